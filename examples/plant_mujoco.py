"""Does a controller of softarm hold a chain of MuJoCo on a circle?

    pip install . mujoco
    python examples/plant_mujoco.py [SECONDS]

The controller is that of the built-in scene mpc-track-circle, with ten elements and the full state measured; the plant has twenty rigid bodies on
ball joints, which bend and twist but neither shear nor stretch, and four fifths of the stiffness that the controller knows.
"""

import sys
from types import SimpleNamespace

import mujoco
import numpy as np

import softarm as sa
from softarm.elastica import state

BODIES, STEP = 20, 5e-4  # of the chain; s
SCENE = sa.Scene.load("mpc-track-circle").replace({"estimator.kind": "none", "estimator.disturbances": []})
LENGTH, RADIUS = SCENE["rod.length_m"], SCENE["rod.section.radius_m"]
PIECE = LENGTH / BODIES


def chain():
    """Bodies in a row along z. A joint has the bending stiffness of the arm between the middles of its bodies, the first that of half of it."""
    joint = 0.8 * SCENE["rod.material.youngs_modulus_pa"] * 0.25 * np.pi * RADIUS**4 / PIECE
    bodies = "".join(
        f'<body pos="0 0 {PIECE if i else 0}"><joint type="ball" stiffness="{joint if i else 2 * joint}"/>'
        f'<geom type="cylinder" size="{RADIUS}" fromto="0 0 0 0 0 {PIECE}" density="{SCENE["rod.material.density_kg_m3"]}"/>'
        for i in range(BODIES)
    )
    head = f'<option timestep="{STEP}" gravity="0 0 0" integrator="implicitfast"><flag contact="disable"/></option>'
    return mujoco.MjModel.from_xml_string(f"<mujoco>{head}<worldbody>{bodies}{'</body>' * BODIES}</worldbody></mujoco>")


def arrays(data):
    """What `softarm.elastica.state` reads: positions and velocities of the joints and the tip, and frames and spins of the bodies."""
    R, spins = data.xmat[1:].reshape(-1, 3, 3), data.cvel[1:, :3]
    x = np.vstack([data.xpos[1:], data.xpos[-1] + PIECE * R[-1, :, 2]])
    v = np.vstack([data.cvel[1:, 3:], data.cvel[-1:, 3:]]) + np.cross(np.vstack([spins, spins[-1:]]), x - data.subtree_com[1])
    return SimpleNamespace(
        position_collection=x.T,
        velocity_collection=v.T,
        director_collection=R.transpose(2, 1, 0),
        omega_collection=np.einsum("nji,nj->in", R, spins),
    )


def main(duration=6.0):
    model = chain()
    data, controller, commands, off = mujoco.MjData(model), SCENE.controller(), [], []
    for sample in range(round(duration / controller.period)):
        mujoco.mj_forward(model, data)  # places and velocities after the last step
        start, arm = sample * controller.period, arrays(data)
        commands = [*commands[-1:], controller.step(state(arm, len(controller.places) - 1))]
        off.append(np.linalg.norm(arm.position_collection[:, -1] - commands[-1].answer["tip"]["reference_m"]))
        ends = [(command.start, command.end, *command.wrenches[1.0]) for command in commands]
        for k in range(round(controller.period / STEP)):
            now = start + k * STEP
            middle = data.cvel[1:, 3:] + np.cross(data.cvel[1:, :3], data.xipos[1:] - data.subtree_com[1])
            data.xfrc_applied[1:, :3] = -SCENE["damping.viscous_1_s"] * model.body_mass[1:, None] * middle
            data.xfrc_applied[-1, 3:] = 0.0
            # A command acts from its own time on, which may be that of the next sample; nothing acts before the first.
            acting = [own for own in ends if own[0] <= now + 1e-9][-1:]
            for begins, until, begin, end in acting:
                part = min((now - begins) / (until - begins), 1.0)
                wrench, R = (1.0 - part) * begin + part * end, data.xmat[-1].reshape(3, 3)
                # MuJoCo takes forces at the middle of a body, in space; these act at its end.
                data.xfrc_applied[-1, :3] += wrench[:3]
                data.xfrc_applied[-1, 3:] = R @ wrench[3:] + np.cross(0.5 * PIECE * R[:, 2], wrench[:3])
            mujoco.mj_step(model, data)
    counted = off[len(off) // 3 :]  # the first turn does not count
    rms = np.sqrt(np.mean(np.square(counted))) / LENGTH
    print(f"the tip is off its circle by {100 * rms:.3f} % of the length (rms)")
    assert rms < 0.01
    return rms


if __name__ == "__main__":
    main(*map(float, sys.argv[1:]))
