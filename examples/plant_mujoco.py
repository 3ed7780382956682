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
from softarm.mujoco import act, state

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


def main(duration=6.0):
    controller, model, nodes, off = SCENE.controller(), chain(), range(1, N + 2), []
    data = mujoco.MjData(model)
    for _ in range(round(duration / controller.period)):
        command = controller.step(state(model, data, nodes))
        off.append(np.linalg.norm(data.xpos[-1] - command.answer["tip"]["reference_m"]))
        for _ in range(round(controller.period / STEP)):
            act(controller, data, nodes)
            mujoco.mj_step(model, data)
    rms = np.sqrt(np.mean(np.square(off[len(off) // 3 :]))) / SCENE["rod.length_m"]  # the first turn does not count
    print(f"the tip is off its circle by {100 * rms:.3f} % of the length (rms)")
    assert rms < 0.01
    return rms


if __name__ == "__main__":
    main(*map(float, sys.argv[1:]))
