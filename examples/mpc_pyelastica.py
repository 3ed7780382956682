"""Does a controller of softarm hold a rod of PyElastica on a circle?

    cargo build --release
    pip install pyelastica numpy
    python examples/mpc_pyelastica.py [OPTIONS OF softarm mpc]

The controller is that of the built-in scene mpc-track-circle, with ten elements and the full state measured; the rod has forty elements, four
fifths of the stiffness that the controller knows, and PyElastica's discretization. They talk by lines of JSON (docs/serving.md).

A filter that estimates velocities and the stiffness from poses:

    python examples/mpc_pyelastica.py --set estimator.kind=kalman --set 'estimator.disturbances=["stiffness"]' --set sensor.0.age_s=0
"""

import json
import subprocess
import sys
from pathlib import Path

import elastica as ea
import numpy as np

ELEMENTS, STEP = 40, 1e-4  # of the rod; s
LENGTH, RADIUS, DENSITY, DAMPING = 1.0, 0.05, 1000.0, 1.0  # of the scene: m, m, kg/m3, 1/s
YOUNGS = 0.8 * 1e6  # Pa

SOFTARM = Path(__file__).parent.parent / "target" / "release" / "softarm"
COMMAND = [SOFTARM, "mpc", "mpc-track-circle", "--serve", "--quiet", "--set", "estimator.kind=none", "--set", "estimator.disturbances=[]"]


class Commanded(ea.NoForces):
    """The wrench of the last command at the tip: force in space, moment in the frame of the last element."""

    def __init__(self, current):
        self.current = current  # the command that acts, the first of a list

    def wrench(self, part, time):
        command = self.current[0]
        wrench, start, end = command["wrenches"][0], command["from_s"], command["to_s"]
        if time < start:
            return np.zeros(3)  # nothing acts before the first command
        s = min((time - start) / (end - start), 1.0)
        a, b = (np.array(wrench[part.format(at)]) for at in ("from", "to"))
        return (1 - s) * a + s * b

    def apply_forces(self, system, time=0.0):
        system.external_forces[:, -1] += self.wrench("force_{}_n", time)

    def apply_torques(self, system, time=0.0):
        system.external_torques[:, -1] += self.wrench("moment_{}_n_m", time)


class Simulator(ea.BaseSystemCollection, ea.Constraints, ea.Forcing, ea.Damping):
    pass


def rod_and_simulator(commands):
    simulator = Simulator()
    rod = ea.CosseratRod.straight_rod(
        ELEMENTS, np.zeros(3), np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]), LENGTH, RADIUS, DENSITY,
        youngs_modulus=YOUNGS, shear_modulus=YOUNGS / 3.0,
    )  # fmt: skip
    simulator.append(rod)
    simulator.constrain(rod).using(ea.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,))
    simulator.add_forcing_to(rod).using(Commanded, current=commands)
    simulator.dampen(rod).using(ea.AnalyticalLinearDamper, uniform_damping_constant=DAMPING, time_step=STEP)
    simulator.finalize()
    return rod, simulator


def at_nodes(of_elements):
    """Mean of the elements beside a node; at the ends the element there. Means of rotations are none, but near: softarm projects them."""
    ends = np.concatenate([of_elements[:1], of_elements, of_elements[-1:]])
    return 0.5 * (ends[:-1] + ends[1:])


def measurement(rod, time, nodes):
    """The state on the nodes of the model, all in the frames of softarm: columns of a rotation are directors, PyElastica has rows."""
    rotations = at_nodes(rod.director_collection.transpose(2, 1, 0))
    return {
        "type": "measurement",
        "time_s": time,
        "positions_m": rod.position_collection.T[nodes].tolist(),
        "rotations": rotations[nodes].tolist(),
        "velocities_m_s": rod.velocity_collection.T[nodes].tolist(),
        "angular_velocities_rad_s": at_nodes(rod.omega_collection.T)[nodes].tolist(),
    }


def main():
    server = subprocess.Popen(COMMAND + sys.argv[1:], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def say(line):
        print(json.dumps(line), file=server.stdin, flush=True)

    def hear(*kinds):
        while True:
            line = json.loads(server.stdout.readline())
            if line["type"] == "error":
                print("error:", line, file=sys.stderr)
            elif line["type"] in kinds:
                return line

    hello = hear("hello")
    nodes = [round(node["place"] * ELEMENTS) for node in hello["nodes"]]
    commands, off = [], []
    rod, simulator = rod_and_simulator(commands)
    stepper, steps = ea.PositionVerlet(), round(hello["period_s"] / STEP)
    for sample in range(round(hello["duration_s"] / hello["period_s"])):
        time = sample * hello["period_s"]
        say(measurement(rod, time, nodes))
        command = hear("command")
        if time >= 2.0:  # the first turn does not count
            reference = np.array(command["tip"]["reference_m"])
            off.append(np.linalg.norm(rod.position_collection[:, -1] - reference))
        # A command acts from its own time on, which may be that of the next sample.
        commands.append(command)
        for k in range(steps):
            now = time + k * STEP
            while len(commands) > 1 and commands[1]["from_s"] <= now + 1e-9:
                commands.pop(0)
            stepper.step(simulator, now, STEP)
    say({"type": "bye"})
    summary = hear("summary")
    print(json.dumps(summary))
    print(f"an answer takes {1e3 * summary['response_s']['p50']:.2f} ms (median)")
    print(f"rotations were changed by {summary['rotation_change']:.1e} at the most")
    rms = np.sqrt(np.mean(np.square(off)))
    print(f"the tip is off its circle by {1e3 * rms:.2f} mm (rms), {100 * rms / LENGTH:.3f} % of the length")
    assert rms < 0.01 * LENGTH


if __name__ == "__main__":
    main()
