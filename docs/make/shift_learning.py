"""What `adaptive-hold` learns in a shift: a picture for each of the two pages of docs/tasks on shifts.

python docs/make/shift_learning.py                 # both
python docs/make/shift_learning.py MaxRateShift    # one

The machine is a training machine, with the seed in `SHOWN`.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np
from sections import DOCS

from edmsim.controllers import from_text
from edmsim.controllers.feed.law import ServoLaw
from edmsim.controllers.feed.periods import AdaptiveHold
from edmsim.envs.episode import Task
from edmsim.evaluation.episode import OF_TASK, Episode
from edmsim.recording.figures.palette import BLUE, MUTED

THIN = next(law for law in OF_TASK["ThinWireShift"].compared if law.startswith("adaptive-hold"))
SHOWN = {
    "MaxRateShift": ("max-rate-shift", 104, "adaptive-hold"), "ThinWireShift": ("thin-wire-shift", 106, THIN),
}  # fmt: skip
"""Name of the page, seed of a machine whose wires have a limit within reach of the supply, and the law."""
EVERY_S = 2.0


def followed(task: str, seed: int, name: str) -> tuple[np.ndarray, list[float]]:
    """Return rows of time, held flux, and the limit's 5, 50 and 95 % (n, 5); and times when wires broke."""
    law = from_text(name)
    assert isinstance(law, ServoLaw)
    rule = law.period
    assert isinstance(rule, AdaptiveHold)
    cut = Task(task)
    rows, broke_s, lost = [], [], 0
    for window in Episode(cut, law, seed, name).windows():
        time_s = window.observation.time_s
        if not rows or time_s >= rows[-1][0] + EVERY_S:
            rows.append((time_s, rule.hold, *(rule.limit(share) for share in (0.05, 0.5, 0.95))))
        if cut.wires_lost > lost:
            lost = cut.wires_lost
            broke_s.append(time_s)
    return np.array(rows), broke_s


def draw(task: str) -> None:
    """Draw a shift."""
    page, seed, name = SHOWN[task]
    rows, broke_s = followed(task, seed, name)
    figure, axes = plt.subplots(figsize=(6.4, 3.0))
    minutes = rows[:, 0] / 60.0
    likely = "limit, 90 % interval"
    axes.fill_between(minutes, rows[:, 2], rows[:, 4], color=MUTED, alpha=0.25, lw=0, label=likely)
    axes.plot(minutes, rows[:, 3], color=MUTED, lw=1.0, ls="--", label="its median")
    axes.plot(minutes, rows[:, 1], color=BLUE, lw=1.5, label="flux held")
    for k, time_s in enumerate(broke_s):
        axes.axvline(time_s / 60.0, color="0.2", lw=0.8, ls=":", label="a wire breaks" if k == 0 else None)
    axes.set_xlabel("shift, min")
    axes.set_ylabel("flux / critical flux")
    axes.set_xlim(0, minutes[-1])
    axes.set_ylim(0, 1.25 * max(rows[:, 1].max(), float(np.median(rows[:, 4]))))
    axes.legend(fontsize=8, frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, borderpad=0.0)
    axes.spines[["top", "right"]].set_visible(False)
    figure.tight_layout()
    figure.savefig(DOCS / "tasks" / f"{page}-learning.png", dpi=110)


if __name__ == "__main__":
    for task in sys.argv[1:] or SHOWN:
        draw(task)
