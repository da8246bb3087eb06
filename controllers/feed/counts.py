"""The feed law of the 1982 machine: it uses only the counts of short and open pulses.

The law is the optimising routine of the 1982 controller, in its sixteen-bit words
(`edmsim.controllers.mcu.firmware.optimise`), called directly: this controller turns its constants into the
routine's settings and the routine's speed into a feed. `edmsim.controllers.feed.mcu` runs the same routine behind the
registers of the whole machine; both give the same cut, bit for bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

from edmsim.controllers.feed.law import PERSISTENT_SHORT
from edmsim.controllers.mcu.firmware.arithmetic import WORD
from edmsim.controllers.mcu.firmware.optimise import ALARM, ERROR, SHARE, TICK_NS, Settings, State, optimise
from edmsim.controllers.mcu.firmware.timers import SPEED_UNIT_NM_S
from edmsim.controllers.mcu.firmware.tstates import nanoseconds
from edmsim.controllers.protocols import FeedCommand, WindowObservation, check_feed, check_parameters
from edmsim.controllers.pulse_counters import PulseAnalyser
from edmsim.errors import InputError
from edmsim.machine.setting import WINDOW_PULSES
from edmsim.snapshots import Snapshots

UNIT_UM_S = SPEED_UNIT_NM_S / 1000  # speed unit in um/s
TICKS_PER_S = 1_000_000_000 // TICK_NS


@dataclass
class Occupation:
    """State of the processor: its clock, and the end of its current calculation."""

    clock_ns: int = 0  # time since the leg began
    busy_until_ns: int = 0  # when the speed found last is in XVELOC and YVELOC
    units: int = 0  # that speed


@dataclass
class CountsController(Snapshots):
    """Sets the feed from the counts of short and open pulses; retracts from shorts and stops if one never clears.

    All constants are ours. Shares are fractions of the 255 pulses of a window. The feed is a whole number of speed
    units of 262.5 nm/s: up to 127 on the machine of 1982, more where the table is faster. Counts that arrive while
    the processor is busy wait in their latch; further counts are missed.
    """

    name: ClassVar[str] = "counts"

    open_target_share: float = 0.06  # target share of open pulses without shorts. A larger share is safer and slower.
    short_weight: float = 1.0  # number of open pulses that one short pulse cancels
    proportional_um_s: float = 10.0  # feed per unit of the difference from the target, um/s
    integral_um_s2: float = 30.0  # growth of the feed per unit of that difference, um/s per s
    filter_s: float = 0.1  # time constant of the low-pass filter on both shares
    start_feed_um_s: float = 10.0  # start value of the integrator; also its upper limit after a retract
    air_share: float = 0.98  # share of open pulses from which the wire runs at full feed, because no metal is near
    shorted_share: float = 0.5  # share of short pulses from which a window counts as shorted
    patience_s: float = 0.15  # time in a short after which the wire retracts
    clear_share: float = 0.1  # share of short pulses below which a short counts as cleared
    retract_feed_um_s: float = 20.0  # speed of the retract
    retract_um: float = 60.0  # longest retract
    dwell_s: float = 1.0  # wait at the end of a retract that did not clear the short
    return_feed_um_s: float = 10.0  # largest feed on the way back to the place of the short
    progress_um: float = 20.0  # distance along the path from which the next short counts as a new one
    max_tries: int = 8  # retracts for one short before the alarm

    _state: State = field(default_factory=State, init=False, repr=False)
    _cpu: Occupation = field(default_factory=Occupation, init=False, repr=False)
    _analyser: PulseAnalyser = field(default_factory=PulseAnalyser, init=False, repr=False)

    def __post_init__(self) -> None:
        check_parameters(self)
        self._settings: Settings | None = None

    @property
    def missed_windows(self) -> int:
        """Windows not read in time since the leg began (row T-44)."""
        return self._analyser.missed

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a new cut; refuses feeds above the machine's largest and values too large for the routine's words."""
        for name in ("start_feed_um_s", "retract_feed_um_s", "return_feed_um_s"):
            check_feed(self.name, name, getattr(self, name), max_feed_um_s)
        self._settings = self.settings(max_feed_um_s)
        self._state = State(speed=self._settings.start)
        self._cpu = Occupation(units=self._settings.start)
        self._analyser = PulseAnalyser()
        return FeedCommand(self._cpu.units * UNIT_UM_S)

    def update(self, window: WindowObservation) -> FeedCommand:
        """Feed for the next window, from the counts and the position along the path."""
        cpu = self._cpu
        cpu.clock_ns += round(window.duration_s * 1e9)
        self._count(window.short, window.open)
        if cpu.clock_ns >= cpu.busy_until_ns:
            tick = cpu.clock_ns // TICK_NS & WORD
            cpu.units, t_states = self._decide(tick, window.path_um)
            cpu.busy_until_ns = cpu.clock_ns + nanoseconds(t_states)
        return self._command(window.path_um)

    def settings(self, max_feed_um_s: float) -> Settings:
        """The constants as the routine's words.

        Raises
        ------
        InputError
            If one does not fit.
        """
        unit, ticks = 1 / UNIT_UM_S, float(TICKS_PER_S)
        return Settings(
            target=self._word("open_target_share", ERROR),
            weight=self._word("short_weight", 256),
            proportional=self._word("proportional_um_s", unit * 65536 / ERROR),
            integral=self._word("integral_um_s2", unit * 2**32 / ERROR / ticks),
            filter_ticks=self._word("filter_s", ticks, WORD // 2),
            start=self._word("start_feed_um_s", unit),
            limit=min(int(max_feed_um_s * unit + 1e-9), WORD // 2),
            retract=self._word("retract_feed_um_s", unit),
            slow=self._word("return_feed_um_s", unit),
            air=self._word("air_share", SHARE),
            shorted=math.ceil(self.shorted_share * WINDOW_PULSES),
            clear=math.ceil(self.clear_share * WINDOW_PULSES),
            patience_ticks=self._word("patience_s", ticks),
            retract_ticks=self._retract_ticks(),
            dwell_ticks=self._word("dwell_s", ticks),
            progress_um=self._word("progress_um", 1, WORD // 2),
            tries=self._word("max_tries", 1),
        )

    def _word(self, name: str, scale: float, most: int = WORD) -> int:
        """A constant in the routine's scale, refused where it does not fit."""
        value = round(float(getattr(self, name)) * scale)
        if value > most:
            raise InputError(
                f"{name} of the {self.name} controller is {getattr(self, name)}, "
                f"but its sixteen-bit word holds at most {most / scale:.6g}"
            )
        return value

    def _retract_ticks(self) -> int:
        """Duration of the longest retract; 0 where it has no speed."""
        if not self.retract_feed_um_s:
            return 0
        ticks = int(self.retract_um / self.retract_feed_um_s * TICKS_PER_S)
        if ticks > WORD:
            raise InputError(
                f"retract_um of the {self.name} controller is {self.retract_um}, but at "
                f"{self.retract_feed_um_s} um/s its "
                f"sixteen-bit word of time holds at most {WORD / TICKS_PER_S * self.retract_feed_um_s:.6g}"
            )
        return ticks

    def _count(self, short: int, open: int) -> None:
        """Let the analyser count a window."""
        self._analyser.count_window(short, open)

    def _decide(self, tick: int, path_um: float) -> tuple[int, int]:
        """Read the counts and run the routine; return its speed and cost."""
        counts = self._analyser.read()
        assert self._settings is not None
        return optimise(self._settings, self._state, counts.short, counts.open, tick, math.floor(path_um) & WORD)

    def _command(self, path_um: float) -> FeedCommand:
        """Return the command, which takes effect when the processor is ready; an alarm stops the machine at once."""
        if self._state.phase == ALARM:
            return FeedCommand(0.0, PERSISTENT_SHORT)
        latency_ns = max(self._cpu.busy_until_ns - self._cpu.clock_ns, 0)
        return FeedCommand(self._cpu.units * UNIT_UM_S, latency_s=latency_ns * 1e-9)
