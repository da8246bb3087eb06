"""The object interface of the cam tables: addresses, rights, registers; the bench's axes show the effect."""

from __future__ import annotations

import pytest

from edmsim.controllers.axis.elcam.registers import (
    ACCESS,
    CallStatus,
    Descriptor,
    Error,
    Function,
    Mode,
)
from edmsim.errors import InputError

from .cam_bench import HAT, X, Y, at, enter, follows, go, read, rig_of, run, sized, table, write


def test_a_table_is_addressed_by_bus_device_index_and_function():
    # E-1
    rig = rig_of()
    table(rig, 3, HAT)
    elcam = rig.control.elcam
    assert elcam.read_int(Descriptor(1200, 1, 3, Function.SIZE_MASTER)) == (CallStatus.OK, 3)
    assert elcam.read_int(Descriptor(1200, 1, 0, Function.SIZE_MASTER)) == (CallStatus.OK, 0)
    for wrong in (Descriptor(1000, 1, 3, 13), Descriptor(1200, 2, 3, 13), Descriptor(1200, 0, 3, 13),
                  Descriptor(1200, 1, -1, 13)):  # fmt: skip
        assert elcam.read_int(wrong).status is CallStatus.REFUSED
    assert follows(rig, 3)


def test_numbers_and_rights_are_those_of_the_document():
    # E-45, E-3 to E-7, E-10, E-11
    rig = rig_of()
    table(rig, 0, HAT)
    numbers = {number for number in range(1, 301) if any(
        call(number).status is CallStatus.OK for call in (at(rig).read_int, at(rig).read_double)
    )}  # fmt: skip
    assert numbers == {*range(1, 9), 10, *range(13, 21), 30, 31, 300}
    write_only = {f for f, (_, rights) in ACCESS.items() if rights == "w"}
    assert write_only == {11, 12, 21}
    for function in (13, 14, 19, 20):
        assert at(rig).write_int(function, 1) is at(rig).write_double(function, 1.0) is CallStatus.REFUSED
    for function in (9, 22, 29, 32, 299, 301):
        assert at(rig).write_int(function, 1) is at(rig).write_double(function, 1.0) is CallStatus.REFUSED
    assert at(rig).write_int(Function.GAIN, 2) is CallStatus.REFUSED  # it is a double
    assert at(rig).write_double(Function.AXIS, 0.0) is CallStatus.REFUSED
    defaults = {Function.GAIN: 1.0, Function.PHASE: 0.0, Function.SHIFT: 0.0}
    assert {f: at(rig).read_double(f).value for f in defaults} == defaults
    assert read(rig, 0, Function.ROW_COUNT) == 0
    assert follows(rig)


def test_points_count_both_coordinates_and_must_be_equally_many():
    # E-5, E-9, E-10, E-A7
    rig = rig_of()
    sized(rig, points=4)
    enter(rig, 0, HAT)
    write(rig, 0, add_master=30.0)
    assert [read(rig, 0, f) for f in (Function.SIZE_MASTER, Function.SIZE_FOLLOW, Function.BUFFER_SIZE)] == [4, 3, 4]
    assert not follows(rig)
    assert read(rig, 0, Function.ERROR) == Error.SIZE
    write(rig, 0, add_follow=0.0, error=0)
    assert follows(rig)


@pytest.mark.parametrize(
    ("points", "axes", "error"),
    [(1, {}, Error.SIZE), (3, {"master": 5}, Error.MASTER), (3, {"master": -1}, Error.MASTER),
     (3, {"axis": 2}, Error.MASTER), (3, {"master": Y}, Error.MASTER)],
)  # fmt: skip
def test_one_point_and_a_wrong_master_do_not_lead(points, axes, error):
    # E-16
    rig = rig_of()
    table(rig, 0, HAT[:points], **axes)
    assert run(rig, 0) is CallStatus.REFUSED
    assert read(rig, 0, Function.ERROR) == error
    assert (Error.SIZE, Error.MASTER) == (0x200, 0x1000)


@pytest.mark.slow
def test_values_of_the_master_rise():
    # E-9, E-A2, E-A16, E-16
    for value in (10.0, 4.0, float("nan"), float("inf")):
        rig = rig_of()
        sized(rig, points=4)
        enter(rig, 0, HAT[:2])
        assert at(rig).write_double(Function.ADD_MASTER, value) is CallStatus.REFUSED
        assert read(rig, 0, Function.ERROR) == Error.NOT_ASCENDING == 0x2000
        assert read(rig, 0, Function.SIZE_MASTER) == 2
        assert run(rig, 0) is CallStatus.REFUSED
        enter(rig, 0, HAT[2:])
        write(rig, 0, error=0)  # E-3, E-A15
        assert follows(rig)


def test_more_points_than_reserved_are_refused():
    # E-16, E-A16
    rig = rig_of()
    table(rig, 0, HAT)
    for function in (Function.GAIN, Function.PHASE, Function.SHIFT, Function.ROW_START):
        for value in (float("nan"), float("inf")):
            assert at(rig).write_double(function, value) is CallStatus.REFUSED
    assert at(rig).write_double(Function.ADD_MASTER, 30.0) is CallStatus.REFUSED
    assert at(rig).write_double(Function.ADD_FOLLOW, 30.0) is CallStatus.REFUSED
    assert read(rig, 0, Function.ERROR) == Error.SIZE_MASTER | Error.SIZE_FOLLOW == 0xC00
    assert read(rig, 0, Function.SIZE_MASTER) == read(rig, 0, Function.SIZE_FOLLOW) == 3
    write(rig, 0, error=0)
    assert follows(rig)


def test_a_table_with_an_error_does_not_run_and_its_follower_stays():
    # E-19, E-16
    rig = rig_of()
    table(rig, 0, HAT, size=3)
    at(rig).write_double(Function.ADD_MASTER, 30.0)
    assert not follows(rig)
    assert not read(rig, 0, Function.MODE) & Mode.RUN
    assert rig.count("y") == 0


def test_room_is_reserved_once_and_shared_by_all_tables():
    # E-2, E-5, E-16
    rig = rig_of()
    sized(rig, 0, 3125)
    assert at(rig).write_int(Function.BUFFER_SIZE, 4000) is CallStatus.REFUSED
    sized(rig, 1, 3125)
    rig = rig_of()
    sized(rig, 0, 3125)
    write(rig, 1, axis=Y, master=X)
    assert at(rig, 1).write_int(Function.BUFFER_SIZE, 3126) is CallStatus.REFUSED
    assert read(rig, 1, Function.ERROR) == Error.MEMORY == 0x100
    write(rig, 0, reset=1)
    write(rig, 1, error=0, buffer_size=3126)
    enter(rig, 1, HAT)
    assert follows(rig, 1)


@pytest.mark.parametrize(("mode", "most"), [(0, 6250), (Mode.SINGLE, 12_500)])
def test_a_point_takes_sixteen_bytes_or_eight(mode, most):
    # E-2, E-42
    rig = rig_of()
    sized(rig, 0, most, mode)
    rig = rig_of()
    write(rig, 0, mode=int(mode))
    assert at(rig).write_int(Function.BUFFER_SIZE, most + 1) is CallStatus.REFUSED


def test_the_environment_says_how_much_room_there_is(monkeypatch):
    # E-2: SZELCAMPUFFER, 16 bytes a point; what is given in Python goes before it
    monkeypatch.setenv("SZELCAMPUFFER", " 160016 ")
    rig = rig_of()
    sized(rig, 0, 10_001)
    assert at(rig, 1).write_int(Function.BUFFER_SIZE, 1) is CallStatus.REFUSED
    assert rig_of(buffer_bytes=32).control.elcam.buffer_bytes == 32
    monkeypatch.setenv("SZELCAMPUFFER", "")
    assert rig_of().control.elcam.buffer_bytes == 100_000
    monkeypatch.setenv("SZELCAMPUFFER", "1 MB")
    with pytest.raises(InputError, match="variable SZELCAMPUFFER is '1 MB'; it must be 0 to 67108864 bytes"):
        rig_of()
    with pytest.raises(InputError, match="cam tables cannot have 999999999 bytes: this control has 0 to 67108864"):
        rig_of(buffer_bytes=999_999_999)


def test_precision_is_chosen_before_the_size():
    # E-18, E-A10, E-51
    rig = rig_of()
    sized(rig, mode=Mode.SINGLE)
    assert at(rig).write_int(Function.MODE, 0) is CallStatus.LOCKED == 0x10
    assert read(rig, 0, Function.MODE) == Mode.SINGLE
    enter(rig, 0, HAT)
    write(rig, 0, mode=0x50)
    assert at(rig).write_int(Function.MODE, 0x41) is CallStatus.LOCKED
    assert read(rig, 0, Function.MODE) == 0x50
    write(rig, 0, mode=0x11)
    assert read(rig, 0, Function.INTERPOLATE_ROWS) == 0
    assert follows(rig)


def test_bits_of_mode_are_those_of_the_document():
    # E-17
    assert [int(bit) for bit in Mode] == [0x1, 0x2, 0x4, 0x8, 0x10, 0x20, 0x40, 0x80, 0x100]
    rig = rig_of()
    table(rig, 0, HAT)
    write(rig, 0, mode=int(Mode.ROWS | Mode.AUXILIARY | Mode.AUXILIARY_ROW))
    assert read(rig, 0, Function.MODE) == 0x180  # bit 3 is the system's
    assert at(rig).write_int(Function.MODE, 0x200) is CallStatus.REFUSED
    assert follows(rig)  # bits 7 and 8 without 1 and 2 change nothing


def test_single_precision_rounds_points_before_they_are_compared():
    # E-42
    rig = rig_of()
    sized(rig, points=4, mode=Mode.SINGLE)
    write(rig, 0, add_master=100.000001)
    assert at(rig).write_double(Function.ADD_MASTER, 100.000002) is CallStatus.REFUSED
    assert read(rig, 0, Function.ERROR) & Error.NOT_ASCENDING
    rig = rig_of()
    table(rig, 0, ((0.0, 0.0), (200.0, 0.2)), mode=Mode.SINGLE)
    run(rig, 0)
    go(rig, X, 100.0, 400.0)
    assert rig.control.axes[Y].setpoint == pytest.approx(0.1, rel=2.0**-23)
    assert rig.control.axes[Y].setpoint != 0.1


def test_the_option_can_be_queried_and_without_it_there_is_nothing():
    # E-36
    assert rig_of().control.elcam.option
    rig = rig_of(option=False)
    assert not rig.control.elcam.option
    assert at(rig).write_int(Function.AXIS, 1) is at(rig).read_int(Function.AXIS).status is CallStatus.REFUSED


@pytest.mark.parametrize(
    ("old", "new", "function"),
    [("2.5.3.24", "2.5.3.25", Function.TARGET_POSITION), ("2.5.3.67", "2.5.3.68", Function.PHYSICAL_ADDRESS)],
)
def test_old_firmware_lacks_what_came_later(old, new, function):
    # E-36
    for version, status in ((old, CallStatus.REFUSED), (new, CallStatus.OK)):
        rig = rig_of(firmware=version)
        table(rig, 0, HAT)
        call = at(rig).read_double if ACCESS[function][0] is float else at(rig).read_int
        assert call(function).status is status
        assert follows(rig)


def test_old_firmware_has_one_table_to_a_follower_and_no_auxiliary_bits():
    # E-36, E-25
    rig = rig_of(firmware="2.5.3.63")
    table(rig, 0, HAT)
    table(rig, 1, HAT)
    assert run(rig, 0) is CallStatus.OK
    assert run(rig, 1) is CallStatus.REFUSED
    old = rig_of(firmware="2.5.3.114")
    table(old, 0, HAT)
    assert at(old).write_int(Function.MODE, int(Mode.ACTUAL | Mode.AUXILIARY)) is CallStatus.REFUSED
    assert read(old, 0, Function.MODE) == 0
    write(old, 0, mode=int(Mode.ACTUAL))
    assert follows(old)


def test_what_makes_the_table_cannot_change_while_it_runs():
    # E-4, E-28 [ours]
    rig = rig_of()
    table(rig, 0, HAT, size=4)
    assert follows(rig)
    changes = {Function.AXIS: X, Function.MASTER: Y, Function.BUFFER_SIZE: 9, Function.ROW_COUNT: 1}
    for function, value in changes.items():
        assert at(rig).write_int(function, value) is CallStatus.BUSY
    assert at(rig).write_double(Function.ADD_MASTER, 30.0) is CallStatus.BUSY
    write(rig, 0, reset=0)
    table(rig, 0, ((0.0, 0.0), (10.0, 1.0)))
    assert follows(rig, place=0.5)
