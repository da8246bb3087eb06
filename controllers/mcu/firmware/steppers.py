"""The stepper routines: one interrupt routine with two entries, POSITI, and the counts for the timers.

Two kinds of moves share them. For the program's own moves, POSCAL computes the direction once, as in 1982: the timers
count down from values for XVELOC and YVELOC, and each routine takes its T-states. A planner's steps use the same
timers, interrupts and lines, at the planner's times.
"""

from collections.abc import Callable, Iterable

from edmsim.controllers.mcu.board import Board
from edmsim.controllers.mcu.chips import pic, pit
from edmsim.controllers.mcu.chips.bus import CPORT2, TIMERS
from edmsim.controllers.mcu.firmware import memory_map as at
from edmsim.controllers.mcu.firmware import poscal, timers
from edmsim.controllers.mcu.firmware.poscal import BYTE, STEP_UM, WORD, Displacement, Unit, subsgn, velocm
from edmsim.controllers.protocols import Step
from edmsim.snapshots import Snapshots

SIGN = 0x8000  # bit of a negative word


class Steppers(Snapshots):
    """Both axes: their variables in RAM, their timers, their lines."""

    STATE = ("own", "t_states", "free_ns", "_tick", "_last_tick", "_aim")
    _aim: Displacement | None

    def __init__(self, board: Board, serve: Callable[[], bool], unit: Unit, wrap: bool) -> None:
        self.board = board
        self.own = False  # whether the timers make the steps, of a move of the program's own
        self.t_states = 0  # what the routines have cost
        self.free_ns = 0  # when the main program has done what it computes; interrupts put that off
        self.unit: Unit = unit
        self._serve = serve
        self._half_step = STEP_UM // poscal.unit_um(unit) // 2
        self._wrap = wrap
        self._aim = None
        self._clock = timers.TickClock()
        self._tick = -1  # that of time 0 is to come
        self._last_tick = [0, 0]
        lines = board.lines
        self._bits = ((lines.x_direction, lines.x_pulse), (lines.y_direction, lines.y_pulse))

    @property
    def aimed(self) -> bool:
        """Whether POSCAL has found a way that still counts."""
        return self._aim is not None

    @property
    def moving(self) -> bool:
        """Whether an axis is under way in a move of the program's own: XVELOC or YVELOC is not 0."""
        return self.own and any(self.board.bus.word(area + at.VELOCITY) for area in at.AREAS)

    def signed(self, address: int) -> int:
        """Word in RAM as a signed number."""
        word = self.board.bus.word(address)
        return word - 0x10000 if word & SIGN else word

    def stop(self) -> None:
        """Unload both timers, and forget the move; the counters and the targets stay."""
        self.own, self._aim = False, None
        bus = self.board.bus
        for axis, area in enumerate(at.AREAS):
            bus.write(TIMERS + pit.CONTROL, pit.control_word(axis, pit.TERMINAL_COUNT))
            bus.store(area + at.VELOCITY, 0)
            bus.store(area + at.ROUNDS, 0)

    def aim(self, x: int, y: int, heading: int = 1) -> int:
        """Note the target and resolve the way there (POSCAL, row T-69); returns T-states with VELOCM."""
        bus = self.board.bus
        self.lead_to(x, y)
        dx, x_direction = subsgn(x, bus.word(at.XPOS))
        dy, y_direction = subsgn(y, bus.word(at.YPOS))
        self._aim = poscal.resolve(dx, dy, x_direction * heading, y_direction * heading, self._wrap)
        cost = timers.poscal_t_states(dx, dy, bus.word(at.MAXVEL))
        self.t_states += cost
        return cost

    def lead_to(self, x: int, y: int) -> None:
        """Note the target alone: the way stays the one resolved before."""
        self.board.bus.store(at.NEWX, x)
        self.board.bus.store(at.NEWY, y)

    def look_to(self, x: int, y: int) -> None:
        """Note where a planner leads the wire: XVELOC and YVELOC point there, and it makes the steps."""
        self.aim(x, y)
        self.set_speed(self.signed(at.CUTVEL))

    def set_speed(self, units: int) -> None:
        """VELOCM with the way resolved before; XVELOC and YVELOC are read by the next interrupts."""
        bus = self.board.bus
        bus.store(at.CUTVEL, units)
        if self._aim is None:
            return
        for axis, speed in enumerate(velocm(self._aim, min(abs(units), BYTE))):
            area, velocity = at.AREAS[axis], speed if units > 0 else -speed
            if self.own and velocity:
                if not self._to_go(area, velocity):
                    velocity = 0
                elif not bus.word(area + at.VELOCITY):
                    self._load(axis, timers.reload_count(abs(velocity)))
            bus.store(area + at.VELOCITY, velocity)

    def begin(self, x: int, y: int, heading: int = 1) -> int:
        """Begin a move of the program's own with POSCAL, from a stand; `set_speed` starts the timers."""
        for area in at.AREAS:
            self.board.bus.store(area + at.VELOCITY, 0)
        self.own = True
        self._tick = max(self._tick, self._clock.before(self.board.now_ns))
        return self.aim(x, y, heading)

    def busy(self, t_states: int) -> None:
        """Let the main program compute for so long."""
        self.free_ns = self.board.now_ns + timers.nanoseconds(t_states)

    def run_until(self, end_ns: int, to_the_end: bool = True) -> None:
        """Let the timers run up to a time, or the move's end, and serve interrupts; a routine begun is finished."""
        board, clock = self.board, self._clock
        x, y, _ = board.timers.counters
        was = not to_the_end and self.moving
        last = clock.before(end_ns)
        while True:
            self._serve()
            if board.now_ns >= end_ns or (was and not self.moving):
                return
            due = self._tick + min(x.ticks_to_rise, y.ticks_to_rise)
            if due <= last:
                self._pass(max(clock.time_ns(due), board.now_ns), due)
            else:
                self._pass(end_ns, last)

    def drive(self, steps: Iterable[Step]) -> None:
        """Make a planner's steps: it says into which counter what time is loaded, and which way."""
        board, bus = self.board, self.board.bus
        self.own = False
        for time_ns, axis, direction in steps:
            board.now_ns = time_ns
            area = at.AREAS[axis]
            if self.signed(area + at.VELOCITY) * direction <= 0:
                bus.store(area + at.VELOCITY, direction)
            tick = self._clock.before(time_ns + 1)
            waited = max(tick - self._last_tick[axis], 1)
            self._last_tick[axis] = tick
            # whole rounds of the counter are waited before the rest is loaded
            bus.store(area + at.ROUNDS, (waited - 1) // timers.TIMER_COUNT)
            self._load(axis, waited)
            if board.timers.counters[axis].run(waited & WORD or timers.TIMER_COUNT):
                board.interrupts.request(pic.X_STEPPER + axis)
            if not self._serve():
                return

    def interrupt(self, axis: int) -> None:
        """The stepper interrupt routine of an axis (row T-71): the next count, one step, POSITI.

        The count comes first, so that the time between two steps is the count's however long the routine takes. In a
        move of the program's own an axis at its target gets the speed 0, and its next interrupt does nothing.
        """
        area = at.AREAS[axis]
        self._spend(timers.ENTRY_T)
        velocity = self.signed(area + at.VELOCITY)
        if not velocity:
            return
        if self.own:
            self._load(axis, timers.reload_count(abs(velocity)))
        self._spend(timers.LOAD_T + timers.PULSE_T)
        direction, pulse = self._bits[axis]
        bus = self.board.bus
        bus.write(CPORT2, direction << 1 | (velocity > 0))
        bus.write(CPORT2, pulse << 1 | 1)
        bus.write(CPORT2, pulse << 1)
        bus.store(area, poscal.positi(bus.word(area), 1 if velocity > 0 else -1, self._wrap, self.unit))
        self._spend(timers.POSITI_T + timers.RETURN_T)
        if self.own and not self._to_go(area, velocity):
            bus.store(area + at.VELOCITY, 0)

    def _spend(self, t_states: int) -> None:
        """Let a routine take its time: the timers run on, and the main program waits."""
        self.t_states += t_states
        if not self.own:
            return  # a planner's times are those of the edges
        before_ns, spent_ns = self.board.now_ns, timers.nanoseconds(t_states)
        if self.free_ns > before_ns:
            self.free_ns += spent_ns
        self._pass(before_ns + spent_ns, self._clock.before(before_ns + spent_ns + 1))

    def _pass(self, time_ns: int, tick: int) -> None:
        """Let time pass, and the timers count up to a tick."""
        board = self.board
        for axis in (pit.X, pit.Y):
            if board.timers.counters[axis].run(tick - self._tick):
                board.interrupts.request(pic.X_STEPPER + axis)
        board.now_ns, self._tick = time_ns, tick

    def _to_go(self, area: int, velocity: int) -> bool:
        """Whether an axis is more than half a step from its target."""
        bus = self.board.bus
        left = bus.word(area + at.TARGET) - bus.word(area)
        return (left if velocity > 0 else -left) > self._half_step

    def _load(self, axis: int, count: int) -> None:
        self.board.bus.write(TIMERS + axis, count & BYTE)
        self.board.bus.write(TIMERS + axis, count >> 8 & BYTE)
