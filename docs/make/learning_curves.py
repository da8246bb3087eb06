"""Learning curves of the single-file examples with five seeds each: a picture for every page of docs/tasks.

python docs/make/learning_curves.py out/curves            # trains what is missing there, one by one, and draws
python docs/make/learning_curves.py out/curves MaxRate    # of one task, or one script
"""

from __future__ import annotations

import argparse
import csv
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from tasks import PAGES

from edmsim.envs.registry import env_id_of
from edmsim.evaluation import leaderboard
from edmsim.evaluation.lines import lines_of
from edmsim.recording.figures.palette import BLUE, MUTED, VERMILION

ROOT = Path(__file__).parents[2]
SEEDS = (1, 2, 3, 4, 5)
_LEARNED = re.compile(r"(?<=<!-- learned -->\n).*?(?=<!-- /learned -->)", re.DOTALL)
LEGEND_LETTERS = 66
"""Letters of three lines' labels that have room side by side."""
LIMIT = 0.1
"""Cost of an episode that ppo_lag.py keeps to by default."""


class Training(NamedTuple):
    """A script, its options, and the decisions of one training."""

    script: str
    options: tuple[str, ...]
    decisions: int


TASKS = {"GapFeed": 102_400, "HeightStep": 102_400, "Corner": 24_576, "Contour": 24_576, "MaxRate": 61_440,
         "ThinWire": 16_384}  # fmt: skip
"""Decisions of a training in each task: small numbers, so that five take half an hour of a processor at most."""
SLOWER = {"Contour": ("--decision-s", "0.25")}
"""An episode of Contour has 11,760 decisions else."""
TRAININGS = {
    **{task: Training("ppo", ("--env", env_id_of(task), *SLOWER.get(task, ())), n) for task, n in TASKS.items()},
    "ppo_lag": Training("ppo_lag", (), 102_400),
    "recurrent_ppo": Training("recurrent_ppo", (), 20_480),
}
TITLES = {"ppo_lag": "ppo_lag.py, thin wire", "recurrent_ppo": "recurrent_ppo.py, one window seen"}


def curve(folder: Path, name: str, seed: int) -> np.ndarray:
    """Return a learning curve (rows, 3), decisions, return and cost; trains if there is none yet."""
    file, training = folder / f"{name}-{seed}.csv", TRAININGS[name]
    if not file.exists():
        partial = file.with_suffix(".part")
        program = ROOT / "examples" / "learning" / f"{training.script}.py"
        arguments = ["--seed", str(seed), "--steps", str(training.decisions), "--out", str(partial)]
        subprocess.run([sys.executable, program, *arguments, *training.options], check=True)
        partial.rename(file)
    with file.open(newline="") as rows:
        return np.array([[float(value) for value in row] for row in list(csv.reader(rows))[1:]])


def on_grid(curves: list[np.ndarray], column: int) -> tuple[np.ndarray, np.ndarray]:
    """Return decisions (n,), from where all seeds have ended an episode, and a column of every seed (seeds, n)."""
    decisions = np.unique(np.concatenate([rows[:, 0] for rows in curves]))
    decisions = decisions[decisions >= max(rows[0, 0] for rows in curves)]
    return decisions, np.array([np.interp(decisions, rows[:, 0], rows[:, column]) for rows in curves])


def plot(axes: Axes, curves: list[np.ndarray], column: int, colour: str) -> np.ndarray:
    """Draw every seed thinly and their median; return the values."""
    decisions, values = on_grid(curves, column)
    axes.plot(decisions / 1e3, values.T, color=colour, lw=0.7, alpha=0.5)
    axes.plot(decisions / 1e3, np.median(values, axis=0), color=colour, lw=1.8)
    axes.set_xlabel("decisions, thousands")
    axes.set_xlim(0, None)
    axes.set_ylabel("return of an episode" if column == 1 else "cost of an episode")
    axes.spines[["top", "right"]].set_visible(False)
    return values


def lines_to_draw(task: str) -> dict[str, float]:
    """Return the mean returns of a task's two reference lines and of its best classic law, by their labels."""
    env_id = env_id_of(task)
    figures, lines = leaderboard.read(ROOT / "docs" / "leaderboard.json")[env_id].figures, lines_of(env_id)
    ends = lines.blind, lines.reference
    laws = [name for name in figures if name not in ends and not name.startswith("policy:")]
    best = max(laws, key=lambda name: figures[name]["score"].value)
    named = {"score 1": lines.reference, "best law": best, "score 0": lines.blind}
    return {f"{label}: {_short(name)}": figures[name]["total_return"].value for label, name in named.items()}


def _short(name: str) -> str:
    return name.replace("open_target_share=0.05,", "").replace(":open_target_share=0.05", "")


def draw_task(task: str, curves: list[np.ndarray]) -> None:
    """Draw a task's curves with its lines, from what is reached after a third on: what is less is learned soon."""
    figure, axes = plt.subplots(figsize=(6.4, 3.2))
    values = plot(axes, curves, 1, BLUE)
    lines = lines_to_draw(task)
    for (label, height), style in zip(lines.items(), ("-", "--", ":"), strict=True):
        axes.axhline(height, color=MUTED, lw=1.0, ls=style, label=label)
    median = np.median(values, axis=0)
    low, high = min(*lines.values(), median[len(median) // 3]), max(*lines.values(), values.max())
    axes.set_ylim(low - 0.08 * (high - low), high + 0.08 * (high - low))
    rows = 1 if sum(map(len, lines)) < LEGEND_LETTERS else 2
    axes.legend(
        fontsize=8, frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4 - rows, borderpad=0.0
    )
    figure.tight_layout()
    figure.savefig(ROOT / "docs" / "tasks" / f"{PAGES[task]}-learning.png", dpi=110)


def draw_scripts(found: Mapping[str, list[np.ndarray]]) -> None:
    """Draw the two other scripts, and what keeping wires costs one of them."""
    figure, panels = plt.subplots(1, 3, figsize=(10.5, 3.0))
    shown = ("ppo_lag", 1, VERMILION), ("ppo_lag", 2, VERMILION), ("recurrent_ppo", 1, BLUE)
    for axes, (name, column, colour) in zip(panels, shown, strict=True):
        plot(axes, found[name], column, colour)
        axes.set_title(TITLES[name], fontsize=9)
    panels[1].axhline(LIMIT, color="black", lw=0.8, ls="--")
    panels[1].set_ylim(0, None)
    figure.tight_layout()
    figure.savefig(ROOT / "docs" / "learning-curves.png", dpi=110)


def learned(name: str, curves: list[np.ndarray]) -> str:
    """Return what the last twenty episodes brought: the median of the seeds, the least and the greatest."""
    last = np.array([rows[-1] for rows in curves])
    earned, cost = (
        f"{np.median(v):.{d}f} ({v.min():.{d}f} to {v.max():.{d}f})" for v, d in ((last[:, 1], 0), (last[:, 2], 2))
    )
    return (
        f"After {TRAININGS[name].decisions:,} decisions the last twenty episodes earned {earned},\n"
        f"at a cost of {cost} each: the median of five seeds, the least and the greatest."
    )


def with_learned(page: str, text: str) -> str:
    """Return a page with that sentence."""
    return _LEARNED.sub(lambda _: text + "\n", page)


def main() -> None:
    """Train what is missing, draw, and say what was learned."""
    parser = argparse.ArgumentParser(description="Learning curves of the single-file examples.")
    parser.add_argument("folder", type=Path, help="folder of the curves; those that are there are kept")
    parser.add_argument("names", nargs="*", choices=[*TRAININGS, []], help="tasks or scripts; all by default")
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    found = {name: [curve(asked.folder, name, seed) for seed in SEEDS] for name in asked.names or TRAININGS}
    for name, curves in found.items():
        print(f"{name}: {learned(name, curves)}")
        if name in TASKS:
            draw_task(name, curves)
            page = ROOT / "docs" / "tasks" / f"{PAGES[name]}.md"
            text = page.read_text(encoding="utf-8")
            page.write_text(with_learned(text, learned(name, curves)), encoding="utf-8")
    if set(TITLES) <= set(found):
        draw_scripts(found)


if __name__ == "__main__":
    main()
