"""Rows on the part's quality and the wire's motion: roughness, vibration, corner error."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from shapely import LineString, distance, points

from edmsim.controllers import FeedController, make
from edmsim.cosim.straight import Traverse, begin, cut_straight
from edmsim.machine.machine import Machine
from edmsim.metrology.roughness import roughness_um
from edmsim.validation.breakage import ROUGH_TENSION_N, rough_rig
from edmsim.validation.lag import NON_MAGNETIC
from edmsim.validation.rows import Checks, Row, Seeds, differences, extended
from edmsim.validation.setups import PRACTICE, altered

ROUGHNESS = "usual: Ra = C E^n, n = 0.3..0.4; rough cuts 2.5..4 um"
HABIB = "Habib, Mech. Adv. Mater. Mod. Process. 3 (2017), doi:10.1186/s40759-017-0017-1: linear term"
PURSUIT = "constant-lag pursuit through 90 degrees (derived)"
FEED = f"{PRACTICE}: outside corners are undercut the more the faster the feed, where the wire lags"
CORNERS = "corner error from lag: doi:10.1177/0954405412456660 varies it by tension"
PAGE = "docs/theory/emergence.md"

ON_TIMES_US = (10.0, 30.0, 74.0)  # on-times of discharges of 1, 4 and 10 mJ on average (ours)


def roughness(seeds: Seeds) -> list[Row]:
    """Compare Ra from the craters of a cut, over the energy of its discharges."""
    by_on_time = {on: [_ra_and_energy(on, seed) for seed in seeds] for on in ON_TIMES_US}
    logarithms = [np.log(cuts).T for cuts in zip(*by_on_time.values(), strict=True)]
    return [
        Row.band("roughness", "Ra over energy per discharge, exponent", ROUGHNESS, low=0.3, high=0.4,
                 simulated=[float(np.polyfit(energy, ra_um, 1)[0]) for ra_um, energy in logarithms]),
        Row.band("roughness", "Ra of a rough cut, 10 mJ per discharge", ROUGHNESS, low=2.5, high=4.0, unit="um",
                 simulated=[one.ra_um for one in by_on_time[ON_TIMES_US[-1]]], note=f"{PAGE}#roughness"),
    ]


class Roughness(NamedTuple):
    """Return the roughness of a cut and the mean energy of its discharges in J."""

    ra_um: float
    energy: float


def _ra_and_energy(t_on_us: float, seed: int) -> Roughness:
    machine = Machine.load(t_on_us=t_on_us, t_period_us=max(t_on_us + 60.0, 4 * t_on_us))
    cut = cut_straight(machine, make("counts"), seed, settle_s=4.0, seconds=6.0)
    volume_um3 = cut.removed_mm3 * 1e9 / cut.ignitions
    flatness = machine.base.discharge.crater_flatness.value
    return Roughness(roughness_um(volume_um3, flatness), cut.energy / cut.ignitions)


FEED_UM_S = 20.0  # feed of the cuts for vibration: half of the pulses are open (ours)


def vibration(seeds: Seeds) -> list[Row]:
    """Compare signs of Habib's linear terms for the wire's vibration; a higher servo voltage is a lower feed here."""
    machine = Machine.load()
    water, guides = machine.base.dielectric, machine.base.guides
    stronger = {"base.dielectric.flushing_pressure_Pa": 3 * water.flushing_pressure_Pa.value}
    quicker = {"base.guides.wire_speed_m_s": 2 * guides.wire_speed_m_s.value}
    taut = machine.with_(tension=1.4 * machine.tension)
    note = f"{PAGE}#vibration"

    def vibration_um(machine: Machine, feed_um_s: float = FEED_UM_S) -> list[float]:
        return [cut_straight(machine, feed_um_s, seed, settle_s=6.0, seconds=10.0).vibration_um for seed in seeds]

    base_um = vibration_um(machine)
    changed = (
        ("tension x1.4", vibration_um(taut), ""),
        ("servo voltage (feed x0.8)", vibration_um(machine, 0.8 * FEED_UM_S), ""),
        ("flow rate (pressure x3)", vibration_um(altered(machine, stronger)), note),
        ("running speed x2", vibration_um(altered(machine, quicker)), note),
    )
    return [
        Row.sign("vibration", f"rms vibration, {name}", HABIB, rises=False, unit="um",
                 simulated=differences(base_um, changed_um), note=why)
        for name, changed_um, why in changed
    ]


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
                  simulated=[one.nearest_um / one.lag_um for one in slack], within=0.2, note=f"{PAGE}#corner"),
        Row.sign("corner", "passage of a wire that lags, inside the corner", PURSUIT, rises=True, unit="um",
                 simulated=[one.inside_um for one in slack], note=f"{PAGE}#corner"),
        Row.sign("corner", "nearest approach to the corner, tension 5 to 10 N", CORNERS, rises=False, unit="um",
                 simulated=differences(slack, taut, lambda one: one.nearest_um), note=f"{PAGE}#corner"),
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
                     FEED, rises=True, simulated=differences(slow, quick), unit="um", note=f"{PAGE}#corner")
        )
    return rows


CHECKS: Checks = {
    roughness: ("roughness",), vibration: ("vibration",), corner: ("corner",), corner_over_feed: ("corner",),
}
