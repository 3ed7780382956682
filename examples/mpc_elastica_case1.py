"""What return has a controller of softarm on Case 1 of Naughton et al. 2021, for which others train policies?

    cargo build --release
    pip install pyelastica numpy
    python examples/mpc_elastica_case1.py [EPISODES] [OPTIONS OF softarm mpc]

A rod of PyElastica, of twenty elements and with the damping of the version of that paper, is actuated by couples along it: splines of six points in
two directions. The target moves at 0.5 m/s within a box and changes its direction every 500 actions. The controller is that of the built-in scene
mpc-elastica-case1; it knows the state of the rod, and place and velocity of the target, but not where that turns next. An action lasts seven steps; its reward is -d2 for the
distance d of tip and target, 0.5 more below 10 cm, and another 1.5 below 5 cm: at most 14 284 an episode. The best policies that were published with the
case (170 logged runs, mean of 50 episodes) have 12 095 (PPO), 11 885 (TD3), 11 678 (DDPG), 11 322 (SAC) and 7 725 (TRPO).
"""

import json
import subprocess
import sys
from pathlib import Path

import elastica as ea
import numpy as np

ELEMENTS, STEP, STEPS_AN_ACTION, ACTIONS = 20, 2e-4, 7, 7142
LENGTH, RADIUS, DENSITY, YOUNGS, NU = 1.0, 0.05, 1000.0, 1e7, 30.0
SPEED, REDRAWN, BALL = 0.5, 500, 0.05  # of the target: m/s, actions, m
BOX = np.array([[-0.6, 0.6], [0.3, 0.9], [-0.6, 0.6]])

SOFTARM = Path(__file__).parent.parent / "target" / "release" / "softarm"


class Target:
    """A ball that flies straight on, is reflected by the walls, and now and then takes another direction."""

    def __init__(self, seed):
        self.dice = np.random.default_rng(seed)
        self.x = self.dice.uniform(BOX[:, 0], BOX[:, 1])
        self.turn()

    def turn(self):
        a, b = np.pi * self.dice.uniform(0, 2, 2)
        self.v = SPEED * np.array([np.cos(a) * np.sin(b), np.sin(a) * np.sin(b), np.cos(b)])

    @staticmethod
    def moved(x, v, dt):
        x = x + v * dt
        outside = (x - BALL < BOX[:, 0]) | (x + BALL > BOX[:, 1])
        return x, np.where(outside, -v, v)

    def advance(self):
        self.x, self.v = self.moved(self.x, self.v, STEP)

    def expected(self, time, horizon, step):
        """Rows of time and place, if it does not turn."""
        x, v, rows = self.x, self.v, [[time, *self.x]]
        for k in range(1, round(horizon / step) + 2):
            x, v = self.moved(x, v, step)
            rows.append([time + k * step, *x])
        return rows


class Muscles(ea.NoForces):
    """The couples of the present action, one on each element, and the damping of old versions of PyElastica."""

    def __init__(self, couples):
        self.couples = couples

    def apply_forces(self, system, time=0.0):
        share = np.full(ELEMENTS + 1, NU * LENGTH / ELEMENTS)
        share[[0, -1]] *= 0.5
        system.external_forces -= share * system.velocity_collection

    def apply_torques(self, system, time=0.0):
        system.external_torques += self.couples - NU * LENGTH / ELEMENTS * system.omega_collection


class Simulator(ea.BaseSystemCollection, ea.Constraints, ea.Forcing):
    pass


def rod_and_simulator(couples, normal):
    simulator = Simulator()
    rod = ea.CosseratRod.straight_rod(
        ELEMENTS, np.zeros(3), np.array([0.0, 1.0, 0.0]), normal, LENGTH, RADIUS, DENSITY,
        youngs_modulus=YOUNGS, shear_modulus=YOUNGS / 3.0,
    )  # fmt: skip
    simulator.append(rod)
    simulator.constrain(rod).using(ea.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,))
    simulator.add_forcing_to(rod).using(Muscles, couples=couples)
    simulator.finalize()
    return rod, simulator


def at_nodes(of_elements):
    """Mean of the elements beside a node; at the ends the element there."""
    ends = np.concatenate([of_elements[:1], of_elements, of_elements[-1:]])
    return 0.5 * (ends[:-1] + ends[1:])


def episode(seed, options):
    command = [SOFTARM, "mpc", "mpc-elastica-case1", "--serve", "--quiet", *options]
    server = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def say(line):
        print(json.dumps(line), file=server.stdin, flush=True)

    def hear(kind):
        while True:
            line = json.loads(server.stdout.readline())
            if line["type"] == "error":
                print("error:", line, file=sys.stderr)
            elif line["type"] == kind:
                return line

    hello = hear("hello")
    period, couples, target = hello["period_s"], np.zeros((3, ELEMENTS)), Target(seed)
    rod, simulator = rod_and_simulator(couples, np.array(hello["nodes"][0]["initial_rotation"])[:, 0])
    stepper, per_sample = ea.PositionVerlet(), round(period / STEP / STEPS_AN_ACTION)
    reward, n_near = 0.0, 0
    for action in range(ACTIONS):
        time = action * STEPS_AN_ACTION * STEP
        if action % per_sample == 0:
            say({
                "type": "measurement",
                "time_s": time,
                "positions_m": rod.position_collection.T.tolist(),
                "rotations": at_nodes(rod.director_collection.transpose(2, 1, 0)).tolist(),
                "velocities_m_s": rod.velocity_collection.T.tolist(),
                "angular_velocities_rad_s": at_nodes(rod.omega_collection.T).tolist(),
                "reference_m": target.expected(time, hello["horizon_s"] + period, period),
            })  # fmt: skip
            command = hear("command")
        s = min((time - command["from_s"]) / (command["to_s"] - command["from_s"]), 1.0)
        for wrench in command["wrenches"]:
            moment = (1 - s) * np.array(wrench["moment_from_n_m"]) + s * np.array(wrench["moment_to_n_m"])
            couples[:, wrench["node"] - 1] = moment  # of the node at the end of the element
        for k in range(STEPS_AN_ACTION):
            stepper.step(simulator, time + k * STEP, STEP)
            target.advance()
        if (action + 1) % REDRAWN == 0:
            target.turn()
        distance = np.linalg.norm(rod.position_collection[:, -1] - target.x)
        if not np.isfinite(distance):  # the rod has broken down
            reward -= 10000.0
            break
        reward += -(distance**2) + 0.5 * (distance < 0.1) + 1.5 * (distance < 0.05)
        n_near += distance < 0.05
    say({"type": "bye"})
    return reward, n_near / ACTIONS, hear("summary")


def main():
    episodes = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    returns = []
    for seed in range(episodes):
        reward, near, summary = episode(seed, sys.argv[2:])
        returns.append(reward)
        print(
            f"episode {seed}: return {reward:.0f}, {100 * near:.1f} % of the time within 5 cm, {sum(summary['fallbacks'].values())} fall-backs, "
            f"an answer takes {1e3 * summary['response_s']['p50']:.2f} ms, a sample {1e3 * summary['sample_s']['p50']:.2f} ms (median)",
            flush=True,
        )
    error = np.std(returns, ddof=1) / np.sqrt(episodes) if episodes > 1 else np.nan
    print(f"mean return of {episodes} episodes: {np.mean(returns):.0f} +- {error:.0f}")


if __name__ == "__main__":
    main()
