"""The stepper routines: one interrupt routine with two entries, POSITI, and the counts the timers are loaded with.

Two ways of moving share them: a move of the program's own, aimed once by POSCAL as in 1982, and the steps of a
planner that re-aims at every step.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from edmsim.controllers.mcu.board import Board
from edmsim.controllers.mcu.chips import pic, pit
from edmsim.controllers.mcu.chips.bus import CPORT2, TIMERS
from edmsim.controllers.mcu.firmware import memory_map as at
from edmsim.controllers.mcu.firmware.arithmetic import BYTE, WORD, subsgn
from edmsim.controllers.mcu.firmware.poscal import STEP_UM, Displacement, Unit, positi, resolve, unit_um, velocm
from edmsim.controllers.mcu.firmware.timers import TIMER_COUNT, TickClock, reload_count
from edmsim.controllers.mcu.firmware.tstates import POSITI_T, STEPPER_T, poscal_t_states
from edmsim.controllers.protocols import Step

SIGN = 0x8000
"""Bit of a negative word."""


class Steppers:
    """Both axes: their variables in RAM, their timers, their lines.

    Parameters
    ----------
    board : Board
    serve : callable
        Serves the interrupts that wait; returns whether interrupts are still enabled.
    unit, wrap
        See `Computer`.

    Attributes
    ----------
    moving : bool
        Whether a move of the program's own is under way.
    t_states : int
        What the routines have cost.
    """

    def __init__(self, board: Board, serve: Callable[[], bool], unit: Unit, wrap: bool) -> None:
        self.board = board
        self.moving = False
        self.t_states = 0
        self._serve = serve
        self._unit: Unit = unit
        self._half_step = STEP_UM // unit_um(unit) // 2
        self._wrap = wrap
        self._aim: Displacement | None = None
        self._clock = TickClock()
        self._last_tick = [0, 0]
        lines = board.lines
        self._bits = ((lines.x_direction, lines.x_pulse), (lines.y_direction, lines.y_pulse))

    def signed(self, address: int) -> int:
        """Word in RAM as a signed number."""
        word = self.board.bus.word(address)
        return word - 0x10000 if word & SIGN else word

    def stop(self) -> None:
        """Unload both timers, and forget the move; the counters and the targets stay."""
        self.moving, self._aim = False, None
        bus = self.board.bus
        for axis, area in enumerate(at.AREAS):
            bus.write(TIMERS + pit.CONTROL, pit.control_word(axis, pit.TERMINAL_COUNT))
            bus.store(area + at.VELOCITY, 0)
            bus.store(area + at.ROUNDS, 0)

    def aim(self, x: int, y: int) -> None:
        """Note where the wire is to go, and resolve the way there: the first part of POSCAL (row T-69)."""
        bus, distances = self.board.bus, []
        for area, target in zip(at.AREAS, (x, y), strict=True):
            bus.store(area + at.TARGET, target)
            distances.append(subsgn(target, bus.word(area + at.POSITION)))
        (dx, x_direction), (dy, y_direction) = distances
        self._aim = resolve(dx, dy, x_direction, y_direction)
        self.t_states += poscal_t_states(dx, dy, bus.word(at.MAXVEL))

    def set_speed(self, units: int) -> None:
        """VELOCM with the way resolved before; XVELOC and YVELOC are read by the next interrupts."""
        bus = self.board.bus
        bus.store(at.CUTVEL, units)
        if self._aim is None:
            return
        for area, speed in zip(at.AREAS, velocm(self._aim, min(abs(units), BYTE)), strict=True):
            arrived = self.moving and not self._to_go(area, speed)
            bus.store(area + at.VELOCITY, 0 if arrived else speed if units > 0 else -speed)

    def move_to(self, x: int, y: int, units: int) -> None:
        """Begin a move of the program's own: POSCAL once, both timers loaded."""
        self.aim(x, y)
        self.moving = True
        self.set_speed(units)
        for axis, area in enumerate(at.AREAS):
            self._load_next(axis, area)

    def run_until(self, end_ns: int) -> None:
        """Let the timers run up to a time and serve their interrupts."""
        clock, counters = self._clock, self.board.timers.counters
        tick, last = clock.before(self.board.now_ns), clock.before(end_ns)
        while tick < last and self.moving:
            due = min(counters[0].ticks_to_rise, counters[1].ticks_to_rise, last - tick)
            tick += due
            self.board.now_ns = clock.time_ns(tick)
            for axis in (pit.X, pit.Y):
                if counters[axis].run(due):
                    self.board.interrupts.request(pic.X_STEPPER + axis)
            self._serve()
        self.board.now_ns = max(self.board.now_ns, end_ns)

    def drive(self, steps: Iterable[Step]) -> None:
        """Make a planner's steps: it says into which counter what time is loaded, and which way."""
        board, bus = self.board, self.board.bus
        for time_ns, axis, direction in steps:
            board.now_ns = time_ns
            area = at.AREAS[axis]
            if self.signed(area + at.VELOCITY) * direction <= 0:
                bus.store(area + at.VELOCITY, direction)
            tick = self._clock.before(time_ns + 1)
            waited = max(tick - self._last_tick[axis], 1)
            self._last_tick[axis] = tick
            # whole rounds of the counter are waited before the rest is loaded
            bus.store(area + at.ROUNDS, (waited - 1) // TIMER_COUNT)
            self._load(axis, waited & WORD)
            if board.timers.counters[axis].run(waited & WORD or TIMER_COUNT):
                board.interrupts.request(pic.X_STEPPER + axis)
            if not self._serve():
                return

    def interrupt(self, axis: int) -> None:
        """The stepper interrupt routine, entered for x or for y (row T-71): one step, POSITI, the next count."""
        area = at.AREAS[axis]
        velocity = self.board.bus.word(area + at.VELOCITY)
        if not velocity:
            return
        forward = velocity < SIGN
        direction, pulse = self._bits[axis]
        write = self.board.bus.write
        write(CPORT2, direction << 1 | forward)
        write(CPORT2, pulse << 1 | 1)
        write(CPORT2, pulse << 1)
        self._positi(area, forward)
        self.t_states += STEPPER_T + POSITI_T
        if self.moving:
            self._load_next(axis, area)

    def snapshot(self) -> list[int | list[int] | None]:
        """Everything that changes, but for what lies in RAM."""
        aim = None if self._aim is None else list(self._aim)
        return [int(self.moving), self.t_states, list(self._last_tick), aim]

    def restore(self, state: list[int | list[int] | None]) -> None:
        """Continue where `snapshot` was taken."""
        moving, t_states, ticks, aim = state
        assert isinstance(t_states, int)
        assert isinstance(ticks, list)
        self.moving, self.t_states, self._last_tick = bool(moving), t_states, list(ticks)
        self._aim = Displacement(*aim) if isinstance(aim, list) else None

    def _positi(self, area: int, forward: bool) -> None:
        """POSITI: the counter follows the pulse (row T-70)."""
        bus = self.board.bus
        bus.store(area, positi(bus.word(area), 1 if forward else -1, self._wrap, self._unit))

    def _to_go(self, area: int, velocity: int) -> bool:
        """Whether an axis is more than half a step from its target."""
        bus = self.board.bus
        left = bus.word(area + at.TARGET) - bus.word(area)
        return (left if velocity > 0 else -left) > self._half_step

    def _load_next(self, axis: int, area: int) -> None:
        """Load the count to the next step; at its target an axis stops."""
        velocity = self.signed(area + at.VELOCITY)
        if velocity and self._to_go(area, velocity):
            self._load(axis, reload_count(abs(velocity)) & WORD)
            return
        self.board.bus.store(area + at.VELOCITY, 0)
        self.moving = any(self.board.bus.word(other + at.VELOCITY) for other in at.AREAS)

    def _load(self, axis: int, count: int) -> None:
        self.board.bus.write(TIMERS + axis, count & BYTE)
        self.board.bus.write(TIMERS + axis, count >> 8)
