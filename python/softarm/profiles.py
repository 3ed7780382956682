"""Efforts and loads over time from tables: rows of `profile` of a scene, and inputs behind a play."""

from __future__ import annotations

import csv
import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np


def profile(source: Any, columns: Sequence[str | int] | None = None) -> list[list[float]]:
    """Returns the rows `[t, value, ...]` of a `profile`, `displacement_profile` or `gradient_profile` of a scene.

    `source` is the name of a CSV file, with names of its columns in the first line or without, a DataFrame, a Series whose index is the time in
    s, a dictionary of columns, or an array `(n, c)`. `columns` names the column of the time and those of the values, or gives their numbers;
    without it all are taken, in their order. Values are in the unit of the key.

    A row with a value that is empty or NaN is a gap and left out: since a profile is linear between its rows, it is linear across a gap; a gap at
    the start or the end is outside the profile. A time that is not finite, and a table without a value, is a `ValueError`.
    """
    names, rows = _read(source)
    if columns is not None:
        rows = rows[:, [_index(names, column, rows.shape[1]) for column in columns]]
    if rows.shape[1] < 2:
        raise ValueError(f"a profile has a column of times and at least one of values; this table has {rows.shape[1]}")
    if not np.isfinite(rows[:, 0]).all():
        raise ValueError(f"row {int(np.flatnonzero(~np.isfinite(rows[:, 0]))[0])} of a profile has the time {rows[~np.isfinite(rows[:, 0]), 0][0]}")
    kept = rows[~np.isnan(rows).any(axis=1)]
    if not len(kept):
        raise ValueError("a profile without any row of numbers")
    return [[float(number) for number in row] for row in kept]


def follow_with_play(commands: Any, play: Any) -> np.ndarray:
    """Returns the values that act under commands in the order of time, `(n,)` or `(n, m)`, of actuators with play, in the unit of the commands: one for
    all, or one for each of the `m`. The value that acts is the one before, moved as little as a distance from the command of at most `play` asks for; the
    first one is the command.
    """
    commands = np.asarray(commands, float)
    play = np.asarray(play, float)
    if not (np.isfinite(play).all() and (play >= 0.0).all()):
        raise ValueError(f"a play is a finite number of at least 0, and not {play}")
    acting = commands.copy()
    for i in range(1, len(commands)):
        acting[i] = np.clip(acting[i - 1], commands[i] - play, commands[i] + play)
    return acting


def _index(names: list[str], column: str | int, n: int) -> int:
    if isinstance(column, str):
        if column not in names:
            raise ValueError(f"the table has no column {column!r}; it has {names or 'no names'}")
        return names.index(column)
    if not -n <= column < n:
        raise ValueError(f"the table has no column {column}; it has {n}")
    return int(column)


def _read(source: Any) -> tuple[list[str], np.ndarray]:
    """Returns the names of the columns of a table, if they have any, and its numbers `(n, c)`."""
    if isinstance(source, (str, os.PathLike)):
        return _read_file(os.fspath(source))
    if isinstance(source, Mapping) or hasattr(source, "columns"):
        columns = [np.asarray(source[name], dtype=float) for name in source]
        if len({column.shape for column in columns}) > 1 or any(column.ndim != 1 for column in columns):
            raise ValueError("the columns of a profile have different lengths")
        return [str(name) for name in source], np.stack(columns, axis=1) if columns else np.zeros((0, 0))
    if hasattr(source, "index") and hasattr(source, "to_numpy"):
        source = np.stack([np.asarray(source.index, dtype=float), source.to_numpy(dtype=float)], axis=1)
    rows = np.asarray(source, dtype=float)
    if rows.ndim != 2:
        raise ValueError(f"a profile has the shape {rows.shape}; expected rows of time and values, (n, 2) or more columns")
    return [], rows


def _read_file(path: str) -> tuple[list[str], np.ndarray]:
    with open(path, newline="", encoding="utf-8-sig") as file:
        lines = [[field.strip() for field in row] for row in csv.reader(file) if any(field.strip() for field in row)]
    names: list[str] = []
    if lines and not all(_is_number(field) for field in lines[0]):
        names = lines.pop(0)
    width = len(names or (lines[0] if lines else []))
    rows = np.empty((len(lines), width))
    for i, fields in enumerate(lines):
        if len(fields) != width:
            raise ValueError(f"{path}: row {i + 1} has {len(fields)} fields; expected {width}")
        for j, field in enumerate(fields):
            if not _is_number(field):
                raise ValueError(f"{path}: row {i + 1} has {field!r} in column {j + 1}; expected a number, or an empty field for a gap")
            rows[i, j] = float(field or "nan")
    return names, rows


def _is_number(field: str) -> bool:
    try:
        float(field or "nan")
    except ValueError:
        return False
    return True


def is_table(value: Any) -> bool:
    """Tells whether a value is a table, and no list of rows as a scene has it."""
    return isinstance(value, (str, os.PathLike, Mapping, np.ndarray)) or hasattr(value, "to_numpy")


def with_rows(keys: Any, name: str = "") -> Any:
    """Returns the keys of a scene with the rows of every profile that is given as a table."""
    if name.rpartition(".")[2].endswith("profile") and is_table(keys):
        return profile(keys)
    if isinstance(keys, Mapping):
        return {key: with_rows(value, str(key)) for key, value in keys.items()}
    if isinstance(keys, (list, tuple)) and any(isinstance(own, Mapping) for own in keys):
        return [with_rows(own) for own in keys]
    return keys
