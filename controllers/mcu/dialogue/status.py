"""What the machine shows its operator, and how STATUS prints it."""

from __future__ import annotations

from typing import NamedTuple

from edmsim.controllers.mcu.chips.dac import time_text
from edmsim.controllers.mcu.dialogue.part_program import Move
from edmsim.controllers.pulse_counters import percent_of_window


class Status(NamedTuple):
    """What the machine shows its operator.

    Attributes
    ----------
    state : str
        ``STAND-BY``, ``CUTTING``, ``JOGGING`` or ``EMERGENCY: ...`` with its cause.
    position : (int, int)
        Position counters.
    unit : str
        What they count: ``um`` or ``STEPS``.
    speed, running : int
        Greatest cutting speed set, and the speed now, in units; negative while running back.
    short, open, counted : int
        Counts of the last 255 pulses; and 255, or 0 while none have been counted since INIT.
    windows, missed : int
        Windows read since the start, and those that were not read in time (row T-44).
    t_i, t_p : int
        Codes of V(t(i)) and V(t(p)).
    t_i_us, t_p_us : float
        The times they mean.
    voltage_V, current_A : float
        Means over the gap.
    time_s : float
        Machine time.
    move : Move or None
        Of the cut under way.
    """

    state: str
    position: tuple[int, int]
    unit: str
    speed: int
    running: int
    short: int
    open: int
    counted: int
    windows: int
    missed: int
    t_i: int
    t_p: int
    t_i_us: float
    t_p_us: float
    generator_on: bool
    voltage_V: float
    current_A: float
    time_s: float
    move: Move | None

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
