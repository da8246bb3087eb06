"""Rows on resolution: the default cut at `fast`, `default` and `fine`."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from edmsim.cosim.straight import Cut, cut_straight
from edmsim.machine.machine import Machine
from edmsim.validation.rows import Check, Row, differences, mean_and_interval
from edmsim.validation.setups import feed_within

SAME = "the model's own claim: a resolution changes the price of a cut and not the cut"
NOTE = "docs/convergence.md#convergence"
FEED_UM_S = 28.0  # fixed feed, if within capacity: three quarters of what the gap takes, where shorts begin (ours)
SETTLE_S, CUT_S = 6.0, 8.0  # machine time in which the cut settles, and is measured (ours: 200 um)
SHARE = 0.1  # share of `fine`'s figure by which another resolution may differ from it


class Figure(NamedTuple):
    """A figure of a cut, its unit, and the difference that is small whatever the figure is (ours)."""

    name: str
    unit: str
    small: float
    of: Callable[[Cut], float]


FIGURES = (
    Figure("short share", "", 0.01, lambda cut: cut.share("short")),
    Figure("lag", "um", 0.5, lambda cut: cut.lag_um),
    Figure("rms vibration", "um", 0.0, lambda cut: cut.vibration_um),
)


def resolutions(seeds: Sequence[int]) -> list[Row]:
    """Shorts, lag and vibration of the default cut at a fixed feed, coarse over fine."""
    machine = Machine.load()
    feed_um_s = feed_within(FEED_UM_S, machine)
    fast, default, fine = (
        [cut_straight(machine, feed_um_s, seed, settle_s=SETTLE_S, seconds=CUT_S, resolution=name) for seed in seeds]
        for name in ("fast", "default", "fine")
    )
    return [
        _row(figure, name, cuts, fine) for figure in FIGURES for name, cuts in (("fast", fast), ("default", default))
    ]


def _row(figure: Figure, name: str, cuts: Sequence[Cut], fine: Sequence[Cut]) -> Row:
    """Compare a figure with that of `fine`; the interval is that of their difference."""
    published = mean_and_interval([figure.of(cut) for cut in fine])[0] or 1e-6  # what is compared with is not 0
    less, half = mean_and_interval(differences(fine, cuts, figure.of))
    within = max(SHARE, round(figure.small / abs(published), 3))
    return Row.value("resolution", f"{figure.name} of the default cut, {name} against fine", SAME,
                     published=published, simulated=published + less, within=within, uncertainty=half,
                     unit=figure.unit, note=NOTE)


CHECKS: tuple[Check, ...] = (resolutions,)
