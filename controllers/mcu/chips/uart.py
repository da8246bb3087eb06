"""The 8251: a serial channel; one for the terminal, one for the host that sends programs (row T-59).

After reset, a mode word and a command word set the channel to asynchronous characters of eight bits without parity.
It holds one received character; the next one causes an overrun.
"""

from collections.abc import Callable

from edmsim.errors import InputError
from edmsim.snapshots import Snapshots

MODE_8_BITS = 0x4E  # asynchronous, 16 clocks per bit, 8 bits, no parity, 1 stop bit
COMMAND_RUN, COMMAND_RESET_ERRORS, COMMAND_RESET = 0x05, 0x10, 0x40
"""Transmitter and receiver on; errors cleared; back to waiting for a mode word."""
TX_READY, RX_READY, TX_EMPTY, OVERRUN = 0x01, 0x02, 0x04, 0x10  # bits of the status
BITS_PER_CHARACTER = 10  # with start and stop bit


class Usart8251(Snapshots):
    """A serial channel; `transmit` is called with every byte sent."""

    STATE = ("_mode", "_command", "_received", "_ready", "_overrun")

    def __init__(self, transmit: Callable[[int], None]) -> None:
        self._transmit = transmit
        self._mode = -1
        self._command = 0
        self._received = 0
        self._ready = False
        self._overrun = False

    def arrive(self, byte: int) -> None:
        """Receive a character from the line; it is lost if the receiver is off, and overruns an unread one."""
        if self._command & 0x04:
            self._overrun |= self._ready
            self._received, self._ready = byte, True

    def read(self, offset: int) -> int:
        """Read the received character, or at the odd address the status."""
        if offset:
            return TX_READY | TX_EMPTY | self._ready * RX_READY | self._overrun * OVERRUN
        self._ready = False
        return self._received

    def write(self, offset: int, byte: int) -> None:
        """Write a character to send; at the odd address the mode word after a reset, then command words."""
        if not offset:
            if self._command & 0x01:
                self._transmit(byte)
        elif self._mode < 0:
            if byte == COMMAND_RESET:
                return  # a reset again
            if byte != MODE_8_BITS:
                raise InputError(f"mode word {byte:02X}H: a channel has 8 bits without parity, {MODE_8_BITS:02X}H")
            self._mode = byte
        elif byte & COMMAND_RESET:
            self._mode, self._command, self._ready, self._overrun = -1, 0, False, False
        else:
            self._command = byte
            if byte & COMMAND_RESET_ERRORS:
                self._overrun = False
