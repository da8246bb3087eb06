"""Rows on the uncertainty from the constants' ranges: the default cut on machines drawn within them."""

from collections.abc import Sequence

import numpy as np

from edmsim.controllers import make
from edmsim.cosim.straight import Cut, cut_straight
from edmsim.evaluation.compare import CONFIDENCE
from edmsim.machine.machine import Machine
from edmsim.validation.cuts import EARLY_MACHINES, FRONT_GAP, SIDE_GAP
from edmsim.validation.lag import LAG
from edmsim.validation.rows import Check, Row

MACHINES_PER_SEED = 3  # machines drawn (ours: with eight seeds two dozen, of which the outermost bound the interval)
PAGE = "docs/theory/emergence.md#ranges"


def drawn_cuts(seeds: Sequence[int]) -> list[Cut]:
    """Cut straight under the count law on machines drawn within the ranges of all constants; the wire may break."""
    cuts = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        for _ in range(MACHINES_PER_SEED):
            machine = Machine.load().sample(rng)
            cuts.append(cut_straight(machine, make("counts"), seed, settle_s=10.0, seconds=40.0))
    return cuts


def ranges(seeds: Sequence[int]) -> list[Row]:
    """Rate, gaps and lag of drawn machines: the median, and half of what 95 % of them span."""
    # a machine that the law does not feed by a wire's diameter has a rate, but no kerf; it is left out of gaps
    # and lag
    cuts = [cut for cut in drawn_cuts(seeds) if not cut.broken]
    fed = [cut for cut in cuts if cut.travel_um > cut.plant.machine.wire_diameter_um]
    sides = [(float(c.kerf_um.mean()) - c.plant.machine.wire_diameter_um) / 2 for c in fed]
    rates = [c.feed_um_s * c.plant.machine.height_mm * 60e-3 for c in cuts]
    return [
        _row("cutting rate of drawn machines", EARLY_MACHINES, 10.0, 60.0, rates, "mm2/min"),
        _row("frontal gap of drawn machines", FRONT_GAP, 10.0, 30.0, [c.gap_um for c in fed]),
        _row("side gap of drawn machines", SIDE_GAP, 30.0, 60.0, sides),
        _row("lag of drawn machines", LAG, 10.0, 100.0, [c.lag_um for c in fed], note="")
        .context("the source is about rough cuts; these machines cut with pulses of 3 mJ at most"),
    ]


def _row(
    name: str, source: str, low: float, high: float, values: Sequence[float], unit: str = "um", note: str = PAGE
) -> Row:
    least, middle, most = np.quantile(values, [0.5 - CONFIDENCE / 2, 0.5, 0.5 + CONFIDENCE / 2])
    return Row.band("ranges", name, source, low=low, high=high, simulated=float(middle),
                    uncertainty=float(most - least) / 2, unit=unit, note=note)


CHECKS: tuple[Check, ...] = (ranges,)
