"""Axes of a table with errors of screws and ways, and the tables that compensate them, in the control's loops."""

import itertools

import numpy as np
import pytest

from edmsim.axis_bench.control_rig import ControlRig
from edmsim.controllers.axis.elcam.mcu_g3 import ControlAxis
from edmsim.controllers.axis.elcam.module import CallStatus
from edmsim.controllers.axis.elcam.table import Error, Function, Mode
from edmsim.errors import InputError
from edmsim.plant.axes.geometric_errors import errors_um, no_errors

from .cam_bench import (
    COUNTS,
    SWITCH,
    U,
    X,
    Y,
    at,
    compensate,
    enter,
    go,
    read,
    rig_of,
    run,
    settle,
    smooth_loop,
    stop,
    table,
    watch,
    write,
)

PITCH = ((-10.0, 0.0), (0.0, 0.0), (100.0, 0.010), (200.0, 0.030), (210.0, 0.030))
FAST = 400.0


def true_um(rig, **errors):
    """Where the table truly is: what its screws indicate, less their errors and those of the ways."""
    rows = no_errors()
    for name, values in errors.items():
        rows[name] = values
    places = [rig.table_um(name) for name in rig.names]
    off = errors_um(rows, places[0], places[1], places[2] if len(places) > 2 else 0.0)
    return np.array(places[:2]) - off


def pitch_rig(place=150.0, **options):
    rig = rig_of("xyu", **options)
    go(rig, X, place, FAST)
    table(rig, 0, PITCH, axis=X, master=X, mode=Mode.COMPENSATION)
    return rig


def test_a_loop_with_a_compensation_rests_at_the_true_place():
    # E-31, E-33, E-34, E-A1: numbers of an axis whose screw is 20 um too long at 150 mm
    rig = pitch_rig()
    assert run(rig, 0) is CallStatus.OK
    compensate(rig)
    settle(rig)
    axis = rig.control.axes[X]
    assert rig.control.resource(73, X) == pytest.approx(0.020)
    assert rig.count("x") / COUNTS == pytest.approx(150.020, abs=0.0011)
    assert axis.actual == pytest.approx(150.000, abs=0.0011)
    assert true_um(rig, pitch=(20.0 / 150_020, 0.0))[X] == pytest.approx(150_000, abs=1.2)
    assert axis.setpoint == 150.0


@pytest.mark.slow
def test_switching_off_moves_what_it_reports_and_then_the_axis():
    # E-34: the report jumps by c at once, then the loop takes the axis back
    rig = pitch_rig()
    run(rig, 0)
    compensate(rig)
    settle(rig)
    watch(rig)
    compensate(rig, 0)
    settle(rig)
    actual = rig.traces().actual[:, X]
    assert actual[:2] == pytest.approx(150.0, abs=0.0011)
    assert actual.max() == pytest.approx(150.020, abs=0.0021)
    assert actual[-1] == pytest.approx(150.0, abs=0.0011)
    assert rig.count("x") / COUNTS == pytest.approx(150.0, abs=0.0011)
    assert true_um(rig, pitch=(20.0 / 150_020, 0.0))[X] == pytest.approx(149_980, abs=1.2)
    watch(rig)
    compensate(rig)
    settle(rig)
    assert rig.traces().actual[:, X].min() == pytest.approx(149.980, abs=0.0021)


@pytest.mark.slow
def test_a_table_compensates_only_if_every_switch_is_on():
    # E-41, E-14, E-31, E-A5, E-A13: marked by function 30, bit 5, switched on for all, and running
    for marked, bit, everywhere, runs in itertools.product((0, 1), repeat=4):
        rig = rig_of("xyu")
        rig.control.axes[X].setpoint = 10.0
        table(rig, 0, PITCH, axis=X, master=Y)
        write(rig, 0, compensation=marked)
        compensate(rig, everywhere)
        mode = Mode.COMPENSATION * bit | Mode.RUN * runs
        assert at(rig).write_int(Function.MODE, mode) is CallStatus.OK
        assert read(rig, 0, Function.COMPENSATION) == (marked and bit)
        rig.control.axes[Y].setpoint = 150.0
        rig.run(0.003)
        effect = rig.control.resource(73, X) != 0.0
        assert effect == (marked and bit and everywhere and runs), (marked, bit, everywhere, runs)
        is_cam = runs and not marked and not bit
        assert rig.control.move_absolute(X, 20.0, FAST) is not bool(is_cam)


def test_the_mark_outlasts_a_mode_without_its_bit_and_a_reset_but_not_function_30():
    # E-14, E-A13: only function 30 marks, and only function 30 takes the mark back
    rig = pitch_rig()
    compensate(rig)
    write(rig, 0, mode=0)
    write(rig, 0, reset=0, buffer_size=len(PITCH))
    enter(rig, 0, PITCH)
    assert run(rig, 0, Mode.COMPENSATION) is CallStatus.OK
    rig.run(0.002)
    assert rig.control.resource(73, X) == pytest.approx(0.020)
    assert at(rig).write_int(Function.COMPENSATION, 0) is CallStatus.BUSY
    stop(rig, 0)
    write(rig, 0, compensation=0)
    assert run(rig, 0, Mode.COMPENSATION) is CallStatus.OK
    rig.run(0.002)
    assert rig.control.resource(73, X) == 0.0


def angle_points(urad=50.0):
    return ((-10.0, -10e-6 * urad), (400.0, 400e-6 * urad))


@pytest.mark.slow
def test_pitch_and_angle_add_up():
    # E-32, E-33, E-48, E-47
    rig = rig_of("xyu")
    go(rig, X, 200.0, FAST)
    go(rig, Y, 100.0, FAST)
    table(rig, 0, angle_points(), axis=Y, master=X, mode=Mode.COMPENSATION)
    pitch = (-10.0, 0.0), (0.0, 0.0), (100.0, 0.007), (200.0, 0.007)
    table(rig, 1, pitch, axis=Y, master=Y, mode=Mode.COMPENSATION)
    compensate(rig)
    assert run(rig, 0) is CallStatus.OK
    settle(rig)
    assert rig.control.resource(73, Y) == pytest.approx(0.010)
    assert run(rig, 1) is CallStatus.OK
    settle(rig)
    assert rig.control.resource(73, Y) == pytest.approx(0.017)
    assert rig.control.resource(73, X) == 0.0
    errors = {"pitch": (0.0, 7.0 / 100_017), "skew": (0.0, 50e-6)}
    assert true_um(rig, **errors) == pytest.approx([200_000, 100_000], abs=1.2)
    stop(rig, 1)
    stop(rig, 0)
    settle(rig)
    assert true_um(rig, **errors)[Y] == pytest.approx(100_000 - 17, abs=1.2)


@pytest.mark.slow
def test_an_error_that_a_third_axis_changes_is_compensated_by_rows():
    # E-32, E-46, E-15: 50 urad at u = 0 that become 90 at u = 100
    for bits, row_of_25 in ((Mode.INTERPOLATE_ROWS, 60.0), (0, 70.0)):
        rig = rig_of("xyu")
        go(rig, X, 200.0, FAST)
        write(rig, 0, row_count=3)
        rows = [point for urad in (50.0, 70.0, 90.0) for point in angle_points(urad)]
        table(rig, 0, rows, axis=Y, master=X, row_axis=U, row_start=0.0, row_end=100.0,
              mode=Mode.COMPENSATION | bits)  # fmt: skip
        assert run(rig, 0) is CallStatus.OK
        compensate(rig)
        for third, urad in ((0.0, 50.0), (25.0, row_of_25), (100.0, 90.0)):
            go(rig, U, third, FAST)
            assert rig.control.resource(73, Y) == pytest.approx(200e-6 * urad)
            left = true_um(rig, skew=(0.0, 50e-6), skew_per_um=(0.0, 0.4e-9))[Y]
            assert left == pytest.approx(200e-3 * (urad - 50.0 - 0.4 * third), abs=1.2)


def test_an_axis_has_one_pitch_table():
    # E-31, E-47
    rig = pitch_rig()
    table(rig, 1, PITCH, axis=X, master=X, mode=Mode.COMPENSATION)
    assert run(rig, 0) is CallStatus.OK
    assert run(rig, 1) is CallStatus.REFUSED
    compensate(rig)
    settle(rig)
    assert rig.control.resource(73, X) == pytest.approx(0.020)


def test_a_cam_and_a_compensation_share_an_axis():
    # E-47, E-A9
    rig = rig_of("xyu")
    table(rig, 0, ((-10.0, 0.005), (500.0, 0.005)), axis=Y, master=Y, mode=Mode.COMPENSATION)
    table(rig, 1, ((0.0, 0.0), (10.0, 5.0), (20.0, 0.0)))
    compensate(rig)
    assert run(rig, 0) is run(rig, 1) is CallStatus.OK
    go(rig, X, 5.0)
    assert rig.count("y") / COUNTS == pytest.approx(2.505, abs=0.0021)
    assert rig.control.resource(73, Y) == pytest.approx(0.005)


@pytest.mark.slow
def test_outside_a_compensation_table_its_end_holds_and_that_is_noted():
    # E-A14, E-31
    rig = pitch_rig(place=205.0)
    run(rig, 0)
    compensate(rig)
    settle(rig)
    assert not rig.control.elcam.tables[0].held
    go(rig, X, 230.0, FAST)
    assert rig.control.resource(73, X) == pytest.approx(0.030)
    assert rig.control.elcam.tables[0].held


def test_a_compensation_has_gain_shift_and_phase():
    # E-A20
    rig = pitch_rig()
    write(rig, 0, gain=2.0, shift=0.001, phase=50.0)
    run(rig, 0)
    compensate(rig)
    settle(rig)
    assert rig.control.resource(73, X) == pytest.approx(0.001 + 2 * 0.010)


def test_the_argument_is_the_setpoint_or_with_its_bit_the_actual_value():
    # E-A6, E-17
    rig = rig_of("xyu")
    table(rig, 0, angle_points(), axis=Y, master=X, mode=Mode.COMPENSATION)
    compensate(rig)
    run(rig, 0)
    rig.bench.hold("x", True)
    rig.control.move_absolute(X, 100.0, FAST)
    rig.run(1.0)
    assert rig.control.resource(73, Y) == pytest.approx(0.005)
    run(rig, 0, Mode.ACTUAL)
    rig.run(0.01)
    assert rig.control.resource(73, Y) == pytest.approx(0.0, abs=1e-6)


def test_a_steppers_setpoint_takes_the_compensation():
    # E-A1: nothing is measured that it could be taken off
    rig = ControlRig({"x": ControlAxis(500.0, stepper=True), "y": ControlAxis(COUNTS)}, {"y": smooth_loop()})
    go(rig, X, 1.0, 1.0)
    table(rig, 0, ((-10.0, 0.020), (10.0, 0.020)), axis=X, master=X, mode=Mode.COMPENSATION)
    run(rig, 0)
    before = rig.table_um("x")
    compensate(rig)
    settle(rig)
    assert rig.table_um("x") - before == pytest.approx(20.0, abs=0.5)


def test_the_sum_can_be_read_with_firmware_that_has_it():
    # E-33, E-36
    rig = pitch_rig(firmware="2.5.3.107")
    run(rig, 0)
    compensate(rig)
    settle(rig)
    assert rig.count("x") / COUNTS == pytest.approx(150.020, abs=0.0011)  # it compensates all the same
    with pytest.raises(InputError, match=r"no resource 73.*2\.5\.3\.108"):
        rig.control.resource(73, X)


def test_old_firmware_compensates_nothing():
    # E-36
    rig = rig_of("xyu", firmware="2.5.3.67")
    table(rig, 0, PITCH, axis=X, master=Y, mode=Mode.COMPENSATION, marked=False)
    assert run(rig, 0) is CallStatus.REFUSED
    assert rig.control.elcam.write_int(SWITCH, 1) is CallStatus.REFUSED
    assert rig.control.elcam.at(0).write_int(Function.COMPENSATION, 1) is CallStatus.REFUSED


def test_a_compensation_may_come_in_slowly():
    # E-34 [ours]: a rate instead of a jump
    rig = pitch_rig()
    rig.control.axes[X].compensation_rate = 0.1
    run(rig, 0)
    watch(rig)
    compensate(rig)
    settle(rig)
    steps = np.diff(rig.traces().compensation[:, X])
    assert steps.max() == pytest.approx(1e-4)
    assert rig.control.resource(73, X) == pytest.approx(0.020)


def test_a_reversal_is_taken_out_by_direction():
    rig = rig_of("xyu")
    table(rig, 0, ((-10.0, 0.0), (200.0, 0.0)), axis=X, master=X, mode=Mode.COMPENSATION)
    rig.control.elcam.tables[0].reversal = 0.008
    run(rig, 0)
    compensate(rig)
    for place, error in ((10.0, 0.004), (5.0, -0.004)):
        go(rig, X, place)
        assert rig.control.resource(73, X) == pytest.approx(error)


def test_a_master_of_its_own_is_wrong_without_the_compensation_bit():
    # E-19, E-16: read before its mode bits a pitch table shows an error, and after them none
    rig = rig_of("xyu")
    table(rig, 0, PITCH, axis=X, master=X)
    assert read(rig, 0, Function.ERROR) == Error.MASTER
    write(rig, 0, mode=int(Mode.COMPENSATION))
    assert read(rig, 0, Function.ERROR) == 0
    assert run(rig, 0) is CallStatus.OK
