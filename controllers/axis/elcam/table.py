"""A cam table: points of master and follower, in rows if a third axis selects among them, and its lookup.

>>> table = CamTable()
>>> table.points = np.array([(0.0, 0.0), (10.0, 5.0), (20.0, 0.0)])
>>> table.size_master = table.size_follow = 3
>>> table.curve(5.0), table.curve(25.0), table.curve(-5.0)
(2.5, 2.5, 2.5)
"""

import math
from bisect import bisect_right
from enum import IntEnum, IntFlag
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.axis.drive import data_of

# Functions of the object interface and bits of the registers: "G3-ElCam Interface" of the MCU-G3, tables 2 to 4.

DATA: dict[str, Any] = data_of("mcu_g3")  # tables of ``models/drives/mcu_g3.toml``


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
    ROW_START = 16  # that axis' position at row 0 (MLSTART, MasterLineStart)
    ROW_END = 17  # its position at the last row (MLEND, MasterLineEnd)
    ROW_COUNT = 18  # number of rows; 0 for a table without (MLCOUNT, MasterLineCount)
    TARGET_POSITION = 19  # present target of the follower (CALC TARGET POSITION)
    MEMORY_ADDRESS = 20
    TABLE_SIZE = 21  # points of a table in the computer's memory (SetTabSize)
    COMPENSATION = 30  # whether the table is one of errors to compensate (AxisCompensationMode)
    INTERPOLATE_ROWS = 31
    PHYSICAL_ADDRESS = 300


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
    ACTUAL_ROW = 1 << 2  # the same for the axis that chooses the row (RpModeLine)
    ROWS = 1 << 3  # set by the system: the table has rows (MultiDimTable)
    SINGLE = 1 << 4  # points are numbers of 32 bits (SinglePrecision)
    COMPENSATION = 1 << 5
    INTERPOLATE_ROWS = 1 << 6
    AUXILIARY = 1 << 7  # with ACTUAL: a stepper's own encoder is its actual value (AuxModeTable)
    AUXILIARY_ROW = 1 << 8


def cubic(xs: NDArray[Any], ys: NDArray[Any], k: int, share: float) -> float:
    """Return Hermite's cubic at a share of piece `k`, with Catmull and Rom's slopes for uneven points."""
    width = float(xs[k + 1]) - float(xs[k])
    y0, y1 = float(ys[k]), float(ys[k + 1])
    if width <= 0.0:
        return y0
    rise0 = _slope(xs, ys, k - 1, k + 1) * width if k > 0 else y1 - y0
    rise1 = _slope(xs, ys, k, k + 2) * width if k + 2 < len(xs) else y1 - y0
    away = 1.0 - share
    bend = share * away * (away * (rise0 - (y1 - y0)) - share * (rise1 - (y1 - y0)))
    return y0 + share * (y1 - y0) + bend


def _slope(xs: NDArray[Any], ys: NDArray[Any], a: int, b: int) -> float:
    width = float(xs[b]) - float(xs[a])
    return (float(ys[b]) - float(ys[a])) / width if width > 0.0 else 0.0


UNSET = -1  # number of an axis that is not set
_ROW_FAULTS = Error.ROW_SIZE | Error.ROW_START | Error.ROW_END | Error.ROW_AXIS


class CamTable:
    """One table; `cubic` and `reversal` are extensions.

    Attributes
    ----------
    cubic : bool
        Whether points are joined by cubics with the slopes of the points' neighbours instead of straight lines: the
        curve passes through every point, without steps in speed.
    reversal : float
        For compensation tables: error while the master moves up, less error while it moves down, in units of the
        follower. Half of it is added upwards and subtracted downwards.
    """

    def __init__(self) -> None:
        self.error, self.mode = Error(0), Mode(0)
        self.marked = False  # whether it is a table of errors, by function 30; that also sets the bit of MODE
        self.axis = self.master = self.row_axis = UNSET
        self.gain, self.phase, self.shift, self.base = 1.0, 0.0, 0.0, 0.0
        self.row_start = self.row_end = 0.0
        self.row_count = 0
        self.physical_address = 0
        self.cubic, self.reversal = False, 0.0
        # whether the master of a compensation table was beyond its ends since the last start
        self.held = False
        self.direction, self.last_master = 0, math.nan  # the master's, and its position at the last compensation
        self.clear()

    def clear(self) -> None:
        """Discard points, sizes, errors and Run; keep axes, gain, phase, shift, rows and the mark."""
        # (buffer size, 2): master and follower; entries from the sizes on are not set
        self.points: NDArray[Any] = np.zeros((0, 2))
        self.size_master = self.size_follow = 0
        self.error, self.mode = Error(0), self.mode & ~Mode.RUN
        self.was_started = self.in_computer = False

    @property
    def dtype(self) -> type[np.floating[Any]]:
        """Type of the numbers of points."""
        return np.float32 if Mode.SINGLE in self.mode else np.float64

    @property
    def runs(self) -> bool:
        """Whether the table is being followed."""
        return Mode.RUN in self.mode

    @property
    def compensates(self) -> bool:
        """Whether the follower's values are errors to compensate, by the bit of MODE."""
        return Mode.COMPENSATION in self.mode

    @property
    def corrects(self) -> bool:
        """Whether it acts as a table of errors: it runs, has the bit, and was marked by function 30 (chapter 3.1)."""
        return self.runs and self.compensates and self.marked

    @property
    def leads(self) -> bool:
        """Whether it acts as a cam; with only the mark, or only the bit, it does nothing."""
        return self.runs and not self.compensates and not self.marked

    def set_bit(self, bit: Mode, on: bool) -> None:
        """Set or clear a bit of MODE."""
        self.mode = self.mode | bit if on else self.mode & ~bit

    def add_master(self, value: float) -> bool:
        """Enter the next point of the master; a value that does not rise begins the next row, if any."""
        if self.size_master == len(self.points):
            self.error |= Error.SIZE_MASTER
            return False
        number = self.dtype(value)  # rounded as in the lookup
        last = self.points[self.size_master - 1, 0] if self.size_master else -math.inf
        if not math.isfinite(number) or (number <= last and self._rows_started() >= self.row_count):
            self.error |= Error.NOT_ASCENDING
            return False
        self.points[self.size_master, 0] = number
        self.size_master += 1
        return True

    def add_follow(self, value: float) -> bool:
        """Enter the next point of the follower."""
        if self.size_follow == len(self.points):
            self.error |= Error.SIZE_FOLLOW
            return False
        self.points[self.size_follow, 1] = value
        self.size_follow += 1
        return True

    def _rows_started(self) -> int:
        entered = self.points[: self.size_master, 0]
        return 1 + int(np.count_nonzero(entered[1:] <= entered[:-1]))

    def faults(self, axes: int) -> Error:
        """Return the errors that prevent a start, in addition to those in ``error``."""
        found = Error(0)
        if self.size_master != self.size_follow or self.size_master < 2:
            found |= Error.SIZE
        own_master = self.master == self.axis and not self.compensates
        if not (0 <= self.master < axes and 0 <= self.axis < axes) or own_master:
            found |= Error.MASTER
        if not np.isfinite(self.points[: self.size_master]).all():
            found |= Error.NOT_ASCENDING
        if self.row_count > 0:
            found |= self._row_faults(axes)
        return found | Error.ROW_TABLE if found & _ROW_FAULTS else found

    def _row_faults(self, axes: int) -> Error:
        found = Error(0)
        if not 0 <= self.row_axis < axes or (self.row_count > 1 and self.row_start == self.row_end):
            found |= Error.ROW_AXIS
        if self.size_master % self.row_count or self.size_master < 2 * self.row_count:
            return found | Error.ROW_SIZE
        rows = self.points[: self.size_master, 0].reshape(self.row_count, -1)
        if (rows[:, 0] != rows[0, 0]).any():
            found |= Error.ROW_START
        if (rows[:, -1] != rows[0, -1]).any():
            found |= Error.ROW_END
        return found

    def follow(self, master: float, row_place: float) -> float:
        """Return the follower's target at positions of the master and of the axis that chooses the row."""
        offset = self.base if self.runs else self.shift
        return offset + self.gain * self.curve(master - self.phase, row_place)

    def compensation(self, master: float, row_place: float) -> float:
        """Return the error to compensate, with the reversal for the master's direction; see `follow`."""
        if master != self.last_master:
            self.direction = (master > self.last_master) - (master < self.last_master)
            self.last_master = master
        return self.follow(master, row_place) + 0.5 * self.direction * self.reversal

    def change_gain(self, gain: float, master: float, row_place: float) -> None:
        """Change the gain; if the follower advances with each pass, without a jump at the present position."""
        if self.runs and self._adds_up():
            self.base += (self.gain - gain) * self.curve(master - self.phase, row_place)
        self.gain = gain

    def _adds_up(self) -> bool:
        per_row = self.size_master // max(self.row_count, 1)
        follow = self.points[: self.size_master, 1]
        return not self.compensates and bool((follow[::per_row] != follow[per_row - 1 :: per_row]).any())

    def curve(self, master: float, row_place: float = 0.0) -> float:
        """Return the table's value, without gain, phase and shift."""
        low, high, share = self._rows_at(row_place)
        value = self._row(low, master)
        return value if share == 0.0 else value + share * (self._row(high, master) - value)

    def _rows_at(self, place: float) -> tuple[int, int, float]:
        """Return the rows on both sides of a position of their axis, and the share of the second row."""
        last = self.row_count - 1
        if last < 1:
            return 0, 0, 0.0
        at = (place - self.row_start) / (self.row_end - self.row_start) * last
        at = min(max(at, 0.0), float(last))
        if Mode.INTERPOLATE_ROWS not in self.mode:
            nearest = math.floor(at + 0.5)
            return nearest, nearest, 0.0
        low = min(int(at), last - 1)
        return low, low + 1, at - low

    def _row(self, row: int, x: float) -> float:
        """Return a row's value at a position, by bisection; it is finite even if the points are not in order."""
        count = self.size_master // max(self.row_count, 1)
        rows = self.points[row * count : (row + 1) * count]
        xs, ys = rows[:, 0], rows[:, 1]
        first, last = float(xs[0]), float(xs[-1])
        passes = 0
        if self.compensates:
            self.held = self.held or not first <= x <= last
            x = min(max(x, first), last)
        elif last > first:
            turns = (x - first) / (last - first)
            if math.isfinite(turns):  # if not, the range is too small or too large for floats: use the ends
                passes = math.floor(turns)
                x -= passes * (last - first)
        k = min(max(bisect_right(xs, x) - 1, 0), count - 2)
        y0, y1, width = float(ys[k]), float(ys[k + 1]), float(xs[k + 1]) - float(xs[k])
        share = min(max((x - float(xs[k])) / width, 0.0), 1.0) if width > 0.0 else 0.0
        value = cubic(xs, ys, k, share) if self.cubic else y0 + share * (y1 - y0)
        return value + passes * (float(ys[-1]) - float(ys[0]))
