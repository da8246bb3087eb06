"""The 8085 with its program: the document's routines for the hardware, and their variables in RAM."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import accumulate, pairwise

from edmsim.controllers.mcu.board import Board
from edmsim.controllers.mcu.chips import bus, pic, pit, ppi, uart
from edmsim.controllers.mcu.chips.bus import CPORT2, PORT2A, PORT2B, TIMERS, Bus
from edmsim.controllers.mcu.chips.cpu import A, C, Cpu8085, NoCodeError
from edmsim.controllers.mcu.chips.dac import COARSE
from edmsim.controllers.mcu.firmware import memory_map as at
from edmsim.controllers.mcu.firmware import poscal, timers
from edmsim.controllers.mcu.firmware.optimise import optimise
from edmsim.controllers.mcu.firmware.poscal import BYTE, STEP_UM, WORD, Displacement, Unit, subsgn, unit_um, velocm
from edmsim.controllers.mcu.firmware.timers import CPU_HZ, MAX_SPEED, nanoseconds, tick_before, tick_time_ns
from edmsim.controllers.protocols import Step, check_window
from edmsim.errors import InputError
from edmsim.machine.setting import WINDOW_PULSES
from edmsim.snapshots import Snapshots

# The stepper routines: one interrupt routine with two entries, POSITI, and the counts for the timers.
#
# There are two kinds of moves. For the program's own moves, POSCAL computes the direction once, as in 1982: the
# timers count down from values for XVELOC and YVELOC, and each routine takes its T-states. A planner's steps use the
# same timers, interrupts and lines, at the planner's times.


_CLOCK = timers.timer_clock_hz(timers.SPEED_UNIT_NM_S).as_integer_ratio()  # hertz and per of both axes' timers


class Steppers(Snapshots):
    """Both axes: their variables in RAM, their timers, their lines."""

    STATE = ("own", "t_states", "free_ns", "_tick", "_last_tick", "_aim")
    _aim: Displacement | None

    def __init__(self, board: Board, serve: Callable[[], bool], unit: Unit, wrap: bool) -> None:
        self.board, self._bus = board, board.bus
        self.own = False  # whether the timers make the steps, in a move of the program itself
        self.t_states = 0  # T-states of the routines so far
        self.free_ns = 0  # when the main program ends its computation; interrupts delay it
        self.unit: Unit = unit
        self._serve = serve
        self._half_step = STEP_UM // poscal.unit_um(unit) // 2
        self._wrap = wrap
        self._aim = None
        self._tick = -1  # before the tick of time 0
        self._last_tick = [0, 0]
        lines = board.lines
        self._bits = ((lines.x_direction, lines.x_pulse), (lines.y_direction, lines.y_pulse))

    @property
    def aimed(self) -> bool:
        """Whether there is a valid result of POSCAL."""
        return self._aim is not None

    @property
    def at_target(self) -> bool:
        """Whether the move began at its target, so POSCAL has found no direction."""
        return self._aim is not None and not self._aim.length

    @property
    def moving(self) -> bool:
        """Whether an axis runs in a move of the program itself: XVELOC or YVELOC is not 0."""
        return self.own and any(self._bus.word(area + at.VELOCITY) for area in at.AREAS)

    def stop(self) -> None:
        """Unload both timers, and end the move; counters and targets do not change."""
        self.own, self._aim = False, None
        for axis, area in enumerate(at.AREAS):
            self._bus.write(TIMERS + pit.CONTROL, pit.control_word(axis, pit.TERMINAL_COUNT))
            self._bus.store(area + at.VELOCITY, 0)
            self._bus.store(area + at.ROUNDS, 0)

    def aim(self, x: int, y: int, heading: int = 1) -> int:
        """Set the target and compute the direction (POSCAL, row T-69); return the T-states, with VELOCM."""
        self.set_target(x, y)
        dx, x_direction = subsgn(x, self._bus.word(at.XPOS))
        dy, y_direction = subsgn(y, self._bus.word(at.YPOS))
        self._aim = poscal.resolve(dx, dy, x_direction * heading, y_direction * heading, self._wrap)
        cost = timers.poscal_t_states(dx, dy, self._bus.word(at.MAXVEL))
        self.t_states += cost
        return cost

    def set_target(self, x: int, y: int) -> None:
        """Set only the target; the direction does not change."""
        self._bus.store(at.NEWX, x)
        self._bus.store(at.NEWY, y)

    def aim_for_planner(self, x: int, y: int) -> None:
        """Set the target of a planner's move: XVELOC and YVELOC point there, but the planner makes the steps."""
        self.aim(x, y)
        self.set_speed(self._bus.signed(at.CUTVEL))

    def set_speed(self, units: int) -> None:
        """Run VELOCM with the present direction; the next interrupts read XVELOC and YVELOC."""
        self._bus.store(at.CUTVEL, units)
        if self._aim is None:
            return
        for axis, speed in enumerate(velocm(self._aim, min(abs(units), BYTE))):
            area, velocity = at.AREAS[axis], speed if units > 0 else -speed
            if self.own and velocity:
                if not self._to_go(area, velocity):
                    velocity = 0
                elif not self._bus.word(area + at.VELOCITY):
                    self._load(axis, timers.reload_count(abs(velocity)))
            self._bus.store(area + at.VELOCITY, velocity)

    def begin(self, x: int, y: int, heading: int = 1) -> int:
        """Begin a move of the program itself with POSCAL, from rest; `set_speed` starts the timers."""
        for area in at.AREAS:
            self._bus.store(area + at.VELOCITY, 0)
        self.own = True
        self._tick = max(self._tick, tick_before(self.board.now_ns, *_CLOCK))
        return self.aim(x, y, heading)

    def busy(self, t_states: int) -> None:
        """Let the main program compute for a number of T-states."""
        self.free_ns = self.board.now_ns + timers.nanoseconds(t_states)

    def run_until(self, end_ns: int, to_the_end: bool = True) -> None:
        """Run timers and interrupts up to a time, or to the end of the move; a routine that has begun is finished."""
        board = self.board
        x, y, _ = board.timers.counters
        was = not to_the_end and self.moving
        last = tick_before(end_ns, *_CLOCK)
        while True:
            self._serve()
            if board.now_ns >= end_ns or (was and not self.moving):
                return
            due = self._tick + min(x.ticks_to_rise, y.ticks_to_rise)
            if due <= last:
                self._pass(max(tick_time_ns(due, *_CLOCK), board.now_ns), due)
            else:
                self._pass(end_ns, last)

    def drive(self, steps: Iterable[Step]) -> None:
        """Make a planner's steps: the planner determines counter, loaded time and direction."""
        board = self.board
        self.own = False
        for time_ns, axis, direction in steps:
            board.now_ns = time_ns
            area = at.AREAS[axis]
            if self._bus.signed(area + at.VELOCITY) * direction <= 0:
                self._bus.store(area + at.VELOCITY, direction)
            tick = tick_before(time_ns + 1, *_CLOCK)
            waited = max(tick - self._last_tick[axis], 1)
            self._last_tick[axis] = tick
            # wait whole rounds of the counter, then load the rest
            self._bus.store(area + at.ROUNDS, (waited - 1) // timers.TIMER_COUNT)
            self._load(axis, waited)
            if board.timers.counters[axis].run(waited & WORD or timers.TIMER_COUNT):
                board.interrupts.request(pic.X_STEPPER + axis)
            if not self._serve():
                return

    def interrupt(self, axis: int) -> None:
        """The stepper interrupt routine of an axis (row T-71): the next count, one step, POSITI.

        The count is loaded first, so the time between two steps does not depend on the duration of the routine. In a
        move of the program itself an axis at its target gets the speed 0, and its next interrupt does nothing.
        """
        area = at.AREAS[axis]
        self._spend(timers.ENTRY_T)
        velocity = self._bus.signed(area + at.VELOCITY)
        if not velocity:
            return
        if self.own:
            self._load(axis, timers.reload_count(abs(velocity)))
        self._spend(timers.LOAD_T + timers.PULSE_T)
        direction, pulse = self._bits[axis]
        self._bus.write(CPORT2, direction << 1 | (velocity > 0))
        self._bus.write(CPORT2, pulse << 1 | 1)
        self._bus.write(CPORT2, pulse << 1)
        self._bus.store(area, poscal.positi(self._bus.word(area), 1 if velocity > 0 else -1, self._wrap, self.unit))
        self._spend(timers.POSITI_T + timers.RETURN_T)
        if self.own and not self._to_go(area, velocity):
            self._bus.store(area + at.VELOCITY, 0)

    def _spend(self, t_states: int) -> None:
        """Advance the time by a routine's duration: the timers run, and the main program waits."""
        self.t_states += t_states
        if not self.own:
            return  # a planner's times are already those of the edges
        before_ns, spent_ns = self.board.now_ns, timers.nanoseconds(t_states)
        if self.free_ns > before_ns:
            self.free_ns += spent_ns
        self._pass(before_ns + spent_ns, tick_before(before_ns + spent_ns + 1, *_CLOCK))

    def _pass(self, time_ns: int, tick: int) -> None:
        """Advance the time, and the timers up to a tick."""
        board = self.board
        for axis in (pit.X, pit.Y):
            if board.timers.counters[axis].run(tick - self._tick):
                board.interrupts.request(pic.X_STEPPER + axis)
        board.now_ns, self._tick = time_ns, tick

    def _to_go(self, area: int, velocity: int) -> bool:
        """Return whether an axis is more than half a step from its target."""
        left = self._bus.word(area + at.TARGET) - self._bus.word(area)
        return (left if velocity > 0 else -left) > self._half_step

    def _load(self, axis: int, count: int) -> None:
        self._bus.write(TIMERS + axis, count & BYTE)
        self._bus.write(TIMERS + axis, count >> 8 & BYTE)


# The program's control of generator and wire: codes of the converters, less energy before a corner, wire tension.
# The document mentions path-dependent generator control as future work. Sparks bend the wire back, so it cuts off
# corners; less energy bends it less. So the routine shortens t(i) before a corner and keeps t(p): the mean current
# falls, and the generator accepts the pair of codes.


def write_codes(board: Board, t_i: int, t_p: int) -> None:
    """Write both codes, first the one that lowers the current, so that no pair in between draws more (row T-34)."""
    bus, lines = board.bus, board.lines
    if (t_i ^ board.codes[0] | t_p ^ board.codes[1]) & COARSE:
        bus.write(PORT2A, 0)
        for line, code in ((lines.t_i_coarse, t_i), (lines.t_p_coarse, t_p)):
            bus.write(CPORT2, line << 1 | bool(code & COARSE))
    order = [(PORT2A, t_i & BYTE), (PORT2B, t_p & BYTE)]
    for address, code in order if (t_i & BYTE) < board.codes[0] & BYTE else reversed(order):
        bus.write(address, code)


def set_tension(board: Board, low: bool) -> None:
    """Lower the wire's tension by a spare line, or restore it (row T-85)."""
    board.bus.write(CPORT2, board.lines.low_tension << 1 | low)


def before_corner(t_i: int, to_corner_um: int, reach_um: int, share: int) -> int:
    """Return the code of t(i) before a corner: within `reach_um`, `share` / 256 of it, at least 1 if it is not 0."""
    if to_corner_um >= reach_um:
        return t_i
    byte = t_i & BYTE
    return t_i & COARSE | max(byte * min(share, BYTE + 1) >> 8, min(byte, 1))


# Character streams: routines that read and write, with addresses at CIADR and COADR (row T-58).


class Streams:
    """Input and output, each redirected to any routine by its address in `memory`."""

    def __init__(self, memory: Bus) -> None:
        self.memory = memory
        self.inputs: dict[int, Callable[[], int | None]] = {
            at.TERMINAL_IN: partial(self._fetch, bus.TERMINAL),
            at.HOST_IN: partial(self._fetch, bus.HOST),
        }
        self.outputs: dict[int, Callable[[int], None]] = {
            at.TERMINAL_OUT: partial(memory.write, bus.TERMINAL),
            at.HOST_OUT: partial(memory.write, bus.HOST),
        }

    def ci(self) -> int | None:
        """Return a character from the stream of CIADR, or None if it has sent nothing."""
        address = self.memory.word(at.CIADR)
        if address not in self.inputs:
            raise InputError(f"CIADR holds {address:04X}H: there is no input routine")
        return self.inputs[address]()

    def co(self, character: int) -> None:
        """Send a character to the stream of COADR; see `ci`."""
        address = self.memory.word(at.COADR)
        if address not in self.outputs:
            raise InputError(f"COADR holds {address:04X}H: there is no output routine")
        self.outputs[address](character)

    def _fetch(self, channel: int) -> int | None:
        return self.memory.read(channel) if self.memory.read(channel + 1) & uart.RX_READY else None


# Set-up by INIT and the monitor: start values copied from their table, safe outputs, serial channels (5.1.1).

JUMP = 0xC3  # JMP of the 8085
BIT_RATE = 9600  # rate of both serial channels in bit/s (ours)
BIT_RATE_COUNT = CPU_HZ // (16 * BIT_RATE)  # count of counter 2: sixteen clocks per bit
_ROUTINES = {
    pic.EMERGENCY: at.EMERGENCY_ROUTINE, pic.X_STEPPER: at.X_ENTRY, pic.Y_STEPPER: at.Y_ENTRY,
    pic.KEYBOARD: at.KBD_ROUTINE,
}  # fmt: skip


def load_start_values(memory: Bus) -> None:
    """Write the control program's table of start values to RAM: zeros, then jumps."""
    jumps = b"".join(
        bytes((JUMP, routine & BYTE, routine >> 8, 0))
        for routine in (_ROUTINES.get(level, at.NO_ROUTINE) for level in range(8))
    )
    table = jumps.rjust(sum(size for _, size in at.START_AREAS), b"\0")
    for offset, byte in enumerate(table):
        memory.write(at.START_VALUES + offset, byte)


def copy_start_values(memory: Bus) -> None:
    """Copy the table in RAM to the data areas and the jump table (rows T-80, T-82)."""
    source = at.START_VALUES
    for first, size in at.START_AREAS:
        for offset in range(size):
            memory.write(first + offset, memory.read(source + offset))
        source += size


def make_outputs_safe(memory: Bus, oev: int) -> None:
    """Set the directions of the ports and safe values: voltages 0, handshake off, generator off by its bit `oev`."""
    memory.write(bus.CPORT2, ppi.BASIC_OUTPUTS)
    memory.write(bus.PORT2C, 1 << oev)
    memory.write(bus.PORT2A, 0)
    memory.write(bus.PORT2B, 0)
    memory.write(bus.CPORT3, ppi.STROBED_INPUTS)
    for bit in (ppi.INTE_A_BIT, ppi.INTE_B_BIT):
        memory.write(bus.CPORT3, bit << 1)
    memory.write(bus.CPORT3, ppi.RESET_BIT << 1 | 1)  # this pulse resets the counters
    memory.write(bus.CPORT3, ppi.RESET_BIT << 1)


def set_up_monitor(memory: Bus) -> None:
    """Do the monitor's set-up: bit rate, serial channels, streams (row T-81)."""
    memory.write(bus.TIMERS + pit.CONTROL, pit.control_word(pit.BIT_RATE, pit.SQUARE_WAVE))
    memory.write(bus.TIMERS + pit.BIT_RATE, BIT_RATE_COUNT & BYTE)
    memory.write(bus.TIMERS + pit.BIT_RATE, BIT_RATE_COUNT >> 8)
    for channel in (bus.TERMINAL, bus.HOST):
        memory.write(channel + 1, uart.COMMAND_RESET)
        memory.write(channel + 1, uart.MODE_8_BITS)
        memory.write(channel + 1, uart.COMMAND_RUN | uart.COMMAND_RESET_ERRORS)
    memory.store(at.CIADR, at.TERMINAL_IN)
    memory.store(at.COADR, at.TERMINAL_OUT)


CALL_T, CHARACTER_T = 18, CPU_HZ * uart.BITS_PER_CHARACTER // BIT_RATE
"""T-states of a call of one of our routines, and of a character sent or received."""
LONGEST_T = 30 * CPU_HZ // 1000
"""Longest duration of an interrupt routine (ours: half of the shortest time between two steps)."""


class MachineCode:
    """The 8085 with instructions in RAM and our routines in EPROM."""

    def __init__(self, board: Board, streams: Streams, routines: Mapping[int, Callable[[], None]]) -> None:
        self.running = False
        self._board = board
        self._streams = streams
        self._routines = routines
        self.cpu = Cpu8085(board.bus, self._routine)

    def call(self, address: int) -> None:
        """Run the code at an address until it returns, at once; registers are restored."""
        cpu = self.cpu
        saved = [*cpu.registers], cpu.flags, cpu.pc, cpu.sp
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
            cpu.registers, cpu.flags, cpu.pc, cpu.sp = saved
            cpu.halted = False

    def begin(self, address: int) -> None:
        """Start a program; `run_until` runs it until it returns, jumps to 0000H or halts."""
        cpu = self.cpu
        cpu.pc, cpu.sp, cpu.halted, self.running = address, at.STACK, False, True
        cpu.push(at.MONITOR)

    def run_until(self, end_ns: int) -> None:
        """Run the program up to a time, at the clock of the 8085; an error ends it."""
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
            board.now_ns = begin_ns + nanoseconds(spent) if cost else end_ns

    def _routine(self, address: int) -> int:
        """Run a routine in EPROM; return 0 T-states if it waits for a character."""
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


OFF, STAND_BY, RUNNING, EMERGENCY = "off", "stand-by", "running", "emergency"
"""States of the machine: not initialised; safe; timers and interrupts on; stopped until INIT."""


def _nothing() -> None:
    """Do nothing: the program has no routine here."""


class Computer(Snapshots):
    """The controller's processor, program and board, whose time (`Board.now_ns`) `run_until` and `drive` advance.

    With `wrap` sixteen bits wrap, as in 1982: the position counters, which otherwise have soft limits (row T-A11),
    and the sum of squares in POSCAL, which otherwise is halved once more (row T-G6).

    >>> computer = Computer()
    >>> computer.init()
    >>> computer.set_position(30_000, 30_000)
    >>> computer.set_speed(127)
    >>> computer.start(generator=False)
    >>> computer.move_to(30_100, 30_000)
    >>> len(computer.run_until(4_000_000_000)), computer.position
    (50, (30100, 30000))
    """

    STATE = ("state", "cause", "keys", "_t_states", "_enabled", "steppers", "board")

    def __init__(self, board: Board | None = None, *, unit: Unit = "um", wrap: bool = False) -> None:
        self.board = board or Board()
        self.bus = self.board.bus  # memory and ports, without the program's checks
        self.state = OFF
        self.cause: tuple[str, ...] = ()
        self.keys: list[int] = []
        self.streams = Streams(self.bus)
        self.steppers = Steppers(self.board, self.serve, unit, wrap)
        self._t_states = 0
        self._enabled = False
        routines: dict[int, Callable[[], None]] = {
            at.EMERGENCY_ROUTINE: self.emergency,
            at.X_ENTRY: partial(self.steppers.interrupt, 0),
            at.Y_ENTRY: partial(self.steppers.interrupt, 1),
            at.KBD_ROUTINE: self._keyboard,
            at.NO_ROUTINE: _nothing,
            at.INIT: self.init,
        }
        self.code = MachineCode(self.board, self.streams, routines)
        load_start_values(self.bus)
        set_up_monitor(self.bus)

    @property
    def t_states(self) -> int:
        """T-states of the routines since the computer was made."""
        return self._t_states + self.steppers.t_states

    def reset(self) -> None:
        """Press the reset button: make the machine safe, and run the monitor's set-up (row T-81)."""
        self.init()
        set_up_monitor(self.bus)
        self.code.running, self.state = False, OFF

    def init(self) -> None:
        """INIT: make the machine safe and ready; required after an emergency (rows T-50, T-51)."""
        self._initialise()
        self.state, self.cause = STAND_BY, ()
        self._t_states += timers.INIT_T

    def emergency(self) -> None:
        """INIT in an emergency: first copy data, then change outputs (5.1.1, 5.3.2, row T-49)."""
        for k, address in enumerate(at.SAVED_WORDS):
            self.bus.store(at.SAVED + 2 * k, self.bus.word(address))
        self._initialise()
        self.code.running = False
        self.state, self.cause = EMERGENCY, self.board.switches.open
        self._t_states += timers.EMERGENCY_T

    def _initialise(self) -> None:
        """Common part of INIT: copy start values, STOP, safe outputs, the 8259 (rows T-50, T-80, T-A14)."""
        self._enabled = False
        copy_start_values(self.bus)
        self.keys.clear()
        self.steppers.stop()
        make_outputs_safe(self.bus, self.board.lines.oev)
        self.bus.write(bus.INTERRUPTS, pic.ICW1)
        self.bus.write(bus.INTERRUPTS + 1, pic.ICW2)

    @property
    def position(self) -> tuple[int, int]:
        """Position counters, in um or in steps."""
        return self.bus.word(at.XPOS), self.bus.word(at.YPOS)

    def set_position(self, x: int, y: int) -> None:
        """Set the position counters; raises `InputError` while the table moves, or for a value that is not a word."""
        if self.moving:
            raise InputError("the table is moving: the position can be set when it stands")
        check_place(x, y)
        self.bus.store(at.XPOS, x)
        self.bus.store(at.YPOS, y)

    @property
    def pulse_codes(self) -> tuple[int, int]:
        """Present codes of V(t(i)) and V(t(p)), with `COARSE` for that range."""
        return self.board.codes[0], self.board.codes[1]

    def set_pulse_codes(self, t_i: int, t_p: int) -> None:
        """Set both voltages; a pair that draws more than 2 A is refused, and the old pair is kept (row T-34)."""
        if self.state in (OFF, EMERGENCY):
            raise InputError("the machine is stopped: INIT first")
        self.board.settings.check(t_i, t_p)
        write_codes(self.board, t_i, t_p)

    @property
    def speed(self) -> int:
        """Greatest cutting speed in units."""
        return self.bus.word(at.MAXVEL)

    def set_speed(self, units: int) -> None:
        """Set the greatest cutting speed, 0..127 units (row T-A1), also of the present move."""
        if not (isinstance(units, int) and 0 <= units <= MAX_SPEED):
            raise InputError(f"the cutting speed is 0..{MAX_SPEED} units of 262.5 nm/s, not {units!r}")
        self.bus.store(at.MAXVEL, units)
        if self.moving and units:
            self.steppers.set_speed(units)

    def start(self, generator: bool = True) -> None:
        """Start the machine: interrupts, and optionally the generator; refused if a switch is open."""
        if self.state in (OFF, EMERGENCY):
            raise InputError("the machine is stopped: INIT first")
        if self.board.switches.open:
            raise InputError(f"the {self.board.switches.open[0]} switch is open: put that right first")
        if generator:
            self.bus.write(bus.CPORT2, self.board.lines.oev << 1)
        self._enabled, self.state = True, RUNNING

    def stop(self) -> None:
        """Stop table and generator; codes, speed and position do not change, and `start` continues."""
        self.bus.write(bus.CPORT2, self.board.lines.oev << 1 | 1)
        self.steppers.stop()
        self.bus.store(at.CUTVEL, 0)
        self._enabled = False
        if self.state == RUNNING:
            self.state = STAND_BY

    @property
    def moving(self) -> bool:
        """Whether a move of the program itself is running."""
        return self.steppers.moving

    def move_to(self, x: int, y: int) -> None:
        """Move straight to a position at the set speed, aimed once by POSCAL as in 1982."""
        if self.moving:
            raise InputError("the table is moving: a new move can begin when it stands")
        if self.state != RUNNING:
            raise InputError("the machine is not started: start it before a move")
        if not self.speed:
            raise InputError(f"the cutting speed is 0: set 1..{MAX_SPEED} units")
        check_place(x, y)
        self.steppers.begin(x, y)
        self.steppers.set_speed(self.speed)

    def run_until(self, end_ns: int, to_the_end: bool = True) -> list[Step]:
        """Run timers and interrupts up to a time, or the end of the move; return the steps that the motors made."""
        self.steppers.run_until(end_ns, to_the_end)
        return self.take_steps(end_ns)

    def drive(self, steps: Iterable[Step]) -> list[Step]:
        """Make a planner's steps through timers, interrupts and port; return the steps that the motors made."""
        if self.serve():
            self.steppers.drive(steps)
        return self.take_steps(self.board.now_ns + 1)

    def take_steps(self, end_ns: int) -> list[Step]:
        """Take the steps before a time; a routine that was running at that time has made its step later."""
        steps = self.board.steps
        self.board.steps = [step for step in steps if step.time_ns >= end_ns]
        return steps[: len(steps) - len(self.board.steps)]

    def serve(self) -> bool:
        """Serve pending interrupts by priority; return whether interrupts are enabled."""
        interrupts = self.board.interrupts
        while self._enabled and interrupts.interrupting:
            self._enabled = False  # as the 8085 does at an acknowledge
            entry = interrupts.acknowledge()
            try:
                self.code.call(entry)
            except NoCodeError as error:
                self.emergency()
                self.cause = (f"interrupt: {error.reason}",)
            self.bus.write(bus.INTERRUPTS, pic.END_OF_INTERRUPT)
            self._enabled = self.state == RUNNING
        return self._enabled

    def _keyboard(self) -> None:
        """Run the routine of the keyboard interrupt: read all keys."""
        while self.bus.read(bus.DISPLAY + 1) & 0x0F:
            self.keys.append(self.bus.read(bus.DISPLAY))
            self._t_states += timers.KEYBOARD_T

    def take_keys(self) -> list[int]:
        """Return the keys pressed since the last call; while interrupts are off, MAIN polls them."""
        if not self._enabled:
            self._keyboard()
        keys, self.keys = self.keys, []
        return keys

    def result_waits(self) -> bool:
        """Whether counts of 255 pulses are in the latches (IBF A and IBF B)."""
        full = ppi.IBF_A | ppi.IBF_B
        return self.bus.read(bus.PORT3C) & full == full

    def optimise(self, clock: int, path: int) -> tuple[int, int]:
        """Read the latched counts and run the optimising routine in RAM; return speed in units and T-states."""
        short, open = self.read_counts()
        memory = self.bus
        variables = at.variables(memory)
        units, t_states = optimise(at.constants(memory), variables, short, open, clock, path)
        at.set_variables(memory, variables)
        if self.steppers.own:
            self.bus.store(at.CUTVEL, units)
            self.steppers.busy(t_states)
        elif units & WORD != self.bus.word(at.CUTVEL):
            self.steppers.set_speed(units)
        self._t_states += t_states
        return units, t_states

    def read_counts(self) -> tuple[int, int]:
        """Read the latches of short and open pulses, and store the counts."""
        short, open = self.bus.read(bus.PORT3A), self.bus.read(bus.PORT3B)
        for address, count in ((at.SHORTS, short), (at.OPENS, open), (at.COUNTED, WINDOW_PULSES)):
            self.bus.store(address, count)
        return short, open


def check_place(x: int, y: int) -> None:
    """Refuse values that are not a pair of words."""
    for value in (x, y):
        if not (isinstance(value, int) and 0 <= value <= WORD):
            raise InputError(f"a position is 0..{WORD}, not {value!r}")


# A path followed by the computer's own timers and routines: `poscal-literal` on the machine of 1982.
# Here no planner computes the times of steps. The main program calls POSCAL once for each move and loads the timers,
# which count down in simulated time; their interrupts make the steps.

Place = tuple[int, int]


class PathRun(Snapshots):
    """The main program's part in a cut: it begins the moves of a path one after the other, and passes speeds on.

    It has the interface of a planner (`edmsim.controllers.planner.registry.Planner`), but its steps are the edges on
    the motors' lines. A new speed has effect when the optimising routine is done, a new move begins when POSCAL is
    done; interrupts delay both. A negative speed runs the present move's vector in reverse to the beginning of the
    move, and then the moves before it, each planned again. After a stop the present move is planned again from the
    table's position.

    >>> computer = Computer()
    >>> computer.init()
    >>> computer.set_position(30_000, 30_000)
    >>> computer.start()
    >>> run = PathRun(computer, [(30_000, 30_000), (30_010, 30_006)])
    >>> steps = run.advance(0, 1_000_000_000, 127)
    >>> len(steps), run.position_um, run.done
    (8, (30010, 30006), True)
    """

    STATE = ("_move", "_heading", "_over", "_requested", "_in_force", "_computing", "_computer")
    speed_unit_nm_s = timers.SPEED_UNIT_NM_S
    max_feed_um_s = timers.MAX_FEED_UM_S

    def __init__(self, computer: Computer, points: Sequence[Place]) -> None:
        for x, y in points:
            check_place(x, y)
        corners = [points[0], *(b for a, b in pairwise(points) if a != b)]
        if len(corners) < 2:
            raise InputError(f"a path needs two different points, not {len(corners)}")
        self._computer = computer
        self._steppers = computer.steppers
        self._size_um = unit_um(computer.steppers.unit)
        self._points = corners
        lengths_um = (math.dist(a, b) * self._size_um for a, b in pairwise(corners))
        self._along_um = list(accumulate(lengths_um, initial=0.0))
        self._over = False
        self._move, self._heading = 0, 1
        self._requested = self._in_force = 0
        self._computing = False

    @property
    def done(self) -> bool:
        """Whether the last move is over (each axis is at its target, or its component is 0 after REDUC)."""
        return self._over and not self._computer.board.steps

    @property
    def position_um(self) -> tuple[float, float]:
        """Position counters in um."""
        x, y = self._computer.position
        return x * self._size_um, y * self._size_um

    @property
    def path_um(self) -> float:
        """Length travelled along the path: the position counters projected onto the present move."""
        (x0, y0), (x1, y1) = self._points[self._move : self._move + 2]
        x, y = self._computer.position
        along_um, end_um = self._along_um[self._move : self._move + 2]
        run_um = ((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) * self._size_um**2 / (end_um - along_um)
        return along_um + min(max(run_um, 0.0), end_um - along_um)

    def advance(self, start_ns: int, end_ns: int, speed_units: int) -> list[Step]:
        """Run the machine for a window; a routine that runs at its end is finished, its step comes in the next."""
        check_window(start_ns, end_ns, speed_units, MAX_SPEED)
        computer, steppers, board = self._computer, self._steppers, self._computer.board
        self._requested = speed_units
        steps = computer.run_until(start_ns)
        while board.now_ns < end_ns and computer.state == RUNNING:
            if steppers.free_ns > board.now_ns:
                steps += computer.run_until(min(end_ns, steppers.free_ns))
            elif not self._main():
                steps += computer.run_until(end_ns, to_the_end=False)
        return steps + computer.run_until(end_ns)

    def _main(self) -> bool:
        """Do the next task if no computation is running; return whether there was one."""
        heading = 1 if self._requested > 0 else -1
        if self._computing:
            self._computing = False
            self._give(heading)
        elif self._requested and not self._steppers.aimed:
            self._begin(heading)
        elif self._requested != self._in_force:
            self._give(heading)
        elif self._requested and not self._steppers.moving:
            return self._begin_next(heading)
        else:
            return False
        return True

    def _give(self, heading: int) -> None:
        """Pass the speed on by VELOCM; exchange the ends of the move if its direction changes."""
        if self._requested and heading != self._heading:
            self._heading, self._over = heading, False
            if self._steppers.at_target:
                self._begin(heading)
                return
            self._steppers.set_target(*self._points[self._move + (heading > 0)])
        self._steppers.set_speed(self._requested)
        self._in_force = self._requested

    def _begin_next(self, heading: int) -> bool:
        """Begin the next move of the path; return False at its ends."""
        if not 0 <= self._move + heading <= len(self._points) - 2:
            self._over = heading > 0
            return False
        self._move += heading
        self._begin(heading)
        return True

    def _begin(self, heading: int) -> None:
        """Run POSCAL for the present move; when it is done, the timers are started."""
        self._heading, self._computing = heading, True
        self._steppers.busy(self._steppers.begin(*self._points[self._move + (heading > 0)], heading))
