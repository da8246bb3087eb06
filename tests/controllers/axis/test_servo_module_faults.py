"""The servo module off and on again: trip, fault input and output, Q, R, its lamp, and what a reset keeps."""

from __future__ import annotations

import numpy as np
import pytest

from edmsim.axis_bench import AxisBench
from edmsim.controllers.axis import ServoModule
from edmsim.controllers.axis.drive import axis_row

from .module_bench import NO_TRIP, get, locked, on_bench, say, status, words
from .uhu_bench import stepped


def wired(**stored):
    bench = on_bench(**stored)
    bench.wire("x", fault_in=True, fault_out=True)
    return bench


def tripped(bench):
    locked(bench, 70)
    say(bench, "+10", run_s=0.01)
    return bench


def pull(bench):
    bench.pull_fault_net(True)
    bench.run(0.01)
    return bench


def stop(bench):
    say(bench, "Q", run_s=0.01)
    return bench


def test_a_low_reset_pin_stops_the_module_and_its_release_starts_it_anew():  # M-1, M-38, M-45, M-A5, M-A20
    bench = on_bench()
    pins = bench.pins("x")
    assert (pins.enabled, pins.fault_out_low, pins.duty) == (True, False, 0.5)
    say(bench, "P555")
    say(bench, "R")
    assert say(bench, "P") == "(P) - Kp: 555"  # the command R keeps it
    bench.reset_pin("x", low=True)
    bench.run(0.05)
    assert not bench.pins("x").enabled
    assert bench.talk(b"P\r") == b""
    bench.reset_pin("x", low=False)
    bench.run(0.05)
    assert bench.received("x") == b"Servo processor module, rev. A\r\n"
    assert bench.pins("x").enabled
    assert say(bench, "P") == "(P) - Kp: 600"


@pytest.mark.parametrize("wires", [("A", "B"), ("A",)])
def test_without_its_encoder_the_axis_trips_on_its_first_move(wires):  # M-1, M-43
    bench = on_bench()
    for wire in wires:
        bench.unplug("x", wire)
    stepped(bench, 200, 2000.0, run_s=0.3)
    assert {0, 1} <= status(bench)


def test_swapped_phases_run_away_to_the_trip_unless_the_law_turns_them():  # M-1
    for sense, tripped_ in ((1, True), (-1, False)):
        bench = AxisBench({"x": ServoModule(axis_row("table"), law={"encoder_sense": sense})})
        bench.swap_phases("x")
        bench.run(0.02)
        bench.received("x")
        say(bench, "+20", run_s=0.5)
        assert (1 in status(bench)) == tripped_


def test_a_trip_stops_the_loop_and_pulls_the_fault_output():  # M-43, M-18
    bench = tripped(wired())
    pins = bench.pins("x")
    assert (pins.enabled, pins.fault_out_low, bench.fault_net_low) == (False, True, True)
    assert status(bench) & {0, 1, 2} == {0, 1}
    bench.hold("x", False)
    before = words(bench, "GP")
    bench.torque("x", 0.05)
    bench.run(0.1)
    bench.hold("x", True)
    assert abs(words(bench, "GP") - before) > 10  # the encoder is still counted
    assert get(bench, "GE") == words(bench, "GT") - words(bench, "GP")


def test_a_low_fault_input_stops_the_loop_and_leaves_the_output():  # M-44, M-A15
    bench = pull(wired())
    bench.wire("x", fault_in=True, fault_out=True)
    assert not bench.pins("x").enabled
    assert not bench.pins("x").fault_out_low
    assert status(bench) & {0, 1, 2} == {0, 2}
    say(bench, "R")  # lasts a cycle under a low input
    bench.run(0.01)
    assert status(bench) & {0, 1, 2} == {0, 2}
    bench.pull_fault_net(False)
    bench.run(0.05)
    assert not bench.pins("x").enabled  # latched
    say(bench, "R", run_s=0.01)
    assert bench.pins("x").enabled


def test_quit_frees_the_motor_and_says_no_fault():  # M-23, M-41
    bench = stop(wired(output_offset=40))
    pins = bench.pins("x")
    assert (pins.enabled, pins.fault_out_low) == (False, False)
    assert status(bench) & {0, 1, 2} == {0}
    assert get(bench, "GD") == 1064
    bench.torque("x", 0.05)
    bench.run(0.1)
    bench.torque("x", 0.0)
    turned = words(bench, "GP")
    assert turned > 10
    bench.run(0.3)
    before = words(bench, "GP")
    say(bench, "O0")
    say(bench, "R", run_s=0.1)
    assert bench.pins("x").enabled
    assert abs(words(bench, "GP") - before) <= 2  # no jump: the motor's place is the setpoint
    assert abs(words(bench, "GT") - before) <= 1


def test_without_power_the_motor_freewheels():  # M-42
    run_out = {}
    for name in ("freewheel", "shorted"):
        bench = on_bench(proportional_gain=0, derivative_gain=0, velocity_feed_forward=2600, error_limit=NO_TRIP)
        stepped(bench, 20_000, 40_000.0, 200_000.0, run_s=0.3)
        if name == "freewheel":
            stop(bench)
        else:  # duty 50 % and enabled: the bridge shorts the winding
            say(bench, "V0")
        start = words(bench, "GP")
        bench.run(1.0)
        run_out[name] = abs(words(bench, "GP") - start)
    assert run_out["freewheel"] > 2 * run_out["shorted"]


def test_reset_clears_flags_and_peak_and_starts_from_where_the_motor_is():  # M-24, M-33, M-56
    bench = locked(on_bench(), 20, -50, 40)
    bench.run(0.01)
    assert say(bench, "?").split("\r\n")[-1] == "Peak Error: 30"  # the largest so far, either way
    bench = tripped(wired(proportional_gain=5000))
    assert {0, 1, 10} <= status(bench)
    assert say(bench, "?").split("\r\n")[-1] == "Peak Error: 80"
    say(bench, "R", run_s=0.01)
    assert status(bench) & {0, 1, 2, 10, 14, 15} == set()
    assert say(bench, "?").split("\r\n")[-1] == "Peak Error: 0"
    assert get(bench, "GE") == 0
    assert (bench.pins("x").enabled, bench.pins("x").fault_out_low, bench.fault_net_low) == (True, False, False)


@pytest.mark.parametrize("typed", ["+76", "-76"])
def test_a_move_beyond_the_limit_is_a_fault_at_once(typed):  # M-34
    bench = on_bench(error_limit=75, step_multiplier=9, error_scale=65535)
    assert say(bench, typed) == f"Move {typed}"
    assert {0, 1} <= status(bench)
    say(bench, "R")
    assert say(bench, "+75") == "Move +75"  # in counts of the encoder: the multiplier has no part in it
    assert words(bench, "GT") == words(bench, "GP") + get(bench, "GE")
    bench.run(0.3)
    assert status(bench) & {0} == set()


def test_a_move_while_off_is_answered_and_discarded_by_reset():  # M-A21
    bench = stop(on_bench())
    before = words(bench, "GP")
    assert say(bench, "+500") == "Move +500"
    bench.run(0.1)
    assert (words(bench, "GP"), words(bench, "GT")) == (before, before + 500)
    assert status(bench) & {0, 1, 2} == {0}
    say(bench, "R", run_s=0.1)
    assert (words(bench, "GP"), words(bench, "GT")) == (before, before)


def lamp(bench, seconds):
    """Times of the lamp's changes over some time, in tenths of a second, and the share that it was lit."""
    bench.changes("x")
    bench.run(seconds)
    rows = bench.changes("x")
    lit = (rows["pins"] & 8) != 0
    turns = np.flatnonzero(np.diff(lit)) + 1
    return np.round(np.diff(rows["time_ns"][turns]) * 1e-8).astype(int), lit[turns]


@pytest.mark.parametrize(("name", "flashes"), [("quit", 1), ("trip", 2), ("external", 3)])
def test_a_stopped_module_flashes_its_reason(name, flashes):  # M-3, M-A10
    bench = {"quit": stop, "trip": tripped, "external": pull}[name](wired())
    lengths, lit = lamp(bench, 8.0)
    lit_times = lengths[lit[:-1]]
    pauses = lengths[~lit[:-1]]
    assert set(lit_times) == {2}
    assert sorted(set(pauses)) == ([18] if flashes == 1 else [2, 20 - 4 * flashes + 2])
    assert len(lit_times) == pytest.approx(4 * flashes, abs=flashes)


def test_a_running_module_blinks_evenly_and_faster_in_recorder_mode():  # M-3, M-A10, M-A5, M-A23: pin 18
    bench = on_bench()
    assert set(lamp(bench, 4.0)[0]) == {5}
    say(bench, "Z0")
    lengths, _ = lamp(bench, 2.0)
    assert lengths.size >= 14
    assert set(lengths) == {1}


def test_no_watchdog_stops_a_module_whose_loop_stands():  # M-A22
    bench = on_bench()
    bench.changes("x")
    bench.stall("x", 0.5)
    bench.run(0.4)
    stepped(bench, 20, 1000.0, run_s=0.4)
    assert bench.pins("x").enabled
    assert status(bench) & {0, 1, 2} == set()
    assert words(bench, "GP") == pytest.approx(20, abs=1)


def test_a_fault_of_one_axis_stops_the_other():  # M-44, M-43
    drives = {name: ServoModule(axis_row("table")) for name in ("x", "y")}
    bench = AxisBench(drives)
    for name in drives:
        bench.wire(name, fault_in=True, fault_out=True)
    bench.run(0.02)
    bench.talk(b"+500\r", axis="x")
    bench.run(0.01)
    assert not bench.pins("y").enabled
    assert bench.talk(b"GS\r", axis="y") == b"Status: 0000000000000101\r\n"
    assert not bench.pins("y").fault_out_low  # else neither would ever come back
    for name in drives:
        bench.talk(b"R\r", axis=name)
    bench.run(0.01)
    assert bench.pins("x").enabled
    assert bench.pins("y").enabled
