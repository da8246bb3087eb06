"""Rows on cuts: classes of pulses, debris and shorts; removal, kerf and gaps; ignition in debris; roughness."""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from edmsim.closed_loop.straight import Cut, Traverse, begin, cut_straight
from edmsim.controllers import from_text, make
from edmsim.evaluation.stable_rate import JAMMED_SHARE, quick_counts
from edmsim.machine.machine import Machine
from edmsim.machine.pulse_window import PulseWindow
from edmsim.metrology.roughness import roughness_um
from edmsim.plant import constants, window
from edmsim.plant.gap.generator import crater_um3
from edmsim.plant.workpiece.blanks import SLOT_GAP_UM
from edmsim.validation import breakage, discharges, setups
from edmsim.validation.rows import Checks, Row, Seeds, differences, extended

LIAO_WOO = "Liao, Woo, J. Mater. Process. Technol. 71(3):433 (1997)"
FLUSHING_STUDY = "particle-resolved flushing study, Eng. Appl. Comput. Fluid Mech., doi:10.1080/19942060.2021.1877198"
BRIDGES = "Murray et al., J. Mater. Process. Technol. 229:54 (2016): debris of the gap's size bridges it"
DRUM = "Machines 12(12):908 (2024): drum error of thick parts by secondary discharges on debris"
SLOT_FLOW = "slot Poiseuille flow (derived)"
SPARC_BALANCE = "debris balance of SPARC (ETH, MIT licence)"
PAGE = "docs/theory/emergence.md"
CLASSES = f"{PAGE}#classes-of-pulses"

FEED_UM_S = 24.0  # feed at which open, normal and short pulses all occur, if within the capacity (ours)
CHANGE = 0.2  # relative change of settings (ours: about the spacing of levels in such studies)

TRAINS = 32  # seeds of these cuts
# Ours: a ratio that depends on a setting changes at least a tenth as much. A change of a setting by a fifth then
# changes the short ratio, 0.042, by 0.0009, and half of this is the interval. The differences of eight seeds had a
# standard deviation of 0.0013: 2.04 x 0.0013 / sqrt(32) = 0.0005.


def sparks_ratio(cut: Cut, kind: str) -> float:
    """Return the share of a class among all pulses that are not open: the ratio of Liao and Woo."""
    return cut.share(kind) / (cut.share("spark") + cut.share("arc") + cut.share("short"))


def pulse_trains(seeds: Seeds) -> list[Row]:
    """Compare signs of Liao and Woo at fixed feed: effects of on-time, off-time and feed on ratios and delay."""
    machine = Machine.load()
    on, off = machine.t_on_us, machine.t_period_us - machine.t_on_us
    shorter, longer = (1 - CHANGE) * on, (1 + CHANGE) * off
    brief = machine.with_(t_on_us=shorter, t_period_us=shorter + off)
    sparse = machine.with_(t_period_us=on + longer)
    largest = setups.feed_within((1 + CHANGE) * FEED_UM_S, machine)
    feed_um_s = min(setups.feed_within(FEED_UM_S, brief, sparse), largest / (1 + CHANGE))
    seeds = extended(seeds, TRAINS)
    base = [_train(machine, feed_um_s, seed) for seed in seeds]
    changes = {
        "shorter on-time": (brief, feed_um_s),
        "longer off-time": (sparse, feed_um_s),
        "larger feed": (machine, (1 + CHANGE) * feed_um_s),
    }
    rows = []
    for name, (changed, feed) in changes.items():
        cuts = [_train(changed, feed, seed) for seed in seeds]
        rows += _three_signs(name, base, cuts)
    return rows


def _train(machine: Machine, feed_um_s: float, seed: int) -> Cut:
    return cut_straight(machine, feed_um_s, seed, settle_s=6.0, seconds=15.0)


def _three_signs(name: str, base: Sequence[Cut], cuts: Sequence[Cut]) -> list[Row]:
    figures = {
        "normal ratio": (lambda cut: sparks_ratio(cut, "spark"), False, ""),
        "short ratio": (lambda cut: sparks_ratio(cut, "short"), True, ""),
        "mean delay": (lambda cut: cut.mean_delay_us, False, "us"),
    }
    return [
        Row.sign("pulse ratios", f"{figure}, {name}", LIAO_WOO, rises=rises, simulated=differences(base, cuts, of),
                 unit=unit, note=CLASSES)
        for figure, (of, rises, unit) in figures.items()
    ]


DEBRIS_HEIGHT_MM = 40.0  # height at which debris matters: the middle is far from both jets (ours)
DEBRIS_FEED_UM_S = 12.0  # feed, if within the capacity, at which debris bridges the middle in weak flushing (ours)
LOADINGS = (0.06, 0.14)  # shares of debris in the water of the flushing study
LOADING_RATIO = 2.3  # their ratio; in a cut the debris is proportional to the feed


def debris(seeds: Seeds) -> list[Row]:
    """Compare debris, bridging and drum of a cut over its flushing, and the share flushed out without a cut."""
    machine = Machine.load(height_mm=DEBRIS_HEIGHT_MM)
    usual_Pa = machine.base.dielectric.flushing_pressure_Pa.value
    weak_machine = setups.altered(machine, {"base.dielectric.flushing_pressure_Pa": usual_Pa / 3})
    one_machine = machine.with_(flushing_upper_Pa=0.0)
    feed_um_s = setups.feed_within(DEBRIS_FEED_UM_S, machine, weak_machine, one_machine)
    usual, weak, one = ([_tall(of, feed_um_s, seed) for seed in seeds] for of in (machine, weak_machine, one_machine))
    slow = [_tall(machine, feed_um_s / LOADING_RATIO, seed) for seed in seeds]
    thin, thick = (flushed_share(loading) for loading in LOADINGS)
    return [
        _sign("debris share, flushing pressure x3", SLOT_FLOW, False, differences(weak, usual, _debris)),
        _sign("short share, flushing pressure x3", BRIDGES, False, differences(weak, usual, _shorts)),
        _sign("short share, second nozzle on", BRIDGES, False, differences(one, usual, _shorts)),
        _sign(f"debris share, feed x{LOADING_RATIO}", SPARC_BALANCE, True, differences(slow, usual, _debris)),
        Row.value(
            "debris", f"share of debris flushed out per second, loading x{LOADING_RATIO}", FLUSHING_STUDY,
            published=0.86, simulated=thick / thin, within=0.1, note=f"{PAGE}#debris-and-flushing",
        ),
        _sign("kerf at mid-height less kerf at the faces (drum)", DRUM, True, [drum_um(cut) for cut in usual], "um"),
    ]


def _tall(machine: Machine, feed_um_s: float, seed: int) -> Cut:
    return cut_straight(machine, feed_um_s, seed, settle_s=8.0, seconds=240.0 / feed_um_s)


def _debris(cut: Cut) -> float:
    return cut.debris


def _shorts(cut: Cut) -> float:
    return cut.share("short")


def _sign(name: str, source: str, rises: bool, found: Sequence[float], unit: str = "") -> Row:
    return Row.sign("debris", name, source, rises=rises, simulated=found, unit=unit,
                    note=f"{PAGE}#debris-and-flushing")


HALF = math.log(2)
"""Time of flushing over the residence time of clean water: then half of little debris is flushed out (ours: not in
the abstract of the study)."""
FLUSHED_GAP_UM = 30.0  # gap of the hole, which does not affect the flow: flushing uses the machine's side gap
FLUSHED_ON_US, FLUSHED_PERIOD_US = 2.0, 10.0
"""Setting of the generator, which is off: windows are short compared with the residence time."""


def flushed_share(loading: float) -> float:
    """Return the share of a gap's debris that the jets flush out in the time of `HALF`, without pulses."""
    set_up = Machine.load(height_mm=DEBRIS_HEIGHT_MM)
    plant = setups.in_a_hole(set_up.with_(t_on_us=FLUSHED_ON_US, t_period_us=FLUSHED_PERIOD_US), FLUSHED_GAP_UM, 1)
    plant.switch_generator(False)
    setups.load_debris(plant, loading)
    jet_m_s = constants.flushing(set_up).lower_m_s
    until_ns = plant.time_ns + HALF * DEBRIS_HEIGHT_MM / 2 * 1e-3 / jet_m_s * 1e9
    while plant.time_ns < until_ns:
        plant.advance()
    return 1.0 - float(plant.snapshot()["debris"][: plant.resolution.slices].mean()) / loading


def drum_um(cut: Cut) -> float:
    """Return the kerf of the middle slice minus the mean of the lowest and the highest one."""
    kerf = cut.kerf_um
    return float(kerf[len(kerf) // 2] - (kerf[0] + kerf[-1]) / 2)


# --- shorts: their causes, their effect on the rate, and cuts that end in shorts ---

JAM = "a wire that only touches cuts nothing (derived)"
COST = "shorts melt little and heat the wire as discharges do (derived)"
DERIVED = (
    "no source says so: a derivation for shorts of a whole discharge's current, and this generator gives them a fifth"
)
SOONER = "pulses that ignite sooner find a gap less deionised (derived)"
FEW_SHORTS = f"{setups.PRACTICE}: below 10 % in stable cutting"
MEMORY = "from memory, no table was retrieved: below 10 % in stable cutting"
PARTS = "no source separates the causes of shorts"

SHORTS_FEEDS_UM_S = (10.0, 20.0, 28.0)  # from 75 % open pulses to the first frequent shorts (ours)
NO_FILM: Mapping[str, float] = {
    "base.dielectric.viscosity_Pa_s": 1e-9,
    "base.dielectric.flushing_pressure_Pa": 0.03,
    "base.dielectric.edge_loss": 0.0,
}
"""Viscosity and flushing divided by a million: the same flow without a film."""
NO_PULL: Mapping[str, float] = {"base.dielectric.permittivity": 1e-6}


def _short_shares(machine: Machine, feed_um_s: float, seeds: Seeds) -> list[float]:
    """Return the share of shorts at a fixed feed for every seed; 1 if the wire was driven into the metal."""
    shares = []
    for seed in seeds:
        try:
            shares.append(_train(machine, feed_um_s, seed).share("short"))
        except window.PlantError:
            shares.append(1.0)
    return shares


def causes(seeds: Seeds) -> list[Row]:
    """Report shorts over the feed, and the part that the pull causes, with and without the film of water."""
    machine = Machine.load()
    feeds = [setups.feed_within(feed, machine) for feed in SHORTS_FEEDS_UM_S]
    by_feed = [_short_shares(machine, feed, seeds) for feed in feeds]
    top = feeds[-1]
    rows = [
        Row.sign("shorts", f"short share, feed {feeds[0]:.3g} to {top:.3g} um/s", LIAO_WOO, rises=True,
                 simulated=differences(by_feed[0], by_feed[-1]), note=CLASSES),
        Row.band("shorts", f"short share at {feeds[1]:.3g} um/s", MEMORY, high=0.1, simulated=by_feed[1])
        .context("a working assumption from memory, no published table"),
    ]
    for name, film in (("with the film", {}), ("without a film", NO_FILM)):
        free, pulled = (
            _short_shares(setups.altered(machine, {**film, **pull}), feeds[1], seeds) for pull in (NO_PULL, {})
        )
        rows.append(Row.report("shorts", f"short share by the pull at {feeds[1]:.3g} um/s, {name}", PARTS,
                               simulated=differences(free, pulled)))
    return rows


OPEN_SHARES = (0.02, 0.05, 0.1, 0.2, 0.35)
"""Shares of open pulses that the servo holds (ours: from near the metal to far from it)."""


def rate_over_shorts(seeds: Seeds) -> list[Row]:
    """Compare the cutting rate of a servo over the shorts that it allows."""
    rig = breakage.rough_rig(breakage.ROUGH_MM)
    runs = {share: setups.servo_cuts(rig, seeds, open_share=share) for share in OPEN_SHARES}
    rates = [float(np.mean([cut.feed_um_s for cut in runs[share]])) for share in OPEN_SHARES]
    best = OPEN_SHARES[int(np.argmax(rates))]
    shorts = {share: [cut.share("short") for cut in cuts] for share, cuts in runs.items()}
    return [
        Row.band("shorts", f"short share at the highest cutting rate, {best:g} of the pulses open", JAM, low=0.0,
                 high=JAMMED_SHARE, published="below the jam", simulated=shorts[best]),
        Row.band("shorts", "short share of a rough cut, 30 mm, at the highest cutting rate", FEW_SHORTS, high=0.1,
                 simulated=shorts[best], note=CLASSES),
        Row.sign("shorts", f"feed, {best:g} to {OPEN_SHARES[-1]:g} of the pulses open", JAM, rises=False, unit="um/s",
                 simulated=differences(runs[best], runs[OPEN_SHARES[-1]], lambda cut: cut.feed_um_s)),
        *(
            Row.report("shorts", f"feed at a short share of {np.mean(shorts[share]):.2g}", PARTS,
                       simulated=rate, unit="um/s")
            for share, rate in zip(OPEN_SHARES, rates, strict=True)
        ),
    ]


ON_SHORTS, ON_SPARKS = OPEN_SHARES[0], breakage.HELD_SHARE
"""Shares of open pulses held by a servo that allows shorts, and by one that avoids the metal."""
ARC_PERIOD_US = 10.0
"""Period at which arcs are counted: its pause of some 9 us is three times the deionisation time of 3 us; after the 60
us with which the search begins, no channel remains."""


def price(seeds: Seeds) -> list[Row]:
    """Compare the costs of a servo that allows shorts: heat, arcs, and the power at which the wire breaks."""
    rig = breakage.sato_rig(breakage.MIDDLE_MM)
    slow = setups.altered(rig, setups.UNBREAKABLE)
    off, on = _off_and_on_shorts(slow, seeds)
    dense_off, dense_on = _off_and_on_shorts(slow.with_(t_period_us=ARC_PERIOD_US), seeds)
    # highest rate of a servo, with pauses shortened until the wire breaks or the cut jams
    sparing, shorting = (
        [
            max((step.rate_mm2_min for step in breakage.held_periods(rig, seed, share)), default=0.0)
            for seed in seeds
        ]
        for share in (ON_SPARKS, ON_SHORTS)
    )
    return [
        Row.sign("shorts", "rise of the wire's temperature per working current, servo on shorts", COST, rises=True,
                 simulated=differences(off, on, lambda cut: _hottest_K(cut) / cut.working_current_A), unit="K/A",
                 note=CLASSES).context(DERIVED),
        Row.sign("shorts", f"arc share at a period of {ARC_PERIOD_US:g} us, servo on shorts", SOONER, rises=True,
                 simulated=differences(dense_off, dense_on, lambda cut: cut.share("arc")), note=CLASSES),
        Row.sign("shorts", "cutting rate before the wire breaks, servo on shorts", COST, rises=False,
                 simulated=differences(sparing, shorting), unit="mm2/min", note=CLASSES).context(DERIVED),
    ]


def _off_and_on_shorts(machine: Machine, seeds: Seeds) -> tuple[list[Cut], list[Cut]]:
    """Cut with a servo that avoids the metal, and with one that allows shorts."""
    off, on = (setups.servo_cuts(machine, seeds, open_share=share) for share in (ON_SPARKS, ON_SHORTS))
    return off, on


def _hottest_K(cut: Cut) -> float:
    """Return the mean over the windows of the hottest slice's temperature above the water's."""
    hottest = float(np.mean([window.wire_temperature_K for window in cut.windows]))
    return hottest - cut.plant.machine.base.dielectric.temperature_K.value


ABOVE = 1.3  # factor of a fixed feed over the capacity: the wire must meet the metal (ours)
JAM_S = 3.0
PUSHES = (0.0, 0.3, 1.0)
"""Pushes of melting metal in a short, as shares of a bubble's push: ends of the range, and the machine's value."""


def jams(seeds: Seeds) -> list[Row]:
    """Report shorts at a feed above the capacity, over the push of a short."""
    feed_um_s = ABOVE * setups.capacity_um_s(breakage.rough_rig(breakage.ROUGH_MM))
    rows = []
    for push in PUSHES:
        machine = breakage.rough_rig(breakage.ROUGH_MM, {"base.discharge.short_push_share": push})
        rows.append(Row.report("shorts", f"short share above capacity, push of a short {push:g}",
                               "no datum on the push of a short",
                               simulated=[_jammed_share(machine, feed_um_s, seed) for seed in seeds]))
    return rows


def _jammed_share(machine: Machine, feed_um_s: float, seed: int) -> float:
    """Return the share of shorts in the last third of a cut that is fed too fast; 1 if the wire ends in the metal."""
    traverse = Traverse(begin(machine, seed), feed_um_s)
    try:
        traverse.run(2 * JAM_S / 3)
        windows = traverse.run(JAM_S / 3)
    except window.PlantError:
        return 1.0
    return sum(w.short for w in windows) / sum(w.pulses for w in windows)


# --- removal and kerf ---

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
GAPS = f"{PAGE}#kerf-and-gaps"


def _by_counts(machine: Machine, seed: int) -> Cut:
    """Cut with a feed that follows the pulses, as on a machine."""
    return cut_straight(machine, make("counts"), seed, settle_s=10.0, seconds=15.0)


def removal(seeds: Seeds) -> list[Row]:
    """Compare energy per volume and cutting rate of the default set-up, energy and charge in production cutting."""
    machine = Machine.load()
    cuts = [_by_counts(machine, seed) for seed in seeds]
    dense = setups.servo_cuts(production(), seeds)
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
    rig = breakage.sato_rig(80.0, setups.UNBREAKABLE)
    return rig.with_(t_period_us=rig.t_on_us + breakage.PAUSE_US)


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
                     simulated=(widths - diameter) / 2, unit="um", note=GAPS)
            for diameter, widths in zip(DIAMETERS_UM, kerf.T, strict=True)
        ),
    ]


OVERCUT_FEEDS_UM_S = (7.0, 14.0, 28.0)  # fixed feeds, each twice the one before, if within the capacity (ours)


def overcut(seeds: Seeds) -> list[Row]:
    """Compare the kerf over a fixed feed: the walls of a slow cut face the wire longer."""
    machine = Machine.load()
    feeds = [setups.feed_within(feed, machine) for feed in OVERCUT_FEEDS_UM_S]
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


# --- gaps over the energy of the pulses ---

WIDER = (
    f"{setups.PRACTICE}: more energy per pulse, a wider gap at one voltage; {discharges.ESTEVES_2023}: energy "
    "influences the delay"
)
OPEN_SHARE = 0.2  # share of open pulses that the servo of these cuts holds (ours: far from a jam of the rough cut)
BRIEF_US, LONG_US = 0.4, 1.4
"""On-times at one current and pause: the longer pulse has 3.5 times the energy (ours)."""


def gap_over_energy(seeds: Seeds) -> list[Row]:
    """Compare the gap at discharges of short and long pulses with the same peak."""
    rig = breakage.rough_rig(breakage.ROUGH_MM)
    brief, long = (
        setups.servo_cuts(setups.with_on_time(rig, on), seeds, open_share=OPEN_SHARE) for on in (BRIEF_US, LONG_US)
    )
    return [Row.sign("kerf", f"gap at the discharges of a rough cut, on-time {BRIEF_US:g} to {LONG_US:g} us", WIDER,
                     rises=True, simulated=differences(brief, long, lambda cut: cut.gap_um), unit="um", note=GAPS)]


FINE_MJ, FINE_ON_US = 0.05, 0.2
COARSE_MJ, COARSE_ON_US = 10.0, 1.4  # a pulse of fine cuts and one of rough cuts, triangles both (ours: usual orders)
SIDE_MM, SIDE_V, SIDE_PA = 5.0, 80.0, 0.2e5
"""For both: height (ours: fine pulses cut slowly), open voltage, the nominal one of the ignition law, and pressure of
the nozzles (ours: that of trims and sheet)."""
START_GAP_UM = 10.0
"""Gap of the initial slot (ours: narrower than that of fine pulses, so the slot is not measured)."""
SETTLED_UM, KERF_UM, LONGEST_S = 40.0, 20.0, 600.0
"""Travel until the kerf is determined by the pulses, measured length of kerf, and greatest machine time (ours)."""
FEW = 3  # seeds of these slots (ours: a slot takes five million fine pulses)


def side_gap_over_energy(seeds: Seeds) -> list[Row]:
    """Compare the side gap of slots cut with fine pulses and with those of a rough cut."""
    fine, coarse = (
        [side_gap_um(slot_rig(energy, on), seed) for seed in seeds[:FEW]]
        for energy, on in ((FINE_MJ, FINE_ON_US), (COARSE_MJ, COARSE_ON_US))
    )
    return [Row.sign("kerf", f"side gap, {FINE_MJ:g} to {COARSE_MJ:g} mJ per discharge at {SIDE_V:g} V", WIDER,
                     rises=True, simulated=differences(fine, coarse), unit="um", note=GAPS)]


def slot_rig(energy_mJ: float, t_on_us: float) -> Machine:
    """Return a production machine with triangles of an energy and a duration, and the pause of rough cuts."""
    burning_V = Machine.load().material.burning_voltage_V.value
    machine = Machine.load(
        "production", generator="production", height_mm=SIDE_MM, open_voltage_V=SIDE_V, t_on_us=t_on_us,
        t_period_us=t_on_us + breakage.ROUGH_PERIOD_US - COARSE_ON_US, flushing_lower_Pa=SIDE_PA,
        flushing_upper_Pa=SIDE_PA, peak_current_A=2 * energy_mJ * 1e3 / (burning_V * t_on_us),
    )
    return setups.altered(machine, setups.UNBREAKABLE)


def side_gap_um(machine: Machine, seed: int) -> float:
    """Cut a slot; return half of the kerf minus the wire, NaN if it jams or takes longer than `LONGEST_S`."""
    plant = begin(machine, seed, gap_um=START_GAP_UM)
    traverse = Traverse(plant, from_text(quick_counts(OPEN_SHARE)))

    def run_to(x_um: float) -> list[PulseWindow]:
        windows = []
        while plant.commanded_um[0] < x_um and plant.time_ns < LONGEST_S * 1e9:
            windows.append(traverse.window())
        return windows

    try:
        run_to(plant.commanded_um[0] + SETTLED_UM)
        from_um = plant.commanded_um[0]
        windows = run_to(from_um + machine.wire_diameter_um / 2 + SLOT_GAP_UM + KERF_UM)
    except window.PlantError:
        return math.nan
    if plant.time_ns >= LONGEST_S * 1e9:
        return math.nan
    cut = Cut(plant, windows, from_um, plant.commanded_um[0] - from_um)
    return (float(cut.kerf_um.mean()) - machine.wire_diameter_um) / 2


# --- delays in debris ---

REMAINS = f"{discharges.THESIS}: the flow carries the remains of discharges off, and the delays rise"
PARTICLES = "docs/theory/breakdown.md#particles"

SPEEDS_M_S = (0.0, 1.0, 2.0)  # mean flow speeds of figure 2-9
HOLE_UM, HOLE_V = 25.0, 80.0
"""Gap and open voltage, the nominal one of the ignition law (ours: at the figure's 300 V all its gaps would be below
the critical one by equal fields, with or without debris)."""
SPARK_A = 1.2  # energy of discharges (ours, not published: craters so small that the hole keeps its gap to 1 um)
HOLES, BEFORE, MEASURED = 6, 1, 1
"""Holes per seed, windows of 25 ms until the debris in flowing water is steady, and measured windows."""


def delay_in_debris(seeds: Seeds) -> list[Row]:
    """Compare the mean delay in the debris of discharges, over the speed of the water that removes it."""
    # craters remove metal here, because only they make debris; all other motion of the water is off
    delay = {
        speed: [
            discharges.mean_delay_us([w for hole in range(HOLES) for w in in_debris(speed, HOLES * seed + hole)])
            for seed in seeds
        ]
        for speed in SPEEDS_M_S
    }
    return [
        Row.sign("ignition", f"mean delay among debris, flow {slow:g} to {quick:g} m/s", REMAINS, rises=True,
                 simulated=differences(delay[slow], delay[quick]), unit="us", note=discharges.FLOW)
        for slow, quick in pairwise(SPEEDS_M_S)
    ]


def in_debris(speed_m_s: float, seed: int) -> list[PulseWindow]:
    """Fire pulses as long as those of figure 2-9 in a hole with their own debris and a flow."""
    usual = Machine.load()
    still, metal = discharges.thesis_machine(speed_m_s, HOLE_V, usual.height_mm), usual.material
    ohm = (still.generator.open_voltage_V.value - metal.burning_voltage_V.value) / SPARK_A
    changes = {"material.removal_mm3_J": metal.removal_mm3_J.value, "generator.resistance_ohm": ohm}
    plant = setups.in_a_hole(setups.altered(still, changes), discharges.hole_gap_um(still, HOLE_UM, seed), seed)
    return [plant.advance() for _ in range(BEFORE + MEASURED)][BEFORE:]


# --- sizes of the particles ---

SIZES = (
    "particles with exponential sizes that hold the volume of the debris, N(> x) = c / (pi d^3) exp(-x / d), ignite "
    "where they leave the critical gap (derived)"
)
NEAR_UM, NEAR_SHARE = 13.0, 1e-6
"""Gap near the critical one, where particles of some mean sizes ignite, and a debris share at which half of the
pulses meet none (ours)."""
FAR_UM, FAR_SHARE = (28.0, 30.0, 32.0), 0.01
"""Gaps of rough cuts, where only the largest particles ignite, and a share at which some pulses meet one (ours)."""
LOADED_WINDOWS = 16  # windows per seed and gap: 4080 pulses


def particles(seeds: Seeds) -> list[Row]:
    """Compare the number of particles that ignite in a hole with debris, and its decrease with the gap."""
    critical_um, size_um = Machine.load().base.gap.critical_um.value, mean_size_um(_at_80_V())
    sizes = (np.array(FAR_UM) - critical_um) / size_um
    over = [[math.log(counted(gap, FAR_SHARE, seed)) for gap in FAR_UM] for seed in seeds]
    return [
        Row.value("ignition", f"number of particles that ignite at {NEAR_UM:g} um over the law's", SIZES,
                  published=1.0, simulated=[counted(NEAR_UM, NEAR_SHARE, seed) for seed in seeds], within=0.1,
                  note=PARTICLES),
        Row.value("ignition", f"fall of that number over {FAR_UM[0]:g} to {FAR_UM[-1]:g} um, e-folds per mean size",
                  SIZES, published=-1.0, within=0.1,
                  simulated=[float(np.polyfit(sizes, of, 1)[0]) - 1 for of in over], note=PARTICLES),
    ]


def counted(gap_um: float, share: float, seed: int) -> float:
    """Return the number of particles that ignite, from the share of pulses that meet none, over the law's number."""
    # the law is summed over the gaps of the rays, with the wire's whole surface as area
    machine, gap = loaded_machine(), Machine.load().base.gap
    plant = discharges.isolated_gap(machine, gap_um, seed)
    setups.load_debris(plant, share)
    windows = [plant.advance() for _ in range(LOADED_WINDOWS)]
    none = max(sum(w.open for w in windows), 1)  # a lower bound if every pulse meets one
    found = -math.log(none / sum(w.pulses for w in windows))
    gaps_um, size_um = discharges.ray_gaps_um(plant), mean_size_um(_at_80_V())
    area_um2 = math.pi * machine.wire_diameter_um * machine.height_mm * 1e3
    per_um3 = share / (math.pi * size_um**3) * np.exp(-(gaps_um - gap.critical_um.value) / size_um)
    return found / (area_um2 * float(np.mean(gaps_um * per_um3)))


def mean_size_um(machine: Machine) -> float:
    """Return the mean particle size of a setting's debris."""
    return float(machine.base.gap.particle_share.value * crater_um3(machine) ** (1 / 3))


def loaded_machine() -> Machine:
    """Return the default machine at the law's nominal voltage, with constant debris of its particle size."""
    usual = _at_80_V()
    still = setups.altered(usual, {**setups.STILL, **discharges.STILL_WATER, **setups.NO_IGNITION})
    return setups.altered(still, {"base.gap.particle_share": mean_size_um(usual) / crater_um3(still) ** (1 / 3)})


def _at_80_V() -> Machine:
    return setups.altered(Machine.load(), {"generator.open_voltage_V": HOLE_V})


# --- roughness ---

ROUGHNESS = "usual: Ra = C E^n, n = 0.3..0.4; rough cuts 2.5..4 um"
ON_TIMES_US = (10.0, 30.0, 74.0)  # on-times of discharges of 1, 4 and 10 mJ on average (ours)


def roughness(seeds: Seeds) -> list[Row]:
    """Compare Ra from the craters of a cut, over the energy of its discharges."""
    by_on_time = {on: [_ra_and_energy(on, seed) for seed in seeds] for on in ON_TIMES_US}
    logarithms = [np.log(cuts).T for cuts in zip(*by_on_time.values(), strict=True)]
    return [
        Row.band("roughness", "Ra over energy per discharge, exponent", ROUGHNESS, low=0.3, high=0.4,
                 simulated=[float(np.polyfit(energy, ra_um, 1)[0]) for ra_um, energy in logarithms]),
        Row.band("roughness", "Ra of a rough cut, 10 mJ per discharge", ROUGHNESS, low=2.5, high=4.0, unit="um",
                 simulated=[ra_um for ra_um, _ in by_on_time[ON_TIMES_US[-1]]], note=f"{PAGE}#roughness"),
    ]


def _ra_and_energy(t_on_us: float, seed: int) -> tuple[float, float]:
    """Cut at an on-time; return Ra in um and the mean energy of a discharge in J."""
    machine = Machine.load(t_on_us=t_on_us, t_period_us=max(t_on_us + 60.0, 4 * t_on_us))
    cut = cut_straight(machine, make("counts"), seed, settle_s=4.0, seconds=6.0)
    volume_um3 = cut.removed_mm3 * 1e9 / cut.ignitions
    flatness = machine.base.discharge.crater_flatness.value
    return roughness_um(volume_um3, flatness), cut.energy / cut.ignitions


CHECKS: Checks = {
    pulse_trains: ("pulse ratios",), debris: ("debris",), causes: ("shorts",), rate_over_shorts: ("shorts",),
    price: ("shorts",), jams: ("shorts",), removal: ("removal", "kerf"), pauses: ("removal",),
    thickness: ("removal",), diameters: ("kerf",), overcut: ("kerf",), gap_over_energy: ("kerf",),
    side_gap_over_energy: ("kerf",), delay_in_debris: ("ignition",), particles: ("ignition",),
    roughness: ("roughness",),
}
