"""The discrete rod of `softarm` in CasADi: standard model, explicit step, clamped base, no damping.

Nodes 0..K, node 0 held at the origin with the identity rotation, the arm at rest along +z. A configuration of the free nodes is
(x_1, s_1, ..., x_K, s_K): positions in m and modified Rodrigues parameters s = tan(angle/4) axis (body to space), three numbers that
are regular below a full turn. The wrench u = (force, moment) acts on the tip: force in space, moment in the tip's frame.
Formulas: the project's own, restated here from the discrete action, so that agreement with `softarm` means something.
"""

from dataclasses import dataclass
from math import comb, pi, sqrt

import casadi as ca
import numpy as np


@dataclass(frozen=True)
class Rod:
    """A uniform straight rod; stiffness and inertia of its section in SI units."""

    length: float
    n_elements: int
    ea: float
    ga: float
    ei: float
    gj: float
    mass: float
    """kg/m"""
    rotary: tuple
    """kg m, the first two equal: about the transverse axes, then about the rod's own"""
    strain: str
    """"trapezoidal" or "helical\""""

    @property
    def element_length(self):
        return self.length / self.n_elements

    @property
    def share(self):
        """Length lumped on nodes 1..K, m."""
        share = np.full(self.n_elements, self.element_length)
        share[-1] /= 2
        return share

    @property
    def tip_inertia(self):
        """Mass three times, then moments of inertia of the tip node, kg and kg m^2."""
        return np.array([self.mass] * 3 + list(self.rotary)) * self.share[-1]

    @property
    def time_scale(self):
        """L^2 sqrt(rhoA / EI), s."""
        return self.length**2 * sqrt(self.mass / self.ei)

    @staticmethod
    def circle(length, radius, youngs, poisson, density, n_elements, strain):
        shear = youngs / (2 * (1 + poisson))
        area, second = pi * radius**2, pi * radius**4 / 4
        rotary = (density * second, density * second, 2 * density * second)
        return Rod(length, n_elements, youngs * area, shear * area, youngs * second, 2 * shear * second, density * area, rotary, strain)


def product(p, q):
    """Of quaternions, scalar first."""
    return ca.vertcat(p[0] * q[0] - ca.dot(p[1:], q[1:]), p[0] * q[1:] + q[0] * p[1:] + ca.cross(p[1:], q[1:]))


def conjugate(q):
    return ca.vertcat(q[0], -q[1:])


def rotate(q, v):
    """R(q) v of a unit quaternion."""
    t = 2 * ca.cross(q[1:], v)
    return v + q[0] * t + ca.cross(q[1:], t)


def quaternion(s):
    """Unit quaternion of modified Rodrigues parameters."""
    n = ca.dot(s, s)
    return ca.vertcat(1 - n, 2 * s) / (1 + n)


def rodrigues(q):
    """Modified Rodrigues parameters of a unit quaternion."""
    return q[1:] / (1 + q[0])


def matrices(s):
    """Rotation matrices of an array of modified Rodrigues parameters [..., 3], NumPy."""
    n = (s**2).sum(-1)[..., None, None]
    hat = np.zeros(s.shape + (3,))
    hat[..., 0, 1], hat[..., 0, 2], hat[..., 1, 2] = -s[..., 2], s[..., 1], -s[..., 0]
    hat -= np.swapaxes(hat, -1, -2)
    return np.eye(3) + (8 * hat @ hat + 4 * (1 - n) * hat) / (1 + n) ** 2


def _series(coefficients, x):
    """Horner's rule; works on SX and on numbers."""
    value = coefficients[-1]
    for c in reversed(coefficients[:-1]):
        value = c + x * value
    return value


def _analytic(coefficients, closed, x, limit):
    """An even function of an angle as a function of its square: its power series below `limit`, its closed form above.

    The closed form sees `limit` below it, so that no branch has a derivative that is not finite.
    """
    return ca.if_else(x < limit, _series(coefficients, x), closed(ca.fmax(x, limit)))


# asin(r)/r over r^2.
_ASIN = [comb(2 * n, n) / (4**n * (2 * n + 1)) for n in range(11)]
# (1 - (r/2) cot(r/2))/r^2 over r^2: |B_2n|/(2n)!.
_COT = [
    1 / 12, 1 / 720, 1 / 30240, 1 / 1209600, 1 / 47900160, 691 / 1307674368000, 1 / 74724249600,
    3617 / 10670622842880000, 43867 / 5109094217170944000,
]  # fmt: skip


def logarithm(q):
    """Rotation vector of a unit quaternion with positive scalar part."""
    n = ca.dot(q[1:], q[1:])
    factor = _analytic(_ASIN, lambda n: ca.asin(ca.sqrt(n)) / ca.sqrt(n), n, 0.02)
    return 2 * factor * q[1:]


def inverse_tangent_coefficient(n):
    """(1 - (a/2) cot(a/2))/a^2 over n = a^2."""

    def closed(n):
        half = ca.sqrt(n) / 2
        return (1 - half / ca.tan(half)) / n

    return _analytic(_COT, closed, n, 0.4)


def _trapezoidal(rod, dx, qa, qb):
    """Force on the element's second end (spatial; the first has the opposite) and body moments on both, -dU."""
    l = rod.element_length
    c1, c2 = ca.vertcat(rod.ga, rod.ga, rod.ea), ca.vertcat(rod.ei, rod.ei, rod.gj)
    ya, yb = rotate(conjugate(qa), dx), rotate(conjugate(qb), dx)
    na, nb = c1 * (ya / l - ca.DM([0, 0, 1])), c1 * (yb / l - ca.DM([0, 0, 1]))
    force = -(rotate(qa, na) + rotate(qb, nb)) / 2
    relative = product(conjugate(qa), qb)
    psi = 2 * relative[1:] / relative[0]
    m = c2 * psi / l
    along, across = m + psi * ca.dot(psi, m) / 4, ca.cross(psi, m) / 2
    return force, along + across - ca.cross(na, ya) / 2, -(along - across) - ca.cross(nb, yb) / 2


def _helical(rod, dx, qa, qb):
    """The same with one constant strain along the element."""
    l = rod.element_length
    c1, c2 = ca.vertcat(rod.ga, rod.ga, rod.ea), ca.vertcat(rod.ei, rod.ei, rod.gj)
    psi, y, n = ca.SX.sym("psi", 3), ca.SX.sym("y", 3), ca.SX.sym("n", 3)
    c = inverse_tangent_coefficient(ca.dot(psi, psi))

    def tangent(v, sign):
        turned = ca.cross(psi, v)
        return v - sign * turned / 2 + c * ca.cross(psi, turned)

    strained, transposed = tangent(y, 1), tangent(n, -1)
    slope = ca.gradient(ca.dot(n, strained), psi)
    mu = ca.SX.sym("mu", 3)
    kinematics = ca.Function("kinematics", [psi, y], [strained])
    forces = ca.Function("forces", [psi, y, n], [transposed, slope])
    moments = ca.Function("moments", [psi, mu], [tangent(mu, -1), tangent(mu, 1)])
    angle = logarithm(product(conjugate(qa), qb))
    local = rotate(conjugate(qa), dx)
    stress = c1 * (kinematics(angle, local) / l - ca.DM([0, 0, 1]))
    pulled, turning = forces(angle, local, stress)
    first, second = moments(angle, c2 * angle / l + turning)
    return -rotate(qa, pulled), first - ca.cross(pulled, local), -second


def element_forces(rod, dx, qa, qb):
    return {"trapezoidal": _trapezoidal, "helical": _helical}[rod.strain](rod, dx, qa, qb)


def forces(rod, x, q):
    """Elastic forces and body moments on nodes 1..K: lists of 3-vectors; `x`, `q` of the same nodes."""
    f, m = [0] * rod.n_elements, [0] * rod.n_elements
    xa, qa = ca.DM.zeros(3), ca.DM([1, 0, 0, 0])
    for e in range(rod.n_elements):
        force, first, second = element_forces(rod, x[e] - xa, qa, q[e])
        f[e] += force
        m[e] += second
        if e > 0:
            f[e - 1] -= force
            m[e - 1] += first
        xa, qa = x[e], q[e]
    return f, m


def turn(inertia, g):
    """Cayley vector f of J f + f x J f / 2 = (1 + |f|^2/4) g for J = diag(a, a, b) and g = h times the momentum.

    The scalar a = 1 + |f|^2/4 by Newton from the isotropic answer: |g| is a few percent of J here, and three steps reach rounding.
    Beyond |g| = J, where there is no answer, something finite keeps the line searches of the peers alive.
    """
    a, b = inertia[0], inertia[2]
    across, along = (g[0] ** 2 + g[1] ** 2) / a**2, (g[2] / b) ** 2
    alpha = 2 / (1 + ca.sqrt(ca.fmax(1 - across - along, 0.01)))
    if a != b:
        skew = ((b - a) * g[2] / (2 * a * b)) ** 2
        for _ in range(3):
            shrink = 1 / (1 + skew * alpha**2)
            value = alpha - 1 - alpha**2 / 4 * (across * shrink + along)
            slope = 1 - alpha / 2 * (across * shrink**2 + along)
            alpha = alpha - value / slope
    along = alpha * g[2] / b
    s = (b - a) * along / (2 * a)
    shrink = alpha / (a * (1 + s**2))
    return ca.vertcat(shrink * (g[0] - s * g[1]), shrink * (g[1] + s * g[0]), along)


def split(rod, c):
    """Positions and rotation parameters of a stacked configuration."""
    return [c[6 * q : 6 * q + 3] for q in range(rod.n_elements)], [c[6 * q + 3 : 6 * q + 6] for q in range(rod.n_elements)]


def rest(rod):
    c = np.zeros((rod.n_elements, 6))
    c[:, 2] = rod.element_length * np.arange(1, rod.n_elements + 1)
    return c.ravel()


def advance(rod, h, share, x, q, v, w, force, moment, control):
    """Position, rotation parameters and velocities of one node at the next time node; see `step`."""
    inertia = ca.DM(rod.rotary)
    velocity = v + h / (rod.mass * share) * (force + control[:3] / 2)
    momentum = inertia * w + h / share * (moment + control[3:] / 2)
    cayley = turn(rod.rotary, h * momentum)
    scale = 1 / ca.sqrt(1 + ca.dot(cayley, cayley) / 4)
    half = ca.vertcat(scale, cayley * scale / 2)
    arriving = rotate(conjugate(half), momentum) + h / (2 * share) * control[3:]
    place = x + h * velocity, rodrigues(product(q, half))
    return *place, velocity + h / (2 * rod.mass * share) * control[:3], arriving / inertia


def step(rod, h):
    """Function (z, u) -> z+ on states of 12 K numbers.

    z = (configuration at k, velocities): v = p/m and w = J^-1 pi of every free node as they *arrive* at k, without the elastic kick
    of k but with the half kick of the control of the interval before. The step kicks (elastic h, control h/2), drifts, and
    kicks with the control again (h/2): one evaluation of the forces, and controls that jump at a time node need no care.
    """
    K = rod.n_elements
    z, u = ca.SX.sym("z", 12 * K), ca.SX.sym("u", 6)
    x, s = split(rod, z[: 6 * K])
    v, w = split(rod, z[6 * K :])
    q = [quaternion(s) for s in s]
    f, m = forces(rod, x, q)
    places, rates = [], []
    for i in range(K):
        control = u if i == K - 1 else ca.SX.zeros(6)
        position, rotation, *velocities = advance(rod, h, rod.share[i], x[i], q[i], v[i], w[i], f[i], m[i], control)
        places += [position, rotation]
        rates += velocities
    return ca.Function("step", [z, u], [ca.vertcat(*places, *rates)], ["z", "u"], ["next"])


def initial_state(rod, h):
    """At rest in the stress-free shape, where the elastic kick is zero; see `step`."""
    return np.concatenate([rest(rod), np.zeros(6 * rod.n_elements)])


def pose_error(rod, x, q, position, rotation=None):
    """Position over L, and log(R*^T R) if `rotation`, the quaternion of R*, is given."""
    rows = (x - ca.DM(position)) / rod.length
    if rotation is None:
        return rows
    target = ca.DM(np.array(rotation) / np.linalg.norm(rotation))
    return ca.vertcat(rows, logarithm(product(conjugate(target), q)))


def tip_goal(rod, h, x, q, v, w, force, moment, position, rotation=None):
    """Scaled residuals: `pose_error`, and the velocities of the terminal Legendre transform times T/L, T."""
    mass, inertia = rod.mass * rod.share[-1], ca.DM(rod.rotary) * rod.share[-1]
    velocity, angular = v + h / 2 / mass * force, w + h / 2 * moment / inertia
    return ca.vertcat(pose_error(rod, x, q, position, rotation), velocity * rod.time_scale / rod.length, angular * rod.time_scale)


def goal(rod, h, position, rotation=None):
    """Function (z_N) -> residuals of `tip_goal`."""
    K = rod.n_elements
    z = ca.SX.sym("z", 12 * K)
    x, s = split(rod, z[: 6 * K])
    v, w = split(rod, z[6 * K :])
    q = [quaternion(s) for s in s]
    f, m = forces(rod, x, q)
    residual = tip_goal(rod, h, x[-1], q[-1], v[-1], w[-1], f[-1], m[-1], position, rotation)
    return ca.Function("goal", [z], [residual], ["z"], ["residual"])
