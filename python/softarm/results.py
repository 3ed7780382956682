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

    @property
    def efforts(self) -> np.ndarray:
        """Rows of `efforts.csv`: `t`, s, `name` of an actuator, its `effort` (tension of a tendon or cable in N, pressure of a chamber in Pa,
        activation of a muscle, field of a magnet in T or T/m) and its `coordinate`; with winches `displacement`, m.
        """
        return self.table("efforts.csv")

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

    def plot(self, ax: Any = None) -> Any:
        """Draws the arm at its first, last and some times (of an equilibrium, load factors; of a fit, shapes) between, and the path of the tip;
        needs matplotlib. Returns the axes.
        """
        import matplotlib.pyplot as plt  # type: ignore[import-not-found,import-untyped,unused-ignore]

        if ax is None:
            ax = plt.figure(figsize=(6, 5)).add_subplot(projection="3d")
        rows = np.unique(np.linspace(0, len(self.t) - 1, 6).round().astype(int))
        for row in rows:
            shade = 0.25 + 0.75 * row / max(len(self.t) - 1, 1)
            words = {"equilibrium": f"load factor {self.t[row]:.3g}", "fit": f"shape {self.t[row]:.0f}"}
            label = words.get(self.command, f"t = {self.t[row]:.3g} s")
            ax.plot(*self.x[row].T, color=(0.1, 0.35, 0.6, shade), lw=2.5, label=label)
        ax.plot(*self.tip.T, color="0.3", lw=0.8)
        ax.set(xlabel="x (m)", ylabel="y (m)", zlabel="z (m)", title=f"{self.summary.get('scene')}: {self.status}")
        # A motion in a plane has a box with room for numbers too.
        least, most = self.x[rows].min(axis=(0, 1)), self.x[rows].max(axis=(0, 1))
        half = np.maximum(0.55 * (most - least), 0.2 * (most - least).max())
        for which, middle, part in zip("xyz", 0.5 * (least + most), half):
            getattr(ax, f"set_{which}lim")(middle - part, middle + part)
            ax.locator_params(axis=which, nbins=4)
        ax.set_aspect("equal")
        ax.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.1, 0.5))
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
