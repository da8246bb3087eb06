"""Set-up by INIT and the monitor: start values copied from their table, safe outputs, serial channels (5.1.1)."""

from __future__ import annotations

from edmsim.controllers.mcu.chips import bus, pic, pit, ppi, uart
from edmsim.controllers.mcu.chips.bus import Bus
from edmsim.controllers.mcu.firmware import memory_map as at
from edmsim.controllers.mcu.firmware.arithmetic import BYTE
from edmsim.controllers.mcu.firmware.tstates import CPU_HZ

JUMP = 0xC3  # JMP of the 8085
BIT_RATE = 9600  # of both serial channels in bit/s (ours)
BIT_RATE_COUNT = CPU_HZ // (16 * BIT_RATE)  # count of counter 2: sixteen clocks a bit
_ROUTINES = {
    pic.EMERGENCY: at.EMERGENCY_ROUTINE, pic.X_STEPPER: at.X_ENTRY, pic.Y_STEPPER: at.Y_ENTRY,
    pic.KEYBOARD: at.KBD_ROUTINE,
}  # fmt: skip


def load_start_values(memory: Bus) -> None:
    """Put the table of start values into RAM, as the control program brings it: jumps, and zeros before them."""
    jumps = b"".join(
        bytes((JUMP, routine & BYTE, routine >> 8, 0))
        for routine in (_ROUTINES.get(level, at.NO_ROUTINE) for level in range(8))
    )
    table = jumps.rjust(sum(size for _, size in at.START_AREAS), b"\0")
    for offset, byte in enumerate(table):
        memory.write(at.START_VALUES + offset, byte)


def copy_start_values(memory: Bus) -> None:
    """Copy the table in RAM into the data areas and the jump table (rows T-80, T-82)."""
    source = at.START_VALUES
    for first, size in at.START_AREAS:
        for offset in range(size):
            memory.write(first + offset, memory.read(source + offset))
        source += size


def make_outputs_safe(memory: Bus, oev: int) -> None:
    """Directions of the ports and safe values: both voltages 0, handshake off, generator off by its bit `oev`."""
    memory.write(bus.CPORT2, ppi.BASIC_OUTPUTS)
    memory.write(bus.PORT2C, 1 << oev)
    memory.write(bus.PORT2A, 0)
    memory.write(bus.PORT2B, 0)
    memory.write(bus.CPORT3, ppi.STROBED_INPUTS)
    for bit in (ppi.INTE_A_BIT, ppi.INTE_B_BIT):
        memory.write(bus.CPORT3, bit << 1)
    memory.write(bus.CPORT3, ppi.RESET_BIT << 1 | 1)  # a pulse resets the counters
    memory.write(bus.CPORT3, ppi.RESET_BIT << 1)


def set_up_monitor(memory: Bus) -> None:
    """What the monitor sets up before it listens: bit rate, serial channels, streams (row T-81)."""
    memory.write(bus.TIMERS + pit.CONTROL, pit.control_word(pit.BIT_RATE, pit.SQUARE_WAVE))
    memory.write(bus.TIMERS + pit.BIT_RATE, BIT_RATE_COUNT & BYTE)
    memory.write(bus.TIMERS + pit.BIT_RATE, BIT_RATE_COUNT >> 8)
    for channel in (bus.TERMINAL, bus.HOST):
        memory.write(channel + 1, uart.COMMAND_RESET)
        memory.write(channel + 1, uart.MODE_8_BITS)
        memory.write(channel + 1, uart.COMMAND_RUN | uart.COMMAND_RESET_ERRORS)
    memory.store(at.CIADR, at.TERMINAL_IN)
    memory.store(at.COADR, at.TERMINAL_OUT)
