"""Returns of the shipped policy and two laws at finer resolutions and on other machines.

python docs/make/transfer.py    # writes the table of docs/tasks/gap-feed.md
"""

import operator
import sys
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from sections import table, write_sections

from edmsim.envs.arguments import ends_of
from edmsim.envs.registry import make_family
from edmsim.evaluation.compare import held_back, mean, shown
from edmsim.evaluation.episode import Result, cut, engine_of
from edmsim.runs import perform

ENV_ID = "edmsim/GapFeed-v2"
CONTROLLERS = ("policy:GapFeed-ppo", "delay", "counts")
CUTS = 12
"""Number of cuts, as in a comparison in GapFeed."""
MORE, LESS = 1.5, 0.5
"""Factors on the upper and the lower end of an environment's ranges, for conditions beyond them (ours)."""


def places() -> dict[str, dict[str, Any]]:
    """Return arguments of the environment by name: resolutions, and conditions beyond its ranges."""
    family = make_family(ENV_ID)
    (low, high), slack = (ends_of(name, getattr(family, name)) for name in ("height_mm", "tension"))
    return {
        "as trained": {}, "resolution default": {"resolution": "default"}, "resolution fine": {"resolution": "fine"},
        f"higher: {high:g} to {MORE * high:g} mm": {"height_mm": (high, MORE * high)},
        f"lower: {LESS * low:g} to {low:g} mm": {"height_mm": (LESS * low, low)},
        f"slack wire: {LESS * slack[0]:g} to {slack[0]:g} N": {"tension": (LESS * slack[0], slack[0])},
        "carbide": {"materials": ("cemented-carbide",)}, "copper": {"materials": ("copper",)},
    }


def cell(cuts: Sequence[Result]) -> str:
    """Return a controller's return, rate, and lost wires and jams."""
    names = "total_return", "rate_mm2_min"
    reward, rate = (mean(np.array([getattr(made, name) for made in cuts])) for name in names)
    return f"{shown(names[0], reward)}; {rate.value:.1f}; {sum(made.wires_lost + made.jammed for made in cuts)}"


def main() -> None:
    """Make the cuts, and write the table."""
    jobs = {
        (name, place, seed): partial(cut, ENV_ID, seed, name, **options)
        for place, options in places().items() for name in CONTROLLERS for seed in held_back(CUTS)
    }  # fmt: skip

    def watch(done: int, total: int) -> None:
        sys.stderr.write(f"\r{done} of {total} cuts")

    made = perform(operator.call, list(jobs.values()), watch, engine=engine_of(ENV_ID, len(jobs)))
    cuts = dict(zip(jobs, made, strict=True))
    rows = [
        [place, *(cell([cuts[name, place, seed] for seed in held_back(CUTS)]) for name in CONTROLLERS)]
        for place in places()
    ]
    write_sections("tasks/gap-feed.md", {"transfer": table(["place", *(f"`{name}`" for name in CONTROLLERS)], rows)})


if __name__ == "__main__":
    main()
