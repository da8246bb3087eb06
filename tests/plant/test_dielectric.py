"""Debris and flushing: removal by the water, and debris that bridges the gap."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

import edmsim
from edmsim.plant.constants import constants, faces_Pa, flow_m_s, flushing, wake_m_s
from edmsim.plant.gap.water import (
    Jets,
    bridged_probability,
    flow_speed_m_s,
    flush,
    jets,
    kerf_jets,
    permittivity_ratio,
    surface_tension_N_m,
    viscosity_ratio,
)
from edmsim.plant.resolution import resolution

from .conftest import fill

SHARES = st.lists(st.floats(0.0, 1.0), min_size=1, max_size=15)
SPARC = {"base": 0.3, "per_um": 0.02, "ceiling": 0.95, "steepness": 500.0}


def flush_alike(debris, changes):
    """Flush by two jets of one pressure, which meet at mid-height."""
    flush(debris, changes, changes, shares(0.5, len(debris)))


def shares(lower_share, slices):
    """Flow shares of two jets that meet at this share of the height."""
    return Jets(lower_share, 1.0, 1.0).flow_share(slices)


@given(SHARES, st.floats(0.0, 1e12), st.floats(0.0, 1e12), st.floats(0.0, 1.0))
def test_flushing_adds_nothing_and_leaves_no_negative_share(start, lower, upper, share):
    debris = np.array(start)
    flush(debris, lower, upper, shares(share, len(debris)))
    assert debris.min() >= 0.0
    assert debris.sum() <= sum(start) * (1 + 1e-12)


@pytest.mark.parametrize("n_slices", [5, 9, 15])
def test_debris_gathers_at_mid_height(n_slices):
    debris = np.zeros(n_slices)
    for _ in range(5_000):
        flush_alike(debris, 0.05)
        debris += 1e-4  # the same in every slice
    np.testing.assert_allclose(debris, debris[::-1], rtol=1e-9)
    assert (np.diff(debris[: n_slices // 2 + 1]) > 0).all()


@pytest.mark.parametrize(("slices", "lower_share"), [(9, 0.5), (3, 0.4), (5, 0.5), (5, 0.0), (4, 1.0), (15, 0.77)])
def test_short_steps_of_flushing_follow_the_flow(slices, lower_share):
    """Water comes from the slice upstream; where the jets meet, from both sides, in their shares."""
    start, flows = np.random.default_rng(2).uniform(0.0, 0.3, slices), np.array([0.7, 1.9])
    entering = shares(lower_share, slices) * flows[:, None]
    rates = np.diag(-entering.sum(axis=0)) + np.diag(entering[0, 1:], -1) + np.diag(entering[1, :-1], 1)
    debris = start.copy()
    flush(debris, 0.0, 0.0, shares(lower_share, slices))
    np.testing.assert_array_equal(debris, start)
    for _ in range(2_000):
        flush(debris, *(flows / 2_000), shares(lower_share, slices))
    np.testing.assert_allclose(debris, expm(rates) @ start, rtol=3e-3)


def test_slot_flow():
    """Water in a slot: speed = dp g^2 / (12 eta z) over the length z."""
    at = flow_speed_m_s(30_000.0, 1e-3, 45.0, 10.0)
    assert at == pytest.approx(30_000.0 * 45e-6**2 / (12 * 1e-3 * 0.01))
    assert flow_speed_m_s(60_000.0, 1e-3, 45.0, 10.0) == pytest.approx(2 * at)
    assert flow_speed_m_s(30_000.0, 1e-3, 45.0, 20.0) == pytest.approx(at / 2)


@given(st.floats(1.0, 3e6), st.floats(1.0, 3e6))
def test_the_stronger_jet_reaches_further_and_both_come_to_rest_where_they_meet(lower, upper):
    both = jets(lower, upper, 1e-3, 45.0, 20.0)
    assert both.lower_share / (1 - both.lower_share) == pytest.approx(np.sqrt(lower / upper))
    faces_and_meeting = both.past_m_s(np.array([0.0, both.lower_share, 1.0]))
    np.testing.assert_allclose(faces_and_meeting, [both.lower_m_s, 0.0, both.upper_m_s], rtol=1e-9)
    assert both.lower_m_s == pytest.approx(flow_speed_m_s(lower, 1e-3, 45.0, 20.0 * both.lower_share))
    slopes = both.lower_m_s / both.lower_share, both.upper_m_s / (1 - both.lower_share)
    assert slopes[0] == pytest.approx(slopes[1])  # the same amount leaves at every height


@pytest.mark.parametrize(("lower", "upper", "share"), [(30_000.0, 0.0, 1.0), (0.0, 30_000.0, 0.0)])
def test_a_nozzle_that_is_off_leaves_the_whole_height_to_the_other_jet(lower, upper, share):
    """The flow's path is twice as long, so it is half as fast, and debris stays four times as long."""
    one = jets(lower, upper, 1e-3, 45.0, 20.0)
    both = jets(30_000.0, 30_000.0, 1e-3, 45.0, 20.0)
    assert one.lower_share == share
    assert (one.lower_m_s, one.upper_m_s) == (both.lower_m_s / 2 * share, both.upper_m_s / 2 * (1 - share))
    debris = np.zeros(9)
    for _ in range(5_000):
        flush(debris, 0.05 * share, 0.05 * (1 - share), one.flow_share(9))
        debris += 1e-4
    assert (np.diff(debris if share else debris[::-1]) > 0).all()  # debris gathers at the far end


@pytest.mark.parametrize("pressures", [(3e6, 1e-30), (1e-30, 3e6)])
def test_a_jet_next_to_nothing_is_as_one_that_is_off(pressures):
    off = jets(*(pressure if pressure > 1.0 else 0.0 for pressure in pressures), 1e-3, 45.0, 20.0)
    np.testing.assert_allclose(jets(*pressures, 1e-3, 45.0, 20.0), off, atol=1e-15)


@pytest.mark.parametrize(("lower", "upper", "share"), [(2e5, 0.0, 1.0), (0.0, 2e5, 0.0)])
def test_one_jet_drives_the_whole_kerf(lower, upper, share):
    one = kerf_jets(lower, upper, 312.0, 40.0)
    speed = math.sqrt(2 * 2e5 / 998.0 / (1.5 + 0.04 * 40.0 / (2 * 0.312)))
    assert one == (share, pytest.approx(speed * share), pytest.approx(speed * (1 - share)))
    np.testing.assert_allclose(one.past_m_s(np.array([0.0, 0.5, 1.0])), speed * np.abs([share, 0.5, 1 - share]))
    assert kerf_jets(0.0, 0.0, 312.0, 40.0) == (0.5, 0.0, 0.0)


@given(st.floats(1.0, 3e6), st.floats(1.0, 3e6), st.floats(0.1, 80.0))
def test_the_kerf_s_jets_meet_where_the_gap_s_do_and_each_falls_to_rest_there(lower, upper, height):
    """By their losses of pressure: ``dp = (1.5 + 0.04 z / (2 w)) rho v^2 / 2``."""
    wake, gap = kerf_jets(lower, upper, 312.0, height), jets(lower, upper, 1e-3, 45.0, height)
    assert wake.lower_share == gap.lower_share
    ways = wake.lower_share, 1 - wake.lower_share
    for pressure, way, speed in zip((lower, upper), ways, wake[1:], strict=True):
        loss = 1.5 + 0.04 * way * height / (2 * 0.312)
        assert loss * 998.0 * speed**2 / 2 == pytest.approx(pressure)
    faces_and_meeting = wake.past_m_s(np.array([0.0, wake.lower_share, 1.0]))
    np.testing.assert_allclose(faces_and_meeting, [wake.lower_m_s, 0.0, wake.upper_m_s], rtol=1e-9, atol=1e-9)


def test_eddies_stir_the_kerf_where_the_jets_meet(machine):
    """The speed has the jets' part along the kerf, and everywhere a share of the faster jet's, at right angles."""
    res, set_up = resolution("fast"), machine.with_(flushing_lower_Pa=2e5, flushing_upper_Pa=2e5)
    nozzle = kerf_jets(2e5, 2e5, 328.0, 20.0).lower_m_s
    down = nozzle * np.array([0.8, 0.4, 0.0, 0.4, 0.8])
    np.testing.assert_allclose(wake_m_s(set_up, res), np.sqrt(down**2 + (0.3 * nozzle) ** 2))


def test_stirred_water_rubs_more(machine, altered):
    films = [
        constants(altered(machine, {"base.dielectric.film_stirring": by}), resolution("fast")).film_um3_kg_s
        for by in (1.0, 2.0)
    ]
    assert films[1] == pytest.approx(2 * films[0])
    assert constants(machine, resolution("fast")).film_um3_kg_s == films[1]


def test_without_flushing_the_water_stands_and_the_debris_stays():
    still = jets(0.0, 0.0, 1e-3, 45.0, 20.0)
    np.testing.assert_array_equal(still.past_m_s(np.linspace(0, 1, 5)), 0.0)
    debris = np.full(5, 0.2)
    flush(debris, still.lower_m_s, still.upper_m_s, still.flow_share(5))
    np.testing.assert_array_equal(debris, 0.2)


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(0.0, 80.0))
def test_more_debris_bridges_more_and_a_wider_gap_less(first, second, gap):
    low, high = sorted((first, second))
    assert 0.0 <= bridged_probability(low, gap, **SPARC) <= bridged_probability(high, gap, **SPARC) <= 1.0
    assert bridged_probability(low, gap + 5.0, **SPARC) <= bridged_probability(low, gap, **SPARC)


@pytest.mark.parametrize(("gap", "critical"), [(0.0, 0.3), (10.0, 0.5), (30.0, 0.9), (60.0, 0.95)])
def test_half_of_the_pulses_find_a_bridge_at_the_critical_share(gap, critical):
    assert bridged_probability(critical, gap, **SPARC) == pytest.approx(0.5, abs=1e-9)
    assert bridged_probability(critical + 0.01, gap, **SPARC) == pytest.approx(1 / (1 + np.exp(-5.0)), rel=1e-6)
    assert bridged_probability(critical - 0.1, gap, **SPARC) == 0.0
    assert bridged_probability(critical + 0.1, gap, **SPARC) == 1.0


# --- nozzles off the workpiece ---


@pytest.fixture(scope="module")
def production():
    """Return the machine with 2 bar."""
    return edmsim.Machine.load("production", generator="production")


@pytest.mark.parametrize("standoff_mm", [0.0, 0.2, 0.5, 2.0, 100.0])
@pytest.mark.parametrize(("bore_mm", "flow_l_min"), [(6.0, 6.0), (4.0, 15.0), (10.0, 3.0)])
def test_a_nozzle_off_the_workpiece_keeps_what_its_flow_takes(altered, production, standoff_mm, bore_mm, flow_l_min):
    """Bernoulli's pressure of the flow round the rim and of the free jet's stagnation, at most the set pressure."""
    set_Pa, flow_m3_s, bore_m = 200_000.0, flow_l_min / 60_000, bore_mm / 1000
    jet_m_s = 4 * flow_m3_s / (math.pi * bore_m**2)
    escapes_m_s = flow_m3_s / (math.pi * bore_m * standoff_mm / 1000) if standoff_mm else math.inf
    expected = min(set_Pa, 998 / 2 * (escapes_m_s**2 + jet_m_s**2))
    nozzles = {"base.dielectric.nozzle_mm": bore_mm, "base.dielectric.nozzle_flow_l_min": flow_l_min}
    rig = altered(production, nozzles)
    assert faces_Pa(rig.with_(standoff_upper_mm=standoff_mm)) == (set_Pa, pytest.approx(expected))
    assert faces_Pa(rig.with_(standoff_lower_mm=standoff_mm)) == (pytest.approx(expected), set_Pa)


@pytest.mark.parametrize("standoff_mm", [0.0, 1e-320, 1e-200, 1e-9, 0.5, 100.0])
def test_a_nozzle_that_is_off_stays_off_at_any_distance_and_one_that_lies_on_keeps_all(production, standoff_mm):
    """Also at distances at which the area round the rim underflows, or the speed overflows."""
    off = production.with_(flushing_lower_Pa=0.0, standoff_lower_mm=standoff_mm, standoff_upper_mm=standoff_mm)
    lower, upper = faces_Pa(off)
    assert lower == 0.0
    assert (upper == 2e5) == (standoff_mm < 0.5)


def test_a_stand_off_weakens_the_flow_in_the_gap(production):
    """It acts as a lower pressure of the nozzle: the upper end gets less water, and the jets meet higher up."""
    res = resolution("fast")
    away = production.with_(standoff_upper_mm=2.0)
    flow, usual = flow_m_s(away, res), flow_m_s(production, res)
    assert flow[-1] < 0.2 * usual[-1]
    assert flow.mean() < 0.6 * usual.mean()
    np.testing.assert_array_equal(flow, flow_m_s(production.with_(flushing_upper_Pa=faces_Pa(away)[1]), res))
    assert flushing(away).lower_share > flushing(production).lower_share == 0.5
    np.testing.assert_array_equal(flow_m_s(production.with_(standoff_upper_mm=0.2), res), usual)
    both = production.with_(standoff_lower_mm=2.0, standoff_upper_mm=2.0)
    np.testing.assert_allclose(flow_m_s(both, res), 9.753e3 / 2e5 * usual, rtol=1e-3)


# --- water by temperature ---


@pytest.mark.parametrize(("celsius", "permittivity", "viscosity_mPa_s", "tension_mN_m"), [
    (20.0, 80.1, 1.0016, 72.75), (50.0, 69.9, 0.5465, 67.94),
    (80.0, 60.9, 0.3544, 62.67), (100.0, 55.6, 0.2816, 58.91),
])  # fmt: skip
def test_water_has_the_handbook_s_properties(celsius, permittivity, viscosity_mPa_s, tension_mN_m):
    kelvin = celsius + 273.15
    assert permittivity_ratio(kelvin) == pytest.approx(permittivity / 80.1, rel=5e-3)
    assert viscosity_ratio(kelvin) == pytest.approx(viscosity_mPa_s / 1.0016, rel=0.03)
    assert surface_tension_N_m(kelvin) == pytest.approx(tension_mN_m * 1e-3, rel=2e-3)


def test_the_gap_has_the_water_of_its_temperature(machine, altered):
    res = resolution("fast")
    cold, warm = (altered(machine, {"base.dielectric.gap_temperature_K": t}) for t in (293.15, 323.15))
    assert constants(cold, res).permittivity_F_m == pytest.approx(80.0 * 8.8541878e-12)
    of_warm, of_cold = constants(warm, res), constants(cold, res)
    eps = of_warm.permittivity_F_m / of_cold.permittivity_F_m
    eta = of_warm.film_um3_kg_s / of_cold.film_um3_kg_s
    assert (eps, eta) == (pytest.approx(0.873, abs=0.003), pytest.approx(0.546, abs=0.01))
    np.testing.assert_allclose(flow_m_s(warm, res) * eta, flow_m_s(cold, res))


# --- in the plant ---


def test_a_loaded_slot_flows_more_slowly(in_a_hole, machine):
    """By Einstein's viscosity, 1 + 2.5 times the share: an interval carries off less by this factor."""
    changes = []
    for debris in (1e-6, 0.2):
        plant = in_a_hole(machine, 200.0)
        fill(plant, debris=debris)
        while (left := plant.snapshot()["debris"][0]) == debris:
            plant.advance_pulse()
        changes.append(debris / left - 1)
    assert changes[0] / changes[1] == pytest.approx(1 + 2.5 * 0.2, rel=1e-3)


def test_the_operator_s_nozzles_decide_on_flow_and_debris(machine, altered, drive):
    res = resolution("fast")
    np.testing.assert_array_equal(
        flow_m_s(machine.with_(flushing_lower_Pa=3e4, flushing_upper_Pa=3e4), res), flow_m_s(machine, res)
    )
    unpumped, means, at_ends = altered(machine, {"base.gas.pumping": 0.0}), {}, {}
    for lower, upper in ((3e4, 3e4), (0.0, 3e4), (3e4, 0.0)):
        plant = edmsim.Plant(unpumped.with_(flushing_lower_Pa=lower, flushing_upper_Pa=upper), 1, resolution="fast")
        means[lower, upper] = np.mean([w.debris for w in drive(plant, 20.0, 4.0)[40:]])
        at_ends[lower, upper] = plant.snapshot()["debris"][[0, res.slices - 1]]
    assert min(means[0.0, 3e4], means[3e4, 0.0]) > 1.5 * means[3e4, 3e4]
    assert at_ends[0.0, 3e4][0] > 2 * at_ends[0.0, 3e4][1]
    assert at_ends[3e4, 0.0][1] > 2 * at_ends[3e4, 0.0][0]


def test_weak_flushing_leaves_more_debris_most_of_it_at_mid_height(machine, altered, drive):
    mean = {}
    for pressure in (5_000.0, 30_000.0):
        weak = altered(machine, {"base.dielectric.flushing_pressure_Pa": pressure, "base.gas.pumping": 0.0})
        plant = edmsim.Plant(weak, seed=1)
        windows = drive(plant, 20.0, 4.0)[40:]
        mean[pressure] = np.mean([w.debris for w in windows])
        end = plant.snapshot()["debris"]
        assert end[4] > end[0]
        assert end[4] > end[8]
    assert mean[5_000.0] > 2 * mean[30_000.0]


def test_bubbles_that_pump_leave_less_debris(machine, altered, drive):
    left = []
    for share in (0.0, 0.3, 1.0):
        plant = edmsim.Plant(altered(machine, {"base.gas.pumping": share}), 1, resolution="fast")
        left.append(np.mean([w.debris for w in drive(plant, 20.0, 4.0)[40:]]))
    assert left[0] > 1.1 * left[1] > 1.2 * left[2]


def test_a_gap_full_of_debris_shorts_until_it_is_flushed(in_a_hole, machine):
    plant = in_a_hole(machine, 30.0)
    fill(plant, debris=1.0)
    windows = [plant.advance() for _ in range(60)]
    assert windows[0].short > 20
    assert windows[0].debris < 1.0
    assert windows[-1].short == 0
    assert windows[-1].debris < 0.1
