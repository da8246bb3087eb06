"""A cut whose motion comes from another program: it sets the axes' positions and reads the gap's measurements.

`ExternalMotion` is a feed controller that makes the steps itself. `edmsim.cut` uses it like any other and writes the
same report, tables and recording. The program file defines the workpiece and the nominal contour; the other program
reads the same file.
"""

import math
import time
from collections import deque
from typing import Any, ClassVar, Protocol

import numpy as np

from edmsim.controllers.protocols import ControllerState, FeedCommand, Step, WindowObservation
from edmsim.errors import InputError
from edmsim.machine.machine import Machine
from edmsim.numeric import finite
from edmsim.snapshots import Snapshots

_FEED_WINDOWS = 40  # windows of the recorded mean feed (ours: a single window has one motor step or none)
_NEAR_UM = 1000.0  # search range round the last position on the path (ours: paths come back to themselves)


class Link(Protocol):
    """Connection to the other program."""

    def place_um(self) -> tuple[float, float]:
        """Present target of x and y, in um of its own coordinates."""

    def finished(self) -> bool:
        """Whether it has reached its end."""

    def show(self, observation: WindowObservation) -> None:
        """Send the observation of a window."""


class ExternalMotion:
    """Follows another program in real time, or a multiple of it.

    Parameters
    ----------
    link : Link
    time_scale : float
        Machine seconds per second of the other program's clock: with 10, its feeds are divided by ten.
    """

    name: ClassVar[str] = "external"

    def __init__(self, link: Link, time_scale: float = 1.0) -> None:
        if not 0 < time_scale < math.inf:
            raise InputError(f"time_scale is above 0, in machine seconds per second, not {time_scale!r}")
        self._link, self._time_scale = link, time_scale
        self._run: _Followed | None = None
        self._points: np.typing.NDArray[np.float64] = np.zeros((0, 2))
        self._step_um = self._rapid_um_s = self._end_um = 1.0
        self._before: deque[tuple[float, float]] = deque()

    def check_legs(self, legs: int) -> None:
        """Raise `InputError` for a path with stops: the other program does not report when it continues."""
        if legs > 1:
            raise InputError("another program moves the axes along one contour without dwells: cut the others apart")

    def set_up(self, machine: Machine, points_um: np.typing.NDArray[Any], start_um: float) -> None:
        """Read the path; the other program is then at its start."""
        table = machine.base.table
        self._points, self._step_um, self._end_um = points_um, table.step_um.value, machine.wire_diameter_um
        self._rapid_um_s = table.rapid_um_s.value

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin at the other program's position."""
        self._run = _Followed(self._link, self._points, self._step_um, self._rapid_um_s, self._time_scale)
        self._before = deque([(0.0, 0.0)], _FEED_WINDOWS)
        return FeedCommand(0.0)

    def path_run(self, planner: str) -> "_Followed | None":
        """Return the path run that follows the other program."""
        return self._run

    @property
    def emergency(self) -> str | None:
        """Message if the other program has ended further than the wire's diameter before the end of the path."""
        run = self._run
        if run is None or not run.done or run.length_um - run.path_um <= self._end_um:
            return None
        at, of = run.path_um / 1e3, run.length_um / 1e3
        return f"the program that moves the axes ended at {at:.3f} of {of:.3f} mm of the path"

    def open_switch(self, name: str) -> None:
        """Do nothing: the machine's switches are left to the other program."""

    def update(self, window: WindowObservation) -> FeedCommand:
        """Send the window; the feed is the axes' actual one."""
        self._link.show(window)
        time_s, path_um = self._before[0]
        self._before.append((window.time_s, window.path_um))
        return FeedCommand((window.path_um - path_um) / max(window.time_s - time_s, window.duration_s))

    def snapshot(self) -> ControllerState:
        """Return nothing: the state of the other program cannot be saved."""
        return {}

    def restore(self, state: ControllerState) -> None:
        """Refuse: the state of the other program cannot be restored."""
        raise InputError("a cut that another program moves cannot be resumed: cut it again")


class _Followed(Snapshots):
    """Replaces a planner: steps the axes to the other program's target."""

    STATE = ("_counted", "path_um")  # within a window
    speed_unit_nm_s = 1.0
    max_feed_um_s = math.inf

    def __init__(
        self, link: Link, points_um: np.typing.NDArray[np.float64], step_um: float, rapid_um_s: float,
        time_scale: float,
    ) -> None:
        self._link, self._points, self._step_um, self._scale = link, points_um, step_um, time_scale
        self._between_ns = int(step_um / rapid_um_s * 1e9)
        self._origin = self._place_um()
        self._counted = [float(v) for v in points_um[0]]
        self._target = (-1, self.position_um)
        self._end: tuple[float, float] | None = None
        self._clock: tuple[float, int] | None = None
        self.path_um = 0.0
        self._sides = np.diff(points_um, axis=0)
        self._lengths = np.hypot(*self._sides.T)
        self._stations = np.concatenate([[0.0], np.cumsum(self._lengths)])

    @property
    def position_um(self) -> tuple[float, float]:
        """Position counters."""
        return self._counted[0], self._counted[1]

    @property
    def length_um(self) -> float:
        """Length of the path."""
        return float(self._stations[-1])

    @property
    def done(self) -> bool:
        """Whether the other program has ended, and the axes are at its last position."""
        if not self._link.finished():
            return False
        if self._end is None:
            self._end = self._link_um()  # the axes may lag if the simulation is slower than the clock
        return max(abs(distance) for distance in self._distances(self._end)) < self._step_um

    def advance(self, start_ns: int, end_ns: int, speed_units: int) -> list[Step]:
        """Wait until the window is due, and step to the axes' target."""
        if self._target[0] != start_ns:  # if equal, the same window is planned again because it was shorter
            self._wait(start_ns)
            self._target = start_ns, self._end or self._link_um()
        steps = []
        for axis, distance in enumerate(self._distances(self._target[1])):
            direction = 1 if distance > 0 else -1
            for k in range(int(abs(distance) / self._step_um + 1e-9)):
                at_ns = start_ns + k * self._between_ns
                if at_ns >= end_ns:
                    break
                steps.append(Step(at_ns, axis, direction))
                self._counted[axis] += direction * self._step_um
        self.path_um = self._station()
        return sorted(steps)

    def _place_um(self) -> tuple[float, float]:
        """Return the other program's target of the axes, in its own coordinates."""
        what, place_um = "a place of the program that moves the axes, in um,", self._link.place_um()
        if np.shape(place_um) != (2,):
            raise InputError(f"{what} is {place_um!r}: give x and y")
        x, y = (finite(what, um) for um in place_um)
        return x, y

    def _link_um(self) -> tuple[float, float]:
        """Return the other program's target of the axes, in coordinates of the path."""
        (x, y), start = self._place_um(), self._points[0]
        return float(start[0] + x - self._origin[0]), float(start[1] + y - self._origin[1])

    def _distances(self, place_um: tuple[float, float]) -> tuple[float, float]:
        """Return the distances of both axes from the counters to a position."""
        return place_um[0] - self._counted[0], place_um[1] - self._counted[1]

    def _wait(self, start_ns: int) -> None:
        now = time.monotonic()
        if self._clock is None:
            self._clock = now, start_ns
        due = self._clock[0] + (start_ns - self._clock[1]) * 1e-9 / self._scale
        if due > now:
            time.sleep(due - now)

    def _station(self) -> float:
        """Return the length of path nearest to the counters, within `_NEAR_UM` of the last one."""
        place, begins = np.array(self._counted), self._points[:-1]
        along = ((place - begins) * self._sides).sum(axis=1) / np.maximum(self._lengths, 1e-9)
        along = np.clip(along, 0.0, self._lengths)
        feet = begins + self._sides * (along / np.maximum(self._lengths, 1e-9))[:, None]
        far = np.abs(self._stations[:-1] + along - self.path_um) > _NEAR_UM
        nearest = int(np.where(far, np.inf, np.hypot(*(place - feet).T)).argmin())
        return float(self._stations[nearest] + along[nearest])
