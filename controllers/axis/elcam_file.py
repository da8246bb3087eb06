"""Compensation files: tables of a machine's errors as TOML, loaded into ELCAM through its object interface.

::

    [[table]]
    axis = "x"                       # whose error it is
    master = "x"                     # along which it was measured: its own travel, or another axis'
    points = [[0.0, -1.5], [5.0, 2.0]]   # mm and um: what the axis indicates less where it truly is
    reversal_um = 4.0                # if wanted: by how much the error is greater upwards than downwards
    cubic = true                     # if wanted: a curve between the points in place of straight lines
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

from edmsim.controllers.axis.elcam import CamPlace, Elcam
from edmsim.controllers.axis.elcam_registers import DATA, CallStatus, Descriptor, Error, Function, Mode
from edmsim.errors import InputError
from edmsim.given_numbers import real

NAMES = "x", "y", "u", "v"
"""Axes in the order of their numbers."""
_KEYS = {"axis", "master", "points", "reversal_um", "cubic"}


@dataclass(frozen=True)
class ErrorTable:
    """Errors of one axis along an axis.

    Attributes
    ----------
    axis, master : str
        Of `NAMES`.
    points : float64 array (n, 2)
        Place of the master in mm, and the error in um: what the axis indicates less where it truly is.
    reversal_um : float
        By how much the error is greater while the master moves up than while it moves down.
    cubic : bool
        Whether a curve joins the points in place of straight lines.
    """

    axis: str
    master: str
    points: NDArray[np.float64]
    reversal_um: float = 0.0
    cubic: bool = False


def read_tables(file: str | Path) -> list[ErrorTable]:
    """Read a compensation file.

    Raises
    ------
    InputError
        It cannot be read, or a table in it is none: which one, and what would be right.
    """
    try:
        data = tomllib.loads(Path(file).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read: {error}", file) from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"not valid TOML: {error}", file) from None
    tables = data.get("table")
    if not isinstance(tables, list) or not tables:
        raise InputError("a compensation file has one section [[table]] or more; there is none", file)
    return [_table(number, given, file) for number, given in enumerate(tables, 1)]


def _table(number: int, given: Mapping[str, Any], file: str | Path) -> ErrorTable:
    def refuse(reason: str) -> InputError:
        return InputError(f"table {number}: {reason}", file)

    wrong = sorted(given.keys() - _KEYS)
    if wrong:
        raise refuse(f"unknown key {wrong[0]!r}; there are: {', '.join(sorted(_KEYS))}")
    for key in ("axis", "master"):
        if given.get(key) not in NAMES:
            raise refuse(f"{key} is {given.get(key)!r}; it must be one of {', '.join(NAMES)}")
    pairs = given.get("points")
    if not isinstance(pairs, list) or len(pairs) < 2 or any(not _is_pair(pair) for pair in pairs):
        raise refuse("points must be two or more pairs of numbers, [mm, um]")
    if not all(_is_finite(value) for pair in pairs for value in pair):
        raise refuse("points must be finite numbers")
    points = np.array(pairs, np.float64)
    rising = np.diff(points[:, 0]) > 0
    if not rising.all():
        k = int(np.argmin(rising))
        raise refuse(f"places must rise, but {points[k + 1, 0]:g} mm follows {points[k, 0]:g} mm")
    reversal_um = given.get("reversal_um", 0.0)
    if real(reversal_um) is None or not _is_finite(reversal_um):
        raise refuse(f"reversal_um is {reversal_um!r}; it must be a number")
    cubic = given.get("cubic", False)
    if not isinstance(cubic, bool):
        raise refuse(f"cubic is {cubic!r}; it must be true or false")
    return ErrorTable(given["axis"], given["master"], points, float(reversal_um), cubic)


def _is_pair(pair: object) -> bool:
    return isinstance(pair, list) and len(pair) == 2 and all(real(value) is not None for value in pair)


def _is_finite(value: float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number of hundreds of digits
        return False


def text_of(tables: Iterable[ErrorTable], comments: Sequence[str] = ()) -> str:
    """Return tables as the text of a compensation file, comments first."""
    lines = [f"# {line}".rstrip() for line in comments]
    for table in tables:
        lines += ["", "[[table]]", f'axis = "{table.axis}"', f'master = "{table.master}"']
        if table.reversal_um:
            lines.append(f"reversal_um = {table.reversal_um:.3f}")
        if table.cubic:
            lines.append("cubic = true")
        lines += ["points = [", *(f"    [{x:.6f}, {y:.3f}]," for x, y in table.points.tolist()), "]"]
    return "\n".join(lines) + "\n"


def load_tables(tables: Sequence[ErrorTable], file: str | Path | None = None) -> Elcam:
    """Load error tables into an ELCAM of four axes in mm, and switch the compensation on.

    Parameters
    ----------
    tables : sequence of ErrorTable
    file : path, optional
        For messages.

    Raises
    ------
    InputError
        The control refuses a table: too many points, or a second one of the same axes.
    """
    elcam = Elcam([CamPlace() for _ in NAMES], buffer_bytes=DATA["elcam"]["most_bytes"])
    for index, table in enumerate(tables):
        at = elcam.at(index)
        at.write_int(Function.AXIS, NAMES.index(table.axis))
        at.write_int(Function.MASTER, NAMES.index(table.master))
        at.write_int(Function.BUFFER_SIZE, len(table.points))
        at.load((table.points * (1.0, 1e-3)).tobytes())
        at.write_int(Function.COMPENSATION, 1)
        started = at.write_int(Function.MODE, Mode.COMPENSATION | Mode.RUN)
        error = Error(int(at.read_int(Function.ERROR).value))
        if Error.MEMORY in error:
            many = len(table.points)
            raise InputError(f"table {index + 1}: {many} points are more than the control has room for", file)
        if started is not CallStatus.OK:
            twice = f"there is a table of {table.axis} along {table.master} already"
            raise InputError(f"table {index + 1}: {twice}", file)
        extensions = elcam.tables[index].extensions
        extensions.reversal, extensions.cubic = table.reversal_um * 1e-3, table.cubic
    elcam.write_int(Descriptor(DATA["elcam"]["bus"], 0, Function.COMPENSATION, 0), 1)
    return elcam
