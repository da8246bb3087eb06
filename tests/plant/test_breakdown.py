"""Ignition: the delay law against its published table, and what the pulse loop makes of it."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy import stats

import edmsim
from edmsim.compiled.random import key_of, uniform
from edmsim.machine.setting import discharge_current_A
from edmsim.plant.constants import flow_factor, flow_m_s, gap_law
from edmsim.plant.gap.breakdown import GapLaw, choose_ray, slice_sums, weibull
from edmsim.plant.gap.rays import rays_with
from edmsim.plant.kernel.state import ARC, SHORT, SPARK
from edmsim.plant.resolution import resolution

FAST = resolution("fast")


def sums(gaps_um, law, shift=(0.0, 0.0), angles=None):
    """Return rate, primed weight, contact depth and pull of rays with these gaps, by default all along x."""
    rays, row = rays_with(gaps_um, np.zeros(len(gaps_um)) if angles is None else angles), np.zeros((1, 4))
    contact = slice_sums(rays, 0, *shift, law, 1.0, row)
    return row[0, 0], row[0, 1], contact, row[0, 2], row[0, 3]


def front(gap_um, law, res=FAST):
    """Sums over half the wire's girth and the whole height, at one gap everywhere."""
    return np.array(sums(np.full(res.slices * res.rays // 2, gap_um), law))


def parabola(gap_um):
    return 0.48 * gap_um**2 - 3.69 * gap_um + 14.05


@pytest.mark.slow
@pytest.mark.parametrize("name", ["fast", "default", "fine"])
def test_rate_of_the_reference_area_is_the_published_one(name, machine, published):
    res = resolution(name)
    law = gap_law(machine.with_(height_mm=10), res, 80.0)
    rows = [row for row in published("ignition_median_vs_gap_eth") if row["gap_um"] >= 8]
    assert len(rows) == 9
    for row in rows:
        rate = front(row["gap_um"], law, res)[0]
        assert math.log(2) / rate == pytest.approx(row["t50_us"], rel=1e-4)
        assert rate == pytest.approx(row["rate_per_us"], abs=1e-6)


@pytest.mark.parametrize(("height", "diameter"), [(20, 250), (40, 250), (10, 100), (60, 50)])
def test_rates_and_primed_exponents_add_with_area(height, diameter, machine):
    reference = machine.with_(height_mm=10)
    other = reference.with_(wire_diameter_um=diameter, tension=1.0, height_mm=height)
    ratio = height / 10 * diameter / 250
    for gap in (6.0, 10.0, 25.0):
        small, large = gap_law(reference, FAST, 80.0), gap_law(other, FAST, 80.0)
        expected, total = front(gap, small), front(gap, large)
        assert total[0] == pytest.approx(ratio * expected[0], rel=1e-5)
        exponent = small.primed_per_um2 * expected[1]
        assert large.primed_per_um2 * total[1] == pytest.approx(ratio * exponent, rel=1e-5)


@pytest.mark.parametrize("voltage", [60.0, 100.0, 120.0, 250.0])
def test_equal_field_gives_equal_delay(voltage, machine):
    at_80, law = gap_law(machine, FAST, 80.0), gap_law(machine, FAST, voltage)
    for gap in (8.0, 12.0, 20.0):
        assert front(gap * voltage / 80, law)[0] == pytest.approx(front(gap, at_80)[0], rel=1e-4)
    for gap in (4.0, 8.0, 9.0, 11.5):
        primed, at_reference = law.primed_per_um2 * front(gap * voltage / 80, law)[1], front(gap, at_80)[1]
        assert primed == pytest.approx(at_80.primed_per_um2 * at_reference, rel=1e-4)


def test_rate_never_falls_as_the_gap_closes(machine):
    law = gap_law(machine, FAST, 80.0)
    gaps, fastest_um = np.arange(0.0, 60.0, 0.5), 3.69 / 0.96
    rates = np.array([front(gap, law)[0] for gap in gaps])
    assert all(a > b for a, b in pairwise(rates[gaps > fastest_um]))
    np.testing.assert_allclose(rates[gaps < fastest_um], rates[0], rtol=1e-6)  # there it stays; sums of float32
    assert (rates[gaps > fastest_um] < rates[0]).all()
    lowest = parabola(fastest_um)
    assert rates[0] == pytest.approx(2 * math.log(2) / lowest, rel=1e-4)  # 20 mm: twice the reference area


def test_sites_become_primed_through_the_critical_gap(machine):
    law = gap_law(machine.with_(height_mm=10), FAST, 80.0)
    gaps = np.array([15.0, 12.0, 11.0, 9.0, 7.0, 3.0])
    exponent = np.array([law.primed_per_um2 * front(gap, law)[1] for gap in gaps])
    np.testing.assert_allclose(exponent, np.maximum(12.0 - gaps, 0.0) ** 2 / 12, rtol=1e-5)
    primed = 1 - np.exp(-exponent)
    assert primed[1] == 0.0
    assert 0.4 < primed[3] < 0.6  # about one half at 9 um, between 8 and 10
    assert primed[5] > 0.99


def test_gaps_follow_the_wire(machine):
    """Rays shorten by what the wire moves along them."""
    law = gap_law(machine, FAST, 80.0)
    angles = np.linspace(-1.2, 1.2, 16)
    gaps = np.linspace(9.0, 30.0, 16)
    moved = gaps - 3.0 * np.cos(angles) + 2.0 * np.sin(angles)
    np.testing.assert_allclose(
        sums(gaps, law, (3.0, -2.0), angles), sums(moved, law, (0.0, 0.0), angles), rtol=1e-4, atol=1e-5
    )


def test_contact_is_the_depth_below_the_asperities(machine):
    law = gap_law(machine, FAST, 80.0)
    assert sums([2.0, 5.0, 80.0], law)[2] == 0.0
    assert sums([1.5, 5.0, -1.0], law)[2] == pytest.approx(0.5 + 3.0)


@pytest.mark.slow
@pytest.mark.parametrize("primed", [False, True])
def test_places_of_ignition_follow_the_weights(primed):
    law = GapLaw(0.48, -3.69, 14.05, 0.8, 3.84, 12.0, 0.1, 2.0, 0.008)
    gaps = np.array([6.0, 9.0, 30.0, 7.0, 11.0, 12.5, 8.0, 10.0], np.float32)
    gap_um = gaps.astype(float)
    weights = np.maximum(12.0 - gap_um, 0.0) ** 2 if primed else 1 / parabola(gap_um * 0.8)
    draws = 20_000
    targets = [uniform(key_of(3), np.uint64(n)) * weights.sum() for n in range(draws)]
    rays = rays_with(gaps, np.zeros(8))
    chosen = [choose_ray(rays, 0, 0.0, 0.0, law, primed, target) for target in targets]
    counts = np.bincount(chosen, minlength=len(gaps))
    possible = weights > 0
    assert counts[~possible].sum() == 0
    expected = weights[possible] / weights.sum() * draws
    assert stats.chisquare(counts[possible], expected).pvalue > 1e-3


def test_a_target_past_the_total_falls_on_the_narrowest_gap():
    law = GapLaw(0.48, -3.69, 14.05, 1.0, 3.84, 12.0, 0.1, 2.0, 0.008)
    assert choose_ray(rays_with([20.0, 6.0, 15.0], np.zeros(3)), 0, 0.0, 0.0, law, False, 1e9) == 1


@pytest.mark.parametrize(("scale", "shape"), [(2.0, 1.0), (1.5, 0.7), (3.0, 2.0)])
def test_primed_delays_are_weibull(scale, shape):
    draws = [weibull(scale, shape, uniform(key_of(5), np.uint64(n))) for n in range(5_000)]
    assert stats.kstest(draws, stats.weibull_min(shape, scale=scale).cdf).pvalue > 1e-3


# --- the law at work in the pulse loop: the wire in the middle of a hole has the same gap everywhere ---

LONG = {"t_on_us": 300.0, "t_period_us": 2_000.0}


@pytest.mark.parametrize(
    ("gap", "height", "voltage"), [(20, 10, 80), (30, 10, 80), (20, 20, 80), (25, 10, 100)]
)
def test_share_of_open_pulses_is_the_exponential_of_rate_and_time(gap, height, voltage, in_a_hole, machine):
    setting = {"generator.open_voltage_V": float(voltage)}
    set_up = machine.with_(**LONG, height_mm=height)
    plant = in_a_hole(set_up, gap, **setting)
    windows = [plant.advance() for _ in range(40)]
    pulses = 40 * 255
    rate = 2 * height / 10 * math.log(2) / parabola(gap * 80 / voltage) * flow_factor(set_up, FAST).mean()
    assert sum(w.short + w.arc for w in windows) == 0
    unlit = sum(w.open for w in windows) / pulses
    assert -math.log(unlit) / 300.0 == pytest.approx(rate, rel=0.06)
    expected = math.exp(-rate * 300.0)
    delays = np.average([w.mean_delay_us for w in windows], weights=[w.spark for w in windows])
    truncated = 1 / rate - 300.0 * expected / (1 - expected)
    assert delays == pytest.approx(truncated + 0.2, rel=0.06)


def test_a_narrow_gap_ignites_within_microseconds(in_a_hole, machine):
    """Two regimes: below the critical gap most delays are a few us, above it none is (Esteves 2023)."""
    quick = {}
    for gap in (6.0, 20.0):
        plant = in_a_hole(machine.with_(t_on_us=10.0, t_period_us=100.0, height_mm=10), gap)
        windows = [plant.advance() for _ in range(20)]
        quick[gap] = sum(w.spark for w in windows) / (20 * 255)
    assert quick[6.0] > 0.95
    assert quick[20.0] < 0.2


def test_debris_hastens_ignition(in_a_hole, machine):  # T-9
    """Rate times 1 + gain x share: debris of 0.1 at gain 5 makes it half as much again."""
    stagnant = machine.with_(**LONG, height_mm=10, flushing_lower_Pa=0.0, flushing_upper_Pa=0.0)
    rates = []
    for debris in (0.0, 0.1):
        plant = in_a_hole(stagnant, 25.0)
        state = plant.snapshot()
        state["debris"][:] = debris
        plant.restore(state)
        unlit = sum(plant.advance().open for _ in range(20)) / (20 * 255)
        rates.append(-math.log(unlit) / 300.0)
    assert rates[1] / rates[0] == pytest.approx(1.5, rel=0.08)


def test_at_the_point_of_figure_2_9_delays_rise_with_gap_and_flow(in_a_hole, own_file):  # T-9, T-10
    """A pulse of 600 W, 300 V open, 50 us in 100 us, flows of 0 to 4 m/s, gaps of 10, 20 and 30 um."""
    strong = own_file(
        "generators", "iso-pulse", ("{ value = 100.0, range = [60.0, 120.0],", "{ value = 300.0,"),
        ("{ value = 11.8,", "{ value = 10.19,"), ("{ value = 30.0,", "{ value = 50.0,"),
        ("{ value = 2.0,", "{ value = 14.0,"),
    )  # fmt: skip
    machine = edmsim.Machine.load(generator=strong, height_mm=20.0)
    assert machine.material.burning_voltage_V.value * discharge_current_A(machine) == pytest.approx(600.0, rel=1e-3)
    gaps, flows, delays = (10.0, 20.0, 30.0), (0.0, 1.0, 2.0, 4.0), {}
    for gap in gaps:
        for flow in flows:
            flushed = machine.with_(flushing_lower_Pa=flow * 272_000.0, flushing_upper_Pa=0.0)
            assert flow_m_s(flushed, FAST).mean() == pytest.approx(flow, rel=0.01)
            plant = in_a_hole(flushed, gap)
            windows = [plant.advance() for _ in range(4)]
            pulses = [w.mean_delay_us * (w.spark + w.arc) + machine.t_on_us * w.open for w in windows]
            delays[gap, flow] = sum(pulses) / (4 * 255)
    assert all(delays[gap, one] <= delays[gap, more] for gap in gaps for one, more in pairwise(flows))
    assert all(delays[one, flow] <= delays[wider, flow] for flow in flows for one, wider in pairwise(gaps))
    assert delays[30.0, 4.0] > 3 * delays[30.0, 0.0]
    assert delays[30.0, 4.0] > 2 * delays[20.0, 4.0] > 2 * delays[10.0, 4.0]
    with pytest.raises(edmsim.InputError, match="above the generator's 2 A"):  # this machine's own cannot
        edmsim.Machine.load(peak_current_A=6.6, t_on_us=50.0, t_period_us=100.0)


def test_unknown_resolution_is_refused():
    with pytest.raises(edmsim.InputError, match=r"'coarse'; there are: fast, default, fine"):
        resolution("coarse")


# --- the place that burned last ---


def arcs_by_chain(in_a_hole, pause_us, **constants):
    """Share of arcs among the pulses after a spark, and after a spark and an arc, so long after they burned."""
    machine = edmsim.Machine.load(
        generator="iso-energetic", peak_current_A=0.5, t_on_us=10.0, t_period_us=10.0 + pause_us
    )
    plant = in_a_hole(machine, 6.0, **constants)
    plant.watch_pulses()
    kinds = []
    for _ in range(60):
        plant.advance()
        kinds += plant.last_pulses()["kind"].tolist()
    kinds = np.array(kinds)
    assert not (kinds == SHORT).any()
    after_spark = kinds[1:][kinds[:-1] == SPARK] == ARC
    after_both = kinds[2:][(kinds[:-2] == SPARK) & (kinds[1:-1] == ARC)] == ARC
    return after_spark.mean(), after_both.mean() if len(after_both) else math.nan


@pytest.mark.parametrize("pause", [6.0, 10.0, 20.0])
def test_arcs_return_the_more_the_shorter_the_pause_and_the_longer_their_chain(pause, in_a_hole):
    """Ions leave in 5 us; the heat of a spark makes that twice as long, and fades itself within 40 us."""
    hot = math.exp(-pause / 40.0)
    once, twice = (math.exp(-pause / (5.0 * (1.0 + heat))) for heat in (hot, (1.0 + hot) * hot))
    found = arcs_by_chain(in_a_hole, pause)
    assert found == (pytest.approx(once, abs=0.03), pytest.approx(twice, abs=0.05))


def test_without_memory_of_heat_arcs_follow_the_ions_alone(in_a_hole):
    found = arcs_by_chain(in_a_hole, 6.0, **{"base.discharge.spot_gain": 0.0})
    expected = math.exp(-6.0 / 5.0)
    assert found == (pytest.approx(expected, abs=0.03), pytest.approx(expected, abs=0.05))


def test_after_a_long_pause_no_spark_leaves_an_arc(in_a_hole):
    assert arcs_by_chain(in_a_hole, 150.0)[0] == 0.0
