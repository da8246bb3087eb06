"""Debris and flushing: what the water carries off, and when debris bridges the gap."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import edmsim
from edmsim.plant.gap.debris import bridged_probability, flush, nozzle_flow_per_slice_us

SHARES = st.lists(st.floats(0.0, 1.0), min_size=1, max_size=15)
SPARC = {"base": 0.3, "per_um": 0.02, "ceiling": 0.95, "steepness": 500.0}


@given(SHARES, st.floats(0.0, 1e12))
def test_flushing_adds_nothing_and_leaves_no_negative_share(start, changes):
    debris = np.array(start)
    flush(debris, changes)
    assert debris.min() >= 0.0
    assert debris.sum() <= sum(start) * (1 + 1e-12)


def test_no_time_changes_nothing_and_long_flushing_leaves_clean_water():
    debris = np.full(9, 0.4)
    flush(debris, 0.0)
    np.testing.assert_array_equal(debris, 0.4)
    for _ in range(30):
        flush(debris, 1e6)
    assert debris.max() < 1e-6


@pytest.mark.parametrize("n_slices", [5, 9, 15])
def test_debris_gathers_at_mid_height(n_slices):
    debris = np.zeros(n_slices)
    for _ in range(5_000):
        flush(debris, 0.05)
        debris += 1e-4  # the same in every slice
    np.testing.assert_allclose(debris, debris[::-1], rtol=1e-9)
    assert (np.diff(debris[: n_slices // 2 + 1]) > 0).all()


def test_the_nozzle_renews_its_own_slice_at_the_rate_of_its_flow():
    debris = np.array([0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.2])
    n = 1_000
    for _ in range(n):
        flush(debris, 1.0 / n)
    assert debris[0] == pytest.approx(0.2 * np.exp(-1), rel=1e-3)
    assert debris[8] == debris[0]
    assert debris[1] > debris[2] > 0.0  # it went inwards


def test_the_middle_slice_takes_half_from_either_side():
    """The flow has fallen to a fifth there (1 - 2/2.5), half of it from above and half from below."""
    debris = np.array([0.0, 0.0, 0.2, 0.0, 0.0])
    for _ in range(1_000):
        flush(debris, 1e-3)
    np.testing.assert_allclose(debris, [0.0, 0.0, 0.2 * np.exp(-0.2), 0.0, 0.0], rtol=1e-3)


def test_slot_flow():
    """Water in a slot: speed = dp g^2 / (12 eta (h/2))."""
    at = nozzle_flow_per_slice_us(30_000.0, 1e-3, 45.0, 20.0, 5)
    speed_um_us = 30_000.0 * 45e-6**2 / (12 * 1e-3 * 0.01)
    assert at == pytest.approx(speed_um_us / 4_000.0)
    assert nozzle_flow_per_slice_us(60_000.0, 1e-3, 45.0, 20.0, 5) == pytest.approx(2 * at)
    assert nozzle_flow_per_slice_us(30_000.0, 1e-3, 45.0, 40.0, 5) == pytest.approx(at / 4)


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


# --- in the plant ---


def test_weak_flushing_leaves_more_debris_most_of_it_at_mid_height(machine, altered, drive):
    mean = {}
    for pressure in (5_000.0, 30_000.0):
        weak = altered(machine, {"base.dielectric.flushing_pressure_Pa": pressure})
        plant = edmsim.Plant(weak, seed=1)
        windows = drive(plant, 20.0, 4.0)[40:]
        mean[pressure] = np.mean([w.debris for w in windows])
        end = plant.snapshot()["debris"]
        assert end[4] > end[0]
        assert end[4] > end[8]
    assert mean[5_000.0] > 2 * mean[30_000.0]


def test_a_gap_full_of_debris_shorts_until_it_is_flushed(in_a_hole, machine):
    plant = in_a_hole(machine, 30.0)
    state = plant.snapshot()
    state["debris"][:] = 1.0
    plant.restore(state)
    windows = [plant.advance() for _ in range(60)]
    assert windows[0].short > 20
    assert windows[0].debris < 1.0
    assert windows[-1].short == 0
    assert windows[-1].debris < 0.1
