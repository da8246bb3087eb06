"""The 1982 controller as a feed controller: its law behind registers, its steps through interrupts.

The counts reach the program as on the machine: 255 clocks of SYNC, strobes, the latches at 4030H and 4031H, polled
through the handshake at 4032H. With the planner `poscal-literal` the controller is the machine itself: it aims every
move once, and its timers decide when a step comes (`edmsim.controllers.mcu.path_run`). Any other planner decides that
itself, and its steps leave as on the machine: a timer runs out, the 8259 interrupts, the routine raises a line of
4022H. What the controller decides is then what `CountsController` decides, bit for bit.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.feed.counts import CountsController
from edmsim.controllers.mcu.board import Board
from edmsim.controllers.mcu.chips.dac import LIMIT_A, PulseSettings
from edmsim.controllers.mcu.computer import EMERGENCY, Computer
from edmsim.controllers.mcu.firmware import memory_map
from edmsim.controllers.mcu.firmware.arithmetic import WORD
from edmsim.controllers.mcu.firmware.generator_control import before_corner
from edmsim.controllers.mcu.firmware.poscal import Unit, check_1982, unit_for, unit_um
from edmsim.controllers.mcu.path_run import PathRun
from edmsim.controllers.planner.kinds import LITERAL
from edmsim.controllers.planner.registry import Planner, kind_of
from edmsim.controllers.protocols import FeedCommand, Step, WindowObservation
from edmsim.geometry import CORNER_DEG, Polyline
from edmsim.machine.machine import Machine
from edmsim.machine.setting import discharge_current_A


class _Setup(NamedTuple):
    """What MAIN gets before a cut."""

    pulses: PulseSettings = PulseSettings()  # what the codes mean
    codes: tuple[int, int] = (102, 170)  # nearest to it
    t_on_us: float = 20.0  # as it was set
    unit: Unit = "um"
    points: tuple[tuple[int, int], ...] = ()  # corners of the path in `unit`, each other than the one before
    starts_um: tuple[float, ...] = ()  # length of path up to each point
    corners_um: tuple[float, ...] = ()  # up to every corner, over all legs

    @classmethod
    def of(cls, machine: Machine, points_um: NDArray[Any], start_um: float) -> _Setup:
        """Read the dials and the drawing."""
        pulses = PulseSettings(pulse_A=discharge_current_A(machine))
        t_i, t_p = pulses.code_of_t_i(machine.t_on_us), pulses.code_of_t_p(machine.t_period_us)
        while t_i and pulses.mean_current_A(t_i, t_p) > LIMIT_A:
            t_i -= 1  # a setting at the limit, rounded over it
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
    corner_share: float = 0.6  # factor on t(i) there

    _computer: Computer = field(default_factory=Computer, init=False, repr=False)
    _move: int = field(default=-1, init=False, repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._setup = _Setup()
        self._run: PathRun | None = None

    @property
    def computer(self) -> Computer:
        """The computer with its registers; every leg begins with a new one."""
        return self._computer

    @property
    def missed_windows(self) -> int:
        """Windows not read in time since the leg began (row T-44)."""
        return self._computer.board.counters.missed

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        """Take in the generator's setting and the path; called before every leg of the cut."""
        self._setup = _Setup.of(machine, points_um, start_um)

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a new cut: INIT, position and settings as MAIN gets them, start."""
        command = super().reset(max_feed_um_s)
        self._start(wrap=False)
        return command

    def path_run(self, planner: str) -> Planner | None:
        """Return the computer's own motion where it is to make the steps as in 1982: for `poscal-literal`."""
        if kind_of(planner).number != LITERAL:
            return None
        self._start(wrap=True)
        self._run = PathRun(self._computer, self._setup.points)
        return self._run

    def _start(self, wrap: bool) -> None:
        """INIT, position and settings, start."""
        setup = self._setup
        self._computer = Computer(Board(setup.pulses), unit=setup.unit, wrap=wrap)
        self._computer.init()
        if setup.points:
            self._computer.set_position(*setup.points[0])
        self._computer.set_pulse_codes(*setup.codes)
        memory = self._computer.board.bus
        assert self._settings is not None
        memory_map.set_constants(memory, self._settings)
        memory_map.set_variables(memory, self._state)
        self._computer.start()
        self._move, self._run = -1, None

    @property
    def emergency(self) -> str | None:
        """What the emergency routine did, and where; None while it has not run since the leg began."""
        computer = self._computer
        if computer.state != EMERGENCY:
            return None
        size_um = unit_um(self._setup.unit)
        x_mm, y_mm = (place * size_um / 1e3 for place in computer.position)
        switches = " and ".join(computer.cause)
        why = f" ({switches})" if switches else ""
        return f"the controller's emergency routine{why} stopped the machine at x {x_mm:.3f} y {y_mm:.3f} mm"

    def open_switch(self, name: str) -> None:
        """Let a switch of the machine open: its line interrupts, and the emergency routine runs."""
        self._computer.board.switches.trip(name)
        self._computer.serve()

    def update(self, window: WindowObservation) -> FeedCommand:
        """Feed for the next window; the routines of the steps put off what the program computes."""
        self._computer.serve()
        if self._run is not None:
            computer, cpu = self._computer, self._cpu
            late_ns = max(computer.steppers.free_ns - computer.board.now_ns, 0)
            cpu.busy_until_ns = cpu.clock_ns + round(window.duration_s * 1e9) + late_ns
        return super().update(window)

    def drive(self, steps: list[Step]) -> list[Step]:
        """Make a planner's steps through timers, interrupts and port."""
        return self._computer.drive(steps)

    def _count(self, short: int, open: int) -> None:
        self._computer.board.counters.count_window(short, open)

    def _decide(self, tick: int, path_um: float) -> tuple[int, int]:
        setup = self._setup
        if setup.points and self._run is None:
            here = self._move
            if here < 0 or not setup.starts_um[here] <= path_um <= setup.starts_um[here + 1]:
                self._aim(path_um)
        speed, t_states = self._computer.optimise(tick, math.floor(path_um) & WORD)
        self._state = memory_map.variables(self._computer.board.bus)
        return speed, t_states

    def _aim(self, path_um: float) -> None:
        """Tell the program where the present move of the path ends."""
        setup = self._setup
        self._move = min(max(bisect_right(setup.starts_um, path_um) - 1, 0), len(setup.points) - 2)
        self._computer.steppers.look_to(*setup.points[self._move + 1])

    def _command(self, path_um: float) -> FeedCommand:
        command = super()._command(path_um)
        setup = self._setup
        if command.alarm is not None:
            self._computer.emergency()
        if self._computer.state == EMERGENCY or not (self.corner_um and setup.points):
            return command
        ahead = bisect_right(setup.corners_um, path_um)
        left = setup.corners_um[ahead] - path_um if ahead < len(setup.corners_um) else math.inf
        t_i, t_p = setup.codes
        code = before_corner(t_i, int(min(left, WORD)), round(self.corner_um), round(self.corner_share * 256))
        if code != self._computer.pulse_codes[0]:
            self._computer.set_pulse_codes(code, t_p)
        return command._replace(t_on_us=setup.t_on_us if code == t_i else setup.pulses.times_us(code, t_p)[0])
