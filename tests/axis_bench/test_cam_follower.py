"""Axes on the bench follow cam tables: interpolation, repetition, gain, master sources, rows; curves and ramps."""

import math

import numpy as np
import pytest

from edmsim.controllers.axis.elcam.mcu_g3 import CYCLE_S, ControlAxis
from edmsim.controllers.axis.elcam.module import CallStatus
from edmsim.controllers.axis.elcam.table import Error, Function, Mode
from edmsim.errors import InputError

from .cam_bench import (
    COUNTS,
    HAT,
    STAIR,
    U,
    X,
    Y,
    enter,
    go,
    jumps,
    read,
    rig_of,
    run,
    settle,
    stop,
    table,
    watch,
    write,
)


def place_mm(rig, axis):
    return rig.count("xyuv"[axis]) / COUNTS


def start(rig, index, points=HAT, at=0.0, **values):
    """Put the master somewhere, run a table, and let its follower rest."""
    go(rig, X, at)
    table(rig, index, points, **values)
    assert run(rig, index) is CallStatus.OK
    settle(rig)


@pytest.mark.parametrize(
    ("values", "place"), [({}, 2.5), ({"gain": 2.0}, 5.0), ({"shift": 1.0}, 3.5), ({"phase": 5.0}, 0.0),
                          ({"gain": 2.0, "shift": 1.0}, 6.0), ({"phase": -1000.0}, 2.5)],
)  # fmt: skip
def test_the_follower_is_between_the_points(values, place):
    # E-20, E-7, E-A8
    rig = rig_of()
    start(rig, 0, at=5.0, **values)
    assert rig.control.axes[Y].setpoint == pytest.approx(place)
    assert place_mm(rig, Y) == pytest.approx(place, abs=0.002)


@pytest.mark.parametrize(
    ("points", "master", "place"),
    [(HAT, 25.0, 2.5), (HAT, -5.0, 2.5), (HAT, -15.0, 2.5), (HAT, 40.0, 0.0), ((*HAT, (1000.0, 0.0)), 25.0, 0.0),
     ([(x - 4.0, y) for x, y in HAT], 20.0, 2.0)],
)  # fmt: skip
def test_a_table_repeats_both_ways_unless_a_point_lies_beyond_the_travel(points, master, place):
    # E-21, E-37
    rig = rig_of()
    start(rig, 0, points)
    go(rig, X, master, 100.0)
    assert place_mm(rig, Y) == pytest.approx(place, abs=0.002)


@pytest.mark.slow
def test_each_pass_adds_what_the_ends_differ_by():
    # E-22, E-38
    rig = rig_of()
    start(rig, 0, STAIR)
    for master, place in ((5.0, 2.0), (15.0, 7.0), (25.0, 12.0), (45.0, 22.0), (-5.0, -3.0)):
        go(rig, X, master, 200.0)
        assert place_mm(rig, Y) == pytest.approx(place, abs=0.002), master


@pytest.mark.slow
def test_a_new_gain_acts_from_the_place_on_where_passes_add_up():
    # E-22, E-38
    rig = rig_of()
    start(rig, 0, STAIR, at=25.0)
    watch(rig)
    write(rig, 0, gain=2.0)
    settle(rig)
    assert jumps(rig.traces(), Y) == 0.0
    for master, place in ((30.0, 16.0), (40.0, 28.0)):
        go(rig, X, master)
        assert rig.control.axes[Y].setpoint == pytest.approx(place)


def test_a_new_gain_and_a_new_shift_act_at_once_where_both_ends_are_equal():
    # E-38
    rig = rig_of()
    start(rig, 0, at=5.0)
    watch(rig)
    write(rig, 0, gain=2.0)
    settle(rig)
    assert jumps(rig.traces(), Y) == pytest.approx(2.5)
    assert place_mm(rig, Y) == pytest.approx(5.0, abs=0.002)
    write(rig, 0, shift=1.0)
    settle(rig)
    assert place_mm(rig, Y) == pytest.approx(6.0, abs=0.002)


@pytest.mark.parametrize("end", ["run", "reset"])
def test_a_follower_in_motion_keeps_its_speed_until_it_is_stopped(end):
    # E-24, E-39, E-4
    rig = rig_of()
    start(rig, 0)
    rig.control.move_velocity(X, 20.0)
    rig.run(0.2)
    if end == "run":
        stop(rig, 0)
    else:
        write(rig, 0, reset=1)
        assert (read(rig, 0, Function.SIZE_MASTER), read(rig, 0, Function.BUFFER_SIZE)) == (0, 0)
    rig.control.halt(X)
    rig.run(0.1)
    at = place_mm(rig, Y)
    rig.run(0.2)
    assert place_mm(rig, Y) - at == pytest.approx(0.2 * 10.0, abs=0.02)  # half the master's speed
    rig.control.halt(Y)
    rig.run(0.1)
    at = place_mm(rig, Y)
    rig.run(0.2)
    assert place_mm(rig, Y) == pytest.approx(at, abs=0.002)


def test_a_follower_takes_no_travel_commands():
    # E-26
    rig = rig_of()
    start(rig, 0)
    assert not rig.control.move_absolute(Y, 3.0, 10.0)
    assert not rig.control.halt(Y)
    settle(rig)
    assert place_mm(rig, Y) == pytest.approx(0.0, abs=0.002)
    stop(rig, 0)
    go(rig, Y, 3.0)
    assert place_mm(rig, Y) == pytest.approx(3.0, abs=0.002)


def test_the_start_is_approached_by_the_computed_position():
    # E-12, E-44, E-28
    rig = rig_of()
    go(rig, X, 5.0)
    table(rig, 0, HAT)
    assert read(rig, 0, Function.ERROR) == 0
    unprepared = rig_of()
    go(unprepared, X, 5.0)
    table(unprepared, 0, HAT)
    watch(unprepared)
    run(unprepared, 0)
    settle(unprepared)
    assert jumps(unprepared.traces(), Y) == pytest.approx(2.5)  # without the approach, by the difference
    go(rig, Y, read(rig, 0, Function.TARGET_POSITION))
    watch(rig)
    run(rig, 0)
    settle(rig)
    assert jumps(rig.traces(), Y) == 0.0
    answer = rig.control.elcam.at(0).read_double(Function.TARGET_POSITION)
    assert answer.status is CallStatus.BUSY == 2
    go(rig, X, 15.0)
    assert place_mm(rig, Y) == pytest.approx(2.5, abs=0.002)


def test_the_master_is_its_setpoint_or_its_actual_value():
    # E-23, E-17
    rig = rig_of()
    rig.bench.hold("x", True)  # setpoint and actual value part
    table(rig, 0, HAT)
    run(rig, 0)
    rig.control.move_absolute(X, 5.0, 20.0)
    rig.run(0.5)
    assert rig.control.axes[Y].setpoint == pytest.approx(2.5)
    run(rig, 0, Mode.ACTUAL)
    rig.run(0.01)
    assert rig.control.axes[Y].setpoint == pytest.approx(0.0, abs=0.002)


@pytest.mark.parametrize(
    ("bits", "use", "reads"),
    [(Mode.ACTUAL | Mode.AUXILIARY, True, True), (Mode.ACTUAL | Mode.AUXILIARY, False, False),
     (Mode.ACTUAL, True, False), (Mode.AUXILIARY, True, False)],
)  # fmt: skip
def test_a_stepper_master_is_read_by_its_own_encoder(bits, use, reads):
    # E-40, E-17, E-23
    rig = rig_of("xy", steppers="x")
    master = rig.control.axes[X]
    master.use_encoder, master.auxiliary_factor = use, 5000.0  # ten counts to a step of 2 um
    table(rig, 0, ((0.0, 0.0), (4.0, 4.0), (8.0, 0.0)), mode=bits)
    run(rig, 0)
    go(rig, X, 1.0, 1.0)
    assert rig.control.axes[Y].setpoint == pytest.approx(1.0, abs=0.002)
    master.auxiliary_factor = 2500.0
    rig.run(0.002)
    assert rig.control.axes[Y].setpoint == pytest.approx(2.0 if reads else 1.0, abs=0.004)


def test_the_encoder_of_a_stepper_sees_the_steps_it_lost():
    # E-40, E-23
    rig = rig_of("xy", steppers="x")
    rig.control.axes[X].use_encoder, rig.control.axes[X].auxiliary_factor = True, 5000.0
    table(rig, 0, HAT, mode=Mode.ACTUAL | Mode.AUXILIARY)
    run(rig, 0)
    rig.bench.hold("x", True)
    rig.control.move_absolute(X, 0.2, 1.0)
    rig.run(0.5)
    assert rig.control.axes[X].actual == pytest.approx(0.2)  # it counts its own steps
    assert rig.control.axes[Y].setpoint == pytest.approx(0.0, abs=0.001)


def test_tables_move_their_own_followers_only():
    # E-35, E-6
    rig = rig_of("xyuv")
    table(rig, 0, HAT, axis=Y, master=X)
    table(rig, 7, STAIR, axis=3, master=U)
    assert run(rig, 0) is run(rig, 7) is CallStatus.OK
    go(rig, X, 5.0)
    assert [place_mm(rig, k) for k in (Y, 3)] == pytest.approx([2.5, 0.0], abs=0.002)
    go(rig, U, 10.0)
    assert [place_mm(rig, k) for k in (Y, 3)] == pytest.approx([2.5, 4.0], abs=0.002)


@pytest.mark.slow
def test_running_one_table_ends_the_others_of_its_follower():
    # E-25, E-47
    rig = rig_of("xyuv")
    table(rig, 0, HAT)
    table(rig, 1, ((0.0, 0.0), (5.0, 2.5), (20.0, 9.0)))  # one place in common, at 5
    table(rig, 2, STAIR, axis=3, master=U)
    assert [run(rig, k) for k in (0, 2)] == [0, 0]
    go(rig, X, 5.0)
    watch(rig)
    assert run(rig, 1) is CallStatus.OK
    settle(rig)
    assert jumps(rig.traces(), Y) == pytest.approx(0.0, abs=1e-12)
    assert [read(rig, k, Function.MODE) & Mode.RUN for k in range(3)] == [0, 1, 1]
    go(rig, X, 20.0 - 1e-6)
    assert place_mm(rig, Y) == pytest.approx(9.0, abs=0.003)
    write(rig, 0, shift=1.0)  # with a shift, no place is common any more
    go(rig, X, 5.0)
    watch(rig)
    run(rig, 0)
    settle(rig)
    assert jumps(rig.traces(), Y) == pytest.approx(1.0)


def test_followers_do_what_was_computed_beforehand():
    # E-20: over the whole way, not only where it rests
    rig = rig_of()
    start(rig, 0)
    watch(rig)
    go(rig, X, 20.0, 40.0)
    traces = rig.traces()
    assert traces.setpoint[:, Y] == pytest.approx(np.interp(traces.setpoint[:, X], *np.transpose(HAT)))
    assert np.abs(traces.actual[:, Y] - traces.setpoint[:, Y]).max() < 0.3


@pytest.mark.slow
def test_a_curve_passes_through_the_points_without_corners():
    bends = {}
    for cubic in (False, True):
        rig = rig_of()
        points = [(x, 5.0 * np.sin(2 * np.pi * x / 40.0)) for x in np.arange(0.0, 41.0, 4.0)]
        table(rig, 0, points)
        rig.control.elcam.tables[0].cubic = cubic
        run(rig, 0)
        for x, y in points[1:4]:
            go(rig, X, x)
            assert rig.control.axes[Y].setpoint == pytest.approx(y)
        go(rig, X, 8.0)
        rig.control.axes[X].accel = 1e6
        rig.control.move_velocity(X, 20.0)
        rig.run(0.01)
        watch(rig)
        rig.run(1.0)
        bends[cubic] = np.abs(np.diff(rig.traces().setpoint[:, Y], 2)).max()
    assert bends[True] < 0.1 * bends[False]


def test_a_follower_can_come_in_on_a_ramp():
    rig = rig_of()
    go(rig, X, 5.0)
    table(rig, 0, HAT)
    watch(rig)
    assert rig.control.cam_in(0, ramp_s=0.2)
    rig.run(0.1)
    assert not rig.control.in_sync(0)
    rig.run(0.15)
    assert rig.control.in_sync(0)
    settle(rig)
    assert jumps(rig.traces(), Y) < 0.02  # of 2.5
    assert rig.count("y") / COUNTS == pytest.approx(2.5, abs=0.002)


def test_a_ramp_that_was_broken_off_does_not_come_back():
    rig = rig_of()
    go(rig, X, 5.0)
    table(rig, 0, HAT)
    assert rig.control.cam_in(0, ramp_s=0.2)
    rig.run(0.05)
    rig.control.cam_out(0)
    go(rig, Y, 2.5)
    assert rig.control.cam_in(0)
    assert rig.control.in_sync(0)
    rig.run(0.002)
    assert rig.control.axes[Y].setpoint == 2.5


def test_an_axis_slows_down_on_its_ramp_for_a_target_close_ahead():
    axis = ControlAxis(1000.0, velocity=50.0, target=0.3, speed=50.0)
    speeds = [50.0]
    while axis.target is not None:
        axis.travel(CYCLE_S)
        speeds.append(axis.velocity)
    assert axis.setpoint == 0.3
    assert np.abs(np.diff(speeds)).max() < 2.1 * axis.accel * CYCLE_S


def test_names_of_plcopen():
    rig = rig_of()
    table(rig, 0, HAT)
    assert not rig.control.in_sync(0)
    assert rig.control.cam_in(0)
    assert rig.control.in_sync(0)
    assert not rig.control.move_absolute(Y, 3.0, 10.0)
    rig.control.cam_out(0)
    assert not rig.control.in_sync(0)
    assert not read(rig, 0, Function.MODE) & Mode.RUN
    assert rig.control.halt(Y)
    assert not rig.control.cam_in(1)  # a table without points
    for move in (lambda: rig.control.move_absolute(Y, math.nan, 10.0), lambda: rig.control.halt(9)):
        with pytest.raises(InputError, match=r"target is nan: give a finite number|no axis 9: this control has 0 to"):
            move()


ROWS = [(x, y) for top in (5.0, 10.0, 30.0) for x, y in ((0.0, 0.0), (50.0, top), (100.0, 0.0))]


def rows_rig(mode=0, **values):
    rig = rig_of("xyu")
    go(rig, X, 50.0, 400.0)
    write(rig, 0, row_count=3)
    table(rig, 0, ROWS, row_axis=U, row_start=0.0, row_end=100.0, mode=mode, **values)
    assert read(rig, 0, Function.ERROR) == 0
    return rig


@pytest.mark.slow
@pytest.mark.parametrize(
    ("places", "bits", "want"),
    [((-10.0, 0.0, 20.0, 25.0, 30.0), 0, (5, 5, 5, 10, 10)),
     ((50.0, 60.0, 75.0, 100.0, 120.0), 0, (10, 10, 30, 30, 30)),
     ((-10.0, 0.0, 20.0, 25.0, 30.0), Mode.INTERPOLATE_ROWS, (5, 5, 7, 7.5, 8)),
     ((50.0, 60.0, 75.0, 100.0, 120.0), Mode.INTERPOLATE_ROWS, (10, 14, 20, 30, 30))],
)  # fmt: skip
def test_a_third_axis_chooses_the_row(places, bits, want):
    # E-46, E-11, E-A3
    rig = rows_rig(bits)
    assert read(rig, 0, Function.MODE) & Mode.ROWS
    assert run(rig, 0) is CallStatus.OK
    for place, follower in zip(places, want, strict=True):
        go(rig, U, place, 400.0)
        assert place_mm(rig, Y) == pytest.approx(follower, abs=0.003), place


def test_rows_may_fall_and_one_row_is_a_table():
    # E-46, E-A3, E-A19
    rig = rig_of("xyu")
    go(rig, X, 50.0, 400.0)
    write(rig, 0, row_count=3)
    table(rig, 0, ROWS, row_axis=U, row_start=100.0, row_end=0.0)
    write(rig, 1, row_count=1)
    table(rig, 1, ROWS[:3], row_axis=X, row_start=7.0, row_end=7.0)
    run(rig, 0)
    settle(rig)
    assert place_mm(rig, Y) == pytest.approx(30.0, abs=0.003)
    assert run(rig, 1) is CallStatus.OK
    settle(rig)
    assert place_mm(rig, Y) == pytest.approx(5.0, abs=0.003)


def test_the_row_is_chosen_by_setpoint_or_actual_value():
    # E-46, E-17
    rig = rows_rig(Mode.INTERPOLATE_ROWS)
    rig.bench.hold("u", True)
    run(rig, 0)
    rig.control.move_absolute(U, 50.0, 400.0)
    rig.run(1.0)
    assert rig.control.axes[Y].setpoint == pytest.approx(10.0)
    run(rig, 0, Mode.ACTUAL_ROW)
    rig.run(0.01)
    assert rig.control.axes[Y].setpoint == pytest.approx(5.0, abs=0.01)


def test_the_row_is_chosen_by_a_steppers_encoder():
    # E-46, E-A18, E-17
    rig = rig_of("xyu", steppers="u")
    rig.control.axes[U].use_encoder, rig.control.axes[U].auxiliary_factor = True, 5000.0
    go(rig, X, 50.0, 400.0)
    write(rig, 0, row_count=3)
    table(rig, 0, ROWS, row_axis=U, row_start=0.0, row_end=1.0,
          mode=Mode.INTERPOLATE_ROWS | Mode.ACTUAL_ROW | Mode.AUXILIARY_ROW)  # fmt: skip
    run(rig, 0)
    go(rig, U, 0.5, 1.0)
    assert rig.control.axes[Y].setpoint == pytest.approx(10.0, abs=0.1)
    rig.control.axes[U].auxiliary_factor = 10_000.0
    rig.run(0.002)
    assert rig.control.axes[Y].setpoint == pytest.approx(7.5, abs=0.1)


@pytest.mark.slow
def test_interpolation_of_rows_is_lost_with_its_bit():
    # E-15, E-8, E-51, E-A12: in cam mode as well
    rig = rows_rig()
    write(rig, 0, interpolate_rows=1)
    assert read(rig, 0, Function.MODE) & Mode.INTERPOLATE_ROWS
    go(rig, U, 20.0, 400.0)
    run(rig, 0)
    settle(rig)
    assert place_mm(rig, Y) == pytest.approx(7.0, abs=0.003)
    write(rig, 0, mode=int(Mode.RUN))
    assert read(rig, 0, Function.INTERPOLATE_ROWS) == 0
    settle(rig)
    assert place_mm(rig, Y) == pytest.approx(5.0, abs=0.003)


def test_the_number_of_rows_is_fixed_once_the_table_has_run():
    # E-27
    rig = rows_rig()
    at = rig.control.elcam.at(0)
    run(rig, 0)
    assert at.write_int(Function.ROW_COUNT, 0) is CallStatus.BUSY
    stop(rig, 0)
    assert at.write_int(Function.ROW_COUNT, 0) is CallStatus.REFUSED
    write(rig, 0, reset=0, row_count=0)
    assert not read(rig, 0, Function.MODE) & Mode.ROWS


@pytest.mark.parametrize(
    ("points", "error"),
    [([*ROWS, (150.0, 0.0)], Error.ROW_SIZE), ([(0.0, 0.0)] * 3, Error.ROW_SIZE),
     ([(0, 0), (50, 1), (100, 0), (5, 0), (50, 1), (100, 0)], Error.ROW_SIZE),
     ([(0, 0), (100, 0), (5, 0), (100, 0), (0, 0), (100, 0)], Error.ROW_START),
     ([(0, 0), (100, 0), (0, 0), (90, 0), (0, 0), (100, 0)], Error.ROW_END)],
)  # fmt: skip
def test_bad_rows_do_not_run(points, error):
    # E-27, E-16, E-A4
    rig = rig_of("xyu")
    write(rig, 0, row_count=4 if len(points) == 6 and error == Error.ROW_SIZE else 3)
    table(rig, 0, points, row_axis=U, row_start=0.0, row_end=100.0)
    assert run(rig, 0) is CallStatus.REFUSED
    found = read(rig, 0, Function.ERROR)
    assert found == error | Error.ROW_TABLE
    settle(rig)
    assert rig.control.axes[Y].setpoint == 0.0


def test_a_second_row_needs_the_number_of_rows_before():
    # E-27, E-9, E-A11
    rig = rig_of("xyu")
    write(rig, 0, axis=Y, master=X, buffer_size=9)
    enter(rig, 0, ROWS[:3])
    assert rig.control.elcam.at(0).write_double(Function.ADD_MASTER, 0.0) is CallStatus.REFUSED
    assert read(rig, 0, Function.ERROR) & Error.NOT_ASCENDING
    rig = rows_rig(size=12)
    assert rig.control.elcam.at(0).write_double(Function.ADD_MASTER, 0.0) is CallStatus.REFUSED  # three rows are all
    assert read(rig, 0, Function.SIZE_MASTER) == 9
    assert read(rig, 0, Function.ERROR) & Error.NOT_ASCENDING


def test_a_row_axis_that_leads_nowhere_is_an_error():
    # E-16, E-A19
    rig = rig_of("xyu")
    write(rig, 0, row_count=2)
    table(rig, 0, ROWS[:6], row_axis=U, row_start=5.0, row_end=5.0)
    assert run(rig, 0) is CallStatus.REFUSED
    assert read(rig, 0, Function.ERROR) == Error.ROW_AXIS | Error.ROW_TABLE
