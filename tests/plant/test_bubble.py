"""The push of a confined bubble: the law of the loop and its limits, the slit's equations behind it."""

import math
from pathlib import Path

import pytest
from scipy.integrate import quad
from scipy.special import j1

from edmsim.machine.machine import Machine
from edmsim.plant.gap.gas import (
    ESCAPE_AREA,
    ESCAPE_EDGE,
    LEAST_GAP_UM,
    bubble_impulse_Ns,
    bubble_law,
    vent_time_us,
)
from edmsim.plant.gap.water import DENSITY_KG_M3

SCRIPT = Path(__file__).parents[2] / "docs" / "make" / "bubble.py"
LAW = bubble_law(250.0, 4.3e-6, 0.04)
WATER = LAW._replace(escape_Ns_J=0.0)
"""Only the water driven out pushes."""
BRIEF_US = 1e-4
"""Long before the gas escapes."""


@pytest.fixture(scope="module")
def slit(load_script):
    return load_script(SCRIPT)


@pytest.fixture(scope="module")
def strip(slit):
    return slit.strip()


def exponent(impulse, low, high):
    return math.log(impulse(high) / impulse(low)) / math.log(high / low)


# the law


def test_the_gas_of_a_default_pulse_escapes_after_two_us():
    half, inertia = math.pi / 4 * 250e-6, 2 * math.pi * DENSITY_KG_M3 * 20e-6 * 0.6
    expected_s = (0.75 * half**2 * math.sqrt(inertia / (0.04 * 145.0))) ** (2 / 3)
    assert vent_time_us(145.0, 20.0, LAW) == pytest.approx(expected_s * 1e6, rel=1e-6)
    assert vent_time_us(145.0, 20.0, LAW) == pytest.approx(2.2, abs=0.05)


def test_the_vent_time_follows_gap_power_and_diameter():
    assert exponent(lambda g: vent_time_us(145.0, g, LAW), 10.0, 40.0) == pytest.approx(1 / 3)
    assert exponent(lambda p: vent_time_us(p, 20.0, LAW), 100.0, 7000.0) == pytest.approx(-1 / 3)
    assert exponent(lambda d: bubble_law(d, 3e-6, 0.04).vent_us, 100.0, 300.0) == pytest.approx(4 / 3)
    assert exponent(lambda chi: bubble_law(250.0, 3e-6, chi).vent_us, 0.01, 0.1) == pytest.approx(-1 / 3)


def test_a_short_pulse_pushes_by_the_roots_of_energy_and_gap_and_the_square_of_the_diameter():
    def of(power_W=145.0, gap_um=20.0, diameter_um=250.0):
        law = bubble_law(diameter_um, 4.3e-6, 0.04)._replace(escape_Ns_J=0.0)
        return bubble_impulse_Ns(power_W, BRIEF_US, gap_um, law)

    assert exponent(lambda p: of(power_W=p), 10.0, 1000.0) == pytest.approx(0.5, rel=1e-4)
    assert exponent(lambda g: of(gap_um=g), 8.0, 40.0) == pytest.approx(-0.5, rel=1e-4)
    assert exponent(lambda d: of(diameter_um=d), 100.0, 300.0) == pytest.approx(2.0, rel=1e-4)


def test_water_is_driven_out_only_until_the_gas_escapes():
    vent_us = vent_time_us(7000.0, 20.0, LAW)
    at_vent = bubble_impulse_Ns(7000.0, vent_us, 20.0, WATER)
    assert at_vent == pytest.approx(4.3e-6 * math.sqrt(7000.0 * vent_us * 1e-6 / 0.01))
    assert bubble_impulse_Ns(7000.0, 10 * vent_us, 20.0, WATER) == pytest.approx(at_vent)


def test_the_same_energy_at_once_drives_out_more_water():
    vent_us = vent_time_us(7000.0, 20.0, LAW)
    steady = bubble_impulse_Ns(7000.0, vent_us, 20.0, WATER)
    at_once = bubble_impulse_Ns(7000.0 * vent_us / 1e-4, 1e-4, 20.0, WATER)
    assert at_once == pytest.approx(steady * math.sqrt(1.7), rel=1e-3)


def test_the_impulse_does_not_jump_when_the_gas_escapes():
    for power_W in (20.0, 145.0, 7000.0):
        vent_us = vent_time_us(power_W, 20.0, LAW)
        before, after = (bubble_impulse_Ns(power_W, vent_us * x, 20.0, LAW) for x in (1 - 1e-9, 1 + 1e-9))
        assert after == pytest.approx(before, rel=1e-7)


def test_escaping_gas_pushes_on_only_against_the_ambient_pressure():
    def later_N(power_W):
        vent_us = vent_time_us(power_W, 20.0, LAW)
        shorter, longer = (bubble_impulse_Ns(power_W, vent_us + t, 20.0, LAW) for t in (0.0, 10.0))
        return (longer - shorter) / 10e-6

    weakest_W = LAW.ambient_N / LAW.escape_Ns_J
    assert later_N(0.9 * weakest_W) == pytest.approx(0.0, abs=1e-9)
    assert later_N(3 * weakest_W) == pytest.approx(2 * LAW.ambient_N, rel=1e-6)


def test_no_energy_gives_no_push():
    assert bubble_impulse_Ns(0.0, 20.0, 20.0, LAW) == 0.0
    assert bubble_impulse_Ns(145.0, 0.0, 20.0, LAW) == 0.0


def test_metal_nearer_than_the_least_gap_raises_nothing():
    at_least = bubble_impulse_Ns(145.0, 20.0, LEAST_GAP_UM, LAW)
    assert bubble_impulse_Ns(145.0, 20.0, 0.5, LAW) == at_least
    assert bubble_impulse_Ns(145.0, 20.0, -1.0, LAW) == at_least
    assert bubble_impulse_Ns(145.0, 20.0, LEAST_GAP_UM + 1, LAW) < at_least


# the slit's equations


def test_a_steady_growth_of_a_disc_pushes_as_its_momentum_integral_says(slit):
    """R R' = K gives rho pi K Ro^2 / 4, by the Bernoulli term alone: the flow's own impulse is 0 at the edge."""
    radius, k = 196e-6, 0.01
    pushed, _ = quad(lambda r: DENSITY_KG_M3 * math.pi * k**2 * slit.DISC.bernoulli(r / radius) * r / k, 0, radius)
    assert pushed == pytest.approx(DENSITY_KG_M3 * math.pi * k * radius**2 / 4, rel=1e-6)
    assert slit.DISC.momentum(1.0) == 0.0


@pytest.mark.parametrize(("x", "k", "rise"), [(0.1, 0.01, 0.0), (0.5, 0.02, 3e4), (0.9, 0.05, -1e5)])
def test_the_force_on_a_disc_is_its_pressure_integrated_over_gas_and_water(slit, x, k, rise):
    """`rise` is dK/dt; the water leaves as a jet at ambient pressure."""
    edge = 196e-6
    radius = x * edge

    def pressure(r):
        return DENSITY_KG_M3 * (rise * math.log(edge / r) - k**2 / 2 * (1 / r**2 - 1 / edge**2))

    water, _ = quad(lambda r: 2 * math.pi * r * pressure(r), radius, edge)
    force = math.pi * radius**2 * pressure(radius) + water
    swept = x + 1e-6, x - 1e-6  # dm/dt = dm/dx K / (W^2 x)
    momentum_rate = (slit.DISC.momentum(swept[0]) - slit.DISC.momentum(swept[1])) / 2e-6 * k / (edge**2 * x)
    started = 2 * math.pi * DENSITY_KG_M3 * edge**2 * (rise * slit.DISC.momentum(x) + k * momentum_rate)
    assert force == pytest.approx(started + DENSITY_KG_M3 * math.pi * k**2 * slit.DISC.bernoulli(x), rel=1e-5)


def test_a_small_bubble_in_a_strip_flows_as_a_source_between_two_edges(strip):
    assert strip.inertia(0.03) == pytest.approx(math.log(4 / (math.pi * 0.03)), rel=1e-4)
    assert strip.momentum(0.03) == pytest.approx((2 / math.pi) ** 2, rel=2e-3)
    assert strip.outflow(0.03) == pytest.approx(math.pi**2 / 16, rel=1e-3)  # both edges' (pi/2 / cosh(pi z/2))^3
    assert strip.slope(0.03) == pytest.approx(-1 / 0.03, rel=1e-4)


@pytest.mark.parametrize(("x", "ratio"), [(0.2, 1.53), (0.4, 1.54), (0.6, 1.59), (0.8, 1.75)])
def test_a_strip_pushes_more_than_a_disc_of_the_same_kinetic_energy(slit, strip, x, ratio):
    push = [shape.momentum(x) / math.sqrt(shape.inertia(x)) for shape in (strip, slit.DISC)]
    assert push[0] / push[1] == pytest.approx(ratio, abs=0.01)


def test_the_escape_of_the_law_is_that_of_the_strip(strip):
    assert pytest.approx(4 * j1(math.pi / 2), abs=5e-4) == ESCAPE_AREA
    assert (strip.gas_area, strip.opening) == (pytest.approx(ESCAPE_AREA, abs=5e-4), ESCAPE_EDGE)


def test_the_energy_of_the_gas_is_all_accounted_for(slit, strip):
    for shape in (slit.DISC, strip):
        for pulse in slit.PULSES.values():
            energy = slit.grow(pulse, 20.0, slit.Gas(), shape).energy
            assert energy["internal"] + energy["work"] + energy["vented"] == pytest.approx(energy["given"], rel=1e-6)
            parts = energy["kinetic"] + energy["carried"] + energy["rubbed"] + energy["displaced"]
            assert parts == pytest.approx(energy["work"], rel=1e-4)


@pytest.mark.parametrize(("power_W", "burn_us"), [(145.0, 3.0), (145.0, 20.0), (7000.0, 0.3), (7000.0, 1.4)])
@pytest.mark.parametrize(("gap_um", "diameter_um"), [(20, 250), (10, 250), (30, 250), (20, 100), (20, 300)])
def test_the_law_keeps_to_the_equations(slit, strip, power_W, burn_us, gap_um, diameter_um):
    spark = Machine.load().base.discharge
    solved = slit.grow(slit.Pulse(power_W, burn_us), gap_um, slit.Gas(), strip, diameter_um).impulse_Ns
    law = bubble_law(diameter_um, spark.impulse_10mJ_Ns.value, spark.bubble_share.value)
    assert bubble_impulse_Ns(power_W, burn_us, gap_um, law) == pytest.approx(solved, rel=0.1)


def test_a_refill_gives_back_what_it_draws(slit):
    _, drawn_Ns, met_Ns = slit.refill()
    assert drawn_Ns < 0 < met_Ns
    assert abs(drawn_Ns + met_Ns) < 0.2 * met_Ns


def test_the_page_has_the_constant_that_the_equations_give(slit, strip):
    page = (slit.DOCS / "theory" / "gas.md").read_text(encoding="utf-8")
    assert all(line in page for line in slit.facts(strip))
    machine = Machine.load().base.discharge.impulse_10mJ_Ns
    assert slit.impulse_10mJ_Ns(strip) == pytest.approx(machine.value, rel=0.03)
