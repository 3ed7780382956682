"""States in the layout of PyElastica and back.

PyElastica has positions and velocities `(3, n+1)` on nodes, and directors `(3, 3, n)`, whose rows are the axes of the sections in space, and
angular velocities `(3, n)` on the `n` elements between; softarm has all of them on nodes, with axes as columns. Both count angular velocities,
and moments, in the frame of the section, whose third axis points along the arm.

Positions and velocities are the same numbers. Rotations go to the middle between two neighbours: there and back, they are exact where the arm is
curved alike all along, and else off by a curvature's change over an element. Elements are equal in length.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .control import Controller, State

try:
    from elastica import NoForces  # type: ignore[import-not-found,import-untyped,unused-ignore]
except ImportError:
    NoForces = object

__all__ = ["Commanded", "arrays", "put", "state"]


class Commanded(NoForces):  # type: ignore[misc,unused-ignore]
    """What a controller commands, as a forcing of a rod: `simulator.add_forcing_to(rod).using(Commanded, controller)`.

    A force acts on the node nearest to its place, and a moment on the element there.
    """

    def __init__(self, controller: Controller):
        super().__init__()
        self.controller = controller

    def apply_forces(self, system: Any, time: Any = 0.0) -> None:
        last = system.position_collection.shape[1] - 1
        for place, wrench in self.controller.wrenches_at(float(time)).items():
            system.external_forces[:, round(place * last)] += wrench[:3]

    def apply_torques(self, system: Any, time: Any = 0.0) -> None:
        last = system.director_collection.shape[2] - 1
        for place, wrench in self.controller.wrenches_at(float(time)).items():
            system.external_torques[:, min(int(place * (last + 1)), last)] += wrench[3:]


def arrays(state: State) -> dict[str, np.ndarray]:
    """Returns `position_collection`, `director_collection`, `velocity_collection` and `omega_collection` of a state."""
    return {
        "position_collection": np.ascontiguousarray(state.x.T),
        "director_collection": np.ascontiguousarray(_between(state.R).transpose(2, 1, 0)),
        "velocity_collection": np.ascontiguousarray(state.v.T),
        "omega_collection": np.ascontiguousarray(0.5 * (state.w[:-1] + state.w[1:]).T),
    }


def put(rod: Any, state: State) -> None:
    """Puts a rod of PyElastica into a state with its elements, in place."""
    for name, array in arrays(state).items():
        own = getattr(rod, name)
        if own.shape != array.shape:
            raise ValueError(f"the state has {len(state.x) - 1} elements, and the rod {rod.position_collection.shape[1] - 1}")
        own[...] = array


def state(rod: Any, elements: int | None = None) -> State:
    """Returns the state of a rod, or of anything with the four arrays, on the nodes of as many elements as it has, or of a divisor of them."""
    x, v = rod.position_collection.T, rod.velocity_collection.T
    R, w = _at_nodes(rod.director_collection.transpose(2, 1, 0), rod.omega_collection.T)
    n = len(R) - 1
    stride, rest = divmod(n, n if elements is None else elements)
    if stride == 0 or rest:
        raise ValueError(f"the rod has {n} elements, which {elements} do not divide")
    return State(*(np.ascontiguousarray(own[::stride]) for own in (x, R, v, w)))


def _at_nodes(R: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns rotations and angular velocities at nodes, of those on elements: those between two, and at the ends half an element farther."""
    if len(R) == 1:
        return np.repeat(R, 2, axis=0), np.repeat(w, 2, axis=0)
    inner, spins = _between(R), 0.5 * (w[:-1] + w[1:])
    # The next in a row with equal turns: R_2 = R_1 R_0^T R_1.
    first, last = R[0] @ inner[0].T @ R[0], R[-1] @ inner[-1].T @ R[-1]
    ends = 1.5 * w[0] - 0.5 * w[1], 1.5 * w[-1] - 0.5 * w[-2]
    return np.concatenate([first[None], inner, last[None]]), np.concatenate([ends[0][None], spins, ends[1][None]])


def _between(R: np.ndarray) -> np.ndarray:
    """Returns the rotations midway between neighbours of a row `(n, 3, 3)`: the nearest to their sum."""
    left, _, right = np.linalg.svd(R[:-1] + R[1:])
    return left @ right
