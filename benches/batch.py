"""How many actions a second do arms of a batch take, and how many a rod of PyElastica in the same process?

    pip install . pyelastica
    python benches/batch.py [ARMS]

An arm of 0.3 m, radius 10 mm and 1 MPa is pushed aside by a force on its tip for actions of 10 ms. Rates are the best of five runs of 50 actions,
on a machine that should do nothing else; the error is that of the tip after 50 actions, against 80 elements, in lengths of the arm. PyElastica
takes the longest of the steps tried that stays stable; softarm takes the step that it chooses itself, and the longest as well.
"""

import sys
import time

import numpy as np

import softarm as sa

ACTION, ACTIONS, RUNS = 0.01, 50, 5
STEPS = (20, 50, 100, 200, 500)
LENGTH, RADIUS, MODULUS, DENSITY, VISCOUS, FORCE = 0.3, 0.01, 1e6, 1000.0, 2.0, 0.1


def scene(elements, steps=None):
    keys = sa.arm(LENGTH, RADIUS, MODULUS, density=DENSITY, elements=elements, direction=(0.0, 0.0, 1.0), gravity=False, damping=VISCOUS)
    own = {} if steps is None else {"step_s": ACTION / steps}
    return sa.Scene(keys | {"time": {"end_s": 1.0, "integrator": "explicit"} | own})


def of_softarm(elements, arms, threads, steps=None):
    """Actions a second of all arms, and where a tip ends; with as many steps an action, or those that softarm chooses."""
    batch = sa.batch(scene(elements, steps), arms, threads=threads)
    wrenches = np.zeros((arms, 6))
    wrenches[:, 0] = FORCE
    least = np.inf
    for _ in range(RUNS):
        batch.reset()
        begun = time.perf_counter()
        for _ in range(ACTIONS):
            batch.step(ACTION, wrenches)
        least = min(least, time.perf_counter() - begun)
    return arms * ACTIONS / least, batch.positions[0, -1]


def of_elastica(elements, steps):
    """Actions a second of one rod with as many steps an action, and where its tip ends; no finite place if it is unstable."""
    import elastica as ea

    class Simulator(ea.BaseSystemCollection, ea.Constraints, ea.Forcing, ea.Damping):
        pass

    least, tip, h = np.inf, None, ACTION / steps
    for _ in range(RUNS):
        simulator = Simulator()
        rod = ea.CosseratRod.straight_rod(
            elements, np.zeros(3), np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]), LENGTH, RADIUS, DENSITY,
            youngs_modulus=MODULUS, shear_modulus=MODULUS / 3.0,
        )  # fmt: skip
        simulator.append(rod)
        simulator.constrain(rod).using(ea.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,))
        simulator.add_forcing_to(rod).using(ea.EndpointForces, np.zeros(3), np.array([FORCE, 0.0, 0.0]), ramp_up_time=1e-12)
        simulator.dampen(rod).using(ea.AnalyticalLinearDamper, uniform_damping_constant=VISCOUS, time_step=h)
        simulator.finalize()
        stepper, now = ea.PositionVerlet(), 0.0
        begun = time.perf_counter()
        for _ in range(ACTIONS * steps):
            now = stepper.step(simulator, now, h)
        least, tip = min(least, time.perf_counter() - begun), rod.position_collection[:, -1].copy()
    return ACTIONS / least, tip


def main(arms=64):
    _, best = of_softarm(80, 1, 1)
    print("| program | elements | arms | threads | actions/s | error / length |\n|---|---|---|---|---|---|")

    def row(name, elements, n, threads, found):
        off = np.linalg.norm(found[1] - best) / LENGTH
        print(f"| {name} | {elements} | {n} | {threads} | {found[0]:.3g} | {off:.1e} |", flush=True)

    for steps in (None, STEPS[0]):
        for n, threads in ((1, 1), (arms, 1), (arms, 2)):
            name = "softarm" if steps is None else f"softarm, {steps} steps an action"
            row(name, 10, n, threads, of_softarm(10, n, threads, steps))
    try:
        import elastica  # noqa: F401
    except ImportError:
        print("skipped: PyElastica, not installed", file=sys.stderr)
        return
    for elements in (10, 40):
        for steps in STEPS:
            with np.errstate(all="ignore"):
                found = of_elastica(elements, steps)
            if np.isfinite(found[1]).all() and np.linalg.norm(found[1]) < 2 * LENGTH:
                row(f"PyElastica, {steps} steps an action", elements, 1, 1, found)
                break


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
