"""A section of a file of ELCAM tables: its values, or one line about what is wrong with them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.numeric import real


class FileTable:
    """A section of a file.

    Parameters
    ----------
    name : str
        For messages, such as ``table 2``.
    values : mapping
        The parsed TOML.
    file : path
    """

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
