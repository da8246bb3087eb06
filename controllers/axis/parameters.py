"""A drive's parameters by the names of their fields, stored in its record's registers, and their code in its EEPROM.

>>> from edmsim.controllers.axis import make
>>> drive = make("uhu")
>>> drive.parameters["proportional_gain"] = 900
>>> drive.parameters["proportional_gain"]
900
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, MutableMapping, Sequence
from typing import Any, NamedTuple, Protocol

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


# The code of a drive's words in its EEPROM: a checksum, and every half byte as an extended Hamming word.
# Ten words make 42 bytes, so three banks of the UHU's parameters fill 126 of the ATtiny2313's 128 bytes. The manual
# promises "checksum and forward error correction" without a layout (rows U-26, U-29, U-A24): the layout is ours.
# The servo processor module stores its only bank in the same code (row M-A16).

WORD = 1 << 16  # words are 0 to 65535
_HALF_BITS = 4
_CHECKED = (0b1101, 0b1011, 0b0111)
"""Which of the four data bits each check bit of a Hamming (7,4) code covers; the eighth bit makes all eight even."""
_CORRECTABLE, _NOTED = 1, 2
"""Flipped bits of a code byte that are corrected, and that are noticed: the code's distance is four."""


class Stored(NamedTuple):
    """Content of an EEPROM."""

    words: tuple[int, ...] | None  # 0 to 65535; None where a code byte has more flipped bits than can be corrected
    corrected: int  # bits that were flipped and put right
    valid: bool  # whether all bytes could be read and the checksum is right


def _code_byte(half: int) -> int:
    checks = sum(((half & mask).bit_count() & 1) << (_HALF_BITS + k) for k, mask in enumerate(_CHECKED))
    return half | checks | ((half | checks).bit_count() & 1) << 7


_CODE = tuple(_code_byte(half) for half in range(1 << _HALF_BITS))


def _nearest(byte: int) -> tuple[int, int]:
    """Return the half byte whose code is nearest, and how many bits it is away."""
    away = [(byte ^ code).bit_count() for code in _CODE]
    return away.index(min(away)), min(away)


_DECODE = tuple(_nearest(byte) for byte in range(256))


def size_of(n_words: int) -> int:
    """Return the bytes that some words take in the EEPROM."""
    return 2 * (2 * n_words + 1)


def encode(words: Sequence[int], *, false_checksum: bool = False) -> bytes:
    """Return the EEPROM's code of words (0 to 65535); a new UHU has a false checksum (row U-28)."""
    plain = bytearray(itertools.chain.from_iterable(word.to_bytes(2, "big") for word in words))
    plain.append(_checksum(plain) ^ (0xFF if false_checksum else 0))
    return bytes(itertools.chain.from_iterable((_CODE[byte >> _HALF_BITS], _CODE[byte & 0xF]) for byte in plain))


def decode(image: bytes) -> Stored:
    """Read what `encode` wrote, whatever happened to it since."""
    halves = [_DECODE[byte] for byte in image]
    corrected = sum(away for _, away in halves if away == _CORRECTABLE)
    if any(away >= _NOTED for _, away in halves):
        return Stored(None, corrected, False)
    plain = bytes(high << _HALF_BITS | low for (high, _), (low, _) in zip(halves[::2], halves[1::2], strict=True))
    words = tuple(int.from_bytes(plain[k : k + 2], "big") for k in range(0, len(plain) - 1, 2))
    return Stored(words, corrected, _checksum(plain[:-1]) == plain[-1])


def _checksum(plain: bytes | bytearray) -> int:
    """Return the complement of the sum: an EEPROM of nothing but 00H or FFH is then not valid."""
    return ~sum(plain) & 0xFF
