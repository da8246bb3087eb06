"""Planners by name: the ways from a path and a speed to the steps of two motors."""

from __future__ import annotations

import math
from typing import NamedTuple

from numpy.typing import ArrayLike

from edmsim.controllers.mcu.firmware.poscal import STEP_UM, Unit, unit_for
from edmsim.controllers.mcu.firmware.timers import MAX_SPEED, SPEED_UNIT_NM_S
from edmsim.controllers.planner.course import Course
from edmsim.controllers.planner.dda import NM
from edmsim.controllers.planner.protocol import Planner
from edmsim.controllers.planner.record import DDA, EXACT, LITERAL, POSCAL, SINE_TABLE
from edmsim.controllers.planner.row_planner import RowPlanner
from edmsim.errors import InputError, one_of

__all__ = ["PLANNERS", "Kind", "Planner", "kind_of", "make_planner", "position_unit"]

MOST_STEP_UM = 16  # longest motor step of the planners that steer (ours: half the distance at which they look ahead)


class Kind(NamedTuple):
    """What is particular to a planner."""

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
    name: str,
    points_um: ArrayLike,
    speed_unit_nm_s: float | None = None,
    unit: Unit = "um",
    step_um: float = STEP_UM,
) -> Planner:
    """Make a planner of `PLANNERS` for one path: corners (n, 2), whole um within 0..65535, but any for ``exact``.

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
    course = Course.of(kind.number, points_um, kind.speed_unit_nm_s, unit, step_um)
    return RowPlanner(course, kind.speed_unit_nm_s, kind.max_speed)


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
