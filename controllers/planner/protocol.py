"""Interfaces of planners, and of controllers that make a planner's steps themselves."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

from edmsim.controllers.protocols import Step

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
        """Length travelled along the path in um, 0 at its start."""

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
