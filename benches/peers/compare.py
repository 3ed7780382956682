"""Solves the same problems by softarm and by its peers, checks that they are the same, and prints a table.

    python compare.py --softarm ../../target/release/softarm

One thread each (`softarm`: two), one solve at a time, every solve in a process of its own.
"""

import argparse
import csv
import functools
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[variable] = "1"

import casadi as ca  # noqa: E402
import numpy as np  # noqa: E402

import full_space  # noqa: E402
import rod as discrete  # noqa: E402
import shooting  # noqa: E402
from problems import PROBLEMS  # noqa: E402

SAME_MODEL = 1e-9
"""Largest difference of softarm's trajectory from the same controls replayed in CasADi, m and 1."""
SAME_MINIMUM = 1e-4
"""Relative difference of objectives."""
HIT = 1e-5
"""Largest scaled residual of the goal at the end of a replay."""

PEERS = {
    "ipopt": full_space.solve_configurations,
    "ipopt-rest": functools.partial(full_space.solve_configurations, from_rest=True),
    "fatrop": full_space.solve_stages,
    "gn-sqp": shooting.solve,
}
SOFTARM = {"softarm": ("rest", 2), "softarm-1": ("rest", 1), "softarm-static": ("static", 1)}
"""First guess and threads; the first are its defaults on two cores."""
SOLVER_CALL = ("linearize", "condense", "qp", "globalize")
"""Phases of softarm that a peer's solver has as well: no first guess, no check, no gains, no files."""
FATROP_ELEMENTS = 2
"""By default fatrop is left out of problems with more elements, which it did not solve."""
LONG = 5.0
"""Seconds of wall time beyond which one run is enough."""


def replay(problem, controls):
    """Configurations [N + 1, K, 6] and goal residuals under the controls [M, 6], by CasADi's own evaluation of the step."""
    step = discrete.step(problem.rod, problem.step).mapaccum(problem.n_steps)
    initial = discrete.initial_state(problem.rod, problem.step)
    states = np.array(step(initial, np.repeat(controls.T, problem.steps_per_block, axis=1)))
    states = np.hstack([initial[:, None], states]).T
    goal = discrete.goal(problem.rod, problem.step, problem.position, problem.orientation)
    K = problem.rod.n_elements
    return states[:, : 6 * K].reshape(-1, K, 6), np.array(goal(states[-1])).ravel()


def softarm(problem, binary, variant, limit):
    """One run of the program, timed from outside."""
    guess, threads = variant
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        command = [binary, "solve", str(problem.scene), "--set", f"solver.guess={guess}"]
        command += ["--json", "--quiet", "--threads", str(threads), "--out", str(out)]
        before, wall = os.times(), time.perf_counter()
        try:
            run = subprocess.run(command, capture_output=True, text=True, timeout=limit)
        except subprocess.TimeoutExpired:
            return {"success": False, "status": f"not in {limit:.0f} s", "iterations": -1, "wall_s": limit, "cpu_s": limit}
        wall, after = time.perf_counter() - wall, os.times()
        if run.returncode not in (0, 3, 4, 7):
            return {"success": False, "status": run.stderr.strip().splitlines()[-1], "iterations": 0, "wall_s": wall, "cpu_s": wall}
        summary = json.loads(run.stdout)
        assert summary["steps"] == problem.n_steps, f"softarm takes {summary['steps']} steps, not {problem.n_steps}"
        with open(out / "controls.csv", newline="") as file:
            rows = list(csv.DictReader(file))
        names = [f"tip {part} {axis} ({unit})" for part, unit in (("force", "N"), ("moment", "N m")) for axis in "xyz"]
        controls = np.array([[float(row.get(name, 0.0)) for name in names] for row in rows])
        trajectory = np.load(out / "trajectory.npz")
        c, _ = replay(problem, controls)
        positions = np.abs(c[..., :3] - trajectory["x"][:, 1:]).max()
        rotations = np.abs(discrete.matrices(c[..., 3:]) - trajectory["R"][:, 1:]).max()
        phases = summary["phases_s"]
        return {
            "success": summary["status"] == "converged",
            "status": summary["status"],
            "iterations": summary["iterations"],
            "wall_s": wall,
            "cpu_s": after.children_user + after.children_system - before.children_user - before.children_system,
            "call_s": sum(phases[phase] for phase in SOLVER_CALL),
            "objective": summary["objective"],
            "model_difference": float(max(positions, rotations)),
            "verdict": (summary["check"] or {}).get("verdict"),
            "u": controls.tolist(),
        }


def peer(problem, name, limit):
    """One run in a process of its own."""
    command = [sys.executable, __file__, "--one", name, problem.name]
    begin = time.perf_counter()
    try:
        run = subprocess.run(command, capture_output=True, text=True, timeout=limit)
    except subprocess.TimeoutExpired:
        wall = time.perf_counter() - begin
        return {"success": False, "status": f"not in {limit:.0f} s", "iterations": -1, "wall_s": wall, "cpu_s": wall}
    lines = [line for line in run.stdout.splitlines() if line.startswith("RESULT ")]
    if not lines:
        error = (run.stderr.strip().splitlines() or [f"exit code {run.returncode}"])[-1]
        return {"success": False, "status": error[:100], "iterations": -1, "wall_s": float("nan"), "cpu_s": float("nan")}
    return json.loads(lines[-1].removeprefix("RESULT "))


def one(name, problem):
    """In the child: solves and prints the answer as JSON."""
    found = PEERS[name](problem)
    found["call_s"] = found["wall_s"]
    found.pop("w", None)
    found["u"] = np.asarray(found["u"]).tolist()
    print("RESULT " + json.dumps(found), flush=True)


def measure(name, problem, arguments):
    """Median of `repeat` runs, or one run where it takes long."""
    runs = []
    for _ in range(arguments.repeat):
        if name in SOFTARM:
            runs.append(softarm(problem, arguments.softarm, SOFTARM[name], arguments.limit))
        else:
            runs.append(peer(problem, name, arguments.limit))
        if not runs[-1]["wall_s"] < LONG:
            break
    found = runs[0]
    for key in ("wall_s", "cpu_s", "call_s"):
        found[key] = statistics.median(run.get(key, float("nan")) for run in runs)
    found["runs"] = len(runs)
    if "u" in found:
        controls = np.array(found["u"])
        found["objective"] = problem.objective(controls)
        found["goal"] = float(np.abs(replay(problem, controls)[1]).max())
    return found


def remark(found, reference):
    if not found["success"]:
        off = f", objective off by {found['objective'] / reference - 1:.1e}" if "objective" in found and reference else ""
        return f"{found['status']}{off}"
    notes = []
    if found["goal"] > HIT:
        notes.append(f"replay misses the goal by {found['goal']:.0e}")
    if reference and abs(found["objective"] / reference - 1) > SAME_MINIMUM:
        notes.append("another minimum")
    if found.get("model_difference", 0) > SAME_MODEL:
        notes.append(f"MODELS DIFFER by {found['model_difference']:.0e}")
    return ", ".join(notes)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    binary = Path(__file__).resolve().parents[2] / "target" / "release" / "softarm"
    parser.add_argument("--softarm", default=str(binary), help="path of the program")
    parser.add_argument("--problems", nargs="+", default=list(PROBLEMS), choices=PROBLEMS, metavar="NAME")
    parser.add_argument("--solvers", nargs="+", choices=[*SOFTARM, *PEERS], metavar="NAME")
    parser.add_argument("--repeat", type=int, default=3, help=f"runs of what takes less than {LONG:.0f} s")
    parser.add_argument("--limit", type=float, default=200.0, help="seconds for one process, compilation included")
    parser.add_argument("--json", help="file for all results")
    parser.add_argument("--one", nargs=2, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        one(arguments.one[0], PROBLEMS[arguments.one[1]])
        return
    print(f"{platform.processor() or platform.machine()}, Python {platform.python_version()}, CasADi {ca.__version__}")
    print(f"load when started: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores\n")
    print("| problem | solver | iterations | wall s | CPU s | solver's call s | ratio | objective | replay | remark |")
    print("|---|---|---|---|---|---|---|---|---|---|", flush=True)
    results = {}
    for problem in (PROBLEMS[name] for name in arguments.problems):
        reference = None
        affordable = [name for name in [*SOFTARM, *PEERS] if name != "fatrop" or problem.rod.n_elements <= FATROP_ELEMENTS]
        for name in arguments.solvers or affordable:
            found = measure(name, problem, arguments)
            results.setdefault(problem.name, {})[name] = found
            if reference is None and found["success"]:
                reference = found
            ratio = found["call_s"] / reference["call_s"] if reference else float("nan")
            cells = [problem.name, name, f"{found['iterations']}", f"{found['wall_s']:.2f}", f"{found['cpu_s']:.2f}"]
            cells += [f"{found['call_s']:.3f}", f"{ratio:.1f}"]
            cells += [f"{found[key]:{form}}" if key in found else "" for key, form in (("objective", ".6f"), ("goal", ".0e"))]
            cells.append(remark(found, reference and reference["objective"]))
            print("| " + " | ".join(cells) + " |", flush=True)
    if arguments.json:
        Path(arguments.json).write_text(json.dumps(results, indent=1))
    differing = [
        (problem, name)
        for problem, found in results.items()
        for name, run in found.items()
        if run["success"] and (run.get("model_difference", 0) > SAME_MODEL or run["goal"] > HIT)
    ]
    if differing:
        sys.exit(f"not the same problem, or goal missed: {differing}")


if __name__ == "__main__":
    main()
