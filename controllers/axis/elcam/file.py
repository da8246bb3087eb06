"""TOML files of ELCAM tables: errors of a machine's axes, and cams for its upper guide.

::

    [[table]]                        # errors to compensate
    axis = "x"                       # the axis with the error
    master = "x"                     # the error depends on this axis or the path
    points = [[0.0, -1.5], [5.0, 2.0]]   # mm and um: indicated less true position
    reversal_um = 4.0                # optional: error upwards less error downwards
    cubic = true                     # optional: a curve between points instead of straight lines

    [[table]]                        # errors that also depend on a third axis: rows instead of points
    axis = "y"
    master = "x"
    row_axis = "y"                   # an axis or the path, which selects the row
    row_range_mm = [0.0, 65.0]       # its position at the first and the last row
    interpolate_rows = true          # optional: interpolate linearly between rows; by default the nearest row
    rows = [[[0.0, 0.0], [65.0, 9.0]], [[0.0, 0.0], [65.0, 3.0]]]

    [[cam]]                          # motion of an axis of the upper guide
    axis = "u"
    master = "path"                  # the length of path, x or y
    points = [[0.0, 0.0], [2.0, 0.1]]    # mm and mm
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.axis.elcam.module import BUFFER_VARIABLE, CamPlace, Elcam, TableAccess
from edmsim.controllers.axis.elcam.registers import DATA, CallStatus, Descriptor, Error, Function, Mode
from edmsim.errors import InputError
from edmsim.numeric import real

NAMES = "x", "y", "u", "v"  # axes in the order of their numbers
PATH = "path"  # the length of path behind the wire, in mm: the control has it as an axis that nothing moves
PLACES = (*NAMES, PATH)  # what a table can look up, in the order of the control's numbers
CAM_AXES, CAM_MASTERS = NAMES[2:], ("x", "y", PATH)
_STEEPEST = 1.0  # travel of a follower over that of its master, at most (ours): it then is no faster than the wire


class _Section:
    """A parsed section of a file; its name is for messages, such as ``table 2``."""

    def __init__(self, name: str, values: Mapping[str, Any], file: str | Path) -> None:
        self._name, self._values, self._file = name, values, file

    def __contains__(self, key: str) -> bool:
        """Tell whether something is given."""
        return key in self._values

    def refuse(self, reason: str) -> InputError:
        """Return the error that names the section."""
        return InputError(f"{self._name}: {reason}", self._file)

    def check_keys(self, *known: str) -> None:
        """Refuse an unknown key."""
        wrong = sorted(self._values.keys() - set(known))
        if wrong:
            raise self.refuse(f"unknown key {wrong[0]!r}; there are: {', '.join(sorted(known))}")

    def one_of(self, key: str, names: Sequence[str]) -> str:
        """Return a name."""
        found = self._values.get(key)
        if found not in names:
            raise self.refuse(f"{key} is {found!r}; it must be one of {', '.join(names)}")
        return str(found)

    def number(self, key: str) -> float:
        """Return a number, 0 if it is not given."""
        found = self._values.get(key, 0.0)
        if not _is_finite_number(found):
            raise self.refuse(f"{key} is {found!r}; it must be a number")
        return float(found)

    def flag(self, key: str) -> bool:
        """Return whether something is wanted; it is not if it is not given."""
        found = self._values.get(key, False)
        if not isinstance(found, bool):
            raise self.refuse(f"{key} is {found!r}; it must be true or false")
        return found

    def range(self, key: str) -> tuple[float, float]:
        """Return two places."""
        found = self._values.get(key)
        if not isinstance(found, list) or len(found) != 2 or not all(map(_is_finite_number, found)):
            raise self.refuse(f"{key} is {found!r}; it must be two numbers, [mm, mm]")
        return float(found[0]), float(found[1])

    def points(self, unit: str) -> NDArray[np.float64]:
        """Return the points (n, 2); `unit` is that of their second numbers."""
        return self._points("points", self._values.get("points"), unit)

    def rows(self, unit: str) -> list[NDArray[np.float64]]:
        """Return the points of each row."""
        found = self._values["rows"]
        if not isinstance(found, list) or not found:
            raise self.refuse("rows must be one row or more, each a list of points")
        return [self._points(f"row {number}", row, unit) for number, row in enumerate(found, 1)]

    def _points(self, what: str, pairs: Any, unit: str) -> NDArray[np.float64]:
        if not isinstance(pairs, list) or len(pairs) < 2 or any(not _is_pair(pair) for pair in pairs):
            raise self.refuse(f"{what} must be two or more pairs of numbers, [mm, {unit}]")
        if not all(_is_finite(value) for pair in pairs for value in pair):
            raise self.refuse(f"{what} must be finite numbers")
        points = np.array(pairs, np.float64)
        rising = np.diff(points[:, 0]) > 0
        if not rising.all():
            k = int(np.argmin(rising))
            raise self.refuse(f"places must rise, but {points[k + 1, 0]:g} mm follows {points[k, 0]:g} mm in {what}")
        return points


def _is_number(value: object) -> bool:
    return real(value) is not None


def _is_pair(pair: object) -> bool:
    return isinstance(pair, list) and len(pair) == 2 and all(map(_is_number, pair))


def _is_finite_number(value: Any) -> bool:
    return _is_number(value) and _is_finite(value)


def _is_finite(value: float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number of hundreds of digits
        return False


@dataclass(frozen=True)
class TableRows:
    """Selector of a table's row: one of `PLACES`, and its position in mm at the first and the last row."""

    axis: str
    first_mm: float
    last_mm: float
    count: int
    interpolated: bool


@dataclass(frozen=True)
class ErrorTable:
    """Errors of one axis along an axis or the path."""

    # axis, master: one of `NAMES`; one of `PLACES`
    axis: str
    master: str
    # (n, 2): position of the master in mm, and error in um (indicated less true position of the axis), row after row
    points: NDArray[np.float64]
    reversal_um: float = 0.0  # error while the master moves up, less error while it moves down
    cubic: bool = False  # whether a curve joins the points instead of straight lines
    rows: TableRows | None = None  # selector of the row of points


@dataclass(frozen=True)
class Cam:
    """Motion of an axis of `CAM_AXES` over a master of `CAM_MASTERS`: ``points`` (n, 2), both in mm."""

    axis: str
    master: str
    points: NDArray[np.float64]
    cubic: bool = False


def read_tables(file: str | Path) -> list[ErrorTable | Cam]:
    """Read a file of tables.

    Raises
    ------
    InputError
        The file cannot be read, or a table is invalid; the message names it and valid values.
    """
    try:
        data = tomllib.loads(Path(file).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read: {error}", file) from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"not valid TOML: {error}", file) from None
    found: list[ErrorTable | Cam] = []
    for kind, read in (("table", _error_table), ("cam", _cam)):
        sections = data.pop(kind, [])
        if not isinstance(sections, list) or any(not isinstance(section, dict) for section in sections):
            raise InputError(f"a compensation file has one section [[{kind}]] or more, not this {kind}", file)
        found += [read(_Section(f"{kind} {number}", section, file)) for number, section in enumerate(sections, 1)]
    if data:
        raise InputError(f"unknown section {next(iter(data))!r}; there are: [[table]], [[cam]]", file)
    if not found:
        raise InputError("no section: a compensation file has one section [[table]] or [[cam]] or more", file)
    return found


def _error_table(section: _Section) -> ErrorTable:
    shape = ("rows", "row_axis", "row_range_mm", "interpolate_rows") if "rows" in section else ("points",)
    section.check_keys("axis", "master", "reversal_um", "cubic", *shape)
    axis, master = section.one_of("axis", NAMES), section.one_of("master", PLACES)
    points, rows = (section.points("um"), None) if "points" in shape else _rows(section)
    return ErrorTable(axis, master, points, section.number("reversal_um"), section.flag("cubic"), rows)


def _rows(section: _Section) -> tuple[NDArray[np.float64], TableRows]:
    lines = section.rows("um")
    axis = section.one_of("row_axis", PLACES)
    first_mm, last_mm = section.range("row_range_mm")
    if len(lines) > 1 and first_mm == last_mm:
        raise section.refuse(f"row_range_mm is {first_mm:g} to {last_mm:g}: the rows must begin and end apart")
    for number, line in enumerate(lines, 1):
        ends = [line[0, 0], line[-1, 0], len(line)]
        expected = [lines[0][0, 0], lines[0][-1, 0], len(lines[0])]
        if ends != expected:
            raise section.refuse(
                f"row {number} has {ends[2]} points from {ends[0]:g} to {ends[1]:g} mm; the first one has "
                f"{expected[2]} from {expected[0]:g} to {expected[1]:g} mm, and all must be alike"
            )
    rows = TableRows(axis, first_mm, last_mm, len(lines), section.flag("interpolate_rows"))
    return np.concatenate(lines), rows


def _cam(section: _Section) -> Cam:
    section.check_keys("axis", "master", "points", "cubic")
    axis = section.one_of("axis", NAMES)
    if axis not in CAM_AXES:
        raise section.refuse(
            f"the program moves {axis}, and an axis that follows a cam takes no travel commands; axis must be one of "
            f"{', '.join(CAM_AXES)}"
        )
    cam = Cam(axis, section.one_of("master", CAM_MASTERS), section.points("mm"), section.flag("cubic"))
    slope = np.diff(cam.points[:, 1]) / np.diff(cam.points[:, 0])
    k = int(np.argmax(np.abs(slope)))
    if abs(slope[k]) > _STEEPEST:
        raise section.refuse(
            f"{cam.axis} moves {abs(slope[k]):g} mm for each mm of {cam.master} behind {cam.points[k, 0]:g} mm; "
            f"it must be at most {_STEEPEST:g}"
        )
    return cam


def text_of(tables: Iterable[ErrorTable], comments: Sequence[str] = ()) -> str:
    """Return tables as text of a compensation file, after the comments."""
    lines = [f"# {line}".rstrip() for line in comments]
    for table in tables:
        lines += ["", "[[table]]", f'axis = "{table.axis}"', f'master = "{table.master}"']
        if table.reversal_um:
            lines.append(f"reversal_um = {table.reversal_um:.3f}")
        if table.cubic:
            lines.append("cubic = true")
        points = [f"[{x:.6f}, {y:.3f}]," for x, y in table.points.tolist()]
        if table.rows is None:
            lines += ["points = [", *(f"    {point}" for point in points), "]"]
            continue
        rows, per_row = table.rows, len(points) // table.rows.count
        lines += [f'row_axis = "{rows.axis}"', f"row_range_mm = [{rows.first_mm:.6f}, {rows.last_mm:.6f}]"]
        if rows.interpolated:
            lines.append("interpolate_rows = true")
        each = (points[k : k + per_row] for k in range(0, len(points), per_row))
        lines += ["rows = [", *(f"    [{' '.join(row)}]," for row in each), "]"]
    return "\n".join(lines) + "\n"


def load_tables(tables: Sequence[ErrorTable | Cam], file: str | Path | None = None) -> Elcam:
    """Load tables into an ELCAM of four axes in mm and the path, start them, and switch compensation on.

    Parameters
    ----------
    tables : sequence of ErrorTable or Cam
    file : path, optional
        For errors.

    Raises
    ------
    InputError
        The control refuses a table: no room for its points, or a second one of the same axes.
    """
    elcam = Elcam([CamPlace() for _ in PLACES])
    numbers = {ErrorTable: 0, Cam: 0}
    for index, table in enumerate(tables):
        numbers[type(table)] += 1
        name = f"{'cam' if isinstance(table, Cam) else 'table'} {numbers[type(table)]}"
        rivals = [other for other in tables[:index] if isinstance(other, Cam) and other.axis == table.axis]
        if isinstance(table, Cam) and rivals:
            raise InputError(f"{name}: there is a cam of {table.axis} already", file)
        started = _load(elcam.at(index), table)
        if Error.MEMORY in Error(int(elcam.at(index).read_int(Function.ERROR).value)):
            raise InputError(
                f"{name}: {len(table.points)} points are more than the control has room for, which is "
                f"{elcam.buffer_bytes} bytes for all tables, 16 for a point; the environment variable "
                f"{BUFFER_VARIABLE} gives it up to {DATA['elcam']['most_bytes']}", file,
            )  # fmt: skip
        if started is not CallStatus.OK:
            raise InputError(f"{name}: there is a table of {table.axis} along {table.master} already", file)
        extensions = elcam.tables[index].extensions
        extensions.cubic = table.cubic
        if isinstance(table, ErrorTable):
            extensions.reversal = table.reversal_um * 1e-3
    elcam.write_int(Descriptor(DATA["elcam"]["bus"], 0, Function.COMPENSATION, 0), 1)
    return elcam


def _load(at: TableAccess, table: ErrorTable | Cam) -> CallStatus:
    """Set a table up in the document's order (chapter 2.6), and let it run."""
    mode, unit_mm = Mode.RUN, 1.0
    at.write_int(Function.AXIS, NAMES.index(table.axis))
    at.write_int(Function.MASTER, PLACES.index(table.master))
    at.write_int(Function.BUFFER_SIZE, len(table.points))
    if isinstance(table, ErrorTable):
        mode, unit_mm = mode | Mode.COMPENSATION, 1e-3
        at.write_int(Function.COMPENSATION, 1)
        if table.rows is not None:
            at.write_int(Function.ROW_COUNT, table.rows.count)
            at.write_int(Function.ROW_AXIS, PLACES.index(table.rows.axis))
            at.write_double(Function.ROW_START, table.rows.first_mm)
            at.write_double(Function.ROW_END, table.rows.last_mm)
            mode |= Mode.INTERPOLATE_ROWS if table.rows.interpolated else Mode(0)
    at.load((table.points * (1.0, unit_mm)).tobytes())
    return at.write_int(Function.MODE, mode)
