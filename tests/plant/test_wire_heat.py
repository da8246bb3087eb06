"""Loads and heat of the wire: published electrostatic force, closed forms of the heat balance, breakage."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmsim.plant.constants import gap_law, heat_law
from edmsim.plant.gap.breakdown import slice_sums
from edmsim.plant.gap.rays import rays_with
from edmsim.plant.resolution import resolution
from edmsim.plant.wire import (
    VACUUM_PERMITTIVITY_F_M,
    HeatLaw,
    discharge_impulse,
    electrostatic_pull_N_m,
    heat_step,
    strength_share,
)

WATER_K = 293.0
STILL = HeatLaw(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, WATER_K)


def test_electrostatic_pull_is_the_published_table(published):
    rows = published("analytic_electrostatic_force")
    assert len(rows) == 25
    for row in rows:
        pull = electrostatic_pull_N_m(row["V"], row["gap_um"], 125.0, 80.0)
        assert pull == pytest.approx(row["force_N_per_m"], rel=6e-5, abs=6e-5)  # four decimals


@pytest.mark.parametrize("gap", [5.0, 10.0, 20.0])
@pytest.mark.parametrize("name", ["fast", "default", "fine"])
def test_rays_on_a_flat_wall_pull_as_the_closed_form(gap, name, machine):
    """Each ray pulls as coaxial cylinders its gap apart would; together they make a cylinder before a plane."""
    res = resolution(name)
    angle = 2 * math.pi * np.arange(res.rays) / res.rays
    angle = angle[np.cos(angle) > 0.1]
    gaps = (125.0 + gap) / np.cos(angle) - 125.0
    sums = np.zeros((1, 4))
    slice_sums(rays_with(gaps, angle), 0, 0.0, 0.0, gap_law(machine, res, 100.0), 1.0, sums)
    inverse_squares, sideways = sums[0, 2:]
    girth_per_ray_m = math.pi * 250e-6 / res.rays
    pressure = 0.5 * 80 * VACUUM_PERMITTIVITY_F_M * 100.0**2 * 1e12  # of a ray, times gap^2 in um^2
    pull = pressure * inverse_squares * girth_per_ray_m
    assert pull == pytest.approx(electrostatic_pull_N_m(100.0, gap, 125.0, 80.0), rel=0.015)
    assert abs(sideways) < 1e-4 * inverse_squares


def test_impulse_is_a_power_of_the_energy():
    assert discharge_impulse(0.01, 3e-7, 0.75) == pytest.approx(3e-7)
    assert discharge_impulse(0.16, 3e-7, 0.75) == pytest.approx(8 * 3e-7)


# --- heat ---


def test_water_cools_exponentially_whatever_the_step():
    law = STILL._replace(cooling_per_us=1e-4)
    for pieces in (1, 7, 100):
        temperature = np.array([600.0, 400.0, 293.0])
        for _ in range(pieces):
            heat_step(temperature, law, 12_000.0 / pieces, 0.0)
        left = np.array([307.0, 107.0, 0.0]) * math.exp(-1.2)
        np.testing.assert_allclose(temperature - WATER_K, left, rtol=1e-9)


@pytest.mark.parametrize("per_kelvin", [0.0, 0.0039])
def test_a_constant_current_settles_where_the_water_takes_it_up(per_kelvin):
    law = STILL._replace(cooling_per_us=1e-4, joule_K_per_A2_us=1e-3, resistance_per_K=per_kelvin)
    temperature = np.full(4, WATER_K)
    for _ in range(20_000):
        heat_step(temperature, law, 10.0, 4.0 * 10.0)  # 2 A
    rise = 4e-3 / (1e-4 - 4e-3 * per_kelvin)
    np.testing.assert_allclose(temperature - WATER_K, rise, rtol=2e-3)


def test_a_running_wire_enters_cold_at_the_top_and_warms_on_its_way_down():
    law = STILL._replace(run_per_us=1e-4, joule_K_per_A2_us=1e-3)
    temperature = np.full(5, 500.0)
    heat_step(temperature, law, 2_000.0, 0.0)
    assert (np.diff(temperature) < 0).all()  # the top, the last slice, is renewed first
    for _ in range(5_000):
        heat_step(temperature, law, 50.0, 4.0 * 50.0)
    np.testing.assert_allclose(temperature - WATER_K, 40.0 * np.arange(5, 0, -1), rtol=1e-6)


def test_conduction_evens_out_and_loses_nothing():
    law = STILL._replace(conduction_per_us=1e-3)
    temperature = np.array([293.0, 293.0, 693.0, 293.0])
    for _ in range(2_000):
        heat_step(temperature, law, 100.0, 0.0)
        assert temperature.sum() == pytest.approx(4 * 393.0)
    np.testing.assert_allclose(temperature, 393.0, rtol=1e-6)


@given(st.lists(st.floats(293.0, 1500.0), min_size=1, max_size=9), st.floats(1.0, 1e9))
def test_no_interval_is_too_long_for_the_heat_balance(start, dt_us):
    law = HeatLaw(1.0, 6e-5, 1e-5, 4e-5, 0.0, 0.0, WATER_K)
    temperature = np.array(start)
    heat_step(temperature, law, dt_us, 0.0)
    assert WATER_K - 1e-6 <= temperature.min() <= temperature.max() <= max(start) + 1e-6


def test_rates_of_the_default_wire_are_those_of_a_brass_cylinder(machine):
    law = heat_law(machine, resolution("default"))
    volumetric, section = 8400.0 * 377.0, math.pi / 4 * 0.25e-3**2
    assert 1 / law.kelvin_per_J == pytest.approx(volumetric * section * 20e-3 / 9)
    assert law.cooling_per_us == pytest.approx(4 * 14_000.0 / (volumetric * 0.25e-3) * 1e-6)
    assert law.run_per_us * 20_000 / 9 == pytest.approx(0.1)  # slices per us times um per slice: 0.1 m/s


def test_strength_falls_by_half_at_the_half_strength_temperature():
    assert strength_share(293.0, 600.0, 293.0) == 1.0
    assert strength_share(600.0, 600.0, 293.0) == pytest.approx(0.5)
    assert strength_share(907.0, 600.0, 293.0) == 0.0
    assert strength_share(2000.0, 600.0, 293.0) == 0.0


# --- the wire in the plant ---


def test_the_default_wire_holds(machine, plant_at_work):
    plant, windows = plant_at_work
    assert not any(w.broken for w in windows)
    assert 293.0 < max(w.wire_temperature_K for w in windows) < 450.0
    assert plant.machine == machine


def test_a_badly_cooled_wire_breaks_and_stays_broken(machine, altered, drive):
    from edmsim import Plant

    dry = altered(machine, {"base.cooling.convection_W_m2K": 1.0, "base.guides.wire_speed_m_s": 1e-3})
    plant = Plant(dry, seed=1, resolution="fast")
    windows = drive(plant, 30.0, 4.0)
    first = next(k for k, w in enumerate(windows) if w.broken)
    assert windows[first].pulses < 255
    assert windows[first].wire_temperature_K > 600.0
    assert all(w.broken for w in windows[first:])
    assert all(w.pulses == 255 for w in windows[:first])
    assert 0.0 < plant.broken_height_mm < dry.height_mm


def test_a_worn_wire_breaks_cold(machine, altered, drive):
    """Ten newton on a wire that holds 46 N: it breaks once some 80 % of it is gone."""
    from edmsim import Plant

    worn = altered(
        machine, {"base.discharge.wear_ratio": 100.0, "base.cooling.wire_heat_share": 0.0}
    )
    windows = drive(Plant(worn, seed=1, resolution="fast"), 30.0, 4.0)
    assert windows[-1].broken
    assert max(w.wire_temperature_K for w in windows) < 400.0
