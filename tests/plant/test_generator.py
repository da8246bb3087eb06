"""The pulse generator: refused settings, and its three modes in the gap."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import edmsim
from edmsim.machine.setting import discharge_current_A, mean_current_A
from edmsim.plant.gap.generator import timing
from edmsim.plant.kernel.state import ARC, SHORT, SPARK


def load(mode="iso-pulse", **setting):
    return edmsim.Machine.load(generator=mode, **setting)


@given(st.floats(1.0, 25.0), st.floats(100.0, 5_000.0), st.floats(0.5, 0.99))
def test_mean_current_rises_with_the_duty(machine, on, period, less):  # T-35
    setting = machine.with_(t_on_us=on, t_period_us=period)
    assert mean_current_A(setting) == pytest.approx(discharge_current_A(machine) * on / period)
    assert mean_current_A(setting.with_(t_period_us=period / less)) < mean_current_A(setting) <= 2.0


def test_a_refused_setting_leaves_the_old_one(machine):  # T-34
    plant = edmsim.Plant(machine, seed=1, resolution="fast")
    reference = edmsim.Plant(machine, seed=1, resolution="fast")
    with pytest.raises(edmsim.InputError, match="above the generator's 2 A"):
        plant.set_generator(30.0, 60.0)
    assert (plant.machine.t_on_us, plant.machine.t_period_us) == (30.0, 100.0)
    assert [plant.advance() for _ in range(5)] == [reference.advance() for _ in range(5)]


@pytest.mark.parametrize("period", [2.0, 10.0, 100.0, 1_000.0, 10_000.0])
def test_dead_time_is_255_periods_exactly(period, machine, altered):  # T-36, T-42
    weak = altered(machine, {"generator.resistance_ohm": 100.0})
    plant = edmsim.Plant(weak.with_(t_on_us=1.0, t_period_us=period), seed=1, resolution="fast")
    dead_ns = round(255 * period * 1e3)
    assert plant.window_ns == plant.longest_window_ns == dead_ns
    for n in range(3):
        window = plant.advance()
        assert (window.start_ns, window.duration_ns) == (n * dead_ns, dead_ns)
        assert window.pulses == 255


@pytest.mark.parametrize(("generator", "shape"), [
    ("iso-pulse", "rectangle"), ("iso-energetic", "rectangle"), ("iso-energetic", "triangle"),
    ("ignition-pulse", "rectangle"), ("production", "triangle"), ("fine", "triangle"),
])  # fmt: skip
def test_a_window_is_the_sum_of_its_pulses(generator, shape, drive):  # T-3, T-5
    """For iso-pulses t(e) = t(i) - t(d); for the others t(e) is set, and the period of two of them varies."""
    machine = load(generator, pulse_shape=shape)
    own, on_us, mean = machine.generator, machine.t_on_us, 0.5 if shape == "triangle" else 1.0
    supply_V, ohm = (own.supply_voltage_V or own.open_voltage_V).value, own.resistance_ohm.value
    discharge_A, short_A = mean * (supply_V - 22.0) / ohm, mean * supply_V / ohm
    short_A *= own.short_current_share.value if own.short_current_share else 1.0
    plant = edmsim.Plant(machine, seed=2, resolution="fast")
    plant.watch_pulses()
    varies, kinds, durations = own.mode == "iso-energetic", set(), set()
    for _ in range(60):
        (window,) = drive(plant, 40.0, 1e-9)
        pulses = plant.last_pulses()
        kind, delay_us = pulses["kind"], pulses["delay_us"].astype(float)
        assert [(kind == k).sum() for k in range(4)] == [window.open, window.spark, window.arc, window.short]
        burns_us = on_us - delay_us if own.mode == "iso-pulse" else np.full(255, on_us)
        burns_us = burns_us * np.where(kind == ARC, own.arc_share.value if own.arc_share else 1.0, kind == SPARK)
        conducting_us = np.where(kind == SHORT, on_us, burns_us)
        np.testing.assert_allclose(pulses["conducting_us"], conducting_us, atol=1e-5)
        waits_us = np.where(kind == SHORT, 0.0, delay_us)
        periods_us = waits_us + conducting_us + machine.t_period_us - on_us if varies else machine.t_period_us
        duration_us, rounding_us = window.duration_ns * 1e-3, 255 * 0.08 if varies else 0.0
        assert duration_us == pytest.approx(np.sum(periods_us + np.zeros(255)), abs=rounding_us)
        assert duration_us * 1e3 <= plant.longest_window_ns
        assert window.energy_J == pytest.approx(22.0 * discharge_A * burns_us.sum() * 1e-6, rel=1e-6)
        charge = discharge_A * burns_us.sum() + short_A * on_us * window.short
        assert window.mean_current_A * duration_us == pytest.approx(charge, rel=1e-6)
        volts_us = pulses["open_V"] @ waits_us + 22.0 * burns_us.sum()
        assert window.mean_voltage_V * duration_us == pytest.approx(volts_us, rel=1e-6)
        if window.spark + window.arc:
            assert pulses["gap_um"][burns_us > 0].mean() == pytest.approx(window.gap_um, rel=1e-4)
        assert (np.diff(pulses["start_us"]) > 0).all()
        assert pulses["start_us"][-1] < duration_us
        kinds |= set(kind.tolist())
        durations.add(window.duration_ns)
    assert SPARK in kinds
    assert (len(durations) > 10) == varies
    assert (plant.window_ns == 0) == varies


def test_an_ignition_pulse_nearly_always_ignites(in_a_hole):  # T-5
    gap = 20.0
    iso = in_a_hole(load("iso-pulse", t_on_us=20.0), gap)
    ignition = in_a_hole(load("ignition-pulse", t_on_us=20.0), gap)
    unlit = [np.mean([p.advance().open for _ in range(10)]) / 255 for p in (iso, ignition)]
    assert unlit[0] > 0.4
    assert unlit[1] < 0.02


@pytest.mark.parametrize(("on", "period"), [(30.0, 100.0), (30.0, 400.0), (200.0, 1000.0)])
def test_the_mean_voltage_is_to_be_divided_by_the_relative_pulse_duration(on, period, in_a_hole, machine):  # T-6, T-7
    """Divided by the duty cycle, the voltages of an open and a sparking gap are the same at every duty cycle."""
    setting = machine.with_(t_on_us=on, t_period_us=period)
    relative = on / period
    assert in_a_hole(setting, 300.0).advance().mean_voltage_V / relative == pytest.approx(100.0)
    sparking = in_a_hole(setting, 6.0).advance()
    waiting = sparking.mean_delay_us / on
    assert sparking.spark > 240
    assert sparking.mean_voltage_V / relative == pytest.approx(22.0 + 78.0 * waiting, rel=0.05)


def test_a_new_setting_holds_from_the_next_window_on(machine):
    plant = edmsim.Plant(machine, seed=1, resolution="fast")
    assert plant.advance().duration_ns == 25_500_000
    plant.set_generator(10.0, 200.0)
    assert plant.advance().duration_ns == 51_000_000
    assert (plant.machine.t_on_us, plant.machine.t_period_us) == (10.0, 200.0)


def test_a_generator_switched_off_moves_no_metal_and_lets_the_table_move(machine, drive):
    plant = edmsim.Plant(machine, seed=1, resolution="fast")
    plant.switch_generator(False)
    windows = drive(plant, 20.0, 1.0)
    assert plant.time_ns == sum(w.duration_ns for w in windows)
    assert plant.commanded_um[0] == pytest.approx(32_520.0, abs=2.0)
    assert all(w.energy_J == 0.0 and w.mean_current_A == 0.0 and w.mean_voltage_V < 0.01 for w in windows)
    assert plant.removed_mm3 == 0.0
    assert windows[-1].wire_temperature_K == pytest.approx(machine.base.dielectric.temperature_K.value)
    plant.switch_generator(True)
    assert sum(w.spark for w in drive(plant, 20.0, 1.0)) > 0
    assert plant.removed_mm3 > 0.0


# --- triangular pulses and the operator's choices in the loop ---


def test_a_triangle_heats_the_wire_by_its_current_a_third_more_than_a_rectangle_of_its_charge(in_a_hole, altered):
    """The integral of i^2 is I^2 t/3 against (I/2)^2 t: measured with heat from the current alone."""
    only_current = {"base.cooling.wire_heat_share": 0.0, "base.cooling.convection_W_m2K": 1.0,
                    "wire.resistivity_per_K": 0.0, "material.removal_mm3_J": 1e-15,
                    "base.discharge.impulse_10mJ_Ns": 0.0}  # fmt: skip
    rises = []
    for choice in ({"pulse_shape": "triangle"}, {"peak_current_A": (100.0 - 22.0) / 11.8 / 2}):
        plant = in_a_hole(altered(load("iso-energetic", **choice), only_current), 8.0)
        windows = [plant.advance() for _ in range(40)]
        lit = sum(w.spark + w.arc for w in windows)
        assert lit > 5_000
        rises.append((plant.snapshot()["temperature_K"].mean() - 293.0) / lit)
    assert rises[0] / rises[1] == pytest.approx(4 / 3, rel=0.03)


def test_the_longest_wait_is_the_operator_s(in_a_hole):
    for wait_us in (20.0, 120.0):
        plant = in_a_hole(load("iso-energetic", ignition_wait_us=wait_us), 300.0)
        assert plant.advance().duration_ns == pytest.approx(255 * (wait_us + 70.0) * 1e3, abs=255 * 200)


def test_the_open_voltage_is_the_operator_s(in_a_hole):
    window = in_a_hole(load("iso-pulse", open_voltage_V=80.0), 300.0).advance()
    assert window.mean_voltage_V == pytest.approx(80.0 * 0.3, rel=0.01)


def test_a_faster_wire_is_cooler(drive):
    hottest = {}
    for speed in (0.03, 0.3):
        machine = load(wire_speed_m_s=speed)
        windows = drive(edmsim.Plant(machine, seed=2, resolution="fast"), 20.0, 4.0)
        hottest[speed] = np.mean([w.wire_temperature_K for w in windows[40:]])
    assert hottest[0.3] < hottest[0.03] - 0.5


# --- removal ---


@pytest.mark.parametrize(("on_us", "share"), [(1.4, 0.07**0.45), (5.0, 0.25**0.45), (20.0, 1.0), (100.0, 1.0)])
def test_short_pulses_remove_less_per_joule(on_us, share):
    machine = load(t_on_us=on_us, t_period_us=400.0)
    assert timing(machine).removal_um3_J == pytest.approx(9.3e6 * share)


def test_craters_follow_the_removal_of_their_length(in_a_hole):
    for on_us in (2.0, 20.0):
        machine = load("iso-energetic", t_on_us=on_us, t_period_us=on_us + 80.0)
        plant = in_a_hole(machine, 8.0, **{"material.removal_mm3_J": 9.3e-3})
        window = plant.advance()
        assert window.spark + window.arc > 100
        assert window.crater_um3 / window.energy_J == pytest.approx(timing(machine).removal_um3_J, rel=0.1)
