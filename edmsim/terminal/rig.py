"""The rig: the 1982 controller wired to the simulated machine, window by window, as its operator has it before him.

The law decides the speed from the counts of every window; a planner makes motor steps of it; the plant takes them.
With the generator off, or without a wire, table and time go on all the same.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from edmsim.analyser import WINDOW_PULSES
from edmsim.controllers import WindowObservation, make
from edmsim.controllers.feed.base import FeedCommand
from edmsim.controllers.mcu.arithmetic import WORD
from edmsim.controllers.mcu.dac import PulseSettings
from edmsim.controllers.mcu.main_program import Status
from edmsim.controllers.mcu.part_program import Codes, Entry, Setting
from edmsim.controllers.mcu.planner import Planner, Step, make_planner
from edmsim.controllers.mcu.poscal import STEP_UM
from edmsim.controllers.mcu.timers import MAX_FEED_UM_S, MAX_SPEED, SPEED_UNIT_NM_S
from edmsim.errors import InputError, PlantError
from edmsim.machine import Machine
from edmsim.plant.generator import discharge_current_A
from edmsim.plant.plant import Plant, PulseWindow

from .route import Due, Point, lay_out

STAND_BY, CUTTING, JOGGING, EMERGENCY = "STAND-BY", "CUTTING", "JOGGING", "EMERGENCY"
BARE_WINDOW_NS = 25_500_000
"""Time that passes at once while no wire is there: a window of the usual period."""


class Rig:
    """Controller and machine.

    Parameters
    ----------
    machine : Machine
        Its generator must have a fixed period, as the generator of 1982 has.
    seed : int
    resolution : str
    planner : str
        Name of the planner.
    """

    def __init__(
        self, machine: Machine, seed: int = 0, *, resolution: str = "default", planner: str = "poscal"
    ) -> None:
        self.plant = Plant(machine, seed, resolution=resolution)
        self.pulses = PulseSettings(pulse_A=discharge_current_A(machine))
        self._planner_name = planner
        self._controller = make("counts")
        self._events: list[str] = []
        x, y = self.plant.commanded_um
        self._position: Point = (round(x), round(y))
        self._bare_um, self._bare_ns = (x, y), 0
        self._wire = True
        self._speed = MAX_SPEED
        self._windows = self._missed = 0
        self._state = STAND_BY
        self._planner: Planner | None = None
        self._dues: list[Due] = []
        self._held: tuple[Planner, list[Due]] | None = None
        self.init()

    @property
    def greeting(self) -> str:
        """What the terminal prints first."""
        machine = self.plant.machine
        return (
            f"{machine.name.upper()}   WIRE SPARK EROSION   8085 CONTROLLER\n"
            f"{machine.material_name.upper()} {machine.height_mm:g} mm HIGH, ITS EDGE 30 um AHEAD OF THE WIRE IN +X\n"
            "HELP LEADS THROUGH A JOB; BYE LEAVES"
        )

    @property
    def time_ns(self) -> int:
        """Machine time."""
        return self.plant.time_ns if self._wire else self._bare_ns

    @property
    def place_um(self) -> tuple[float, float]:
        """Where the carriage is on the table, whatever the counters say."""
        return self.plant.commanded_um if self._wire else self._bare_um

    @property
    def moving(self) -> bool:
        """Whether a cut or a jog is under way."""
        return self._state in (CUTTING, JOGGING)

    @property
    def in_emergency(self) -> bool:
        """Whether nothing moves until INIT."""
        return self._state == EMERGENCY

    def digits(self) -> tuple[str, str]:
        """Both banks of sixteen digits."""
        x, y = self._position
        return f"{x:05d} {y:05d}    ", " " * 16

    def take_events(self) -> list[str]:
        """What the machine has to say since the last call."""
        events, self._events = self._events, []
        return events

    def heard(self, data: bytes) -> bytes:
        """Return what of the operator's bytes the serial line brings."""
        return data

    def spoken(self, data: bytes) -> bytes:
        """Return what of the controller's bytes the serial line brings."""
        return data

    # what MAIN can do to the machine

    @property
    def codes(self) -> Codes:
        """How us become codes."""
        return Codes(self.pulses.code_of_t_i, self.pulses.code_of_t_p)

    def status(self) -> Status:
        """What the machine shows."""
        window, (t_i_us, t_p_us) = self._window, self.pulses.times_us(self._t_i, self._t_p)
        return Status(
            state=f"{EMERGENCY}: {self._cause}" if self.in_emergency else self._state,
            position_um=self._position,
            speed=self._speed,
            running=self._units,
            short=window.short if window else 0,
            open=window.open if window else 0,
            windows=self._windows,
            missed=self._missed,
            t_i=self._t_i,
            t_p=self._t_p,
            t_i_us=t_i_us,
            t_p_us=t_p_us,
            generator_on=self.plant.generator_on,
            voltage_V=window.mean_voltage_V if window else 0.0,
            current_A=window.mean_current_A if window else 0.0,
            time_s=self.time_ns * 1e-9,
        )

    def set_position(self, position_um: Point) -> None:
        """Set the position counters; they count on from there."""
        self._check_still()
        self._position = position_um

    def set(self, setting: Setting) -> None:
        """Take over codes and speed; a pair above 2 A is refused and the old one stays (row T-34)."""
        self._check_alive()
        t_i = self._t_i if setting.t_i is None else setting.t_i
        t_p = self._t_p if setting.t_p is None else setting.t_p
        if t_i and t_p:
            self.pulses.check(t_i, t_p)
            self.plant.set_generator(*self.pulses.times_us(t_i, t_p))
        self._t_i, self._t_p = t_i, t_p
        self._speed = self._speed if setting.speed is None else setting.speed

    def cut(self, program: Sequence[Entry]) -> None:
        """Start timers and generator along a path."""
        self._check_still()
        points, dues = lay_out(self._position, program)
        while dues and not dues[0].path_um:
            self.set(dues.pop(0).setting)
        self._check_generator()
        self._held = None
        self._run(make_planner(self._planner_name, np.array(points)), dues)

    def go_on(self) -> None:
        """Go on with the cut that was stopped, from where it was stopped."""
        self._check_still()
        if self._held is None:
            raise InputError("no cut was stopped; START or RUN begins one")
        planner, dues = self._held
        if planner.position_um != self._position:
            x, y = planner.position_um
            raise InputError(f"the cut stopped at X {x} Y {y}; bring the wire back there first")
        self._check_generator()
        self._run(planner, dues)

    def _run(self, planner: Planner, dues: list[Due]) -> None:
        self._planner, self._dues, self._state = planner, dues, CUTTING
        self._command = self._controller.reset(MAX_FEED_UM_S)
        self.plant.switch_generator(True)

    def jog(self, axis: int, way_um: int) -> None:
        """Move one axis with the generator off, at the highest speed the timers run."""
        self._check_still()
        if abs(way_um) < STEP_UM:
            raise InputError(f"a motor step is {STEP_UM} um; jog by at least that")
        target = [*self._position]
        target[axis] += way_um
        if not 0 <= target[axis] <= WORD:
            raise InputError(f"soft limit: the counters hold 0 to {WORD} um, not {target[axis]}")
        self.plant.switch_generator(False)
        self._planner, self._state = make_planner("poscal", np.array([self._position, target])), JOGGING
        self._command = FeedCommand(MAX_FEED_UM_S)

    def stop(self) -> None:
        """Stop timers and generator."""
        self._check_alive()
        if not self.moving and not self.plant.generator_on:
            raise InputError("the machine stands still already")
        self._stand_by()
        self._say_place("STOPPED")

    def generator(self, on: bool) -> None:
        """Run or stop the generator."""
        self._check_alive()
        if on:
            self._check_generator()
        self.plant.switch_generator(on)

    def emergency(self, cause: str = "STOP BY THE OPERATOR") -> None:
        """Stop everything: steppers still, generator off, codes 0; the position stays (row T-49)."""
        self.init()
        self._state, self._cause = EMERGENCY, cause
        self._say_place(f"{EMERGENCY}: {cause}; NOTHING MOVES UNTIL INIT")

    def init(self) -> None:
        """INIT: a safe stand-by; the position stays (rows T-50, T-51)."""
        self._stand_by()
        self._t_i = self._t_p = 0

    def thread_wire(self) -> None:
        """Thread a new wire where the carriage stands."""
        self._check_still()
        if self._wire:
            raise InputError("the wire is whole")
        by_hand_ns = round(self.plant.machine.base.table.threading_s.value * 1e9)
        self.plant.rethread(self.place_um, self.time_ns - self.plant.time_ns + by_hand_ns)
        self._wire = True
        self._say_place("NEW WIRE")

    def _check_alive(self) -> None:
        if self.in_emergency:
            raise InputError(f"emergency ({self._cause}): only INIT helps")

    def _check_still(self) -> None:
        self._check_alive()
        if self.moving:
            raise InputError("the machine moves already; STOP stops it, WAIT waits for its end")

    def _check_generator(self) -> None:
        if not (self._t_i and self._t_p):
            raise InputError("t(i) and t(p) are not set; TI us TP us sets them")
        if not self._wire:
            raise InputError("the wire is broken; WIRE threads a new one")

    # the machine at work

    def advance(self) -> None:
        """Let one window pass."""
        start_ns = self.time_ns
        end_ns = start_ns + (self.plant.window_ns if self._wire else BARE_WINDOW_NS)
        steps = self._take_steps(start_ns, end_ns)
        if self._wire:
            self._fire(steps)
        else:
            x, y = (self.place_um[k] + STEP_UM * sum(s.direction for s in steps if s.axis == k) for k in (0, 1))
            self._bare_um, self._bare_ns = (x, y), end_ns
        if self._planner is not None and self._planner.done:
            self._stand_by()
            self._say_place("READY")

    def _fire(self, steps: list[Step]) -> None:
        """Let the plant pass a window, and the controller see it."""
        try:
            window = self.plant.advance(steps)
        except PlantError:
            self._lose_wire("THE WIRE WAS PRESSED AGAINST THE WORKPIECE AND BROKE")
            return
        self._window = window
        if window.broken:
            self._lose_wire(f"WIRE BREAK, {self.plant.broken_height_mm:.1f} mm ABOVE THE WORKPIECE'S LOWER FACE")
        elif self._state == CUTTING and window.pulses == WINDOW_PULSES:
            self._control(window)

    def _control(self, window: PulseWindow) -> None:
        """Counts to speed, and settings that are due."""
        assert self._planner is not None
        self._windows += 1
        self._command = self._controller.update(
            WindowObservation(
                self.plant.time_ns * 1e-9, window.duration_ns * 1e-9, window.short, window.open,
                window.mean_voltage_V, window.mean_current_A, window.mean_delay_us,
                self._units * SPEED_UNIT_NM_S * 1e-3, self._planner.path_um,
            )
        )  # fmt: skip
        if self._command.alarm is not None:
            self.emergency(self._command.alarm.upper())
            return
        while self._dues and self._planner.path_um >= self._dues[0].path_um:
            try:
                self.set(self._dues.pop(0).setting)
            except InputError as error:
                self._events.append(f"? {error.reason}; THE OLD SETTING STAYS")

    def _take_steps(self, start_ns: int, end_ns: int) -> list[Step]:
        """Motor steps of a window, as far as no end switch opens."""
        if self._planner is None:
            return []
        units = round(self._command.feed_um_s * 1e3 / SPEED_UNIT_NM_S)
        units = max(-self._speed, min(units, self._speed if self._state == CUTTING else MAX_SPEED))
        change_ns = min(start_ns + round(self._command.latency_s * 1e9), end_ns)
        planned = self._planner.advance(start_ns, change_ns, self._units)
        planned += self._planner.advance(change_ns, end_ns, units)
        self._units = units
        place, taken = [*self.place_um], []
        travel_um = self.plant.machine.base.table.travel_mm.value * 1e3
        for step in planned:
            place[step.axis] += STEP_UM * step.direction
            taken.append(step)
            beyond = place[step.axis] - travel_um if step.direction > 0 else -place[step.axis]
            if beyond > STEP_UM:
                self._count(taken)
                side = f"{'XY'[step.axis]}{'+' if step.direction > 0 else '-'}"
                self.emergency(f"END SWITCH {side}")
                return taken
        self._count(taken)
        return taken

    def _count(self, steps: list[Step]) -> None:
        """POSITI for every step taken."""
        x, y = (self._position[k] + STEP_UM * sum(s.direction for s in steps if s.axis == k) for k in (0, 1))
        self._position = (x, y)

    def _lose_wire(self, cause: str) -> None:
        self._bare_um, self._bare_ns, self._wire = self.plant.commanded_um, self.plant.time_ns, False
        self.emergency(cause)

    def _stand_by(self) -> None:
        """Stop timers and generator."""
        if self._state == CUTTING and self._planner is not None and not self._planner.done:
            self._held = self._planner, self._dues
        self._state, self._cause = STAND_BY, ""
        self._planner, self._dues = None, []
        self._units = 0
        self._window: PulseWindow | None = None
        self.plant.switch_generator(False)

    def _say_place(self, text: str) -> None:
        x, y = self._position
        self._events.append(f"{text}   X {x} Y {y} um")
