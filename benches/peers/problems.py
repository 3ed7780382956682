"""The problems that are compared, and their scene files for `softarm`."""

from dataclasses import dataclass

import numpy as np

from rod import Rod


@dataclass(frozen=True)
class Problem:
    """A tip wrench, constant on blocks of equal length, brings the tip to a goal at rest with the least effort.

    min h/2 sum_k |f/f_s|^2 + |m/m_s|^2, from the straight rod at rest.
    """

    name: str
    rod: Rod
    scene_rod: str
    """The rod's sections in the scene file."""
    end: float
    n_steps: int
    n_blocks: int
    position: tuple
    orientation: tuple = None
    """Quaternion, scalar first."""
    force_max: float = None
    moment_max: float = None
    force_scale: float = 1.0
    moment_scale: float = 1.0
    sphere: tuple = None
    """(x, y, z, distance): every node keeps this distance from the center at every time node."""

    @property
    def step(self):
        return self.end / self.n_steps

    @property
    def steps_per_block(self):
        assert self.n_steps % self.n_blocks == 0
        return self.n_steps // self.n_blocks

    @property
    def scales(self):
        return np.repeat([self.force_scale, self.moment_scale], 3)

    @property
    def n_goals(self):
        return 9 if self.orientation is None else 12

    @property
    def bounds(self):
        """Of every bounded norm of scaled controls: which components, and the limit."""
        parts = (slice(0, 3), self.force_max, self.force_scale), (slice(3, 6), self.moment_max, self.moment_scale)
        return [(part, limit / scale) for part, limit, scale in parts if limit is not None]

    def objective(self, controls):
        """Of an array [n_blocks, 6] in N and N m."""
        return self.end / self.n_blocks / 2 * float(((controls / self.scales) ** 2).sum())

    def scene(self, guess):
        """TOML for `softarm solve`; `guess`: "static" or "rest"."""
        lines = [self.scene_rod, f"[time]\nend_s = {self.end!r}\nstep_s = {self.step * (1 + 1e-12)!r}\n", "[task]"]
        lines.append(f"position_m = {list(self.position)}")
        if self.orientation is not None:
            lines.append(f"orientation_wxyz = {list(self.orientation)}")
        # The same problem as the peers solve: rest of the tip and no tolerance, constant controls, and a wrench without bounds where none is given.
        lines.append("at_rest = 'tip'\ntolerance_m_s = 0\ntolerance_rad_s = 0")
        lines.append(f"\n[control]\nblocks = {self.n_blocks}\nhold = 'constant'")
        lines.append(f"force_max_n = {'inf' if self.force_max is None else repr(self.force_max)}")
        lines.append(f"moment_max_n_m = {'inf' if self.moment_max is None else repr(self.moment_max)}")
        lines.append(f"\n[objective]\nforce_scale_n = {self.force_scale!r}\nmoment_scale_n_m = {self.moment_scale!r}")
        lines.append(f'\n[solver]\nguess = "{guess}"\nmax_iterations = 300\n')
        return "\n".join(lines)


def soft(name, n_elements, n_steps, end=1.0, strain="trapezoidal", **goal):
    """Silicone-like: L = 1 m, r = 0.05 m, E = 1 MPa."""
    rod = Rod.circle(1.0, 0.05, 1e6, 0.5, 1000.0, n_elements, strain)
    text = f"""[rod]
length_m = 1.0
elements = {n_elements}
strain = "{strain}"
model = "standard"

[rod.material]
youngs_modulus_pa = 1e6
poisson_ratio = 0.5
density_kg_m3 = 1000.0

[rod.section]
radius_m = 0.05
"""
    goal = {"position": (0.3, 0.1, 0.9), "force_scale": 5.0, "moment_scale": 5.0} | goal
    return Problem(name, rod, text, end, n_steps, 20, **goal)


def paper(name, n_elements, n_steps, end=5.0, strain="trapezoidal", **goal):
    """The rod of the source paper's third experiment."""
    rod = Rod(10.0, n_elements, 1e4, 1e4, 500.0, 500.0, 1.0, (10.0, 10.0, 10.0), strain)
    text = f"""[rod]
length_m = 10.0
elements = {n_elements}
strain = "{strain}"
model = "standard"

[rod.stiffness]
ea_n = 1e4
ga_n = 1e4
ei_n_m2 = 500.0
gj_n_m2 = 500.0

[rod.inertia]
mass_kg_m = 1.0
rotary_kg_m = [10.0, 10.0, 10.0]
"""
    goal = {"position": (4.0, 1.0, 8.5), "force_scale": 5.0, "moment_scale": 50.0} | goal
    return Problem(name, rod, text, end, n_steps, 20, **goal)


def _all():
    bent = {"position": (0.5, 0.2, 0.7), "strain": "helical"}
    pose = {"orientation": (0.95, -0.1, 0.3, 0.0)}
    bounded = {"force_max": 1.8, "moment_max": 3.5}
    yield soft("soft-reach-2", 2, 100, end=0.2, position=(0.2, 0.05, 0.95))
    yield soft("soft-reach-4", 4, 200, end=0.4)
    yield soft("soft-reach-8", 8, 500)
    yield soft("soft-reach-12", 12, 500, end=0.9)
    yield soft("soft-pose-8", 8, 500, **pose)
    yield soft("soft-bound-8", 8, 500, **bounded)
    yield soft("soft-bent-12", 12, 500, end=0.9, **bent)
    yield paper("paper-reach-8", 8, 500)


PROBLEMS = {problem.name: problem for problem in _all()}
