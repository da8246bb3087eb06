"""Why the seventh pass is slow: its feed for several offsets; writes the table of theory/passes.md.

    python docs/make/fine_pass.py

The straight edge of the validation's rows is cut in seven passes, the last one with greater offsets; the metal before
it is the same.
"""

import math
from collections.abc import Sequence

from sections import table, write_sections

from edmsim.evaluation.technology_search import cut_in_passes
from edmsim.machine.technology import Technology, technology_for
from edmsim.validation.passes import HEIGHT_MM, LENGTH_MM

PASSES, SEED = 7, 1
FURTHER_UM = (0.0, 2.0, 4.0)
"""Offsets of the last pass, minus the technology's."""


def with_offset(known: Technology, further_um: float) -> Technology:
    """Return the technology with another offset of the last pass only."""
    heights = []
    for at in known.heights:
        *others, before, last = at.passes
        assert before.step_um is not None
        assert last.last_offset_um is not None
        before = before.model_copy(update={"step_um": before.step_um - further_um})
        last = last.model_copy(update={"last_offset_um": last.last_offset_um + further_um})
        heights.append(at.model_copy(update={"passes": (*others, before, last)}))
    return known.model_copy(update={"heights": tuple(heights)})


def row(further_um: float) -> Sequence[str]:
    """Cut the edge, and return the figures of its last pass."""
    technology = with_offset(technology_for("tool-steel"), further_um)
    before, last = cut_in_passes(
        technology, HEIGHT_MM, PASSES, LENGTH_MM, seed=SEED, resolution="default"
    ).passes.records[-2:]
    assert before.wall is not None
    assert last.wall is not None
    return (
        f"{further_um:g}", f"{before.wall.mean_um - last.wall.mean_um:.1f}",
        f"{100 * last.sums.short / last.sums.pulses:.1f}",
        f"{math.sqrt(last.sums.vibration2_pulses / last.sums.pulses):.1f}", f"{last.feed_mm_min:.2f}",
    )  # fmt: skip


def main() -> None:
    """Make the cuts, and write their table into the page."""
    heads = "offset further by, um", "removed, um", "shorts, %", "vibration, um rms", "feed, mm/min"
    found = table(heads, [row(further_um) for further_um in FURTHER_UM], numbers=5)
    write_sections("theory/passes.md", {"fine pass": found})


if __name__ == "__main__":
    main()
