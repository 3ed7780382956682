"""Does a rest that is learned from shapes help a controller whose model is wrong?

    pip install . mujoco
    python examples/learned_rest.py [SECONDS]

The controller of the built-in scene mpc-track-circle, with ten elements, the full state measured and no estimator, holds a chain of MuJoCo on a
circle. The chain hangs under gravity, which its model knows, and has four fifths of the stiffness of its model. The rest is a potential of the
bending and of the stretch of a section, since the chain does not stretch, learned from shapes of the chain at rest under forces on its tip, a quarter of which are held out.
"""

import sys

import mujoco
import numpy as np

import softarm as sa
from softarm.mujoco import act, state

GRAVITY = [0.0, 0.0, 9.81]  # m/s², along the arm: it hangs
SCENE = sa.Scene.load("mpc-track-circle").replace(
    {
        "estimator.kind": "none",
        "estimator.disturbances": [],
        "damping.viscous_1_s": 0.0,
        "damping.internal_s": 0.02,
        "gravity": {"acceleration_m_s2": GRAVITY},
    }
)
RADIUS, N, STEP = SCENE["rod.section.radius_m"], SCENE["rod.elements"], 5e-4  # m, elements, s
HALF = 0.5 * SCENE["rod.length_m"] / N
NODES = range(1, N + 2)
REST = [
    {"strains": ["bend_1", "bend_2"], "grid": [[-3.0, 3.0, 5], [-3.0, 3.0, 5]]},
    {"strains": ["stretch"], "grid": [[-0.01, 0.02, 7]]},
]
PRIORS = [1.0, 30.0]  # J/m


def chain():
    """Bodies in a row along z, whose frames are on the nodes; the first is fixed, and it and the last are half as long."""
    stiffness = 0.8 * SCENE["rod.material.youngs_modulus_pa"] * 0.25 * np.pi * RADIUS**4 / (2 * HALF)
    joint = f'<joint type="ball" pos="0 0 {-HALF}" stiffness="{stiffness}" damping="{stiffness * SCENE["damping.internal_s"]}"/>'
    bodies = "".join(
        f'<body pos="0 0 {2 * HALF}">{joint}<geom type="cylinder" size="{RADIUS}" density="{SCENE["rod.material.density_kg_m3"]}" '
        f'fromto="0 0 {-HALF} 0 0 {HALF if node < N else 0.0}"/>'
        for node in range(1, N + 1)
    )
    gravity = " ".join(map(str, GRAVITY))
    head = f'<option timestep="{STEP}" gravity="{gravity}" integrator="implicitfast"><flag contact="disable"/></option>'
    text = f"<mujoco>{head}<worldbody><body>{bodies}{'</body>' * (N + 1)}</worldbody></mujoco>"
    return mujoco.MjModel.from_xml_string(text)


def shape(force):
    """Places of three nodes of the chain at rest under a force on its tip."""
    model = chain()
    model.dof_damping[:] *= 30.0  # it comes to rest sooner, in the same shape
    data = mujoco.MjData(model)
    data.xfrc_applied[-1, :3] = force
    for _ in range(round(8.0 / STEP)):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    return {f"node{k}": data.xpos[NODES[k]].tolist() for k in (4, 7, N)}


def measured(n_shapes):
    """Shapes under forces that no pattern has."""
    dice = np.random.default_rng(1)
    forces = [[*dice.uniform(-10.0, 10.0, 2).tolist(), 0.0] for _ in range(n_shapes)]
    shapes = [
        {"set": [f"load.0.force_n={force}"], "positions_m": shape(force), "held_out": k % 4 == 3} for k, force in enumerate(forces)
    ]
    markers = [{"name": f"node{k}", "at": k / N} for k in (4, 7, N)]
    return {"sigma_m": 1e-4, "marker": markers, "shape": shapes}


def off(scene, duration):
    """The distance of the tip from the circle, root of the mean square after the first turn, over the length."""
    controller, model, off = scene.controller(), chain(), []
    data = mujoco.MjData(model)
    for _ in range(round(duration / controller.period)):
        command = controller.step(state(model, data, NODES))
        off.append(np.linalg.norm(data.xpos[-1] - command.answer["tip"]["reference_m"]))
        for _ in range(round(controller.period / STEP)):
            act(controller, data, NODES)
            mujoco.mj_step(model, data)
    return np.sqrt(np.mean(np.square(off[len(off) // 3 :]))) / SCENE["rod.length_m"]


def main(duration=6.0, n_shapes=24):
    data = measured(n_shapes)
    loaded = SCENE.replace({"load": [{"node": "tip", "force_n": [0.0, 0.0, 0.0]}]})
    free = [{"key": f"learned.{k}.weights", "prior": 0.0, "prior_sigma": sigma} for k, sigma in enumerate(PRIORS)]
    fitted = loaded.replace({"learned": REST}).fit(data | {"free": free})
    held_out = 1e3 * fitted.summary["held_out_rms_m"]
    plain = loaded.fit(data, free=["marker.node4.offset_m.0"]).summary["held_out_rms_m"] * 1e3
    print(f"shapes that were held out: places off by {plain:.2f} mm without the rest, {held_out:.2f} mm with it")
    learned = SCENE.replace({"learned": fitted.scene["learned"]})
    without, with_rest = (100 * off(scene, duration) for scene in (SCENE, learned))
    print(f"the loop: off by {without:.3f} % of the length without the rest, {with_rest:.3f} % with it")
    assert held_out < 0.5 * plain and with_rest < 1.1 * without
    return without, with_rest


if __name__ == "__main__":
    main(*map(float, sys.argv[1:]))
