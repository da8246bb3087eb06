"""``docs/convergence.md``: errors of the resolutions, from the same cuts at `fast`, `default` and `fine`.

python docs/make/convergence.py
"""

import sys
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from sections import DOCS, table

from edmsim.bench.figures import pulses_per_s
from edmsim.closed_loop.straight import Cut, cut_straight
from edmsim.controllers import from_text, make
from edmsim.evaluation.stable_rate import quick_counts
from edmsim.job.cut import cut
from edmsim.machine.machine import Machine
from edmsim.plant.resolution import RESOLUTIONS
from edmsim.validation.breakage import rough_rig
from edmsim.validation.passes import HEIGHT_MM, chain
from edmsim.validation.rows import mean_and_interval

SEEDS = (0, 1, 2, 3)
FEED_UM_S = 32.0
"""Fixed feed for comparing shares: two thirds of the greatest that the gap allows."""
SETTLE_S, CUT_S = 8.0, 20.0
ROUGH_MM, ROUGH_OPEN, ROUGH_S = 30.0, 0.2, 2.0
"""Height of the rough cuts, share of open pulses that their servo holds, and time before and during measurement."""
PASSES = (1, 2, 4)
"""Passes of the tool steel's technology after which a straight wall is measured."""
CORNER_HEIGHT_MM = 10.0
_CORNERS = "G21 G90\nG0 X-2 Y0.5\nG41 D1\nG1 X0 Y0.5\nY1\nX1\nY0\nX0\nY0.5\nG40\nM2\n"
"""A punch of 1 x 1 mm with sharp corners."""

_INTRODUCTION = """\
# Convergence

How much does a result depend on `--resolution`?

- *Default cuts* agree: feed and rate within 2 %, the kerf within 2 um, shorts within 0.7 % of the pulses, corners of
  a punch within 1 um and its profile error within 0.5 um.
- *Trims* agree within 1 um, with waves of 0.2 to 0.3 um from `default` on and of 0.6 to 0.7 um at `fast`, whose rays
  are as far apart as a crater is wide. A single pass leaves 2.6 um more at `fast` than at `default`, and 1.5 um less
  at `fine`.
- *Rough cuts* ({rough:g} mm, pulses of 11 mJ every 10 us, a servo that holds {open_share:g} of them open) do not
  converge: at finer resolutions the wire vibrates more and touches the metal more often. Feed and lag at `fast`
  differ from those at `fine` by 7 and 12 %, and the vibration is seven tenths of that at `fine`. From 25 slices and
  24 modes on it is 12 to 13 um. So compare rough cuts at one resolution.

[Lag](theory/emergence.md#what-takes-the-lag) explains why rough cuts differ, and lists what was tried against it.

The table (`python docs/make/convergence.py`) is of straight cuts of 20 mm tool steel at a fixed feed of {feed:g} um/s
and under the `counts` law, {cut_s:g} s after {settle_s:g} s, of a punch of 1 x 1 mm, {height:g} mm high, and of
straight walls, {tall:g} mm high, after passes of the technology for tool steel. Figures are the mean over {seeds}
seeds and half its 95 % interval. The place of a wall is the metal left over the drawing, with offsets that were found
at `default`; its waves are the scatter along the path at every height, without roughness. Pulses per second are of
the machine that made this page.
"""


class Figure(NamedTuple):
    """One figure of a resolution: its name, unit, and function of a cut."""

    name: str
    unit: str
    of: Callable[[Cut], float]


FIXED = (
    Figure("short, fixed feed", "%", lambda c: 100 * c.share("short")),
    Figure("open, fixed feed", "%", lambda c: 100 * c.share("open")),
    Figure("spark, fixed feed", "%", lambda c: 100 * c.share("spark")),
    Figure("kerf, fixed feed", "um", lambda c: float(c.kerf_um.mean())),
    Figure("gap at sparks, fixed feed", "um", lambda c: c.gap_um),
    Figure("lag, fixed feed", "um", lambda c: c.lag_um),
    Figure("vibration, fixed feed", "um", lambda c: c.vibration_um),
)
ROUGH = (
    Figure("short, rough cut", "%", lambda c: 100 * c.share("short")),
    Figure("lag, rough cut", "um", lambda c: c.lag_um),
    Figure("vibration, rough cut", "um", lambda c: c.vibration_um),
    Figure("feed, rough cut", "um/s", lambda c: c.feed_um_s),
    Figure("working current, rough cut", "A", lambda c: c.working_current_A),
)
CONTROLLED = (
    Figure("feed, counts", "um/s", lambda c: c.feed_um_s),
    Figure("cutting rate, counts", "mm2/min", lambda c: c.feed_um_s * c.plant.machine.height_mm * 0.06),
    Figure("short, counts", "%", lambda c: 100 * c.share("short")),
    Figure("open, counts", "%", lambda c: 100 * c.share("open")),
)


def measure(resolution: str, seeds: Sequence[int] = SEEDS) -> dict[str, tuple[float, float, str]]:
    """Return every figure of a resolution by name: mean, half of its 95 % interval, unit."""
    figures: dict[str, tuple[float, float, str]] = {}
    # every cut has its own controller, because controllers have state
    usual, rough, quick = Machine.load(), rough_rig(ROUGH_MM), quick_counts(ROUGH_OPEN)
    for kinds, machine, feed, settle_s, seconds in (
        (FIXED, usual, lambda: FEED_UM_S, SETTLE_S, CUT_S),
        (CONTROLLED, usual, partial(make, "counts"), SETTLE_S, CUT_S),
        (ROUGH, rough, partial(from_text, quick), ROUGH_S, ROUGH_S),
    ):  # fmt: skip
        cuts = [
            cut_straight(machine, feed(), seed, settle_s=settle_s, seconds=seconds, resolution=resolution)
            for seed in seeds
        ]
        for kind in kinds:
            figures[kind.name] = (*mean_and_interval([kind.of(one) for one in cuts]), kind.unit)
    for passes in PASSES:
        ends = [chain(HEIGHT_MM, passes, seed, resolution).records[-1].wall for seed in seeds]
        walls = [wall for wall in ends if wall is not None]
        name = f"{passes} pass" if passes == 1 else f"{passes} passes"
        figures[f"wall after {name}"] = (*mean_and_interval([wall.mean_um for wall in walls]), "um")
        figures[f"waves after {name}"] = (*mean_and_interval([wall.waves_um for wall in walls]), "um rms")
    corners, profiles = zip(*(_punch(resolution, seed) for seed in seeds), strict=True)
    figures["error at sharp corners"] = (*mean_and_interval(corners), "um")
    figures["profile error, rms"] = (*mean_and_interval(profiles), "um")
    return figures


def _punch(resolution: str, seed: int) -> tuple[float, float]:
    """Return the mean error of the corners and the rms profile error of a small punch, in um."""
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "punch.ngc"
        program.write_text(_CORNERS, encoding="utf-8")
        report = cut(program, height_mm=CORNER_HEIGHT_MM, resolution=resolution, seed=seed).report
    errors = [corner["error_um"] for corner in report["corners"] if corner["error_um"] is not None]
    return float(np.mean(errors)), float(report["profile_error_um"]["rms"])


def page() -> str:
    """Return the page of the documentation; print the name of each resolution before its measurement."""
    columns, speeds = [], []
    for name in RESOLUTIONS:
        print(name, file=sys.stderr)
        columns.append(measure(name))
        speeds.append(pulses_per_s(name)[0])
    heads = [f"{name} ({r.slices} x {r.rays} x {r.modes})" for name, r in RESOLUTIONS.items()]
    introduction = _INTRODUCTION.format(
        feed=FEED_UM_S, cut_s=CUT_S, settle_s=SETTLE_S, height=CORNER_HEIGHT_MM, seeds=len(SEEDS), tall=HEIGHT_MM,
        rough=ROUGH_MM, open_share=ROUGH_OPEN,
    )
    every, usual = RESOLUTIONS.values(), speeds[list(RESOLUTIONS).index("default")]
    rows = [
        *((f"{figure}, {unit}", *(f"{column[figure][0]:.4g} ± {column[figure][1]:.2g}" for column in columns))
          for figure, (_, _, unit) in columns[0].items()),
        ("cells of the kerf field, um", *(f"{r.cell_um:g}" for r in every)),
        ("windows per tracing of the rays", *(str(r.trace_windows) for r in every)),
        ("pulses per second over those of `default`", *(f"{speed / usual:.2f}" for speed in speeds)),
    ]  # fmt: skip
    return f"{introduction}\n{table(('figure', *heads), rows)}\n"


if __name__ == "__main__":
    (DOCS / "convergence.md").write_text(page(), encoding="utf-8")
