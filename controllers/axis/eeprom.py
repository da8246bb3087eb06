"""The code of a drive's words in its EEPROM: a checksum, and every half byte as an extended Hamming word.

Ten words make 42 bytes, so three banks of the UHU's parameters fill 126 of the ATtiny2313's 128 bytes. The manual
promises "checksum and forward error correction" without a layout (rows U-26, U-29, U-A24): the layout is ours. The
servo processor module stores its only bank in the same code (row M-A16).

>>> image = bytearray(encode([900, 24]))
>>> image[3] ^= 0x10
>>> decode(bytes(image))
Stored(words=(900, 24), corrected=1, valid=True)
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

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
