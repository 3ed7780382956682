"""How many actions a second do the environments of softarm.gym take?

    pip install ".[gym]"
    python benches/environments.py [ARMS]

The table of docs/learning.md, under random actions: processor time for an action, of one environment, of a vector, and of its model alone, the
least of five runs; and actions a second of the vector with one thread and with two, which mean something on a machine that does nothing else.
"""

import sys
import time

import numpy as np

from softarm.environments import TASKS
from softarm.gym import ArmEnv, ArmVectorEnv

CALLS, RUNS = 100, 5  # no episode ends within a run


def measured(begin, step):
    """Least processor time and least time by the clock of a call, s."""
    least = [np.inf, np.inf]
    for _ in range(RUNS):
        begin()
        step(0)
        starts = time.process_time(), time.perf_counter()
        for call in range(1, CALLS):
            step(call)
        ends = time.process_time(), time.perf_counter()
        least = [min(old, (end - start) / (CALLS - 1)) for old, start, end in zip(least, starts, ends)]
    return least


def main(arms=64):
    print(f"| environment | one arm, µs | {arms} arms, µs | of it the model | actions/s, 1 thread | actions/s, 2 threads |")
    print("|---|---|---|---|---|---|")
    for name in TASKS:
        single = ArmEnv(name)
        actions = np.random.default_rng(0).uniform(-1.0, 1.0, (CALLS, arms, len(single.task.low))) * single.task.high
        one, _ = measured(lambda: single.reset(seed=0), lambda call: single.step(actions[call, 0]))
        many, model, rates = 0.0, 0.0, []
        for threads in (1, 2):
            envs = ArmVectorEnv(name, arms, threads=threads)
            spent, clock = measured(lambda: envs.reset(seed=0), lambda call: envs.step(actions[call]))
            rates.append(f"{arms / clock:.0f}")
            if threads == 1:
                many, task, own = spent / arms, envs.task, envs.arms

                def move(call):
                    own.efforts, wrenches = task.commands(actions[call], own.efforts)
                    own.batch.step(task.period, wrenches, own.efforts if task.n_efforts else None)

                model = measured(lambda: envs.reset(seed=0), move)[0] / arms
        print(f"| `{name}` | {1e6 * one:.0f} | {1e6 * many:.1f} | {1e6 * model:.1f} | " + " | ".join(rates) + " |", flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
