"""The rig: the 1982 controller's computer, connected to the simulated machine and run window by window."""

import math
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from typing import NamedTuple, cast

import numpy as np

from edmsim.closed_loop.stops import switches_open
from edmsim.consoles.computer_1982.words import Entry, Move, Setting, check_speed
from edmsim.controllers import make
from edmsim.controllers.feed.counts import CountsController
from edmsim.controllers.mcu.board import STOP_BUTTON, WIRE_BREAK, X_END, Y_END, Board, Faults, SafetySwitches
from edmsim.controllers.mcu.chips.dac import PulseSettings
from edmsim.controllers.mcu.computer import EMERGENCY, Computer, PathRun
from edmsim.controllers.mcu.computer import STAND_BY as COMPUTER_STAND_BY
from edmsim.controllers.mcu.firmware import memory_map as at
from edmsim.controllers.mcu.firmware.arcs import arc_points
from edmsim.controllers.mcu.firmware.optimise import ALARM, TICK_NS, State
from edmsim.controllers.mcu.firmware.poscal import STEP_UM, WORD, check_1982, unit_for, unit_um
from edmsim.controllers.mcu.firmware.timers import MAX_FEED_UM_S, MAX_SPEED, seconds
from edmsim.controllers.planner.kinds import LITERAL
from edmsim.controllers.planner.registry import Planner, counting, kind_of, make_planner
from edmsim.controllers.protocols import Step
from edmsim.errors import InputError
from edmsim.machine.machine import Machine
from edmsim.machine.pulse_window import PulseWindow
from edmsim.machine.setting import WINDOW_PULSES, discharge_current_A, open_V
from edmsim.metrology.edges import metal_at
from edmsim.plant.constants import table_mechanics
from edmsim.plant.plant import Plant
from edmsim.plant.window import PlantError

Point = tuple[int, int]  # a position in counter units: um or steps


class Route(NamedTuple):
    """The path of a program from the wire's position on."""

    corners: list[Point]
    lengths_um: list[float]  # length of path up to every corner but the first
    dues: list[tuple[float, Setting]]  # settings in order, each with the length of path from which it applies
    moves: list[tuple[float, Move]]  # moves in order, each with the length of path up to its end

    def move_at(self, path_um: float) -> Move:
        """Return the move at a length of path."""
        number = bisect_right([end_um for end_um, _ in self.moves], path_um)
        return self.moves[min(number, len(self.moves) - 1)][1]

    def corner_ahead(self, path_um: float) -> Point:
        """Return the next corner after a length of path."""
        return self.corners[min(bisect_right(self.lengths_um, path_um), len(self.lengths_um) - 1) + 1]


def lay_out(start: Point, program: Sequence[Entry], unit_um: int = 1) -> Route:
    """Return a program's path from a start on; `unit_um` is a counter's unit."""
    corners, lengths, dues, moves = [start], [0.0], [], []
    for entry in program:
        if isinstance(entry, Setting):
            dues.append((lengths[-1], entry))
            continue
        following = [entry.end_um]
        if entry.centre_um is not None:
            arc = arc_points(corners[-1], entry.centre_um, entry.end_um, entry.clockwise)
            following = [(int(x), int(y)) for x, y in arc[1:]]
        for corner in following:
            distance = float(np.hypot(corner[0] - corners[-1][0], corner[1] - corners[-1][1]))
            lengths.append(lengths[-1] + unit_um * distance)
            corners.append(corner)
        moves.append((lengths[-1], entry))
    if not lengths[-1]:
        raise InputError("the wire is there already; give another new position")
    return Route(corners, lengths[1:], dues, moves)


def moved(place_um: tuple[float, float], steps: Iterable[Step]) -> tuple[float, float]:
    """Return a position after some steps."""
    place = [*place_um]
    for step in steps:
        place[step.axis] += STEP_UM * step.direction
    return place[0], place[1]


END_SWITCHES = (X_END, Y_END)


class TableEnds:
    """Ends of the carriage's travel: the stops of the machine's MJCF, and end switches unless they are stuck."""

    def __init__(self, machine: Machine, switches: SafetySwitches) -> None:
        self._travel_um = machine.base.table.travel_mm.value * 1e3
        self._stops_um = table_mechanics(machine, longest_us=1e3).stops_um
        self._switches = switches

    def switch_open(self, axis: int, direction: int, place_um: float) -> bool:
        """Return whether a step of an axis in a direction has opened its end switch."""
        if END_SWITCHES[axis] in self._switches.stuck:
            return False
        return switches_open(place_um, self._travel_um, STEP_UM) == direction

    def passed(self, place_um: tuple[float, float], steps: Iterable[Step]) -> list[Step]:
        """Return the steps that the table makes from a position; steps of a motor against a stop are lost."""
        place, made = [*place_um], []
        low_um, high_um = self._stops_um
        for step in steps:
            there_um = place[step.axis] + STEP_UM * step.direction
            if low_um <= there_um <= high_um:
                place[step.axis] = there_um
                made.append(step)
        return made


STAND_BY, CUTTING, JOGGING = "STAND-BY", "CUTTING", "JOGGING"
LOW_TENSION = 0.5  # share of the wire's tension while the spare line is high (ours: half)
BENT_SHARE = 0.01
"""A wire bent by more than this share of its free length breaks (ours: the model of a taut string is not valid
beyond; cuts bend it ten times less)."""
UNKNOWN_CAUSE = "NO SWITCH IS OPEN: CALLED BY A PROGRAM, OR BY A SPARK ON THE SWITCHES' LINE"


class Rig:
    """Computer and machine, as in 1982: a fixed period, steps of 2 um, and a planner that counts (not ``exact``).

    The computer's own timers generate all jogs, and with ``poscal-literal`` all motion.
    """

    def __init__(
        self, machine: Machine, seed: int = 0, *, resolution: str = "default", planner: str = "poscal",
        faults: Faults | None = None,
    ) -> None:
        check_1982(machine.base.table.step_um.value)
        self.plant = Plant(machine, seed, resolution=resolution)
        self._tensions = machine, machine.with_(tension=LOW_TENSION * machine.tension)
        self.board = Board(PulseSettings(pulse_A=discharge_current_A(machine)), faults=faults)
        self.board.open_V = open_V(machine)
        self.board.on_step = self._carry
        self.unit = unit_for(machine.base.table.travel_mm.value * 1e3)
        self.unit_um = unit_um(self.unit)
        if not kind_of(planner).counts:
            others = f"choose {', '.join(counting())}"
            raise InputError(f"the terminal's computer cannot count along with the planner {planner}: {others}")
        self._planner_name = planner
        self._literal = kind_of(planner).number == LITERAL
        self.computer = Computer(self.board, unit=self.unit, wrap=self._literal)
        self.mode, self.cause = STAND_BY, ""  # cause of the last emergency
        self.held: tuple[Planner, Route, Point] | None = None  # an unfinished cut, and where it stopped
        self.wire = True
        self.windows = 0  # read while cutting
        law = cast(CountsController, make("counts")).settings(MAX_FEED_UM_S)
        at.set_constants(self.board.bus, law._replace(limit=MAX_SPEED))
        self._events: list[str] = []
        self._planner: Planner | None = None
        self._carriage = [*self.place_um]
        self.ends = TableEnds(machine, self.board.switches)
        self._window: PulseWindow | None = None
        self._codes = (0, 0)
        self.computer.init()
        x, y = self.plant.commanded_um
        self.computer.set_position(round(x / self.unit_um), round(y / self.unit_um))

    def warm_up(self) -> None:
        """Compile the pulse loop without changing the state."""
        before = self.plant.snapshot()
        self.plant.advance()
        self.plant.restore(before)

    @property
    def time_ns(self) -> int:
        """Machine time."""
        return self.plant.time_ns

    @property
    def place_um(self) -> tuple[float, float]:
        """True position of the carriage, which the position counters may not show."""
        return self.plant.commanded_um

    @property
    def has_no_wire(self) -> bool:
        """Whether the sensor reports a broken wire; a stuck sensor does not."""
        return not self.wire and WIRE_BREAK not in self.board.switches.stuck

    @property
    def in_metal(self) -> bool:
        """Whether a wire's centre would be inside the workpiece; in a kerf it is not, even if the wire was bent."""
        field, place = self.plant.field, np.array([self.place_um])
        # the stock, because tiles of the field may not be made yet
        blank = field.stock.fraction(place[:, 0], place[:, 1], field.cell_um)[0, 0]
        return bool(min(blank, metal_at(field, place).max()) >= 0.5)

    @property
    def moving(self) -> bool:
        """Whether a cut or a jog is under way."""
        return self._planner is not None

    @property
    def stalled(self) -> bool:
        """Whether a cut has the greatest speed 0, which MAXVEL may contain although SPEED refuses it."""
        return self.moving and self.mode == CUTTING and not self.computer.speed

    @property
    def move(self) -> Move | None:
        """The present move of the cut; None without a cut."""
        return self._route.move_at(self._planner.path_um) if self._planner and self.mode == CUTTING else None

    @property
    def in_emergency(self) -> bool:
        """Whether the machine is stopped until INIT."""
        return self.computer.state == EMERGENCY

    @property
    def gap(self) -> tuple[float, float]:
        """Mean voltage and current; with the generator off, the remaining voltage (row T-27)."""
        if self._window is not None and self.plant.generator_on and self.board.generator_on:
            return self._window.mean_voltage_V, self._window.mean_current_A
        return self.board.generator_line.voltage_V(self.time_ns), 0.0

    @property
    def unit_name(self) -> str:
        """Unit of the position counters, as the terminal prints it."""
        return "um" if self.unit == "um" else "STEPS"

    def take_events(self) -> list[str]:
        """Return the machine's events since the last call."""
        events, self._events = self._events, []
        return events

    def say(self, text: str) -> None:
        """Add an event with the present position."""
        x, y = self.computer.position
        self._events.append(f"{text}   X {x} Y {y} {self.unit_name}")

    def refuse(self, reason: str) -> None:
        """Add an event: the reason of a failed request."""
        self._events.append(f"? {reason}")

    def set(self, setting: Setting) -> None:
        """Set codes and speed; a pair that draws more than 2 A or leaves no pause raises an error (row T-34)."""
        old = self.computer.pulse_codes
        t_i = old[0] if setting.t_i is None else setting.t_i
        t_p = old[1] if setting.t_p is None else setting.t_p
        self.board.settings.check(t_i, t_p)
        if t_i and t_p:
            self.plant.set_generator(*self.board.settings.times_us(t_i, t_p))
        self.computer.set_pulse_codes(t_i, t_p)
        self._codes = self.computer.pulse_codes
        if setting.speed is not None:  # the limit of the law; the present speed is kept until its next decision
            self.board.bus.store(at.MAXVEL, check_speed(setting.speed))

    def begin_cut(self, route: Route) -> None:
        """Start timers and generator along a route from the wire's position."""
        if self._literal:
            self.resume_cut(PathRun(self.computer, route.corners), route)
        else:
            corners_um = np.array(route.corners) * self.unit_um
            self.resume_cut(make_planner(self._planner_name, corners_um, unit=self.unit), route)

    def resume_cut(self, planner: Planner, route: Route) -> None:
        """Start timers and generator at the planner's present position on its route."""
        self.computer.start()
        self._planner, self._route, self.held, self.mode = planner, route, None, CUTTING
        start = min(at.constants(self.board.bus).start, self.computer.speed, MAX_SPEED)
        at.set_variables(self.board.bus, State(clock=self.time_ns // TICK_NS & WORD, speed=start))
        self._run_at(start)

    def begin_jog(self, target: Point) -> None:
        """Start the timers towards a position, with the generator off."""
        self.computer.start(generator=False)
        self._planner, self.mode = PathRun(self.computer, [self.computer.position, target]), JOGGING
        self._run_at(MAX_SPEED)

    def _run_at(self, units: int) -> None:
        self._units = units
        self._busy_until_ns = self.time_ns
        self.computer.bus.store(at.CUTVEL, units)

    def stand(self, text: str) -> None:
        """Stop timers and generator, and add an event."""
        self.computer.stop()
        self.put_down()
        self.say(text)

    def put_down(self) -> None:
        """End all motion, and store an unfinished cut so that it can be resumed."""
        if self.mode == CUTTING and self._planner is not None:
            self.held = self._planner, self._route, self.computer.position
        self._planner, self.mode = None, STAND_BY
        self.board.mean_current_A = 0.0

    def trip(self, switch: str, cause: str) -> None:
        """Open a switch: the hardware acts at once, the emergency routine by interrupt, or here if that is masked."""
        self.board.switches.trip(switch)
        self.computer.serve()
        if not self.in_emergency:
            self.computer.emergency()
        self._stopped(cause)

    def stop_all(self, cause: str) -> None:
        """Call the emergency routine; no switch opens."""
        self.computer.emergency()
        self._stopped(cause)

    def thread(self) -> None:
        """Thread a new wire by hand at the carriage's position."""
        by_hand_ns = round(self.plant.machine.base.table.threading_s.value * 1e9)
        self.plant.rethread(self.place_um, by_hand_ns)
        self.wire = True
        self.board.switches.release()

    def advance(self) -> None:
        """Run one window."""
        self._obey_lines()
        tensioned = self._tensions[self.board.low_tension]
        if self.plant.machine.tension != tensioned.tension:  # the rest of the state is unchanged
            self.plant = self.plant.with_machine(tensioned)
        start_ns = self.time_ns
        end_ns = start_ns + self.plant.window_ns
        steps = self.ends.passed(self.place_um, self._make_steps(start_ns, end_ns))
        self._fire(steps, moved(self.place_um, steps))
        self.computer.run_until(end_ns)
        if self._planner is not None and self._planner.done:
            if self.mode == CUTTING:  # within a step of the end: apply the settings after the last move
                self._take_over(math.inf)
            self._planner = None
            self.stand("READY")

    def _obey_lines(self) -> None:
        """Set the generator by the ports 4020H to 4022H; a length of 0 switches it off."""
        on = self.board.generator_on and all(self.board.codes)
        if on and self.computer.pulse_codes != self._codes:
            self._codes = self.computer.pulse_codes
            try:
                self.plant.set_generator(*self.board.times_us)
            except InputError as error:
                self.refuse(f"{error.reason}; the generator keeps its old setting")
        if self.plant.generator_on != on:
            self.plant.switch_generator(on)

    def _make_steps(self, start_ns: int, end_ns: int) -> list[Step]:
        """Return a window's motor steps, by hand, program, timers and planner, up to the opening of an end switch."""
        reported = self.in_emergency and not self.moving
        self._carriage = [*moved(self.place_um, self.board.steps)]
        try:
            self.computer.code.run_until(end_ns)
        except InputError as error:
            self.refuse(error.reason)
        if self._planner is not None and self.computer.state == COMPUTER_STAND_BY:
            self.stand("STOPPED BY A PROGRAM")
        if self.in_emergency and not reported:  # before the planner computes steps that no motor makes
            self._stopped()
            reported = True
        try:
            made = self._motion(start_ns, end_ns)
        except InputError as error:  # an altered counter has led off the table
            made = self.computer.take_steps(end_ns)
            self.computer.emergency()
            self.computer.cause = (error.reason,)
        self.computer.serve()
        if self.in_emergency and not reported:
            self._planner = None  # not stored for GO, because it is ahead of the counters, or off the table
            self._stopped()
        return sorted(step._replace(time_ns=max(step.time_ns, start_ns)) for step in made)

    def _motion(self, start_ns: int, end_ns: int) -> list[Step]:
        """Advance timers and planner by a window; a new speed is used when the optimising routine has finished."""
        if self._planner is None:
            return self.computer.run_until(end_ns)
        change_ns = min(max(self._busy_until_ns, start_ns), end_ns)
        planned = self._planner.advance(start_ns, change_ns, self._units)
        next_units = max(-MAX_SPEED, min(self.computer.bus.signed(at.CUTVEL), MAX_SPEED))
        planned += self._planner.advance(change_ns, end_ns, next_units)
        if change_ns < end_ns:
            self._units = next_units
        return planned if isinstance(self._planner, PathRun) else self.computer.drive(planned)

    def _carry(self, step: Step) -> None:
        """Move the carriage by a step; open the end switch if the carriage leaves its travel."""
        self._carriage[step.axis] += STEP_UM * step.direction
        if self.ends.switch_open(step.axis, step.direction, self._carriage[step.axis]):
            self.board.switches.trip(END_SWITCHES[step.axis])

    def _fire(self, steps: list[Step], place_um: tuple[float, float]) -> None:
        """Advance the plant by a window that ends at a position, and pass its pulses to the computer."""
        pressed = "THE WIRE WAS PRESSED AGAINST THE WORKPIECE AND BROKE"
        try:
            window = self.plant.advance(steps)
        except PlantError:
            self._lose_wire(pressed, place_um)
            return
        self._window = window
        self.board.mean_current_A = window.mean_current_A
        if window.spark or window.arc:
            self.board.spark()
        if window.broken:
            height = self.plant.broken_height_mm
            self._lose_wire(f"WIRE BREAK {height:.1f} mm ABOVE THE WORKPIECE'S LOWER FACE", place_um)
        elif math.hypot(*window.deflection_um) > BENT_SHARE * 1e3 * self.plant.machine.guide_distance_mm:
            self._lose_wire(pressed, place_um)
        elif self.in_emergency:
            return  # the counters are reset and the generator is off
        elif self.plant.generator_on and window.pulses == WINDOW_PULSES:
            self.board.counters.count_window(window.short, window.open)
            self._read_counts()
        elif self.mode == CUTTING:
            self.stand("NO PULSES COME: THE GENERATOR DROPPED OUT AT LOW V(t(p)); STOPPED")

    def _read_counts(self) -> None:
        """Read the latches if the previous counts have been processed; while cutting, decide on the speed."""
        computer, now_ns = self.computer, self.plant.time_ns
        if self.mode != CUTTING or self._planner is None:
            computer.read_counts()
            return
        if now_ns < max(self._busy_until_ns, computer.steppers.free_ns) or not computer.result_waits():
            return
        path_um = self._planner.path_um
        if not self._literal:
            computer.steppers.aim_for_planner(*self._route.corner_ahead(path_um))
        _, t_states = computer.optimise(now_ns // TICK_NS & WORD, int(path_um) & WORD)
        self.windows += 1
        self._busy_until_ns = now_ns + round(seconds(t_states) * 1e9)
        if at.variables(self.board.bus).phase == ALARM:
            self.trip(STOP_BUTTON, "PERSISTENT SHORT")
            return
        self._take_over(path_um)

    def _take_over(self, path_um: float) -> None:
        """Apply the program's settings up to a length of path."""
        dues = self._route.dues
        while dues and path_um >= dues[0][0]:
            try:
                self.set(dues.pop(0)[1])
            except InputError as error:
                self.refuse(f"{error.reason}; the old setting stays")

    def _lose_wire(self, cause: str, place_um: tuple[float, float]) -> None:
        """Remove the broken wire; the carriage keeps the window's steps. If the sensor reports it, all stops."""
        self.plant.rethread(place_um, 0)
        self.plant.continue_without_wire()
        self.wire = False
        if self.has_no_wire:
            self.trip(WIRE_BREAK, cause)

    def _stopped(self, cause: str = "") -> None:
        """Report an emergency; without a cause, those that the emergency routine has found."""
        self.put_down()
        found = (switch if ":" in switch else f"{switch} SWITCH" for switch in self.computer.cause)
        self.cause = cause or " AND ".join(found).upper() or UNKNOWN_CAUSE
        self.say(f"EMERGENCY: {self.cause}; NOTHING MOVES UNTIL INIT")
