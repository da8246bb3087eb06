"""Character streams: routines that read and write, with addresses at CIADR and COADR (row T-58)."""

from __future__ import annotations

from collections.abc import Callable

from edmsim.controllers.mcu.chips import bus, uart
from edmsim.controllers.mcu.chips.bus import Bus
from edmsim.controllers.mcu.firmware import memory_map as at
from edmsim.errors import InputError


class Streams:
    """Input and output, each redirectable to any routine with an address; the addresses are in `memory`."""

    def __init__(self, memory: Bus) -> None:
        self.memory = memory
        self.inputs: dict[int, Callable[[], int | None]] = {
            at.TERMINAL_IN: lambda: self._fetch(bus.TERMINAL),
            at.HOST_IN: lambda: self._fetch(bus.HOST),
        }
        self.outputs: dict[int, Callable[[int], None]] = {
            at.TERMINAL_OUT: lambda byte: memory.write(bus.TERMINAL, byte),
            at.HOST_OUT: lambda byte: memory.write(bus.HOST, byte),
        }

    def ci(self) -> int | None:
        """Character from the stream that CIADR names; None while none has come."""
        address = self.memory.word(at.CIADR)
        if address not in self.inputs:
            raise InputError(f"CIADR holds {address:04X}H: there is no input routine")
        return self.inputs[address]()

    def co(self, character: int) -> None:
        """Send a character down the stream that COADR names; see `ci`."""
        address = self.memory.word(at.COADR)
        if address not in self.outputs:
            raise InputError(f"COADR holds {address:04X}H: there is no output routine")
        self.outputs[address](character)

    def _fetch(self, channel: int) -> int | None:
        return self.memory.read(channel) if self.memory.read(channel + 1) & uart.RX_READY else None
