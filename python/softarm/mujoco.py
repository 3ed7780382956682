"""The state of a chain of bodies in MuJoCo, and a controller's forces on it.

A chain has a body for every node of an arm, or for a part of them, in their order from the base on. The frame of a body, `xpos` and `xmat`, is
that of its node: the third axis points along the arm. Its centre of mass may be elsewhere.

MuJoCo counts angular velocities and moments in space, and softarm in the frame of the node; forces act in MuJoCo on centres of mass, and in
softarm on nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .control import Controller, State

__all__ = ["act", "state"]


def state(model: Any, data: Any, bodies: Sequence[int]) -> State:
    """Returns the state on the nodes that these bodies stand for, from `data.qpos` and `data.qvel` as they are now."""
    import mujoco  # type: ignore[import-not-found,import-untyped,unused-ignore]

    # A step leaves positions and velocities of bodies as they were before it.
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    chain = np.asarray(bodies)
    velocities = np.zeros((len(chain), 6))
    for body, velocity in zip(chain, velocities, strict=True):
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, velocity, 0)
    R = data.xmat[chain].reshape(-1, 3, 3)
    return State(data.xpos[chain], R, velocities[:, 3:].copy(), np.einsum("nji,nj->ni", R, velocities[:, :3]))


def act(controller: Controller, data: Any, bodies: Sequence[int]) -> None:
    """Puts the wrenches that a controller commands at `data.time` into `data.xfrc_applied` of the nearest of these bodies.

    What stood there for these bodies is replaced. Call it before every `mujoco.mj_step`. Efforts of actuators are `efforts_at` of
    `controller.acting(data.time)`.
    """
    data.xfrc_applied[np.asarray(bodies)] = 0.0
    for place, wrench in controller.wrenches_at(data.time).items():
        body = bodies[round(place * (len(bodies) - 1))]
        force, lever = wrench[:3], data.xpos[body] - data.xipos[body]
        data.xfrc_applied[body, :3] += force
        data.xfrc_applied[body, 3:] += data.xmat[body].reshape(3, 3) @ wrench[3:] + np.cross(lever, force)
