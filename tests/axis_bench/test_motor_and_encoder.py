"""What the bench's axes do: motor, supply, bridge, friction, backlash, encoder, and spikes on its wires."""

import math

import numpy as np
import pytest

import edmsim
from edmsim.axis_bench import AxisBench
from edmsim.compiled.axis_rows import BRIDGE_DAMAGED, FREEWHEEL, WINDING_DAMAGED
from edmsim.controllers.axis import ServoModule, Uhu, tuned
from edmsim.controllers.axis.drive import axis_names, axis_row
from edmsim.controllers.axis.uhu import O as OVERRUNS

from .puppet import Puppet, bench_of, command, put_out


def test_a_motor_runs_up_to_its_no_load_speed_with_its_time_constant():
    bench = bench_of(
        friction_Nm=0.0, stiction_Nm=0.0, way_friction_N=0.0, way_stiction_N=0.0, damping_Nm_s=0.0, way_N_s_m=0.0,
        table_kg=1e-3, screw_N_s_m=0.0, supply_ohm=1e-3, link_F=10.0,
    )
    motor = bench.motor("x")
    command(bench, 0.5)
    bench.run(0.0005 + 0.009)  # the first sample comes after 0.5 ms
    last = 0.5 * motor["supply_V"] / motor["torque_Nm_A"]
    per_s2 = motor["inertia_kg_m2"] * motor["inductance_H"]
    poles = np.roots([per_s2, motor["inertia_kg_m2"] * motor["resistance_ohm"], motor["torque_Nm_A"] ** 2])
    fast, slow = poles
    reached = (1 - (fast * np.exp(slow * 0.009) - slow * np.exp(fast * 0.009)) / (fast - slow)).real
    assert bench.axis("x")["speed_rad_s"] == pytest.approx(last * reached, rel=0.01)
    bench.run(0.2)
    assert bench.axis("x")["speed_rad_s"] == pytest.approx(last, rel=1e-3)
    assert bench.axis("x")["current_A"] == pytest.approx(0.0, abs=0.01)


def run_out_s(how):
    bench = bench_of()
    command(bench, 0.5, run_s=0.3)
    if how == "freewheel":
        put_out(bench, FREEWHEEL, run_s=0.005)
        assert (bench.axis("x")["current_A"], bench.axis("x")["speed_rad_s"] > 10.0) == (0.0, True)
    command(bench, 0.0)
    began = bench.time_s
    while abs(bench.axis("x")["speed_rad_s"]) > 10.0:
        bench.run(0.001)
    return bench.time_s - began


def test_a_bridge_that_is_off_lets_the_motor_run_out_and_one_at_half_duty_brakes_it():
    assert run_out_s("freewheel") > 2.0 * run_out_s("short")


def test_a_supply_sags_under_load_and_gives_no_more_than_its_limit():
    stiff = bench_of(supply_ohm=1e-3)
    stiff.hold("x", True)
    command(stiff, 0.4, run_s=0.05)
    assert stiff.axis("x")["current_A"] == pytest.approx(0.4 * 30.0 / 0.5, rel=1e-3)  # by its resistance
    assert stiff.axis("x")["speed_rad_s"] == 0.0
    bench = bench_of(supply_ohm=0.5, supply_A=5.0)
    bench.hold("x", True)
    command(bench, 0.3, run_s=0.1)
    drawn_A = 0.3 * bench.axis("x")["current_A"]
    assert bench.axis("x")["link_V"] == pytest.approx(30.0 - 0.5 * drawn_A, rel=0.01)
    command(bench, 0.9, run_s=0.2)
    assert 0.9 * bench.axis("x")["current_A"] == pytest.approx(5.0, rel=0.01)
    bench.supply("x", 0.0)
    bench.run(0.5)
    assert bench.axis("x")["link_V"] < 0.1


def test_too_much_current_and_heat_are_reported_as_damage():
    bench = AxisBench({"x": Puppet(axis_row("low-impedance"))})
    bench.hold("x", True)
    command(bench, 0.1, run_s=0.1)
    assert bench.axis("x")["damage"] == 0
    command(bench, 0.74, run_s=0.1)
    assert bench.axis("x")["damage"] & BRIDGE_DAMAGED
    warm = bench_of(winding_J_K=1.0)
    warm.hold("x", True)
    command(warm, 0.5, run_s=2.0)
    assert warm.axis("x")["damage"] & WINDING_DAMAGED


def test_a_rotor_sticks_until_the_torque_breaks_it_away():
    bench = bench_of(way_friction_N=0.0, way_stiction_N=0.0)
    bench.torque("x", 0.029)
    bench.run(0.1)
    assert bench.axis("x")["rotor_um"] == 0.0
    bench.torque("x", 0.031)
    bench.run(0.1)
    assert bench.axis("x")["rotor_um"] > 1.0


def test_backlash_is_lost_at_a_reversal():
    bench = bench_of(backlash_um=100.0)
    for torque in (0.3, -0.3):
        bench.torque("x", torque)
        bench.run(1.0)
        row = bench.axis("x")
        pulls_N = 20.0 + 200.0 * abs(row["speed_um_s"]) * 1e-6
        assert (row["rotor_um"] - row["place_um"]) * np.sign(torque) == pytest.approx(50.0 + pulls_N / 8.5, abs=0.5)


def test_a_hanging_load_pulls_an_axis_down():
    bench = bench_of(load_N=-400.0)
    put_out(bench, FREEWHEEL, run_s=0.3)
    assert bench.axis("x")["place_um"] < -1000.0


def test_rotor_and_table_oscillate_at_the_frequency_of_the_coupling():
    bench = bench_of(
        friction_Nm=0.0, stiction_Nm=0.0, way_friction_N=0.0, way_stiction_N=0.0, damping_Nm_s=0.0, way_N_s_m=0.0,
        screw_N_s_m=50.0,
    )
    put_out(bench, FREEWHEEL)
    bench.trace = True
    bench.force("x", 100.0)
    bench.run(0.002)
    bench.force("x", 0.0)
    bench.run(0.5)
    rows = bench.samples("x")
    twist = rows["rotor_um"] - rows["place_um"]
    spectrum = np.abs(np.fft.rfft(twist - twist.mean(), 1 << 14))
    frequency = np.fft.rfftfreq(1 << 14, 500e-6)[spectrum.argmax()]
    motor = bench.motor("x")
    load = motor["table_kg"] * (motor["um_per_rad"] * 1e-6) ** 2
    spring = motor["screw_N_m"] * (motor["um_per_rad"] * 1e-6) ** 2
    expected = math.sqrt(spring * (1 / load + 1 / motor["inertia_kg_m2"])) / (2 * math.pi)
    assert frequency == pytest.approx(expected, rel=0.03)
    assert 60.0 < expected < 120.0


def turn_to(bench, turns_um, torque=0.5):
    """Turn the shaft by hand past a travel and let it come to rest."""
    bench.torque("x", math.copysign(torque, turns_um))
    while abs(bench.axis("x")["rotor_um"]) < abs(turns_um):
        bench.run(0.001)
    bench.torque("x", 0.0)
    bench.run(0.3)


def test_the_encoder_counts_four_to_a_line_both_ways():
    bench = bench_of()
    put_out(bench, FREEWHEEL)
    for way in (10_000.0, -10_000.0):
        turn_to(bench, way)
        row = bench.axis("x")
        assert row["count"] == math.floor(row["rotor_um"] / 10.0 + 0.5)
    assert row["illegal"] == row["missed"] == 0


@pytest.mark.parametrize("error", [0.4, -0.4])
def test_uneven_phases_shift_every_other_edge(error):
    counts = {}
    for phase_error in (0.0, error):
        bench = bench_of(phase_error=phase_error)
        put_out(bench, FREEWHEEL)
        bench.trace = True
        turn_to(bench, 500.0, 0.15)
        rows = bench.samples("x")
        counts[phase_error] = rows["count"] - rows["rotor_um"] / 10.0
        assert bench.axis("x")["illegal"] == 0
    assert np.abs(counts[0.0]).max() <= 0.5 + 1e-9
    assert 0.5 < np.abs(counts[error]).max() <= 0.5 + abs(error) + 1e-9


def test_a_missing_phase_leaves_the_count_standing_and_a_swapped_one_turns_it_round():
    bench = bench_of()
    put_out(bench, FREEWHEEL)
    bench.unplug("x", "A")
    turn_to(bench, 5_000.0)
    assert abs(bench.axis("x")["count"]) <= 2
    other = bench_of()
    put_out(other, FREEWHEEL)
    other.swap_phases("x")
    turn_to(other, 5_000.0)
    assert other.axis("x")["count"] == -other.axis("x")["true_count"] < -400


def test_both_phases_at_once_are_illegal_and_move_no_count():
    bench = bench_of()
    bench.slip_encoder("x", 2)
    assert (bench.axis("x")["illegal"], bench.axis("x")["count"]) == (1, 0)
    bench.slip_encoder("x", 1)
    assert (bench.axis("x")["illegal"], bench.axis("x")["count"]) == (1, 1)


@pytest.mark.parametrize(("width_s", "edges"), [(1e-6, 0), (1e-5, 2)])
def test_a_pulse_shorter_than_the_input_needs_is_missed(width_s, edges):
    bench = bench_of()
    bench.drive("x").record["count_rate_Hz"] = 250e3
    bench.pulse_encoder("x", "A", width_s)
    assert bench.axis("x")["edges"] == edges
    assert bench.axis("x")["count"] == 0


@pytest.mark.parametrize(("rate_Hz", "keeps"), [(250e3, False), (4e6, True)])
def test_edges_faster_than_the_input_are_overruns(rate_Hz, keeps):
    bench = AxisBench({"x": Puppet(axis_row("fast"))})
    bench.drive("x").record["count_rate_Hz"] = rate_Hz
    command(bench, 0.7, run_s=0.5)
    row = bench.axis("x")
    assert row["speed_rad_s"] * bench.motor("x")["counts_per_rad"] > 1e6
    assert (row["illegal"] == 0, row["missed"] == 0) == (keeps, keeps)


NOISE = {"spike_rate_Hz": 500.0, "spike_s": 20e-6}


def noisy(drive, seed=0, **changes):
    """A bench with a drive whose encoder has spikes."""
    for name, value in {**NOISE, **changes}.items():
        drive.motor[name] = value
    return AxisBench({"x": drive}, seed=seed)


def history(bench, seconds=0.1):
    bench.trace = True
    bench.run(seconds)
    return bench.samples("x").tobytes(), bench.axis("x").tobytes()


def test_no_axis_of_the_files_has_spikes():
    for name in axis_names():
        bench = AxisBench({"x": Puppet(axis_row(name))})
        bench.run(0.2)
        assert bench.axis("x")["noise_draws"] == bench.axis("x")["edges"] == 0


def test_the_same_seed_gives_the_same_spikes_to_the_bit_and_another_one_others():
    first, again, other = (history(noisy(tuned("uhu"), seed)) for seed in (3, 3, 4))
    assert first == again
    assert first != other


def test_a_snapshot_amid_a_spike_continues_bit_for_bit():
    bench = noisy(Puppet(axis_row("bench")), spike_s=1e-3)
    while bench.axis("x")["disturbed"] == 0:
        bench.run(1e-4)
    state = bench.snapshot()
    first = history(bench)
    bench.restore(state)
    assert history(bench) == first


def test_spikes_come_at_their_rate_and_those_the_input_is_too_slow_for_are_missed():
    """Of spikes of a mean length w the share exp(-1 / (rate w)) is longer than 1 / rate; two of three move counts."""
    for rate_Hz, passes in ((1e6, math.exp(-0.05)), (50e3, math.exp(-1.0))):
        bench = noisy(Puppet(axis_row("bench")))
        bench.drive("x").record["count_rate_Hz"] = rate_Hz
        put_out(bench, FREEWHEEL, run_s=10.0)
        row = bench.axis("x")
        assert row["edges"] / 2 + row["illegal"] / 2 == pytest.approx(5_000 * passes, rel=0.06)
        assert row["illegal"] / row["edges"] == pytest.approx(0.5, rel=0.1)
        assert abs(row["count"]) <= 1  # a spike that is on now is all that can be left


def test_spikes_on_a_moving_axis_cost_counts_where_an_edge_falls_into_them():
    bench = noisy(Puppet(axis_row("bench")), spike_rate_Hz=3e3)
    bench.drive("x").record["real"][0, 0] = 0.5
    bench.run(1.0)
    row = bench.axis("x")
    assert row["true_count"] > 5_000
    assert abs(row["true_count"] - row["count"]) > 4


def test_the_uhu_counts_spikes_on_both_wires_as_overruns_and_stays_where_it_is():  # U-24, U-50
    bench = noisy(Uhu(axis_row("bench"), stored={}))
    bench.run(1.0)
    assert bench.drive("x").record["reg"][0, OVERRUNS] > 100
    assert bench.pins("x").enabled
    assert abs(bench.axis("x")["true_count"]) <= 2


def test_the_module_s_filter_keeps_spikes_out():  # M-29
    edges = {}
    for divider in (0, 6):
        bench = noisy(ServoModule(axis_row("table"), {"encoder_filter": divider}), spike_s=10e-6)
        bench.run(1.0)
        edges[divider] = int(bench.axis("x")["edges"] + bench.axis("x")["illegal"])
    assert edges[0] > 500
    assert edges[6] < 0.05 * edges[0]


@pytest.mark.parametrize("mechanics", ["modal", "mujoco"])
def test_a_plant_s_seed_draws_the_spikes_of_its_axes(mechanics):
    def counts(seed):
        drive = tuned("uhu")
        drive.motor["spike_rate_Hz"], drive.motor["spike_s"] = 2e3, 20e-6
        plant = edmsim.Plant(edmsim.Machine.load(), seed, resolution="fast", mechanics=mechanics, drives={"x": drive})
        plant.switch_generator(False)
        plant.advance()
        row = plant.snapshot()["axes"][0]
        return tuple(int(row[name]) for name in ("noise_draws", "edges", "illegal"))

    assert counts(1) == counts(1) != counts(2)
    assert np.all(np.array(counts(1)) > 5)
