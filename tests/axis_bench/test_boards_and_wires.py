"""What the bench's boards do: step pulses, fault net, time to compute, watchdog, reset, serial line; and how fast."""

import copy
import pickle
import time

import numpy as np
import pytest

from edmsim.axis_bench import AxisBench
from edmsim.compiled.axis_rows import FAULT, FAULT_OUT, FREEWHEEL
from edmsim.controllers import axis as axes
from edmsim.controllers.axis.drive import axis_row
from edmsim.errors import InputError

from .puppet import BUSY, CALLS, DELAY, STREAMS, Puppet, bench_of, command, put_out


def test_a_step_source_sends_exact_counts():
    bench = AxisBench({"x": axes.make("servo"), "y": axes.make("servo")})
    bench.steps("x", 100_003, 1.5e6, 1e8)
    bench.steps("x", -3, 10.0)
    bench.steps("y", -50)
    bench.run(0.09)
    assert bench.drive("x").record["setpoint"] == 100_003
    bench.run(1.0)
    assert bench.drive("x").record["setpoint"] == 100_000
    assert bench.drive("y").record["setpoint"] == -50


def test_open_step_and_direction_inputs_read_high():  # U-43
    bench = bench_of()
    bench.unplug("x", "step")
    bench.steps("x", 10)
    bench.run(0.01)
    assert bench.drive("x").record["setpoint"] == 0
    bench.unplug("x", "step", plugged=True)
    bench.unplug("x", "dir")
    bench.steps("x", -10)
    bench.run(0.01)
    assert bench.drive("x").record["setpoint"] == 10


def test_a_fault_stops_the_other_drive_through_the_net_and_not_without_its_diode():  # U-42
    for diode in (True, False):
        bench = AxisBench({"x": Puppet(), "y": Puppet()})
        bench.wire("x", fault_out=diode)
        bench.run(0.005)
        assert bench.pins("y").enabled
        put_out(bench, FAULT | FREEWHEEL | FAULT_OUT, "x", run_s=0.002)
        assert bench.pins("x").fault_out_low
        assert bench.fault_net_low == diode
        assert bench.pins("y").enabled != diode
        assert bench.pins("y").fault_in_low == diode


def test_the_fault_net_can_be_pulled_by_hand_and_an_open_input_reads_high():  # U-42, U-43
    bench = AxisBench({"x": Puppet(), "y": Puppet()})
    bench.unplug("y", "fault")
    bench.pull_fault_net(True)
    bench.run(0.002)
    assert bench.fault_net_low
    assert (bench.pins("x").enabled, bench.pins("y").enabled) == (False, True)
    bench.pull_fault_net(False)
    bench.run(0.002)
    assert bench.pins("x").enabled


def test_outputs_take_effect_after_the_time_to_compute_and_the_duty_at_a_pulse_of_the_bridge():
    bench = bench_of()
    bench.drive("x").record["pwm_ns"] = 70_000
    bench.run(0.002)
    bench.changes("x")
    bench.drive("x").record["reg"][0, DELAY] = 300_000
    put_out(bench, FREEWHEEL)
    command(bench, 0.5, run_s=0.000305)
    assert bench.changes("x").tolist() == [(0, 2_300_000, FREEWHEEL)]
    assert bench.pins("x").duty == 0.5
    bench.run(0.00001)
    assert bench.pins("x").duty == 0.75


def test_a_sample_that_takes_longer_than_the_period_puts_off_the_next():
    bench = bench_of()
    bench.trace = True
    bench.drive("x").record["reg"][0, BUSY] = 620_000
    bench.run(0.01)
    assert set(np.diff(bench.samples("x")["time_ns"])) == {620_000}


def test_a_dip_of_the_logic_supply_resets_the_drive_and_lets_the_motor_freewheel():
    bench = bench_of()
    bench.run(0.01)
    assert bench.received("x") == b"on"
    bench.rail("x", 4.6)
    assert bench.pins("x").enabled
    bench.rail("x", 4.4)
    assert not bench.pins("x").enabled
    calls = int(bench.drive("x").record["reg"][0, CALLS])
    bench.send(b"lost")
    bench.run(0.1)
    assert bench.drive("x").record["reg"][0, CALLS] == calls
    bench.rail("x", 5.0)
    bench.run(0.01)
    assert bench.received("x") == b"on"
    assert bench.pins("x").enabled


def test_a_byte_takes_ten_bits_each_way_and_another_baud_is_garbage():
    bench = bench_of()
    bench.run(0.1)
    bench.received("x")
    began = bench.time_s
    bench.send(b"abc")
    bench.run(0.02)
    heard = bench.received_at("x")
    assert bytes(byte for byte, _ in heard) == b"ABC"
    bits_s = 1 / 38400.0
    assert [at - began for _, at in heard] == pytest.approx([(20 + 10 * k) * bits_s for k in range(3)], rel=1e-3)
    bench.host_baud(57600.0)
    assert bench.talk(b"abc\r") != b"ABC\r"
    assert bench.drive("x").errors > 0
    bench.host_baud(38461.5)
    assert bench.talk(b"abc\r") == b"ABC\r"


def test_what_is_sent_to_a_closed_terminal_is_lost():
    bench = bench_of()
    bench.run(0.01)
    bench.open_terminal(False)
    assert b"ABC" not in bench.talk(b"abc")
    bench.open_terminal(True)
    assert bench.talk(b"abc") == b"ABC"


def test_a_stream_from_the_sample_reaches_the_terminal():
    bench = bench_of()
    bench.run(0.01)
    bench.received("x")
    bench.drive("x").record["reg"][0, STREAMS] = 1
    bench.run(0.5)
    assert bench.received("x") == bytes([191]) * 200


@pytest.mark.parametrize("mechanics", ["modal", pytest.param("mujoco", marks=pytest.mark.slow)])
def test_the_same_again_from_a_snapshot_or_copy_to_the_bit(mechanics):
    drives = {"x": axes.tuned("servo-module"), "v": axes.tuned("uhu")}
    bench = AxisBench(drives, mechanics=mechanics)
    bench.unplug("v", "step")
    for axis in "xv":
        bench.steps(axis, 50, 400.0, 50_000.0)
    bench.run(0.05)
    state, ends = bench.snapshot(), []
    copies = copy.deepcopy(bench), pickle.loads(pickle.dumps(bench))
    for again in (bench, bench, AxisBench(drives, mechanics=mechanics), *copies):
        if again not in copies:
            again.restore(state)
        again.trace = True
        again.run(0.1)
        rows = [row.tobytes() for name in "xv" for row in (again.axis(name), again.drive(name).record)]
        ends.append((again.samples("x").tobytes(), rows))
    assert all(end == ends[0] for end in ends)
    copies[0].send(b"?")
    assert (copies[0].sending(), bench.sending()) == (True, False)


def test_a_snapshot_of_other_drives_is_refused():
    bench = bench_of()
    for other in ({}, AxisBench({"y": axes.make("uhu")}).snapshot()):
        with pytest.raises(InputError, match="not a snapshot of a bench with the drives"):
            bench.restore(other)


@pytest.mark.parametrize(("wrong", "reason"), [
    (lambda: AxisBench({"x": axes.make("stepper")}), "a motor and a sample"),
    (lambda: AxisBench({"x": axes.tuned("uhu")}, mechanics="full"), "no mechanics 'full'"),
    (lambda: axis_row("bench", lines=500), "missing or unknown: lines"),
    (lambda: bench_of(table_kg=0.0), "table_kg is 0"),
    (lambda: bench_of().unplug("x", "Z"), "no wire 'Z'"), (lambda: bench_of().run(-1.0), "number of 0 or more"),
    (lambda: bench_of().hold("q", True), "no axis 'q' on this bench; there are: x"),
    (lambda: bench_of().steps("y", 5), "no axis 'y' on this bench"),
    (lambda: bench_of().pulse_encoder("x", "C", 1e-5), "no phases 'C'"),
    (lambda: bench_of().flip_bits("x", [0, 4096]), "beyond the EEPROM"),
    (lambda: bench_of().step_times("x", [0], 2), "direction is 2"),
])  # fmt: skip
def test_wrong_drives_mechanics_and_wires_are_refused(wrong, reason):
    with pytest.raises(InputError, match=reason):
        wrong()


@pytest.mark.parametrize(("mechanics", "times"), [("modal", 20.0), ("mujoco", 10.0)])
def test_an_axis_runs_at_many_times_real_time(mechanics, times):
    bench = AxisBench({"x": axes.tuned("uhu")}, mechanics=mechanics)
    bench.steps("x", 5_000, 1_000.0, 10_000.0)
    bench.run(0.05)
    began = time.process_time()
    bench.run(2.0)
    assert 2.0 / (time.process_time() - began) > times
