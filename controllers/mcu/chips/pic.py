"""The 8259: eight interrupt requests in order of priority, and their jump table.

It is set up for the 8085: it answers an acknowledge with a call into a table of eight entries of four bytes, which
the program puts at 3FE0H..3FFFH (row T-48). Priorities (row T-45): emergency, steppers, keyboard.
"""

from edmsim.errors import InputError
from edmsim.snapshots import Snapshots

EMERGENCY, X_STEPPER, Y_STEPPER, KEYBOARD = range(4)  # levels: the order is the document's, the numbers are ours
SPURIOUS = 7  # level of a request that ended before it was acknowledged
ENTRY_BYTES = 4
JUMP_TABLE = 0x3FE0
ICW1 = 0x16 | JUMP_TABLE & 0xE0
"""First word of initialisation: edge-triggered, entries of four bytes, one chip, low byte of the table."""
ICW2 = JUMP_TABLE >> 8
END_OF_INTERRUPT = 0x20


class Pic8259(Snapshots):
    """A single 8259."""

    STATE = ("_table", "_half", "_mask", "_requested", "_in_service")

    def __init__(self) -> None:
        self._table = -1
        self._half = -1
        self._mask = 0xFF
        self._requested = 0
        self._in_service = 0

    def read(self, offset: int) -> int:
        """Read requests, or at the odd address the mask."""
        return self._mask if offset else self._requested

    def write(self, offset: int, byte: int) -> None:
        """Write a word of initialisation, an end of interrupt, or a mask."""
        if offset:
            if self._half >= 0:
                self._table, self._half = byte << 8 | self._half, -1
            else:
                self._mask = byte
        elif byte & 0x10:
            if byte & 0x0F != ICW1 & 0x0F:
                raise InputError(f"ICW1 {byte:02X}H: this 8259 stands alone, sees edges, has entries of four bytes")
            self._half, self._mask, self._requested, self._in_service = byte & 0xE0, 0, 0, 0
        elif byte == END_OF_INTERRUPT:
            self._in_service &= self._in_service - 1  # the highest priority is the lowest bit
        else:
            raise InputError(f"command {byte:02X}H: this 8259 knows the end of interrupt, {END_OF_INTERRUPT:02X}H")

    def request(self, level: int) -> None:
        """Process the rising edge of a request line."""
        self._requested |= 1 << level

    @property
    def interrupting(self) -> bool:
        """INT: there is an unmasked request of higher priority than all in service."""
        return self._next() >= 0

    def acknowledge(self) -> int:
        """Acknowledge: return the address of the table's entry, whose level is then in service."""
        if self._table < 0:
            raise InputError("the 8259 has no jump table: write ICW1 and ICW2 first")
        level = self._next()
        if level < 0:
            return self._table + ENTRY_BYTES * SPURIOUS
        self._requested &= ~(1 << level)
        self._in_service |= 1 << level
        return self._table + ENTRY_BYTES * level

    def _next(self) -> int:
        """Return the level to be served next, or -1."""
        waiting = self._requested & ~self._mask
        if not waiting:
            return -1
        lowest = waiting & -waiting
        if self._in_service and lowest >= self._in_service & -self._in_service:
            return -1
        return lowest.bit_length() - 1
