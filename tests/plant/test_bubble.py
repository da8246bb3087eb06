"""The push of a confined bubble: the loop's law and its limits, and the equations of the slit."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import j1

from edmsim.machine.machine import Machine
from edmsim.plant.gap.gas import (
    ESCAPE_AREA,
    ESCAPE_EDGE,
    bubble_impulse_Ns,
    bubble_law,
    vent_time_us,
)
from edmsim.plant.gap.water import AMBIENT_PA, DENSITY_KG_M3

SCRIPT = Path(__file__).parents[2] / "docs" / "make" / "bubble.py"


@pytest.fixture(scope="module")
def slit(load_script):
    return load_script(SCRIPT)


@pytest.fixture(scope="module")
def strip(slit):
    return slit.strip()


# the law


@pytest.mark.parametrize("diameter_um", [20.0, 100.0, 250.0, 360.0])
@pytest.mark.parametrize("power_W", [0.2, 10.0, 145.0, 7000.0])
@pytest.mark.parametrize("gap_um", [-1.0, 0.5, 5.0, 20.0, 40.0])
def test_vent_time_and_impulse_are_those_of_the_page(diameter_um, power_W, gap_um):
    """Gas drives out the water until it escapes, and pushes against the ambient pressure; the least gap is 5 um."""
    share, impulse_Ns, half_m, gap_m = 0.04, 4.3e-6, math.pi / 4 * diameter_um * 1e-6, max(gap_um, 5.0) * 1e-6
    law = bubble_law(diameter_um, impulse_Ns, share)
    inertia = 2 * math.pi * DENSITY_KG_M3 * gap_m * 0.6
    vent_s = (0.75 * half_m**2 * math.sqrt(inertia / (share * power_W))) ** (2 / 3)
    assert vent_time_us(power_W, gap_um, law) == pytest.approx(vent_s * 1e6, rel=1e-6)
    escape_Ns_J = share * 0.3 / 1.3 * 2.267 * half_m / (4 * gap_m * 270.0)
    excess_N = max(0.0, escape_Ns_J * power_W - 2.267 * half_m**2 * AMBIENT_PA)
    for burn_s in vent_s * np.array([1e-6, 0.5, 1.0, 3.0, 20.0]):
        until_J = power_W * min(burn_s, vent_s)
        driving_J = until_J * (1 + 0.7 * max(0.0, 1 - burn_s / vent_s))
        expected_Ns = impulse_Ns * (diameter_um / 250) ** 2 * math.sqrt(driving_J / 0.01 * 20e-6 / gap_m)
        expected_Ns += escape_Ns_J * until_J / 2 + excess_N * max(0.0, burn_s - vent_s)
        assert bubble_impulse_Ns(power_W, burn_s * 1e6, gap_um, law) == pytest.approx(expected_Ns, rel=1e-6)
    assert bubble_impulse_Ns(0.0, 20.0, gap_um, law) == bubble_impulse_Ns(power_W, 0.0, gap_um, law) == 0.0


# the slit's equations


def test_a_steady_growth_of_a_disc_pushes_as_its_momentum_integral_says(slit):
    """R R' = K gives rho pi K Ro^2 / 4, by the Bernoulli term alone, as the flow's own impulse is 0 at the edge."""
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
