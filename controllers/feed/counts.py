"""The feed law of the 1982 machine: it uses only the counts of short and open pulses.

The law is the optimising routine of the 1982 controller, in its sixteen-bit words
(`edmsim.controllers.mcu.firmware.optimise`). `CountsController` calls it directly: it turns its constants into the
routine's settings and the routine's speed into a feed. `McuController` runs it behind the registers of the whole
machine; both give the same cut, bit for bit.
"""

import math
from bisect import bisect_right
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.feed.law import PERSISTENT_SHORT
from edmsim.controllers.mcu.board import Board
from edmsim.controllers.mcu.chips.dac import LIMIT_A, PulseSettings
from edmsim.controllers.mcu.computer import EMERGENCY, Computer, PathRun, before_corner
from edmsim.controllers.mcu.firmware import memory_map
from edmsim.controllers.mcu.firmware.optimise import ALARM, ERROR, SHARE, TICK_NS, Settings, State, optimise
from edmsim.controllers.mcu.firmware.poscal import WORD, Unit, check_1982, unit_for, unit_um
from edmsim.controllers.mcu.firmware.timers import SPEED_UNIT_NM_S, nanoseconds
from edmsim.controllers.planner.kinds import LITERAL
from edmsim.controllers.planner.registry import Planner, kind_of
from edmsim.controllers.protocols import FeedCommand, Step, WindowObservation, check_feed, check_parameters
from edmsim.controllers.pulse_counters import PulseAnalyser
from edmsim.errors import InputError
from edmsim.geometry import CORNER_DEG, Polyline
from edmsim.machine.machine import Machine
from edmsim.machine.setting import WINDOW_PULSES, discharge_current_A
from edmsim.snapshots import Snapshots

UNIT_UM_S = SPEED_UNIT_NM_S / 1000  # speed unit in um/s
TICKS_PER_S = 1_000_000_000 // TICK_NS


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
    max_tries: int = 8  # retracts, and waits of `dwell_s`, for one short before the alarm

    _state: State = field(default_factory=State, init=False, repr=False)
    _clock_ns: int = field(default=0, init=False, repr=False)  # since the leg began
    _busy_until_ns: int = field(default=0, init=False, repr=False)  # when the last speed arrives in XVELOC and YVELOC
    _units: int = field(default=0, init=False, repr=False)  # that speed
    _analyser: PulseAnalyser = field(default_factory=PulseAnalyser, init=False, repr=False)

    def __post_init__(self) -> None:
        check_parameters(self)
        self._settings: Settings | None = None

    @property
    def _counters(self) -> PulseAnalyser:
        """Where windows are counted."""
        return self._analyser

    @property
    def missed_windows(self) -> int:
        """Windows not read in time since the leg began (row T-44)."""
        return self._counters.missed

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a new cut; refuses feeds above the machine's largest and values too large for the routine's words."""
        for name in ("start_feed_um_s", "retract_feed_um_s", "return_feed_um_s"):
            check_feed(self.name, name, getattr(self, name), max_feed_um_s)
        self._settings = self.settings(max_feed_um_s)
        self._state = State(speed=self._settings.start)
        self._clock_ns, self._busy_until_ns, self._units = 0, 0, self._settings.start
        self._analyser = PulseAnalyser()
        return FeedCommand(self._units * UNIT_UM_S)

    def update(self, window: WindowObservation) -> FeedCommand:
        """Feed for the next window, from the counts and the position along the path."""
        self._clock_ns += round(window.duration_s * 1e9)
        self._counters.count_window(window.short, window.open)
        if self._clock_ns >= self._busy_until_ns:
            tick = self._clock_ns // TICK_NS & WORD
            self._units, t_states = self._decide(tick, window.path_um)
            self._busy_until_ns = self._clock_ns + nanoseconds(t_states)
        return self._command(window.path_um)

    def settings(self, max_feed_um_s: float) -> Settings:
        """Return the constants as the routine's words.

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
        """Return a constant in the routine's scale; refuse one that does not fit."""
        value = round(float(getattr(self, name)) * scale)
        if value > most:
            raise InputError(
                f"{name} of the {self.name} controller is {getattr(self, name)}, "
                f"but its sixteen-bit word holds at most {most / scale:.6g}"
            )
        return value

    def _retract_ticks(self) -> int:
        """Duration of the longest retract; 0 without a retract speed."""
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

    def _decide(self, tick: int, path_um: float) -> tuple[int, int]:
        """Read the counts and run the routine; return its speed and cost."""
        counts = self._analyser.read()
        assert self._settings is not None
        return optimise(self._settings, self._state, counts.short, counts.open, tick, math.floor(path_um) & WORD)

    def _command(self, path_um: float) -> FeedCommand:
        """Return the command, which takes effect when the processor is ready; an alarm stops the machine at once."""
        if self._state.phase == ALARM:
            return FeedCommand(0.0, PERSISTENT_SHORT)
        latency_ns = max(self._busy_until_ns - self._clock_ns, 0)
        return FeedCommand(self._units * UNIT_UM_S, latency_s=latency_ns * 1e-9)


# The law behind the registers of the machine. The counts reach the program as on the machine: 255 clocks of SYNC,
# strobes, latches at 4030H and 4031H, polled through the handshake at 4032H. With the planner `poscal-literal` the
# computer also times the steps: it receives the end of every move, and its timers decide when a step comes. With any
# other planner, the planner decides when, and each step leaves as on the machine: a timer runs out, the 8259
# interrupts, the routine raises a line of 4022H.


class _Setup(NamedTuple):
    """Inputs of MAIN before a cut."""

    pulses: PulseSettings = PulseSettings()  # meaning of the codes
    codes: tuple[int, int] = (102, 170)  # t(i) and t(p) nearest to the setting
    t_on_us: float = 20.0  # as set by the operator
    unit: Unit = "um"
    points: tuple[tuple[int, int], ...] = ()  # corners of the path in `unit`, without repeated points
    starts_um: tuple[float, ...] = ()  # path length at each point
    corners_um: tuple[float, ...] = ()  # path length at every corner, over all legs

    @classmethod
    def of(cls, machine: Machine, points_um: NDArray[Any], start_um: float) -> "_Setup":
        """Read the set-up and the drawing."""
        pulses = PulseSettings(pulse_A=discharge_current_A(machine))
        t_i, t_p = pulses.code_of_t_i(machine.t_on_us), pulses.code_of_t_p(machine.t_period_us)
        while t_i and pulses.mean_current_A(t_i, t_p) > LIMIT_A:
            t_i -= 1  # a setting at the limit may be rounded above it
        check_1982(machine.base.table.step_um.value)
        unit = unit_for(machine.base.table.travel_mm.value * 1e3)
        size_um = unit_um(unit)
        line = Polyline(np.asarray(points_um, np.float64) * 1e-3, closed=False)
        points = tuple((round(x * 1e3) // size_um, round(y * 1e3) // size_um) for x, y in line.points)
        along = line.s * 1e3 + start_um
        corners = tuple(float(s) for s in along[line.corners(CORNER_DEG)])
        return cls(pulses, (t_i, t_p), machine.t_on_us, unit, points, tuple(float(s) for s in along), corners)


@dataclass
class McuController(CountsController):
    """The register-level controller of 1982; its other parameters are those of `CountsController`."""

    name: ClassVar[str] = "mcu"

    # distance before a corner from which t(i) is shortened; 0 for no change of the generator
    corner_um: float = 0.0
    corner_share: float = 0.6  # factor on t(i) there; the code is at least 1

    # its registers; every leg begins with a new one
    computer: Computer = field(default_factory=Computer, init=False, repr=False)
    _move: int = field(default=-1, init=False, repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._setup = _Setup()
        self._run: PathRun | None = None

    @property
    def _counters(self) -> PulseAnalyser:
        return self.computer.board.counters

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        """Read the generator's setting and the path; called before every leg of the cut."""
        self._setup = _Setup.of(machine, points_um, start_um)
        drawn_A = self._setup.pulses.pulse_A * machine.t_on_us / machine.t_period_us
        if self.corner_um and drawn_A > LIMIT_A + 1e-9:  # no pair of codes has this current
            raise InputError(
                f"corner_um of the {self.name} controller needs a setting of at most {LIMIT_A:g} A, but t_on "
                f"{machine.t_on_us:g} us in t_period {machine.t_period_us:g} us draws {drawn_A:.2f} A: leave "
                "corner_um out, or lengthen t_period"
            )

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a new cut: INIT, position and settings as MAIN gets them, start."""
        command = super().reset(max_feed_um_s)
        self._start(wrap=False)
        return command

    def path_run(self, planner: str) -> Planner | None:
        """Return the computer's own motion for `poscal-literal`, with which it makes the steps as in 1982."""
        if kind_of(planner).number != LITERAL:
            return None
        self._start(wrap=True)
        self._run = PathRun(self.computer, self._setup.points)
        return self._run

    def _start(self, wrap: bool) -> None:
        """Run INIT, set position and settings, start."""
        setup = self._setup
        self.computer = Computer(Board(setup.pulses), unit=setup.unit, wrap=wrap)
        self.computer.init()
        if setup.points:
            self.computer.set_position(*setup.points[0])
        self.computer.set_pulse_codes(*setup.codes)
        memory = self.computer.board.bus
        assert self._settings is not None
        memory_map.set_constants(memory, self._settings)
        memory_map.set_variables(memory, self._state)
        self.computer.start()
        self._move, self._run = -1, None

    @property
    def emergency(self) -> str | None:
        """Message of the emergency routine with its place; None if it has not run since the leg began."""
        computer = self.computer
        if computer.state != EMERGENCY:
            return None
        size_um = unit_um(self._setup.unit)
        x_mm, y_mm = (place * size_um / 1e3 for place in computer.position)
        switches = " and ".join(computer.cause)
        why = f" ({switches})" if switches else ""
        return f"the controller's emergency routine{why} stopped the machine at x {x_mm:.3f} y {y_mm:.3f} mm"

    def open_switch(self, name: str) -> None:
        """Open a safety switch: its line interrupts, and the emergency routine runs."""
        self.computer.board.switches.trip(name)
        self.computer.serve()

    def update(self, window: WindowObservation) -> FeedCommand:
        """Feed for the next window; the interrupt routines of the steps delay the program."""
        self.computer.serve()
        if self._run is not None:
            late_ns = max(self.computer.steppers.free_ns - self.computer.board.now_ns, 0)
            self._busy_until_ns = self._clock_ns + round(window.duration_s * 1e9) + late_ns
        return super().update(window)

    def drive(self, steps: list[Step]) -> list[Step]:
        """Let timers, interrupts and port make a planner's steps."""
        return self.computer.drive(steps)

    def _decide(self, tick: int, path_um: float) -> tuple[int, int]:
        setup = self._setup
        if setup.points and self._run is None:
            here = self._move
            if here < 0 or not setup.starts_um[here] <= path_um <= setup.starts_um[here + 1]:
                self._aim(path_um)
        speed, t_states = self.computer.optimise(tick, math.floor(path_um) & WORD)
        self._state = memory_map.variables(self.computer.board.bus)
        return speed, t_states

    def _aim(self, path_um: float) -> None:
        """Pass the end of the present move to the program."""
        setup = self._setup
        self._move = min(max(bisect_right(setup.starts_um, path_um) - 1, 0), len(setup.points) - 2)
        self.computer.steppers.aim_for_planner(*setup.points[self._move + 1])

    def _command(self, path_um: float) -> FeedCommand:
        command = super()._command(path_um)
        setup = self._setup
        if command.alarm is not None:
            self.computer.emergency()
        if self.computer.state == EMERGENCY or not (self.corner_um and setup.points):
            return command
        ahead = bisect_right(setup.corners_um, path_um)
        left = setup.corners_um[ahead] - path_um if ahead < len(setup.corners_um) else math.inf
        t_i, t_p = setup.codes
        code = before_corner(t_i, int(min(left, WORD)), round(self.corner_um), round(self.corner_share * 256))
        if code != self.computer.pulse_codes[0]:
            self.computer.set_pulse_codes(code, t_p)
        return command._replace(t_on_us=setup.t_on_us if code == t_i else setup.pulses.times_us(code, t_p)[0])
