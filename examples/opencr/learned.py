"""Does a learned rest help OpenCR's arm?

    python examples/opencr/learned.py

Each of the three segments gets a potential of its bending with 25 weights, which are fitted to the training rows around `fitted.toml`, with the
zeros and the play of `predicted.toml`. It prints the distances of the tip, without the mean of the differences, before and after.
"""

import tomllib
from pathlib import Path

import softarm as sa

FOLDER = Path(__file__).parent
ENDS = [0.0, 0.321715818, 0.656836461, 1.0]
PRIOR = 0.01  # J/m


def distances(result):
    """Distances of the training and of the held-out rows, mm."""
    return {case["name"]: 1e3 * case["aligned_rms_m"] for case in result.summary["cases"]}


def main():
    arm = sa.Scene.load(FOLDER / "fitted.toml")
    data = tomllib.loads((FOLDER / "predicted.toml").read_text())
    for table in data["table"]:
        table["csv"] = str(FOLDER / table["csv"])
    data.pop("free", None)
    before = distances(arm.fit(data, free=["base.position_m.2"]))
    grid = [[-25.0, 25.0, 5]] * 2  # 1/m
    parts = [{"from": start, "to": end, "strains": ["bend_1", "bend_2"], "grid": grid} for start, end in zip(ENDS, ENDS[1:])]
    free = [{"key": f"learned.{k}.weights", "prior": 0.0, "prior_sigma": PRIOR} for k in range(len(parts))]
    after = distances(arm.replace({"learned": parts}).fit(data | {"free": free}))
    for name, was in before.items():
        print(f"{name}: {was:.2f} mm without the rest, {after[name]:.2f} mm with it")
    return before, after


if __name__ == "__main__":
    main()
