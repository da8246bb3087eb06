"""Rows on shorts: their causes, their effect on the rate, and how a cut ends in them."""

from collections.abc import Mapping, Sequence

import numpy as np

from edmsim.cosim.straight import Cut, Traverse, begin, cut_straight
from edmsim.evaluation.stable_rate import JAMMED_SHARE
from edmsim.machine.machine import Machine
from edmsim.plant.window import PlantError
from edmsim.validation.breakage import MIDDLE_MM, held_periods, rough_rig, sato_rig
from edmsim.validation.pulse_ratios import LIAO_WOO
from edmsim.validation.rows import Check, Row, differences
from edmsim.validation.setups import HELD_SHARE, PRACTICE, UNBREAKABLE, altered, capacity_um_s, feed_within, servo_cut

JAM = "a wire that only touches cuts nothing (derived)"
COST = "shorts melt little and heat the wire as discharges do (derived)"
DERIVED = (
    "no source says so: a derivation for shorts of a whole discharge's current, and this generator gives them a fifth"
)
SOONER = "pulses that ignite sooner find a gap less deionised (derived)"
FEW_SHORTS = f"{PRACTICE}: below 10 % in stable cutting"
MEMORY = "from memory, no table was retrieved: below 10 % in stable cutting"
PARTS = "no source separates the causes of shorts"
NOTE = "docs/theory/emergence.md#classes-of-pulses"

FEEDS_UM_S = (10.0, 20.0, 28.0)  # from three quarters of the pulses open to the first crowd of shorts (ours)
NO_FILM: Mapping[str, float] = {
    "base.dielectric.viscosity_Pa_s": 1e-9,
    "base.dielectric.flushing_pressure_Pa": 0.03,
    "base.dielectric.edge_loss": 0.0,
}
"""Water a million times as thin, and flushing a million times as weak: the same flow without a film."""
NO_PULL: Mapping[str, float] = {"base.dielectric.permittivity": 1e-6}


def _shorts(machine: Machine, feed_um_s: float, seeds: Sequence[int]) -> list[float]:
    """Share of shorts at a fixed feed, a cut per seed; 1 if the wire was driven into the metal."""
    shares = []
    for seed in seeds:
        try:
            shares.append(cut_straight(machine, feed_um_s, seed, settle_s=6.0, seconds=15.0).share("short"))
        except PlantError:
            shares.append(1.0)
    return shares


def causes(seeds: Sequence[int]) -> list[Row]:
    """Shorts over the feed, and what of them is the pull's, with the film of water and without it."""
    machine = Machine.load()
    feeds = [feed_within(feed, machine) for feed in FEEDS_UM_S]
    by_feed = [_shorts(machine, feed, seeds) for feed in feeds]
    top = feeds[-1]
    rows = [
        Row.sign("shorts", f"short share, feed {feeds[0]:.3g} to {top:.3g} um/s", LIAO_WOO, rises=True,
                 simulated=differences(by_feed[0], by_feed[-1]), note=NOTE),
        Row.band("shorts", f"short share at {feeds[1]:.3g} um/s", MEMORY, high=0.1, simulated=by_feed[1])
        .context("a working assumption from memory, no published table"),
    ]
    for name, film in (("with the film", {}), ("without a film", NO_FILM)):
        free, pulled = (_shorts(altered(machine, {**film, **pull}), feeds[1], seeds) for pull in (NO_PULL, {}))
        rows.append(Row.report("shorts", f"short share by the pull at {feeds[1]:.3g} um/s, {name}", PARTS,
                               simulated=differences(free, pulled)))
    return rows


OPEN_SHARES = (0.02, 0.05, 0.1, 0.2, 0.35)
"""Shares of open pulses that the servo is set to hold (ours: from next to the metal to far from it)."""


def rate_over_shorts(seeds: Sequence[int]) -> list[Row]:
    """Cutting rate of a servo over the shorts it lets happen."""
    runs = {share: [servo_cut(rough_rig(30.0), seed, open_share=share) for seed in seeds] for share in OPEN_SHARES}
    rates = [float(np.mean([cut.feed_um_s for cut in runs[share]])) for share in OPEN_SHARES]
    best = OPEN_SHARES[int(np.argmax(rates))]
    shorts = {share: [cut.share("short") for cut in cuts] for share, cuts in runs.items()}
    return [
        Row.band("shorts", f"short share at the highest cutting rate, {best:g} of the pulses open", JAM, low=0.0,
                 high=JAMMED_SHARE, published="below the jam", simulated=shorts[best]),
        Row.band("shorts", "short share of a rough cut, 30 mm, at the highest cutting rate", FEW_SHORTS, high=0.1,
                 simulated=shorts[best], note=NOTE),
        Row.sign("shorts", f"feed, {best:g} to {OPEN_SHARES[-1]:g} of the pulses open", JAM, rises=False, unit="um/s",
                 simulated=differences(runs[best], runs[OPEN_SHARES[-1]], lambda cut: cut.feed_um_s)),
        *(
            Row.report("shorts", f"feed at a short share of {np.mean(shorts[share]):.2g}", PARTS,
                       simulated=rate, unit="um/s")
            for share, rate in zip(OPEN_SHARES, rates, strict=True)
        ),
    ]


ON_SHORTS, ON_SPARKS = OPEN_SHARES[0], HELD_SHARE
"""Shares of open pulses held by a servo that runs on shorts, and by one that stays off the metal."""
ARC_PERIOD_US = 10.0
"""Period at which arcs are counted: its pause of some 9 us is some three times the deionisation's 3 us; of the 60 us
that the search begins with nothing is left of a channel."""


def price(seeds: Sequence[int]) -> list[Row]:
    """What a servo that runs on shorts pays: heat, arcs, and the power at which the wire breaks."""
    slow = sato_rig(MIDDLE_MM, UNBREAKABLE)
    off, on = _off_and_on_shorts(slow, seeds)
    dense_off, dense_on = _off_and_on_shorts(slow.with_(t_period_us=ARC_PERIOD_US), seeds)
    # highest rate of a servo whose pauses are shortened until the wire breaks or the cut jams
    sparing, shorting = (
        [
            max((step.rate_mm2_min for step in held_periods(sato_rig(MIDDLE_MM), seed, share)), default=0.0)
            for seed in seeds
        ]
        for share in (ON_SPARKS, ON_SHORTS)
    )
    return [
        Row.sign("shorts", "rise of the wire's temperature per working current, servo on shorts", COST, rises=True,
                 simulated=differences(off, on, lambda cut: _hottest_K(cut) / cut.working_current_A), unit="K/A",
                 note=NOTE).context(DERIVED),
        Row.sign("shorts", f"arc share at a period of {ARC_PERIOD_US:g} us, servo on shorts", SOONER, rises=True,
                 simulated=differences(dense_off, dense_on, lambda cut: cut.share("arc")), note=NOTE),
        Row.sign("shorts", "cutting rate before the wire breaks, servo on shorts", COST, rises=False,
                 simulated=differences(sparing, shorting), unit="mm2/min", note=NOTE).context(DERIVED),
    ]


def _off_and_on_shorts(machine: Machine, seeds: Sequence[int]) -> tuple[list[Cut], list[Cut]]:
    """Cut with a servo that stays off the metal, and with one that runs on shorts."""
    off, on = ([servo_cut(machine, seed, open_share=share) for seed in seeds] for share in (ON_SPARKS, ON_SHORTS))
    return off, on


def _hottest_K(cut: Cut) -> float:
    """Mean over the windows of the hottest slice's temperature above the water's."""
    hottest = float(np.mean([window.wire_temperature_K for window in cut.windows]))
    return hottest - cut.plant.machine.base.dielectric.temperature_K.value


ABOVE = 1.3  # a fixed feed this much above the capacity: the wire must meet the metal (ours)
JAM_S = 3.0
PUSHES = (0.0, 0.3, 1.0)
"""Shares of a bubble's push that metal melting in a short gives: the range's ends and the machine's own."""


def jams(seeds: Sequence[int]) -> list[Row]:
    """Shorts of a feed above capacity, by the push that a short gives."""
    feed_um_s = ABOVE * capacity_um_s(rough_rig(30.0))
    rows = []
    for push in PUSHES:
        machine = rough_rig(30.0, {"base.discharge.short_push_share": push})
        rows.append(Row.report("shorts", f"short share above capacity, push of a short {push:g}",
                               "no datum on the push of a short",
                               simulated=[_jammed_share(machine, feed_um_s, seed) for seed in seeds]))
    return rows


def _jammed_share(machine: Machine, feed_um_s: float, seed: int) -> float:
    """Share of shorts in the last third of a cut that is driven too fast; 1 if the wire ends in the metal."""
    traverse = Traverse(begin(machine, seed), feed_um_s)
    try:
        traverse.run(2 * JAM_S / 3)
        windows = traverse.run(JAM_S / 3)
    except PlantError:
        return 1.0
    return sum(w.short for w in windows) / sum(w.pulses for w in windows)


CHECKS: tuple[Check, ...] = (causes, rate_over_shorts, price, jams)
