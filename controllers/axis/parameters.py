"""A drive's parameters by the names of their fields, stored in its record's registers.

>>> from edmsim.controllers.axis import make
>>> drive = make("uhu")
>>> drive.parameters["proportional_gain"] = 900
>>> drive.parameters["proportional_gain"]
900
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, MutableMapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.axis.drive import Screw, axis_row
from edmsim.errors import InputError


def by_name(values: Mapping[str, float], table: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    """Return values by name that are given by name or letter; an unknown name is returned as it is."""
    names = {row["letter"]: row["name"] for row in table}
    found: dict[str, Any] = {names.get(key.upper(), key): value for key, value in values.items()}
    return found


def tuned_values(
    data: Mapping[str, Any], what: str, axis: str, changes: Mapping[str, float], screw: Screw | None
) -> dict[str, int]:
    """Return by name the parameters that a drive's file has for an axis, some of them changed, for a screw."""
    tuned = data["tuned"]
    if axis not in tuned:
        raise InputError(f"no {what} is tuned for an axis {axis!r}; there are: {', '.join(tuned)}")
    fitted = {} if screw is None else {"step_multiplier": max(round(screw.counts_of(axis_row(axis))) - 1, 0)}
    return {**tuned[axis], **fitted, **by_name(changes, data["parameter"])}


def law_with(law: Mapping[str, Any], changes: Mapping[str, int], what: str) -> dict[str, Any]:
    """Return a drive's settings not in its manual, with changes."""
    if unknown := sorted(changes.keys() - law.keys()):
        raise InputError(f"the law of the {what} has no {unknown[0]!r}; it has {', '.join(law)}")
    return {**law, **changes}


class HasRecord(Protocol):
    """Owner of a drive's record; a plant replaces the first record by its own row."""

    record: NDArray[np.void]


class Registers(MutableMapping[str, int]):
    """Registers of a drive's record by name; `places` has of each its number and its least and largest value."""

    def __init__(self, owner: HasRecord, places: Mapping[str, tuple[int, int, int]]) -> None:
        self._owner, self._places = owner, dict(places)

    def __getitem__(self, name: str) -> int:
        return int(self._reg[self._place(name)[0]])

    def __setitem__(self, name: str, value: int) -> None:
        place, low, high = self._place(name)
        if not low <= value <= high or value != int(value):
            raise InputError(f"the drive's {name} is {value}; it must be a whole number {low} to {high}")
        self._reg[place] = int(value)

    def __delitem__(self, name: str) -> None:
        raise InputError(f"the drive's {name} cannot be taken away; set it to another value")

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)

    @property
    def _reg(self) -> NDArray[np.int64]:
        registers: NDArray[np.int64] = self._owner.record["reg"][0]
        return registers

    def _place(self, name: str) -> tuple[int, int, int]:
        if name not in self._places:
            raise InputError(f"the drive has no {name!r}; it has {', '.join(self._places)}")
        return self._places[name]
