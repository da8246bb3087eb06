"""Layers of the cut face: what heat changed, what the water dissolved, and what equalising pulses leave of that."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad

import edmsim
from edmsim.machine.setting import discharge_current_A
from edmsim.metrology.roughness import electrolysed_um, heat_affected_um

MATERIALS = (
    "tool-steel", "cemented-carbide", "copper", "aluminium", "stainless-steel", "titanium-alloy", "nickel-alloy",
    "graphite", "polycrystalline-diamond",
)  # fmt: skip


# T-86
@pytest.mark.slow
@pytest.mark.parametrize("material", MATERIALS)
def test_at_the_affected_depth_the_metal_just_reaches_the_temperature_at_which_it_changes(material):
    machine = edmsim.Machine.load(material=material)
    surface = machine.material.surface
    depth_mm, a, begin = heat_affected_um(machine, 20.0) * 1e-3, surface.diffusivity_mm2_s.value, 293.0
    assert 3.0 < depth_mm * 1e3 < 120.0
    # heat conduction by finite differences, on a grid of 2 % of that depth
    cells, spacing = 300, depth_mm / 50
    metal = np.full(cells, begin)
    step_s = 0.25 * spacing**2 / a
    for _ in range(round(20e-6 / step_s)):
        metal[0] = surface.melting_K.value
        metal[1:-1] += 0.25 * (metal[2:] - 2 * metal[1:-1] + metal[:-2])
    assert metal[50] == pytest.approx(surface.affected_K.value, rel=0.01)
    assert heat_affected_um(machine, 80.0) == pytest.approx(2 * heat_affected_um(machine, 20.0))


# T-86, T-12
def test_the_water_dissolves_what_faraday_says_of_half_a_passing_field():
    machine = edmsim.Machine.load()
    radius, gap, volts, speed_mm_s = 0.125, 0.025, 26.0, 0.01
    axis = radius + gap  # a cylinder of this axis before a plane: the field of two line charges
    line = math.sqrt(axis**2 - radius**2)
    strength = volts / math.acosh(axis / radius)
    charge = quad(lambda x: 2 * strength * line / (x * x + line * line) / speed_mm_s, 0, math.inf)[0] * 15e-7
    found = electrolysed_um(machine, volts / speed_mm_s, gap * 1e3)
    iron_mm3_C = 55.85 / (2 * 96485) / 7.86e-3
    assert found == pytest.approx(charge * iron_mm3_C * 1e3, rel=0.01)
    assert 0.3 < found < 1.5
    assert electrolysed_um(machine, 0.0, 25.0) == 0.0


# T-86, T-12
def test_equalising_pulses_keep_the_metal_and_change_no_spark():
    plain, equalised = (edmsim.Machine.load(generator=name) for name in ("iso-pulse", "equalising"))
    plants = [edmsim.Plant(machine, seed=3, resolution="fast") for machine in (plain, equalised)]
    for _ in range(5):
        assert plants[0].advance() == plants[1].advance()
    window = plants[0].window()
    net_V = plants[1].opposite_pulses().net_voltage_V
    assert electrolysed_um(plain, window.mean_voltage_V / 0.01, 25.0) > 0.3
    assert electrolysed_um(equalised, net_V / 0.01, 25.0) == pytest.approx(0.0, abs=1e-9)


# T-86
def test_the_layer_follows_the_charge_that_is_left():
    long = edmsim.Machine.load(generator="equalising", t_on_us=30.0, t_period_us=40.0, resistance_ohm=60.0)
    plant = edmsim.Plant(long, seed=3, resolution="fast")  # in a slot without metal near: every pulse is open
    window, left = plant.advance(), plant.opposite_pulses()
    opposite_V = -left.voltage_V * 10.0 / 40.0  # in the whole of every pause, which is not enough
    assert 0 < left.net_voltage_V == pytest.approx(window.mean_voltage_V - opposite_V)
    share = left.net_voltage_V / window.mean_voltage_V
    all_of_it = electrolysed_um(long, window.mean_voltage_V / 0.01, 25.0)
    assert electrolysed_um(long, left.net_voltage_V / 0.01, 25.0) == pytest.approx(all_of_it * share)


def test_what_is_not_known_is_not_said():
    machine = edmsim.Machine.load()
    bare = machine.model_copy(update={"material": machine.material.model_copy(update={"surface": None})})
    assert math.isnan(heat_affected_um(bare, 20.0))
    assert math.isnan(electrolysed_um(bare, 2600.0, 25.0))
    assert math.isnan(electrolysed_um(machine, 2600.0, math.nan))
    with pytest.raises(edmsim.InputError, match="it lasts 0 us or more"):
        heat_affected_um(machine, -1.0)


def test_arcs_are_among_the_discharges_whose_mean_the_report_takes():
    result = edmsim.cut(
        Path(__file__).parents[2] / "examples" / "slot.iso", resolution="fast", seed=1, max_time_s=5.0, height_mm=5.0,
        machine="production", generator="production", wire="brass-250", t_period_us=15.0,
    )
    arcs, sparks = (int(result.windows[name].to_numpy().sum()) for name in ("arc", "spark"))
    assert arcs > 0.05 * sparks
    machine, report = result.machine, result.report
    power_W = machine.material.burning_voltage_V.value * discharge_current_A(machine)
    mean_us = report.energy_J / ((arcs + sparks) * power_W) * 1e6
    assert report.surface.heat_affected_um == pytest.approx(heat_affected_um(machine, mean_us), rel=1e-6)
