"""Rows on the wire's position: lag and experiments on its causes, trims along a wall, vibration, corners."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from shapely import LineString, distance, points

from edmsim.closed_loop.straight import Cut, Traverse, begin, cut_straight
from edmsim.controllers import FeedController
from edmsim.machine.machine import Machine
from edmsim.plant.plant import Plant
from edmsim.plant.workpiece.kerf_field import Stock
from edmsim.validation.breakage import ROUGH_MM, ROUGH_TENSION_N, rough_rig
from edmsim.validation.cuts import drum_um
from edmsim.validation.rows import Checks, Row, Seeds, differences, extended, ratios
from edmsim.validation.setups import PRACTICE, UNBREAKABLE, altered, servo_cuts, with_on_time

LAG = "usual lag of rough cuts"
TRAILS = f"{PRACTICE}: the wire trails its guides"
STILLNESS = f"{PRACTICE}: below a third of the gap of rough cuts, 30 um"
JET = (
    "Iwai, Liu, Ebisu, Okada, Kurihara, JSPE (2020): hydrodynamic force on the wire as large as the explosive force "
    "in first cuts"
)
DRUM = f"{PRACTICE}: walls of 40 mm are hollow by 5 to 20 um"
STRING = "taut string: deflection = load / tension (derived; Sarkar et al., Precision Engineering 35:339 (2011))"
TRIM = "push ~ root of the energy against pull ~ square of the voltage (derived; the sign is what practice knows)"
PAGE = "docs/theory/emergence.md"
LAG_PAGE = f"{PAGE}#lag"
NO_NUMBER = "no impulse, force or lag of a discharge is published in any unit"
RANGE = f"{NO_NUMBER}: the constant's range is what is known"
EXPERIMENT = "an experiment that would settle it, not made as far as is known"

IMPULSE, MAGNETIC = "base.discharge.impulse_10mJ_Ns", "material.magnetic_share"
NON_MAGNETIC = {MAGNETIC: -0.02}
"""Austenitic steel (ours, derived: eddy currents at some 0.4 MHz in a metal of 1.4e6 S/m repel slightly)."""
TALL_MM = 60.0  # height of the tall rough cut (ours)
TAUTER = 1.4  # factor on the tension (ours: 10 to 14 N)
ON_TIMES_US = (0.4, 1.6)
"""On-times at one current with a ratio of four (ours: as far as the generator's mean current allows)."""
ROUGH_OPEN_SHARE = 0.2
"""Share of open pulses that the servo of the rough cuts holds (ours: at 0.1 a cut in austenite nearly jams)."""
DEFAULT_S = 12.0  # machine times in which the default set-up settles and is measured


def rough_cuts(seeds: Seeds, machine: Machine, seconds: float = 3.0) -> list[Cut]:
    """Cut with a servo and every seed."""
    return servo_cuts(machine, seeds, open_share=ROUGH_OPEN_SHARE, seconds=seconds)


def _lag_um(cut: Cut) -> float:
    return cut.lag_um


def _report(name: str, reason: str, found: Sequence[float], unit: str = "um") -> Row:
    return Row.report("lag", name, reason, simulated=found, unit=unit)


def impulse_ends(machine: Machine) -> tuple[float, float]:
    """Return the range of the impulse of a discharge of 10 mJ."""
    bounds = machine.base.discharge.impulse_10mJ_Ns.range
    assert bounds is not None
    return bounds


def rough_lag(seeds: Seeds) -> list[Row]:
    """Compare lag and vibration of rough cuts, the lag's range, and effects of magnetism, tension, height, jets."""
    base = rough_cuts(seeds, rough_rig(ROUGH_MM))
    without_um = [cut.lag_um for cut in rough_cuts(seeds, rough_rig(ROUGH_MM, {MAGNETIC: 0.0}))]
    # in tool steel push, pull and magnetic force nearly cancel, so the string law is checked in austenitic steel
    pushed = rough_cuts(seeds, rough_rig(ROUGH_MM, NON_MAGNETIC))
    taut = rough_cuts(seeds, rough_rig(ROUGH_MM, NON_MAGNETIC, tension=TAUTER * ROUGH_TENSION_N))
    tall = rough_cuts(seeds, rough_rig(TALL_MM, NON_MAGNETIC))
    return [
        _usual("lag of a rough cut, 30 mm, 11 mJ per discharge", base),
        _usual("lag of a rough cut in austenitic steel, 30 mm", pushed),
        Row.band("vibration", "rms vibration of a rough cut, 30 mm", STILLNESS, high=10.0, unit="um",
                 simulated=[cut.vibration_um for cut in base], note=f"{PAGE}#vibration")
        .calibration("bubble_share, 0.01 to 0.1 by its derivation, was set to 0.02 to fit this vibration and the "
                     "60 000 discharges per second of Sato's stable cutting"),
        Row.value("lag", "deflection of a rough cut in austenitic steel, tension x1.4 over x1", STRING,
                  published=1 / TAUTER, simulated=ratios(pushed, taut, _lag_um), within=0.15, note=LAG_PAGE),
        Row.sign("lag", "lag of a rough cut in austenitic steel, 30 to 60 mm high", STRING, rises=True,
                 simulated=differences(pushed, tall, _lag_um), unit="um", note=LAG_PAGE),
        jets(pushed, seeds),
        _report("lag of that cut without the magnetic force", "no source separates the two forces", without_um),
        *(
            _report(f"lag of that cut, impulse {impulse:g} N s at 10 mJ", RANGE,
                    [*map(_lag_um, rough_cuts(seeds, rough_rig(ROUGH_MM, {IMPULSE: impulse})))])
            for impulse in impulse_ends(rough_rig(ROUGH_MM))
        ),
    ]


def _usual(name: str, cuts: Sequence[Cut]) -> Row:
    return Row.band("lag", name, LAG, low=10.0, high=100.0, simulated=[*map(_lag_um, cuts)], unit="um", note=LAG_PAGE)


WEAK_PA = 0.2e5  # pressure of both nozzles at which jets hardly act: a tenth of that of the rough cut


def jets(flushed: Sequence[Cut], seeds: Seeds) -> Row:
    """Compare the lag of a rough cut in austenitic steel with that in a weak flow."""
    machine = rough_rig(ROUGH_MM, NON_MAGNETIC)
    weak = rough_cuts(seeds, machine.with_(flushing_lower_Pa=WEAK_PA, flushing_upper_Pa=WEAK_PA))
    usual_Pa = machine.base.dielectric.flushing_pressure_Pa.value
    return Row.sign(
        "lag", f"lag of a rough cut in austenitic steel, {WEAK_PA / 1e5:g} to {usual_Pa / 1e5:g} bar", JET,
        rises=True, simulated=differences(weak, flushed, _lag_um), unit="um", note=LAG_PAGE,
    )


def default_lag(seeds: Seeds) -> list[Row]:
    """Report the lag of the default cut with the servo, over the range of the impulse."""

    def found(changes: Mapping[str, float]) -> list[float]:
        return [*map(_lag_um, servo_cuts(altered(Machine.load(), changes), seeds, seconds=DEFAULT_S))]

    return [
        _report("lag of the default cut, 20 mm, 4 mJ per discharge", NO_NUMBER, found({})),
        *(
            _report(f"lag of the default cut, impulse {impulse:g} N s at 10 mJ", RANGE, found({IMPULSE: impulse}))
            for impulse in impulse_ends(Machine.load())
        ),
    ]


def experiments(seeds: Seeds) -> list[Row]:
    """Report the model's predictions for the two experiments that would separate the causes of the lag."""
    steel = rough_cuts(seeds, rough_rig(ROUGH_MM))
    rig = rough_rig(ROUGH_MM, NON_MAGNETIC)
    other = rough_cuts(seeds, rig)
    brief, long = (rough_cuts(seeds, with_on_time(rig, on)) for on in ON_TIMES_US)
    names = "{1:g} over {0:g} us".format(*ON_TIMES_US)
    return [
        _report("lag of that cut in austenitic steel less that in tool steel", EXPERIMENT,
                differences(steel, other, _lag_um)),
        _report(f"lag in austenitic steel at one current, on-time {names}", EXPERIMENT,
                ratios(brief, long, _lag_um), ""),
        _report(f"energy per discharge of these, on-time {names}", EXPERIMENT,
                ratios(brief, long, lambda cut: cut.energy / cut.ignitions), ""),
    ]


# --- lag over the height ---

HEIGHTS_MM, RISES_TO_MM = (10.0, 20.0, 40.0, 80.0, 120.0), 80.0  # where the wire must lag; the lag rises up to
DRUM_MM = 40.0
DEFAULT_HEIGHTS_MM = (10.0, 40.0, 80.0)
PRODUCTION_S = 20.0  # in which production cuts settle, and are measured (ours: both travel by more than the wire)
FEW = 4  # seeds of these cuts (ours: the sign of whole um is compared)


def lag_over_height(seeds: Seeds) -> list[Row]:
    """Compare the lag of the production machine over the height, with an unbreakable wire; and the wall's hollow."""
    cuts = {}
    for height in HEIGHTS_MM:
        machine = altered(Machine.load("production", generator="production", height_mm=height), UNBREAKABLE)
        cuts[height] = rough_cuts(seeds[:FEW], machine, PRODUCTION_S)
    least = HEIGHTS_MM[0]
    return [
        *(_trails(f"lag of the production machine, {height:g} mm high", cuts[height]) for height in HEIGHTS_MM),
        Row.sign("lag", f"lag of the production machine, {least:g} to {RISES_TO_MM:g} mm high",
                 f"{TRAILS}, ever more", rises=True, unit="um", note=LAG_PAGE,
                 simulated=differences(cuts[least], cuts[RISES_TO_MM], _lag_um)),
        Row.band("debris", f"hollow of the production machine's wall at mid-height, {DRUM_MM:g} mm high", DRUM,
                 low=5.0, high=20.0, simulated=[drum_um(cut) / 2 for cut in cuts[DRUM_MM]], unit="um",
                 note=f"{PAGE}#debris-and-flushing"),
    ]


def default_over_height(seeds: Seeds) -> list[Row]:
    """Compare the lag of the default set-up at other heights."""
    rows = []
    for height in DEFAULT_HEIGHTS_MM:
        cuts = rough_cuts(seeds[:FEW], Machine.load(height_mm=height), DEFAULT_S)
        rows.append(_trails(f"lag of the default cut, {height:g} mm high", cuts))
    return rows


def _trails(name: str, cuts: Sequence[Cut]) -> Row:
    return Row.sign("lag", name, TRAILS, rises=True, published="positive", simulated=[*map(_lag_um, cuts)], unit="um",
                    note=LAG_PAGE)


# --- trim cuts ---

TRIM_HEIGHT_MM, TRIM_ON_US, TRIM_PERIOD_US, TRIM_FEED_UM_S = 20.0, 0.5, 20.0, 40.0
"""Trim cut: workpiece, on-time and least period, feed along the wall (ours: usual orders)."""
TRIM_UM = 20.0  # distance of the wire's surface from the wall: near enough for trimming, too far for shorts (ours)
TRIM_MJ = (0.03, 0.1, 0.3, 1.0, 3.0)  # energies of trim and finishing pulses, and beyond (ours)
LOWER_V, TRIM_V = 60.0, 80.0
AHEAD_UM = 30.0  # distance from the wire to the beginning of the wall, and travel before the measurement


def trim_machine(energy_mJ: float, open_V: float = TRIM_V) -> Machine:
    """Return a production machine with trim pulses of an energy, at the same duration of the triangles."""
    burning_V = Machine.load().material.burning_voltage_V.value
    return Machine.load(
        "production", generator="production", height_mm=TRIM_HEIGHT_MM, open_voltage_V=open_V, t_on_us=TRIM_ON_US,
        t_period_us=TRIM_PERIOD_US, peak_current_A=2 * energy_mJ * 1e3 / (burning_V * TRIM_ON_US),
    )


def trim(machine: Machine, seed: int) -> tuple[float, float]:
    """Cut along a wall to the left of the feed; return mean deflection towards it in um, and share of shorts."""
    centre_um = x, y = machine.base.table.centre_um
    radius, travel = machine.wire_diameter_um / 2, machine.base.table.travel_mm.value * 1e3
    stock = Stock((x + radius + AHEAD_UM, y + radius + TRIM_UM, travel, travel))
    plant = Plant(machine, seed, stock=stock, position_um=centre_um, resolution="fast")
    traverse = Traverse(plant, TRIM_FEED_UM_S)
    traverse.run(3 * radius / TRIM_FEED_UM_S)
    windows = traverse.run(300.0 / TRIM_FEED_UM_S)
    cut = Cut(plant, windows, x, 300.0)
    return float(np.mean([w.deflection_um[1] for w in windows])), cut.share("short")


def trims(seeds: Seeds) -> list[Row]:
    """Compare the deflection towards the wall over energy and voltage, and the energy at which its sign changes."""
    runs = {energy: [trim(trim_machine(energy), seed) for seed in seeds] for energy in TRIM_MJ}
    towards = {energy: [run[0] for run in of] for energy, of in runs.items()}
    lower = [trim(trim_machine(TRIM_MJ[0], LOWER_V), seed) for seed in seeds]
    shorts = max(float(np.mean([run[1] for run in of])) for of in (*runs.values(), lower))
    note = f"{PAGE}#trim-cuts"
    least, most = TRIM_MJ[0], TRIM_MJ[-1]
    return [
        Row.band("trim cuts", "short share of trim cuts, the largest", "trim cuts have next to no shorts", high=0.05,
                 simulated=shorts, note=note),
        Row.sign("trim cuts", f"deflection towards the wall, trim pulses of {least:g} mJ", TRIM, rises=True,
                 simulated=towards[least], unit="um", note=note),
        Row.sign("trim cuts", f"deflection towards the wall, {least:g} to {most:g} mJ", TRIM, rises=False,
                 simulated=differences(towards[least], towards[most]), unit="um", note=note),
        Row.value("trim cuts", f"deflection towards the wall, {TRIM_V:g} over {LOWER_V:g} V, {least:g} mJ", TRIM,
                  published=(TRIM_V / LOWER_V) ** 2, simulated=ratios([run[0] for run in lower], towards[least]),
                  within=0.25, note=note),
        Row.report("trim cuts", f"energy of a pulse that neither draws nor pushes (infinite: above {most:g} mJ)",
                   NO_NUMBER, simulated=crossing_mJ([float(np.mean(of)) for of in towards.values()]), unit="mJ"),
    ]


def crossing_mJ(towards_um: Sequence[float]) -> float:
    """Return the energy within `TRIM_MJ` at which the deflection falls below 0; infinite if it does not."""
    for k in range(len(TRIM_MJ) - 1):
        before, after = towards_um[k], towards_um[k + 1]
        if before > 0.0 >= after:
            share = before / (before - after)
            return float(TRIM_MJ[k] * math.exp(share * math.log(TRIM_MJ[k + 1] / TRIM_MJ[k])))
    return math.inf


# --- vibration ---

HABIB = "Habib, Mech. Adv. Mater. Mod. Process. 3 (2017), doi:10.1186/s40759-017-0017-1"
NO_SIGN = (
    "the source has a fit with squares and products, whose slopes are as large as the linear terms; its units and "
    "settings are not known, so neither is the sign of the effect"
)
FEED_UM_S = 20.0  # feed of the cuts for vibration: half of the pulses are open (ours)


def vibration(seeds: Seeds) -> list[Row]:
    """Compare signs of Habib's linear terms for the wire's vibration; a higher servo voltage is a lower feed here."""
    machine = Machine.load()
    water, guides = machine.base.dielectric, machine.base.guides
    stronger = {"base.dielectric.flushing_pressure_Pa": 3 * water.flushing_pressure_Pa.value}
    quicker = {"base.guides.wire_speed_m_s": 2 * guides.wire_speed_m_s.value}

    def vibration_um(machine: Machine, feed_um_s: float = FEED_UM_S) -> list[float]:
        return [cut_straight(machine, feed_um_s, seed, settle_s=6.0, seconds=10.0).vibration_um for seed in seeds]

    base_um = vibration_um(machine)

    def row(name: str, changed_um: Sequence[float]) -> Row:
        return Row.sign("vibration", f"rms vibration, {name}", HABIB, rises=False, unit="um",
                        simulated=differences(base_um, changed_um), note=f"{PAGE}#vibration")

    return [
        row("tension x1.4", vibration_um(machine.with_(tension=1.4 * machine.tension))),
        *(
            row(name, changed_um).context(NO_SIGN)
            for name, changed_um in (
                ("servo voltage (feed x0.8)", vibration_um(machine, 0.8 * FEED_UM_S)),
                ("flow rate (pressure x3)", vibration_um(altered(machine, stronger))),
                ("running speed x2", vibration_um(altered(machine, quicker))),
            )
        ),
    ]


# --- corners ---

PURSUIT = "constant-lag pursuit through 90 degrees (derived)"
UNDERCUT = f"{PRACTICE}: outside corners are undercut the more the faster the feed, where the wire lags"
CORNERS = "corner error from lag: doi:10.1177/0954405412456660 varies it by tension"
CORNER_PAGE = f"{PAGE}#corner"
CORNER_HEIGHT_MM, CORNER_FEED_UM_S = 60.0, 20.0  # height and feed of the corner (ours: a lag of some 20 um)
SLOW_UM_S = CORNER_FEED_UM_S / 2  # lower feed, at which the corner should be undercut less (ours)
TURNS = 12  # seeds of the corners at two feeds
# Ours: the least effect to detect is 0.5 um, half of the path's grid, and half of it is the interval. The differences
# of four seeds in tool steel had a standard deviation of 0.35 um: 2.20 x 0.35 / sqrt(12) = 0.22 um.
BEFORE_UM, AFTER_UM = 320.0, 320.0  # travel before and after the corner: at least eight lags
LONGEST_S = 600.0  # greatest machine time of both (ours: enough for 0.5 um/s)
SMOOTHED_UM = 1.5  # travel over which the wire's path is averaged, to remove vibration


class CornerPass(NamedTuple):
    """The path of a wire round a corner of 90 degrees."""

    lag_um: float  # lag on the straight before it
    nearest_um: float  # least distance of the wire's path from the corner
    # largest distance of the wire's path from that of the guides: inside the corner if the wire lags, outside it if
    # the wire leads
    farthest_um: float
    # nearest distance inside the corner along its bisector; negative outside
    inside_um: float


def corner(seeds: Seeds) -> list[Row]:
    """Compare the corner error of a lagging wire with the pursuit of constant lag, and over tension."""
    slack = [cut_corner(corner_rig(5.0), seed) for seed in seeds]
    taut = [cut_corner(corner_rig(10.0), seed) for seed in seeds]
    return [
        Row.value("corner", "nearest approach to the corner over lag, 90 degrees", PURSUIT, published=0.6628,
                  simulated=[one.nearest_um / one.lag_um for one in slack], within=0.2, note=CORNER_PAGE),
        Row.sign("corner", "passage of a wire that lags, inside the corner", PURSUIT, rises=True, unit="um",
                 simulated=[one.inside_um for one in slack], note=CORNER_PAGE),
        Row.sign("corner", "nearest approach to the corner, tension 5 to 10 N", CORNERS, rises=False, unit="um",
                 simulated=differences(slack, taut, lambda one: one.nearest_um), note=CORNER_PAGE),
    ]


def corner_rig(tension: float) -> Machine:
    """Return the rough cut in a non-magnetic metal, where the lag is largest, with an unchanged pull."""
    return rough_rig(CORNER_HEIGHT_MM, NON_MAGNETIC, tension=tension)


def cut_corner(
    machine: Machine, seed: int, watch: Callable[[tuple[float, float], bool], None] | None = None, *,
    feed: float | FeedController = CORNER_FEED_UM_S,
) -> CornerPass:
    """Cut along +x, then along +y; NaN if the wire broke, or did not pass the corner within `LONGEST_S`."""
    plant, centre_um = begin(machine, seed), machine.base.table.centre_um
    traverse = Traverse(plant, feed)
    places, lags = [], []
    for axis, length_um in ((0, BEFORE_UM), (1, AFTER_UM)):
        traverse.axis = axis
        while plant.commanded_um[axis] - centre_um[axis] < length_um:
            window = traverse.window()
            if window.broken or plant.time_ns > LONGEST_S * 1e9:
                return CornerPass(math.nan, math.nan, math.nan, math.nan)
            x, y = plant.commanded_um
            deflection = window.deflection_um
            places.append((x + deflection[0], y + deflection[1]))
            if axis == 0 and x - centre_um[0] > BEFORE_UM / 2:
                lags.append(-deflection[0])
            if watch is not None:
                watch(deflection, axis == 1)
    corner_um = (plant.commanded_um[0], centre_um[1])
    beyond_um = (corner_um[0], plant.commanded_um[1] + AFTER_UM)  # a leading wire is ahead of the guides at the end
    guides = LineString([centre_um, corner_um, beyond_um])
    count = max(1, round(len(places) * SMOOTHED_UM / (BEFORE_UM + AFTER_UM)))
    path = np.lib.stride_tricks.sliding_window_view(np.array(places), count, axis=0).mean(axis=-1)
    passing = min(path, key=lambda place: math.dist(place, corner_um))
    inside = ((corner_um[0] - passing[0]) + (passing[1] - corner_um[1])) / math.sqrt(2)
    farthest = float(distance(points(path), guides).max())
    return CornerPass(float(np.mean(lags)), math.dist(passing, corner_um), farthest, float(inside))


def corner_over_feed(seeds: Seeds) -> list[Row]:
    """Compare the undercut of an outer corner in a rough cut over the feed: austenitic and tool steel."""
    rows = []
    for metal, machine in (
        ("austenitic steel", corner_rig(ROUGH_TENSION_N)), ("tool steel", rough_rig(CORNER_HEIGHT_MM)),
    ):
        slow, quick = (
            [cut_corner(machine, seed, feed=feed).inside_um for seed in extended(seeds, TURNS)]
            for feed in (SLOW_UM_S, CORNER_FEED_UM_S)
        )
        rows.append(
            Row.sign("corner", f"undercut of a corner in {metal}, feed {SLOW_UM_S:g} to {CORNER_FEED_UM_S:g} um/s",
                     UNDERCUT, rises=True, simulated=differences(slow, quick), unit="um", note=CORNER_PAGE)
        )
    return rows


CHECKS: Checks = {
    rough_lag: ("lag", "vibration"), default_lag: ("lag",), experiments: ("lag",), lag_over_height: ("lag", "debris"),
    default_over_height: ("lag",), trims: ("trim cuts",), vibration: ("vibration",), corner: ("corner",),
    corner_over_feed: ("corner",),
}
