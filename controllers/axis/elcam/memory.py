"""Memory for cam tables: in the control (chapter 1 of the ELCAM document) and in the computer (chapter 2.8)."""

from __future__ import annotations

import os
from typing import NamedTuple

from edmsim.controllers.axis.elcam.registers import DATA
from edmsim.errors import InputError

BUFFER_VARIABLE = "SZELCAMPUFFER"  # environment variable with the bytes for the points of all tables
_MANY_DIGITS = 20  # more digits than any count of bytes has (ours)

_FIRST_ADDRESS = 0x1000_0000  # of the first piece given out (ours: some address above the first megabytes)
_PAGE = 0x1000  # pieces begin at whole pages (ours)


def buffer_bytes_chosen() -> int:
    """Return the room that SZELCAMPUFFER of the environment asks for, else the control's own."""
    text = os.environ.get(BUFFER_VARIABLE, "").strip()
    if not text:
        return int(DATA["elcam"]["buffer_bytes"])
    most = DATA["elcam"]["most_bytes"]
    if not (text.isascii() and text.isdigit() and len(text) < _MANY_DIGITS and int(text) <= most):
        raise InputError(f"the environment variable {BUFFER_VARIABLE} is {text!r}; it must be 0 to {most} bytes")
    return int(text)


class Allocation(NamedTuple):
    """Result of an allocation."""

    status: int  # 0 where there is memory
    memory: bytearray  # the piece, for the program ("virtual address")
    address: int  # where it is, for the control ("physical address")


class PhysicalMemory:
    """Contiguous blocks of memory, at addresses that a control can read.

    Parameters
    ----------
    free_bytes : int
        The longest free block; other programs fragment the memory.
    reserved_bytes : int
        Size reserved while booting, or 0. You can allocate only this size.
    """

    def __init__(self, free_bytes: int = 1 << 26, reserved_bytes: int = 0) -> None:
        self.free_bytes = free_bytes
        self.reserved_bytes = reserved_bytes
        self._pieces: dict[int, bytearray] = {}
        self._next = _FIRST_ADDRESS

    def allocate(self, size: int) -> Allocation:
        """Allocate bytes; status 1 if no block is large enough (ours, the document says "error code")."""
        wrong_size = self.reserved_bytes > 0 and size != self.reserved_bytes
        if size < 1 or wrong_size or (self.reserved_bytes == 0 and size > self.free_bytes):
            return Allocation(1, bytearray(), 0)
        address, piece = self._next, bytearray(size)
        self._pieces[address] = piece
        self._next += -(-size // _PAGE) * _PAGE
        return Allocation(0, piece, address)

    def free(self, memory: bytearray) -> int:
        """Free a block; 0 on success, else 1."""
        for address, piece in self._pieces.items():
            if piece is memory:
                del self._pieces[address]
                return 0
        return 1

    def at(self, address: int) -> bytearray | None:
        """Return the block at an address; None if none is allocated there."""
        return self._pieces.get(address)
