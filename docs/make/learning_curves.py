"""Learning curves of examples/learning/ppo.py with five seeds: a picture for every page of docs/tasks.

python docs/make/learning_curves.py out/curves            # trains what is missing there, one by one, and draws
python docs/make/learning_curves.py out/curves MaxRate    # of one task
"""

from __future__ import annotations

import argparse
import csv
import subprocess
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from tasks import PAGES, with_block

from edmsim.envs.registry import env_id_of
from edmsim.evaluation import leaderboard
from edmsim.evaluation.lines import lines_of
from edmsim.recording.figures.palette import BLUE, MUTED

ROOT = Path(__file__).parents[2]
SEEDS = (1, 2, 3, 4, 5)
LEGEND_LETTERS = 66
"""Letters of three lines' labels that have room side by side."""
NAME_LETTERS = 32
"""A law of more numbers than that is named without them: the table beside the picture has them."""
TASKS = {"GapFeed": 102_400, "HeightStep": 102_400, "Corner": 24_576, "Contour": 24_576, "MaxRate": 61_440,
         "ThinWire": 16_384, "Trim": 20_480}  # fmt: skip
"""Decisions of a training in each task: small numbers, so that five take half an hour of a processor at most."""
OWN = {"Contour": ("--decision-s", "0.25"), "Trim": ("--action", "speed")}
"""An episode of Contour has 11,760 decisions else; a pass has no front that a servo could follow."""


def curve(folder: Path, task: str, seed: int) -> np.ndarray:
    """Return a learning curve (rows, 3), decisions, return and cost; trains if there is none yet."""
    file = folder / f"{task}-{seed}.csv"
    if not file.exists():
        partial = file.with_suffix(".part")
        program = ROOT / "examples" / "learning" / "ppo.py"
        arguments = ["--seed", str(seed), "--steps", str(TASKS[task]), "--out", str(partial)]
        subprocess.run(
            [sys.executable, program, "--env", env_id_of(task), *arguments, *OWN.get(task, ())], check=True
        )
        partial.rename(file)
    with file.open(newline="") as rows:
        return np.array([[float(value) for value in row] for row in list(csv.reader(rows))[1:]])


def on_grid(curves: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return decisions (n,), from where all seeds have ended an episode, and the return of every seed (seeds, n)."""
    decisions = np.unique(np.concatenate([rows[:, 0] for rows in curves]))
    decisions = decisions[decisions >= max(rows[0, 0] for rows in curves)]
    return decisions, np.array([np.interp(decisions, rows[:, 0], rows[:, 1]) for rows in curves])


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
    text = name.replace("open_target_share=0.05,", "").replace(":open_target_share=0.05", "")
    return text if len(text) <= NAME_LETTERS else text.partition(":")[0]


def draw_task(task: str, curves: list[np.ndarray]) -> None:
    """Draw every seed thinly, their median and a task's lines.

    What is less than is reached after a third of the training is learned soon, and left out.
    """
    figure, axes = plt.subplots(figsize=(6.4, 3.2))
    decisions, values = on_grid(curves)
    median, lines = np.median(values, axis=0), lines_to_draw(task)
    axes.plot(decisions / 1e3, values.T, color=BLUE, lw=0.7, alpha=0.5)
    axes.plot(decisions / 1e3, median, color=BLUE, lw=1.8)
    for (label, height), style in zip(lines.items(), ("-", "--", ":"), strict=True):
        axes.axhline(height, color=MUTED, lw=1.0, ls=style, label=label)
    low, high = min(*lines.values(), median[len(median) // 3]), max(*lines.values(), values.max())
    axes.set_xlim(0, None)
    axes.set_ylim(low - 0.08 * (high - low), high + 0.08 * (high - low))
    rows = 1 if sum(map(len, lines)) < LEGEND_LETTERS else 2
    axes.legend(
        fontsize=8, frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4 - rows, borderpad=0.0
    )
    axes.set_xlabel("decisions, thousands")
    axes.set_ylabel("return of an episode")
    axes.spines[["top", "right"]].set_visible(False)
    figure.tight_layout()
    figure.savefig(ROOT / "docs" / "tasks" / f"{PAGES[task]}-learning.png", dpi=110)


def learned(task: str, curves: list[np.ndarray]) -> str:
    """Return what the last twenty episodes brought: the median of the seeds, the least and the greatest."""
    last = np.array([rows[-1] for rows in curves])
    earned, cost = (
        f"{np.median(v):.{d}f} ({v.min():.{d}f} to {v.max():.{d}f})" for v, d in ((last[:, 1], 0), (last[:, 2], 2))
    )
    return (
        f"After {TASKS[task]:,} decisions the last twenty episodes earned {earned},\n"
        f"at a cost of {cost} each: the median of five seeds, the least and the greatest."
    )


def main() -> None:
    """Train what is missing, draw, and say what was learned."""
    parser = argparse.ArgumentParser(description="Learning curves of examples/learning/ppo.py.")
    parser.add_argument("folder", type=Path, help="folder of the curves; those that are there are kept")
    parser.add_argument("tasks", nargs="*", choices=[*TASKS, []], help="tasks; all by default")
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    for task in asked.tasks or TASKS:
        curves = [curve(asked.folder, task, seed) for seed in SEEDS]
        text = learned(task, curves)
        print(f"{task}: {text}")
        draw_task(task, curves)
        page = ROOT / "docs" / "tasks" / f"{PAGES[task]}.md"
        page.write_text(with_block(page.read_text(encoding="utf-8"), "learned", text + "\n"), encoding="utf-8")


if __name__ == "__main__":
    main()
