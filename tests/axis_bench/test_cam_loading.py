"""Whole cam tables at once: the bytes of a block, what refuses it, and tables in the computer's memory."""

from __future__ import annotations

import time

import numpy as np
import pytest

from edmsim.controllers.axis.elcam.module import PhysicalMemory
from edmsim.controllers.axis.elcam.registers import CallStatus, Error, Function, LoadStatus, Mode

from .cam_bench import COUNTS, HAT, X, Y, at, enter, follows, read, rig_of, run, settle, sized, table, write

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


def test_memory_may_be_refused():
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


def test_an_address_that_was_never_allocated_is_no_memory():
    # E-49
    rig = rig_of()
    write(rig, 0, axis=Y, master=X, physical_address=0x1234)
    assert at(rig).write_int(Function.BUFFER_SIZE, 3) is CallStatus.REFUSED
    assert read(rig, 0, Function.ERROR) == Error.MEMORY
