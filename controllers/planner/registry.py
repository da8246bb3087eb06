"""Planners by name: from a path and a speed to the steps of two motors."""

from __future__ import annotations

import math
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from edmsim.controllers.mcu.firmware.arithmetic import WORD
from edmsim.controllers.mcu.firmware.poscal import STEP_UM, Unit, soft_limit, unit_for
from edmsim.controllers.mcu.firmware.timers import MAX_SPEED, SPEED_UNIT_NM_S
from edmsim.controllers.planner import kinds
from edmsim.controllers.planner.course import Course
from edmsim.controllers.planner.kinds import CHANGES, DDA, EXACT, LIMIT, LITERAL, NM, POSCAL, SINE_TABLE, position_um
from edmsim.controllers.protocols import Step, check_window
from edmsim.errors import InputError, one_of

__all__ = ["PLANNERS", "Kind", "Planner", "kind_of", "make_planner", "position_unit"]

# Interfaces of planners, and of controllers that make a planner's steps themselves.

PlannerState = dict[str, Any]  # a planner's snapshot, fit for JSON


class Planner(Protocol):
    """Follows a path and says when each axis steps; windows may be cut anywhere, and the steps stay the same."""

    @property
    def speed_unit_nm_s(self) -> float:
        """Unit of the path speed in nm/s: 262.5 of the integer planners, 1 of `exact`."""

    @property
    def max_feed_um_s(self) -> float:
        """Greatest path speed in um/s: 127 units of the integer planners, none (infinite) of `exact`."""

    @property
    def position_um(self) -> tuple[float, float]:
        """Position counters in um (row T-70): whole steps away from the start point; ints where steps are whole."""

    @property
    def path_um(self) -> float:
        """Length travelled along the path in um, 0 where the planner began."""

    @property
    def done(self) -> bool:
        """Whether the path's end is reached."""

    def advance(self, start_ns: int, end_ns: int, speed_units: int) -> list[Step]:
        """Return the steps at ``start_ns <= time_ns < end_ns``, in order; a negative speed runs backwards."""

    def snapshot(self) -> PlannerState:
        """Everything that changes while running."""

    def restore(self, state: PlannerState) -> None:
        """Continue exactly where `snapshot` was taken; the planner must have been made for the same path."""


@runtime_checkable
class RunsPath(Protocol):
    """A controller that is the machine's own computer: with some planners no planner runs, as it makes the steps."""

    def path_run(self, planner: str) -> Planner | None:
        """Return the leg's replacement of the planner of that name, or None; called after every reset."""


_ROOM = 64  # steps of a window for which there is room at first


class RowPlanner:
    """Runs a course by compiled code; see `Planner` and `make_planner`."""

    def __init__(self, course: Course, kind: Kind) -> None:
        self.speed_unit_nm_s, self.max_feed_um_s = kind.speed_unit_nm_s, kind.max_feed_um_s
        self._max_speed = kind.max_speed
        self._course = course
        self._row = course.row[0]
        self._room = np.zeros((_ROOM, 3), np.int64)

    @property
    def position_um(self) -> tuple[float, float]:
        """Position counters in um, whole where start and steps are."""
        x, y = (position_um(self._row, axis) for axis in (0, 1))
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
        if made == LIMIT:
            size_um = int(self._row["unit_um"])
            raise soft_limit(next(v for v in self.position_um if not 0 <= v <= WORD * size_um), size_um)
        if made > len(self._room):
            self._room = np.zeros((made, 3), np.int64)
            self._course.row[0] = before
            kinds.advance(self._row, points, along, lengths, start_ns, end_ns, speed_units, self._room)
        return [Step(*step) for step in self._room[:made].tolist()]

    def snapshot(self) -> PlannerState:
        """Everything that changes while running."""
        return {name: self._row[name].tolist() for name in CHANGES}

    def restore(self, state: PlannerState) -> None:
        """Continue where `snapshot` was taken."""
        for name in CHANGES:
            self._row[name] = state[name]


MOST_STEP_UM = 16  # longest motor step of the planners that steer (ours: half the distance at which they look ahead)


class Kind(NamedTuple):
    """Properties of a planner."""

    number: int  # its kind in compiled code (see `record`)
    speed_unit_nm_s: float = SPEED_UNIT_NM_S  # unit of its path speed
    max_speed: int | None = MAX_SPEED  # greatest path speed in units; None if it has no limit of its own

    @property
    def max_feed_um_s(self) -> float:
        """Greatest path speed in um/s; infinite if there is none."""
        return math.inf if self.max_speed is None else self.max_speed * self.speed_unit_nm_s / 1000

    @property
    def counts(self) -> bool:
        """Whether it has position counters of 16 bits, and so paths in whole units of them."""
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


def position_unit(name: str, travel_um: float, step_um: float = STEP_UM) -> Unit:
    """Return what a planner counts on a table: um, or motor steps where 16 bits hold no more."""
    kind = kind_of(name)
    if not kind.counts:
        return "um"
    _check_step(name, kind, step_um)
    return unit_for(travel_um, int(step_um) if step_um == int(step_um) else 1)


def make_planner(
    name: str, points_um: ArrayLike, speed_unit_nm_s: float | None = None, unit: Unit = "um",
    step_um: float = STEP_UM, start: int = 0,
) -> Planner:
    """Make a planner of `PLANNERS` for one path: corners (n, 2), whole um within 0..65535, but any for ``exact``.

    It begins at the corner of the number `start`, from which it can run back to the first one.

    Its speed unit is 262.5 nm/s if not given, or 252.6 as the thesis prints it (row T-A1), and 1 nm/s for ``exact``.
    The unit ``step`` takes points at whole steps, 0..65535 of them (row T-61); `step_um` is whole, up to 16, a whole
    number of nm for ``dda``, any for ``exact``.
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
