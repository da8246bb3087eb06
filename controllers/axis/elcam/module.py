"""ELCAM, the cam tables of the control MCU-G3: its object interface, and positions from the tables.

>>> elcam = Elcam([CamPlace(), CamPlace(setpoint=5.0)])
>>> table = elcam.at(0)
>>> for function, value in ((Function.BUFFER_SIZE, 3), (Function.AXIS, 0), (Function.MASTER, 1)):
...     assert table.write_int(function, value) == 0
>>> for x, y in ((0.0, 0.0), (10.0, 5.0), (20.0, 0.0)):
...     assert table.write_double(Function.ADD_MASTER, x) == table.write_double(Function.ADD_FOLLOW, y) == 0
>>> table.write_int(Function.MODE, Mode.RUN), elcam.follow()
(<CallStatus.OK: 0>, {0: 2.5})

The sign of a compensation: an entry is the error of the axis, its indicated less its true position. Some other
controls use the opposite sign.
"""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple, Protocol

import numpy as np

from edmsim.controllers.axis.elcam.table import DATA, CamTable, Error, Function, Mode
from edmsim.errors import InputError
from edmsim.numeric import whole

__all__ = ["CamPlace", "Elcam", "Function", "Mode", "TableAccess"]

# The object interface: addresses, functions and answers (tables 1 and 2, chapter 2.7).


@dataclass(frozen=True)
class Descriptor:
    """An object's address."""

    bus: int  # 1200 for ELCAM
    device: int  # 1 for a table; 0 with index 30 for the switch of the compensation of all tables
    index: int  # number of the table, 0 or more, chosen by the user
    sub_index: int  # a `Function`


class Access(NamedTuple):
    """How a function is called."""

    kind: type[int] | type[float]
    rights: str  # of "r" and "w"
    name: str = ""  # attribute of `CamTable` that it reads, and writes unless the module does more; empty for none
    while_running: bool = False  # whether it is writable while the table runs (ours: the document forbids only rows)
    since: str = ""  # key in the data of the first firmware version with it; empty for all versions


ACCESS: dict[Function, Access] = {
    Function.ERROR: Access(int, "rw", while_running=True),
    Function.RESET: Access(int, "rw", while_running=True),
    Function.BUFFER_SIZE: Access(int, "rw"),
    Function.AXIS: Access(int, "rw", "axis"),
    Function.MASTER: Access(int, "rw", "master"),
    Function.GAIN: Access(float, "rw", "gain", while_running=True),
    Function.PHASE: Access(float, "rw", "phase", while_running=True),
    Function.SHIFT: Access(float, "rw", "shift", while_running=True),
    Function.MODE: Access(int, "rw", while_running=True),
    Function.ADD_MASTER: Access(float, "w"),
    Function.ADD_FOLLOW: Access(float, "w"),
    Function.SIZE_MASTER: Access(int, "r", "size_master"),
    Function.SIZE_FOLLOW: Access(int, "r", "size_follow"),
    Function.ROW_AXIS: Access(int, "rw", "row_axis"),
    Function.ROW_START: Access(float, "rw", "row_start"),
    Function.ROW_END: Access(float, "rw", "row_end"),
    Function.ROW_COUNT: Access(int, "rw", "row_count"),
    Function.TARGET_POSITION: Access(float, "r", since="target_position"),
    Function.MEMORY_ADDRESS: Access(int, "r", "physical_address"),
    Function.TABLE_SIZE: Access(int, "w", since="computer_memory"),
    Function.COMPENSATION: Access(int, "rw", since="compensation"),
    Function.INTERPOLATE_ROWS: Access(int, "rw", while_running=True),
    Function.PHYSICAL_ADDRESS: Access(int, "rw", "physical_address", since="computer_memory"),
}
"""Every function of a table's object."""


KNOWN = Mode(0x1FF)  # all bits of MODE


class CallStatus(IntEnum):
    """Status of a call of the object interface; all but BUSY and LOCKED are ours."""

    OK = 0
    REFUSED = 1  # unknown object, no such right, invalid number, or forbidden by its register; nothing has changed
    BUSY = 2  # not allowed while the table runs
    LOCKED = 16  # "Error 10 hex": the precision cannot be changed after the buffer size is set


class LoadStatus(IntEnum):
    """Status of loading a whole table (chapter 2.7)."""

    OK = 0
    NO_ACCESS = 1
    SIZE = 2
    REBOOTED = 3
    NO_ADDRESS = 4
    NO_MEMORY = 5
    SYSTEM = 6
    NOT_WHOLE = 7


class ObjectAnswer(NamedTuple):
    """Result of a reading call; the value is valid only with `CallStatus.OK`."""

    status: CallStatus
    value: float


def version_of(text: str) -> tuple[int, ...]:
    """Return a version as numbers that compare."""
    return tuple(int(part) for part in text.split("."))


# Memory for cam tables: in the control (chapter 1 of the ELCAM document) and in the computer (chapter 2.8).

BUFFER_VARIABLE = "SZELCAMPUFFER"  # environment variable with the bytes for the points of all tables
_MANY_DIGITS = 20  # longer than any number of bytes (ours)

_FIRST_ADDRESS = 0x1000_0000  # of the first allocated block (ours: an address above the first megabytes)
_PAGE = 0x1000  # blocks begin at whole pages (ours)


def buffer_bytes_chosen() -> int:
    """Return the buffer's bytes by the environment variable SZELCAMPUFFER, or else the control's default."""
    text = os.environ.get(BUFFER_VARIABLE, "").strip()
    if not text:
        return int(DATA["elcam"]["buffer_bytes"])
    most = DATA["elcam"]["most_bytes"]
    if not (text.isascii() and text.isdigit() and len(text) < _MANY_DIGITS and int(text) <= most):
        raise InputError(f"the environment variable {BUFFER_VARIABLE} is {text!r}; it must be 0 to {most} bytes")
    return int(text)


class Allocation(NamedTuple):
    """Result of an allocation."""

    status: int  # 0 on success
    memory: bytearray  # the block, for the program ("virtual address")
    address: int  # its address for the control ("physical address")


class PhysicalMemory:
    """Contiguous blocks of memory, at addresses that a control can read.

    Parameters
    ----------
    free_bytes : int
        The longest free block; other programs fragment the memory.
    reserved_bytes : int
        Size reserved while booting, or 0. You can allocate only this size.
    """

    def __init__(self, free_bytes: int = 1 << 26, reserved_bytes: int = 0) -> None:
        self.free_bytes = free_bytes
        self.reserved_bytes = reserved_bytes
        self._pieces: dict[int, bytearray] = {}
        self._next = _FIRST_ADDRESS

    def allocate(self, size: int) -> Allocation:
        """Allocate bytes; status 1 if no block is large enough (ours, the document says "error code")."""
        wrong_size = self.reserved_bytes > 0 and size != self.reserved_bytes
        if size < 1 or wrong_size or (self.reserved_bytes == 0 and size > self.free_bytes):
            return Allocation(1, bytearray(), 0)
        address, piece = self._next, bytearray(size)
        self._pieces[address] = piece
        self._next += -(-size // _PAGE) * _PAGE
        return Allocation(0, piece, address)

    def free(self, memory: bytearray) -> int:
        """Free a block; 0 on success, else 1."""
        for address, piece in self._pieces.items():
            if piece is memory:
                del self._pieces[address]
                return 0
        return 1

    def at(self, address: int) -> bytearray | None:
        """Return the block at an address; None if none is allocated there."""
        return self._pieces.get(address)


class CamAxis(Protocol):
    """ELCAM's interface of an axis, in its unit; `auxiliary` is from a stepper's encoder, if used."""

    @property
    def setpoint(self) -> float:
        """Commanded position."""

    @property
    def actual(self) -> float:
        """Position."""

    @property
    def auxiliary(self) -> float | None:
        """Position by a stepper's encoder."""


@dataclass
class CamPlace:
    """An axis that consists of its positions only."""

    setpoint: float = 0.0
    actual: float = 0.0
    auxiliary: float | None = None


@dataclass
class ControlFaults:
    """Faults of the control that can be simulated."""

    rebooted: bool = False  # another program boots it while a table is loaded
    system: bool = False  # the same, but noticed later
    memory: bool = False  # the library cannot reach the tables' memory


_AUXILIARY = Mode.AUXILIARY | Mode.AUXILIARY_ROW


@dataclass(frozen=True)
class TableAccess:
    """One table's object: the calls of `Elcam` without the descriptor."""

    elcam: "Elcam"
    index: int

    def _descriptor(self, function: int) -> Descriptor:
        return Descriptor(DATA["elcam"]["bus"], 1, self.index, function)

    def write_int(self, function: int, value: int) -> CallStatus:
        """As `Elcam.write_int`."""
        return self.elcam.write_int(self._descriptor(function), value)

    def write_double(self, function: int, value: float) -> CallStatus:
        """As `Elcam.write_double`."""
        return self.elcam.write_double(self._descriptor(function), value)

    def read_int(self, function: int) -> ObjectAnswer:
        """As `Elcam.read_int`."""
        return self.elcam.read_int(self._descriptor(function))

    def read_double(self, function: int) -> ObjectAnswer:
        """As `Elcam.read_double`."""
        return self.elcam.read_double(self._descriptor(function))

    def load(self, data: bytes, single: bool = False) -> LoadStatus:
        """As `Elcam.load`."""
        return self.elcam.load(self.index, data, single)


class Elcam:
    """The ELCAM module of a control.

    Parameters
    ----------
    axes : sequence of CamAxis
        The control's axes; the module reads their positions on demand.
    buffer_bytes : int, optional
        Memory for the points of all tables; by default the environment variable SZELCAMPUFFER, or 100 000 if it is
        not set.
    firmware, library : str, optional
        Versions of the control's firmware and of the computer's library; by default the newest in the document.
    option : bool
        Whether the firmware has ELCAM.
    memory : PhysicalMemory, optional
        The computer's memory, for tables stored there.

    Attributes
    ----------
    tables : dict of int to CamTable
        Tables in use, by number.
    compensating : bool
        Whether compensation is on, for all tables (device 0, index 30).
    faults : ControlFaults

    Raises
    ------
    InputError
        The memory exceeds the control's, or SZELCAMPUFFER is not a number of bytes.
    """

    def __init__(
        self, axes: Sequence[CamAxis], *, buffer_bytes: int | None = None, firmware: str | None = None,
        library: str | None = None, option: bool = True, memory: PhysicalMemory | None = None,
    ) -> None:
        data = DATA["elcam"]
        self.buffer_bytes = buffer_bytes_chosen() if buffer_bytes is None else buffer_bytes
        if not 0 <= self.buffer_bytes <= data["most_bytes"]:
            raise InputError(
                f"cam tables cannot have {self.buffer_bytes} bytes: this control has 0 to {data['most_bytes']}"
            )
        self.axes = axes
        self.option = option
        self.memory = memory or PhysicalMemory()
        self.tables: dict[int, CamTable] = {}
        self.compensating = False
        self.faults = ControlFaults()
        self._firmware = version_of(firmware or data["firmware"])
        self._library = version_of(library or data["library"])

    def has(self, what: str) -> bool:
        """Return whether the firmware has ELCAM and a later feature, by its key in the data."""
        return self.option and self._firmware >= version_of(DATA["since"][what])

    def at(self, index: int) -> TableAccess:
        """Return a table's object."""
        return TableAccess(self, index)

    def write_int(self, to: Descriptor, value: int) -> CallStatus:
        """Write a whole number (wrOptionInt)."""
        number = whole(value)
        if number is None or not self._is_switch(to):
            return CallStatus.REFUSED if number is None else self._write(to, number, int)
        self.compensating = bool(number)
        return CallStatus.OK

    def write_double(self, to: Descriptor, value: float) -> CallStatus:
        """Write a number (wrOptionDbl)."""
        return self._write(to, float(value), float)

    def read_int(self, of: Descriptor) -> ObjectAnswer:
        """Read a whole number (rdOptionInt)."""
        if self._is_switch(of):
            return ObjectAnswer(CallStatus.OK, int(self.compensating))
        return self._read(of, int)

    def read_double(self, of: Descriptor) -> ObjectAnswer:
        """Read a number (rdOptionDbl)."""
        return self._read(of, float)

    def load(self, index: int, data: bytes, single: bool = False) -> LoadStatus:
        """Load all points of a table at once: pairs of master and follower, little endian.

        Parameters
        ----------
        index : int
            Number of the table; set its axes and size first.
        data : bytes
            64-bit numbers (wrEICamTable64) or, with `single`, 32-bit numbers (wrEICamTable32).
        single : bool
            Whether the numbers have 32 bits: as the table's mode says, or nothing is loaded.
        """
        table = self.tables.get(index)
        if len(data) % (8 if single else 16):
            return LoadStatus.NOT_WHOLE
        if not self.option or table is None or table.runs or single != (Mode.SINGLE in table.mode):
            return LoadStatus.NO_ACCESS
        count = len(data) // (8 if single else 16)
        if not 2 <= count <= len(table.points):
            return LoadStatus.SIZE
        if not self.has("block_load") or self._library < version_of(DATA["elcam"]["library"]):
            return LoadStatus.NO_ADDRESS
        if self.faults.memory or table.in_computer:
            return LoadStatus.NO_MEMORY
        if self.faults.rebooted or self.faults.system:
            return LoadStatus.REBOOTED if self.faults.rebooted else LoadStatus.SYSTEM
        table.points[:count] = np.frombuffer(data, "<f4" if single else "<f8").reshape(-1, 2)
        table.size_master = table.size_follow = count
        return LoadStatus.OK

    def follow(self) -> dict[int, float]:
        """Return the target positions of all axes that follow a cam table now, by number."""
        found = {}
        for table in self.tables.values():
            if table.runs and self._memory_lost(table):
                table.mode &= ~Mode.RUN
                table.error |= Error.MEMORY
            elif table.leads:
                found[table.axis] = table.follow(*self._places(table))
        return found

    def compensation(self, axis: int) -> float:
        """Return an axis' present error to compensate: the sum of its active tables."""
        if not (self.compensating and self.has("compensation")):
            return 0.0
        return sum(
            table.compensation(*self._places(table)) for table in self.tables.values()
            if table.axis == axis and table.corrects
        )

    def _is_switch(self, what: Descriptor) -> bool:
        known = what.bus == DATA["elcam"]["bus"] and what.device == 0 and what.index == Function.COMPENSATION
        return known and self.has("compensation")

    def _function(self, what: Descriptor, kind: type, right: str) -> Function | None:
        """Return a descriptor's function for a call of this kind, or None."""
        if what.bus != DATA["elcam"]["bus"] or what.device != 1 or what.index < 0 or not self.option:
            return None
        if what.sub_index not in set(ACCESS):
            return None
        function = Function(what.sub_index)
        access = ACCESS[function]
        old = access.since != "" and not self.has(access.since)
        return None if access.kind is not kind or right not in access.rights or old else function

    def _write(self, to: Descriptor, value: Any, kind: type) -> CallStatus:
        function = self._function(to, kind, "w")
        if function is None or (not math.isfinite(value) and function is not Function.ADD_MASTER):
            return CallStatus.REFUSED
        table = self.tables.setdefault(to.index, CamTable())
        if table.runs and not ACCESS[function].while_running:
            return CallStatus.BUSY
        match function:
            case Function.ERROR:
                table.error = Error(0)
            case Function.RESET:
                table.clear()
            case Function.BUFFER_SIZE:
                return self._reserve(table, value)
            case Function.GAIN:
                table.change_gain(value, *(self._places(table) if table.runs else (0.0, 0.0)))
            case Function.SHIFT:
                table.base += value - table.shift
                table.shift = value
            case Function.MODE:
                return self._set_mode(table, value)
            case Function.ADD_MASTER:
                return CallStatus.OK if table.add_master(value) else CallStatus.REFUSED
            case Function.ADD_FOLLOW:
                return CallStatus.OK if table.add_follow(value) else CallStatus.REFUSED
            case Function.ROW_COUNT:
                if table.was_started or value < 0:
                    return CallStatus.REFUSED
                table.row_count = value
                table.set_bit(Mode.ROWS, value > 0)
            case Function.TABLE_SIZE:
                if not table.in_computer or not 0 <= value <= len(table.points):
                    return CallStatus.REFUSED
                table.size_master = table.size_follow = value
            case Function.COMPENSATION:
                table.marked = bool(value)
                table.set_bit(Mode.COMPENSATION, table.marked)
            case Function.INTERPOLATE_ROWS:
                table.set_bit(Mode.INTERPOLATE_ROWS, bool(value))
            case _:
                setattr(table, ACCESS[function].name, value)
        return CallStatus.OK

    def _read(self, of: Descriptor, kind: type) -> ObjectAnswer:
        function = self._function(of, kind, "r")
        if function is None:
            return ObjectAnswer(CallStatus.REFUSED, 0)
        table = self.tables.setdefault(of.index, CamTable())
        match function:
            case Function.TARGET_POSITION:
                return self._target_position(table)
            case Function.ERROR:
                value = self._error(table)
            case Function.RESET:
                value = 0
            case Function.BUFFER_SIZE:
                value = len(table.points)
            case Function.MODE:
                value = int(table.mode)
            case Function.COMPENSATION:
                value = int(table.marked and table.compensates)
            case Function.INTERPOLATE_ROWS:
                value = int(Mode.INTERPOLATE_ROWS in table.mode)
            case _:
                value = getattr(table, ACCESS[function].name)
        return ObjectAnswer(CallStatus.OK, value)

    def _error(self, table: CamTable) -> int:
        """Return the register ERROR; after points were entered, with the errors that would prevent a start."""
        entered = table.size_master + table.size_follow > 0
        return int(table.error | table.faults(len(self.axes)) if entered else table.error)

    def _reserve(self, table: CamTable, count: int) -> CallStatus:
        """Reserve memory for points, only once: in the control or in a block of the computer."""
        if len(table.points) or count < 1:
            return CallStatus.REFUSED
        size = count * 2 * np.dtype(table.dtype).itemsize
        if table.physical_address:
            piece = self.memory.at(table.physical_address)
            if piece is None or len(piece) < size:
                table.error |= Error.MEMORY
                return CallStatus.REFUSED
            table.points = np.frombuffer(piece, table.dtype, 2 * count).reshape(-1, 2)
            table.in_computer = True
            return CallStatus.OK
        taken = sum(other.points.nbytes for other in self.tables.values() if not other.in_computer)
        if taken + size > self.buffer_bytes:
            table.error |= Error.MEMORY
            return CallStatus.REFUSED
        table.points = np.zeros((count, 2), table.dtype)
        return CallStatus.OK

    def _set_mode(self, table: CamTable, value: int) -> CallStatus:
        """Write all bits of MODE; Run is set only for a table without an error, and for one table per follower."""
        new_mode = Mode(value) & KNOWN
        if (new_mode ^ table.mode) & Mode.SINGLE and len(table.points):
            return CallStatus.LOCKED
        if value & ~int(KNOWN) or (new_mode & _AUXILIARY and not self.has("auxiliary")):
            return CallStatus.REFUSED
        if table.runs and Mode.RUN in new_mode and (new_mode ^ table.mode) & Mode.COMPENSATION:
            return CallStatus.BUSY
        new_mode = new_mode & ~Mode.ROWS | table.mode & Mode.ROWS
        started = Mode.RUN in new_mode and not table.runs
        table.mode = new_mode & ~Mode.RUN | table.mode & new_mode & Mode.RUN
        return self._start(table) if started else CallStatus.OK

    def _start(self, table: CamTable) -> CallStatus:
        table.error |= table.faults(len(self.axes))
        if self._memory_lost(table):
            table.error |= Error.MEMORY
        rivals = [other for other in self.tables.values() if other.runs and other.axis == table.axis]
        if table.compensates:
            same_pair = any(other.compensates and other.master == table.master for other in rivals)
            refused = same_pair or not self.has("compensation")
        else:
            rivals = [other for other in rivals if not other.compensates]
            refused = bool(rivals) and not self.has("several_tables")
        if table.error or refused:
            return CallStatus.REFUSED
        if not table.compensates:
            for other in rivals:
                other.mode &= ~Mode.RUN
        table.mode |= Mode.RUN
        table.base, table.was_started, table.held, table.direction = table.shift, True, False, 0
        return CallStatus.OK

    def _target_position(self, table: CamTable) -> ObjectAnswer:
        if table.runs:
            return ObjectAnswer(CallStatus.BUSY, 0.0)
        if table.error or table.faults(len(self.axes)):
            return ObjectAnswer(CallStatus.REFUSED, 0.0)
        return ObjectAnswer(CallStatus.OK, table.follow(*self._places(table)))

    def _memory_lost(self, table: CamTable) -> bool:
        return table.in_computer and self.memory.at(table.physical_address) is None

    def _places(self, table: CamTable) -> tuple[float, float]:
        """Return the positions of a table's master and of the axis that chooses its row."""
        master = self._place(table.master, table.mode, Mode.ACTUAL, Mode.AUXILIARY)
        if table.row_count == 0:
            return master, 0.0
        return master, self._place(table.row_axis, table.mode, Mode.ACTUAL_ROW, Mode.AUXILIARY_ROW)

    def _place(self, number: int, mode: Mode, actual: Mode, auxiliary: Mode) -> float:
        axis = self.axes[number]
        if actual not in mode:
            return axis.setpoint
        return axis.auxiliary if auxiliary in mode and axis.auxiliary is not None else axis.actual
