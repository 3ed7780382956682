"""Compares Jacobian and Hessian of every full-space statement with central differences, on a small problem that has all features."""

from dataclasses import replace

import casadi as ca
import numpy as np

import full_space
from problems import PROBLEMS
from rod import Rod

STEP = 1e-6
TOLERANCE = 1e-7
"""Relative: rounding of a difference is 1e-16/STEP of the values, truncation STEP^2; curvature makes both ten to a hundred times larger."""


def largest_errors(program, random):
    _, functions = program.functions(triangular=False)
    w = 1e-2 * full_space.STATE_SCALE * random.normal(size=program.n)
    y, direction = random.normal(size=program.rows), full_space.STATE_SCALE * random.normal(size=program.n)

    def values(w):
        return np.array(functions["nlp_jac_g"](w, [])[0]).ravel()

    def slopes(w):
        return np.array(functions["nlp_hess_l"](w, [], 1.3, y)[0]).ravel()

    for function, matrix in (
        (values, functions["nlp_jac_g"](w, [])[1]),
        (slopes, functions["nlp_hess_l"](w, [], 1.3, y)[1]),
    ):
        product = np.array(ca.mtimes(matrix, direction)).ravel()
        difference = (function(w + STEP * direction) - function(w - STEP * direction)) / (2 * STEP)
        yield np.abs(product - difference).max() / np.abs(difference).max()


def main():
    full_space.STATE_SCALE = 1.0  # differences of equal quality for states and controls
    random = np.random.default_rng(0)
    features = {"orientation": (0.9, 0.1, 0.2, 0.1), "force_max": 3.0, "moment_max": 2.0, "sphere": (0.3, 0.1, 0.8, 0.2)}
    for strain in ("trapezoidal", "helical"):
        rod = Rod.circle(1.0, 0.05, 1e6, 0.5, 1000.0, 3, strain)
        problem = replace(PROBLEMS["soft-reach-2"], name="check", rod=rod, n_steps=20, end=0.04, **features)
        for name, (program, *_) in (
            ("configurations", full_space.configurations(problem)),
            ("stages", full_space.stages(problem)),
        ):
            jacobian, hessian = largest_errors(program, random)
            print(f"{strain}, {name}: Jacobian {jacobian:.1e}, Hessian {hessian:.1e}")
            assert jacobian < TOLERANCE and hessian < TOLERANCE


if __name__ == "__main__":
    main()
