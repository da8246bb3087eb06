"""``docs/learning-curves.png`` and its table: the single-file examples of examples/learning with five seeds each.

python docs/make/learning_curves.py out/curves            # trains what is missing there, one after the other, and draws
"""

from __future__ import annotations

import argparse
import csv
import subprocess
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from edmsim.recording.figures.palette import BLUE, ORANGE, VERMILION

ROOT = Path(__file__).parents[2]
SEEDS = (1, 2, 3, 4, 5)
RUNS = {"ppo": 61_440, "ppo_lag": 61_440, "recurrent_ppo": 40_960}
"""Scripts, and windows of each training: small ones, so that all fifteen take some minutes of a processor."""
LABELS = {"ppo": "PPO", "ppo_lag": "Lagrangian PPO, thin wire", "recurrent_ppo": "recurrent PPO, one window seen"}
COLOURS = dict(zip(RUNS, (BLUE, VERMILION, ORANGE), strict=True))
LIMIT = 0.1
"""Cost of an episode that ppo_lag.py keeps to by default."""


def curve(folder: Path, script: str, seed: int) -> np.ndarray:
    """Return a learning curve (rows, 3), windows, return and cost; trains if there is none yet."""
    file = folder / f"{script}-{seed}.csv"
    if not file.exists():
        partial = file.with_suffix(".part")
        program = ROOT / "examples" / "learning" / f"{script}.py"
        arguments = ["--seed", str(seed), "--steps", str(RUNS[script]), "--out", str(partial)]
        subprocess.run([sys.executable, program, *arguments], check=True)
        partial.rename(file)
    with file.open(newline="") as rows:
        return np.array([[float(value) for value in row] for row in list(csv.reader(rows))[1:]])


def on_grid(curves: list[np.ndarray], column: int) -> tuple[np.ndarray, np.ndarray]:
    """Return windows (n,), from where all seeds have an episode behind them, and a column of every seed (seeds, n)."""
    windows = np.unique(np.concatenate([rows[:, 0] for rows in curves]))
    windows = windows[windows >= max(rows[0, 0] for rows in curves)]
    return windows, np.array([np.interp(windows, rows[:, 0], rows[:, column]) for rows in curves])


def draw(found: dict[str, list[np.ndarray]], file: Path) -> None:
    """Draw every seed, and the median of them."""
    figure, panels = plt.subplots(1, len(found) + 1, figsize=(11.0, 3.0))
    shown = [(script, 1) for script in found] + [("ppo_lag", 2)]
    for axes, (script, column) in zip(panels, shown, strict=True):
        windows, values = on_grid(found[script], column)
        axes.plot(windows / 1e3, values.T, color=COLOURS[script], lw=0.7, alpha=0.5)
        axes.plot(windows / 1e3, np.median(values, axis=0), color=COLOURS[script], lw=1.8)
        axes.set_title(LABELS[script], fontsize=9)
        axes.set_xlabel("windows, thousands")
        axes.set_xlim(0, None)
        axes.set_ylabel("return of an episode" if column == 1 else "cost of an episode")
        axes.spines[["top", "right"]].set_visible(False)
    panels[-1].axhline(LIMIT, color="black", lw=0.8, ls="--")
    panels[-1].set_ylim(0, None)
    figure.tight_layout()
    figure.savefig(file, dpi=110)


def table(found: dict[str, list[np.ndarray]]) -> str:
    """Return what the last hundred episodes brought: the median of the seeds, and the least and the greatest."""
    lines = ["| script | windows | return | cost |", "|---|---|---|---|"]
    for script, curves in found.items():
        last = np.array([rows[-1] for rows in curves])
        told = [f"{np.median(v):.{d}f} ({v.min():.{d}f} to {v.max():.{d}f})" for v, d in ((last[:, 1], 0), (last[:, 2], 2))]
        lines.append(f"| `{script}.py` | {RUNS[script]:,} | {told[0]} | {told[1]} |")
    return "\n".join(lines)


def main() -> None:
    """Train what is missing, draw, and print the table."""
    parser = argparse.ArgumentParser(description="Learning curves of the single-file examples.")
    parser.add_argument("folder", type=Path, help="folder of the curves; those that are there are kept")
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    found = {script: [curve(folder, script, seed) for seed in SEEDS] for script in RUNS}
    draw(found, ROOT / "docs" / "learning-curves.png")
    print(table(found))


if __name__ == "__main__":
    main()
