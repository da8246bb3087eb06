"""The object interface of the cam tables: addresses, rights, registers; the bench's axes show the effect."""

import time

import numpy as np
import pytest

from edmsim.controllers.axis.elcam.module import ACCESS, CallStatus, Descriptor, LoadStatus, PhysicalMemory
from edmsim.controllers.axis.elcam.table import Error, Function, Mode
from edmsim.errors import InputError

from .cam_bench import COUNTS, HAT, X, Y, at, enter, follows, go, read, rig_of, run, settle, sized, table, write


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
    write_only = {function for function, access in ACCESS.items() if access.rights == "w"}
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


def test_more_points_than_reserved_are_refused_and_the_table_does_not_run():
    # E-16, E-19, E-A16
    rig = rig_of()
    table(rig, 0, HAT)
    for function in (Function.GAIN, Function.PHASE, Function.SHIFT, Function.ROW_START):
        for value in (float("nan"), float("inf")):
            assert at(rig).write_double(function, value) is CallStatus.REFUSED
    assert at(rig).write_double(Function.ADD_MASTER, 30.0) is CallStatus.REFUSED
    assert at(rig).write_double(Function.ADD_FOLLOW, 30.0) is CallStatus.REFUSED
    assert read(rig, 0, Function.ERROR) == Error.SIZE_MASTER | Error.SIZE_FOLLOW == 0xC00
    assert read(rig, 0, Function.SIZE_MASTER) == read(rig, 0, Function.SIZE_FOLLOW) == 3
    assert not follows(rig)
    assert (read(rig, 0, Function.MODE) & Mode.RUN, rig.count("y")) == (0, 0)
    write(rig, 0, error=0)
    assert follows(rig)


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
    monkeypatch.setenv("SZELCAMPUFFER", "67108864")
    assert rig_of().control.elcam.buffer_bytes == 67_108_864
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


# Whole cam tables at once: the bytes of a block, what refuses it, and tables in the computer's memory.

LONG = "0000000000000000 0000000000000000 0000000000002440 0000000000001440 0000000000003440 0000000000000000"
SHORT = "00000000 00000000 00002041 0000a040 0000a041 00000000"


@pytest.mark.parametrize(("text", "single"), [(LONG, False), (SHORT, True)])
def test_a_block_is_read_byte_for_byte(text, single):
    # E-29, E-A17
    rig = rig_of()
    sized(rig, mode=Mode.SINGLE if single else 0)
    data = bytes.fromhex(text)
    assert np.array(HAT, "<f4" if single else "<f8").tobytes() == data
    assert at(rig).load(data, single) is LoadStatus.OK == 0
    assert read(rig, 0, Function.SIZE_MASTER) == read(rig, 0, Function.SIZE_FOLLOW) == 3
    assert follows(rig)


def test_a_block_that_does_not_fit_has_its_code():
    # E-29, E-A17
    rig = rig_of()
    sized(rig)
    data = bytes.fromhex(LONG)
    assert at(rig).load(data[:47]) is at(rig).load(data[:40]) is LoadStatus.NOT_WHOLE == 7
    assert at(rig).load(data + data) is at(rig).load(b"") is at(rig).load(data[:16]) is LoadStatus.SIZE == 2
    assert at(rig).load(bytes(24), single=True) is LoadStatus.NO_ACCESS == 1
    assert at(rig).load(data) == 0
    assert follows(rig)
    assert at(rig).load(data) is LoadStatus.NO_ACCESS
    single = rig_of()
    sized(single, points=5, mode=Mode.SINGLE)
    assert at(single).load(data) is LoadStatus.NO_ACCESS
    assert at(single).load(bytes(40), single=True) == 0


@pytest.mark.parametrize(
    ("options", "fault", "code"),
    [({"firmware": "2.5.3.66"}, None, 4), ({"library": "2.5.3.42"}, None, 4), ({}, "memory", 5), ({}, "rebooted", 3),
     ({}, "system", 6), ({"option": False}, None, 1)],
)  # fmt: skip
def test_a_control_out_of_order_loads_nothing(options, fault, code):
    # E-29, E-36
    rig = rig_of(**options)
    if options.get("option", True):
        sized(rig)
    if fault:
        setattr(rig.control.elcam.faults, fault, True)
    assert at(rig).load(bytes.fromhex(LONG)) == code
    assert not follows(rig)


def test_a_block_is_not_looked_at_and_the_lookup_stays_finite():
    # E-43
    rig = rig_of()
    for index, xs in enumerate(((0.0, 10.0, 10.0, 20.0), (0.0, 15.0, 5.0, 20.0), (7.0, 7.0, 7.0, 7.0))):
        sized(rig, index, 4)
        assert at(rig, index).load(np.array([(x, 1.0 + k) for k, x in enumerate(xs)]).tobytes()) == 0
        assert not read(rig, index, Function.ERROR) & Error.NOT_ASCENDING
        for master in (0.0, 5.0, 7.0, 10.0, 20.0):
            rig.control.axes[X].setpoint = master
            assert run(rig, index) is CallStatus.OK
            rig.run(0.001)
            assert 1.0 <= rig.control.axes[Y].setpoint < 10.0


def test_a_block_with_numbers_that_are_none_does_not_run():
    rig = rig_of()
    sized(rig)
    assert at(rig).load(np.array([0.0, 0.0, 10.0, np.nan, 20.0, 0.0]).tobytes()) == 0
    assert run(rig, 0) is CallStatus.REFUSED
    assert read(rig, 0, Function.ERROR) == Error.NOT_ASCENDING


def test_a_block_loads_faster_than_its_points():
    # E-50
    points = np.column_stack([np.arange(100_000.0), np.arange(100_000.0) % 7])
    rig = rig_of(buffer_bytes=4_000_000)
    sized(rig, 0, len(points))
    sized(rig, 1, len(points))
    started = time.perf_counter()
    assert at(rig).load(points.tobytes()) == 0
    block_s = time.perf_counter() - started
    started = time.perf_counter()
    enter(rig, 1, points[:1000])
    assert block_s < 100 * (time.perf_counter() - started)
    rig.control.axes[X].setpoint = 50_000.5
    run(rig, 0)
    rig.run(0.001)
    assert rig.control.axes[Y].setpoint == pytest.approx((50_000 % 7 + 50_001 % 7) / 2)


def in_memory(rig, memory, points, count=3):
    """Set a table up whose points stand in the computer's memory."""
    found = memory.allocate(16 * count)
    if found.status:
        return found
    write(rig, 0, axis=Y, master=X, physical_address=found.address, buffer_size=count)
    np.frombuffer(found.memory).reshape(-1, 2)[: len(points)] = points
    write(rig, 0, table_size=len(points))
    return found


def test_a_table_can_stay_in_the_computers_memory():
    # E-30, E-13, E-49: larger than the control's room
    memory = PhysicalMemory()
    rig = rig_of(memory=memory)
    found = in_memory(rig, memory, HAT, 1_000_000)
    assert (found.status, read(rig, 0, Function.PHYSICAL_ADDRESS)) == (0, found.address)
    assert read(rig, 0, Function.BUFFER_SIZE) == 1_000_000
    assert follows(rig)
    np.frombuffer(found.memory)[3] = 7.0  # the program changes a point under way
    settle(rig)
    assert rig.count("y") / COUNTS == pytest.approx(3.5, abs=0.002)
    assert memory.free(found.memory) == 0
    settle(rig)
    assert not read(rig, 0, Function.MODE) & Mode.RUN
    assert read(rig, 0, Function.ERROR) & Error.MEMORY
    assert memory.free(found.memory) == 1


def test_the_address_comes_before_the_size():
    # E-13
    memory = PhysicalMemory()
    rig = rig_of(memory=memory)
    found = memory.allocate(16 * 10_000)
    assert at(rig).write_int(Function.BUFFER_SIZE, 10_000) is CallStatus.REFUSED
    write(rig, 0, error=0, axis=Y, master=X, physical_address=found.address, buffer_size=10_000)
    assert at(rig).write_int(Function.TABLE_SIZE, 10_001) is CallStatus.REFUSED
    other = rig_of(memory=memory)
    table(other, 0, HAT)
    write(other, 0, physical_address=found.address)  # too late, but no other harm
    assert at(other).write_int(Function.TABLE_SIZE, 2) is CallStatus.REFUSED
    assert follows(other)


def test_memory_may_be_refused_and_an_address_that_was_never_allocated_is_none():
    # E-49
    fragmented = PhysicalMemory(free_bytes=4096)
    rig = rig_of(memory=fragmented)
    assert in_memory(rig, fragmented, HAT, 1_000_000).status != 0
    assert not follows(rig)
    again = fragmented.allocate(4096)
    fragmented.free_bytes = 0
    assert again.status == 0
    assert fragmented.allocate(4096).status != 0  # at the second start
    reserved = PhysicalMemory(reserved_bytes=48)
    assert reserved.allocate(32).status != 0
    rig = rig_of(memory=reserved)
    assert in_memory(rig, reserved, HAT).status == 0
    assert follows(rig)
    write(rig, 1, axis=Y, master=X, physical_address=0x1234)  # never allocated
    assert at(rig, 1).write_int(Function.BUFFER_SIZE, 3) is CallStatus.REFUSED
    assert read(rig, 1, Function.ERROR) == Error.MEMORY
