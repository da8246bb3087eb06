"""Rows on what figures depend on: the constants' ranges (drawn machines), the resolution, films that are left out."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from edmsim.closed_loop.straight import Cut, cut_straight
from edmsim.controllers import make
from edmsim.evaluation.compare import CONFIDENCE
from edmsim.machine.machine import Machine
from edmsim.plant.resolution import Resolution, resolution
from edmsim.validation.cuts import EARLY_MACHINES, FRONT_GAP, SIDE_GAP
from edmsim.validation.lag import LAG
from edmsim.validation.rows import Checks, Row, Seeds, differences, mean_and_interval
from edmsim.validation.setups import feed_within

MACHINES_PER_SEED = 3  # machines drawn per seed (ours: two dozen in all, whose extremes are the interval)
PAGE = "docs/theory/emergence.md#ranges"


def ranges(seeds: Seeds) -> list[Row]:
    """Report rate, gaps and lag of drawn machines: the median, and half of the range of 95 % of them."""
    drawn = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        for _ in range(MACHINES_PER_SEED):
            machine = Machine.load().sample(rng)
            drawn.append(cut_straight(machine, make("counts"), seed, settle_s=10.0, seconds=40.0))
    # a machine that travels less than a wire's diameter has a rate but no kerf, and is left out of gaps and lag
    cuts = [cut for cut in drawn if not cut.broken]
    fed = [cut for cut in cuts if cut.travel_um > cut.plant.machine.wire_diameter_um]
    sides = [(float(c.kerf_um.mean()) - c.plant.machine.wire_diameter_um) / 2 for c in fed]
    rates = [c.feed_um_s * c.plant.machine.height_mm * 60e-3 for c in cuts]
    return [
        _row("cutting rate of drawn machines", EARLY_MACHINES, 10.0, 60.0, rates, "mm2/min"),
        _row("frontal gap of drawn machines", FRONT_GAP, 10.0, 30.0, [c.gap_um for c in fed]),
        _row("side gap of drawn machines", SIDE_GAP, 30.0, 60.0, sides),
        _row("lag of drawn machines", LAG, 10.0, 100.0, [c.lag_um for c in fed], note="")
        .context("the source is about rough cuts; these machines cut with discharges of 4 to 5 mJ"),
    ]


def _row(
    name: str, source: str, low: float, high: float, values: Sequence[float], unit: str = "um", note: str = PAGE
) -> Row:
    least, middle, most = np.quantile(values, [0.5 - CONFIDENCE / 2, 0.5, 0.5 + CONFIDENCE / 2])
    return Row.band("ranges", name, source, low=low, high=high, simulated=float(middle),
                    uncertainty=float(most - least) / 2, unit=unit, note=note)


# Rows on resolution: the default cut at `fast`, `default` and `fine`.

SAME = "the model's own claim: a resolution changes the price of a cut and not the cut"
NOTE = "docs/convergence.md#convergence"
FEED_UM_S = 28.0  # fixed feed, if within the capacity: 75 % of it, where shorts begin (ours)
SETTLE_S, CUT_S = 6.0, 8.0  # machine times in which the cut settles and is measured (ours: 200 um)
SHARE = 0.1  # relative tolerance of a figure at another resolution than `fine`


class Figure(NamedTuple):
    """A figure of a cut, its unit, and an absolute tolerance (ours)."""

    name: str
    unit: str
    small: float
    of: Callable[[Cut], float]


FIGURES = (
    Figure("short share", "", 0.01, lambda cut: cut.share("short")),
    Figure("lag", "um", 0.5, lambda cut: cut.lag_um),
    Figure("rms vibration", "um", 0.0, lambda cut: cut.vibration_um),
)


def resolutions(seeds: Seeds) -> list[Row]:
    """Compare shorts, lag and vibration of the default cut at a fixed feed between resolutions."""
    machine = Machine.load()
    feed_um_s = feed_within(FEED_UM_S, machine)
    fast, default, fine = (
        [cut_straight(machine, feed_um_s, seed, settle_s=SETTLE_S, seconds=CUT_S, resolution=name) for seed in seeds]
        for name in ("fast", "default", "fine")
    )
    return [
        _against_fine(figure, name, cuts, fine)
        for figure in FIGURES for name, cuts in (("fast", fast), ("default", default))
    ]


def _against_fine(figure: Figure, name: str, cuts: Sequence[Cut], fine: Sequence[Cut]) -> Row:
    """Compare a figure with that of `fine`; the interval is that of their difference."""
    published = mean_and_interval([figure.of(cut) for cut in fine])[0] or 1e-6  # what is compared with is not 0
    less, half = mean_and_interval(differences(fine, cuts, figure.of))
    within = max(SHARE, round(figure.small / abs(published), 3))
    return Row.value("resolution", f"{figure.name} of the default cut, {name} against fine", SAME,
                     published=published, simulated=published + less, within=within, uncertainty=half,
                     unit=figure.unit, note=NOTE)


# The film of single slices is left out in wide gaps.

FAST = resolution("fast")
SKIP = f"the film of a slice is followed where its front gap is under {FAST.film_from_um:g} um; that this is enough"
SKIP_FEED_UM_S, ALL_FROM_UM = 24.0, 40.0
"""A feed at which the wire is near the metal, and a front gap below which every slice's film is applied (ours)."""


def check_skip(seeds: Seeds) -> list[Row]:
    """Compare lag and shorts with the films of single slices applied everywhere and only in narrow gaps."""

    def cuts(res: Resolution) -> list[Cut]:
        machine = Machine.load()
        return [
            cut_straight(machine, SKIP_FEED_UM_S, seed, settle_s=6.0, seconds=15.0, resolution=res) for seed in seeds
        ]

    usual = cuts(FAST)
    everywhere = cuts(replace(FAST, film_from_um=ALL_FROM_UM))
    followed = f"film followed under {ALL_FROM_UM:g} um less under {FAST.film_from_um:g} um"
    note = "docs/theory/gas.md#the-film-of-water"
    return [
        Row.band("film", f"lag, {followed}", SKIP, low=-0.5, high=0.5, published="no difference", unit="um",
                 simulated=differences(usual, everywhere, lambda cut: cut.lag_um), note=note),
        Row.band("film", f"short share, {followed}", SKIP, low=-0.02, high=0.02, published="no difference",
                 simulated=differences(usual, everywhere, lambda cut: cut.share("short")), note=note),
    ]


CHECKS: Checks = {ranges: ("ranges",), resolutions: ("resolution",), check_skip: ("film",)}
