"""What the monitor works on at the terminal: the bus, tapes as files, the host's line, and what G starts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from edmsim.controllers.mcu.chips import bus
from edmsim.controllers.mcu.dialogue.monitor import STARTS
from edmsim.controllers.mcu.firmware import memory_map as at
from edmsim.errors import InputError
from edmsim.terminal.operation import Operation


class MonitorBench:
    """See `edmsim.controllers.mcu.dialogue.monitor.Bench`.

    Parameters
    ----------
    operation : Operation
    tapes : path
        Folder of the tapes.
    from_host : callable
        Returns what the host sends.
    reset : callable
        Presses the reset button.
    to_main : callable
        Gives the terminal to MAIN, as it was left or, if told so, from its beginning.
    """

    def __init__(
        self, operation: Operation, tapes: Path, from_host: Callable[[], bytes], reset: Callable[[], None],
        to_main: Callable[[bool], None],
    ) -> None:
        self._operation = operation
        self._computer = operation.rig.computer
        self._tapes = tapes
        self.from_host = from_host
        self._reset = reset
        self._to_main = to_main

    def read(self, address: int) -> int:
        """Byte at an address."""
        return self._computer.read(address)

    def write(self, address: int, byte: int) -> None:
        """Put a byte at an address; raises `InputError` where none can be written."""
        self._computer.board.bus.check_writable(address)
        self._computer.write(address, byte)

    def tape(self, name: str) -> bytes:
        """What stands on a tape."""
        try:
            return (self._tapes / name).read_bytes()
        except OSError as error:
            raise InputError(f"the tape {name} cannot be read: {error.strerror}") from None

    def put_away(self, name: str, text: str) -> None:
        """Keep a tape that was punched; one that was punched before is not punched again."""
        try:
            with (self._tapes / name).open("x", encoding="ascii") as file:
                file.write(text)
        except FileExistsError:
            raise InputError(f"there is a tape {name} already, and no hole can be closed: name another") from None
        except OSError as error:
            raise InputError(f"the tape {name} cannot be punched: {error.strerror}") from None

    def go(self, address: int | None) -> None:
        """Start at an address, or go back to MAIN."""
        code = self._computer.code
        if address is None or address == at.MAIN:
            self._to_main(address is not None)
        elif address == at.MONITOR:
            self._reset()
        elif address == at.INIT:
            self._operation.init()
        elif address == at.EMERGENCY_ROUTINE:
            self._operation.rig.stop_all("CALLED FROM THE MONITOR")
        elif address in STARTS:
            code.call(address)
        elif address in bus.RAM:
            code.begin(address)
        else:
            raise InputError(f"there is no 8085 code at {address:04X}H: the listings are lost; M shows what starts")
