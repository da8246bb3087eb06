"""A drive's parameters by the names of their fields, kept in the registers of its record.

>>> from edmsim.controllers.axis import make
>>> drive = make("uhu")
>>> drive.parameters["proportional_gain"] = 900
>>> drive.parameters["proportional_gain"]
900
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, MutableMapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError


class HasRecord(Protocol):
    """What has a drive's record; a plant puts its own row in place of the first one."""

    record: NDArray[np.void]


class Registers(MutableMapping[str, int]):
    """Some registers of a drive's record, by name.

    Parameters
    ----------
    owner : object with a record
        The drive: asked for its record at every access.
    places : mapping of str to int
        Register of each name.
    low, high : int
        What a register takes.

    Raises
    ------
    InputError
        A name is unknown, or a value is no whole number from `low` to `high`.
    """

    def __init__(self, owner: HasRecord, places: Mapping[str, int], low: int = 0, high: int = 65535) -> None:
        self._owner, self._places, self._low, self._high = owner, dict(places), low, high

    def __getitem__(self, name: str) -> int:
        return int(self._owner.record["reg"][0, self._place(name)])

    def __setitem__(self, name: str, value: int) -> None:
        place = self._place(name)
        if value != int(value) or not self._low <= value <= self._high:
            raise InputError(f"the drive's {name} is {value}; it must be a whole number {self._low} to {self._high}")
        self._owner.record["reg"][0, place] = int(value)

    def __delitem__(self, name: str) -> None:
        raise InputError(f"the drive's {name} cannot be taken away; set it to another value")

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)

    def _place(self, name: str) -> int:
        if name not in self._places:
            raise InputError(f"the drive has no {name!r}; it has {', '.join(self._places)}")
        return self._places[name]
