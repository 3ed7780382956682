"""The optimal-control problem of a scene as arrays, for a solver of one's own."""

from __future__ import annotations

from dataclasses import dataclass
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


class Program:
    """The discrete optimal-control problem of a scene, condensed to its variables: minimize the objective over `v` in the sets, subject
    to `constraints(v) = 0` and `inequalities(v) <= 0`, where the motion follows from `v` by simulation.

    The first `n_controls` variables are the coefficients of the control, each in its unit; the others are the residuals of goals that are
    soft or within a tolerance. All values are those of the solver of `Scene.solve`, which keeps the motion as an unknown of its own.
    """

    def __init__(self, native: _softarm.Program):
        self._native = native

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
