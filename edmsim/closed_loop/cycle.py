"""One control cycle: motor steps, a window of 255 pulses, an observation, a decision.

All cuts that Python runs window by window use it: programs (`edmsim.closed_loop.simulation`) and straight cuts
(`edmsim.closed_loop.straight`). Environments run many sub-environments in compiled calls, and the terminal of 1982
decides by interrupts; they share `WindowObservation.of`, `edmsim.closed_loop.stops` and the rules of legs.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, Protocol, TypeAlias

import numpy as np

from edmsim.controllers.axis.elcam.step_compensation import StepCompensation
from edmsim.controllers.planner.registry import PathOffset, Planner
from edmsim.controllers.protocols import DrivesSteps, FeedCommand, Step, WindowObservation
from edmsim.machine import pulse_window, setting
from edmsim.plant.gap.generator import OppositePulses
from edmsim.plant.plant import Plant
from edmsim.snapshots import Snapshots

# Motion of the wire along its path: motor steps for a window, from a planner or evenly spaced along an axis.
# The steps are planned for the longest possible window; those after the window's actual end are dropped.


class PlannerMotion(Snapshots):
    """Motion along a leg by the steps of a planner; a command's feed has effect after its latency."""

    STATE = ("planner", "rest_until_ns", "command", "_units")
    command: FeedCommand

    def __init__(
        self, planner: Planner, drives: DrivesSteps | None, start_um: float, rest_until_ns: int, command: FeedCommand,
        max_feed_um_s: float, offset: PathOffset, compensation: StepCompensation | None = None,
    ) -> None:
        self.planner = planner
        self.start_um = start_um
        self.rest_until_ns = rest_until_ns
        self.command = command
        self._drives = drives
        self._limit_um_s = max_feed_um_s
        self._units = 0
        self._speeds = 0, 0, 0  # speed in units, a time in ns, and the speed after it
        self._before: Any = None
        self._planned: tuple[int, float] | None = None  # steps of the longest window, and the path length after them
        self._offset = offset
        self._compensation = compensation

    @property
    def feed_um_s(self) -> float:
        """Present feed, in whole speed units of the planner."""
        return self._units * self.planner.speed_unit_nm_s * 1e-3

    @property
    def path_um(self) -> float:
        """Path length that the wire has travelled, over all legs."""
        return self.start_um + self.planner.path_um

    def plan(self, start_ns: int, end_ns: int, certain: bool) -> list[Step]:
        """Return the planner's steps; if not `certain`, the window may end earlier, and no step was made yet."""
        self._speeds = self._speeds_from(start_ns)
        offset_um, lateral = self.command.offset_um, list[Step]()
        if self._offset.is_due(offset_um):
            lateral = self._offset.steps(start_ns, self.planner.path_um, offset_um)
        if certain:
            return lateral + self._to_motors(self._drive(self._steps(start_ns, end_ns)))
        self._before = self.planner.snapshot(), self._compensation and self._compensation.snapshot()
        steps = self._steps(start_ns, end_ns)
        self._planned = len(steps), self.path_um
        return lateral + self._to_motors(steps)

    def keep(self, start_ns: int, end_ns: int) -> None:
        """Process the window's end; a planner that went further is set back to it."""
        if self._before is not None:
            planner, compensation = self._before
            self.planner.restore(planner)
            if self._compensation is not None:
                self._compensation.restore(compensation)
            self._before = None
            self._to_motors(self._drive(self._steps(start_ns, end_ns)))
            self._planned = None
        first, change_ns, then = self._speeds
        self._units = then if change_ns < end_ns else first

    def _speeds_from(self, start_ns: int) -> tuple[int, int, int]:
        """Return the speeds of the next window: the old one until the controller is done, then the new one."""
        if start_ns < self.rest_until_ns:
            return 0, start_ns, 0
        feed_um_s = max(-self._limit_um_s, min(self._limit_um_s, self.command.feed_um_s))
        units = round(feed_um_s * 1e3 / self.planner.speed_unit_nm_s)
        return self._units, start_ns + round(self.command.latency_s * 1e9), units

    def _steps(self, start_ns: int, end_ns: int) -> list[Step]:
        first, change_ns, then = self._speeds
        change_ns = min(change_ns, end_ns)
        if change_ns <= start_ns or first == then:
            return self.planner.advance(start_ns, end_ns, then)
        steps = self.planner.advance(start_ns, change_ns, first)
        return steps + self.planner.advance(change_ns, end_ns, then) if change_ns < end_ns else steps

    def _drive(self, steps: list[Step]) -> list[Step]:
        """Return the steps of the motors; a controller with lines to x and y makes these itself."""
        if not (self._drives and steps):
            return steps
        made = self._drives.drive([step for step in steps if step.axis < 2])
        led = [step for step in steps if step.axis >= 2]
        return sorted([*made, *led], key=lambda step: step.time_ns) if led else made

    def _to_motors(self, steps: list[Step]) -> list[Step]:
        if self._compensation is None:
            return steps
        # in a window that ends early, every step keeps the path length for which it was planned
        of, path_um = self._planned or (len(steps), self.path_um)
        return self._compensation.motor_steps(steps, path_um, of)


class EvenSteps:
    """Steps of one axis, evenly spaced; feed (negative runs backwards) and axis may change between windows."""

    def __init__(self, step_um: float, feed_um_s: float) -> None:
        self.axis = 0
        self.feed_um_s = feed_um_s
        self.path_um = 0.0
        self._step_um = step_um
        self._step_share = 0.0  # fraction of the next step that has passed

    def plan(self, start_ns: int, end_ns: int, certain: bool = False) -> list[tuple[int, int, int]]:
        """Return the steps of the longest possible window."""
        per_ns = abs(self.feed_um_s) / self._step_um * 1e-9
        count = int(self._step_share + per_ns * (end_ns - start_ns))
        direction = 1 if self.feed_um_s > 0 else -1
        return [(start_ns + int((k + 1 - self._step_share) / per_ns), self.axis, direction) for k in range(count)]

    def keep(self, start_ns: int, end_ns: int) -> None:
        """Process the window's end."""
        travel_um = self.feed_um_s * (end_ns - start_ns) * 1e-9
        self._step_share = (self._step_share + abs(travel_um) / self._step_um) % 1.0
        self.path_um += travel_um


PlantView: TypeAlias = Plant
"""Interface of the plant for recorders, which read the last window and change nothing."""


class CycleResult(NamedTuple):
    """Result of one control cycle: a window, and the motion of the wire in it."""

    window: pulse_window.PulseWindow  # results of the window
    time_ns: int  # machine time at the window's end
    feed_um_s: float  # feed at the window's end
    path_um: float  # path length travelled by the position counters, over all legs
    opposite: OppositePulses | None = None  # equalising pulses of the window, if the generator has them


class Recorder(Protocol):
    """Records a cut and changes nothing."""

    name: ClassVar[str]  # key of its snapshot in the checkpoint, unique among the recorders of a cut

    def begin(self, plant: PlantView) -> None:
        """Read the plant before the first window."""
        return

    def leg(self, points_um: np.typing.NDArray[np.int64], start_um: float) -> None:
        """Read the points (n, 2) of the leg that begins at `CycleResult.path_um` == `start_um`."""
        return

    def window(self, result: CycleResult, plant: PlantView) -> None:
        """Record a window after it ended."""

    def snapshot(self) -> Mapping[str, np.typing.NDArray[Any]]:
        """Return a copy of the state as arrays."""

    def restore(self, state: Mapping[str, np.typing.NDArray[Any]]) -> None:
        """Load a snapshot."""


class Cycle:
    """Runs plant, motion and controller together. Recorders see every window; a decision applies to the next one."""

    def __init__(
        self, plant: Plant, motion: PlannerMotion | EvenSteps, decide: Callable[[WindowObservation], None],
        recorders: Sequence[Recorder] = (),
    ) -> None:
        self.motion = motion
        self._plant = plant
        self._decide = decide
        self._recorders = recorders

    def run_window(self) -> CycleResult:
        """Run one window."""
        plant, motion = self._plant, self.motion
        start_ns = plant.time_ns
        steps = motion.plan(start_ns, start_ns + plant.longest_window_ns, plant.window_ns > 0)
        window = plant.advance(steps)
        motion.keep(start_ns, plant.time_ns)
        result = CycleResult(window, plant.time_ns, motion.feed_um_s, motion.path_um, plant.opposite_pulses())
        for recorder in self._recorders:
            recorder.window(result, plant)
        if window.pulses == setting.WINDOW_PULSES:
            self._decide(WindowObservation.of(window, result.time_ns, result.feed_um_s, result.path_um))
        return result
