"""The address space of the 8085: EPROM, RAM, and chips at their own addresses.

Ports are memory-mapped (5.1.1). The document defines the addresses of the two 8255 (row T-23) and the jump table (row
T-48); those of EPROM, RAM and the other chips are ours.
"""

from typing import Protocol

from edmsim.controllers.mcu.firmware.poscal import BYTE, WORD
from edmsim.errors import InputError
from edmsim.snapshots import Snapshots

EPROM, RAM = range(0x2000), range(0x2000, 0x4000)
"""8 K each (row T-20); the jump table of 3FE0H..3FFFH is the top of RAM."""
PORT2A, PORT2B, PORT2C, CPORT2 = 0x4020, 0x4021, 0x4022, 0x4023
PORT3A, PORT3B, PORT3C, CPORT3 = 0x4030, 0x4031, 0x4032, 0x4033
TIMERS, INTERRUPTS, DISPLAY, TERMINAL, HOST = 0x4000, 0x4008, 0x4010, 0x4018, 0x401C
"""First addresses of the 8253, the 8259, the 8279 and both 8251 (ours)."""
FLOATING = 0xFF  # read at addresses without a chip, and in EPROM, whose bytes of 1982 are lost


class Chip(Protocol):
    """A chip at some addresses."""

    def read(self, offset: int) -> int:
        """Read the byte at an address relative to the chip's first."""

    def write(self, offset: int, byte: int) -> None:
        """Write a byte at such an address."""


class Bus(Snapshots):
    """Address decoder and memory; writing to EPROM or to an address without a chip has no effect, as on the board."""

    STATE = ("ram",)

    def __init__(self) -> None:
        self.ram = bytearray(len(RAM))
        self._chips: dict[int, tuple[Chip, int]] = {}

    def attach(self, first: int, size: int, chip: Chip) -> None:
        """Attach a chip at `size` addresses from `first` on."""
        for offset in range(size):
            self._chips[first + offset] = (chip, offset)

    def read(self, address: int) -> int:
        """Read the byte at an address, 0..FFFFH; raises `InputError` for another address."""
        found = self._chips.get(address)
        if found is not None:
            return found[0].read(found[1])
        _check(address, WORD, "an address")
        return self.ram[address - RAM.start] if address in RAM else FLOATING

    def write(self, address: int, byte: int) -> None:
        """Write a byte at an address."""
        found = self._chips.get(address)
        if found is not None and 0 <= byte <= BYTE:
            found[0].write(found[1], byte)
            return
        _check(byte, BYTE, "a byte")
        _check(address, WORD, "an address")
        if address in RAM:
            self.ram[address - RAM.start] = byte

    def check_writable(self, address: int) -> None:
        """Refuse an address at which writing has no effect: EPROM, or no chip."""
        if address in EPROM:
            raise InputError(f"{address:04X}H is EPROM, which cannot be written")
        if address not in RAM and address not in self._chips:
            raise InputError(f"nothing answers at {address:04X}H")

    def word(self, address: int) -> int:
        """Read a word in RAM, low byte first (LHLD)."""
        at = address - RAM.start
        return self.ram[at] | self.ram[at + 1] << 8

    def signed(self, address: int) -> int:
        """Read a word in RAM as a signed number."""
        word = self.word(address)
        return word - 0x10000 if word & 0x8000 else word

    def store(self, address: int, word: int) -> None:
        """Write a word to RAM, low byte first, without bits above the sixteenth (SHLD)."""
        at = address - RAM.start
        self.ram[at], self.ram[at + 1] = word & BYTE, word >> 8 & BYTE


def _check(value: int, most: int, what: str) -> None:
    if not (isinstance(value, int) and 0 <= value <= most):
        raise InputError(f"{what} is 0..{most:X}H, not {value!r}")
