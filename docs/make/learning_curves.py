"""Learning curves of examples/learning with five seeds: a picture for every page of docs/tasks, one for training.md.

python docs/make/learning_curves.py out/curves            # makes missing trainings, one by one, and draws
python docs/make/learning_curves.py out/curves MaxRate    # ppo.py in one task
python docs/make/learning_curves.py out/curves examples   # recurrent_ppo.py and ppo_lag.py
"""

import argparse
import csv
import subprocess
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from sections import DOCS, write_sections
from tasks import PAGES

from edmsim.envs.registry import env_id_of
from edmsim.evaluation.compare import leaderboard
from edmsim.evaluation.episode import lines_of
from edmsim.learning.score import in_words
from edmsim.recording.figures.palette import BLUE, MUTED

SEEDS = (1, 2, 3, 4, 5)
LEGEND_LETTERS = 66
"""Total length of three lines' labels that fit in a row."""
NAME_LETTERS = 32
"""Greatest length of a law's name with parameters; a longer one is shown without them, because the page's table has
them."""
TASKS = {"GapFeed": 204_800, "HeightStep": 204_800, "Corner": 98_304, "Contour": 49_152, "MaxRate": 122_880,
         "ThinWire": 65_536, "Trim": 81_920}  # fmt: skip
"""Decisions of a training in each task, so that five trainings take a quarter of an hour of processor time."""
EXAMPLES = {"recurrent_ppo": 61_440, "ppo_lag": 204_800}
"""Decisions of a training with the other two examples."""
STEPS = {**TASKS, **EXAMPLES}
COST_LIMIT = 0.1
"""Bound of `ppo_lag.py` for the mean cost of an episode (ours)."""
OWN = {
    "Contour": ("--decision-s", "0.25"), "Trim": ("--action", "speed"), "ppo_lag": ("--limit", str(COST_LIMIT)),
}
"""Further options: an episode of Contour would have 11,760 decisions; a trim has no front for a servo to follow."""


def curve(folder: Path, name: str, seed: int) -> np.ndarray:
    """Return a learning curve (rows, 3): decisions, return and cost; train if its file is missing.

    `name` is a task, in which `ppo.py` trains, or another example.
    """
    file = folder / f"{name}-{seed}.csv"
    if not file.exists():
        partial = file.with_suffix(".part")
        program, where = ("ppo", ("--env", env_id_of(name))) if name in TASKS else (name, ())
        arguments = ["--seed", str(seed), "--steps", str(STEPS[name]), "--out", str(partial), *OWN.get(name, ())]
        file_of = DOCS.parent / "examples" / "learning" / f"{program}.py"
        subprocess.run([sys.executable, file_of, *where, *arguments], check=True)
        partial.rename(file)
    with file.open(newline="") as rows:
        return np.array([[float(value) for value in row] for row in list(csv.reader(rows))[1:]])


def on_grid(curves: list[np.ndarray], column: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Return decisions (n,), from the first at which all seeds have ended an episode, and a column (seeds, n)."""
    decisions = np.unique(np.concatenate([rows[:, 0] for rows in curves]))
    decisions = decisions[decisions >= max(rows[0, 0] for rows in curves)]
    return decisions, np.array([np.interp(decisions, rows[:, 0], rows[:, column]) for rows in curves])


def lines_to_draw(task: str) -> dict[str, float]:
    """Return the mean returns of a task's two reference lines and of its best classic law, by label."""
    env_id = env_id_of(task)
    figures, lines = leaderboard(DOCS / "leaderboard.jsonl")[env_id, "fast"].figures, lines_of(env_id)
    ends = lines.blind, lines.reference
    laws = [name for name in figures if name not in ends and not name.startswith("policy:")]
    best = max(laws, key=lambda name: figures[name]["total_return"].value)
    named = {"score 1": lines.reference, "best law": best, "score 0": lines.blind}
    return {f"{label}: {_short(name)}": figures[name]["total_return"].value for label, name in named.items()}


def _short(name: str) -> str:
    text = name.replace("open_target_share=0.05,", "").replace(":open_target_share=0.05", "")
    return text if len(text) <= NAME_LETTERS else text.partition(":")[0]


def draw_task(task: str, curves: list[np.ndarray]) -> None:
    """Draw every seed's curve, their median and a task's lines.

    The axis begins at the least median after a third of the training, without the low returns before.
    """
    figure, axes = plt.subplots(figsize=(6.4, 3.2))
    decisions, values = on_grid(curves)
    median, lines = np.median(values, axis=0), lines_to_draw(task)
    _draw_seeds(axes, decisions, values)
    for (label, height), style in zip(lines.items(), ("-", "--", ":"), strict=True):
        axes.axhline(height, color=MUTED, lw=1.0, ls=style, label=label)
    low, high = min(*lines.values(), median[len(median) // 3 :].min()), max(*lines.values(), values.max())
    axes.set_xlim(0, None)
    axes.set_ylim(low - 0.08 * (high - low), high + 0.08 * (high - low))
    rows = 1 if sum(map(len, lines)) < LEGEND_LETTERS else 2
    axes.legend(
        fontsize=8, frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4 - rows, borderpad=0.0
    )
    axes.set_ylabel("return of an episode")
    figure.tight_layout()
    figure.savefig(DOCS / "tasks" / f"{PAGES[task]}-learning.png", dpi=110)


def _draw_seeds(axes: Axes, decisions: np.ndarray, values: np.ndarray) -> None:
    """Draw every seed's curve, and their median."""
    axes.plot(decisions / 1e3, values.T, color=BLUE, lw=0.7, alpha=0.5)
    axes.plot(decisions / 1e3, np.median(values, axis=0), color=BLUE, lw=1.8)
    axes.set_xlabel("decisions, thousands")
    axes.spines[["top", "right"]].set_visible(False)


def draw_examples(curves: dict[str, list[np.ndarray]]) -> None:
    """Draw the returns of both examples, and the cost of the example with a bound."""
    figure, panels = plt.subplots(1, 3, figsize=(9.0, 2.8))
    shown = ("recurrent_ppo", 1, "return"), ("ppo_lag", 1, "return"), ("ppo_lag", 2, "cost")
    for axes, (name, column, label) in zip(panels, shown, strict=True):
        _draw_seeds(axes, *on_grid(curves[name], column))
        axes.set_xlim(0, None)
        axes.set_title(f"{name}.py", fontsize=10, loc="left")
        axes.set_ylabel(f"{label} of an episode")
    panels[-1].axhline(COST_LIMIT, color=MUTED, lw=1.0, ls="--", label="bound")
    panels[-1].set_ylim(0, None)
    panels[-1].legend(fontsize=8, frameon=False, loc="upper right")
    figure.tight_layout()
    figure.savefig(DOCS / "training-examples.png", dpi=110)


def learned(name: str, curves: list[np.ndarray]) -> str:
    """Return the text on the last twenty episodes: median, least and greatest of the seeds."""
    last = np.array([rows[-1] for rows in curves])
    reward, cost = (
        f"{np.median(v):.{d}f} ({v.min():.{d}f} to {v.max():.{d}f})" for v, d in ((last[:, 1], 0), (last[:, 2], 2))
    )
    decisions, values = on_grid(curves)
    curve = in_words(decisions.astype(int).tolist(), np.median(values, axis=0).tolist())
    return (
        f"After {STEPS[name]:,} decisions the last twenty episodes earned {reward},\n"
        f"at a cost of {cost} each: the median of five seeds, the least and the greatest.\n"
        f"The curve of their median: {curve.replace('steps', 'decisions')}."
    )


def main() -> None:
    """Make the missing trainings, draw, and write the results into the pages."""
    parser = argparse.ArgumentParser(description="Learning curves of examples/learning.")
    parser.add_argument("folder", type=Path, help="folder of the curves; those that are there are kept")
    parser.add_argument("which", nargs="*", choices=[*TASKS, "examples", []], help="tasks, examples; all by default")
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    which = arguments.which or [*TASKS, "examples"]
    for task in TASKS:
        if task in which:
            curves = [curve(arguments.folder, task, seed) for seed in SEEDS]
            draw_task(task, curves)
            write_sections(f"tasks/{PAGES[task]}.md", {"learned": learned(task, curves)})
    if "examples" in which:
        of_both = {name: [curve(arguments.folder, name, seed) for seed in SEEDS] for name in EXAMPLES}
        draw_examples(of_both)
        said = "\n\n".join(f"`{n}.py`: {learned(n, of)}" for n, of in of_both.items())
        write_sections("training.md", {"learned": said})


if __name__ == "__main__":
    main()
