"""Design of an arm with three tendons by derivatives: taper, routing and places of the tendons for the least peak tension over 20 targets.

    pip install . numpy scipy
    python examples/codesign.py [GRID]

A soft arm of 0.3 m hangs from its base. Its tip should reach 20 places beside the axis, and must not give way by more than 12 mm to a force of
0.01 N across it. The design has three numbers: the radius of the tip, and the offset of the tendons from the axis at the base and at the tip, which
leaves a wall of 2 mm. At every target the two tendons beside its direction pull, and the third one is slack; their tensions follow from the target by
Newton's method with the derivatives of the tip along the tensions, and change with the design by the implicit function theorem. The largest tension
of all targets is the least in the sense of sequential quadratic programming (SLSQP of scipy).

With GRID, a number, the best of GRID^3 designs on a grid stands beside it. At the end the design is checked with twice the elements, and a solve
with a certificate takes its tip to the target that is the hardest.
"""

import sys
import time

import numpy as np
from scipy.optimize import NonlinearConstraint, minimize

import softarm as sa

LENGTH, BASE, WALL, FORCE, GIVES = 0.3, 0.010, 2e-3, 0.01, 0.012
ANGLES = 2 * np.pi * np.arange(3) / 3
BEARING = 2 * np.pi * np.append(np.arange(10) + 0.25, np.arange(10) + 0.75) / 10
TARGETS = np.repeat([0.05, 0.07], 10)[:, None] * np.stack([np.cos(BEARING), np.sin(BEARING)], axis=1)
BOUNDS = np.array([[0.005, BASE], [0.002, BASE - WALL], [0.002, BASE - WALL]])  # radius of the tip, offset at the base, at the tip
KEYS = ["rod.section.radius_tip_m", *(f"tendon.{i}.{end}.{axis}" for end in ("offset_m", "offset_to_m") for i in range(3) for axis in range(2))]
# Derivatives of the keys along the design.
CHAIN = np.zeros((13, 3))
CHAIN[0, 0] = 1.0
for i in range(3):
    for end in range(2):
        CHAIN[1 + 6 * end + 2 * i : 3 + 6 * end + 2 * i, 1 + end] = np.cos(ANGLES[i]), np.sin(ANGLES[i])


def scene(design, elements=10, force=0.0):
    tip, near, far = (float(x) for x in design)
    arm = sa.arm(LENGTH, BASE, 2e5, density=1070.0, poisson_ratio=0.45, elements=elements)
    arm["rod"]["section"] = {"radius_base_m": BASE, "radius_tip_m": tip}
    place = lambda offset, angle: [float(offset * np.cos(angle)), float(offset * np.sin(angle))]
    tendons = [{"name": f"t{i}", "offset_m": place(near, a), "offset_to_m": place(far, a)} for i, a in enumerate(ANGLES)]
    load = [{"node": "tip", "force_n": [force, 0.0, 0.0]}]
    return sa.Scene(arm | {"gravity": {"acceleration_m_s2": [0.0, 0.0, -9.81]}, "tendon": tendons, "load": load, "time": {"end_s": 1.0}})


def tensions(arm, gradient=()):
    """Returns the tensions (20, 3) that take the tip to the targets, the tendons that pull, and the shapes there.

    Tensions grow from zero by at most 0.2 N at a time, for a target can be reached by an arm that bends too far and back as well.
    """
    pulls = np.zeros((20, 3))
    # The second axis of the sections of a hanging arm points along -y.
    pairs = np.array([sorted(np.argsort(np.abs(np.angle(np.exp(1j * (ANGLES + bearing)))))[:2]) for bearing in BEARING])
    rows = np.arange(20)[:, None]
    for _ in range(30):
        shapes = arm.shapes(pulls, jacobian=True)
        off = TARGETS - shapes.tips[:, :2]
        steps = np.linalg.solve(np.take_along_axis(shapes.jacobian[:, :2], pairs[:, None, :], axis=2), off[..., None])[..., 0]
        pulls[rows, pairs] += steps * min(1.0, 0.2 / np.abs(steps).max())
        if np.abs(off).max() < 1e-10:
            break
    return pulls, pairs, arm.shapes(pulls, jacobian=True, gradient=gradient, stability=True)


class Design:
    """Tensions and compliance of a design, with their derivatives."""

    def __init__(self):
        self.at, self.evaluations = None, 0

    def evaluate(self, design):
        if self.at is not None and np.array_equal(design, self.at):
            return
        self.at, self.evaluations = design.copy(), self.evaluations + 1
        arm = scene(design)
        self.pulls, pairs, shapes = tensions(arm, KEYS)
        # dT/dp = -(dx/dT)^-1 dx/dp
        along = shapes.along[0][:, :, -1, :2] .transpose(0, 2, 1) @ CHAIN
        slopes = np.take_along_axis(shapes.jacobian[:, :2], pairs[:, None, :], axis=2)
        self.tensions = np.take_along_axis(self.pulls, pairs, axis=1).ravel()
        self.slopes = -np.linalg.solve(slopes, along).reshape(40, 3)
        pushed = scene(design, force=FORCE).shapes(np.zeros((1, 3)), gradient=KEYS)
        self.gives, self.giving = pushed.tips[0, 0], pushed.along[0][0, :, -1, 0] @ CHAIN

    def of(self, name):
        def value(variables):
            self.evaluate(variables[:3] * SCALE)
            return getattr(self, name)

        return value


SCALE = BOUNDS.max(axis=1)


def optimum(start):
    """Returns the best design from one, its peak tension, and the number of designs that were evaluated."""
    own = Design()
    own.evaluate(start)
    peak = own.tensions.max()
    constraints = [
        {"type": "ineq", "fun": lambda z: z[3] - own.of("tensions")(z) / peak, "jac": lambda z: np.hstack([-(own.of("slopes")(z) * SCALE) / peak, np.ones((40, 1))])},
        {"type": "ineq", "fun": lambda z: 1 - own.of("gives")(z) / GIVES, "jac": lambda z: np.append(-own.of("giving")(z) * SCALE / GIVES, 0.0)},
        {"type": "ineq", "fun": lambda z: (z[0] * SCALE[0] - WALL - z[2] * SCALE[2]) / SCALE[0], "jac": lambda z: np.array([1.0, 0.0, -SCALE[2] / SCALE[0], 0.0])},
    ]
    found = minimize(
        lambda z: z[3],
        [*(start / SCALE), 1.0],
        jac=lambda z: np.array([0.0, 0.0, 0.0, 1.0]),
        bounds=[*(BOUNDS / SCALE[:, None]), (0.0, None)],
        constraints=constraints,
        method="SLSQP",
        options={"ftol": 1e-9, "maxiter": 60},
    )
    design = found.x[:3] * SCALE
    own.evaluate(design)
    return design, own, found


def on_a_grid(n):
    """Returns the best design of a grid and its peak tension."""
    best = (None, np.inf)
    for tip in np.linspace(*BOUNDS[0], n):
        for near in np.linspace(*BOUNDS[1], n):
            for far in np.linspace(BOUNDS[2, 0], tip - WALL, n):
                design = np.array([tip, near, far])
                if scene(design, force=FORCE).shapes(np.zeros((1, 3))).tips[0, 0] > GIVES:
                    continue
                pulls, _, _ = tensions(scene(design))
                best = min(best, (design, pulls.max()), key=lambda own: own[1])
    return best


def main():
    begun = time.perf_counter()
    design, own, found = optimum(np.array([0.009, 0.005, 0.005]))
    spent = time.perf_counter() - begun
    print(f"{found.message}: tip radius {1e3 * design[0]:.3f} mm, offsets {1e3 * design[1]:.3f} and {1e3 * design[2]:.3f} mm")
    print(f"peak tension {own.tensions.max():.5f} N, gives way by {1e3 * own.gives:.2f} mm; {own.evaluations} designs, {spent:.1f} s")
    if len(sys.argv) > 1:
        begun = time.perf_counter()
        best, peak = on_a_grid(int(sys.argv[1]))
        print(f"grid of {sys.argv[1]}^3: {np.round(1e3 * best, 3)} mm, peak tension {peak:.5f} N, {time.perf_counter() - begun:.1f} s")
    fine, _, shapes = tensions(scene(design, 20))
    print(f"with twice the elements the tensions differ by {np.abs(fine - own.pulls).max():.1e} N; {shapes.stable.sum()} of 20 shapes are stable")
    worst = int(own.pulls.max(axis=1).argmax())
    target = scene(design).shapes(own.pulls).tips[worst]
    task = {
        "time": {"end_s": 2.0},
        "damping": {"viscous_1_s": 4.0},
        "initial": {"shape": "equilibrium"},
        "task": {"position_m": [float(x) for x in target], "tolerance_m": 3e-4},
    }
    keys = scene(design).to_dict()
    for tendon in keys["tendon"]:
        tendon["tension_n"] = [0.0, 1.2 * float(own.tensions.max())]
    keys.update(task)
    result = sa.Scene(keys).solve()
    print(f"a solve takes the tip there: {result.status}, {result.certificate.verdict}")


if __name__ == "__main__":
    main()
