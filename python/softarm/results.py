"""Results: the files that a verb writes, as numbers and arrays."""

from __future__ import annotations

import csv
import html
import io
import json
import os
import shutil
import tempfile
import weakref
import zipfile
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from .errors import ResultError


class Folder:
    """A temporary folder, which goes with this object, at the latest at the end of the process that made it. A process forked from that
    one leaves the folder alone.
    """

    def __init__(self) -> None:
        self.name = tempfile.mkdtemp(prefix="softarm-")
        weakref.finalize(self, _remove_own, self.name, os.getpid())


def _remove_own(name: str, owner: int) -> None:
    if os.getpid() == owner:
        shutil.rmtree(name, ignore_errors=True)


class Certificate:
    """What the check of a solve found: `verdict`, and every criterion with what was found and allowed."""

    def __init__(self, found: dict[str, Any]):
        self.found = found

    @property
    def verdict(self) -> str:
        """"certified", "rejected" or why nothing was checked."""
        return str(self.found.get("verdict"))

    @property
    def is_certified(self) -> bool:
        """Tells whether all criteria hold."""
        return self.verdict == "certified"

    def __bool__(self) -> bool:
        return self.is_certified

    def __repr__(self) -> str:
        return f"<softarm.Certificate: {self.verdict}>"


class Result:
    """A result directory. Without a directory of one's own its files live as long as this object; `save` keeps them.

    `t` has the shape (n,), `x` (n, K+1, 3), `R` (n, K+1, 3, 3), each with a row for every time of the trajectory; the rotations take the frame
    of a node to space. SI units.
    """

    along: tuple[np.ndarray, np.ndarray] | None = None
    """Derivatives of the shape of an equilibrium along numbers, where `Scene.equilibrium` was asked for them."""

    def __init__(
        self,
        directory: str | os.PathLike[str],
        holder: Folder | None = None,
        exit_code: int | None = None,
    ):
        self.directory = Path(directory)
        self.exit_code = exit_code
        self._holder = holder
        try:
            self.summary: dict[str, Any] = json.loads((self.directory / "summary.json").read_text())
        except (OSError, ValueError) as error:
            raise ResultError(f"{self.directory} is not the directory of a result: {error}") from None
        if self.summary.get("tool") != "softarm":
            raise ResultError(f"{self.directory}/summary.json is not of softarm")

    @property
    def command(self) -> str:
        """The verb that made the result."""
        return str(self.summary["command"])

    @property
    def status(self) -> str:
        """How the verb ended, such as "converged"."""
        return str(self.summary.get("status", "completed"))

    @property
    def certificate(self) -> Certificate:
        """What the check of a solve found."""
        return Certificate(self.summary.get("check") or {"verdict": "not checked"})

    @property
    def doubt(self) -> dict[str, Any] | None:
        """What a solve or a closed loop does on the plants of a stated doubt (`[doubt]`): `plants`, `violating`, `share`, `at_most`, `limits` and
        `goal`; None without one."""
        return self.summary.get("doubt") or self.certificate.found.get("doubt")

    @cached_property
    def trajectory(self) -> dict[str, np.ndarray]:
        """All arrays of `trajectory.npz` by name."""
        return self._arrays("trajectory.npz")

    @cached_property
    def end(self) -> dict[str, np.ndarray]:
        """The state at the end: arrays of `end.npz` by name."""
        return self._arrays("end.npz")

    def _arrays(self, name: str) -> dict[str, np.ndarray]:
        path = self.directory / name
        if not path.is_file():
            raise ResultError(f"{self.directory} has no {name}: a result of {self.command} without one")
        with np.load(path, allow_pickle=False) as file:
            return {key: np.ascontiguousarray(file[key]) for key in file.files}

    @property
    def t(self) -> np.ndarray:
        """Times, s, (n,)."""
        return self.trajectory["t"]

    @property
    def x(self) -> np.ndarray:
        """Positions of the nodes, m, (n, K+1, 3)."""
        return self.trajectory["x"]

    @property
    def R(self) -> np.ndarray:
        """Rotations of the nodes, body to space, (n, K+1, 3, 3)."""
        return self.trajectory["R"]

    @property
    def tip(self) -> np.ndarray:
        """Positions of the tip, m, (n, 3)."""
        return self.x[:, -1]

    def table(self, name: str) -> np.ndarray:
        """Returns a CSV file of the result, such as "controls.csv", as an array with named columns, as the file heads them: numbers, flags,
        and text; an empty field of numbers is NaN.
        """
        path = self.directory / name
        if not path.is_file():
            tables = sorted(other.name for other in self.directory.glob("*.csv"))
            raise ResultError(f"{self.directory} has no {name}; its tables are {tables}")
        with open(path, newline="", encoding="utf-8") as file:
            head, *rows = [row for row in csv.reader(file) if row]
        columns = [_column(head[i], [row[i] for row in rows]) for i in range(len(head))]
        table = np.empty(len(rows), dtype=[(name, column.dtype) for name, column in zip(_distinct(head), columns)])
        for name, column in zip(table.dtype.names or (), columns):
            table[name] = column
        return table

    @property
    def controls(self) -> np.ndarray:
        """Rows of `controls.csv`: `t_start` and `t_end`, s, then a column for every control, named by control and unit, as in
        `controls["tip force x (N)"]` and `controls["left (N)"]`. Forces and moments, and whole efforts of actuators; of a winch its
        displacement, m.
        """
        return self.table("controls.csv")

    @cached_property
    def _efforts(self) -> tuple[list[str], np.ndarray]:
        if not (self.directory / "efforts.csv").is_file() and self.command in ("simulate", "solve", "mpc"):
            return [], np.zeros((len(self.t), 0))  # an arm without actuators
        rows = self.table("efforts.csv")
        n = len(self.t)
        if len(rows) % n:
            raise ResultError(f"{self.directory}/efforts.csv has {len(rows)} rows; expected as many for each of the {n} times")
        m = len(rows) // n
        return [str(name) for name in rows["name"][:m]], np.asarray(rows["effort"], dtype=float).reshape(n, m)

    @property
    def efforts(self) -> np.ndarray:
        """Efforts of the m actuators at the times `t`, (n, m), in the order of `effort_names`: tensions of tendons and cables in N, pressures of
        chambers and braids in Pa, activations of muscles, fields of magnets in T or T/m; `effort_units` has the units. Of a closed loop they
        are those that act in the plant. `table("efforts.csv")` has coordinates, and displacements of winches, too.
        """
        return self._efforts[1]

    @property
    def effort_names(self) -> list[str]:
        """Names of the columns of `efforts`."""
        return self._efforts[0]

    @cached_property
    def effort_units(self) -> list[str]:
        """Units of the columns of `efforts`: "N", "Pa", "1", "T" or "T/m"."""
        # A winch takes its displacement, and its effort is the tension.
        units = {name: "N" if unit == "m" else unit or "1" for name, unit in self.scene.inputs}
        return [units[name] for name in self.effort_names]

    @cached_property
    def diagnostics(self) -> dict[str, np.ndarray]:
        """Momenta, strains, internal forces, reactions and balances: arrays of `diagnostics.npz` by name (docs/files.md), which a simulation and
        a solve write where the scene has `output.diagnostics = true`.
        """
        if not (self.directory / "diagnostics.npz").is_file():
            raise ResultError(
                f"{self.directory} has no diagnostics.npz: scene.replace({{\"output.diagnostics\": True}}).simulate(), or .solve(), has one"
            )
        return self._arrays("diagnostics.npz")

    @property
    def scene(self):
        """The scene with all defaults, which gives this result again."""
        from .scene import Scene

        return Scene.load(self.directory / "scene.toml")

    def to_dict(self) -> dict[str, Any]:
        """Returns the summary."""
        return json.loads(json.dumps(self.summary))

    def save(self, directory: str | os.PathLike[str]) -> Path:
        """Copies the files into a directory that is not there yet or empty, and returns its path."""
        target = Path(directory)
        if target.exists() and (not target.is_dir() or any(target.iterdir())):
            raise ResultError(f"{target} is there and not empty; give another name, or `out` to the verb, which replaces results only")
        shutil.copytree(self.directory, target, dirs_exist_ok=True)
        return target

    def export(
        self,
        format: str,
        path: str | os.PathLike[str] | None = None,
        *,
        frames: int | None = None,
        azimuth: float | None = None,
        elevation: float | None = None,
        turn: float = 0.0,
        seconds: float | None = None,
        size: tuple[int, int] = (640, 640),
        force: bool = False,
    ) -> Path:
        """Writes the motion for other programs, and returns the file to open.

        `format` is "vtk" (a series that ParaView opens), "csv" (one table), "svg" (pictures, and one that plays them), "gif" or "mp4" (films,
        by matplotlib; MP4 by the program ffmpeg). `path` is the folder of the files, which are called `motion`, or for "csv", "svg", "gif"
        and "mp4" a file whose name ends like that; without it the folder is that of the result, with the format's name at its end.

        At most `frames` times are written, evenly spread. Pictures are seen from `azimuth` and `elevation` (degrees), and go round by `turn` on
        the way; a film lasts `seconds`, and has `size` pixels. A file that softarm did not write, and any existing film or file that `path` names, is
        replaced only with `force`.
        """
        kinds = ("vtk", "csv", "svg", "gif", "mp4")
        if format not in kinds:
            raise ValueError(f"format = {format!r}; expected one of {kinds}")
        if format != "vtk" and path is not None and Path(path).suffix.lower() == f".{format}":
            target = Path(path)
        elif format in ("gif", "mp4"):
            target = (self.directory / format if path is None else Path(path)) / f"motion.{format}"
        else:
            return self._export(format, self.directory / format if path is None else Path(path), frames, azimuth, elevation, turn, seconds, force)
        if target.exists() and not (force and target.is_file()):
            raise ResultError(f"{target} is there already; give another name, or force=True, which replaces a file")
        target.parent.mkdir(parents=True, exist_ok=True)
        holder = Folder()
        if format in ("gif", "mp4"):
            made = Path(holder.name) / target.name
            self._film(made, format, frames, azimuth, elevation, turn, seconds, size)
        else:
            made = self._export(format, Path(holder.name), frames, azimuth, elevation, turn, seconds, False)
        # As a whole, or not at all.
        beside = target.with_name(f".{target.name}.{os.getpid()}")
        try:
            shutil.copyfile(made, beside)
            os.replace(beside, target)
        finally:
            beside.unlink(missing_ok=True)
        return target

    def _export(
        self,
        format: str,
        folder: Path,
        frames: int | None,
        azimuth: float | None,
        elevation: float | None,
        turn: float,
        seconds: float | None,
        force: bool,
    ) -> Path:
        """Writes files by the verb `export`."""
        from .scene import _call, _options

        words = _options(to=format, out=os.fspath(folder), frames=frames, force=os.fspath(folder) if force else None)
        if format == "svg":
            words += _options(azimuth=azimuth, elevation=elevation, turn=turn, seconds=seconds)
        return Path(_call(["export", *words, "--", os.fspath(self.directory)])[1]["file"])

    def _film(
        self,
        path: Path,
        format: str,
        frames: int | None,
        azimuth: float | None,
        elevation: float | None,
        turn: float,
        seconds: float | None,
        size: tuple[int, int],
    ) -> None:
        from .pictures import Picture, film

        if frames is not None and frames < 2:
            raise ValueError(f"frames = {frames}; expected at least 2")
        lasts = float(np.clip(self.t[-1], 2.0, 10.0)) if seconds is None else float(seconds)
        if not (np.isfinite(lasts) and lasts > 0.0):
            raise ValueError(f"seconds = {seconds}; expected a time above 0")
        # MP4 as most players know it has an even number of rows and columns.
        width, height = (2 * (side // 2) for side in size)
        if min(width, height) < 64:
            raise ValueError(f"size = {size}; expected at least 64 pixels each way")
        scene = self.scene
        target = (scene.to_dict().get("task") or {}).get("position_m")
        points = self.x.reshape(-1, 3) if target is None else np.vstack([self.x.reshape(-1, 3), target])
        picture = Picture(scene, points.min(axis=0), points.max(axis=0), size=(width, height))
        first, up = -60.0 if azimuth is None else azimuth, 20.0 if elevation is None else elevation
        # A GIF counts in hundredths of a second, and programs that show it are slow below two of them.
        times = np.linspace(self.t[0], self.t[-1], max(2, min(frames or round(20 * lasts), int(50 * lasts))))
        words = {"equilibrium": "load factor {:.3g}", "fit": "shape {:.0f}"}.get(self.command, "t = {:.2f} s")

        def shown() -> Any:
            for number, time in enumerate(times):
                row = int(np.abs(self.t - time).argmin())
                picture.turn(first + turn * number / (len(times) - 1), up)
                title = words.format(self.t[row])
                picture.draw(self.x[row], self.R[row], target=target, time=self.t[row], path=self.tip[: row + 1], title=title)
                yield picture.pixels()

        film(shown(), path, len(times) / lasts, format)

    def plot(self, ax: Any = None) -> Any:
        """Draws the arm at its first, last and some times (of an equilibrium, load factors; of a fit, shapes) between, and the path of the tip;
        needs matplotlib. Returns the axes.
        """
        import matplotlib.pyplot as plt  # type: ignore[import-not-found,import-untyped,unused-ignore]

        from .pictures import name_axes

        legend: dict[str, Any] = {}
        if ax is None:
            figure = plt.figure(figsize=(7, 5))
            # The legend has the left edge for itself.
            ax = figure.add_axes((0.18, 0.06, 0.78, 0.86), projection="3d")
            legend = {"bbox_to_anchor": (0.01, 0.98), "bbox_transform": figure.transFigure}
        rows = np.unique(np.linspace(0, len(self.t) - 1, 6).round().astype(int))
        for row in rows:
            shade = 0.25 + 0.75 * row / max(len(self.t) - 1, 1)
            words = {"equilibrium": f"load factor {self.t[row]:.3g}", "fit": f"shape {self.t[row]:.0f}"}
            label = words.get(self.command, f"t = {self.t[row]:.3g} s")
            ax.plot(*self.x[row].T, color=(0.1, 0.35, 0.6, shade), lw=2.5, label=label)
        ax.plot(*self.tip.T, color="0.3", lw=0.8)
        ax.set(title=f"{self.summary.get('scene')}: {self.status}")
        # A motion in a plane has a box with room for numbers too.
        least, most = self.x[rows].min(axis=(0, 1)), self.x[rows].max(axis=(0, 1))
        half = np.maximum(0.55 * (most - least), 0.2 * (most - least).max())
        for which, middle, part in zip("xyz", 0.5 * (least + most), half):
            getattr(ax, f"set_{which}lim")(middle - part, middle + part)
            ax.locator_params(axis=which, nbins=4 if part > 0.5 * half.max() else 2)
        name_axes(ax, half)
        # As long as it is said to be in each direction, and with room for the names of the axes.
        ax.set_box_aspect(half, zoom=0.8)
        ax.legend(fontsize="small", loc="upper left", **legend)
        return ax

    @property
    def page(self) -> str:
        """The page of the result, as HTML."""
        return (self.directory / "report.html").read_text()

    def _repr_html_(self) -> str:
        page = html.escape(self.page, quote=True)
        return f'<iframe srcdoc="{page}" style="width:100%;height:720px;border:0"></iframe>'

    def __repr__(self) -> str:
        summary = self.summary
        parts = [f"softarm.Result of {self.command} {summary.get('scene')!r}: {self.status}"]
        if self.command == "solve":
            parts.append(self.certificate.verdict)
            # A solve that was stopped early has neither.
            objective, off = summary.get("objective"), summary.get("tip_error_m")
            parts.append("no objective" if objective is None else f"objective {objective:.6g}")
            if off is not None:
                parts.append(f"tip {1e3 * off:.3g} mm off")
        if self.command == "mpc" and (off := (summary.get("tip_error_m") or {}).get("rms")) is not None:
            parts.append(f"tip {1e3 * off:.3g} mm off (rms), {summary['overruns']} of {summary['samples']} samples late")
        if summary.get("wall_s") is not None:
            parts.append(f"{summary['wall_s']:.3g} s")
        return f"<{', '.join(parts)}>"

    def __reduce__(self):
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_STORED) as file:
            for path in sorted(self.directory.iterdir()):
                if path.is_file():
                    file.write(path, path.name)
        return _unpack, (packed.getvalue(), self.exit_code)


_TEXT = {"name"}
"""Columns that are text, also where it spells numbers."""


def _column(name: str, fields: list[str]) -> np.ndarray:
    """Returns the fields of a column as whole numbers, flags, numbers or text, the first of these that all of them are."""
    if name not in _TEXT and fields:
        if all(field in ("true", "false") for field in fields):
            return np.array([field == "true" for field in fields])
        for kind, empty in ((int, None), (float, "nan")):
            try:
                return np.array([kind(field or empty) for field in fields])  # type: ignore[arg-type]
            except (ValueError, TypeError, OverflowError):
                continue
    return np.array(fields, dtype=str) if fields else np.empty(0, dtype=str if name in _TEXT else float)


def _distinct(names: list[str]) -> list[str]:
    """Gives a name that was there before a number."""
    out: list[str] = []
    for name in names:
        number, own = 2, name
        while own in out:
            number, own = number + 1, f"{name} {number}"
        out.append(own)
    return out


def _unpack(packed: bytes, exit_code: int | None) -> Result:
    holder = Folder()
    target = Path(holder.name) / "result"
    with zipfile.ZipFile(io.BytesIO(packed)) as file:
        file.extractall(target)
    return Result(target, holder, exit_code)


def load(directory: str | os.PathLike[str]) -> Result:
    """Returns the result in a directory."""
    return Result(directory)


def verify(directory: str | os.PathLike[str] | Result, *, quick: bool = False) -> Certificate:
    """Checks a saved solve again, by code that does not share the solver's assembly, and returns what it found. `quick` leaves out the
    second-order condition and the growth of disturbances.
    """
    from .scene import _call

    path = directory.directory if isinstance(directory, Result) else directory
    summary = _call(["verify", *(["--quick"] if quick else []), "--", os.fspath(path)])[1]
    return Certificate({**summary["check"], "mismatches": summary["mismatches"]})
