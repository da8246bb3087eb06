"""Ignition: the delay law against its published table, and the pulse loop's use of it."""

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import cumulative_trapezoid

import edmsim
from edmsim.compiled.jit import compiled
from edmsim.compiled.random import key_of, uniform
from edmsim.machine.setting import discharge_current_A
from edmsim.plant.constants import flow_m_s, gap_law
from edmsim.plant.gap.breakdown import GapLaw, choose_ray, slice_sums, weibull
from edmsim.plant.gap.pulse_outcome import _await
from edmsim.plant.gap.rays import rays_with
from edmsim.plant.kernel.state import ARC, SHORT, SPARK, STATE, Arrays, allocate, sizes_of
from edmsim.plant.resolution import resolution

from .conftest import fill

FAST = resolution("fast")


def sums(gaps_um, law, shift, angles, debris):
    """Return rate, primed weight, contact depth and pull of rays with these gaps and angles."""
    row = np.zeros((1, 4))
    contact = slice_sums(rays_with(gaps_um, angles), 0, *shift, law, row, debris)
    return row[0, 0], row[0, 1], contact, row[0, 2], row[0, 3]


def front_rate(gap_um, law, res):
    """Rate over half of the wire's circumference and the whole height, with a constant gap."""
    n = res.slices * res.rays // 2
    return sums(np.full(n, gap_um), law, (0.0, 0.0), np.zeros(n), 0.0)[0]


def parabola(gap_um):
    return 0.48 * gap_um**2 - 3.69 * gap_um + 14.05


PARTICLES_UM = 300.0
LAW = GapLaw(0.48, -3.69, 14.05, 0.8, 3.84, 12.0, 0.1, 9.0, 4.0, PARTICLES_UM, 2.0, 0.008)


def larger_than(size_um, mean_um):
    """Share of particles larger than a size."""
    return np.exp(-size_um / mean_um)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["fast", "default", "fine"])
def test_rate_of_the_reference_area_is_the_published_one(name, machine, published):
    res = resolution(name)
    law = gap_law(machine.with_(height_mm=10), res, 80.0)
    rows = [row for row in published("ignition_median_vs_gap_eth") if row["gap_um"] >= 8]
    assert len(rows) == 9
    for row in rows:
        rate = front_rate(row["gap_um"], law, res)
        assert math.log(2) / rate == pytest.approx(row["t50_us"], rel=1e-4)
        assert rate == pytest.approx(row["rate_per_us"], abs=1e-6)


@pytest.mark.parametrize("debris", [0.0, 1e-4, 0.02])
@pytest.mark.parametrize(
    ("height", "diameter", "voltage"),
    [(10, 250, 80.0), (60, 50, 60.0), (20, 100, 250.0), (40, 360, 120.0), (20, 250, 100.0)],
)
def test_sums_over_the_rays_are_those_of_the_page(height, diameter, voltage, debris, machine):
    """Sites of patches at gaps of equal field, less the wire's movement; below 3.84 um the rate is constant."""
    set_up = machine.with_(height_mm=height, wire_diameter_um=diameter, tension=0.2)
    law, field = gap_law(set_up, FAST, voltage), voltage / 80
    rng, n = np.random.default_rng(1), 400
    angle, traced, shift = rng.uniform(-2.0, 2.0, n), rng.uniform(0.0, 60.0, n) * field, (1.5, -1.0)
    gap = traced - shift[0] * np.cos(angle) - shift[1] * np.sin(angle)
    patch_um2 = math.pi * diameter * height * 1e3 / (FAST.slices * FAST.rays)
    patches = patch_um2 / (math.pi / 2 * 250.0 * 10e3)
    rate = math.log(2) / parabola(np.maximum(gap / field, 3.69 / 0.96)) * patches
    held, mean_um, beyond = np.maximum(gap, 1.0), law.particle_um, np.maximum(gap - 9.0 * field, 0.0)
    sites = patches * np.maximum(12.0 * field - gap, 0.0) ** 2 / (12 * field**2)
    sites += patch_um2 * held * debris / (math.pi * mean_um**3) * np.exp(-beyond / mean_um)
    pull = (1 / held + 1 / diameter) ** 2
    found = np.array(sums(traced, law, shift, angle, debris)) * [1.0, law.primed_per_um2, 1.0, 1.0, 1.0]
    expected = [rate.sum(), sites.sum(), np.maximum(2.0 - gap, 0.0).sum(), pull @ np.cos(angle), pull @ np.sin(angle)]
    np.testing.assert_allclose(found, expected, rtol=2e-4, atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(("primed", "debris"), [(False, 0.0), (False, 0.01), (True, 0.0), (True, 0.01)])
def test_places_of_ignition_follow_the_weights(primed, debris):
    gaps = np.array([6.0, 9.0, 30.0, 7.0, 11.0, 12.5, 8.0, 10.0], np.float32)
    gap_um = gaps.astype(float)
    weights = np.maximum(12.0 - gap_um, 0.0) ** 2 if primed else 1 / parabola(gap_um * 0.8)
    if primed:  # the widest gap has most particles, but needs larger ones
        weights += PARTICLES_UM * debris * gap_um * larger_than(np.maximum(gap_um - 9.0, 0.0), 4.0)
    draws = 20_000
    targets = [uniform(key_of(3), np.uint64(n)) * weights.sum() for n in range(draws)]
    rays = rays_with(gaps, np.zeros(8))
    chosen = [choose_ray(rays, 0, 0.0, 0.0, LAW, primed, target, debris) for target in targets]
    counts = np.bincount(chosen, minlength=len(gaps))
    possible = weights > 0
    assert counts[~possible].sum() == 0
    expected = weights[possible] / weights.sum() * draws
    assert stats.chisquare(counts[possible], expected).pvalue > 1e-3


def test_a_target_past_the_total_falls_on_the_narrowest_gap():
    rays = rays_with([20.0, 6.0, 15.0], np.zeros(3))
    assert [choose_ray(rays, 0, 0.0, 0.0, LAW, primed, 1e9, 0.01) for primed in (False, True)] == [1, 1]


@pytest.mark.parametrize(("scale", "shape"), [(2.0, 1.0), (1.5, 0.7), (3.0, 2.0)])
def test_primed_delays_are_weibull(scale, shape):
    draws = [weibull(scale, shape, uniform(key_of(5), np.uint64(n))) for n in range(5_000)]
    assert stats.kstest(draws, stats.weibull_min(shape, scale=scale).cdf).pvalue > 1e-3


# --- the law in the pulse loop: a wire in the middle of a hole has the same gap everywhere ---

LONG = {"t_on_us": 300.0, "t_period_us": 2_000.0}


@compiled
def _many_delays(state, a, sums, rate, wait_us, delays, slices):
    for n in range(len(delays)):
        delays[n], slices[n], _ = _await(state, a, sums, rate, wait_us)


@pytest.mark.slow
@pytest.mark.parametrize("carried", [(0.0, 0.0), (0.02, 0.02), (0.005, 0.08)])
def test_the_flow_puts_off_delays_as_the_integral_of_its_rate_says(carried):
    """Thinning compared with numerical integration: distribution of delays, and slices in which they end."""
    state, a, sums = np.zeros(1, STATE), allocate(Arrays, sizes_of(2, 24, 4)), np.zeros((2, 4))
    state["key"], a.carried_per_us[:], sums[:, 0] = key_of(7), carried, (0.01, 0.03)
    delays, slices = np.empty(20_000), np.empty(20_000, np.int64)
    _many_delays(state, a, sums, 0.04, 150.0, delays, slices)
    times = np.linspace(0.0, 150.0, 15_001)
    hazards = sums[:, 0] * np.exp(-np.square(np.outer(times, carried)))
    survives = np.exp(-cumulative_trapezoid(hazards.sum(axis=1), times, initial=0.0))
    lit = delays < 150.0
    assert (~lit).mean() == pytest.approx(survives[-1], abs=0.01)
    shorter = (1 - survives) / (1 - survives[-1])
    assert stats.kstest(delays[lit], lambda t: np.interp(t, times, shorter)).pvalue > 1e-3
    ends_low = np.trapezoid(hazards[:, 0] * survives, times) / (1 - survives[-1])
    assert (slices[lit] == 0).mean() == pytest.approx(ends_low, abs=0.01)


@pytest.mark.parametrize(("gap", "height", "voltage", "pressure_Pa"), [
    (20, 10, 80, 0.0), (30, 10, 80, 3e4), (20, 20, 80, 3e4), (25, 10, 100, 3e4), (20, 10, 80, 2e5),
])  # fmt: skip
def test_share_of_open_pulses_follows_rate_time_and_flow(gap, height, voltage, pressure_Pa, in_a_hole, machine):
    setting = {"generator.open_voltage_V": float(voltage)}
    set_up = machine.with_(**LONG, height_mm=height, flushing_lower_Pa=pressure_Pa, flushing_upper_Pa=pressure_Pa)
    plant = in_a_hole(set_up, gap, **setting)
    windows = [plant.advance() for _ in range(40)]
    pulses = 40 * 255
    rate = 2 * height / 10 * math.log(2) / parabola(gap * 80 / voltage)
    assert sum(w.short + w.arc for w in windows) == 0
    times, unlit = np.linspace(0.0, 300.0, 3_001), sum(w.open for w in windows) / pulses
    hazard = rate * np.exp(-np.square(np.outer(times, flow_m_s(set_up, FAST) / 100.0))).mean(axis=1)
    survives = np.exp(-cumulative_trapezoid(hazard, times, initial=0.0))
    assert math.log(unlit) == pytest.approx(math.log(survives[-1]), rel=0.06)
    delays = np.average([w.mean_delay_us for w in windows], weights=[w.spark for w in windows])
    truncated = (np.trapezoid(survives, times) - 300.0 * survives[-1]) / (1 - survives[-1])
    assert delays == pytest.approx(truncated + 0.2, rel=0.06)


# --- particles of debris ---

SPARSE = {"base.gap.median_c_us": 1e15, "base.gap.critical_width_um": 0.1, "base.gap.chaining": 0.0}
"""Above the critical gap only particles cause ignition, and none bridges the gap."""


def loaded(in_a_hole, machine, gap_um, debris, mean_um, **constants):
    """A plant in a hole with stagnant water and debris of this mean size; its craters add almost no debris."""
    stagnant = machine.with_(**LONG, height_mm=10, flushing_lower_Pa=0.0, flushing_upper_Pa=0.0)
    crater_um3 = 1e-15 * 1e9 * 22.0 * discharge_current_A(stagnant) * 300e-6
    size = {"base.gap.particle_share": mean_um / crater_um3 ** (1 / 3)}
    plant = in_a_hole(stagnant, gap_um, **(SPARSE | size | constants))
    fill(plant, debris=debris)
    return plant


def test_debris_of_a_setting_is_as_large_as_its_craters_make_it(machine):
    """A share of the cube root of the crater's volume: with equal current, longer pulses make coarser debris."""
    sizes = [gap_law(machine.with_(t_on_us=on), FAST, 100.0).particle_um for on in (2.5, 20.0)]
    per_J = 9.3e-3 * 1e9 * np.array([(2.5 / 20) ** 0.45, 1.0])  # short pulses remove less
    crater_um3 = per_J * 22.0 * discharge_current_A(machine) * np.array([2.5e-6, 20e-6])
    np.testing.assert_allclose(sizes, 0.05 * np.cbrt(crater_um3), rtol=1e-6)
    dead = gap_law(machine, FAST, 1e-6)
    assert dead.particles_um == 0.0  # the generator is switched off


@pytest.mark.parametrize(("gap", "debris", "mean_um"), [(14.0, 2e-6, 3.0), (16.0, 4e-6, 2.0), (30.0, 2e-4, 2.0)])
def test_debris_hastens_ignition(gap, debris, mean_um, in_a_hole, machine):  # T-9
    """A share ``exp(-N)`` of the pulses stays open if N particles around the wire are large enough."""
    plant = loaded(in_a_hole, machine, gap, debris, mean_um)
    critical = 9.0 * 100.0 / 80.0
    number = 250.0 * 10_000.0 * gap * debris / mean_um**3 * larger_than(gap - critical, mean_um)
    windows = [plant.advance() for _ in range(20)]
    assert sum(w.short + w.arc for w in windows) == 0
    unlit = sum(w.open for w in windows) / (20 * 255)
    assert 0.05 < unlit < 0.9
    assert -math.log(unlit) == pytest.approx(number, rel=0.08)
    delays = np.average([w.mean_delay_us for w in windows], weights=[w.spark for w in windows])
    assert delays == pytest.approx(machine.base.gap.primed_scale_us.value + 0.2, rel=0.08)  # within a few us
    clean = loaded(in_a_hole, machine, gap, 0.0, mean_um)
    assert clean.advance().open == 255


def test_a_particle_that_finds_others_bridges_the_gap(in_a_hole, machine):
    """Of the sites primed by particles in a wide gap, a share ``chaining x debris`` becomes shorts."""
    for debris in (0.005, 0.02):
        plant = loaded(in_a_hole, machine, 20.0, debris, 3.0, **{"base.gap.chaining": 20.0})
        windows = [plant.advance() for _ in range(20)]
        primed = sum(w.short + w.spark for w in windows)
        assert primed > 0.99 * 20 * 255
        assert sum(w.short for w in windows) / primed == pytest.approx(20.0 * debris, abs=0.025)
    near = loaded(in_a_hole, machine, 8.0, 0.02, 3.0, **{"base.gap.chaining": 20.0})
    assert near.advance().short == 0  # in so narrow a gap sites are primed without particles


def test_at_the_point_of_figure_2_9_delays_rise_with_the_gap_and_beyond_the_critical_one_with_flow(
    in_a_hole, own_file
):  # T-9, T-10
    """Pulses of 600 W, 300 V open, 50 us in 100 us; flows of 0 to 4 m/s; gaps of 10, 20 and 30 um, and two more.

    At 300 V the critical gap is 34 um: in the figure's gaps sites are primed, and the flow does not carry them off.
    In the figure these delays rise with the flow; that is a row of the validation, which fails.
    """
    strong = own_file(
        "generators", "iso-pulse", ("{ value = 100.0, range = [60.0, 120.0],", "{ value = 300.0,"),
        ("{ value = 11.8,", "{ value = 10.19,"), ("{ value = 30.0,", "{ value = 50.0,"),
        ("{ value = 2.0,", "{ value = 14.0,"),
    )  # fmt: skip
    machine = edmsim.Machine.load(generator=strong, height_mm=20.0)
    assert machine.material.burning_voltage_V.value * discharge_current_A(machine) == pytest.approx(600.0, rel=1e-3)
    narrow, wide, flows, delays = (10.0, 20.0, 30.0), (40.0, 50.0), (0.0, 2.0, 4.0), {}
    gaps = narrow + wide
    for gap in gaps:
        for flow in flows:
            flushed = machine.with_(flushing_lower_Pa=flow * 171_850.0, flushing_upper_Pa=0.0)
            assert flow_m_s(flushed, FAST).mean() == pytest.approx(flow, rel=0.01)
            plant = in_a_hole(flushed, gap)
            windows = [plant.advance() for _ in range(16)]
            pulses = [w.mean_delay_us * (w.spark + w.arc) + machine.t_on_us * w.open for w in windows]
            delays[gap, flow] = sum(pulses) / (16 * 255)
    within_us = 2.0 + 0.2  # delay of a primed site
    assert all(delays[gap, flow] == pytest.approx(within_us, rel=0.05) for gap in narrow for flow in flows)
    assert all(delays[50.0, flow] > 2 * delays[40.0, flow] > 4 * within_us for flow in flows)
    assert all(delays[gap, one] < delays[gap, more] for gap in wide for one, more in pairwise(flows))
    assert delays[50.0, 4.0] > 1.2 * delays[50.0, 0.0]
    with pytest.raises(edmsim.InputError, match="above the generator's 2 A"):  # the machine's own generator cannot
        edmsim.Machine.load(peak_current_A=6.6, t_on_us=50.0, t_period_us=100.0)


def test_unknown_resolution_is_refused():
    with pytest.raises(edmsim.InputError, match=r"'coarse'; there are: fast, default, fine"):
        resolution("coarse")


# --- the place of the last discharge ---


def arcs_by_chain(in_a_hole, pause_us, **constants):
    """Share of arcs among pulses after a spark, and after a spark and an arc, with this pause."""
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


@pytest.mark.parametrize(("pause", "gain"), [(6.0, 1.0), (10.0, 1.0), (20.0, 1.0), (6.0, 0.0)])
def test_arcs_return_the_more_the_shorter_the_pause_and_the_longer_their_chain(pause, gain, in_a_hole):
    """Ions decay in 3 us; the heat of a spark doubles this time, and decays itself in 40 us."""
    hot = gain * math.exp(-pause / 40.0)
    once, twice = (math.exp(-pause / (3.0 * (1.0 + heat))) for heat in (hot, (1.0 + hot) * hot))
    found = arcs_by_chain(in_a_hole, pause, **{"base.discharge.spot_gain": gain})
    assert found == (pytest.approx(once, abs=0.03), pytest.approx(twice, abs=0.05))


def test_after_a_long_pause_no_spark_leaves_an_arc(in_a_hole):
    assert arcs_by_chain(in_a_hole, 150.0)[0] == 0.0


def test_a_short_leaves_the_clock_of_the_ions_alone(in_a_hole, machine):
    """The time since the end of the last discharge continues through shorts and open pulses."""
    plant = in_a_hole(machine, 6.0)
    spark = plant.advance_pulse()
    assert spark.spark == 1
    quiet = plant.snapshot()["state"]["since_discharge_us"][0]
    assert quiet == pytest.approx(100.0 - 30.0)
    fill(plant, debris=1.0)  # certainly bridges the gap
    for n in (1, 2, 3):
        assert plant.advance_pulse().short == 1
        assert plant.snapshot()["state"]["since_discharge_us"][0] == pytest.approx(quiet + 100.0 * n)
    wide = in_a_hole(machine, 80.0)
    before = wide.snapshot()["state"]["since_discharge_us"][0]
    assert wide.advance_pulse().open == 1
    assert wide.snapshot()["state"]["since_discharge_us"][0] == before + 100.0
