"""Scenes: what an arm, a task, a loop are, and the verbs that work on them."""

from __future__ import annotations

import copy
import csv
import json
import logging
import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from . import _softarm
from .control import Controller, Plant
from .errors import ModelError, ResultError, SceneError
from .profiles import with_rows
from .program import Program
from .results import Folder, Result

if TYPE_CHECKING:
    from .rollout import Rollout



@dataclass(frozen=True)
class Shapes:
    """Shapes of an arm at rest."""

    x: npt.NDArray[np.float64]
    """Positions of the nodes, m, `(n, K+1, 3)`."""
    R: npt.NDArray[np.float64]
    """Rotations of the nodes, body to space, `(n, K+1, 3, 3)`."""
    jacobian: npt.NDArray[np.float64] | None = None
    """Derivatives of the tip's position along the inputs, `(n, 3, m)`, NaN of a shape that nothing holds in some direction, as where it is about to buckle; `None` if not asked for."""
    stable: npt.NDArray[np.bool_] | None = None
    """Whether the shapes are stable, `(n,)`; `None` if not asked for."""
    along: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]] | None = None
    """Derivatives of positions, `(n, p, K+1, 3)`, and rotations, rad in the frames of the nodes in the same shape, along the `p` numbers of `gradient`;
    NaN of a shape that nothing holds in some direction, as where it is about to buckle; `None` if not asked for."""

    @property
    def tips(self) -> npt.NDArray[np.float64]:
        """Positions of the tip, m, `(n, 3)`."""
        return self.x[:, -1]


Event = Callable[[dict[str, Any]], None]
TASK_VERBS = ("simulate", "solve", "mpc", "equilibrium", "tradeoff")
"""Verbs of tasks; a fit depends on files, and has `Scene.fit` alone."""
LOG = logging.getLogger("softarm")


def schema() -> dict[str, Any]:
    """Returns the JSON Schema of a scene: every key with its type, unit, default and description."""
    return json.loads(_softarm.schema())


def _plain(value: Any) -> Any:
    """Returns numpy numbers and arrays, tuples and paths as what JSON knows."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    return value


def _quoted(text: str) -> str:
    """Returns a text as a basic string of TOML, which unlike JSON has no pairs of surrogates and escapes U+007F."""
    try:
        text.encode()
    except UnicodeEncodeError as error:
        raise ValueError(f"{text!r} is no text of Unicode: {error.reason}") from None
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _literal(value: Any) -> str:
    """Returns a value as TOML on one line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, str):
        return _quoted(value)
    if isinstance(value, list):
        return "[" + ", ".join(map(_literal, value)) + "]"
    if isinstance(value, dict):
        rows = (f"{_quoted(key)} = {_literal(item)}" for key, item in value.items() if item is not None)
        return "{ " + ", ".join(rows) + " }"
    raise TypeError(f"a scene has numbers, texts, lists and dictionaries; {value!r} is a {type(value).__name__}")


def override(key: str, value: Any) -> str:
    """Returns a value of a dotted key as an override `KEY=VALUE`."""
    return f"{key}={_literal(_plain(with_rows(value, key)))}"


def _toml(keys: Mapping[str, Any]) -> str:
    """Returns a dictionary as the text of a scene: values first, then a section for every dictionary and list of dictionaries."""
    values: list[str] = []
    sections: list[str] = []

    def add(path: str, table: dict[str, Any], header: str) -> None:
        if header:
            sections.append(header)
        rows = sections if header else values
        later = []
        for key, value in table.items():
            name = key if key.replace("_", "").isalnum() and key.isascii() else _quoted(key)
            place = f"{path}.{name}" if path else name
            if isinstance(value, dict):
                later.append((place, value, f"\n[{place}]"))
            elif isinstance(value, list) and value and all(isinstance(item, dict) for item in value):
                later.extend((place, item, f"\n[[{place}]]") for item in value)
            elif value is not None:
                rows.append(f"{name} = {_literal(value)}")
        for place, item, line in later:
            add(place, item, line)

    add("", _plain(keys), "")
    return "\n".join(values + sections) + "\n"


def _remove(keys: dict[str, Any], path: str) -> None:
    """Takes the key at a dotted path away, where it is."""
    *parents, last = path.split(".")
    at: Any = keys
    try:
        for part in parents:
            at = at[int(part)] if isinstance(at, list) else at[part]
        del at[int(last) if isinstance(at, list) else last]
    except (KeyError, IndexError, ValueError, TypeError):
        raise KeyError(f"{path} is no key of this scene, and cannot be taken away") from None


def _is_a_name(text: str) -> bool:
    """Tells whether what was given as the text of a scene is its name: a line without any key or section."""
    line = text.strip()
    return bool(line) and not any(mark in line for mark in "\n=[#")


class Scene:
    """A scene: a dictionary with the keys of a scene file, or the text of one.

    Raises `SceneError`, with the key, the line and a remedy, for a scene that cannot be used. A scene does not change: `replace` returns
    another one. Paths in a dictionary are relative to the working directory. The rows of a `profile` may be an array, a DataFrame or the name of a
    CSV file, as `softarm.profile` reads them.
    """

    __slots__ = ("_name", "_text", "_overrides", "_keys")

    def __init__(self, keys: Mapping[str, Any] | str, *, name: str = "scene"):
        self._name = name
        self._overrides: tuple[str, ...] = ()
        if isinstance(keys, os.PathLike) or (isinstance(keys, str) and _is_a_name(keys)):
            given = os.fspath(keys)
            raise SceneError(f"{given!r} is a name, and no text of a scene; Scene.load({given!r}) reads files and built-in scenes")
        text = keys if isinstance(keys, str) else _toml(with_rows(keys))
        self._text, self._keys = _softarm.parse(name, text, [])

    @classmethod
    def load(cls, name_or_path: str | os.PathLike[str]) -> Scene:
        """Returns the scene of a file, or the built-in scene of this name; `softarm.builtin_scenes()` lists them."""
        name = os.fspath(name_or_path)
        text, keys = _softarm.parse(name, None, [])
        return cls._of(name, text, (), keys)

    @classmethod
    def _of(cls, name: str, text: str, overrides: tuple[str, ...], keys: dict[str, Any]) -> Scene:
        scene = object.__new__(cls)
        scene._name, scene._text, scene._overrides, scene._keys = name, text, overrides, keys
        return scene

    def replace(self, keys: Mapping[str, Any] | None = None, /, **more: Any) -> Scene:
        """Returns the scene with other values of some keys: `scene.replace({"rod.elements": 40, "load.0.force_n": [0, 0, 1]})`. A value of None
        takes the key away, so that its default holds.
        """
        given = {**(keys or {}), **more}
        if gone := [key for key, value in given.items() if value is None]:
            rest = self.to_dict()
            for key in gone:
                _remove(rest, key)
            kept = {key: value for key, value in given.items() if value is not None}
            return Scene(rest, name=self._name).replace(kept)
        overrides = (*self._overrides, *(override(key, value) for key, value in given.items()))
        _, resolved = _softarm.parse(self._name, self._text, list(overrides))
        return self._of(self._name, self._text, overrides, resolved)

    @property
    def name(self) -> str:
        """Name of the scene, by which results say where they come from."""
        return Path(self._name).stem

    @property
    def text(self) -> str:
        """Text of the scene as it was read, without what was replaced."""
        return self._text

    def to_dict(self) -> dict[str, Any]:
        """Returns the scene with every default written out."""
        return copy.deepcopy(self._keys)

    def __getitem__(self, key: str) -> Any:
        """Returns the value of a dotted key, with defaults: `scene["rod.elements"]`."""
        value: Any = self._keys
        for part in key.split("."):
            value = value[int(part)] if isinstance(value, list) else value[part]
        return value

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Scene) and self._keys == other._keys

    def __hash__(self) -> int:
        return hash(json.dumps(self._keys, sort_keys=True))

    def __repr__(self) -> str:
        sections = ", ".join(key for key, value in self._keys.items() if isinstance(value, (dict, list)))
        return f"<softarm.Scene {self.name!r}: {sections}>"

    def __reduce__(self):
        return Scene._of, (self._name, self._text, self._overrides, self._keys)

    def _call(self, verb: str, words: list[str], on_event: Event | None = None) -> tuple[int, dict[str, Any]]:
        for override in self._overrides:
            words.append(f"--set={override}")
        return _call([verb, *words, "--", self._name], (self._name, self._text), on_event)

    def _run(self, verb: str, out: str | os.PathLike[str] | None, words: list[str], on_event: Event | None) -> Result:
        holder: Folder | None = None
        if out is None:
            holder = Folder()
            out = Path(holder.name) / verb
        try:
            code, _ = self._call(verb, [f"--out={os.fspath(out)}", *words], on_event)
        except KeyboardInterrupt as interrupt:
            # Ctrl-C asks the work to stop; its best result is there by now.
            if (Path(out) / "summary.json").is_file():
                interrupt.partial = Result(out, holder)  # type: ignore[attr-defined]
            raise
        return Result(out, holder, code)

    def check(self, *, threads: int | None = None) -> dict[str, Any]:
        """Returns what follows from the scene before anything is solved: weight, frequencies, static needs, stable step, warnings."""
        return self._call("check", _options(threads=threads))[1]

    def simulate(
        self,
        out: str | os.PathLike[str] | None = None,
        *,
        accuracy: float | None = None,
        on_event: Event | None = None,
    ) -> Result:
        """Simulates the arm. Without `out` the files live as long as the result."""
        return self._run("simulate", out, _options(accuracy=accuracy), on_event)

    def solve(
        self,
        out: str | os.PathLike[str] | None = None,
        *,
        starts: int = 1,
        start_from: Result | str | os.PathLike[str] | None = None,
        deep: bool = False,
        accuracy: float | None = None,
        threads: int | None = None,
        seed: int | None = None,
        on_event: Event | None = None,
    ) -> Result:
        """Computes the controls, and checks them by a forward simulation. A solve that does not converge is a status of the result.

        `starts` counts the initial guesses of which the best certified one is kept, `start_from` is an earlier result to begin with, `deep`
        checks the second-order condition and the growth of disturbances too, and `on_event` is called with every iteration.
        """
        earlier = start_from.directory if isinstance(start_from, Result) else start_from
        words = _options(starts=starts, accuracy=accuracy, threads=threads, seed=seed)
        if earlier is not None:
            words.append(f"--from={os.fspath(earlier)}")
        if deep:
            words.append("--deep")
        return self._run("solve", out, words, on_event)

    def mpc(
        self,
        out: str | os.PathLike[str] | None = None,
        *,
        baselines: bool = False,
        threads: int | None = None,
        seed: int | None = None,
        on_event: Event | None = None,
    ) -> Result:
        """Runs the closed loop of the scene, and with `baselines` the same loop under other laws."""
        words = _options(threads=threads, seed=seed) + (["--baselines"] if baselines else [])
        return self._run("mpc", out, words, on_event)

    def equilibrium(
        self,
        out: str | os.PathLike[str] | None = None,
        *,
        to: float = 1.0,
        points: int = 21,
        time: float = 0.0,
        accuracy: float | None = None,
        gradient: Sequence[str] = (),
    ) -> Result:
        """Computes the arm at rest, its stability, and its shapes over the load factor up to `to`.

        With `gradient` the result has `along`: the derivatives of the shape under the whole loads along numbers of the scene by their keys, those of
        positions `(p, K+1, 3)` and of rotations, rad in the frames of the nodes. They are those of `shapes`, and need the number of elements and `time` 0.
        """
        result = self._run("equilibrium", out, _options(to=to, points=points, time=time, accuracy=accuracy), None)
        if gradient:
            if time != 0.0:
                raise ValueError("gradient is that of the arm under its whole loads at time 0: leave `time` out")
            found = self.shapes(gradient=gradient)
            whole = result.x[np.argmin(np.abs(result.t - 1.0))]
            if whole.shape != found.x[0].shape or np.abs(whole - found.x[0]).max() > 1e-6 * np.abs(whole).max():
                raise ModelError("the shape that follows from the one at rest is another one than that of a search near it, or has other elements")
            result.along = None if found.along is None else (found.along[0][0], found.along[1][0])
        return result

    @property
    def inputs(self) -> list[tuple[str, str]]:
        """Names and units of the inputs of `shapes`: the efforts of all actuators along the arm, of winches displacements in m."""
        return [(name, unit) for name, unit, _ in _softarm.inputs(self._name, self._text, list(self._overrides))]

    def shapes(
        self,
        inputs: Any = None,
        *,
        changes: Mapping[str, Any] | None = None,
        gradient: Sequence[str] = (),
        jacobian: bool = False,
        stability: bool = False,
        threads: int | None = None,
    ) -> Shapes:
        """Computes the arm at rest under each of `n` rows of inputs, `(n, m)`, or a dictionary of columns by the names of actuators, whose
        others are zero, or what follows from that of another one; without inputs they are those of the scene. An input beyond the bounds of its
        actuator is refused, as by `Plant.step`. `changes` has columns of numbers by the keys of the scene that they
        change from row to row: loads, moduli, places. Rows that change little from one to the next are fast, because every search begins at the shape of the row before.

        With `jacobian` the derivatives of the tip's position along the inputs are computed too, with `gradient` those of all nodes along numbers
        by their keys (moduli, places of tendons, loads, the base), and with `stability` whether the shapes are stable. A row without a shape at rest raises `ModelError`.
        """
        if isinstance(inputs, Mapping):
            known = _softarm.inputs(self._name, self._text, list(self._overrides))
            names = [name for name, _, _ in known]
            unknown = [name for name in inputs if name not in names]
            if unknown:
                raise ValueError(f"there is no actuator {unknown[0]!r}; those of the arm are {names}")
            columns = np.broadcast_arrays(*(np.atleast_1d(np.asarray(column, float)) for column in inputs.values()))
            rows = np.tile([np.nan if follows else 0.0 for _, _, follows in known], (len(columns[0]) if columns else 1, 1))
            for name, column in zip(inputs, columns, strict=True):
                rows[:, names.index(name)] = column
            inputs = rows
        changed = {key: np.atleast_1d(np.asarray(column, float)) for key, column in (changes or {}).items()}
        if changed and inputs is not None:
            inputs = np.atleast_2d(np.asarray(inputs, float))
            n = max(len(inputs), *(len(column) for column in changed.values()))
            inputs = np.repeat(inputs, n, axis=0) if len(inputs) == 1 else inputs
            changed = {key: np.repeat(column, n) if len(column) == 1 else column for key, column in changed.items()}
        listed = [(key, column.tolist()) for key, column in changed.items()]
        overrides = list(self._overrides)
        found = _softarm.shapes(self._name, self._text, overrides, inputs, listed, list(gradient), jacobian, stability, threads)
        return Shapes(*found)

    def tradeoff(
        self,
        out: str | os.PathLike[str] | None = None,
        *,
        tolerance: float = 1e-3,
        budget: str = "60s",
        threads: int | None = None,
        on_event: Event | None = None,
    ) -> Result:
        """Measures error against time over discretizations, and recommends one for a tolerance (in lengths of the arm)."""
        return self._run("tradeoff", out, _options(tolerance=tolerance, budget=budget, threads=threads), on_event)

    def fit(
        self,
        data: Mapping[str, Any] | str | os.PathLike[str],
        free: Sequence[str] | str = (),
        out: str | os.PathLike[str] | None = None,
        *,
        robust: bool = False,
        threads: int | None = None,
    ) -> Result:
        """Fits numbers of the scene, named by their dotted keys, to measured places of markers: a file as in docs/fitting.md, or a dictionary
        with its keys, whose tables are relative to the working directory. `result.scene` has the fitted numbers.

        Instead of the name of a table, `csv` of a recording may be the table itself: a DataFrame, or a dictionary of columns by their names.
        """
        words = _options(threads=threads) + (["--robust"] if robust else [])
        free = [free] if isinstance(free, str) else list(free)
        words += [f"--free={','.join(free)}"] if free else []
        if not isinstance(data, Mapping):
            return self._run("fit", out, [f"--data={os.fspath(data)}", *words], None)
        keys = _plain(_with_columns(data))
        with tempfile.TemporaryDirectory(prefix="softarm-") as folder:
            tables = [*keys.get("recording", []), *keys.get("table", [])]
            for index, recording in enumerate(tables):
                recording["csv"] = _table_file(recording, index, folder)
            path = Path(folder) / "data.toml"
            path.write_text(_toml(keys), encoding="utf-8")
            return self._run("fit", out, [f"--data={os.fspath(path)}", *words], None)

    def controller(self) -> Controller:
        """Returns the controller of the closed loop, for a plant of one's own."""
        return Controller(lambda: _softarm.Controller(self._name, self._text, list(self._overrides)))

    def program(self) -> Program:
        """Returns the optimal-control problem as arrays, for a solver of one's own."""
        return Program(_softarm.Program(self._name, self._text, list(self._overrides)), self)

    def rollout(self, dt: float, numbers: Sequence[str] = (), *, linear: bool = False, nodes: Sequence[int] = ()) -> Rollout:
        """Returns motions of that arm under sequences of controls, with derivatives along the controls, the state at the start and some numbers of
        the scene."""
        from .rollout import Rollout

        return Rollout(self, dt, numbers, linear=linear, nodes=nodes)

    def plant(self) -> Plant:
        """Returns the simulated arm: of `[plant]` in a scene with a closed loop, else of `[rod]`."""
        return Plant(_softarm.Plant(self._name, self._text, list(self._overrides)), self)


def _with_columns(data: Mapping[str, Any]) -> dict[str, Any]:
    """Returns data of a fit whose recordings and tables have a table in `csv` as lists by the names of its columns."""

    def columns(table: Any) -> Any:
        if isinstance(table, (str, os.PathLike)):
            return os.fspath(table)
        try:
            return {str(name): list(table[name]) for name in table.keys()}
        except (AttributeError, TypeError) as error:
            raise ResultError(
                "`csv` of a recording is the name of a table, a DataFrame, or a dictionary of columns by their names"
            ) from error

    changed = {}
    for kind in ("recording", "table"):
        tables = [
            {key: columns(value) if key == "csv" else value for key, value in table.items()}
            for table in data.get(kind, [])
        ]
        if tables:
            changed[kind] = tables
    return {**data, **changed}


def _table_file(recording: Mapping[str, Any], index: int, folder: str) -> str:
    """Returns the absolute path of the table of a recording; one that is given as columns is written into the folder."""
    if "csv" not in recording:
        raise ResultError(
            f"recording {index} has no `csv`: give the name of a table, or the table itself as a DataFrame or a dictionary of its columns "
            '"t_s", "NAME_x_m", "NAME_y_m", "NAME_z_m"; docs/fitting.md'
        )
    table = recording["csv"]
    if isinstance(table, str):
        return os.path.abspath(table)
    if len({len(column) for column in table.values()}) > 1:
        raise ResultError(f"recording {index}: the columns of `csv` have different lengths")
    path = Path(folder) / f"recording-{index}.csv"
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(table)
        writer.writerows(zip(*table.values()))
    return str(path)


def _options(**values: Any) -> list[str]:
    """Returns options of the command line; those that are None are left out."""
    return [f"--{name}={value}" for name, value in values.items() if value is not None]


def _call(
    words: list[str], scene: tuple[str, str] | None = None, on_event: Event | None = None
) -> tuple[int, dict[str, Any]]:
    """Runs a verb, and returns its exit code and summary. Messages go to the logger `softarm`."""
    summary: dict[str, Any] = {}

    def hear(kind: str, line: str) -> None:
        if kind == "data":
            event = json.loads(line)
            if event.get("event") == "summary":
                summary.update(event)
                del summary["event"]
            elif on_event is not None:
                on_event(event)
        elif kind == "message":
            LOG.info("%s", line)
        else:
            LOG.warning("%s", line)

    code = _softarm.call([words[0], "--json-lines", *words[1:]], scene, hear)
    return code, summary


def batch(
    scene: Scene, n: int, *, each: Mapping[str, Sequence[Any]] | None = None, threads: int | None = None
) -> _softarm.Batch:
    """Returns `n` arms of a scene that move at the same time, on several threads. `each` has values of their own for some keys:
    `sa.batch(scene, 3, each={"rod.material.youngs_modulus_pa": [1e5, 2e5, 3e5]})`.
    """
    own = None
    if each is not None:
        for key, values in each.items():
            if len(values) != n:
                raise ValueError(f"{key} has {len(values)} values; expected one for each of the {n} arms")
        own = [[override(key, values[i]) for key, values in each.items()] for i in range(n)]
    return _softarm.Batch(n, scene._name, scene._text, list(scene._overrides), threads, own)


class _TaskScene(Scene):
    """A scene whose results are kept in folders with names by what they depend on, as `--skip-existing` does."""

    __slots__ = ("_more", "_told")

    def __init__(self, scene: Scene, more: list[str], told: dict[str, Any]):
        self._name, self._text, self._overrides, self._keys = scene._name, scene._text, scene._overrides, scene._keys
        self._more, self._told = more, told

    def _run(self, verb: str, out: Any, words: list[str], on_event: Event | None) -> Any:
        def hear(event: dict[str, Any]) -> None:
            if event["event"] == "result":
                self._told.update(event)
            elif on_event is not None:
                on_event(event)

        return self._call(verb, ["--skip-existing", f"--out={os.fspath(out)}", *self._more, *words], hear)


def run(task: Mapping[str, Any], folder: str | os.PathLike[str] | None = None, *, small: bool = False) -> dict[str, Any]:
    """Runs one task of a sweep: `{"verb": "solve", "scene": ..., "set": {...}, "options": {...}}`. It is pure and picklable.

    `scene` is a `Scene`, a dictionary or a name, `verb` one of `TASK_VERBS`, and `options` its arguments. Returns
    `{"key": ..., "exit_code": ..., "summary": ...}`. With a folder the result is kept in `folder/KEY`, as `softarm VERB --skip-existing`
    keeps it, where KEY is a hash of verb, options, version and the scene with all defaults; a result that is there already is not computed
    again (`"skipped"`). `small` keeps its numbers alone. What a scene or a computation has wrong is returned as `"error"`, so that one task
    does not end a sweep; a task of another form is a `ValueError`.
    """
    from .errors import SoftarmError

    unknown = set(task) - {"verb", "scene", "set", "options"}
    if unknown:
        raise ValueError(f"a task has verb, scene, set and options, and no {sorted(unknown)}")
    verb = task.get("verb", "solve")
    if verb not in TASK_VERBS:
        raise ValueError(f"verb = {verb!r}; expected one of {TASK_VERBS}")
    told: dict[str, Any] = {}
    with tempfile.TemporaryDirectory(prefix="softarm-") as passing:
        try:
            given = task["scene"]
            scene = given if isinstance(given, Scene) else Scene.load(given) if isinstance(given, str) else Scene(given)
            scene = scene.replace(task.get("set", {}))
            own = _TaskScene(scene, ["--small"] if small else [], told)
            code, summary = getattr(own, verb)(passing if folder is None else folder, **task.get("options", {}))
        except SoftarmError as error:
            return {"key": told.get("key"), "exit_code": None, "summary": {}, "error": str(error)}
    if told["there"]:
        return {"key": told["key"], "exit_code": None, "summary": summary, "skipped": True}
    return {"key": told["key"], "exit_code": code, "summary": summary}
