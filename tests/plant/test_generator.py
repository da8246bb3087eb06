"""The pulse generator: settings it refuses, and what its three modes do in the gap."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import edmsim
from edmsim.machine.setting import discharge_current_A, mean_current_A
from edmsim.plant.gap.generator import timing


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


def test_iso_pulse_burns_what_the_delay_leaves(machine, drive):  # T-3: t(e) = t(i) - t(d)
    windows = drive(edmsim.Plant(machine, seed=2, resolution="fast"), 25.0, 3.0)
    power = 22.0 * discharge_current_A(machine)
    lit = [w for w in windows if w.spark + w.arc]
    assert len(lit) > 20
    for w in lit:
        n = w.spark + w.arc
        assert w.energy_J == pytest.approx(power * n * (30.0 - w.mean_delay_us) * 1e-6, rel=1e-9)
        assert w.energy_J <= power * n * 30e-6
        assert w.duration_ns == 255 * 100_000


def test_iso_energetic_sparks_are_all_alike_and_its_period_varies(drive):  # T-5
    machine = load("iso-energetic")
    plant = edmsim.Plant(machine, seed=2, resolution="fast")
    windows = drive(plant, 25.0, 3.0)
    energy = 22.0 * discharge_current_A(machine) * 20e-6
    for w in windows:
        lit = w.spark + w.arc
        assert w.energy_J == pytest.approx(energy * lit, rel=1e-9)
        delays_us = w.mean_delay_us * lit if lit else 0.0
        # t(d) + t(e) + pause; an unlit pulse waits 60 us and pauses, a short lasts t(e)
        expected_us = 90.0 * (lit + w.short) + delays_us + 130.0 * w.open
        assert w.duration_ns * 1e-3 == pytest.approx(expected_us, abs=255 * 0.08)
        assert w.duration_ns <= plant.longest_window_ns
    assert plant.window_ns == 0
    assert plant.time_ns == sum(w.duration_ns for w in windows)
    assert len({w.duration_ns for w in windows}) > len(windows) // 2


def test_an_ignition_pulse_nearly_always_ignites(in_a_hole):  # T-5
    gap = 20.0
    iso = in_a_hole(load("iso-pulse", t_on_us=20.0), gap)
    ignition = in_a_hole(load("ignition-pulse", t_on_us=20.0), gap)
    unlit = [np.mean([p.advance().open for _ in range(10)]) / 255 for p in (iso, ignition)]
    assert unlit[0] > 0.4
    assert unlit[1] < 0.02


def test_ignition_pulses_burn_for_the_whole_on_time(drive):  # T-5
    machine = load("ignition-pulse")
    windows = drive(edmsim.Plant(machine, seed=2, resolution="fast"), 20.0, 2.0)
    energy = 22.0 * discharge_current_A(machine) * 20e-6
    assert sum(w.spark for w in windows) > 1000
    for w in windows:
        assert w.energy_J == pytest.approx(energy * (w.spark + w.arc), rel=1e-9)
        assert w.duration_ns == 255 * 100_000


@pytest.mark.parametrize(("on", "period"), [(30.0, 100.0), (30.0, 400.0), (200.0, 1000.0)])
def test_the_mean_voltage_is_to_be_divided_by_the_relative_pulse_duration(on, period, in_a_hole, machine):  # T-6, T-7
    """An open gap and a sparking one show the same voltages at every duty, once rescaled with it."""
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


def test_a_snapshot_remembers_that_the_generator_is_off(machine):
    plant = edmsim.Plant(machine, seed=1, resolution="fast")
    plant.switch_generator(False)
    state = plant.snapshot()
    plant.switch_generator(True)
    plant.restore(state)
    assert not plant.generator_on
    assert plant.advance().mean_voltage_V < 0.01


# --- triangular pulses and the operator's choices in the loop ---


def test_a_triangle_has_the_charge_and_energy_of_half_its_peak(drive):
    machine = load("iso-energetic", pulse_shape="triangle")
    peak_A = (100.0 - 22.0) / 11.8
    windows = drive(edmsim.Plant(machine, seed=2, resolution="fast"), 15.0, 2.0)
    assert sum(w.spark for w in windows) > 1000
    for w in windows:
        lit = w.spark + w.arc
        assert w.energy_J == pytest.approx(22.0 * peak_A / 2 * 20e-6 * lit, rel=1e-9)
        charge = peak_A / 2 * 20e-6 * lit + 100.0 / 11.8 / 2 * 20e-6 * w.short
        assert w.mean_current_A * w.duration_ns * 1e-9 == pytest.approx(charge, rel=1e-9)


def test_a_triangle_heats_the_wire_by_its_current_a_third_more_than_a_rectangle_of_its_charge(in_a_hole, altered):
    """The integral of i^2 is I^2 t/3 against (I/2)^2 t: seen where nothing but the current heats."""
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
