#!/usr/bin/env python3
"""How often are the numbers of a fit within two of their standard errors?

    cargo build --release
    python3 benches/fit_errors.py [SEEDS] [--softarm PATH]

An arm that is let go is simulated with 1/64 of the automatic time step, and two of its markers are seen 50 times in half a second.
Modulus and internal damping are fitted to these places with normal noise of as many seeds. Of every number the program prints how often it is
within two standard errors of the truth (of normal numbers 95.4 of 100 are, with a binomial deviation of 2.1 of 100 for 100 seeds), the mean and
the mean square of its error over the standard error (0 and 1), and what is off without noise over the standard error: the bias of the time
step. The table stands in docs/fitting.md. Needs numpy.
"""

import argparse
import json
import os
import pathlib
import subprocess
import tempfile
from concurrent.futures import ThreadPoolExecutor

import numpy as np

SCENE = """
[rod]
length_m = 0.4
elements = 8
[rod.material]
youngs_modulus_pa = 8e5
poisson_ratio = 0.4
density_kg_m3 = 1050.0
[rod.section]
radius_m = 0.01
[rod.reference]
curvature_1_m = [0.0, 2.0, 0.0]
[gravity]
acceleration_m_s2 = [0.0, 0.0, -9.81]
[damping]
internal_s = 0.02
[time]
end_s = 0.5
"""
TRUTH = {"rod.material.youngs_modulus_pa": 8e5, "damping.internal_s": 0.02}
START = 1.1  # of the search, over the truth
TIMES = 50
FINER = 64  # the time step of the truth
SIGMAS = (1e-3, 5e-5)  # m
MARKERS = {"middle": 0.5, "tip": 1.0}


def run(softarm, folder, *words):
    done = subprocess.run([softarm, *map(str, words), "--json", "--quiet", "--threads", "1"], cwd=folder, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(done.stderr)
    return json.loads(done.stdout)


def places(softarm, folder):
    """Times, and places of the markers without noise."""
    usual = run(softarm, folder, "check", "arm.toml")["step_s"]
    run(softarm, folder, "simulate", "arm.toml", "--out", "truth", "--set", f"time.step_s={usual / FINER}")
    with np.load(folder / "truth" / "trajectory.npz") as motion:
        t, x = motion["t"], motion["x"]
    rows = np.unique(np.searchsorted(t, np.linspace(t[-1] / TIMES, t[-1] * (1 - 1e-9), TIMES)))
    return t[rows], {name: x[rows, round(at * (x.shape[1] - 1))] for name, at in MARKERS.items()}


def fitted(softarm, folder, name, t, seen, sigma):
    """Estimates and standard errors."""
    heads = ["t_s", *(f"{marker}_{axis}_m" for marker in seen for axis in "xyz")]
    np.savetxt(folder / f"{name}.csv", np.column_stack([t, *seen.values()]), delimiter=",", header=",".join(heads), comments="", fmt="%.17g")
    markers = "".join(f'[[marker]]\nname = "{marker}"\nat = {at}\n' for marker, at in MARKERS.items())
    (folder / f"{name}.toml").write_text(f'sigma_m = {sigma}\n{markers}[[recording]]\ncsv = "{name}.csv"\n')
    off = [word for key, value in TRUTH.items() for word in ("--set", f"{key}={START * value}")]
    found = run(softarm, folder, "fit", "arm.toml", "--data", f"{name}.toml", "--free", ",".join(TRUTH), "--out", name, "--small", *off)
    return np.array([[own["value"], own["standard_error"]] for own in found["parameters"]])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("seeds", nargs="?", type=int, default=100)
    parser.add_argument("--softarm", default="target/release/softarm")
    options = parser.parse_args()
    softarm = os.path.abspath(options.softarm)
    truth = np.array(list(TRUTH.values()))
    print(f"| integrator | noise, mm | number | within two of {options.seeds} | mean | mean square | bias |")
    print("|---|---|---|---|---|---|---|")
    for integrator in ("explicit", "implicit"):
        table(softarm, integrator, options.seeds, truth)


def table(softarm, integrator, seeds, truth):
    """Prints the rows of an integrator."""
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(2) as pool:
        folder = pathlib.Path(folder)
        (folder / "arm.toml").write_text(f'{SCENE}integrator = "{integrator}"\n')
        t, clean = places(softarm, folder)
        exact = fitted(softarm, folder, "exact", t, clean, SIGMAS[0])
        for sigma in SIGMAS:

            def one(seed):
                noise = np.random.default_rng(seed)
                seen = {name: x + sigma * noise.standard_normal(x.shape) for name, x in clean.items()}
                return fitted(softarm, folder, f"seed{seed}", t, seen, sigma)

            found = np.array(list(pool.map(one, range(seeds))))
            off = (found[:, :, 0] - truth) / found[:, :, 1]
            bias = (exact[:, 0] - truth) / found[:, :, 1].mean(axis=0)
            for i, key in enumerate(TRUTH):
                within = int((np.abs(off[:, i]) <= 2.0).sum())
                numbers = f"{within} | {off[:, i].mean():.2f} | {(off[:, i] ** 2).mean():.2f} | {bias[i]:.2g}"
                print(f"| {integrator} | {1e3 * sigma:g} | `{key}` | {numbers} |", flush=True)


if __name__ == "__main__":
    main()
