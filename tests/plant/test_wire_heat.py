"""Loads and heat of the wire: published electrostatic force, closed forms of the heat balance, breakage."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import edmsim
from edmsim.machine.setting import discharge_current_A
from edmsim.plant.constants import (
    RAY_RANGE_UM,
    constants,
    convection_W_m2K,
    critical_W_m2,
    flow_m_s,
    gap_law,
    heat_law,
    modal_model,
    wake_m_s,
)
from edmsim.plant.gap.breakdown import slice_sums
from edmsim.plant.gap.rays import rays_with
from edmsim.plant.kernel.discharge import divide_current
from edmsim.plant.kernel.state import Arrays, allocate, sizes_of
from edmsim.plant.resolution import Resolution, resolution
from edmsim.plant.wire import (
    VACUUM_PERMITTIVITY_F_M,
    HeatLaw,
    add_currents,
    heat_transfer_W_m2K,
    spot_K,
    strength_share,
)
from edmsim.plant.wire import (
    heat_step as heat_step_with,
)

WATER_K, BOILING_K = 293.0, 373.15
STILL = HeatLaw(
    kelvin_per_J=0.0, cooling_m2K_J=0.0, conduction_per_us=0.0, run_per_us=0.0, joule_K_per_A2_us=0.0,
    resistance_per_K=0.0, water_K=WATER_K, boiling_K=BOILING_K, superheat_K=30.0, film_W_m2K=2e3,
    dry_share=0.5, melting_K=1173.0, spot_K_m_J=0.0, spot_m2=6.25e-8, spreading_m2_us=0.0,
)  # fmt: skip
"""A law without any flow of heat."""
VACUUM_PERMEABILITY_N_A2 = 4e-7 * math.pi


@pytest.mark.parametrize("gap", [5.0, 10.0, 20.0, 30.0])
@pytest.mark.parametrize("name", ["fast", "default", "fine"])
def test_rays_on_a_flat_wall_pull_as_the_published_table_says(gap, name, machine, published):
    """Each ray pulls as coaxial cylinders with its gap; the sum is that of a cylinder in front of a plane."""
    res, table = resolution(name), published("analytic_electrostatic_force")
    (expected_N_m,) = (row["force_N_per_m"] for row in table if (row["V"], row["gap_um"]) == (100.0, gap))
    angle = 2 * math.pi * np.arange(res.rays) / res.rays
    angle = angle[np.cos(angle) > (125.0 + gap) / (125.0 + RAY_RANGE_UM)]  # rays that meet the wall
    gaps = (125.0 + gap) / np.cos(angle) - 125.0
    sums = np.zeros((1, 4))
    slice_sums(rays_with(gaps, angle), 0, 0.0, 0.0, gap_law(machine, res, 100.0), sums)
    inverse_squares, sideways = sums[0, 2:]
    girth_per_ray_m = math.pi * 250e-6 / res.rays
    pressure = 0.5 * 80 * VACUUM_PERMITTIVITY_F_M * 100.0**2 * 1e12  # of a ray, times gap^2 in um^2
    pull = pressure * inverse_squares * girth_per_ray_m
    assert pull == pytest.approx(expected_N_m, rel=0.015)
    assert abs(sideways) < 1e-4 * inverse_squares


# --- heat ---


def wire(temperature_K, **arrays):
    """Return arrays of a wire's slices at these temperatures, with other arrays by name."""
    a = allocate(Arrays, sizes_of(len(temperature_K), 24, 4))
    a.temperature_K[:] = temperature_K
    a.metal.fill(1.0)
    for name, values in arrays.items():
        getattr(a, name)[..., : len(temperature_K)] = values
    return a


def currents(a):
    """Squared currents in the slices' wire."""
    found = np.empty(len(a.temperature_K))
    add_currents(a, found)
    return found


def heat_step(a, law, dt_us):
    heat_step_with(a, law, currents(a), dt_us)


def even_current(n, current2_us):
    """Currents of discharges that flow equally in all `n` slices."""
    return np.full((2, n), current2_us / n)


@pytest.mark.slow
def test_water_cools_exponentially_whatever_the_step():
    law = STILL._replace(cooling_m2K_J=1e-8)
    for pieces in (1, 7, 100):
        a = wire([370.0, 320.0, 293.0], convection_W_m2K=1e4)
        for _ in range(pieces):
            heat_step(a, law, 12_000.0 / pieces)
        left = np.array([77.0, 27.0, 0.0]) * math.exp(-1.2)
        np.testing.assert_allclose(a.temperature_K - WATER_K, left, rtol=1e-9)


def test_a_running_wire_enters_cold_at_the_top_and_warms_on_its_way_down():
    law = STILL._replace(run_per_us=1e-4, joule_K_per_A2_us=1e-3)
    a = wire(np.full(5, 500.0))
    heat_step(a, law, 2_000.0)
    assert (np.diff(a.temperature_K) < 0).all()  # new wire reaches the top, the last slice, first
    a.current2_us[:] = even_current(5, 1.0 * 50.0)
    for _ in range(5_000):
        heat_step(a, law, 50.0)
    np.testing.assert_allclose(a.temperature_K - WATER_K, 10.0 * np.arange(5, 0, -1), rtol=1e-6)


@pytest.mark.parametrize(
    ("slice_um", "slices"), [(50.0, 401), (200.0, 101), (400.0, 51), (1_000.0, 41), (2_000.0, 41)]
)
def test_a_hot_spot_spreads_along_the_wire_as_a_gaussian(machine, slice_um, slices):
    """``T = q / sqrt(4 pi a t) exp(-x^2 / (4 a t))``; thin slices take several steps in a span of 1.5 ms."""
    law = heat_law(machine.with_(height_mm=slices * slice_um * 1e-3), Resolution(slices, 24, 4))
    law = law._replace(cooling_m2K_J=0.0, run_per_us=0.0, melting_K=1e9)
    middle = slices // 2
    rise = np.zeros(slices)
    rise[middle] = 100.0
    a = wire(WATER_K + rise)
    spans, dt_us = round(8.0 / (law.conduction_per_us * 1_500.0)) if slice_um > 400 else 40, 1_500.0
    for _ in range(spans):
        heat_step(a, law, dt_us)
    rise, away = a.temperature_K - WATER_K, np.arange(slices) - middle
    wire_ = machine.wire
    diffusivity = wire_.conductivity_W_mK.value / (wire_.density_kg_m3.value * wire_.heat_capacity_J_kgK.value)
    width2 = 2 * diffusivity * spans * dt_us * 1e-6 / (slice_um * 1e-6) ** 2  # in squares of a slice's height
    gaussian = 100.0 / math.sqrt(2 * math.pi * width2) * np.exp(-(away**2) / (2 * width2))
    assert rise.sum() == pytest.approx(100.0)
    assert (rise * away**2).sum() / rise.sum() == pytest.approx(width2, rel=1e-3)
    np.testing.assert_allclose(rise, gaussian, atol=0.02 * gaussian.max())


@pytest.mark.slow
@given(st.lists(st.floats(293.0, 1500.0), min_size=1, max_size=9), st.floats(1.0, 1e9))
def test_no_interval_is_too_long_for_the_heat_balance(start, dt_us):
    law = STILL._replace(cooling_m2K_J=6e-9, conduction_per_us=1e-5, run_per_us=4e-5)
    a = wire(start, convection_W_m2K=1e4)
    heat_step(a, law, dt_us)
    assert WATER_K - 1e-6 <= a.temperature_K.min() <= a.temperature_K.max() <= max(start) + 1e-6


def test_the_wire_gets_no_hotter_than_it_melts():
    law = STILL._replace(joule_K_per_A2_us=1.0, resistance_per_K=0.0039)
    a = wire(np.full(3, 900.0), current2_us=even_current(3, 1e4))
    for _ in range(5):
        heat_step(a, law, 1_000.0)
    np.testing.assert_array_equal(a.temperature_K, 1173.0)


# --- the current in every slice ---


def of_piece(covered):
    """Mean of i^2 over the workpiece, relative to the current's; ``covered`` is its share between the contacts."""
    return 0.25 - covered / 6 + covered**2 / 12


@pytest.mark.parametrize("covered", [0.5, 0.8, 1.0])
def test_discharges_spread_evenly_heat_the_wire_by_a_quarter_less_the_piece_s_square(covered):
    """With a workpiece h between contacts L apart, the mean of i^2 over L is 1/4 - h^2 / (12 L^2) of the current's.

    In the workpiece it is less, because discharges above and below a point send smaller shares through it.
    """
    n = 200
    z = 0.5 + covered * ((np.arange(n) + 0.5) / n - 0.5)
    a = wire(np.full(n, WATER_K), height_share=z)
    for s in range(n):
        divide_current(a, s, 1.0 / n)
    squares = currents(a)
    below, above = a.current2_us.sum(axis=1)
    whole = covered * squares.mean() + (1 - covered) / 2 * (below + above)
    assert whole == pytest.approx(0.25 - covered**2 / 12, rel=1e-3)
    assert squares.mean() == pytest.approx(of_piece(covered), rel=1e-3)
    end = (1 - covered) / 2
    profile = ((1 - z) ** 3 + z**3 - 2 * end**3) / (3 * covered)
    np.testing.assert_allclose(squares, profile, atol=5e-4)  # 1/3 at the ends, 1/12 midway for covered = 1


def test_one_discharge_divides_as_the_resistances_to_the_contacts():
    a = wire(np.full(5, WATER_K), height_share=[0.3, 0.4, 0.5, 0.6, 0.7])
    divide_current(a, 3, 100.0)
    below, above = 0.4**2 * 100.0, 0.6**2 * 100.0
    assert currents(a) == pytest.approx([below] * 3 + [(below + above) / 2, above])


# --- boiling ---


def flux_W_m2(temperature_K, dry=0.0, convection=1e4, critical=4e6, law=STILL):
    return heat_transfer_W_m2K(temperature_K, law, convection, critical, dry) * (temperature_K - WATER_K)


def test_the_flux_rises_by_convection_then_by_boiling_to_the_critical_one_and_falls():
    assert flux_W_m2(350.0) == pytest.approx(1e4 * 57.0)
    assert flux_W_m2(BOILING_K) == pytest.approx(1e4 * (BOILING_K - WATER_K))
    hottest = BOILING_K + 30.0
    assert flux_W_m2(hottest - 1e-6) == pytest.approx(4e6, rel=1e-5)
    assert flux_W_m2(hottest + 1e-6) == pytest.approx(2e3 * (hottest - WATER_K))  # a film of steam
    temperatures = np.linspace(WATER_K + 1.0, hottest - 1e-6, 300)
    fluxes = np.array([flux_W_m2(t) for t in temperatures])
    assert (np.diff(fluxes) > 0).all()
    assert np.diff(fluxes).max() < 0.05 * 4e6  # no jump while it rises


def test_gas_takes_its_share_from_convection_and_from_the_critical_flux():
    assert flux_W_m2(350.0, dry=0.6) == pytest.approx(0.7 * flux_W_m2(350.0))
    assert flux_W_m2(BOILING_K + 30.0 - 1e-6, dry=0.6) == pytest.approx(0.7 * 4e6, rel=1e-5)
    driest = STILL._replace(dry_share=1.0)  # gas in front of and behind the wire removes all cooling, but not more
    assert flux_W_m2(350.0, dry=1.8, law=driest) == 0.0


def test_strong_convection_is_not_lessened_by_boiling_and_a_film_is_not_better_than_convection():
    assert flux_W_m2(BOILING_K + 20.0, convection=1e5) == pytest.approx(1e5 * (BOILING_K + 20.0 - WATER_K))
    assert flux_W_m2(BOILING_K + 50.0, convection=500.0) == pytest.approx(500.0 * (BOILING_K + 50.0 - WATER_K))


def test_convection_follows_the_water_past_every_slice(machine):
    """The front half is cooled by water of the gap, the back half by that of the kerf behind the wire."""
    res = resolution("fast")
    for setting in ({}, {"flushing_upper_Pa": 0.0}):
        set_up = machine.with_(**setting)
        front, back = flow_m_s(set_up, res), wake_m_s(set_up, res)
        expected = 14_000.0 * (1 + 0.5 * (front + back) / 2)
        np.testing.assert_allclose(convection_W_m2K(set_up, res), expected)
    assert convection_W_m2K(machine, res)[-1] > convection_W_m2K(machine.with_(flushing_upper_Pa=0.0), res)[-1]


def test_the_critical_flux_of_a_stream_is_gunther_s(machine):
    """7.19e4 W/m2 times the root of m/s and the subcooling, if this is more than in stagnant water."""
    res = resolution("fast")
    strong = machine.with_(flushing_lower_Pa=2e5, flushing_upper_Pa=2e5)
    speed = wake_m_s(strong, res)
    np.testing.assert_allclose(critical_W_m2(strong, res), 7.19e4 * np.sqrt(speed) * (BOILING_K - WATER_K))
    assert critical_W_m2(strong, res).min() > 4e6
    np.testing.assert_array_equal(
        critical_W_m2(machine.with_(flushing_lower_Pa=0.0, flushing_upper_Pa=0.0), res), 4e6
    )
    one = critical_W_m2(machine.with_(flushing_lower_Pa=0.0, flushing_upper_Pa=3e4), res)
    assert (np.diff(one) > 0).all()  # it falls with the distance from the nozzle


@pytest.mark.slow
def test_every_slice_has_its_own_critical_flux_and_gas_before_and_behind_takes_from_it():
    law = STILL._replace(cooling_m2K_J=1e-9)
    hot = BOILING_K + 30.0 - 1e-6
    a = wire(np.full(3, hot), convection_W_m2K=1e4, critical_W_m2=[2e6, 4e6, 4e6])
    a.covered[2], a.wake_gas[2] = 0.4, 0.2
    heat_step(a, law, 10.0)
    lost = -np.log((a.temperature_K - WATER_K) / (hot - WATER_K)) / (1e-9 * 10.0) * (hot - WATER_K)
    np.testing.assert_allclose(lost, [2e6, 4e6, 0.7 * 4e6], rtol=1e-5)


# --- the heat of one place ---


def test_heat_of_one_place_spreads_along_the_wire_by_conduction(machine):
    """``Q / (rho c A sqrt(pi a t + d^2))``: a line source in a rod, initially as long as the diameter."""
    law = heat_law(machine, resolution("fast"))
    volumetric, section, diffusivity = 8400.0 * 377.0, math.pi / 4 * 0.25e-3**2, 120.0 / (8400.0 * 377.0)
    assert machine.wire.conductivity_W_mK.value == 120.0
    for heat_J, time_us in ((1e-3, 0.0), (1e-3, 500.0), (0.2, 2e4)):
        length_m = math.sqrt(math.pi * diffusivity * time_us * 1e-6 + 0.25e-3**2)
        assert spot_K(law, heat_J, time_us) == pytest.approx(heat_J / (volumetric * section * length_m))
    long_us, heat_J = 1e6, 0.01  # limit for long times: constant heating of a rod at one point
    rod_K = heat_J / (volumetric * section) / math.sqrt(math.pi * diffusivity * long_us * 1e-6)
    assert spot_K(law, heat_J, long_us) == pytest.approx(rod_K, rel=1e-3)


def burnt(in_a_hole, machine, deionisation_us):
    """A plant after pulses in a gap of 6 um until the wire broke, or for a second."""
    plant = in_a_hole(machine, 6.0, **{
        "base.cooling.wire_heat_share": 0.3, "base.gap.deionisation_us": deionisation_us,
        "base.discharge.spot_gain": 0.0,
    })  # fmt: skip
    while plant.time_ns < 1e9 and not (window := plant.advance()).broken:
        pass
    return plant, window


def test_a_chain_of_arcs_breaks_a_wire_that_sparks_at_other_places_do_not(in_a_hole, machine):
    """It breaks at the arc with which slice and spot exceed the temperature at which strength equals tension."""
    plant, window = burnt(in_a_hole, machine, 1e7)
    assert window.broken
    assert (window.spark, window.short, window.open) == (1, 0, 0)
    state, law = plant.snapshot()["state"][0], heat_law(machine, resolution("fast"))
    slice_K = plant.snapshot()["temperature_K"][int(state["broken_slice"])]
    breaks_K = WATER_K + (1 - machine.tension / machine.breaking_force) * 2 * (600.0 - WATER_K)
    arc_J = 0.3 * 22.0 * discharge_current_A(machine) * 30e-6
    spots = [spot_K(law, state["chain_J"] - less, state["chain_us"]) for less in (0.0, arc_J)]
    assert slice_K + spots[0] > breaks_K > slice_K + spots[1]
    assert slice_K < 450.0
    assert state["chain_J"] == pytest.approx(arc_J * (window.arc + 1), rel=0.02)  # the spark ignites after some us
    assert state["chain_us"] == pytest.approx(100.0 * window.arc, rel=0.02)
    plant, window = burnt(in_a_hole, machine, 1e-3)
    assert not window.broken
    assert window.spark > 250
    assert plant.snapshot()["state"]["chain_J"] <= arc_J


def test_rates_of_the_default_wire_are_those_of_a_brass_cylinder(machine):
    law = heat_law(machine, resolution("default"))
    volumetric, section = 8400.0 * 377.0, math.pi / 4 * 0.25e-3**2
    assert 1 / law.kelvin_per_J == pytest.approx(volumetric * section * 20e-3 / 9)
    assert law.cooling_m2K_J == pytest.approx(4 / (volumetric * 0.25e-3) * 1e-6)
    assert law.run_per_us * 20_000 / 9 == pytest.approx(0.1)  # slices per us times um per slice: 0.1 m/s
    assert law.joule_K_per_A2_us == pytest.approx(6.4e-8 / section**2 / volumetric * 1e-6)


def test_strength_falls_by_half_at_the_half_strength_temperature():
    assert strength_share(293.0, 600.0, 293.0) == 1.0
    assert strength_share(600.0, 600.0, 293.0) == pytest.approx(0.5)
    assert strength_share(907.0, 600.0, 293.0) == 0.0
    assert strength_share(2000.0, 600.0, 293.0) == 0.0


# --- the magnetic force ---


@pytest.mark.parametrize(("material", "sign"), [("tool-steel", 1), ("cemented-carbide", 1), ("copper", -1)])
def test_a_current_is_drawn_to_steel_and_pushed_off_copper_by_the_slot_s_formula(material, sign):
    """mu0 i^2 / (2 w) per metre in an ideally permeable slot, times the material's share."""
    machine = edmsim.Machine.load(material=material)
    share = machine.material.magnetic_share.value
    kerf_m, slice_m = 328e-6, 20e-3 / 5
    per_A2 = constants(machine, resolution("fast")).magnetic_N_A2 / slice_m
    assert per_A2 == pytest.approx(share * VACUUM_PERMEABILITY_N_A2 / (2 * kerf_m), rel=1e-6)
    assert math.copysign(1, per_A2) == sign


def test_the_magnetic_load_is_that_of_the_mean_square_current_in_the_piece(machine, drive):
    plant = edmsim.Plant(machine, 1, resolution="fast")
    drive(plant, 18.0, 4.0)
    shape = modal_model(machine, plant.resolution).wire_shape[:, 0]
    loads, square_us, time_us = [], 0.0, 0.0
    for _ in range(200):
        for window in drive(plant, 18.0, 0.02):
            square_us += plant.timing.current_A * window.energy_J / 22.0 * 1e6
            square_us += plant.timing.short_A**2 * 30.0 * window.short
            time_us += window.duration_ns * 1e-3
        loads.append(plant.snapshot()["steady"][0, 0] / shape.sum())
    force_N = constants(machine, plant.resolution).magnetic_N_A2 * square_us / time_us * of_piece(0.5)
    assert np.mean(loads) == pytest.approx(force_N * 1e6, rel=0.15)


# --- the wire in the plant ---


DRY = {
    "base.cooling.convection_W_m2K": 1.0, "base.cooling.critical_W_m2": 1.0, "base.cooling.critical_stream": 0.0,
    "base.guides.wire_speed_m_s": 1e-3,
}  # fmt: skip
"""The water takes almost no heat, boiling or not, and the wire hardly moves on."""


def test_no_temperature_runs_away_where_the_wire_cannot_break(machine, altered, drive):
    endless = altered(machine, {**DRY, "wire.half_strength_K": 1e6, "base.discharge.wear_ratio": 0.0})
    windows = drive(edmsim.Plant(endless, seed=1, resolution="fast"), 30.0, 6.0)
    assert not any(w.broken for w in windows)
    assert 700.0 < max(w.wire_temperature_K for w in windows) <= machine.wire.melting_K.value


def test_a_short_that_melts_metal_heats_the_wire_there(machine, altered, drive):
    """There is no other heat: the wire has no resistance here, and no pulse ignites inside metal."""
    rises = []
    for share in (0.0, 0.03):
        cold = altered(machine, {
            **DRY, "wire.resistivity_Ohm_m": 1e-20, "base.cooling.wire_heat_share": share,
            "base.guides.wire_speed_m_s": 1e-4, "base.discharge.wear_ratio": 0.0,
        })  # fmt: skip
        plant = edmsim.Plant(cold, seed=1, resolution="fast")
        drive(plant, 300.0, 0.5)
        before, pressed = plant.snapshot()["temperature_K"].mean(), drive(plant, 300.0, 0.1)
        shorts = sum(w.short for w in pressed)
        assert shorts > 0.98 * sum(w.pulses for w in pressed)
        rises.append((plant.snapshot()["temperature_K"].mean() - before) / shorts)
    joule = 0.03 * 0.1 * 22.0 * 100.0 / 11.8 * 30e-6
    heated = 8400.0 * 377.0 * math.pi / 4 * 0.25e-3**2 * 20e-3
    assert rises == pytest.approx([0.0, joule / heated], rel=0.05, abs=1e-6)


def test_a_badly_cooled_wire_breaks(machine, altered, drive):
    plant = edmsim.Plant(altered(machine, DRY), seed=1, resolution="fast")
    windows = drive(plant, 30.0, 4.0)
    assert windows[-1].broken
    assert windows[-1].pulses < 255
    assert windows[-1].wire_temperature_K > 600.0
    assert all(w.pulses == 255 for w in windows[:-1])
    assert 0.0 < plant.broken_height_mm < machine.height_mm
    plant.rethread(plant.place_um, 0)
    assert math.isnan(plant.broken_height_mm)


def test_a_worn_wire_breaks_cold(machine, altered, drive):
    """10 N on a wire that holds 46 N: it breaks when about 80 % of it is worn away."""
    worn = altered(machine, {"base.discharge.wear_ratio": 100.0, "base.cooling.wire_heat_share": 0.0})
    windows = drive(edmsim.Plant(worn, seed=1, resolution="fast"), 30.0, 4.0)
    assert windows[-1].broken
    assert max(w.wire_temperature_K for w in windows) < 400.0
