"""Rows on results of a cut: kerf, gaps, removal per charge and energy, cutting rate, thickness estimate."""

from itertools import pairwise

import numpy as np

from edmsim.controllers import make
from edmsim.cosim.straight import Cut, cut_straight
from edmsim.machine.machine import Machine
from edmsim.validation.breakage import PAUSE_US, sato_rig
from edmsim.validation.rows import Checks, Row, Seeds, differences
from edmsim.validation.setups import UNBREAKABLE, feed_within, servo_cut

TEXTBOOK = "textbook figure 1.8 W per mm3/min"
MASS_BALANCE = "mass balance of production cutting of steel, from Sato et al. (590 W, 60..80 mm3/min)"
SCHACHT = "Schacht, KU Leuven (2004): charge per removed volume is one constant of a pulse type"
ESTIMATOR = "Sato et al. after Yafuku et al.: thickness from mean current over kerf and feed"
ESTIMATOR_ERROR = "doi:10.1177/0954405413475973: thickness estimated within 2 mm"
EARLY_MACHINES = "usual of machines of the 1970s and early 1980s"
KERF = "kerf = wire + 2 side gaps (SPARC)"
SIDE_GAP = "usual side gap of rough cuts"
FRONT_GAP = "usual frontal gap"
EXPOSURE = "a wall ignites for as long as it faces the wire (derived)"
EXPONENT = "the exponent of removal over the on-time was set to match this mass balance"
PAGE = "docs/theory/emergence.md"


def _by_counts(machine: Machine, seed: int) -> Cut:
    """Cut with a feed that follows the pulses, as on a machine."""
    return cut_straight(machine, make("counts"), seed, settle_s=10.0, seconds=15.0)


def removal(seeds: Seeds) -> list[Row]:
    """Compare energy per volume and cutting rate of the default set-up, energy and charge in production cutting."""
    machine = Machine.load()
    cuts = [_by_counts(machine, seed) for seed in seeds]
    dense = [servo_cut(production(), seed) for seed in seeds]
    note = f"{PAGE}#removal-and-cutting-rate"
    return [
        Row.value("removal", "energy per volume", TEXTBOOK, published=108.0, within=0.1, unit="J/mm3",
                  simulated=[cut.energy / cut.removed_mm3 for cut in cuts])
        .calibration("the removal per joule is this figure"),
        Row.band("removal", "energy per volume, production", MASS_BALANCE, low=440.0, high=590.0, unit="J/mm3",
                 simulated=[cut.energy / cut.removed_mm3 for cut in dense], note=note).calibration(EXPONENT),
        Row.band("removal", "charge per volume, production", MASS_BALANCE, low=22.0, high=29.0, unit="C/mm3",
                 simulated=[cut.charge / cut.removed_mm3 for cut in dense], note=note).calibration(EXPONENT),
        Row.band("removal", "cutting rate", EARLY_MACHINES, low=10.0, high=60.0, unit="mm2/min",
                 simulated=[cut.feed_um_s * machine.height_mm * 60e-3 for cut in cuts]),
        Row.band("kerf", "frontal gap", FRONT_GAP, low=10.0, high=30.0, unit="um",
                 simulated=[cut.gap_um for cut in cuts]),
    ]


def production() -> Machine:
    """Return Sato's stable cutting of 80 mm, the source of the mass balance."""
    rig = sato_rig(80.0, UNBREAKABLE)
    return rig.with_(t_period_us=rig.t_on_us + PAUSE_US)


PAUSE_PERIODS_US = (100.0, 150.0, 250.0)  # periods of the same pulse, with up to three times the default pause (ours)


def pauses(seeds: Seeds) -> list[Row]:
    """Compare the charge per volume over the pause, with a feed proportional to the pulse frequency."""
    longest_over_shortest = []
    for seed in seeds:
        per_volume = []
        for period_us in PAUSE_PERIODS_US:
            slower = period_us / PAUSE_PERIODS_US[0]
            cut = cut_straight(
                Machine.load(t_period_us=period_us), 20.0 / slower, seed, settle_s=6 * slower, seconds=12 * slower
            )
            per_volume.append(cut.charge / cut.removed_mm3)
        longest_over_shortest.append(per_volume[-1] / per_volume[0])
    return [Row.value("removal", "charge per volume, long over short pauses", SCHACHT, published=1.0, within=0.05,
                      simulated=longest_over_shortest)]


def thickness(seeds: Seeds) -> list[Row]:
    """Estimate thicknesses of 10 and 40 mm from working current, kerf and feed, calibrated at 20 mm."""
    known_mm = 20.0
    cuts = {h: [_by_counts(Machine.load(height_mm=h), seed) for seed in seeds] for h in (10.0, known_mm, 40.0)}
    index = {
        h: [cut.working_current_A / (float(cut.kerf_um.mean()) * cut.feed_um_s) for cut in of]
        for h, of in cuts.items()
    }
    return [
        Row.band("removal", f"thickness estimated for {height:g} mm", f"{ESTIMATOR}; {ESTIMATOR_ERROR}",
                 low=height - 2.0, high=height + 2.0, unit="mm",
                 simulated=[known_mm * i / k for i, k in zip(index[height], index[known_mm], strict=True)])
        for height in (10.0, 40.0)
    ]


DIAMETERS_UM = (100.0, 150.0, 200.0, 250.0, 300.0)


def diameters(seeds: Seeds) -> list[Row]:
    """Compare the kerf over the wire diameter, with the count law and the wire's default stress."""
    kerf = np.array(
        [
            [float(_by_counts(Machine.load(wire=f"brass-{d:g}"), seed).kerf_um.mean()) for d in DIAMETERS_UM]
            for seed in seeds
        ]
    )
    # for side gaps anywhere within 30..60 um at both ends
    free = 2 * (60.0 - 30.0) / (DIAMETERS_UM[-1] - DIAMETERS_UM[0])
    return [
        Row.value("kerf", "kerf over wire diameter, slope", KERF, published=1.0, within=free,
                  simulated=[float(np.polyfit(DIAMETERS_UM, one, 1)[0]) for one in kerf]),
        *(
            Row.band("kerf", f"side gap, {diameter:g} um wire", SIDE_GAP, low=30.0, high=60.0,
                     simulated=(widths - diameter) / 2, unit="um", note=f"{PAGE}#kerf-and-gaps")
            for diameter, widths in zip(DIAMETERS_UM, kerf.T, strict=True)
        ),
    ]


FEEDS_UM_S = (7.0, 14.0, 28.0)  # fixed feeds, each twice the one before, if within the capacity (ours)


def overcut(seeds: Seeds) -> list[Row]:
    """Compare the kerf over a fixed feed: the walls of a slow cut face the wire longer."""
    machine = Machine.load()
    feeds = [feed_within(feed, machine) for feed in FEEDS_UM_S]
    kerfs_um = [
        [
            float(cut_straight(machine, feed, seed, settle_s=150.0 / feed, seconds=300.0 / feed).kerf_um.mean())
            for seed in seeds
        ]
        for feed in feeds
    ]
    return [
        Row.sign("kerf", f"kerf, feed {slow:.3g} to {quick:.3g} um/s", EXPOSURE, rises=False, unit="um",
                 simulated=differences(wide_um, narrow_um))
        for (slow, quick), (wide_um, narrow_um) in zip(pairwise(feeds), pairwise(kerfs_um), strict=True)
    ]


CHECKS: Checks = {
    removal: ("removal", "kerf"), pauses: ("removal",), thickness: ("removal",), diameters: ("kerf",),
    overcut: ("kerf",),
}
