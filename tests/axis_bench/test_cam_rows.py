"""Cam tables with rows: a third axis chooses the row, hard or interpolated, by its setpoint or where it is."""

from __future__ import annotations

import pytest

from edmsim.controllers.axis.elcam.registers import CallStatus, Error, Function, Mode

from .cam_bench import COUNTS, U, X, Y, enter, go, read, rig_of, run, settle, stop, table, write


def place_mm(rig, axis):
    return rig.count("xyuv"[axis]) / COUNTS


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
    table(rig, 1, ROWS[:3], row_axis=U, row_start=7.0, row_end=7.0)
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
    [([*ROWS, (150.0, 0.0)], Error.ROW_SIZE),
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
    write(rig, 0, row_count=3)
    table(rig, 0, ROWS, row_axis=U, row_start=5.0, row_end=5.0)
    assert run(rig, 0) is CallStatus.REFUSED
    assert read(rig, 0, Function.ERROR) == Error.ROW_AXIS | Error.ROW_TABLE
