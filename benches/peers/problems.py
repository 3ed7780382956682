"""The problems that are compared: the scene files of `softarm` in `scenes`, read for its peers."""

import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rod import Rod


@dataclass(frozen=True)
class Problem:
    """A tip wrench, constant on blocks of equal length, brings the tip to a goal at rest with the least effort.

    min h/2 sum_k |f/f_s|^2 + |m/m_s|^2, from the straight rod at rest.
    """

    name: str
    rod: Rod
    scene: Path
    """What `softarm solve` is given."""
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


def _rod(scene):
    section, n_elements, strain = scene.get("section"), scene["elements"], scene["strain"]
    if section:
        material = scene["material"]
        modulus, ratio, density = (material[key] for key in ("youngs_modulus_pa", "poisson_ratio", "density_kg_m3"))
        return Rod.circle(scene["length_m"], section["radius_m"], modulus, ratio, density, n_elements, strain)
    stiffness = [scene["stiffness"][key] for key in ("ea_n", "ga_n", "ei_n_m2", "gj_n_m2")]
    inertia = scene["inertia"]
    return Rod(scene["length_m"], n_elements, *stiffness, inertia["mass_kg_m"], tuple(inertia["rotary_kg_m"]), strain)


def _read(path):
    scene = tomllib.loads(path.read_text())
    time, task, control, objective = (scene[key] for key in ("time", "task", "control", "objective"))
    assert control["hold"] == "constant" and task["at_rest"] == "tip" and task["tolerance_m_s"] == task["tolerance_rad_s"] == 0
    orientation = task.get("orientation_wxyz")
    force_max, moment_max = (None if np.isinf(control[key]) else control[key] for key in ("force_max_n", "moment_max_n_m"))
    return Problem(
        path.stem,
        _rod(scene["rod"]),
        path,
        time["end_s"],
        round(time["end_s"] / time["step_s"]),
        control["blocks"],
        tuple(task["position_m"]),
        orientation and tuple(orientation),
        force_max,
        moment_max,
        objective["force_scale_n"],
        objective["moment_scale_n_m"],
    )


def _family_and_size(path):
    family, size = path.stem.rsplit("-", 1)
    return family, int(size)


PROBLEMS = {path.stem: _read(path) for path in sorted((Path(__file__).parent / "scenes").glob("*-*.toml"), key=_family_and_size)}
