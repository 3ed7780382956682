"""Does a controller of softarm hold a chain of MuJoCo on a circle?

    pip install . mujoco
    python examples/plant_mujoco.py [SECONDS]

The controller is that of the built-in scene mpc-track-circle, with ten elements and the full state measured. The chain has a rigid body for every
node of the controller's model, with ball joints midway between two: it bends and twists, and neither shears nor stretches. It has four fifths of
the stiffness that the controller knows.
"""

import sys

import mujoco
import numpy as np

import softarm as sa

SCENE = sa.Scene.load("mpc-track-circle").replace(
    {"estimator.kind": "none", "estimator.disturbances": [], "damping.viscous_1_s": 0.0, "damping.internal_s": 0.02}
)
RADIUS, N, STEP = SCENE["rod.section.radius_m"], SCENE["rod.elements"], 5e-4  # m, elements, s
HALF = 0.5 * SCENE["rod.length_m"] / N


def chain():
    """Bodies in a row along z, whose frames are on the nodes; the first is fixed, and it and the last are half as long."""
    stiffness = 0.8 * SCENE["rod.material.youngs_modulus_pa"] * 0.25 * np.pi * RADIUS**4 / (2 * HALF)
    joint = f'<joint type="ball" pos="0 0 {-HALF}" stiffness="{stiffness}" damping="{stiffness * SCENE["damping.internal_s"]}"/>'
    bodies = "".join(
        f'<body pos="0 0 {2 * HALF}">{joint}<geom type="cylinder" size="{RADIUS}" density="{SCENE["rod.material.density_kg_m3"]}" '
        f'fromto="0 0 {-HALF} 0 0 {HALF if node < N else 0.0}"/>'
        for node in range(1, N + 1)
    )
    head = f'<option timestep="{STEP}" gravity="0 0 0" integrator="implicitfast"><flag contact="disable"/></option>'
    text = f"<mujoco>{head}<worldbody><body>{bodies}{'</body>' * (N + 1)}</worldbody></mujoco>"
    return mujoco.MjModel.from_xml_string(text)


def state(model, data):
    """The state on the nodes of the controller's model."""
    mujoco.mj_forward(model, data)
    rates = np.zeros((N + 1, 6))
    for node in range(N + 1):
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, node + 1, rates[node], 0)
    R = data.xmat[1:].reshape(-1, 3, 3)
    return sa.State(data.xpos[1:].copy(), R.copy(), rates[:, 3:].copy(), np.einsum("nji,nj->ni", R, rates[:, :3]))


def main(duration=6.0):
    controller, model, off = SCENE.controller(), chain(), []
    data, steps = mujoco.MjData(model), round(controller.period / STEP)
    for sample in range(round(duration / controller.period)):
        command = controller.step(state(model, data))
        off.append(np.linalg.norm(data.xpos[-1] - command.answer["tip"]["reference_m"]))
        for k in range(sample * steps, (sample + 1) * steps):
            if acting := controller.acting(k * STEP):
                wrench = acting.wrenches_at(k * STEP)[1.0]
                # MuJoCo takes a force at the middle of a body, and a moment in space.
                arm, R = data.xpos[-1] - data.xipos[-1], data.xmat[-1].reshape(3, 3)
                data.xfrc_applied[-1] = [*wrench[:3], *(R @ wrench[3:] + np.cross(arm, wrench[:3]))]
            mujoco.mj_step(model, data)
    rms = np.sqrt(np.mean(np.square(off[len(off) // 3 :]))) / SCENE["rod.length_m"]  # the first turn does not count
    print(f"the tip is off its circle by {100 * rms:.3f} % of the length (rms)")
    assert rms < 0.01
    return rms


if __name__ == "__main__":
    main(*map(float, sys.argv[1:]))
