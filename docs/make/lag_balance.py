"""What pushes a rough cut's wire back and what takes it forward; writes the table of theory/emergence.md.

    python docs/make/lag_balance.py

A cut of 30 mm at a fifth of open pulses, and the same cut without one of its loads at a time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from edmsim.cosim.straight import Cut
from edmsim.validation.breakage import rough_rig
from edmsim.validation.lag import ROUGH_MM, ROUGH_OPEN_SHARE
from edmsim.validation.setups import servo_cut

PAGE = Path(__file__).parents[1] / "theory" / "emergence.md"
BEGIN, END = "<!-- begin lag balance, by docs/make/lag_balance.py -->\n", "<!-- end lag balance -->"
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


def row(name: str, found: Sequence[Cut]) -> str:
    """Return a line of the table: means over the seeds."""
    figures = np.mean([
        (cut.lag_um, cut.vibration_um, 100 * cut.share("short"), cut.gap_um, 1e-3 * cut.ignitions / cut.seconds)
        for cut in found
    ], axis=0)  # fmt: skip
    return f"| {name} | " + " | ".join(f"{figure:.{n}f}" for figure, n in zip(figures, DIGITS, strict=True)) + " |"


def table() -> list[str]:
    """Return the table, a line per case."""
    head = "| what acts | lag, um | vibration, um | shorts, % | gap at the discharges, um | discharges, kHz |"
    rows = [row(name, cuts(changes)) for name, changes in CASES.items()]
    return [head, "|---" * (head.count("|") - 1) + "|", *rows]


def write(file: Path) -> None:
    """Make the cuts and put their table into the page."""
    lines = table()
    text = file.read_text(encoding="utf-8")
    before, _, rest = text.partition(BEGIN)
    file.write_text("\n".join([before + BEGIN, *lines, "", END + rest.partition(END)[2]]), encoding="utf-8")
    print(*lines, sep="\n")


if __name__ == "__main__":
    write(PAGE)
