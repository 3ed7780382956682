"""Single shooting: a Gauss-Newton SQP over the controls alone.

The subproblem is min 1/2 |U + dU|^2 (effort, exact) subject to the linearized goal and the linearized norm bounds, whose own curvature
is kept in the Hessian with their multipliers. The goal has 9 or 12 rows, so its Jacobian is cheapest backwards: one adjoint row per
goal, by the Jacobian of every step (compiled) and CasADi's mapaccum. l1 merit with one second-order correction.
"""

import time

import casadi as ca
import numpy as np

import rod as discrete
from compiled import compiled
from start import NEARLY_REST, static_path


class Shooting:
    """Goal residuals and their Jacobian as functions of the scaled controls [6 M]."""

    def __init__(self, problem):
        rod, h, N, M = problem.rod, problem.step, problem.n_steps, problem.n_blocks
        n_state, per, n_goals = 12 * rod.n_elements, problem.steps_per_block, problem.n_goals
        tag = f"{rod.strain}_{rod.n_elements}"
        z, u = ca.SX.sym("z", n_state), ca.SX.sym("u", 6)
        value = discrete.step(rod, h)(z, problem.scales * u)
        residual = discrete.goal(rod, h, problem.position, problem.orientation)(z)
        step, seconds = compiled(ca.Function(f"shoot_{tag}", [z, u], [value]))
        slopes, more = compiled(ca.Function(f"slopes_{tag}", [z, u], [ca.jacobian(value, z), ca.jacobian(value, u)]))
        self.end = ca.Function("end", [z], [residual, ca.jacobian(residual, z)])
        self.compile_seconds = seconds + more
        self.initial = discrete.initial_state(rod, h)
        self.roll = step.mapaccum(N)
        row, state, control = ca.MX.sym("row", n_goals, n_state), ca.MX.sym("state", n_state), ca.MX.sym("control", 6)
        a, b = slopes(state, control)
        back = ca.Function("back", [row, state, control], [ca.mtimes(row, a), ca.mtimes(row, b)])
        self.back = back.mapaccum(N)
        self.n_goals, self.N, self.M, self.per = n_goals, N, M, per

    def simulate(self, scaled):
        """Time nodes 0..N in columns."""
        controls = np.repeat(scaled.reshape(self.M, 6).T, self.per, axis=1)
        return np.hstack([self.initial[:, None], np.array(self.roll(self.initial, controls))]), controls

    def residual(self, scaled):
        states, _ = self.simulate(scaled)
        return np.array(self.end(states[:, -1])[0]).ravel()

    def linearize(self, scaled):
        states, controls = self.simulate(scaled)
        residual, slope = self.end(states[:, -1])
        _, rows = self.back(slope, states[:, -2::-1], controls[:, ::-1])
        rows = np.array(rows).reshape(self.n_goals, self.N, 6)[:, ::-1]
        jacobian = rows.reshape(self.n_goals, self.M, self.per, 6).sum(2)
        return np.array(residual).ravel(), jacobian.reshape(self.n_goals, self.M * 6)


def solve(problem, max_iterations=500, tolerance=1e-6, feasibility=1e-8, verbose=False):
    """The same dictionary as the full-space solvers'."""
    shooting = Shooting(problem)
    n, weight = 6 * problem.n_blocks, problem.step * problem.steps_per_block
    blocks = np.arange(n).reshape(problem.n_blocks, 6)
    balls = [(indices, limit) for part, limit in problem.bounds for indices in blocks[:, part]]

    def bounds(u):
        """(|u|^2 - limit^2)/2 of every bound and its Jacobian."""
        values = np.array([(u[i] @ u[i] - r**2) / 2 for i, r in balls])
        jacobian = np.zeros((len(balls), n))
        for row, (i, _) in enumerate(balls):
            jacobian[row, i] = u[i]
        return values, jacobian

    n_rows = shooting.n_goals + len(balls)
    dense = {"h": ca.Sparsity.diag(n), "a": ca.Sparsity.dense(n_rows, n)}
    qp = ca.conic("qp", "qpoases", dense, {"printLevel": "none", "sparse": False, "error_on_fail": False})

    def subproblem(u, residual, jacobian, curvature):
        values, slopes = bounds(u)
        lower = np.concatenate([-residual, np.full(len(balls), -np.inf)])
        upper = np.concatenate([-residual, -values])
        a = np.vstack([jacobian, slopes])
        found = qp(h=ca.diag(ca.DM(weight + curvature)), g=weight * u, a=a, lba=lower, uba=upper, x0=np.zeros(n))
        return np.array(found["x"]).ravel(), np.array(found["lam_a"]).ravel(), qp.stats()["success"]

    def infeasibility(u, residual):
        return np.abs(residual).sum() + np.maximum(bounds(u)[0], 0).sum()

    def attempt(direction):
        """The point after the step, its residual, and whether the merit falls enough."""
        trial = u + direction
        trial_residual = shooting.residual(trial)
        value = weight / 2 * trial @ trial + penalty * infeasibility(trial, trial_residual)
        return trial, trial_residual, value <= merit + 1e-4 * slope + 1e-12 * abs(merit)

    damping = 0.0
    wall, cpu = time.perf_counter(), time.process_time()
    u, multipliers, penalty = static_path(problem, NEARLY_REST)[1].ravel(), np.zeros(n_rows), 1.0
    status, iterations = "iteration limit", 0
    residual, jacobian = shooting.linearize(u)
    for iterations in range(max_iterations + 1):
        values, slopes = bounds(u)
        gradient = weight * u + np.vstack([jacobian, slopes]).T @ multipliers
        complementarity = np.abs(multipliers[shooting.n_goals :] * values).max(initial=0)
        if max(np.abs(gradient).max(), complementarity) <= tolerance and infeasibility(u, residual) <= feasibility:
            status = "converged"
            break
        if iterations == max_iterations:
            break
        curvature = np.zeros(n)
        for (i, _), y in zip(balls, multipliers[shooting.n_goals :]):
            curvature[i] += max(y, 0)
        violation = infeasibility(u, residual)
        accepted = False
        while not accepted and damping < 1e6:
            # Beyond a damping of 10 the step toward the goal is shortened too.
            rest = max(0.0, 1 - 10 / damping) * residual if damping else 0 * residual
            direction, next_multipliers, solved = subproblem(u, residual - rest, jacobian, curvature + damping * weight)
            if solved:
                penalty = max(1.1 * np.abs(next_multipliers).max(), 0.5 * penalty)
                merit = weight / 2 * u @ u + penalty * violation
                slope = weight * u @ direction - penalty * (violation - np.abs(rest).sum())
                trial, trial_residual, accepted = attempt(direction)
                if not accepted and np.isfinite(trial_residual).all():
                    # Second-order correction: the trial's residual in the same linearization.
                    shifted = trial_residual - jacobian @ direction - rest
                    correction, _, solved = subproblem(u, shifted, jacobian, curvature + damping * weight)
                    trial, trial_residual, accepted = attempt(correction)
            if not accepted:
                damping = max(3 * damping, 0.5)
        if not accepted:
            status = "no decrease"
            break
        if verbose:
            print(iterations, weight / 2 * u @ u, violation, np.abs(gradient).max(), damping, penalty, flush=True)
        u, multipliers = trial, next_multipliers
        damping = damping / 2 if damping > 0.1 else 0.0
        residual, jacobian = shooting.linearize(u)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    return {
        "u": u.reshape(-1, 6) * problem.scales,
        "success": status == "converged",
        "status": status,
        "iterations": iterations,
        "wall_s": wall,
        "cpu_s": cpu,
        "compile_s": shooting.compile_seconds,
    }
