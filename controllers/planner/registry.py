"""Planners by name: from a path and a speed to the steps of two motors."""

import math
from itertools import pairwise
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.mcu.firmware.poscal import STEP_UM, WORD, Unit, soft_limit, unit_for, unit_um
from edmsim.controllers.mcu.firmware.timers import MAX_SPEED, SPEED_UNIT_NM_S, TIMER_COUNT, timer_clock_hz
from edmsim.controllers.planner import kinds
from edmsim.controllers.planner.kinds import DDA, EXACT, LITERAL, NM, POSCAL, SINE_TABLE, segment_at
from edmsim.controllers.protocols import Step, check_window
from edmsim.errors import InputError, one_of
from edmsim.geometry import Floats, Ints, Polyline
from edmsim.snapshots import Snapshots


class Course(NamedTuple):
    """A planner's data for compiled code, ready to run."""

    row: NDArray[np.void]
    points_um: Floats  # (n, 2): corners of the path, each different from the one before
    along_um: Floats  # (n,): path length at each corner
    lengths: Ints  # (n - 1,): length of every move in 1/65,536 of a motor step, rounded down; 0 except for `DDA`

    @classmethod
    def of(
        cls, kind: int, points_um: ArrayLike, speed_unit_nm_s: float = SPEED_UNIT_NM_S, unit: Unit = "um",
        step_um: float = STEP_UM, start: int = 0,
    ) -> "Course":
        """Begin a path (n, 2) for a kind of planner at one of its points; refuses points that it cannot count."""
        # lengths are relative to that point, so those of the points before it, for retracts, are negative
        array = np.asarray(points_um, np.float64)
        if array.ndim != 2 or array.shape[1] != 2:
            raise InputError(f"a path needs points in an array of shape (n, 2), not {array.shape}")
        row: NDArray[np.void] = np.zeros(1, kinds.PLANNER)
        row["kind"], row["step_um"] = kind, step_um
        row["unit_um"] = size_um = unit_um(unit, round(step_um))
        if kind == EXACT:
            lay = _exact
        else:
            grid_um = 1 / NM if kind == DDA and step_um != round(step_um) else size_um
            # counters in um that are off the grid of steps may pass a corner by half a step
            _check_counts(array, grid_um, size_um, 0.0 if step_um <= STEP_UM or unit == "step" else step_um)
            clock = timer_clock_hz(speed_unit_nm_s, step_um)
            row["hertz"], row["per"] = clock.numerator, clock.denominator
            lay = _counted
        points, along = lay(array[start:])
        if len(points) < 2:
            raise InputError(f"a path needs two different points, not {len(points)}")
        if start > 0:
            behind, back = lay(array[start::-1])
            row["move"] = len(behind) - 1
            points, along = np.concatenate([behind[:0:-1], points]), np.concatenate([-back[:0:-1], along])
        row["last_move"], row["from_um"] = len(points) - 2, array[start]
        lengths = _lengths(points, step_um) if kind == DDA else np.zeros(len(points) - 1, np.int64)
        kinds.begin(row[0], points)
        return cls(row, points, along, lengths)


def _check_counts(points: Floats, grid_um: float, size_um: int, margin_um: float) -> None:
    """Refuse points outside the range of counters in such units, or between the points of a grid."""
    low, high = margin_um, WORD * size_um - margin_um
    for i, (x, y) in enumerate(points.tolist()):
        if not (low <= x <= high and low <= y <= high):
            raise InputError(
                f"point {i} of the path lies at ({x:g}, {y:g}) um, outside the table's {low:.10g}..{high:.10g} um"
            )
        if any(abs(v / grid_um - round(v / grid_um)) > 1e-6 for v in (x, y)):
            of_nm = "in whole um" if grid_um == 1 else "in whole nm"
            what = f"a whole number of {grid_um:g} um steps" if grid_um > 1 else of_nm
            raise InputError(f"point {i} of the path, ({x:g}, {y:g}) um, is not {what}")


def _counted(points: Floats) -> tuple[Floats, Floats]:
    """Return the corners without repetitions, and the path length at each."""
    distinct = points[np.concatenate([[True], np.any(np.diff(points, axis=0) != 0.0, axis=1)])]
    along = [0.0]
    for a, b in pairwise(distinct.tolist()):
        along.append(along[-1] + math.dist(a, b))
    return distinct, np.array(along)


def _exact(points: Floats) -> tuple[Floats, Floats]:
    """Return the same for fractional corners; those within 0.1 um of the one before are left out."""
    if not np.isfinite(points).all():
        raise InputError("a path needs points of finite numbers")
    line = Polyline(points * 1e-3, closed=False)
    return line.points * 1e3, line.s * 1e3


def _lengths(points: Floats, step_um: float) -> Ints:
    """Return the lengths of the moves in 1/65,536 of a step, rounded down."""
    nm = [(round(x * NM), round(y * NM)) for x, y in points.tolist()]
    return np.array(
        [
            math.isqrt(((bx - ax) ** 2 + (by - ay) ** 2) * TIMER_COUNT**2 // round(step_um * NM) ** 2)
            for (ax, ay), (bx, by) in pairwise(nm)
        ],
        np.int64,
    )


__all__ = ["PLANNERS", "Kind", "Planner", "kind_of", "make_planner", "position_unit"]

# Interfaces of planners, and of controllers that make a planner's steps themselves.

PlannerState = dict[str, Any]  # a planner's snapshot as JSON


class Planner(Protocol):
    """Follows a path and computes the time of each step; how time is divided into windows has no effect."""

    @property
    def speed_unit_nm_s(self) -> float:
        """Unit of the path speed in nm/s: 262.5 of the integer planners, 1 of `exact`."""

    @property
    def max_feed_um_s(self) -> float:
        """Greatest path speed in um/s: 127 units of the integer planners, none (infinite) of `exact`."""

    @property
    def position_um(self) -> tuple[float, float]:
        """Position counters in um (row T-70), whole steps from the start point; ints if steps are whole um."""

    @property
    def path_um(self) -> float:
        """Length travelled along the path in um, 0 at the planner's start."""

    @property
    def done(self) -> bool:
        """Whether the path's end is reached."""

    def advance(self, start_ns: int, end_ns: int, speed_units: int) -> list[Step]:
        """Return the steps at ``start_ns <= time_ns < end_ns``, in order; a negative speed runs backwards."""

    def snapshot(self) -> PlannerState:
        """Save the state."""

    def restore(self, state: PlannerState) -> None:
        """Load a snapshot of a planner of the same path."""


@runtime_checkable
class RunsPath(Protocol):
    """A controller that contains the machine's computer, which makes the steps in place of some planners."""

    def path_run(self, planner: str) -> Planner | None:
        """Return what replaces the planner of this name for the leg, or None; called after every reset."""


_ROOM = 64  # initial room for steps of a window


class RowPlanner:
    """Runs a course in compiled code; see `Planner` and `make_planner`."""

    def __init__(self, course: Course, kind: "Kind") -> None:
        self.speed_unit_nm_s, self.max_feed_um_s = kind.speed_unit_nm_s, kind.max_feed_um_s
        self._max_speed = kind.max_speed
        self._course = course
        self._room = np.zeros((_ROOM, 3), np.int64)

    @property
    def _row(self) -> np.void:
        row: np.void = self._course.row[0]
        return row

    @property
    def position_um(self) -> tuple[float, float]:
        """Position counters in um, ints if start and steps are whole um."""
        x, y = (kinds.position_um(self._row, axis) for axis in (0, 1))
        return (int(x) if x == int(x) else x, int(y) if y == int(y) else y)

    @property
    def path_um(self) -> float:
        """Length travelled along the path in um."""
        _, points, along, _ = self._course
        return kinds.path_um(self._row, points, along)

    @property
    def done(self) -> bool:
        """Whether the path's end is reached."""
        _, points, along, lengths = self._course
        return kinds.done(self._row, points, along, lengths)

    def advance(self, start_ns: int, end_ns: int, speed_units: int) -> list[Step]:
        """Steps in a window of time; see `Planner.advance`."""
        check_window(start_ns, end_ns, speed_units, self._max_speed)
        _, points, along, lengths = self._course
        before = self._row.copy()
        made = kinds.advance(self._row, points, along, lengths, start_ns, end_ns, speed_units, self._room)
        if made == kinds.LIMIT:
            size_um = int(self._row["unit_um"])
            raise soft_limit(next(v for v in self.position_um if not 0 <= v <= WORD * size_um), size_um)
        if made > len(self._room):
            self._room = np.zeros((made, 3), np.int64)
            self._course.row[0] = before
            kinds.advance(self._row, points, along, lengths, start_ns, end_ns, speed_units, self._room)
        return [Step(*step) for step in self._room[:made].tolist()]

    def snapshot(self) -> PlannerState:
        """Save the state."""
        return {name: self._row[name].tolist() for name in kinds.CHANGES}

    def restore(self, state: PlannerState) -> None:
        """Load a snapshot."""
        for name in kinds.CHANGES:
            self._row[name] = state[name]


MOST_STEP_UM = 16  # longest motor step of the planners that aim ahead (ours: half their distance)


class Kind(NamedTuple):
    """Properties of a planner."""

    number: int  # its kind in compiled code (see `record`)
    speed_unit_nm_s: float = SPEED_UNIT_NM_S  # unit of its path speed
    max_speed: int | None = MAX_SPEED  # greatest path speed in units; None if it has no limit

    @property
    def max_feed_um_s(self) -> float:
        """Greatest path speed in um/s; infinite if there is none."""
        return math.inf if self.max_speed is None else self.max_speed * self.speed_unit_nm_s / 1000

    @property
    def counts(self) -> bool:
        """Whether it has 16-bit position counters, which need paths in whole units."""
        return self.number != EXACT


PLANNERS: dict[str, Kind] = {
    "poscal": Kind(POSCAL),
    "poscal-literal": Kind(LITERAL),
    "dda": Kind(DDA),
    "sine-table": Kind(SINE_TABLE),
    "exact": Kind(EXACT, 1.0, None),
}
"""Every planner by its name; the first is the default."""


def kind_of(name: str) -> Kind:
    """Return a planner's kind; raises `InputError` if there is no planner of that name."""
    if name not in PLANNERS:
        raise InputError(f"there is no planner {name!r}; choose one of {one_of(name, PLANNERS)}")
    return PLANNERS[name]


def counting() -> list[str]:
    """Return the names of the planners that have position counters."""
    return [name for name, kind in PLANNERS.items() if kind.counts]


def position_unit(name: str, travel_um: float, step_um: float = STEP_UM) -> Unit:
    """Return the unit that a planner counts on a table: um, or motor steps if 16 bits are not enough for um."""
    kind = kind_of(name)
    if not kind.counts:
        return "um"
    _check_step(name, kind, step_um)
    return unit_for(travel_um, int(step_um) if step_um == int(step_um) else 1)


def make_planner(
    name: str, points_um: ArrayLike, speed_unit_nm_s: float | None = None, unit: Unit = "um",
    step_um: float = STEP_UM, start: int = 0,
) -> Planner:
    """Make a planner of `PLANNERS` for a path: corners (n, 2) in whole um within 0..65535, any values for ``exact``.

    It begins at corner number `start`, and can run back from there to the first one.

    The speed unit is 262.5 nm/s by default, 252.6 as printed in the thesis (row T-A1), 1 nm/s for ``exact``. With the
    unit ``step``, points are at whole steps, 0..65535 (row T-61). `step_um` is an integer up to 16, a whole number of
    nm for ``dda``, any number for ``exact``.
    """
    kind = kind_of(name)
    _check_step(name, kind, step_um)
    if kind.number == EXACT and speed_unit_nm_s not in (None, kind.speed_unit_nm_s):
        raise InputError(f"the planner exact counts its feed in nm/s, not in units of {speed_unit_nm_s} nm/s")
    if speed_unit_nm_s is not None:
        kind = kind._replace(speed_unit_nm_s=speed_unit_nm_s)
    course = Course.of(kind.number, points_um, kind.speed_unit_nm_s, unit, step_um, start)
    return RowPlanner(course, kind)


def _check_step(name: str, kind: Kind, step_um: float) -> None:
    if not (step_um > 0 and math.isfinite(step_um)):
        raise InputError(f"table.step_um is {step_um:g}: a motor step is a number of um above 0")
    if kind.number == DDA and abs(step_um * NM - round(step_um * NM)) > 1e-6:
        raise InputError(
            f"the planner dda counts in whole nm, and table.step_um is {step_um:g} um: choose the planner exact"
        )
    if kind.number in (POSCAL, LITERAL, SINE_TABLE) and not (step_um == int(step_um) <= MOST_STEP_UM):
        raise InputError(
            f"the planner {name} counts in whole um, and table.step_um is {step_um:g}: give the machine steps of "
            f"1 to {MOST_STEP_UM} whole um, or choose the planner exact or dda"
        )



# Offset of the guides from the programmed path, by extra motor steps in every window.
#
# A bent wire does not cut where its guides are. A controller that estimates this error can offset the guides to the
# other side. In a trim pass, guides nearer to the wall remove more metal.

@exactly_compiled
def next_steps(
    points_um: Floats, along_um: Floats, last: int, path_um: float, offset_um: float, step_um: float,
    made: NDArray[np.int64],
) -> tuple[int, int]:
    """Return the step of x and y, -1, 0 or 1, towards an offset to the left of the path.

    One step per axis and window, 80 um/s at the thesis' setting, is slow enough for the motors, and fast enough for
    changes of the wire's deflection. `made` (2,) is the present offset in steps.
    """
    k = segment_at(along_um, last, path_um, 0)
    dx, dy = points_um[k + 1, 0] - points_um[k, 0], points_um[k + 1, 1] - points_um[k, 1]
    scale = offset_um / (math.hypot(dx, dy) * step_um)
    more_x, more_y = int(np.rint(-dy * scale)) - made[0], int(np.rint(dx * scale)) - made[1]
    return min(max(more_x, -1), 1), min(max(more_y, -1), 1)


class PathOffset(Snapshots):
    """The offset of a cut, leg by leg; `lateral_um` is the motors' offset from the program's position."""

    STATE = ("_made",)

    def __init__(self, step_um: float) -> None:
        self._step_um = step_um
        self._made: NDArray[np.int64] = np.zeros(2, np.int64)
        self._points: Floats = np.zeros((0, 2))
        self._along: Floats = np.zeros(0)

    @property
    def lateral_um(self) -> tuple[float, float]:
        """Present offset in um."""
        x, y = (self._made * self._step_um).tolist()
        return x, y

    def clear(self) -> None:
        """Set the position on the program after a motion without steps."""
        self._made[:] = 0

    def begin_leg(self, points_um: NDArray[Any], along_um: Floats | None = None) -> None:
        """Begin the next leg, whose path lengths may differ from those of its points; the motors do not move."""
        if along_um is None:
            course = Course.of(EXACT, points_um)
            self._points, self._along = course.points_um, course.along_um
            return
        moves = np.concatenate([[True], (np.diff(points_um, axis=0) != 0).any(axis=1)])
        self._points, self._along = np.asarray(points_um[moves], np.float64), along_um[moves]

    def is_due(self, offset_um: float) -> bool:
        """Return whether an offset may need steps: in most cuts it is and remains 0."""
        return bool(offset_um or self._made[0] or self._made[1])

    def steps(self, time_ns: int, path_um: float, offset_um: float) -> list[Step]:
        """Return the extra steps of the next window, at a length of the leg."""
        more = next_steps(
            self._points, self._along, len(self._points) - 2, path_um, offset_um, self._step_um, self._made
        )
        self._made += more
        return [Step(time_ns, axis, direction) for axis, direction in enumerate(more) if direction]
