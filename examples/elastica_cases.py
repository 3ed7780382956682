"""What returns has a controller of softarm on Cases 2, 3 and 4 of Naughton et al. 2021, for which others train policies?

    pip install . numpy     # or `cargo build --release`
    python examples/elastica_cases.py [--case 2 3 4] [--episodes N] [--seed SEED] [--seconds SECONDS]
    python examples/elastica_cases.py --plant elastica      # pip install pyelastica

The controllers are those of the built-in scenes mpc-elastica-case2, -case3 and -case4, which know the state of the arm. The plant is the arm of softarm
with more elements than the controller has, or with `--plant elastica` a rod of PyElastica, of the elements, time step, damping, contact law and slew rate of
that paper. Rewards, duration and number of actions are those of the paper. Every episode of Case 2 has a target of its own, drawn as there; Cases 3 and 4
have one episode. `--seconds` ends episodes early.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

BUILT = Path(__file__).parent.parent / "target" / "release" / "softarm"
SOFTARM = [BUILT] if BUILT.exists() else [sys.executable, "-m", "softarm"]
ACTION = 1.4e-3  # duration, s

BEST = {2: ("SAC", 3279), 3: ("TRPO", 5749), 4: ("PPO", 2898)}
"""Largest mean of 50 episodes in a row of the runs published with the paper: of Case 3 of those with four points along the arm."""


class Episode:
    """What is asked in an episode of a case, and what its actions are worth."""

    def __init__(self, case, rng):
        self.scene, self.turned, self.overrides = f"mpc-elastica-case{case}", None, []
        if case == 2:
            self.actions, self.elements, self.step, self.points, self.slew = 1428, 20, 2e-4, 6, np.inf
            self.base, self.along, self.normal = [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]
            self.target = rng.uniform([-0.6, 0.3, -0.6], [0.6, 0.9, 0.6])
            self.aim(rng.uniform(-np.pi / 2, np.pi / 2))
        else:
            self.actions, self.elements, self.step, self.points, self.slew = 3571, 50, 1e-4, {3: 4, 4: 2}[case], 0.01
            self.base, self.along, self.normal = [0.0, 0.5, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]
            self.target = np.array([-0.8, 0.5, {3: 0.15, 4: 0.35}[case]])
        self.couple = 75.0 * self.elements  # N m on an element, per length of one meter

    def aim(self, angle):
        """Asks for a tip along y whose section is turned about y."""
        s, c = np.sin(angle), np.cos(angle)
        self.turned = np.array([[-s, c, 0.0], [0.0, 0.0, 1.0], [c, s, 0.0]])  # columns: the axes of the section
        w = np.sqrt(1.0 - s) / 2.0
        quaternion = [w, (s - 1.0) / (4.0 * w), -c / (4.0 * w), -c / (4.0 * w)]
        self.overrides = [
            f"objective.track.0.path_m={[[0.0, *self.target.tolist()]]}",
            f"objective.track.0.orientations_wxyz={[[0.0, *map(float, quaternion)]]}",
        ]

    def rewards(self, tips, rotations):
        """Rewards of actions, after which tips are there and turned so."""
        d = np.linalg.norm(tips - self.target, axis=1)
        if self.turned is None:
            return -(d**2) + 0.5 * (d <= 0.1) + 1.5 * (d <= 0.05)
        # One minus the squared product of the quaternions: the squared sine of half the angle between them.
        o = (3.0 - np.einsum("kij,ij->k", rotations, self.turned)) / 4.0
        near = 0.5 * (d <= 0.1) * (2.0 - o + (o <= 0.1)) + 1.5 * (d <= 0.05) * (2.0 - o + (o <= 0.05))
        return -(d**2) - 0.5 * o**2 + near

    def command(self, *words):
        changes = [word for change in self.overrides for word in ("--set", change)]
        return [*SOFTARM, "mpc"] + [self.scene, "--quiet", *words, *changes]


def in_softarm(episode, actions):
    """Tips and their rotations after the actions, of the arm that `softarm mpc` simulates."""
    times = ACTION * np.arange(1, actions + 1)
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(
            episode.command("--out", f"{folder}/run", "--set", f"mpc.duration_s={times[-1]}"), check=True, capture_output=True
        )
        with np.load(f"{folder}/run/trajectory.npz") as motion:
            t, x, r = motion["t"], motion["x"][:, -1], motion["R"][:, -1]
    nearest = np.searchsorted(0.5 * (t[1:] + t[:-1]), times)
    return np.stack([np.interp(times, t, x[:, i]) for i in range(3)], axis=1), r[nearest]


def splines(places, points):
    """Values at places of the cubic splines, "not a knot", that are 1 at one of equidistant inner points, and 0 at the others and at the ends."""
    at = np.linspace(0.0, 1.0, points + 2)

    def powers(s):
        columns = [s**k for k in range(4)] + [np.maximum(s - knot, 0.0) ** 3 for knot in at[2:-2]]
        return np.stack(columns, axis=1)

    return powers(places) @ np.linalg.solve(powers(at), np.eye(points + 2)[:, 1:-1])


def in_elastica(episode, actions):
    """The same of a rod of PyElastica, which obeys `softarm mpc --serve`."""
    import tomllib

    import elastica as ea

    n, couples, nu = episode.elements, np.zeros((3, episode.elements)), 30.0
    exported = subprocess.run([*SOFTARM, "example", episode.scene], check=True, capture_output=True, text=True).stdout
    cylinders = [cylinder(ea, **body["capsule"]) for body in tomllib.loads(exported).get("contact", [])]
    contact = ea.RodCylinderContact(k=8e4, nu=4.0)

    class Muscles(ea.NoForces):
        """The couples of the present action, the damping of old versions of PyElastica, and the cylinders, which do not move."""

        def apply_forces(self, system, time=0.0):
            velocity = system.velocity_collection
            drag = nu * system.lengths * 0.5 * (velocity[:, 1:] + velocity[:, :-1])
            system.external_forces[:, :-1] -= 0.5 * drag
            system.external_forces[:, 1:] -= 0.5 * drag
            for body in cylinders:
                contact.apply_contact(system, body)

        def apply_torques(self, system, time=0.0):
            system.external_torques += couples - nu * system.lengths * system.omega_collection

    class Simulator(ea.BaseSystemCollection, ea.Constraints, ea.Forcing):
        pass

    simulator, stepper = Simulator(), ea.PositionVerlet()
    rod = ea.CosseratRod.straight_rod(
        n, np.array(episode.base), np.array(episode.along), np.array(episode.normal), 1.0, 0.05, 1000.0,
        youngs_modulus=1e7, shear_modulus=1e7 / 1.5,
    )  # fmt: skip
    rod.shear_matrix[[0, 1], [0, 1]] *= (4.0 / 3.0) / (27.0 / 28.0)  # the shear factor of old versions
    simulator.append(rod)
    simulator.constrain(rod).using(ea.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,))
    simulator.add_forcing_to(rod).using(Muscles)
    simulator.finalize()

    server = subprocess.Popen(episode.command("--serve"), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def say(line):
        print(json.dumps(line), file=server.stdin, flush=True)

    def hear(kind):
        while (line := json.loads(server.stdout.readline()))["type"] != kind:
            if line["type"] == "error":
                raise RuntimeError(line["message"])
        return line

    hello = hear("hello")
    places = np.array([node["place"] for node in hello["nodes"]])
    every = n // (len(places) - 1)
    assert every * (len(places) - 1) == n, "nodes of the model are nodes of the rod"
    ends = np.concatenate([places[:1], 0.5 * (places[1:] + places[:-1]), places[-1:]])
    values_of = np.linalg.pinv(np.diff(ends)[:, None] * splines(places, episode.points)) / episode.couple
    shape, steps = splines(np.arange(1, n + 1) / n, episode.points), round(ACTION / episode.step)
    per_sample, activation, now = round(hello["period_s"] / ACTION), np.zeros((episode.points, 3)), 0.0
    tips, rotations = [], []
    # From the frames of the rod to those of the model: a roll about the arm.
    roll = at_nodes(rod.director_collection.transpose(2, 1, 0))[0].T @ np.array(hello["nodes"][0]["initial_rotation"])
    for action in range(actions):
        if action % per_sample == 0:
            say({
                "type": "measurement",
                "time_s": action * ACTION,
                "positions_m": rod.position_collection.T[::every].tolist(),
                "rotations": (at_nodes(rod.director_collection.transpose(2, 1, 0))[::every] @ roll).tolist(),
                "velocities_m_s": rod.velocity_collection.T[::every].tolist(),
                "angular_velocities_rad_s": (at_nodes(rod.omega_collection.T)[::every] @ roll).tolist(),
            })  # fmt: skip
            command = hear("command")
        part = min((action * ACTION - command["from_s"]) / (command["to_s"] - command["from_s"]), 1.0)
        moments = np.zeros((len(places), 3))
        for wrench in command["wrenches"]:
            moments[wrench["node"]] = (1 - part) * np.array(wrench["moment_from_n_m"]) + part * np.array(wrench["moment_to_n_m"])
        asked = values_of @ moments @ roll.T
        for _ in range(steps):
            activation += np.clip(asked - activation, -episode.slew, episode.slew)
            couples[:] = 75.0 * (shape @ activation).T
            now = stepper.step(simulator, now, episode.step)
        tips.append(rod.position_collection[:, -1].copy())
        rotations.append(rod.director_collection[..., -1].T)
        if not np.isfinite(tips[-1]).all():
            raise RuntimeError("the rod has broken down")
    say({"type": "bye"})
    server.communicate()
    return np.array(tips), np.array(rotations)


def at_nodes(of_elements):
    """Mean of the elements beside a node; at the ends the element there."""
    ends = np.concatenate([of_elements[:1], of_elements, of_elements[-1:]])
    return 0.5 * (ends[:-1] + ends[1:])


def cylinder(ea, from_m, to_m, radius_m):
    """A capsule of a scene as a body of PyElastica."""
    start, way = np.array(from_m), np.array(to_m) - np.array(from_m)
    length = np.linalg.norm(way)
    across = np.cross(way, [0.0, 0.0, 1.0])
    return ea.Cylinder(start, way / length, across / np.linalg.norm(across), length, radius_m, 1000.0)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--case", type=int, nargs="+", choices=(2, 3, 4), default=(2, 3, 4))
    parser.add_argument("--episodes", type=int, default=50, help="episodes of Case 2")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--plant", choices=("softarm", "elastica"), default="softarm")
    parser.add_argument("--seconds", type=float, help="end of an episode, s, before its own")
    options = parser.parse_args()
    play = {"softarm": in_softarm, "elastica": in_elastica}[options.plant]

    rows = []
    for case in options.case:
        rng, returns = np.random.default_rng(options.seed), []
        for number in range(options.episodes if case == 2 else 1):
            episode, began = Episode(case, rng), time.perf_counter()
            actions = episode.actions if options.seconds is None else min(episode.actions, round(options.seconds / ACTION))
            tips, rotations = play(episode, actions)
            returns.append(episode.rewards(tips, rotations).sum())
            off = np.linalg.norm(tips - episode.target, axis=1)
            first = f"after {ACTION * (np.argmax(off <= 0.05) + 1):.3f} s" if off.min() <= 0.05 else "never"
            print(
                f"case {case}, episode {number}: return {returns[-1]:.0f} of {actions} actions; within 5 cm {first}, "
                f"{100 * np.mean(off <= 0.05):.0f} % of the time; {time.perf_counter() - began:.0f} s",
                flush=True,
            )
        rows.append((case, len(returns), np.mean(returns), np.median(returns), *BEST[case]))
    print("| case | episodes | mean return | median | best published mean |")
    print("|---|---|---|---|---|")
    for case, episodes, mean, median, name, best in rows:
        print(f"| {case} | {episodes} | {mean:.0f} | {median:.0f} | {best} ({name}) |")


if __name__ == "__main__":
    main()
