"""How many actions a second do arms of a batch take, and how many those of PyElastica and SoRoMoX in the same process?

    pip install . pyelastica soromox
    python benches/batch.py [ARMS] > benches/batch.md

An arm of 0.3 m, radius 10 mm and 1 MPa is pushed aside by a force on its tip for actions of 10 ms. Rates are the best of five runs of 50 actions,
on a machine that should do nothing else; the error is that of the tip after 50 actions, against 80 elements, in lengths of the arm. PyElastica
takes the longest of the steps tried that stays stable; softarm takes the step that it chooses itself, and the longest as well.

SoRoMoX runs on the CPU alone, compiled and warm, in float64; no GPU is measured, for which it is made as well. Its arm is one link of variable
strain, of order 2 in bending: with bending alone, the fastest choice of those tried, or with constant twist, stretch and shear too, which have the
stiffness of the others. Steps are those of its semi-implicit Euler method, the fewest an action that stay stable, from a velocity half a step
earlier. Bases, orders and steps were chosen of some forty by the rate and by the very error shown, which favors it. Its arms are mapped by `vmap`
and shared among two CPU devices if their number is even; XLA may use two threads for one arm.
"""

import os
import platform
import sys
import time
from pathlib import Path

import numpy as np

import softarm as sa

ACTION, ACTIONS, RUNS = 0.01, 50, 5
STEPS = (20, 50, 100, 200, 500)
SOROMOX = {"bending": ([0, 1, 1, 0, 0, 0], 2), "all strains": ([1, 1, 1, 1, 1, 1], 9)}
LENGTH, RADIUS, MODULUS, DENSITY, VISCOUS, FORCE = 0.3, 0.01, 1e6, 1000.0, 2.0, 0.1


def scene(elements, steps=None):
    keys = sa.arm(LENGTH, RADIUS, MODULUS, density=DENSITY, elements=elements, direction=(0.0, 0.0, 1.0), gravity=False, damping=VISCOUS)
    own = {} if steps is None else {"step_s": ACTION / steps}
    return sa.Scene(keys | {"time": {"end_s": 1.0, "integrator": "explicit"} | own})


def rate(arms, begin, act, end=lambda state: None):
    """Actions a second of all arms from what `begin` returns, the best of the runs, and the last state, for which `end` waits."""
    least = np.inf
    for _ in range(RUNS):
        state, begun = begin(), time.perf_counter()
        for _ in range(ACTIONS):
            state = act(state)
        end(state)
        least = min(least, time.perf_counter() - begun)
    return arms * ACTIONS / least, state


def of_softarm(elements, arms, threads, steps=None):
    """Actions a second of all arms, and where a tip ends; with as many steps an action, or those that softarm chooses."""
    batch = sa.batch(scene(elements, steps), arms, threads=threads)
    wrenches = np.zeros((arms, 6))
    wrenches[:, 0] = FORCE
    found, _ = rate(arms, batch.reset, lambda _: batch.step(ACTION, wrenches))
    return found, batch.positions[0, -1]


def of_elastica(elements, steps):
    """Actions a second of one rod with as many steps an action, and where its tip ends; no finite place if it is unstable."""
    import elastica as ea

    class Simulator(ea.BaseSystemCollection, ea.Constraints, ea.Forcing, ea.Damping):
        pass

    h, stepper = ACTION / steps, ea.PositionVerlet()

    def begin():
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
        return rod, simulator, 0.0

    def act(state):
        rod, simulator, now = state
        for _ in range(steps):
            now = stepper.step(simulator, now, h)
        return rod, simulator, now

    found, (rod, _, _) = rate(1, begin, act)
    return found, rod.position_collection[:, -1].copy()


def soromox_arm(strains):
    """The arm as one link of SoRoMoX with these of its strains (twist, two of bending, stretch, two of shear), along z by default."""
    import jax.numpy as jnp
    from soromox.systems import GVS, GVSSegment, JointSpec, LinkSpec, StrainBasisSpec

    link = LinkSpec.circular(
        length=LENGTH, radius=RADIUS, density=DENSITY, young_modulus=MODULUS, shear_modulus=MODULUS / 3.0, reference_strain=[0, 0, 0, 1, 0, 0]
    )
    basis = StrainBasisSpec(type="legendre", strain_selector=strains, basis_order=[0, 2, 2, 0, 0, 0])
    segment = GVSSegment(link=link, joint=JointSpec.fixed(), basis=basis, num_gauss_points=5)
    return GVS.from_segments([segment], gravity=jnp.zeros(3))


def of_soromox(strains, steps, arms, devices):
    """Actions a second of all arms with as many steps an action, and where a tip ends."""
    import jax
    import jax.numpy as jnp
    from jax.sharding import NamedSharding, PartitionSpec

    robot, h = soromox_arm(strains), ACTION / steps

    def acceleration(q, v, force):
        load = robot.jacobian_tips(q)[-1, 3:].T @ force
        # Damping in proportion to the mass, -VISCOUS M v, is this acceleration.
        return robot.forward_dynamics(0.0, jnp.concatenate([q, v]), (None, load))[q.size :] - VISCOUS * v

    def step(state, force):
        q, v = state
        v = v + h * acceleration(q, v, force)
        return q + h * v, v

    def action(state, force):
        return jax.lax.fori_loop(0, steps, lambda _, state: step(state, force), state)

    each = PartitionSpec("arms")
    mesh = jax.sharding.Mesh(np.array(jax.devices()[:devices]), ("arms",))
    act = jax.jit(jax.shard_map(jax.vmap(action), mesh=mesh, in_specs=(each, each), out_specs=each, check_vma=False))
    force, rest = jnp.array([FORCE, 0.0, 0.0]), jnp.zeros(robot.num_internal_dofs)
    earlier = -h / 2 * jax.jit(acceleration)(rest, rest, force)
    start, forces = jax.device_put(((jnp.tile(rest, (arms, 1)), jnp.tile(earlier, (arms, 1))), jnp.tile(force, (arms, 1))), NamedSharding(mesh, each))
    jax.block_until_ready(act(start, forces))
    found, state = rate(arms, lambda: start, lambda state: act(state, forces), jax.block_until_ready)
    return found, np.asarray(robot.forward_kinematics(np.asarray(state[0])[0], jnp.asarray(LENGTH)))[:3, 3]


def machine():
    """Processor and number of its threads."""
    cpus = Path("/proc/cpuinfo")
    lines = cpus.read_text(encoding="utf-8").splitlines() if cpus.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return f"{(names or [platform.machine()])[0]}, {os.cpu_count()} threads"


def main(arms=64):
    _, best = of_softarm(80, 1, 1)
    print(f"# Many arms\n\nPrinted by `python benches/batch.py`, whose first lines say how it is measured.\n\nMachine: {machine()}.\n")
    print("| program | elements | arms | threads | actions/s | error / length |\n|---|---|---|---|---|---|")

    def row(name, elements, n, threads, found):
        off = np.linalg.norm(found[1] - best) / LENGTH
        print(f"| {name} | {elements} | {n} | {threads} | {found[0]:.3g} | {off:.1e} |", flush=True)

    for steps in (None, STEPS[0]):
        for n, threads in ((1, 1), (arms, 1), (arms, 2)):
            name = "softarm" if steps is None else f"softarm, {steps} steps an action"
            row(name, 10, n, threads, of_softarm(10, n, threads, steps))
    rows_of_elastica(row)
    rows_of_soromox(row, arms)


def rows_of_elastica(row):
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


def rows_of_soromox(row, arms):
    try:
        import jax

        # JAX takes these before anything else uses it; SoRoMoX does so when it is imported.
        jax.config.update("jax_num_cpu_devices", 2)
        jax.config.update("jax_enable_x64", True)
        jax.config.update("jax_platforms", "cpu")
        import soromox  # noqa: F401
    except ImportError:
        print("skipped: SoRoMoX, not installed", file=sys.stderr)
        return
    for kind, n in (("bending", 1), ("bending", arms), ("all strains", arms)):
        strains, steps = SOROMOX[kind]
        row(f"SoRoMoX, {kind}, {steps} steps an action", 1, n, 2, of_soromox(strains, steps, n, 1 + (n % 2 == 0)))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
