"""Draws what is in a result directory of softarm: the arm at several times, the way of its tip, and what acts on it.

    softarm solve reach
    python examples/plot_result.py results/reach-solve [picture.png]

Needs numpy and matplotlib. It reads only files that docs/files.md describes: summary.json, trajectory.npz and, where there is one, efforts.csv.
"""

import csv
import json
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

SHAPES = 12


def efforts_of(folder: Path) -> dict[str, list[tuple[float, float]]]:
    """Returns the times and efforts of every actuator in the arm by name; nothing of an arm without any."""
    efforts: dict[str, list[tuple[float, float]]] = {}
    if (folder / "efforts.csv").is_file():
        with open(folder / "efforts.csv", newline="") as file:
            for row in csv.DictReader(file):
                efforts.setdefault(row["name"], []).append((float(row["t"]), float(row["effort"])))
    return efforts


def main(folder: Path, picture: Path) -> None:
    summary = json.loads((folder / "summary.json").read_text())
    motion = np.load(folder / "trajectory.npz")
    t, x = motion["t"], motion["x"]  # s; rows, nodes, 3 in m
    tip = x[:, -1]

    figure = plt.figure(figsize=(11, 5), layout="constrained")
    space = figure.add_subplot(1, 2, 1, projection="3d")
    rows = np.unique(np.linspace(0, len(t) - 1, SHAPES).round().astype(int))
    for row in rows:
        color = plt.cm.viridis(row / max(len(t) - 1, 1))
        space.plot(*x[row].T, color=color, linewidth=2)
    space.plot(*tip.T, color="tab:red", linewidth=1, label="tip")
    space.set(xlabel="x, m", ylabel="y, m", zlabel="z, m", title=f"{len(rows)} shapes, dark to light")
    space.set_aspect("equal")
    space.legend()

    forces = figure.add_subplot(1, 2, 2)
    efforts = efforts_of(folder)
    title = "efforts of the actuators, each in its unit" if efforts else "force (space) and moment (body) on the tip"
    for name, rows in efforts.items():
        forces.plot(*np.array(rows).T, label=name)
    for axis, name in enumerate("xyz") if not efforts or motion["tip_force"].any() or motion["tip_moment"].any() else ():
        forces.plot(t, motion["tip_force"][:, axis], label=f"force {name}, N")
        forces.plot(t, motion["tip_moment"][:, axis], linestyle="--", label=f"moment {name}, N m")
    forces.set(xlabel="t, s", title=title)
    forces.legend(fontsize="small", ncols=2)
    forces.grid(alpha=0.3)

    figure.suptitle(f"{summary['scene']}: {summary['status']}, {summary['elements']} elements")
    figure.savefig(picture, dpi=130)
    print(picture)


if __name__ == "__main__":
    if not 2 <= len(sys.argv) <= 3:
        sys.exit(__doc__)
    directory = Path(sys.argv[1])
    main(directory, Path(sys.argv[2]) if len(sys.argv) == 3 else directory / "picture.png")
