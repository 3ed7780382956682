"""The optimal-control problem of a scene as arrays, for a solver of one's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _softarm


@dataclass(frozen=True)
class Component:
    """A component of the control: one number a coefficient."""

    name: str
    """Name of an actuator or of another control, or "force" (spatial frame) or "moment" (frame of the node)."""
    node: int | None
    """Node of a force or moment."""
    axis: int | None
    """Axis of a force or moment, 0 to 2."""
    unit: float
    """Value of a variable of 1, in N, N m or the unit of the effort."""
    rest: float = 0.0
    """Value of the control where its variable is 0, in the same unit: the pretension of a tendon, the displacement of a winch at rest."""


@dataclass(frozen=True)
class Quadratic:
    """Values and derivatives at a point, over the n variables: with a step d the model of the objective is `objective + gradient @ d +
    d @ hessian @ d / 2`, that of the constraints `constraints + jacobian @ d = 0`, and that of the inequalities
    `inequalities + inequality_jacobian @ d <= 0`.
    """

    objective: float
    gradient: np.ndarray
    """(n,)"""
    gauss_newton: np.ndarray
    """(n, n), positive semidefinite: the objective's Hessian without second derivatives of the motion."""
    constraints: np.ndarray
    """(m,)"""
    jacobian: np.ndarray
    """(m, n)"""
    rows: list[int]
    """Numbers of the inequalities that were linearized."""
    inequalities: np.ndarray
    """(len(rows),)"""
    inequality_jacobian: np.ndarray
    """(len(rows), n)"""
    curvature: np.ndarray | None = None
    """(n, n): the exact Hessian of the Lagrangian minus `gauss_newton`; None without multipliers."""

    @property
    def hessian(self) -> np.ndarray:
        """The exact Hessian of the Lagrangian, where multipliers were given; else that of Gauss and Newton."""
        return self.gauss_newton if self.curvature is None else self.gauss_newton + self.curvature


@dataclass(frozen=True)
class Derivatives:
    """Derivatives of a solution along p numbers of its scene, for the same active bounds and limits."""

    variables: np.ndarray
    """Of the variables of the program, in its units, (n, p); NaN for residuals that a ball bounds together, whose basis may not be unique."""
    objective: np.ndarray
    """Of the least objective, (p,)."""
    x: np.ndarray
    """Of the positions of the motion, m, (N+1, K+1, 3, p)."""
    active: int
    """How many bounds and limits are active."""
    residual: float
    """Part of the objective's gradient that no multipliers balance: 0 at an optimum."""


class Program:
    """The discrete optimal-control problem of a scene, condensed to its variables: minimize the objective over `v` in the sets, subject
    to `constraints(v) = 0` and `inequalities(v) <= 0`, where the motion follows from `v` by simulation.

    The first `n_controls` variables are the coefficients of the control, each in its unit; the others are the residuals of goals that are
    soft or within a tolerance. All values are those of the solver of `Scene.solve`, which keeps the motion as an unknown of its own.
    """

    def __init__(self, native: _softarm.Program, scene: Any):
        self._native, self.scene = native, scene

    @property
    def n_variables(self) -> int:
        return self._native.n_variables

    @property
    def n_controls(self) -> int:
        return self._native.n_controls

    @property
    def times(self) -> np.ndarray:
        """Times of the motion, s, (N+1,)."""
        return self._native.times

    @property
    def blocks(self) -> np.ndarray:
        """Starts of the blocks of the control, and the end, s."""
        return self._native.blocks

    @property
    def components(self) -> list[Component]:
        """The c components of a coefficient: variable `i + c j` is coefficient `j` of component `i`."""
        return [
            Component(name, None if axis is None else axis // 3, None if axis is None else axis % 3, unit, rest)
            for name, axis, unit, rest in self._native.components
        ]

    @property
    def sets(self) -> list[dict[str, Any]]:
        """The sets of the variables. `rows` has rows of a matrix M as lists of (variable, factor); of an "interval" and a "half-space"
        `lower <= M v <= upper`, without `lower` for the latter, and of a "ball" `|M v| <= upper`.
        """
        return self._native.sets

    def guess(self) -> np.ndarray:
        """Returns the variables with which a solve begins at first."""
        return self._native.guess()

    def rollout(self, variables: npt.ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Returns the motion: positions (N+1, K+1, 3) in m and rotations (N+1, K+1, 3, 3), body to space."""
        return self._native.rollout(variables)

    def evaluate(self, variables: npt.ArrayLike) -> tuple[float, np.ndarray, np.ndarray]:
        """Returns the objective, the constraints and all inequalities, the latter two scaled as in the solver."""
        return self._native.evaluate(variables)

    def linearize(
        self,
        variables: npt.ArrayLike,
        constraint_multipliers: npt.ArrayLike | None = None,
        inequality_multipliers: npt.ArrayLike | None = None,
        rows: list[int] | None = None,
    ) -> Quadratic:
        """Returns values and derivatives, analytic and condensed: the quadratic subproblem of the solver. `rows` are the inequalities that
        are linearized, by default those near their limits. With multipliers the exact Hessian comes too.
        """
        return Quadratic(**self._native.linearize(variables, constraint_multipliers, inequality_multipliers, rows))

    def sensitivity(self, variables: npt.ArrayLike, change: npt.ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Returns the derivative of the motion along a change of the variables: of the positions in m, spatial, and of the rotations as
        vectors `z` with `dR = R hat(z)`, (N+1, K+1, 3) each.
        """
        return self._native.sensitivity(variables, change)

    def transitions(self, variables: npt.ArrayLike) -> list[tuple[np.ndarray, np.ndarray]]:
        """Returns the linearized motion `dx_next = A dx + B du` over every block of the control.

        `dx` has `(dx, z, dp, dl)` of every node that can move, twelve numbers: position in m, rotation in the frame of the node, momentum
        in kg m/s and angular momentum in the frame of the node, in kg m^2/s, those of the discrete Legendre transform. `du` are the
        components, constant over the block, in N, N m or the unit of the effort.
        """
        return self._native.transitions(variables)

    def solution(self, result: Any) -> np.ndarray:
        """Returns the variables of the solution of a result, whose scene the program is of."""
        variables = self._native.solution(str(result.directory))
        soft = slice(self.n_controls, None)
        local = self.linearize(variables)
        # The residuals of soft goals are those of the motion; the constraints are linear in them.
        variables[soft] -= np.linalg.lstsq(local.jacobian[:, soft], local.constraints, rcond=None)[0]
        return variables

    def _scale(self, other: Program) -> np.ndarray:
        """Returns by what the variables of this program are multiplied to be those of another one with other units of its controls."""
        names = [[(own.name, own.node, own.axis) for own in program.components] for program in (self, other)]
        if other.n_variables != self.n_variables or names[0] != names[1]:
            raise ValueError("the number changes the size of the program, along which there is no derivative")
        units = [np.array([own.unit for own in program.components]) for program in (self, other)]
        out = np.ones(self.n_variables)
        out[: self.n_controls] = np.tile(units[0] / units[1], self.n_controls // len(units[0]))
        return out

    def derivatives(self, variables: npt.ArrayLike, keys: Sequence[str]) -> Derivatives:
        """Returns the derivatives of a solution along numbers of the scene, by their dotted keys.

        The conditions of optimality, with the bounds and limits that are active, define the solution as a function of the numbers; their matrix is
        the exact one of Newton's method. How they change along a number at the solution is a central difference of the analytic gradients of
        two programs. The numbers are those of the scene of the program, of which nothing else changes. At the point where a bound is
        about to become active, or no longer, there are derivatives to one side alone, and these are those of the bounds that are active.

        Raises `ValueError` for variables that are no solution, and for numbers that change the size of the program.
        """
        v = np.array(variables, float)
        inequalities, sets = self.evaluate(v)[2], self.sets
        near = [i for i, value in enumerate(inequalities) if value > -_ACTIVE]
        raw = self.linearize(v, rows=near)
        together = _Together.of(raw, self.n_controls, sets)
        left = np.setdiff1d(np.arange(len(v)), [i for ball in together for i in ball.residuals])
        local = _reduced(raw, v, together, left, _others(raw, together))
        places = [i for i, own in enumerate(sets) if all(ball.place != i for ball in together) and _Bound(own).slack(v) < _ACTIVE]
        bounds = [_Bound(sets[i]) for i in places]
        normals = np.array([own.normal(v)[left] for own in bounds]).reshape(len(bounds), len(left))
        rows = np.vstack([local.jacobian, local.inequality_jacobian, normals])
        # The rows are those of the constraints, then of the limits, then of the balls, then of the bounds.
        m, first = len(local.constraints), len(local.constraints) + len(near)
        last = first + len(together)
        free = {*range(m), *(last + j for j, own in enumerate(bounds) if own.is_equality)}
        slack = {first + j for j in range(len(together)) if local.inequalities[len(near) + j] < -_ACTIVE}
        kept, multipliers = _balanced(rows, local.gradient, free, slack)
        residual = np.abs(local.gradient + rows.T @ multipliers).max() / max(np.abs(local.gradient).max(), 1e-300)
        if not (residual < _RESIDUAL and np.abs(raw.constraints).max(initial=0.0) < _RESIDUAL):
            raise ValueError(
                f"the variables are no solution: {residual:.1e} of the gradient is not balanced; solve with a smaller solver.tolerance"
            )
        taut, full = [i for i in kept if m <= i < first], [i for i in kept if first <= i < last]
        held = [i for i in kept if i >= last]
        limits, held_places = [near[i - m] for i in taut], [places[i - last] for i in held]
        active_rows = [*range(m), *taut, *full, *held]
        weights = multipliers[active_rows]

        def conditions(program: Program) -> tuple[np.ndarray | float, ...]:
            """The gradient of the Lagrangian, the active conditions, the Lagrangian, and the positions of the motion."""
            scale, others = self._scale(program), program.sets
            at = v * scale
            raw = program.linearize(at, rows=limits)
            scaled = replace(
                raw, gradient=raw.gradient * scale, jacobian=raw.jacobian * scale, inequality_jacobian=raw.inequality_jacobian * scale
            )
            balls = [replace(together[i - first], upper=float(others[together[i - first].place]["upper"])) for i in full]
            own = _reduced(scaled, v, balls, left, _others(raw, together))
            slopes = np.vstack([own.jacobian, own.inequality_jacobian])
            active = np.concatenate([own.constraints, own.inequalities, [_Bound(others[i]).value(at) for i in held_places]])
            return own.gradient + weights[: len(slopes)] @ slopes, active, own.objective + weights @ active, program.rollout(at)[0]

        of_constraints, of_limits = np.zeros(len(raw.constraints)), np.zeros(len(inequalities))
        of_constraints[_others(raw, together)] = multipliers[:m]
        of_limits[near] = multipliers[m:first]
        for i in full:
            of_constraints[together[i - first].rows] = multipliers[i] * together[i - first].weights(raw, v)
        hessian = self.linearize(v, of_constraints, of_limits, rows=limits).hessian
        for i in held:
            hessian = hessian + multipliers[i] * bounds[i - last].curvature(len(v))
        hessian = hessian[np.ix_(left, left)]
        for i in full:
            hessian = hessian + multipliers[i] * together[i - first].curvature(raw, left)
        size = len(active_rows)
        matrix = np.block([[hessian, rows[active_rows].T], [rows[active_rows], np.zeros((size, size))]])
        slopes: list[list[Any]] = []
        for key in keys:
            value = self.scene[key]
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise ValueError(f"{key} is no number of this scene")
            half = 1e-5 * (abs(value) or 1.0)
            ahead, behind = (conditions(self.scene.replace({key: value + side}).program()) for side in (half, -half))
            slopes.append([(more - less) / (2 * half) for more, less in zip(ahead, behind)])
        gradients, active, objective, moved = (np.stack(own, axis=-1) for own in zip(*slopes))
        columns = np.zeros((len(v), len(keys)))
        columns[left] = np.linalg.lstsq(matrix, -np.concatenate([gradients, active]), rcond=None)[0][: len(left)]
        moved += np.stack([self.sensitivity(v, column)[0] for column in columns.T], axis=-1)
        columns[[i for ball in together for i in ball.residuals]] = np.nan
        return Derivatives(columns, objective, moved, len(held) + len(full) + len(taut), float(residual))


@dataclass(frozen=True)
class _Together:
    """Residuals `r` that a ball bounds, of constraints `c(u) + s r = 0`: for the other variables, `|c(u)|^2 / s^2 <= upper^2`.

    The basis of the motions of an arm that stays is not unique, and another program may have another one; the norm is the same in all.
    """

    place: int
    """Number of the set."""
    residuals: list[int]
    rows: list[int]
    slope: float
    upper: float

    @staticmethod
    def of(local: Quadratic, n_controls: int, sets: list[dict[str, Any]]) -> list[_Together]:
        """Returns the balls of residuals that cost nothing."""
        out = []
        for place, ball in enumerate(sets):
            residuals = [row[0][0] for row in ball["rows"]]
            if ball["kind"] != "ball" or min(residuals) < n_controls or np.any(local.gradient[residuals]):
                continue
            rows = [int(np.abs(local.jacobian[:, i]).argmax()) for i in residuals]
            slopes = np.array([local.jacobian[row, i] for row, i in zip(rows, residuals)])
            if len(set(rows)) == len(rows) and np.ptp(slopes) <= 1e-9 * np.abs(slopes).max():
                out.append(_Together(place, residuals, rows, float(slopes[0]), float(ball["upper"])))
        return out

    def _left(self, local: Quadratic, v: np.ndarray) -> np.ndarray:
        """Returns `c(u)`."""
        return local.constraints[self.rows] - self.slope * v[self.residuals]

    def value(self, local: Quadratic, v: np.ndarray) -> float:
        """Returns half of `|c|^2 / (s upper)^2 - 1`, at most 0."""
        c = self._left(local, v)
        return 0.5 * float(c @ c / (self.slope * self.upper) ** 2 - 1.0)

    def weights(self, local: Quadratic, v: np.ndarray) -> np.ndarray:
        """Returns the derivative of the value along `c`."""
        return self._left(local, v) / (self.slope * self.upper) ** 2

    def curvature(self, local: Quadratic, left: np.ndarray) -> np.ndarray:
        """Returns the second derivative along the variables that are `left`, without that of `c`."""
        along = local.jacobian[np.ix_(np.array(self.rows), left)] / (self.slope * self.upper)
        return along.T @ along


def _others(local: Quadratic, together: list[_Together]) -> np.ndarray:
    """Returns the numbers of the constraints that no ball replaces."""
    return np.setdiff1d(np.arange(len(local.constraints)), [row for ball in together for row in ball.rows])


def _reduced(local: Quadratic, v: np.ndarray, balls: list[_Together], left: np.ndarray, others: np.ndarray) -> Quadratic:
    """Returns values and derivatives over the variables that are `left`, with these other constraints; the last inequalities are those of balls."""
    jacobian = local.jacobian[:, left]
    values = [ball.value(local, v) for ball in balls]
    slopes = [ball.weights(local, v) @ jacobian[ball.rows] for ball in balls]
    return replace(
        local,
        gradient=local.gradient[left],
        constraints=local.constraints[others],
        jacobian=jacobian[others],
        inequalities=np.concatenate([local.inequalities, values]),
        inequality_jacobian=np.vstack([local.inequality_jacobian[:, left], *slopes]),
    )


def _balanced(rows: np.ndarray, gradient: np.ndarray, free: set[int], slack: set[int]) -> tuple[list[int], np.ndarray]:
    """Returns multipliers of the rows of conditions that balance a gradient, and the conditions that are kept for it: not those that are
    slack, and the multipliers of those that are not free are not negative.
    """
    kept = [i for i in range(len(rows)) if i not in slack]
    while True:
        found = np.linalg.lstsq(rows[kept].T, -gradient, rcond=None)[0]
        low = [(value, i) for value, i in zip(found, kept) if i not in free and value <= 0.0]
        if not low:
            break
        kept.remove(min(low)[1])
    multipliers = np.zeros(len(rows))
    multipliers[kept] = found
    return kept, multipliers


_ACTIVE = 1e-6
"""Distance from a bound or limit, in its scale, below which it may be active: where its multiplier is positive."""
_RESIDUAL = 1e-3
"""Largest part of a gradient that is not balanced at a solution."""


class _Bound:
    """A set of the variables as a constraint `value <= 0`."""

    def __init__(self, own: dict[str, Any]):
        self.own = own

    @property
    def is_equality(self) -> bool:
        """Tells whether it fixes what it bounds, as the controls of an arm that stays."""
        own = self.own
        return own["kind"] == "interval" and own["upper"] - own["lower"] <= 1e-9 * max(abs(own["upper"]), 1.0)

    def _product(self, v: np.ndarray) -> np.ndarray:
        return np.array([sum(factor * v[i] for i, factor in row) for row in self.own["rows"]])

    def _is_low(self, v: np.ndarray) -> bool:
        """Tells whether an interval is nearer to its lower end."""
        own, at = self.own, self._product(v)[0]
        return own["kind"] == "interval" and not self.is_equality and at - own["lower"] < own["upper"] - at

    def value(self, v: np.ndarray) -> float:
        own, at = self.own, self._product(v)
        if own["kind"] == "ball":
            return 0.5 * float(at @ at - own["upper"] ** 2)
        return float(own["lower"] - at[0] if self._is_low(v) else at[0] - own["upper"])

    def slack(self, v: np.ndarray) -> float:
        own, at = self.own, self._product(v)
        if own["kind"] == "ball":
            return float(own["upper"] - np.sqrt(at @ at)) / max(own["upper"], 1e-300)
        return -self.value(v) / max(abs(own["upper"]), 1.0) if np.isfinite(self.value(v)) else np.inf

    def normal(self, v: np.ndarray) -> np.ndarray:
        out, own = np.zeros(len(v)), self.own
        weights = self._product(v) if own["kind"] == "ball" else [-1.0 if self._is_low(v) else 1.0]
        for weight, row in zip(weights, own["rows"]):
            for i, factor in row:
                out[i] += weight * factor
        return out

    def curvature(self, n: int) -> np.ndarray:
        out = np.zeros((n, n))
        if self.own["kind"] == "ball":
            for row in self.own["rows"]:
                for i, a in row:
                    for j, b in row:
                        out[i, j] += a * b
        return out
