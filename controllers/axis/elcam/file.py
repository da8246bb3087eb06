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

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, AllowInfNan, BaseModel, Field, Strict, StrictBool, ValidationError

from edmsim.controllers.axis.elcam.module import BUFFER_VARIABLE, CallStatus, CamPlace, Descriptor, Elcam, TableAccess
from edmsim.controllers.axis.elcam.table import DATA, Error, Function, Mode
from edmsim.errors import InputError, invalid_entry, refuses_wrong_types
from edmsim.files import read_toml

NAMES = "x", "y", "u", "v"  # axes in the order of their numbers
PATH = "path"  # the wire's length of path in mm: for the control, an axis without a motor
PLACES = (*NAMES, PATH)  # possible masters of a table, in the order of the control's numbers
CAM_AXES = NAMES[2:]
_STEEPEST = 1.0  # greatest travel of a follower over its master's (ours), so it is no faster than the wire
_GREATEST_UM = 10_000.0  # greatest error of an axis (ours): far above any machine's, and within a table's travel


Real = Annotated[float, Strict(), AllowInfNan(False)]


def _rising(pairs: list[tuple[float, float]]) -> list[tuple[float, float]]:
    for (before, _), (place, _) in pairwise(pairs):
        if not place > before:
            raise ValueError(f"places must rise, but {place:g} mm follows {before:g} mm")
    return pairs


def _gentle(pairs: list[tuple[float, float]]) -> list[tuple[float, float]]:
    for (before, error_um), (place, next_um) in pairwise(pairs):
        if abs(next_um - error_um) > 1e3 * _STEEPEST * (place - before):
            raise ValueError(
                f"the error changes by {abs(next_um - error_um):g} um from {before:g} to {place:g} mm; it must be at "
                f"most {1e3 * _STEEPEST:g} um for each mm"
            )
    return pairs


Micrometres = Annotated[Real, Field(ge=-_GREATEST_UM, le=_GREATEST_UM)]
Points = Annotated[list[tuple[Real, Real]], Field(min_length=2), AfterValidator(_rising)]
Errors = Annotated[
    list[tuple[Real, Micrometres]], Field(min_length=2), AfterValidator(_rising), AfterValidator(_gentle)
]


class _Section(BaseModel, extra="forbid", frozen=True):
    """A section of a file; its fields are the keys."""

    axis: Literal["x", "y", "u", "v"]
    master: Literal["x", "y", "u", "v", "path"]
    cubic: StrictBool = False


class _Line(_Section, frozen=True):
    """Errors along the master."""

    reversal_um: Micrometres = 0.0
    points: Errors

    def read(self) -> ErrorTable:
        return ErrorTable(self.axis, self.master, np.array(self.points), self.reversal_um, self.cubic)


class _Grid(_Section, frozen=True):
    """Errors along the master and a third axis."""

    reversal_um: Micrometres = 0.0
    row_axis: Literal["x", "y", "u", "v", "path"]
    row_range_mm: tuple[Real, Real]
    interpolate_rows: StrictBool = False
    rows: Annotated[list[Errors], Field(min_length=1)]

    def read(self) -> ErrorTable:
        first_mm, last_mm = self.row_range_mm
        if len(self.rows) > 1 and first_mm == last_mm:
            raise InputError(f"row_range_mm is {first_mm:g} to {last_mm:g}: the rows must begin and end apart")
        from_mm, to_mm, expected = self.rows[0][0][0], self.rows[0][-1][0], len(self.rows[0])
        for number, row in enumerate(self.rows, 1):
            if (row[0][0], row[-1][0], len(row)) != (from_mm, to_mm, expected):
                raise InputError(
                    f"row {number} has {len(row)} points from {row[0][0]:g} to {row[-1][0]:g} mm; the first one has "
                    f"{expected} from {from_mm:g} to {to_mm:g} mm, and all must be alike"
                )
        apart_mm = abs(last_mm - first_mm) / max(len(self.rows) - 1, 1)
        for number, two in enumerate(pairwise(map(np.array, self.rows)), 1):
            places = np.unique([row[:, 0] for row in two])
            change_um = np.abs(np.subtract(*(np.interp(places, *row.T) for row in two))).max()
            if change_um > 1e3 * _STEEPEST * apart_mm:
                raise InputError(
                    f"the error changes by {change_um:g} um from row {number} to the next, {apart_mm:g} mm further; "
                    f"it must be at most {1e3 * _STEEPEST:g} um for each mm"
                )
        rows = TableRows(self.row_axis, first_mm, last_mm, len(self.rows), self.interpolate_rows)
        return ErrorTable(self.axis, self.master, np.concatenate(self.rows), self.reversal_um, self.cubic, rows)


class _Motion(_Section, frozen=True):
    master: Literal["x", "y", "path"]
    points: Points

    def read(self) -> Cam:
        if self.axis not in CAM_AXES:
            raise InputError(
                f"the program moves {self.axis}, and an axis that follows a cam takes no travel commands; axis must "
                f"be one of {', '.join(CAM_AXES)}"
            )
        cam = Cam(self.axis, self.master, np.array(self.points), self.cubic)
        slope = np.diff(cam.points[:, 1]) / np.diff(cam.points[:, 0])
        k = int(np.argmax(np.abs(slope)))
        if abs(slope[k]) > _STEEPEST:
            raise InputError(
                f"{cam.axis} moves {abs(slope[k]):g} mm for each mm of {cam.master} after {cam.points[k, 0]:g} mm; "
                f"it must be at most {_STEEPEST:g}"
            )
        return cam


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
    reversal_um: float = 0.0  # error while the master moves up, minus error while it moves down
    cubic: bool = False  # whether a curve joins the points instead of straight lines
    rows: TableRows | None = None  # selector of the row of points


@dataclass(frozen=True)
class Cam:
    """Motion of an axis of `CAM_AXES` over x, y or the path: ``points`` (n, 2), both in mm."""

    axis: str
    master: str  # one of `PLACES`
    points: NDArray[np.float64]
    cubic: bool = False


@refuses_wrong_types
def read_tables(file: str | Path) -> list[ErrorTable | Cam]:
    """Read a file of tables.

    Raises
    ------
    InputError
        The file cannot be read, or a table is invalid; the message names it and valid values.
    """
    data = read_toml(file)
    found: list[ErrorTable | Cam] = []
    for kind in ("table", "cam"):
        sections = data.pop(kind, [])
        if not isinstance(sections, list) or any(not isinstance(section, dict) for section in sections):
            raise InputError(f"a compensation file has one section [[{kind}]] or more, not this {kind}", file)
        found += [_read(kind, section, f"{kind} {number}", file) for number, section in enumerate(sections, 1)]
    if data:
        raise InputError(f"unknown section {next(iter(data))!r}; there are: [[table]], [[cam]]", file)
    if not found:
        raise InputError("no section: a compensation file has one section [[table]] or [[cam]] or more", file)
    return found


def _read(kind: str, section: dict[str, Any], name: str, file: str | Path) -> ErrorTable | Cam:
    model: type[_Line | _Grid | _Motion] = _Motion if kind == "cam" else _Grid if "rows" in section else _Line
    try:
        return model.model_validate(section).read()
    except ValidationError as error:
        raise InputError(f"{name}: {invalid_entry(error)}", file) from None
    except InputError as error:
        raise InputError(f"{name}: {error.reason}", file) from None


@refuses_wrong_types
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


@refuses_wrong_types
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
        elcam.tables[index].cubic = table.cubic
        if isinstance(table, ErrorTable):
            elcam.tables[index].reversal = table.reversal_um * 1e-3
    elcam.write_int(Descriptor(DATA["elcam"]["bus"], 0, Function.COMPENSATION, 0), 1)
    return elcam


def _load(at: TableAccess, table: ErrorTable | Cam) -> CallStatus:
    """Write a table's settings in the document's order (chapter 2.6), and start it."""
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
