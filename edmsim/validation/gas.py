"""Compare gas, film, added mass and magnetic force of the compiled loop with closed forms."""

import math
from dataclasses import replace

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from edmsim.cosim.straight import Cut, cut_straight
from edmsim.geometry import Floats
from edmsim.machine.machine import Machine
from edmsim.plant.constants import constants, gap_law, modal_model, wire_setup
from edmsim.plant.gap import breakdown, gas
from edmsim.plant.gap.rays import rays_with
from edmsim.plant.kernel.state import GRID, Arrays, allocate, sizes_of
from edmsim.plant.mechanics.film import added_mass_kg_m, drag_N_s_m2, film_sum, suction_limited
from edmsim.plant.mechanics.model import build_model, reduce_model
from edmsim.plant.plant import Plant
from edmsim.plant.resolution import Resolution, resolution
from edmsim.plant.wire import VACUUM_PERMEABILITY_N_A2
from edmsim.plant.workpiece.blanks import started_slot
from edmsim.validation.rows import Checks, Row, Seeds, differences
from edmsim.validation.setups import STILL, altered

SHARE = "x / (1 + x), each bubble replacing the one before (closed form of the model)"
REYNOLDS = "Reynolds' equation of a film with open sides, 6 pi eta (r / g)^3 in a uniform gap (closed form)"
ANNULUS = "cylinder in an annulus, rho pi r^2 (x^2 + 1) / (x^2 - 1) (Paidoussis): from half of that to all of it"
SLOTTED = "taut string whose middle is heavier by the water it moves (closed form)"
PLATES = "string under a pull ~ 1/g^2: the fold lies at a deflection of half the gap that is left (closed form)"
IMAGES = "line current in a flat-ended slot of ideally permeable metal, by images (closed form)"
CAP = "ambient pressure on the wire's diameter (closed form)"
PAGE = "docs/theory/gas.md"
FAST = resolution("fast")
SKIP = f"the film of a slice is followed where its front gap is under {FAST.film_from_um:g} um; that this is enough"


# --- gas ---

PERIOD_US, LIFE_US, COVERED = 5.0, 400.0, (0.005, 0.0125, 0.05)
"""Period of discharges, lifetime of gas, and shares of the slice covered by one discharge: x from 0.4 to 4 (ours)."""


def steady_coverage(covers: float) -> float:
    """Return the mean share of a slice covered by gas, if every discharge covers a share of it for a lifetime."""
    res = replace(FAST, slices=1)
    a = allocate(Arrays, sizes_of(1, res.rays, res.modes))
    a.metal.fill(1.0)
    c = constants(Machine.load(), res)
    spans_us = np.arange(GRID + 1)[:, None] * PERIOD_US / GRID
    law = gas.GasLaw(covers / 2 * c.slice_um, 0.0, 0.0, np.exp(-spans_us / np.array([LIFE_US, 1.0])))
    values = []
    for _ in range(round(8 * LIFE_US / PERIOD_US)):
        gas.fade(a, law, GRID)
        gas.blow(a, c, law, 0, 0.5, 1.0, GRID // 2, 0.0)
        values.append(float(a.steam[0]))
    return float(np.mean(values[len(values) // 2 :]))


def check_gas_share(seeds: Seeds) -> list[Row]:
    """Compare the coverage of one slice at a steady rate of discharges."""
    rows = []
    for covers in COVERED:
        x = covers * LIFE_US / PERIOD_US
        rows.append(Row.value("gas", f"share of the front that gas covers, x = {x:g}", SHARE, published=x / (1 + x),
                              simulated=steady_coverage(covers), within=0.02))
    return rows


# --- film ---


def _half_kerf(front_um: float, side_um: float) -> tuple[Floats, Floats]:
    """Return angles and gaps of rays on the front half of a wire that leads its kerf's axis."""
    angle = math.pi * ((np.arange(128) + 0.5) / 128 - 0.5)
    return angle, side_um - (side_um - front_um) * np.cos(angle)


def _whole_kerf(front_um: float, side_um: float) -> tuple[Floats, Floats]:
    """Return angles and gaps of `_half_kerf`, and of as many rays to the straight walls behind."""
    angle, gaps = _half_kerf(front_um, side_um)
    behind = angle + math.pi
    return np.append(angle, behind), np.append(gaps, (125.0 + side_um) / np.abs(np.sin(behind)) - 125.0)


def film_N_s_m2(angle: Floats, gaps: Floats) -> float:
    """Return the resistance of the film of the default wire in water of 20 C, by the loop's sum over rays."""
    zero, one = np.float32(0.0), np.float32(1.0)
    across = film_sum(rays_with(gaps, angle), 0, zero, zero, one, zero)
    return float(12 * 1e-3 * 125.0**3 * abs(angle[1] - angle[0]) * across)


def check_film(seeds: Seeds) -> list[Row]:
    """Compare the drag of the film in uniform gaps and in a kerf, and the limit of suction."""
    rows = [
        Row.value("film", f"resistance of the film, uniform gap of {gap:g} um", REYNOLDS,
                  published=6 * math.pi * 1e-3 * (125.0 / gap) ** 3,
                  simulated=film_N_s_m2(*_half_kerf(gap, gap)), within=0.01, unit="N s/m2")
        for gap in (5.0, 15.0)
    ]
    rows.append(Row.value("film", "resistance of the film, 10 um in front and 26 um at the sides", REYNOLDS,
                          published=drag_N_s_m2(125.0, 10.0, 26.0, 1e-3),
                          simulated=film_N_s_m2(*_whole_kerf(10.0, 26.0)), within=0.05, unit="N s/m2"))
    machine, res = Machine.load(), FAST
    a = allocate(Arrays, sizes_of(res.slices, res.rays, res.modes))
    a.metal.fill(1.0)
    c = constants(machine, res)
    most = suction_limited(a, c, 0, 1e12) * 1e-6 / (c.slice_um * 1e-6)
    rows.append(Row.value("film", "largest suction of the film", CAP, published=101_325.0 * 250e-6, simulated=most,
                          within=0.01, unit="N/m"))
    return rows


def _quiet_slot(gap_um: float, t_period_us: float, ahead_um: float = 0.0) -> tuple[Plant, float]:
    """Return a wire ahead of a slot's axis with the generator off, and its film from the gaps of its rays."""
    machine = altered(Machine.load(t_on_us=t_period_us / 4, t_period_us=t_period_us), STILL)
    x, y = machine.base.table.centre_um
    stock = started_slot(machine, (x, y), gap_um=gap_um)
    plant = Plant(machine, 1, stock=stock, position_um=(x + ahead_um, y), resolution="fast")
    plant.switch_generator(False)
    plant.advance()
    gaps = np.asarray(plant.snapshot()["edge_um"], float)
    angle = 2 * np.pi * np.arange(gaps.shape[1]) / gaps.shape[1]
    sum_ = (np.sin(angle) ** 2 / gaps**3).sum(axis=1).mean()
    return plant, float(12 * 1e-3 * 125.0**3 * 2 * math.pi / gaps.shape[1] * sum_)


def _release(plant: Plant, mode_um: float, pulses: int) -> tuple[Floats, Floats]:
    """Release a wire deflected in its first mode; return coordinate and speed of this mode before every pulse."""
    state = plant.snapshot()
    state["wire_q"][:], state["wire_v"][:] = 0.0, 0.0
    state["wire_q"][0, 0] = mode_um
    plant.restore(state)
    values = []
    for _ in range(pulses):
        state = plant.snapshot()
        values.append((state["wire_q"][0, 0], state["wire_v"][0, 0]))
        plant.advance_pulse()
    place, speed = np.array(values).T
    return place, speed


SHORT_US, LONG_US = 8.0, 100.0  # periods of a rough cut's and of the default pulses


def check_film_motion(seeds: Seeds) -> list[Row]:
    """Compare the motion of a released wire: creep in a thin film, oscillation in the film of a usual gap."""
    res = FAST
    modes = modal_model(altered(Machine.load(), STILL), res)
    omega, slice_m = float(modes.wire_omega[0]), 20e-3 / res.slices
    per_um = 1 / float(np.abs(modes.wire_shape[:, 0]).max())
    rows = []
    for period_us in (SHORT_US, LONG_US):
        plant, drag = _quiet_slot(10.0, period_us)
        pulses = round(2400.0 / period_us)
        place, _ = _release(plant, -per_um, pulses)
        from_, to = pulses // 3, 2 * pulses // 3
        rows.append(Row.value(
            "film", f"time in which a wire creeps back in a film of 10 um, periods of {period_us:g} us", REYNOLDS,
            published=float(modes.mobility[0]) * drag * slice_m / omega**2 * 1e3,
            simulated=(to - from_) * period_us * 1e-3 / math.log(place[from_] / place[to]), within=0.1, unit="ms",
            note=f"{PAGE}#the-film-of-water",
        ))
    plant, drag = _quiet_slot(31.0, LONG_US, ahead_um=15.0)
    place, speed = _release(plant, 0.05 * per_um, 40)
    energy = speed**2 + (omega * place) ** 2
    rows.append(Row.value(
        "film", "damping ratio of the first mode, 16 um in front and 31 um at the sides", REYNOLDS,
        published=float(modes.wire_zeta[0] + modes.mobility[0] * drag * slice_m / (2 * omega)),
        simulated=math.log(energy[0] / energy[30]) / (30 * LONG_US * 1e-6) / (2 * omega), within=0.25,
        note=f"{PAGE}#the-film-of-water",
    ))
    return rows


# --- added mass ---


def slot_frequency_Hz(machine: Machine) -> float:
    """Return the first frequency of a string between guides with added mass on its middle part, in the slot."""
    wire = wire_setup(machine)
    aside, half = (wire.guide_distance_m - wire.slot_m) / 2, wire.slot_m / 2
    dry_kg_m = wire.line_density
    bare, wet = (math.sqrt(mass / wire.tension) for mass in (dry_kg_m, dry_kg_m + wire.slot_mass_kg_m))

    def mismatch(omega: float) -> float:
        return bare / math.tan(omega * bare * aside) - wet * math.tan(omega * wet * half)

    most = math.pi / (wire.guide_distance_m * bare)
    return float(brentq(mismatch, 0.5 * most, most)) / math.tau


def check_added_mass(seeds: Seeds) -> list[Row]:
    """Compare the added mass of the water in the slot, and the first frequency with it."""
    machine = Machine.load()
    wire = wire_setup(machine)
    ratio = 1 + 20.0 / 125.0
    annulus = 998.0 * math.pi * 125e-6**2 * (ratio**2 + 1) / (ratio**2 - 1) / wire.line_density
    modes = reduce_model(build_model(wire, machine.base.model), 1, [machine.guide_distance_mm * 0.5e-3])
    return [
        Row.band("film", "added mass in a slot over the wire's, a gap of 20 um", ANNULUS, low=annulus / 2,
                 high=annulus, simulated=added_mass_kg_m(125.0, 20.0, 20.0) / wire.line_density),
        Row.value("film", "first frequency in the slot, 20 mm high", SLOTTED, published=slot_frequency_Hz(machine),
                  simulated=float(modes.wire_omega[0]) / math.tau, within=0.01, unit="Hz"),
    ]


# --- pull-in and magnetic force ---


def check_forces(seeds: Seeds) -> list[Row]:
    """Compare the pull-in voltage of the wire, and the force on a current in a slot of magnetic metal."""
    angle = np.linspace(-0.05, 0.05, 16)
    rays, row = rays_with(np.full(16, 30.0), angle), np.zeros((1, 4))
    law = gap_law(Machine.load(), FAST, 100.0)._replace(wire_curvature=0.0)

    def needed(place_um: float) -> float:
        """Return minus the squared voltage that holds a string at a place, up to a constant."""
        breakdown.slice_sums(rays, 0, place_um, 0.0, law, row)
        return -place_um / float(row[0, 2])

    fold_um = float(minimize_scalar(needed, bounds=(1.0, 25.0), method="bounded").x)
    machine, res = Machine.load(), FAST
    c = constants(machine, res)
    width_m = (machine.wire_diameter_um + 2 * machine.base.dielectric.side_gap_um.value) * 1e-6
    share = machine.material.magnetic_share.value
    ideal = c.magnetic_N_A2 / (c.slice_um * 1e-6) / share
    before_m = (machine.wire_diameter_um / 2 + 16.0) * 1e-6
    images = VACUUM_PERMEABILITY_N_A2 / (2 * width_m) / math.tanh(2 * math.pi * before_m / width_m)
    return [
        Row.value("film", "deflection over the gap that is left, at pull-in", PLATES, published=0.5,
                  simulated=fold_um / (30.0 - fold_um), within=0.02),
        Row.value("film", "magnetic force in a slot of ideally permeable metal, 350 A", IMAGES,
                  published=images * 350.0**2, simulated=ideal * 350.0**2, within=0.02, unit="N/m"),
    ]


# --- error of neglecting the film of single slices in wide gaps ---

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
    note = f"{PAGE}#the-film-of-water"
    return [
        Row.band("film", f"lag, {followed}", SKIP, low=-0.5, high=0.5, published="no difference", unit="um",
                 simulated=differences(usual, everywhere, lambda cut: cut.lag_um), note=note),
        Row.band("film", f"short share, {followed}", SKIP, low=-0.02, high=0.02, published="no difference",
                 simulated=differences(usual, everywhere, lambda cut: cut.share("short")), note=note),
    ]


CHECKS: Checks = {
    check_gas_share: ("gas",), check_film: ("film",), check_film_motion: ("film",), check_added_mass: ("film",),
    check_forces: ("film",), check_skip: ("film",),
}
