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
from softarm.elastica import state

ELEMENTS, STEP = 40, 1e-4  # of the rod; s
SCENE = sa.Scene.load("mpc-track-circle").replace({"estimator.kind": "none", "estimator.disturbances": []})


class Commanded(ea.NoForces):
    """The wrench at the tip: force in space, moment in the frame of the last element."""

    wrench = np.zeros(6)

    def apply_forces(self, system, time=0.0):
        system.external_forces[:, -1] += self.wrench[:3]

    def apply_torques(self, system, time=0.0):
        system.external_torques[:, -1] += self.wrench[3:]


class Simulator(ea.BaseSystemCollection, ea.Constraints, ea.Forcing, ea.Damping):
    pass


def rod_and_simulator():
    simulator, modulus = Simulator(), 0.8 * SCENE["rod.material.youngs_modulus_pa"]
    rod = ea.CosseratRod.straight_rod(
        ELEMENTS, np.zeros(3), np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]), SCENE["rod.length_m"],
        SCENE["rod.section.radius_m"], SCENE["rod.material.density_kg_m3"], youngs_modulus=modulus, shear_modulus=modulus / 3.0,
    )  # fmt: skip
    simulator.append(rod)
    simulator.constrain(rod).using(ea.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,))
    simulator.add_forcing_to(rod).using(Commanded)
    simulator.dampen(rod).using(ea.AnalyticalLinearDamper, uniform_damping_constant=SCENE["damping.viscous_1_s"], time_step=STEP)
    simulator.finalize()
    return rod, simulator


def main(duration=6.0):
    controller, commands, off = SCENE.controller(), [], []
    (rod, simulator), stepper = rod_and_simulator(), ea.PositionVerlet()
    for sample in range(round(duration / controller.period)):
        start = sample * controller.period
        commands = [*commands[-1:], controller.step(state(rod, len(controller.places) - 1))]
        off.append(np.linalg.norm(rod.position_collection[:, -1] - commands[-1].answer["tip"]["reference_m"]))
        ends = [(command.start, command.end, *command.wrenches[1.0]) for command in commands]
        for k in range(round(controller.period / STEP)):
            now = start + k * STEP
            # A command acts from its own time on, which may be that of the next sample; nothing acts before the first.
            for begins, until, begin, end in ends:
                if begins <= now + 1e-9:
                    part = min((now - begins) / (until - begins), 1.0)
                    Commanded.wrench = (1.0 - part) * begin + part * end
            stepper.step(simulator, now, STEP)
    counted = off[len(off) // 3 :]  # the first turn does not count
    rms = np.sqrt(np.mean(np.square(counted))) / SCENE["rod.length_m"]
    print(f"the tip is off its circle by {100 * rms:.3f} % of the length (rms)")
    assert rms < 0.01
    return rms


if __name__ == "__main__":
    main(*map(float, sys.argv[1:]))
