"""Laws of memory for the winches of OpenCR's arm, compared on the rows that its fit has seen, by folds of them, and on those that are held out.

    python examples/opencr/memory.py

Every law changes the displacements by little, so that tips follow to first order from the shapes of `fitted.toml` and their derivatives along the
displacements; the other 34 numbers are fitted anew, to first order too. A law's own shape (a width, a time) is the one of a short list that fits the
training rows best. Folds leave out every fifth pattern; "singles to pairs" fits the patterns that pull one segment and predicts those that pull two. All
errors are in mm, without the mean of the differences except by folds, whose mean is that of the rows that they were fitted to.
"""

from __future__ import annotations

import csv
import tomllib
from pathlib import Path

import numpy as np

import softarm as sa

HERE = Path(__file__).resolve().parent
WINCHES = range(9)


def follow(command: np.ndarray, play: np.ndarray) -> np.ndarray:
    """Returns what acts under commands, row by row, with a play that differs from row to row."""
    behind = np.zeros_like(command)
    for i in range(1, len(command)):
        behind[i] = np.clip(behind[i - 1] - (command[i] - command[i - 1]), -play[i], play[i])
    return command + behind


def filtered(command: np.ndarray, t: np.ndarray, tau: float) -> np.ndarray:
    """Returns commands, linear in time between rows, behind a lag of first order."""
    out = command.copy()
    for i in range(1, len(command)):
        speed = (command[i] - command[i - 1]) / (t[i] - t[i - 1])
        late = out[i - 1] - command[i - 1] + speed * tau
        out[i] = command[i] - speed * tau + late * np.exp(-(t[i] - t[i - 1]) / tau)
    return out


def rubbed(command: np.ndarray, length: float) -> np.ndarray:
    """Returns the state from -1 to 1 of Dahl's law of friction, which is Bouc's and Wen's with exponent one, that turns over within a length (m)."""
    out = np.zeros_like(command)
    for i in range(1, len(command)):
        way = command[i] - command[i - 1]
        out[i] = np.sign(way) + (out[i - 1] - np.sign(way)) * np.exp(-abs(way) / length)
    return out


def read() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, int, dict]:
    """Returns times, patterns, displacements of the winches without play (m), tips (m), the number of rows that are fitted, and the table's keys."""
    tables = tomllib.loads((HERE / "predicted.toml").read_text())["table"]
    rows = [list(csv.DictReader(open(HERE / table["csv"]))) for table in tables]
    columns = tables[0]["inputs"]
    every = [row for part in rows for row in part]
    t = np.array([float(row["timestamp"]) for row in every])
    pattern = np.array([row["pattern_label"].removesuffix("_hold") for row in every])
    tips = 1e-3 * np.array([[float(row[f"tip_{axis}"]) for axis in "xyz"] for row in every])
    z = np.array([[own["times"] * float(row[name]) + own["plus"] for name, own in columns.items()] for row in every])
    return t - t[0], pattern, z, tips, len(rows[0]), columns


class Tips:
    """Differences of predicted and measured tips, mm, to first order in displacements and numbers."""

    def __init__(self) -> None:
        self.t, self.pattern, self.command, tips, self.n, columns = read()
        self.play = next(iter(columns.values()))["play"]
        self.acting = sa.follow_with_play(self.command, self.play)
        marker = tomllib.loads((HERE / "predicted.toml").read_text())["marker"][0]["offset_m"][2]
        scene = sa.Scene.load(HERE / "fitted.toml")
        winches = [f"tendon.{i}.rest_displacement_m" for i in WINCHES]
        disks = [f"tendon.{i}.disk_spacing_m" for i in WINCHES]
        places = [f"tendon.{i}.offset_m.{axis}" for i in WINCHES for axis in (0, 1)]
        own = ["rod.material.youngs_modulus_pa", "rod.section.radius_m"]
        keys = winches + disks + places + own
        shapes = scene.shapes(changes={key: self.acting[:, i] for i, key in enumerate(winches)}, gradient=keys)
        axis = shapes.R[:, -1, :, 2]
        self.off = 1e3 * (shapes.tips + marker * axis - tips)
        moved, turned = (part[:, :, -1] for part in shapes.along)
        turned = np.einsum("nij,npj->npi", shapes.R[:, -1], np.cross(turned, [0.0, 0.0, marker]))
        along = 1e3 * (moved + turned).transpose(0, 2, 1)
        self.winches = along[:, :, :9]
        ones = np.ones((len(axis), 1, 1))
        self.base = 1e3 * ones * np.eye(3)
        tail = [along[:, :, 9:18].sum(2, keepdims=True), along[:, :, 18:], 1e3 * axis[:, :, None], self.base, self.winches]
        self.numbers = np.concatenate(tail, axis=2)
        turn = np.array([self.bend(shapes.R, *ends) for ends in ((0, 6), (6, 12), (12, 18))])
        passed = [0, 0, 0, 1, 1, 1, 2, 2, 2]
        self.turned, self.turned_square = (np.cumsum(own, axis=0)[passed].T for own in (turn, turn**2))

    @staticmethod
    def bend(rotations: np.ndarray, start: int, end: int) -> np.ndarray:
        """Returns the angle between the sections of two nodes, rad."""
        trace = np.einsum("nji,nji->n", rotations[:, start], rotations[:, end])
        return np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))

    def errors(self, change: np.ndarray, extra: np.ndarray | None = None) -> list[float]:
        """Returns the errors of training, of folds, of pairs after singles, and of the rows held out, if the winches differ by `change` from those of
        the fit and the columns `extra` belong to numbers of their own."""
        off = self.off + np.einsum("nij,nj->ni", self.winches, change)
        columns = self.numbers if extra is None else np.concatenate([self.numbers, extra], axis=2)
        scale = np.sqrt((columns**2).mean((0, 1)))
        columns = columns / np.where(scale > 0.0, scale, 1.0)
        is_fitted = np.arange(len(off)) < self.n

        def after(rows: np.ndarray) -> np.ndarray:
            flat = columns[rows].reshape(-1, columns.shape[2])
            normal = flat.T @ flat / len(flat) + 1e-10 * np.eye(flat.shape[1])
            return off - columns @ np.linalg.solve(normal, flat.T @ off[rows].ravel() / len(flat))

        def size(rest: np.ndarray) -> float:
            return float(np.sqrt(((rest - rest.mean(0)) ** 2).sum(1).mean()))

        whole = after(is_fitted)
        names = list(dict.fromkeys(self.pattern[: self.n]))
        fold = np.array([names.index(name) % 5 if name in names else -1 for name in self.pattern])
        squares = 0.0
        for k in range(5):
            rest = after(is_fitted & (fold != k))
            rest = rest - rest[is_fitted & (fold != k)].mean(0)
            squares += float((rest[fold == k] ** 2).sum())
        is_pair = np.array(["pair" in name for name in self.pattern])
        pairs = after(is_fitted & ~is_pair)[is_pair]
        return [size(whole[: self.n]), float(np.sqrt(squares / self.n)), size(pairs), size(whole[self.n :])]

    def best(self, name: str, count: int, laws: dict, *, beside_play: bool = False) -> None:
        """Prints the law that fits the training rows best: its change of the winches, or the columns of its numbers."""
        start = np.zeros_like(self.command) if beside_play else self.command - self.acting
        found = []
        for shape, (change, columns) in laws.items():
            extra = None if columns is None else np.stack([np.einsum("nij,nj->ni", self.winches, own) for own in columns], axis=2)
            found.append((self.errors(start + change, extra), shape))
        (train, folds, pairs, held), shape = min(found, key=lambda own: own[0][0])
        print(f"| {name}{' ' + shape if shape else ''} | {count} | {train:.2f} | {folds:.2f} | {pairs:.2f} | {held:.2f} |", flush=True)


def main() -> None:
    """Prints the table."""
    tips = Tips()
    t, command, none = tips.t, tips.command, np.zeros_like(tips.command)
    gap = np.diff(t, prepend=t[0] - 1.0)[:, None]
    speed = np.where(gap < 1.0, np.diff(command, axis=0, prepend=command[:1]) / gap, 0.0)
    times, widths = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0), (3e-5, 4e-5, 5e-5, 6e-5, 7e-5, 8e-5)
    slow = {f"of {tau:g} s": (none, [filtered(command, t, tau) - command]) for tau in times}
    plays = {f"of {1e3 * w:g} mm": (sa.follow_with_play(command, w) - command, None) for w in widths}
    rubs = {f"over {1e3 * x:g} mm": (none, [rubbed(command, x)]) for x in (5e-5, 1e-4, 2e-4, 5e-4, 1e-3)}
    several = [sa.follow_with_play(command, w) - command for w in (2e-5, 5e-5, 1e-4, 2e-4, 5e-4, 1e-3)]
    turning = {
        f"of {1e3 * w:g} mm and {1e3 * c:g} mm/rad": (follow(command, w + c * tips.turned) - command, None)
        for w in (0.0, 2e-5, 4e-5)
        for c in (1e-5, 2e-5, 4e-5)
    }
    print("| law of the winches | numbers | training | folds | singles to pairs | held out |\n|---|---|---|---|---|---|")
    tips.best("none", 0, {"": (none, None)})
    tips.best("late by", 1, {f"{x:g} s": (-x * speed, None) for x in (0.06, 0.08, 0.1)})
    tips.best("Prony: one lag", 2, slow)
    tips.best("Bouc-Wen", 2, rubs)
    tips.best("play", 1, plays)
    tips.best("play that grows with the turn of the arm,", 2, turning)
    tips.best("play, one for each winch", 9, {"": (none, list(np.eye(9)[:, None, :] * (sa.follow_with_play(command, 5e-5) - command)))})
    tips.best("Prandtl-Ishlinskii, six plays", 6, {"": (none, several)})
    tips.best("play of the fit, and one lag", 3, slow, beside_play=True)
    tips.best("play of the fit, and zeros that drift with time", 2, {"": (none, [t[:, None] * np.ones(9)])}, beside_play=True)
    loss = tips.turned_square * command
    tips.best("play of the fit, and a loss of pull with the square of the turn", 2, {"": (none, [loss])}, beside_play=True)


if __name__ == "__main__":
    main()
