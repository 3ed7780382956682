"""Does a controller of softarm hold a rod of PyElastica on a circle?

    pip install . pyelastica
    python examples/plant_pyelastica.py [SECONDS]

The controller is that of the built-in scene mpc-track-circle, with ten elements and the full state measured; the rod has forty elements, four
fifths of the stiffness that the controller knows, and PyElastica's discretization. `examples/mpc_pyelastica.py` does the same by lines of JSON.
"""

import sys

import elastica as ea
import numpy as np

import softarm as sa
from softarm.elastica import Commanded, state

ELEMENTS, STEP = 40, 1e-4  # of the rod; s
SCENE = sa.Scene.load("mpc-track-circle").replace({"estimator.kind": "none", "estimator.disturbances": []})


class Simulator(ea.BaseSystemCollection, ea.Constraints, ea.Forcing, ea.Damping):
    pass


def main(duration=6.0):
    controller, simulator, modulus = SCENE.controller(), Simulator(), 0.8 * SCENE["rod.material.youngs_modulus_pa"]
    rod = ea.CosseratRod.straight_rod(
        ELEMENTS, np.zeros(3), np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]), SCENE["rod.length_m"],
        SCENE["rod.section.radius_m"], SCENE["rod.material.density_kg_m3"], youngs_modulus=modulus, shear_modulus=modulus / 3.0,
    )  # fmt: skip
    simulator.append(rod)
    simulator.constrain(rod).using(ea.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,))
    simulator.add_forcing_to(rod).using(Commanded, controller)
    simulator.dampen(rod).using(ea.AnalyticalLinearDamper, uniform_damping_constant=SCENE["damping.viscous_1_s"], time_step=STEP)
    simulator.finalize()
    stepper, off, steps = ea.PositionVerlet(), [], round(controller.period / STEP)
    for sample in range(round(duration / controller.period)):
        command = controller.step(state(rod, len(controller.places) - 1))
        off.append(np.linalg.norm(rod.position_collection[:, -1] - command.answer["tip"]["reference_m"]))
        for k in range(sample * steps, (sample + 1) * steps):
            stepper.step(simulator, k * STEP, STEP)
    rms = np.sqrt(np.mean(np.square(off[len(off) // 3 :]))) / SCENE["rod.length_m"]  # the first turn does not count
    print(f"the tip is off its circle by {100 * rms:.3f} % of the length (rms)")
    assert rms < 0.01
    return rms


if __name__ == "__main__":
    main(*map(float, sys.argv[1:]))
