"""Four simulations by two processes of joblib: `pip install . joblib`."""

from joblib import Parallel, delayed

import softarm as sa

if __name__ == "__main__":
    tasks = [{"verb": "simulate", "scene": "swing", "set": {"rod.elements": n, "time.end_s": 0.2}} for n in (4, 6, 8, 10)]
    for task, done in zip(tasks, Parallel(n_jobs=2)(delayed(sa.run)(task) for task in tasks)):
        print(f"{task['set']['rod.elements']} elements: tip at {done['summary']['tip']['position_m']} m")
