"""The machine's state for its operator, and how STATUS prints it."""

from __future__ import annotations

from typing import NamedTuple

from edmsim.controllers.mcu.chips.dac import time_text
from edmsim.controllers.mcu.dialogue.part_program import Move
from edmsim.controllers.pulse_counters import percent_of_window


class Status(NamedTuple):
    """What the machine shows its operator."""

    state: str  # ``STAND-BY``, ``CUTTING``, ``JOGGING`` or ``EMERGENCY: ...`` with its cause
    position: tuple[int, int]
    unit: str  # what position counters count: ``um`` or ``STEPS``
    speed: int  # greatest cutting speed set, in units
    running: int  # the speed now; negative while running back
    short: int
    open: int
    counted: int  # 255, or 0 while no pulses have been counted since INIT
    windows: int  # read since the start
    missed: int  # not read in time (row T-44)
    t_i: int  # code of V(t(i))
    t_p: int
    t_i_us: float
    t_p_us: float
    generator_on: bool
    voltage_V: float  # mean over the gap
    current_A: float
    time_s: float
    move: Move | None  # of the cut under way

    @property
    def erosion(self) -> int:
        """Pulses of the last window that eroded."""
        return max(self.counted - self.short - self.open, 0)


def describe(status: Status, target: Move | None) -> str:
    """What STATUS prints; where a cut is under way its move, wherever that was given, else the new position."""
    x, y = status.position
    return "\n".join(
        (
            f"{status.state}   POSITION X {x} Y {y} {status.unit}   {status.move or target or 'NO NEW POSITION'}",
            f"SPEED {status.running} OF {status.speed} UNITS   SHORT {percent_of_window(status.short):.1f} %   "
            f"OPEN {percent_of_window(status.open):.1f} %   WINDOWS {status.windows}, MISSED {status.missed}",
            pulses(status),
            f"GENERATOR {'ON' if status.generator_on else 'OFF'}   GAP {status.voltage_V:.0f} V "
            f"{status.current_A:.2f} A   TIME {status.time_s:.1f} s",
        )
    )


def pulses(status: Status) -> str:
    """Both times and their codes, as STATUS prints them."""

    def show(code: int, us: float) -> str:
        return f"{time_text(us)} us ({code:02X}H)" if code else "NOT SET (00H)"

    return f"t(i) {show(status.t_i, status.t_i_us)}   t(p) {show(status.t_p, status.t_p_us)}"
