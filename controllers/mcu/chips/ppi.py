"""The 8255: three ports, of which A and B may be strobed inputs with handshake lines in port C (mode 1).

It has the modes that this machine uses: mode 0 in both directions, and mode 1 for input (row T-25).
"""

from collections.abc import Callable
from dataclasses import dataclass

from edmsim.errors import InputError
from edmsim.snapshots import Snapshots

A, B, C, CONTROL = range(4)  # offsets of the ports and the control register
MODE_SET = 0x80
BASIC_OUTPUTS = 0x80  # control word of the 8255 that drives machine and DACs: all ports out, mode 0
STROBED_INPUTS = 0xB6  # control word of the 8255 that reads the counters: A and B inputs in mode 1, C7 and C6 out
INTE_A_BIT, INTE_B_BIT, RESET_BIT = 4, 2, 7
"""Bits of port C that set the flags INTE A and INTE B (data sheet of the 8255), and our counter reset."""
INTR_B, IBF_B, INTE_B, INTR_A, INTE_A, IBF_A = 0x01, 0x02, 0x04, 0x08, 0x10, 0x20  # bits of port C read in mode 1


@dataclass
class _Input:
    """A strobed input: its latch and flags."""

    latch: int = 0
    full: bool = False
    enabled: bool = False

    @property
    def request(self) -> bool:
        return self.full and self.enabled


class Ppi8255(Snapshots):
    """An 8255; `on_output` is called with port and byte when an output changes or is written."""

    STATE = ("_mode", "_out", "inputs", "_strobed")

    def __init__(self, on_output: Callable[[int, int], None] | None = None) -> None:
        self.inputs = [0, 0, 0]
        self._on_output = on_output
        self._out = [0, 0, 0]
        self._mode = 0x9B  # after reset all ports are inputs in mode 0
        self._strobed = (_Input(), _Input())

    @property
    def full(self) -> tuple[bool, bool]:
        """IBF A and IBF B."""
        return self._strobed[A].full, self._strobed[B].full

    def strobe(self, port: int, byte: int) -> None:
        """Pulse STB A or STB B: the latch takes the byte, and IBF rises."""
        latch = self._strobed[port]
        latch.latch, latch.full = byte, True

    def read(self, offset: int) -> int:
        """Read port A, B or C; reading a strobed input clears its IBF. The control register cannot be read."""
        if offset == CONTROL:
            return 0xFF
        if offset == C:
            return self._read_c()
        if self._is_strobed(offset):
            self._strobed[offset].full = False
            return self._strobed[offset].latch
        return self.inputs[offset] if self._is_input(offset) else self._out[offset]

    def write(self, offset: int, byte: int) -> None:
        """Write port A, B or C, or the control register: a mode, or one bit of port C."""
        if offset == CONTROL:
            if byte & MODE_SET:
                self._set_mode(byte)
            else:
                self._set_bit(byte >> 1 & 7, bool(byte & 1))
        else:
            self._output(offset, byte)

    def _is_strobed(self, port: int) -> bool:
        return bool(self._mode & (0x20 if port == A else 0x04)) and port != C

    def _is_input(self, port: int) -> bool:
        return bool(self._mode & (0x10, 0x02, 0x01)[port])

    def _set_mode(self, word: int) -> None:
        """Set a mode, which clears all outputs and flags."""
        if word & 0x40 or (word & 0x30) == 0x20 or (word & 0x06) == 0x04:
            raise InputError(f"control word {word:02X}H: this 8255 has mode 0 and, for input only, mode 1")
        self._mode = word
        self._strobed = (_Input(), _Input())
        for port in (A, B, C):
            self._output(port, 0)

    def _set_bit(self, bit: int, on: bool) -> None:
        """Set or reset one line of port C, or in mode 1 its INTE flag."""
        if bit == INTE_A_BIT and self._is_strobed(A):
            self._strobed[A].enabled = on
        elif bit == INTE_B_BIT and self._is_strobed(B):
            self._strobed[B].enabled = on
        else:
            self._output(C, self._out[C] | 1 << bit if on else self._out[C] & ~(1 << bit))

    def _output(self, port: int, byte: int) -> None:
        self._out[port] = byte
        if self._on_output is not None and not (self._is_input(port) and port != C):
            self._on_output(port, byte)

    def _read_c(self) -> int:
        a, b = self._strobed
        value = self.inputs[C] if self._mode & 0x01 and not self._is_strobed(B) else self._out[C]
        if self._is_strobed(A):
            value = value & ~(INTR_A | INTE_A | IBF_A) | a.request * INTR_A | a.enabled * INTE_A | a.full * IBF_A
        if self._is_strobed(B):
            value = value & ~(INTR_B | INTE_B | IBF_B) | b.request * INTR_B | b.enabled * INTE_B | b.full * IBF_B
        return value
