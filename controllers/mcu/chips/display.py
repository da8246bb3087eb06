"""The 8279: 32 digits in two banks of sixteen, and 64 keys (row T-28). It was not connected in 1982.

A word of display memory holds a digit of either bank: bank A in the upper four bits, bank B in the lower. Keys lie in
eight columns by eight rows; a key counts after it is closed in a number of consecutive scans.
"""

from collections import deque

from edmsim.errors import InputError
from edmsim.snapshots import Snapshots

DIGITS, BANK = 32, 16
SHIFT, CTRL = 0x40, 0x80  # bits that the two shift keys add to a key's code, for up to four codes per key
KEYS = 64
SCAN_NS = 5_100_000  # duration of a scan of all keys at the chip's internal 100 kHz (data sheet of the 8279)
FIFO = 8
READ_KEYS, READ_DIGITS, WRITE_DIGITS, CLEAR = 0x40, 0x60, 0x80, 0xC0
"""Commands; the number of the word is added to the second and third, and 10H for automatic increment."""
_NEXT = 0x10
_COMMANDS = 0xE0
BLANK = 0xF  # blank digit: the 4511 decodes nothing above 9


class Kdc8279(Snapshots):
    """An 8279 with its digits and keys; a key must be closed for `debounce_scans` ("several"; ours: 3)."""

    STATE = ("_command", "lost", "_words", "_keys", "_scans")

    def __init__(self, debounce_scans: int = 3) -> None:
        self._needed = debounce_scans
        self._words = bytearray([BLANK << 4 | BLANK] * BANK)
        self._keys: deque[int] = deque()
        self._scans = dict[int, int]()
        self._command = READ_KEYS
        self.lost = 0

    @property
    def digits(self) -> list[int]:
        """The 32 digits: 0..9, or more for blank; bank A is 0..15."""
        return [word >> 4 for word in self._words] + [word & 0xF for word in self._words]

    @property
    def waiting(self) -> int:
        """Unread keys; the interrupt line is high while there are any."""
        return len(self._keys)

    def scan(self, closed: frozenset[int], shift: bool = False, ctrl: bool = False) -> bool:
        """Scan the keys (0..63: 8 times the column, plus the row); return whether one was accepted."""
        for key in closed:
            if not 0 <= key < KEYS:
                raise InputError(f"a key is 0..{KEYS - 1}, not {key!r}")
        self._scans = {key: self._scans.get(key, 0) + 1 for key in closed}
        new = [key for key, scans in sorted(self._scans.items()) if scans == self._needed]
        for key in new:
            if len(self._keys) == FIFO:
                self.lost += 1
            else:
                self._keys.append(key | SHIFT * shift | CTRL * ctrl)
        return bool(new)

    def read(self, offset: int) -> int:
        """Read data, a key or a word of digits by the last command, or at the odd address the status: unread keys."""
        if offset:
            return len(self._keys) & 7 | (len(self._keys) == FIFO) << 3 | bool(self.lost) << 5
        if self._command & _COMMANDS == READ_KEYS:
            return self._keys.popleft() if self._keys else 0xFF
        return self._words[self._place()]

    def write(self, offset: int, byte: int) -> None:
        """Write a command at the odd address; otherwise a word of both digits."""
        if offset == 0:
            if self._command & _COMMANDS == WRITE_DIGITS:
                self._words[self._place()] = byte
            return
        if byte & _COMMANDS == CLEAR:
            self._words[:] = bytes([BLANK << 4 | BLANK] * BANK)
            self._keys.clear()
            self._scans.clear()
            self.lost = 0
        elif byte & _COMMANDS in (READ_KEYS, READ_DIGITS, WRITE_DIGITS):
            self._command = byte
        elif byte & _COMMANDS:  # 000 sets the mode, which is fixed here
            raise InputError(f"command {byte:02X}H: this 8279 reads keys, reads and writes digits, and clears")

    def _place(self) -> int:
        """Return the index of the addressed word, and increment it if the command says so."""
        place = self._command & 0xF
        if self._command & _NEXT:
            self._command = self._command & 0xF0 | place + 1 & 0xF
        return place


def write_digit(chip: Kdc8279, digit: int, value: int) -> None:
    """Write digit 0..31 (0..15 are bank A), 0..9 or `BLANK`, without changing the other bank (row T-28)."""
    if not (0 <= digit < DIGITS and 0 <= value <= BLANK):
        raise InputError(f"there are digits 0..{DIGITS - 1} and values 0..{BLANK}, not {digit!r} and {value!r}")
    place = digit % BANK
    chip.write(1, READ_DIGITS | place)
    word = chip.read(0)
    word = value << 4 | word & 0x0F if digit < BANK else word & 0xF0 | value
    chip.write(1, WRITE_DIGITS | place)
    chip.write(0, word)
    chip.write(1, READ_KEYS)
