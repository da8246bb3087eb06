"""``docs/learning-curves.png`` and its table: the single-file examples of examples/learning with five seeds each.

python docs/make/learning_curves.py out/curves ppo      # trains what is missing there, one after the other, and draws
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
RUNS = {"ppo": 20_480, "ppo_lag": 20_480, "recurrent_ppo": 20_480}
"""Scripts, and windows of each training: small ones, so that five of a script take some minutes of a processor."""
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
    """Return windows (n,), from where all seeds have ended an episode, and a column of every seed (seeds, n)."""
    windows = np.unique(np.concatenate([rows[:, 0] for rows in curves]))
    windows = windows[windows >= max(rows[0, 0] for rows in curves)]
    return windows, np.array([np.interp(windows, rows[:, 0], rows[:, column]) for rows in curves])


def draw(found: dict[str, list[np.ndarray]], file: Path) -> None:
    """Draw every seed, and the median of them."""
    shown = [(script, 1) for script in found] + ([("ppo_lag", 2)] if "ppo_lag" in found else [])
    figure, panels = plt.subplots(1, len(shown), figsize=(1.5 + 3.0 * len(shown), 3.0), squeeze=False)
    for axes, (script, column) in zip(panels[0], shown, strict=True):
        windows, values = on_grid(found[script], column)
        axes.plot(windows / 1e3, values.T, color=COLOURS[script], lw=0.7, alpha=0.5)
        axes.plot(windows / 1e3, np.median(values, axis=0), color=COLOURS[script], lw=1.8)
        axes.set_title(LABELS[script], fontsize=9)
        axes.set_xlabel("windows, thousands")
        axes.set_xlim(0, None)
        axes.set_ylabel("return of an episode" if column == 1 else "cost of an episode")
        axes.spines[["top", "right"]].set_visible(False)
        if column == 2:
            axes.axhline(LIMIT, color="black", lw=0.8, ls="--")
            axes.set_ylim(0, None)
    figure.tight_layout()
    figure.savefig(file, dpi=110)


def table(found: dict[str, list[np.ndarray]]) -> str:
    """Return what the last twenty episodes brought: the median of the seeds, and the least and the greatest."""
    lines = ["| script | windows | return | cost |", "|---|---|---|---|"]
    for script, curves in found.items():
        last = np.array([rows[-1] for rows in curves])
        columns = (last[:, 1], 0), (last[:, 2], 2)
        told = [f"{np.median(v):.{d}f} ({v.min():.{d}f} to {v.max():.{d}f})" for v, d in columns]
        lines.append(f"| `{script}.py` | {RUNS[script]:,} | {told[0]} | {told[1]} |")
    return "\n".join(lines)


def main() -> None:
    """Train what is missing, draw, and print the table."""
    parser = argparse.ArgumentParser(description="Learning curves of the single-file examples.")
    parser.add_argument("folder", type=Path, help="folder of the curves; those that are there are kept")
    parser.add_argument("scripts", nargs="*", choices=[*RUNS, []], help="which of them; all by default")
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    found = {script: [curve(asked.folder, script, seed) for seed in SEEDS] for script in asked.scripts or RUNS}
    draw(found, ROOT / "docs" / "learning-curves.png")
    print(table(found))


if __name__ == "__main__":
    main()
