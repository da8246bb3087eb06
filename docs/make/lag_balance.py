"""Forces that push a rough cut's wire backwards or forwards; writes the table of theory/emergence.md.

    python docs/make/lag_balance.py

A cut of 30 mm with a fifth of open pulses, and the same cut with single loads removed.
"""

from collections.abc import Mapping

import numpy as np
from sections import table, write_sections

from edmsim.closed_loop.straight import Cut
from edmsim.validation.breakage import ROUGH_MM, rough_rig
from edmsim.validation.lag import ROUGH_OPEN_SHARE
from edmsim.validation.setups import servo_cut

SEEDS = (1, 2, 3)
DIGITS = (1, 1, 1, 0, 0)
MAGNETIC = {"material.magnetic_share": 0.0}
PULL = {"base.dielectric.permittivity": 1e-6}
PUSH = {"base.discharge.impulse_10mJ_Ns": 0.0, "base.discharge.bubble_share": 1e-12}
JETS = {"base.dielectric.jet_drag": 0.0}
CASES: Mapping[str, Mapping[str, float]] = {
    "as it is": {},
    "no magnetic force": MAGNETIC,
    "no electrostatic pull": PULL,
    "neither of them": {**MAGNETIC, **PULL},
    "no push of discharges": PUSH,
    "no jets": JETS,
}


def cuts(changes: Mapping[str, float]) -> list[Cut]:
    """Make the cut with changed constants, once per seed."""
    return [servo_cut(rough_rig(ROUGH_MM, changes), seed, open_share=ROUGH_OPEN_SHARE) for seed in SEEDS]


def figures(found: list[Cut]) -> list[str]:
    """Return the figures of cuts, means over the seeds."""
    means = np.mean([
        (cut.lag_um, cut.vibration_um, 100 * cut.share("short"), cut.gap_um, 1e-3 * cut.ignitions / cut.seconds)
        for cut in found
    ], axis=0)  # fmt: skip
    return [f"{mean:.{digits}f}" for mean, digits in zip(means, DIGITS, strict=True)]


def main() -> None:
    """Make the cuts, and write their table into the page."""
    heads = "what acts", "lag, um", "vibration, um", "shorts, %", "gap at the discharges, um", "discharges, kHz"
    found = table(heads, ([name, *figures(cuts(changes))] for name, changes in CASES.items()))
    write_sections("theory/emergence.md", {"lag balance": found})


if __name__ == "__main__":
    main()
