"""A cut of a program: its legs in order, threading between contours, dwells, and its end.

The controller observes only what a real machine measures; the plant receives only motor steps and the generator's
setting (see `edmsim.closed_loop.cycle`).
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from edmsim.closed_loop.cycle import Cycle, PlannerMotion, Recorder
from edmsim.closed_loop.passes import Leg, PassLog, PassSetup, ProgramPlace, Sums, legs_of, path_behind
from edmsim.closed_loop.stops import WORDS, StopCause, stop_cause, switches_open
from edmsim.controllers import FeedCommand, FeedController, WindowObservation, axis, protocols
from edmsim.controllers.axis.elcam.module import Elcam
from edmsim.controllers.axis.elcam.step_compensation import StepCompensation, check_cams
from edmsim.controllers.mcu.board import STOP_BUTTON, WIRE_BREAK, X_END, Y_END
from edmsim.controllers.mcu.firmware.timers import MAX_FEED_UM_S
from edmsim.controllers.planner import four_axes, registry
from edmsim.errors import InputError
from edmsim.machine.machine import Machine
from edmsim.machine.pulse_window import PulseWindow
from edmsim.machine.setting import held_period_us
from edmsim.plant.axes.drives import AxisDrive, AxisFault
from edmsim.plant.axes.steps import rapid_constants, time_left_s
from edmsim.plant.constants import strong_discharge
from edmsim.plant.plant import Plant
from edmsim.plant.window import PlantError
from edmsim.plant.workpiece import height_steps, kerf_field
from edmsim.program.path import CutPath
from edmsim.snapshots import Snapshots, like, state_of, take_state, with_prefix

# The axes of a cut with servo drives: step length, faults at their times, waits at the ends of legs.

_STEP_SHARE = 1e-6  # relative tolerance between a drive's step and the machine's, for rounding


class CutAxes(Snapshots):
    """The servo axes of a cut and their faults; refuses drives whose steps differ from the machine's."""

    STATE = ("_since_ns", "_before_um", "_placed_ns")

    def __init__(self, plant: Plant, faults: Sequence[AxisFault]) -> None:
        self._plant, self._faults = plant, sorted(faults, key=lambda fault: fault.at_s)
        self._since_ns: int | None = None
        self._placed_ns: int | None = None
        self._before_um: list[float] = []
        own = plant.own_step_um
        for fault in self._faults:
            if fault.axis not in own:
                raise InputError(
                    f"{fault.axis} has no servo drive, which the fault {fault.fault} needs: choose one of the "
                    f"drives {', '.join(axis.COMMISSIONED)}"
                )
        step_um = plant.machine.base.table.step_um.value
        for name, own_um in own.items():
            if not abs(own_um / step_um - 1) <= _STEP_SHARE:
                raise InputError(
                    f"the drive of {name} ({plant.drives[name].name}) moves {own_um:g} um at a step; this machine's "
                    f"steps are {step_um:g}"
                )
        self.fail_due()

    def fail_due(self) -> None:
        """Apply the faults that are due."""
        for fault in self._faults:
            if self._plant.time_ns >= fault.at_s * 1e9:
                self._plant.break_axis(fault.axis, fault.fault)

    def settled(self) -> bool:
        """Return whether all axes are settled at a leg's end, not only passing through it."""
        plant = self._plant
        if not plant.in_place:
            self._placed_ns = None
            return False
        if self._placed_ns is None:
            self._placed_ns = plant.time_ns
        if plant.is_moving_fast and plant.time_ns - self._placed_ns < 1e9 * rapid_constants()["rest_s"]:
            return False
        self._since_ns = self._placed_ns = None
        return True

    def late(self) -> str | None:
        """Return why axes will not settle any more; None if they still may."""
        plant = self._plant
        if self._since_ns is not None:
            waited_s = (plant.time_ns - self._since_ns) * 1e-9
            if waited_s < rapid_constants()["settled_s"]:
                return None
            step_um = plant.machine.base.table.step_um.value
            late_s = time_left_s(np.array(self._before_um), plant.away_um, waited_s, step_um)
            if late_s > rapid_constants()["longest_s"]:
                return plant.reason_of_delay(late_s)
        self._since_ns, self._before_um = plant.time_ns, plant.away_um.tolist()
        return None

    def restore(self, state: Mapping[str, Any]) -> None:
        """Load a snapshot after that of the plant; a supply that was off stays off."""
        super().restore(state)
        self.fail_due()


class Progress(NamedTuple):
    """Progress of a cut for display; `wall_time_s` is the computer's time so far."""

    path_um: float
    total_um: float
    time_s: float
    feed_um_s: float
    short: int
    open: int
    wall_time_s: float = 0.0


class Simulation:
    """One cut in progress."""

    STATE = (
        "_at", "_motion", "controller", "_compensation", "_offset", "sums", "refused", "overtaken", "slowed", "cause",
        "reason", "passes", "_axes",
    )  # fmt: skip

    def __init__(
        self,
        machine: Machine,
        path: CutPath,
        controller: FeedController,  # new; it is reset at the beginning of every leg
        *,
        planner: str = "poscal",  # replaced by a controller that makes its own steps (`RunsPath`)
        seed: int = 0,
        resolution: str = "default",
        max_time_s: float | None = None,  # machine time after which the cut is stopped
        lower_regions: tuple[height_steps.LowerRegion, ...] = (),  # where it is lower than the set-up's height
        mechanics: str = "modal",
        recorders: Sequence[Recorder] = (),
        drives: Mapping[str, AxisDrive] | None = None,
        compensation: Elcam | None = None,  # compensation tables of the machine's table, and cams
        stuck_wire_sensor: bool = False,  # then the machine continues without a wire (`Plant.continue_without_wire`)
        axis_faults: Sequence[AxisFault] = (),
        setups: Sequence[PassSetup] = (),  # from rough to last; the last one applies to all later passes
        approach: PassSetup | None = None,  # of the lead-ins of a path in passes; by default that of the first pass
        metal: kerf_field.KerfField | None = None,  # workpiece after an earlier cut, which is copied
        waits: bool = False,  # before every pass except the first, until `begin_pass` is called
    ) -> None:
        self.machine = machine
        self.path = path
        self._setups = tuple(setups) or (PassSetup(machine, controller),)
        self._approach = approach
        self._waits, self.waiting = waits, False
        self._setup = PassSetup(machine, controller)
        self.recorders = tuple(recorders)
        self._planner_name = planner
        table = machine.base.table
        self.unit = registry.position_unit(planner, table.travel_mm.value * 1e3, table.step_um.value)
        self.max_feed_um_s = MAX_FEED_UM_S if table.max_feed_um_s is None else table.max_feed_um_s.value
        self._max_time_ns = math.inf if max_time_s is None else round(max_time_s * 1e9)
        self.legs = legs_of(path)
        if isinstance(controller, protocols.LimitsLegs):
            controller.check_legs(len(self.legs))
        self.total_um = sum(float(leg.along_um[-1] - leg.along_um[0]) for leg in self.legs)
        self.passes = PassLog(path, self.legs)
        x0, y0, x1, y1 = (1e3 * v for v in path.stock_mm)
        radius = path.start_hole_radius_mm * 1e3
        holes = tuple((float(x), float(y), radius) for x, y in path.start_holes_um)
        x, y = (int(v) for v in path.contours[0].points_um[0])
        self.elcam = compensation
        step_um = table.step_um.value
        self._compensation = None if compensation is None else StepCompensation(compensation, step_um)
        if compensation is not None:
            check_cams(compensation, [contour.points_um for contour in path.contours], machine.guide_distance_mm)
        self._check_lean()
        self._offset = registry.PathOffset(step_um)
        self.plant = Plant(
            machine, seed, stock=kerf_field.Stock((x0, y0, x1, y1), holes, lower_regions, machine.height_mm),
            position_um=self._motors_um(float(x), float(y), 0.0, self._lead_of(0)), resolution=resolution,
            mechanics=mechanics, drives=drives,
        )
        if metal is not None:
            self.plant.take_metal(metal)
        self._axes = CutAxes(self.plant, axis_faults)
        self._sees_breaks = not stuck_wire_sensor
        self.sums = Sums()
        self.cause = StopCause.RUNNING
        self.reason: str | None = None
        self.refused: str | None = None
        self.overtaken = 0  # feeds that the controller's next command replaced within their latency
        self.slowed = 0  # windows in which the planner ran a tilted wire slower than its feed
        for recorder in self.recorders:
            recorder.begin(self.plant)
        self._at = ProgramPlace(from_um=(x, y), lead_um=self._lead_of(0))
        self._motion = self._begin_leg()
        self._check_later_passes()
        self.passes.begin_leg(0, self.legs[0], 0.0, 0.0)
        self._cycle = Cycle(self.plant, self._motion, self._decide, self.recorders)

    @property
    def controller(self) -> FeedController:
        """The present feed controller."""
        return self._setup.controller

    @property
    def beyond_training(self) -> list[str]:
        """Differences from the training of the controllers of the passes begun, each text once."""
        texts: dict[str, None] = {}
        for machine, controller in map(self._setup_of, self.legs[: self._at.leg + 1]):
            if isinstance(controller, protocols.WasTrained):
                texts |= dict.fromkeys(controller.beyond_training(machine))
        return list(texts)

    def machine_of(self, number: int) -> Machine:
        """Return the set-up of a pass, by its number from 1."""
        return self._setups[min(number, len(self._setups)) - 1].machine

    def _check_later_passes(self) -> None:
        """Check that the machine can run the feeds of later passes' controllers, before anything is cut."""
        for machine, controller in self._setups:
            if controller is not self._setup.controller:
                protocols.set_up_controller(controller, machine, self.legs[-1].points_um, 0.0)
                protocols.check_command(controller.name, controller.reset(self.max_feed_um_s))

    @property
    def described_setups(self) -> list[tuple[str, str]]:
        """Machine and controller of every pass and of the lead-in as text, to compare with a checkpoint's."""
        setups = self._setups if self._approach is None else (*self._setups, self._approach)
        return [(one.machine.model_dump_json(), repr(one.controller)) for one in setups]

    def _setup_of(self, leg: Leg) -> PassSetup:
        """Return the set-up of a leg: of its pass, or of the lead-in."""
        if leg.leads_in and self._approach is not None:
            return self._approach
        number = 1 if leg.cut_pass is None else leg.cut_pass.number
        return self._setups[min(number, len(self._setups)) - 1]

    def _begin_leg(self) -> PlannerMotion:
        """Plan a leg from the wire's position, which may be half a step before the end of the last leg."""
        at, leg = self._at, self.legs[self._at.leg]
        setup = self._setup_of(leg)
        if setup.machine is not self._setup.machine:
            self.plant.change_setup(setup.machine)
        self._setup = setup
        points, along, leads = leg.started_at(at.from_um, at.lead_um)
        for recorder in self.recorders:
            recorder.leg(points, at.start_um)
        self._offset.begin_leg(points, None if leads is None else along)
        step_um = self.machine.base.table.step_um.value
        behind, along_behind, leads_behind = path_behind(self.legs, at.leg)
        every = np.concatenate([behind, points])
        planner = (
            registry.make_planner(self._planner_name, every, unit=self.unit, step_um=step_um, start=len(behind))
            if leads is None
            else four_axes.make_leaning_planner(
                self._planner_name, every, np.concatenate([leads_behind, leads]),
                np.concatenate([along_behind, along]), self.unit, step_um,
            )
        )
        limit_um_s = self.max_feed_um_s = min(self.max_feed_um_s, planner.max_feed_um_s)
        command = self._reset_controller(setup.machine, points)
        own = self.controller.path_run(self._planner_name) if isinstance(self.controller, registry.RunsPath) else None
        drives = self.controller if isinstance(self.controller, protocols.DrivesSteps) and own is None else None
        # once per leg: a runtime check of a protocol takes a twentieth of a window
        self._switched = self.controller if isinstance(self.controller, protocols.HasSwitches) else None
        rest_until_ns = self.plant.time_ns + round(leg.rest_s * 1e9)
        return PlannerMotion(
            own or planner, drives, at.start_um, rest_until_ns, command, limit_um_s, self._offset, self._compensation
        )

    def _reset_controller(self, machine: Machine, points_um: np.typing.NDArray[Any]) -> FeedCommand:
        """Reset the controller for a leg's points, with the generator at its set-up; return its first command."""
        side = self.legs[self._at.leg].part_side
        protocols.set_up_controller(self.controller, machine, points_um, self._at.start_um, side)
        first = protocols.begin_leg(self.controller, self.max_feed_um_s)
        command = protocols.check_command(self.controller.name, first)
        self._set_generator(machine.t_on_us, machine.t_period_us)
        self._set_generator(command.t_on_us, command.t_period_us)
        return command

    def _check_lean(self) -> None:
        """Refuse a machine or planner that cannot move the upper guide as the legs require."""
        for leg in self.legs:
            if leg.lead_um is not None:
                four_axes.check_lead(self._planner_name, leg.points_um, leg.lead_um)
        if self.path.leans and self.elcam is not None and any(table.leads for table in self.elcam.tables.values()):
            raise InputError("the program's taper moves the upper guide, and so does a cam: leave one of them out")

    def _lead_of(self, leg: int) -> tuple[float, float]:
        """Return u and v at the first point of a leg."""
        lead_um = self.legs[leg].lead_um
        return (0.0, 0.0) if lead_um is None else (float(lead_um[0, 0]), float(lead_um[0, 1]))

    def _motors_um(self, x_um: float, y_um: float, path_um: float, lead_um: tuple[float, float]) -> tuple[float, ...]:
        """Return the position of the motors, with those of u and v, at a place that is reached without steps."""
        self._offset.clear()
        if self._compensation is None:
            return (x_um, y_um, *lead_um) if self.path.leans else (x_um, y_um)
        at = self._compensation.begin((x_um, y_um), path_um, lead_um)
        (u, v), (more_u, more_v) = lead_um, self._compensation.upper_um
        return *at, u + more_u, v + more_v

    @property
    def commanded_um(self) -> tuple[float, float]:
        """Position in the program: that of the motors, without compensation and offset."""
        x, y = self.plant.commanded_um
        off_x, off_y = (0.0, 0.0) if self._compensation is None else self._compensation.offset_um
        lateral_x, lateral_y = self._offset.lateral_um
        return x - off_x - lateral_x, y - off_y - lateral_y

    @property
    def _lead_um(self) -> tuple[float, float]:
        """Positions of u and v in the program: those of the motors, without compensation."""
        u, v = self.plant.lead_um
        off_u, off_v = (0.0, 0.0) if self._compensation is None else self._compensation.upper_um
        return u - off_u, v - off_v

    @property
    def outcome(self) -> str | None:
        """Outcome of the cut, as in the report."""
        return None if self.cause is StopCause.RUNNING else WORDS[self.cause].report

    @property
    def path_um(self) -> float:
        """Path length the wire has travelled, over all legs."""
        return self._motion.path_um

    @property
    def position_um(self) -> tuple[float, float]:
        """Position by the position counters."""
        return self._motion.planner.position_um

    @property
    def leg(self) -> int:
        """Number of the present leg, from 0."""
        return self._at.leg

    @property
    def leg_from_um(self) -> float:
        """Path length at the beginning of the present leg."""
        return self._at.start_um

    @property
    def missed_windows(self) -> int:
        """Number of windows in all legs that were not read in time."""
        of_leg = self.controller.missed_windows if isinstance(self.controller, protocols.MissesWindows) else 0
        return self._at.missed_before + of_leg

    def step(self) -> Progress:
        """Run one window; afterwards `outcome` is set if the cut is over, `waiting` if a pass is."""
        self._axes.fail_due()
        try:
            result = self._cycle.run_window()
        except PlantError:
            if not self.plant.drive_faults:
                raise
            self.cause = StopCause.DRIVE_TRIP  # an axis that ran away has moved the wire
            self._say(self.plant.fault_reason)
            return Progress(self.path_um, self.total_um, self.plant.time_ns * 1e-9, 0.0, 0, 0)
        self.sums.add(result)
        planner = self._motion.planner
        self.slowed += isinstance(planner, four_axes.Following) and planner.slowed
        self.passes.add(result)
        opened = self._switches(result.window)
        cause = self._stop_cause(result.window, opened)
        if self._stopped_by_controller(opened) and cause in (StopCause.RUNNING, StopCause.FINISHED):
            cause = StopCause.EMERGENCY_STOP
        if cause is StopCause.FINISHED:
            cause = self._end_of_leg()
        self.cause = cause
        time_s, short, open_ = self.plant.time_ns * 1e-9, result.window.short, result.window.open
        return Progress(result.path_um, self.total_um, time_s, result.feed_um_s, short, open_)

    def emergency_stop(self) -> None:
        """Press the machine's emergency button: the cut ends here."""
        self.cause = StopCause.EMERGENCY_STOP
        self._say("the emergency stop was pressed")
        self._stopped_by_controller([STOP_BUTTON])

    def _switches(self, window: PulseWindow) -> list[str]:
        """Return the open switches; end switches depend on the carriage, not on the position counter."""
        table = self.machine.base.table
        travel_um, slack_um = table.travel_mm.value * 1e3, table.step_um.value
        ends = zip((X_END, Y_END), self.plant.place_um, strict=True)
        opened = [name for name, place_um in ends if switches_open(place_um, travel_um, slack_um)]
        return [*opened, WIRE_BREAK] if window.broken and self._sees_breaks else opened

    def _stopped_by_controller(self, opened: Sequence[str]) -> bool:
        """Apply open switches to the controller's inputs, if it has any; return whether it stopped the machine."""
        if self._switched is None:
            return False
        for name in opened:
            self._switched.open_switch(name)
        stopped = self._switched.emergency
        if stopped is not None:
            self._say(stopped)
        return stopped is not None

    def _decide(self, observation: WindowObservation) -> None:
        """Let the controller decide on the next window."""
        command = protocols.check_command(self.controller.name, self.controller.update(observation))
        before = self._motion.command
        self.overtaken += before.latency_s >= observation.duration_s and command.feed_um_s != before.feed_um_s
        self._motion.command = command
        self._set_generator(command.t_on_us, command.t_period_us)

    def _set_generator(self, t_on_us: float | None, t_period_us: float | None) -> None:
        """Set the generator; a setting that it refuses has no effect, and `refused` has the reason."""
        now = self.plant.machine.t_on_us, self.plant.machine.t_period_us
        setting = now[0] if t_on_us is None else t_on_us, now[1] if t_period_us is None else t_period_us
        if setting == now:
            return
        try:
            self.plant.set_generator(*setting)
        except InputError as error:
            self.refused = error.reason

    def _stop_cause(self, window: PulseWindow, opened: Sequence[str]) -> StopCause:
        """Return whether and why the leg or the cut ends here."""
        switch = X_END in opened or Y_END in opened
        alarm, late = self._motion.command.alarm, self.plant.time_ns >= self._max_time_ns
        tripped, done = self.plant.drive_faults, self._motion.planner.done
        broken, shorted = WIRE_BREAK in opened, alarm is not None
        cause = StopCause(stop_cause(broken, switch, tripped != 0, shorted, late, done))
        if window.broken:
            self._say(self._break_of(window))
            if WIRE_BREAK not in opened:
                self._say("its stuck sensor did not see that, and the machine went on without a wire")
                self.plant.continue_without_wire()
        if cause is StopCause.LIMIT_SWITCH:
            x, y = self.plant.place_um
            self._say(f"an end switch of the table opened at x {x / 1e3:.3f} y {y / 1e3:.3f} mm")
        elif cause is StopCause.DRIVE_TRIP:
            self._say(self.plant.fault_reason)
        elif cause is StopCause.PERSISTENT_SHORT and alarm is not None:
            self._say(alarm)
        elif cause is StopCause.TIME_LIMIT:
            self._say(f"the time limit of {self._max_time_ns * 1e-9:g} s of machine time was reached")
        return cause

    def _break_of(self, window: PulseWindow) -> str:
        """Return where the wire broke, its temperature, and if the pulses were too dense, a safe period."""
        leg, where = self.legs[self.leg], f"{self.plant.broken_height_mm:.1f} mm above the workpiece's lower face"
        decided = "" if leg.cut_pass is None else "; the file of the technology, or of the conditions, sets that"
        if (one := leg.cut_pass) is not None:
            of = " of the tab" if one.piece == "tab" else ""
            where = f"{'on the way to' if leg.leads_in else 'in'} pass {one.number}{of}, {where}"
        text = f"the wire broke {where}, at {window.wire_temperature_K:.0f} K"
        if why := strong_discharge(self.plant.machine):
            return f"{text}: {why}{decided}"
        period_us, held_us = self.plant.machine.t_period_us, held_period_us(self.plant.machine)
        if period_us > 0.99 * held_us:
            return text
        held = f"from {held_us:.3g} us on its mean current density is at most that of the generator's own setting"
        return f"{text}: a period of {period_us:.3g} us is too short for it; {held}{decided}"

    def _say(self, reason: str) -> None:
        """Add to the reason why the cut ends."""
        self.reason = reason if self.reason is None else f"{self.reason}; {reason}"

    def _end_of_leg(self) -> StopCause:
        """Wait for the axes and the dwell, then begin the next leg; `StopCause.FINISHED` after the last leg."""
        at, leg, now_ns = self._at, self.legs[self._at.leg], self.plant.time_ns
        if not self._axes.settled():
            if late := self._axes.late():
                self._say(f"at the end of a leg of the path {late}")
                return StopCause.DRIVE_TRIP
            self._motion.rest_until_ns = now_ns + 1  # the next window moves nothing
            return StopCause.RUNNING
        if leg.dwell_s > 0 and not at.dwelling:
            at.dwelling = True
            self._motion.rest_until_ns = now_ns + round(leg.dwell_s * 1e9)
        if at.dwelling and now_ns < self._motion.rest_until_ns:
            return StopCause.RUNNING
        self.passes.end_leg(at.leg, leg, self.plant)
        if at.leg == len(self.legs) - 1:
            return StopCause.FINISHED
        following = self.legs[at.leg + 1].cut_pass
        if self._waits and following is not None and following is not leg.cut_pass:
            self.waiting = True
            return StopCause.RUNNING
        return self._next_leg()

    def begin_pass(self, path: CutPath, setups: Sequence[PassSetup]) -> StopCause:
        """Begin the next pass; it and later passes may have other offsets and settings."""
        if not self.waiting:
            raise InputError("a pass is under way: the next one begins when it is over")
        legs = legs_of(path)
        if len(legs) != len(self.legs):
            raise InputError(f"the path has {len(legs)} legs, not {len(self.legs)}: it is no plan of the same cut")
        self.waiting = False
        self.path, self.legs, self._setups = path, legs, tuple(setups)
        self.total_um = self.path_um + sum(float(leg.along_um[-1] - leg.along_um[0]) for leg in legs[self.leg + 1 :])
        self.passes.plan(path, legs)
        self.cause = self._next_leg()
        return self.cause

    def rethread(self, setup: PassSetup, approach: PassSetup) -> None:
        """Thread a new wire at the place of the break, and continue with this pass's setting."""
        if self.cause is not StopCause.WIRE_BREAK:
            raise InputError("no wire broke: there is nothing to thread")
        place_um = (*self.plant.commanded_um, *self.plant.lead_um) if self.path.leans else self.plant.commanded_um
        self.plant.rethread(place_um, round(self.machine.base.table.threading_s.value * 1e9))
        leg = self.legs[self.leg]
        if leg.cut_pass is not None:
            number = min(leg.cut_pass.number, len(self._setups))
            self._setups, self._approach = (*self._setups[: number - 1], setup, *self._setups[number:]), approach
        self._setup = approach if leg.leads_in else setup
        self.plant.change_setup(self._setup.machine)
        self._motion.command = self._reset_controller(self._setup.machine, leg.points_um)
        self.cause, self.reason = StopCause.RUNNING, None

    def _next_leg(self) -> StopCause:
        """Go to the next leg, and thread a wire if it begins a contour."""
        at = self._at
        if self.legs[at.leg + 1].threads:
            late_s = self._thread_at(self.legs[at.leg + 1].points_um[0], self._lead_of(at.leg + 1))
            if why := self.plant.fault_reason or self.plant.reason_of_delay(late_s):
                self._say(f"between two contours {why}")
                return StopCause.DRIVE_TRIP
        self._at = ProgramPlace(
            at.leg + 1, self.commanded_um, self.path_um, False, self._lead_um if self.path.leans else (0.0, 0.0),
            self.missed_windows,
        )
        self._cycle.motion = self._motion = self._begin_leg()
        self.passes.begin_leg(at.leg + 1, self.legs[at.leg + 1], self.plant.time_ns * 1e-9, self.path_um)
        return StopCause.RUNNING

    def _thread_at(self, point_um: np.typing.NDArray[np.int64], lead_um: tuple[float, float]) -> float:
        """Move to a contour and thread; return the time that axes would need that are too slow to wait for."""
        table = self.machine.base.table
        x, y = self.commanded_um
        distance_um = math.hypot(point_um[0] - x, point_um[1] - y)
        seconds = distance_um / table.rapid_um_s.value + table.threading_s.value
        place_um = self._motors_um(float(point_um[0]), float(point_um[1]), self.path_um, lead_um)
        return self.plant.rethread(place_um, round(seconds * 1e9))

    def run(self, watch: Callable[[Progress], None] | None = None) -> str:
        """Run until the cut is over; returns the outcome. `watch` is called after every window."""
        while self.outcome is None:
            progress = self.step()
            if watch is not None:
                watch(progress)
        return self.outcome

    def snapshot(self) -> tuple[dict[str, np.typing.NDArray[Any]], dict[str, Any]]:
        """Return the state: arrays, and JSON values."""
        arrays = {f"plant.{k}": v for k, v in self.plant.snapshot().items()}
        for recorder in self.recorders:
            arrays.update({f"{recorder.name}.{k}": v for k, v in recorder.snapshot().items()})
        return arrays, state_of(self)

    def restore(self, arrays: Mapping[str, np.typing.NDArray[Any]], values: Mapping[str, Any]) -> None:
        """Load a `snapshot` of the same cut, with the same recorders; the cut then continues bit for bit."""
        self._at = like(self._at, values["at"])
        self._cycle.motion = self._motion = self._begin_leg()
        self.plant.restore(with_prefix(arrays, "plant."))
        take_state(self, values)
        for recorder in self.recorders:
            recorder.restore(with_prefix(arrays, f"{recorder.name}."))
