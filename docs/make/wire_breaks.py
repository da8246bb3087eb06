"""How wires broke in shifts of training machines: how long they were dry before, and what was unusual at drying.

python docs/make/wire_breaks.py adaptive-hold      # writes the table of tasks/max-rate-shift.md

The hottest place of the wire is dry if its true temperature is above the boiling point by the superheat at which
steam covers the wire. The unusual figure is the greatest rate of ignitions in a fifth of the height over its mean of
a second, in the window in which the place dried or the one before.
"""

import argparse
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from sections import table, write_sections

from edmsim.controllers import from_text
from edmsim.controllers.feed.law import shorted
from edmsim.envs.episode import Task
from edmsim.evaluation.episode import Episode
from edmsim.machine.components import BOILING_K

ENV_ID, LAW = "edmsim/MaxRateShift-v0", "adaptive-hold"
SEEDS, SECONDS = range(22_002, 22_014), 600.0
USUAL_S = 1.0  # time constant of the mean ignitions in each fifth
SHORT_S = 0.05  # time in which a short counts as just cleared


class Break(NamedTuple):
    """A lost wire."""

    seed: int
    time_s: float
    dry_s: float  # time for which it was dry before it broke
    burst: float  # greatest ignitions of a fifth over their mean when it dried
    after_short: bool


def breaks(seed: int, name: str, seconds: float) -> Iterator[Break]:
    """Cut on a machine, and yield how each wire broke."""
    task = Task(ENV_ID, episode_s=seconds)
    episode = Episode(task, from_text(name), seed, name)
    dry_K = BOILING_K + task.scenario.machine.base.cooling.superheat_K.value
    usual, now = np.zeros(5), np.zeros(5)
    lost, since, cleared_s, burst, after_short = 0, None, math.inf, 0.0, False
    for result in episode.windows():
        window, truth = result.observation, result.truth
        if task.wires_lost > lost:
            lost = task.wires_lost
            dry_s = 0.0 if since is None else window.time_s - since
            yield Break(seed, window.time_s, dry_s, burst, after_short)
            since = None
            continue
        before, now = now, np.array(window.fifths) / window.duration_s
        cleared_s = 0.0 if shorted(window) else cleared_s + window.duration_s
        if truth.wire_temperature_K < dry_K:
            since = None
        elif since is None:
            since = window.time_s - window.duration_s
            burst = float((np.maximum(now, before) / np.maximum(usual, usual.max() / 5)).max())
            after_short = cleared_s < SHORT_S
        if not shorted(window):
            usual -= math.expm1(-window.duration_s / USUAL_S) * (now - usual)


def main() -> None:
    """Print every break, and write the table of the reference."""
    parser = argparse.ArgumentParser(description="Show how wires broke in shifts of training machines.")
    parser.add_argument("controller", nargs="?", default=LAW)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    arguments = parser.parse_args()
    heads = "machine", "broke after, s", "dry for, ms", "ignitions over the usual", "a short had cleared"
    rows = []
    for seed in SEEDS:
        for one in breaks(seed, arguments.controller, arguments.seconds):
            short = "yes" if one.after_short else "no"
            rows.append((str(seed), f"{one.time_s:.0f}", f"{1e3 * one.dry_s:.0f}", f"{one.burst:.2f}", short))
            print(*rows[-1], flush=True)
    if arguments.controller == LAW:
        write_sections("tasks/max-rate-shift.md", {"wire-breaks": table(heads, rows)})


if __name__ == "__main__":
    main()
