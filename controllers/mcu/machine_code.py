"""Machine code in RAM: what the jump table leads to, and programs that the monitor starts."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from edmsim.controllers.mcu.board import Board
from edmsim.controllers.mcu.chips.cpu import A, C, Cpu8085, NoCodeError
from edmsim.controllers.mcu.chips.uart import BITS_PER_CHARACTER
from edmsim.controllers.mcu.firmware import memory_map as at
from edmsim.controllers.mcu.firmware.initialise import BIT_RATE
from edmsim.controllers.mcu.firmware.streams import Streams
from edmsim.controllers.mcu.firmware.tstates import CPU_HZ

CALL_T, CHARACTER_T = 18, CPU_HZ * BITS_PER_CHARACTER // BIT_RATE
"""T-states of a call of a routine of ours, and of a character sent or fetched."""
LONGEST_T = 30 * CPU_HZ // 1000
"""An interrupt routine that has not returned by then is lost (ours: half of the shortest time between two steps)."""


class MachineCode:
    """The 8085 and what it finds at addresses: instructions in RAM, routines of ours in EPROM.

    Parameters
    ----------
    board : Board
    streams : Streams
    routines : mapping
        Routines by their address in EPROM.

    Attributes
    ----------
    cpu : Cpu8085
    running : bool
        Whether a program that the monitor started is under way.
    """

    def __init__(self, board: Board, streams: Streams, routines: Mapping[int, Callable[[], None]]) -> None:
        self.running = False
        self._board = board
        self._streams = streams
        self._routines = routines
        self.cpu = Cpu8085(board.bus, self._routine)

    def call(self, address: int) -> None:
        """Run what stands at an address until it returns, at once; registers are kept.

        Raises
        ------
        NoCodeError
            If there is no code, or it does not return.
        """
        cpu = self.cpu
        kept = [*cpu.registers], cpu.flags, cpu.pc, cpu.sp
        cpu.sp = cpu.sp if self.running else at.STACK
        cpu.push(at.MONITOR)
        cpu.pc, spent = address, 0
        try:
            while cpu.pc != at.MONITOR:
                cost = cpu.step()
                spent += cost
                if not cost or cpu.halted or spent > LONGEST_T:
                    raise NoCodeError(f"what stands at {address:04X}H does not return")
        finally:
            cpu.registers, cpu.flags, cpu.pc, cpu.sp = kept
            cpu.halted = False

    def begin(self, address: int) -> None:
        """Start a program; `run_until` runs it, and it ends where it returns, jumps to 0000H or halts."""
        cpu = self.cpu
        cpu.pc, cpu.sp, cpu.halted, self.running = address, at.STACK, False, True
        cpu.push(at.MONITOR)

    def run_until(self, end_ns: int) -> None:
        """Let the program run up to a time, at the clock of the 8085.

        Raises
        ------
        InputError
            If there is no code where it leads, or a chip refuses what it writes; the program is at its end.
        """
        board, cpu, begin_ns, spent = self._board, self.cpu, self._board.now_ns, 0
        while self.running and board.now_ns < end_ns:
            if cpu.pc == at.MONITOR or cpu.halted:
                self.running = False
                break
            try:
                cost = cpu.step()
            except Exception:
                self.running = False
                raise
            spent += cost
            board.now_ns = begin_ns + spent * 1_000_000_000 // CPU_HZ if cost else end_ns

    def _routine(self, address: int) -> int:
        """What stands in EPROM; 0 T-states while a character is waited for."""
        if address in self._routines:
            self._routines[address]()
        elif address in self._streams.outputs:
            self._streams.outputs[address](self.cpu.registers[C])
            return CHARACTER_T
        elif address in self._streams.inputs:
            character = self._streams.inputs[address]()
            if character is None:
                return 0
            self.cpu.registers[A] = character
        else:
            raise NoCodeError(f"there is no 8085 code at {address:04X}H: the listings of 1982 are lost")
        return CALL_T
