"""Candidates for the reference lines of tasks, on training machines; `OF_TASK` was chosen from them.

python docs/make/lines.py Corner Trim    # prints a table for each task; all by default

None of these machines is used in comparisons.
"""

import sys
from collections.abc import Sequence
from functools import partial

import numpy as np
from sections import table

from edmsim.envs.registry import env_id_of
from edmsim.evaluation.episode import Result, cut_job, engine_of
from edmsim.runs import perform

SET_POINT = "set-point:open_target_share="
PACE = "open_target_share=0.05"
CORNER_PULSES = "on_factor=1,period_factor=0.7"
FEEDS = (range(100, 124), tuple(f"fixed:feed_um_s={feed}" for feed in (12, 16, 20, 24, 28)))
TASKS: dict[str, tuple[range, tuple[str, ...]]] = {
    "GapFeed": FEEDS,
    "HeightStep": FEEDS,
    "Corner": (range(200, 248), (
        *(f"{SET_POINT}0.5,on_factor={on:g},period_factor={period:g}" for on in (1.0, 0.7)
          for period in (0.35, 0.5, 0.7, 1.0)),
        *(f"{SET_POINT}{share:g},{CORNER_PULSES}" for share in (0.3, 0.4, 0.6, 0.7)),
        *(f"lead-oracle:open_target_share=0.6,{CORNER_PULSES},average_s={average_s:g}"
          for average_s in (0.02, 0.05, 0.1, 0.25)),
        *(f"{SET_POINT}0.6,{CORNER_PULSES},pull_N_m={pull:g},fade_um={fade}"
          for pull in (-0.3, -0.5, -0.7) for fade in (25, 50)),
        f"{SET_POINT}0.4,{CORNER_PULSES},before_um=20,behind_um=100,corner_factor=2",
    )),
    "Trim": (range(100, 148), (
        *(f"fixed:feed_um_s={feed},offset_um={off}" for feed in (50, 100, 200) for off in (-8, -5, -2, 1, 4, 7)),
        *(f"{SET_POINT}{share:g},proportional_um_s=200,integral_um_s2=400,offset_um={off}"
          for share in (0.4, 0.5, 0.6, 0.7) for off in (-4, -2, 0)),
    )),
    "ThinWire": (range(100, 124), (
        *(f"{SET_POINT}0.05,period_factor={factor:g}" for factor in (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0)),
        *(f"climb:{PACE},period_factor={factor:g}" for factor in (0.7, 1.0, 2.0)),
        *(f"climb:{PACE},climb_s={seconds:g}" for seconds in (2.5, 1.25)),
    )),
    "MaxRate": (range(1, 25), (
        *(f"fixed-period:period_us={period}" for period in (35, 40, 45, 50, 60)),
        *(f"heat-flux:hold_share={share:g}" for share in (0.3, 0.4, 0.5)),
        *(f"heat-oracle:hold_share={share:g}" for share in (0.2, 0.4)),
        *(f"sato:normal_at_10mm={pulses}" for pulses in (150, 300, 600)),
    )),
}  # fmt: skip
"""Seeds and candidates by task."""


def results(task: str) -> str:
    """Return the mean returns and the lost wires of a task's candidates, as a table of Markdown."""
    seeds, candidates = TASKS[task]
    env_id, jobs = env_id_of(task), [(name, seed) for name in candidates for seed in seeds]

    def watch(done: int, total: int) -> None:
        sys.stderr.write(f"\r{task}: {done} of {total} cuts")

    cuts = perform(partial(cut_job, env_id), jobs, watch, engine=engine_of(env_id, len(jobs)))
    sys.stderr.write("\n")
    rows = [_row(name, cuts[n * len(seeds) : (n + 1) * len(seeds)]) for n, name in enumerate(candidates)]
    return table(("candidate", "return", "net rate, mm2/min", "wires lost", "jams"), rows)


def _row(name: str, cuts: Sequence[Result]) -> tuple[str, ...]:
    reward, rate = (float(np.mean([getattr(c, what) for c in cuts])) for what in ("total_return", "rate_mm2_min"))
    lost, jams = sum(c.wires_lost for c in cuts), sum(c.jammed for c in cuts)
    return f"`{name}`", f"{reward:.0f}", f"{rate:.1f}", str(lost), str(jams)


def main() -> None:
    """Print the tables of the requested tasks."""
    for task in sys.argv[1:] or TASKS:
        seeds = TASKS[task][0]
        print(f"{task}, seeds {seeds[0]} to {seeds[-1]}:", "", results(task), "", sep="\n")


if __name__ == "__main__":
    main()
