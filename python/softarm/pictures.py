"""Pictures of arms in space by matplotlib, without a screen: frames of environments, and films of results."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .errors import ResultError
from .scene import Scene

FACETS = 12
"""Number of faces around an arm."""


def radii(scene: Scene, places: np.ndarray) -> np.ndarray:
    """Returns the radius of the arm at places (0 to 1), m, as it is drawn: of a rectangle or an ellipse half of the longer side, and of an arm
    without a section 1/50 of its length, unless it has a `display_radius_m`.
    """
    rod = scene["rod"]
    lengths = [_share(own, rod) for own in rod.get("segment") or [{"fraction": 1.0}]]
    ends = np.cumsum(lengths) / sum(lengths)
    out = np.empty(len(places))
    for i, place in enumerate(places):
        index = min(int(np.searchsorted(ends, place - 1e-9)), len(ends) - 1)
        own = (rod.get("segment") or [rod])[index]
        begin = ends[index - 1] if index else 0.0
        out[i] = _radius(own, rod, (place - begin) / (ends[index] - begin))
    return out


def _share(segment: Mapping[str, Any], rod: Mapping[str, Any]) -> float:
    return float(segment["fraction"] if "fraction" in segment else segment["length_m"] / rod["length_m"])


def _radius(own: Mapping[str, Any], rod: Mapping[str, Any], part: float) -> float:
    """Returns the radius at a part of the length of a segment, m."""
    section = own.get("section") or rod.get("section") or {}

    def half(name: str) -> float | None:
        if f"radius{name}_m" in section:
            return float(section[f"radius{name}_m"])
        return 0.5 * float(section[f"diameter{name}_m"]) if f"diameter{name}_m" in section else None

    whole, base, tip = half(""), half("_base"), half("_tip")
    if whole is not None:
        return whole
    if base is not None and tip is not None:
        return base + (tip - base) * part
    if "width_m" in section:
        return 0.5 * max(float(section["width_m"]), float(section["height_m"]))
    shown = own.get("display_radius_m") or rod.get("display_radius_m")
    return float(shown) if shown else 0.02 * float(rod["length_m"])


def bodies(scene: Scene) -> list[tuple[str, dict[str, Any], np.ndarray]]:
    """Returns obstacles and bodies to touch: shape, its keys, and its velocity, m/s."""
    whole = scene.to_dict()
    return [
        (shape, own[shape], np.array(own.get("velocity_m_s", (0.0, 0.0, 0.0)), dtype=float))
        for own in [*whole.get("obstacle", []), *whole.get("contact", [])]
        for shape in ("sphere", "capsule", "half_space", "box")
        if own.get(shape)
    ]


def name_axes(axes: Any, half: np.ndarray) -> None:
    """Writes the names of the axes in space beside their numbers, where a box is as long as `half` says in each direction."""
    for i, which in enumerate("xyz"):
        # Matplotlib moves a name away by parts of the lengths of the box in the other directions, which may be short.
        others = np.delete(half, i).max()
        getattr(axes, f"set_{which}label")(f"{which} (m)", labelpad=26.0 * min(half.max() / others, 3.5) - 21.0)


class Picture:
    """An arm in space with targets and obstacles, drawn again and again within the same bounds.

    `low` and `high` (m) are two corners of what is seen, `size` the width and height in pixels, and `azimuth` and `elevation` (degrees) say from
    where: 0 looks from +x, and -90 from -y.
    """

    def __init__(
        self,
        scene: Scene,
        low: np.ndarray,
        high: np.ndarray,
        *,
        size: tuple[int, int] = (480, 480),
        azimuth: float = -60.0,
        elevation: float = 20.0,
    ):
        try:
            from matplotlib.backends.backend_agg import (  # type: ignore[import-not-found,import-untyped,unused-ignore]
                FigureCanvasAgg,
            )
            from matplotlib.figure import Figure  # type: ignore[import-not-found,import-untyped,unused-ignore]
        except ImportError as error:
            raise ImportError("pictures of arms need matplotlib: pip install matplotlib") from error
        self._scene = scene
        self._bodies = bodies(scene)
        middle, half = 0.5 * (low + high), 0.55 * np.maximum(high - low, 0.2 * (high - low).max())
        self._low, self._high = middle - half, middle + half
        figure = Figure(figsize=(size[0] / 100, size[1] / 100), dpi=100)
        self.canvas = FigureCanvasAgg(figure)
        axes: Any = figure.add_axes((0.02, 0.05, 0.92, 0.9), projection="3d", computed_zorder=False)
        axes.view_init(elev=elevation, azim=azimuth)
        for which, (a, b) in zip("xyz", zip(self._low, self._high)):
            getattr(axes, f"set_{which}lim")(a, b)
            axes.locator_params(axis=which, nbins=4 if b - a > (self._high - self._low).max() / 2 else 2)
        axes.tick_params(labelsize="x-small")
        name_axes(axes, half)
        axes.set_box_aspect(half, zoom=0.8)
        self._axes = axes
        self._drawn: list[Any] = []
        self._radii: np.ndarray | None = None

    def draw(
        self,
        x: np.ndarray,
        R: np.ndarray,
        *,
        target: np.ndarray | None = None,
        near: float = 0.0,
        time: float = 0.0,
        path: np.ndarray | None = None,
        title: str = "",
    ) -> None:
        """Draws an arm at positions `(K+1, 3)` and rotations `(K+1, 3, 3)`, its target, a ball of the radius `near` (m), and the path `(n, 3)`
        of its tip, with the obstacles where they are at a time in s.
        """
        for own in self._drawn:
            own.remove()
        axes = self._axes
        self._drawn = []
        for shape, keys, velocity in self._bodies:
            for surface in self._faces(shape, keys, velocity * time):
                self._drawn.append(axes.plot_surface(*surface, color=(0.55, 0.55, 0.55, 0.35), shade=True, zorder=1))
        if path is not None and len(path) > 1:
            self._drawn += axes.plot(*path.T, color="0.3", lw=0.8, zorder=2)
        if self._radii is None or len(self._radii) != len(x):
            away = np.linalg.norm(np.diff(x, axis=0), axis=1)
            places = np.concatenate([[0.0], np.cumsum(away)]) / max(away.sum(), 1e-300)
            self._radii = radii(self._scene, places)
        around = np.linspace(0.0, 2.0 * np.pi, FACETS + 1)
        rings = np.cos(around)[:, None] * R[:, None, :, 0] + np.sin(around)[:, None] * R[:, None, :, 1]
        skin = x[:, None] + self._radii[:, None, None] * rings
        self._drawn.append(
            axes.plot_surface(*np.moveaxis(skin, 2, 0), color=(0.35, 0.6, 0.85), shade=True, rcount=len(x), ccount=FACETS + 1, zorder=3)
        )
        if target is not None:
            if near > 0.0:
                ball = _ball(np.asarray(target, dtype=float), near)
                self._drawn.append(axes.plot_surface(*ball, color=(0.85, 0.2, 0.15, 0.25), shade=False, zorder=4))
            self._drawn += axes.plot(*np.asarray(target, dtype=float)[:, None], "o", color=(0.85, 0.2, 0.15), ms=5, zorder=5)
        self._drawn.append(axes.figure.text(0.5, 0.975, title, ha="center", va="center", fontsize="small"))

    def turn(self, azimuth: float, elevation: float) -> None:
        """Looks from another side, degrees."""
        self._axes.view_init(elev=elevation, azim=azimuth)

    def pixels(self) -> np.ndarray:
        """Returns what is drawn as `(height, width, 3)` bytes: red, green and blue."""
        self.canvas.draw()
        return np.array(self.canvas.buffer_rgba())[:, :, :3]

    def _faces(self, shape: str, keys: Mapping[str, Any], off: np.ndarray) -> Iterator[np.ndarray]:
        """Returns the surfaces of a body, each `(3, a, b)`."""
        if shape == "sphere":
            yield _ball(np.array(keys["center_m"]) + off, keys["radius_m"])
        elif shape == "capsule":
            yield _capsule(np.array(keys["from_m"]) + off, np.array(keys["to_m"]) + off, keys["radius_m"])
        elif shape == "box":
            yield from _box(np.array(keys["center_m"]) + off, np.array(keys["size_m"]), keys.get("orientation_wxyz", (1.0, 0.0, 0.0, 0.0)))
        else:
            plane = _plane(np.array(keys["point_m"]) + off, np.array(keys["normal"]), self._low, self._high)
            if plane is not None:
                yield plane


def _ball(center: np.ndarray, radius: float) -> np.ndarray:
    u, v = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 17), np.linspace(0.0, np.pi, 9), indexing="ij")
    return center[:, None, None] + radius * np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)])


def _across(along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns two unit vectors across a unit vector, and across each other."""
    a = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    a /= np.linalg.norm(a)
    return a, np.cross(along, a)


def _capsule(begin: np.ndarray, end: np.ndarray, radius: float) -> np.ndarray:
    length = float(np.linalg.norm(end - begin))
    along = (end - begin) / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
    a, b = _across(along)
    angle = np.linspace(0.0, 0.5 * np.pi, 5)
    outline = [(-radius * np.cos(own), radius * np.sin(own)) for own in angle] + [
        (length + radius * np.sin(own), radius * np.cos(own)) for own in angle
    ]
    around = np.linspace(0.0, 2.0 * np.pi, 17)
    rows = [begin + s * along + r * (np.cos(around)[:, None] * a + np.sin(around)[:, None] * b) for s, r in outline]
    return np.moveaxis(np.array(rows), 2, 0)


def _box(center: np.ndarray, size: np.ndarray, wxyz: Sequence[float]) -> Iterator[np.ndarray]:
    w, *v = np.array(wxyz, dtype=float) / np.linalg.norm(wxyz)
    hat = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    turn = np.eye(3) + 2.0 * w * hat + 2.0 * hat @ hat
    for axis in range(3):
        a, b = (0.5 * size[other] * turn[:, other] for other in range(3) if other != axis)
        for side in (-0.5, 0.5):
            middle = center + side * size[axis] * turn[:, axis]
            corners = np.array([[middle - a - b, middle - a + b], [middle + a - b, middle + a + b]])
            yield np.moveaxis(corners, 2, 0)


def _plane(point: np.ndarray, normal: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray | None:
    """Returns the part of a plane in a box along the axes as a surface with one face; None where it passes the box by."""
    normal = normal / np.linalg.norm(normal)
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    height = (corners - point) @ normal
    cuts = []
    for i in range(8):
        for j in range(i + 1, 8):
            # Edges of the box have ends that differ in one coordinate.
            if np.count_nonzero(corners[i] != corners[j]) == 1 and height[i] * height[j] <= 0.0 and height[i] != height[j]:
                cuts.append(corners[i] + height[i] / (height[i] - height[j]) * (corners[j] - corners[i]))
    if len(cuts) < 3:
        return None
    points = np.array(cuts)
    middle = points.mean(axis=0)
    a, b = _across(normal)
    order = np.argsort(np.arctan2((points - middle) @ b, (points - middle) @ a))
    edge = points[[*order, order[0]]]
    return np.moveaxis(np.array([np.tile(middle, (len(edge), 1)), edge]), 2, 0)


def film(frames: Iterable[np.ndarray], path: Path, rate: float, kind: str) -> None:
    """Writes frames `(h, w, 3)` as an animated GIF or, by ffmpeg, as MP4, with `rate` of them a second."""
    if kind == "gif":
        try:
            from PIL import Image  # type: ignore[import-not-found,import-untyped,unused-ignore]
        except ImportError as error:
            raise ImportError("a GIF needs Pillow, which comes with matplotlib: pip install pillow") from error
        images = (Image.fromarray(frame) for frame in frames)
        next(images).save(path, format="GIF", save_all=True, append_images=images, duration=round(1000.0 / rate), loop=0, optimize=False)
        return
    import subprocess

    program = shutil.which("ffmpeg")
    if program is None:
        raise ResultError("a film in MP4 needs the program ffmpeg, which is not in the PATH; export to gif does not")
    shown = iter(frames)
    first = next(shown)
    height, width = first.shape[:2]
    words = [program, "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{rate:g}", "-i", "-"]
    words += ["-pix_fmt", "yuv420p", "-f", "mp4", str(path)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as running:
        assert running.stdin is not None and running.stderr is not None
        try:
            running.stdin.write(first.tobytes())
            for frame in shown:
                running.stdin.write(frame.tobytes())
            running.stdin.close()
        except BrokenPipeError:
            pass  # its reason follows
        reason = running.stderr.read().decode(errors="replace").strip()
        code = running.wait()
    if code != 0:
        raise ResultError(f"ffmpeg ended with code {code}: {reason}")
