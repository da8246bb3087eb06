"""Numbers of the ELCAM module: functions of its object interface, bits of its registers, answers, versions.

Source: "G3-ElCam Interface" of the MCU-G3, tables 1 to 4 and chapter 2.7.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import Any, NamedTuple

from edmsim.controllers.axis.drive import data_of

DATA: dict[str, Any] = data_of("mcu_g3")  # tables of ``models/drives/mcu_g3.toml``


@dataclass(frozen=True)
class Descriptor:
    """An object's address."""

    bus: int  # 1200 for ELCAM
    device: int  # 1 for a table; 0 with index 30 for the switch of the compensation of all tables
    index: int  # number of the table, 0 or more, chosen by the user
    sub_index: int  # a `Function`


class Function(IntEnum):
    """Values of ``sub_index`` of a table's object (table 2); in brackets the document's name."""

    ERROR = 1
    RESET = 2
    BUFFER_SIZE = 3  # greatest number of points, those of all rows (BUFSIZE)
    AXIS = 4
    """Number of the axis that follows, or is compensated."""
    MASTER = 5
    GAIN = 6
    PHASE = 7  # shift of the points along the master (PHASE)
    SHIFT = 8  # shift of the points along the follower (SHIFT)
    MODE = 10
    ADD_MASTER = 11
    ADD_FOLLOW = 12
    SIZE_MASTER = 13
    SIZE_FOLLOW = 14
    ROW_AXIS = 15  # number of the axis that chooses the row (MLAXIS)
    ROW_START = 16  # its place at row 0 (MLSTART, MasterLineStart)
    ROW_END = 17  # its place at the last row (MLEND, MasterLineEnd)
    ROW_COUNT = 18  # number of rows; 0 for a table without (MLCOUNT, MasterLineCount)
    TARGET_POSITION = 19  # where the follower ought to be now (CALC TARGET POSITION)
    MEMORY_ADDRESS = 20
    TABLE_SIZE = 21  # points of a table in the computer's memory (SetTabSize)
    COMPENSATION = 30  # whether the table is one of errors to compensate (AxisCompensationMode)
    INTERPOLATE_ROWS = 31
    PHYSICAL_ADDRESS = 300


class Access(NamedTuple):
    """How a function is called."""

    kind: type[int] | type[float]
    rights: str  # of "r" and "w"
    name: str = ""  # attribute of `CamTable` that it reads, and writes unless the module does more; empty for none
    while_running: bool = False  # whether it is written while the table runs (ours: only rows are forbidden there)
    since: str = ""  # key in the data of the version from which on the firmware has it; empty for all


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


class Error(IntFlag):
    """Bits of the register ERROR (table 3)."""

    MEMORY = 1 << 8
    SIZE = 1 << 9
    SIZE_MASTER = 1 << 10
    SIZE_FOLLOW = 1 << 11
    MASTER = 1 << 12
    NOT_ASCENDING = 1 << 13
    ROW_TABLE = 1 << 14
    ROW_AXIS = 1 << 15
    ROW_SIZE = 1 << 16
    ROW_START = 1 << 17
    ROW_END = 1 << 18


class Mode(IntFlag):
    """Bits of the register MODE (table 4)."""

    RUN = 1
    ACTUAL = 1 << 1  # the master's actual value is looked up, not its setpoint (RpModeTable)
    ACTUAL_ROW = 1 << 2  # the same of the axis that chooses the row (RpModeLine)
    ROWS = 1 << 3  # set by the system: the table has rows (MultiDimTable)
    SINGLE = 1 << 4  # points are numbers of 32 bits (SinglePrecision)
    COMPENSATION = 1 << 5
    INTERPOLATE_ROWS = 1 << 6
    AUXILIARY = 1 << 7  # with ACTUAL: a stepper's own encoder is its actual value (AuxModeTable)
    AUXILIARY_ROW = 1 << 8


KNOWN = Mode(0x1FF)  # all bits of MODE


class CallStatus(IntEnum):
    """Status of a call of the object interface; all but BUSY and LOCKED are ours."""

    OK = 0
    REFUSED = 1  # no such object or right, an invalid number, or what its register forbids; nothing has changed
    BUSY = 2  # not while the table runs
    LOCKED = 16  # "Error 10 hex": the precision cannot change any more


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
