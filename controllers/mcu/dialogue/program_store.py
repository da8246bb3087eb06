"""The program in RAM: moves and settings as bytes, where the monitor shows and alters them.

An entry is a kind and what belongs to it (ours): ``01`` x y is a straight move, ``02`` and ``03`` with x y and the
centre's x y are arcs clockwise and the other way round, words with the low byte first. ``10`` and more is a setting;
its three low bits say which of the codes of t(i) and t(p) and the speed, a word each, count. ``00`` ends the program.
"""

from __future__ import annotations

from collections.abc import Sequence

from edmsim.controllers.mcu.chips.bus import Bus
from edmsim.controllers.mcu.dialogue.part_program import Entry, Move, Setting
from edmsim.errors import InputError

END, STRAIGHT, CLOCKWISE, COUNTER_CLOCKWISE, SETTING = 0x00, 0x01, 0x02, 0x03, 0x10
_WORDS = {STRAIGHT: 2, CLOCKWISE: 4, COUNTER_CLOCKWISE: 4}


class ProgramStore:
    """Entries in memory.

    Parameters
    ----------
    memory : Bus
    first : int
        Address of the first entry's kind.
    most : int
        Entries that fit.
    """

    def __init__(self, memory: Bus, first: int, most: int) -> None:
        self._memory = memory
        self._first = first
        self._most = most

    def write(self, entries: Sequence[Entry]) -> None:
        """Put a program into memory."""
        data = b"".join(map(_bytes_of, entries)) + bytes([END])
        for offset, byte in enumerate(data):
            self._memory.write(self._first + offset, byte)

    def read(self) -> list[Entry]:
        """The program as it stands in memory.

        Raises
        ------
        InputError
            If the bytes are none.
        """
        entries: list[Entry] = []
        address = self._first
        while kind := self._memory.read(address):
            if len(entries) == self._most:
                raise InputError(f"the program at {self._first:04X}H has no end: 00H was overwritten")
            if kind in _WORDS:
                words = [self._memory.word(address + 1 + 2 * k) for k in range(_WORDS[kind])]
                centre = (words[2], words[3]) if len(words) == 4 else None
                entries.append(Move((words[0], words[1]), centre, kind == CLOCKWISE))
                address += 1 + 2 * len(words)
            elif kind & ~0x07 == SETTING:
                words = [self._memory.word(address + 1 + 2 * k) for k in range(3)]
                entries.append(Setting(*(word if kind >> k & 1 else None for k, word in enumerate(words))))
                address += 1 + 2 * len(words)
            else:
                raise InputError(f"the program's byte at {address:04X}H is {kind:02X}H, which begins no entry")
        return entries


def _bytes_of(entry: Entry) -> bytes:
    if isinstance(entry, Setting):
        kind = SETTING | sum((value is not None) << k for k, value in enumerate(entry))
        words = [value or 0 for value in entry]
    else:
        kind = STRAIGHT if entry.centre_um is None else CLOCKWISE if entry.clockwise else COUNTER_CLOCKWISE
        words = [*entry.end_um, *(entry.centre_um or ())]
    return bytes([kind]) + b"".join(word.to_bytes(2, "little") for word in words)
