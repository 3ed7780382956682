"""Short ways to common arms and tasks. Each returns a dictionary with keys of a scene, which `|` joins."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any


def arm(
    length: float,
    radius: float,
    youngs_modulus: float,
    *,
    density: float = 1000.0,
    poisson_ratio: float = 0.5,
    elements: int = 20,
    direction: Sequence[float] = (0.0, 0.0, -1.0),
    gravity: bool = True,
    damping: float = 0.0,
    at_rest: bool = True,
) -> dict[str, Any]:
    """Returns the keys of a cylinder that is clamped at the origin and points along `direction`: lengths in m, modulus in Pa, density in
    kg/m^3, viscous damping in 1/s; gravity acts along -z. The arm begins at rest in equilibrium, or without `at_rest` straight, from where
    it falls.
    """
    keys: dict[str, Any] = {
        "rod": {
            "length_m": length,
            "elements": elements,
            "section": {"radius_m": radius},
            "material": {
                "youngs_modulus_pa": youngs_modulus,
                "poisson_ratio": poisson_ratio,
                "density_kg_m3": density,
            },
        },
        "base": {"direction": list(map(float, direction))},
    }
    if gravity:
        keys["gravity"] = {"acceleration_m_s2": [0.0, 0.0, -9.81]}
        if at_rest:
            keys["initial"] = {"shape": "equilibrium"}
    if damping:
        keys["damping"] = {"viscous_1_s": damping}
    return keys


def reach(
    position: Sequence[float],
    time: float,
    force_max: float,
    *,
    moment_max: float | None = None,
    at_rest: bool | str = True,
    blocks: int = 20,
) -> dict[str, Any]:
    """Returns the keys of a task: the tip at `position` (m) after `time` (s), by a force of at most `force_max` (N) on the tip."""
    control: dict[str, Any] = {"force_max_n": force_max, "blocks": blocks}
    if moment_max is not None:
        control["moment_max_n_m"] = moment_max
    return {
        "time": {"end_s": time},
        "task": {"position_m": list(map(float, position)), "at_rest": at_rest},
        "control": control,
    }


def figure_eight(
    center: Sequence[float],
    half_length: float,
    turn: float,
    *,
    duration: float,
    force_max: float,
    sample: float = 0.02,
) -> dict[str, Any]:
    """Returns the keys of a closed loop whose tip follows a figure eight about `center` (m), half of it `half_length` (m) long, a turn in
    `turn` (s), for `duration` (s), with a sample every `sample` (s) and a force of at most `force_max` (N) on the tip.
    """
    eight = {"center_m": list(map(float, center)), "half_length_m": half_length, "turn_s": turn}
    return {
        "time": {"end_s": duration},
        "control": {"force_max_n": force_max},
        "objective": {"track": [{"figure_eight": eight}]},
        "mpc": {"period_s": sample},
    }
