"""ELCAM between a planner and motors: steps more or less where tables say that axes are wrong, and those of cams.

A motor that takes steps reports no place that an error could be taken off, so the error is added to its setpoint
("G3-ElCam Interface", chapter 2.2.1), in whole steps. An axis of the upper guide that follows a cam has no steps but
these.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from edmsim.controllers.axis.elcam.file import NAMES, PATH, PLACES
from edmsim.controllers.axis.elcam.module import Elcam
from edmsim.controllers.axis.elcam.places import CamPlace
from edmsim.controllers.protocols import Step
from edmsim.errors import InputError

_AXES = range(len(NAMES))
_PATH = PLACES.index(PATH)


class StepCompensation:
    """What is between a planner's steps and the motors: the tables of `load_tables` move them `offset_um` further."""

    def __init__(self, elcam: Elcam, step_um: float) -> None:
        self._places = [axis for axis in elcam.axes if isinstance(axis, CamPlace)]
        if len(self._places) != len(PLACES):
            raise InputError("the tables must be those of load_tables: they belong to a control with axes of its own")
        self._elcam = elcam
        self._step_um = step_um
        self._extra = [0] * len(NAMES)

    @property
    def offset_um(self) -> tuple[float, float]:
        """Extra steps of x and y in um."""
        return self._extra[0] * self._step_um, self._extra[1] * self._step_um

    @property
    def upper_um(self) -> tuple[float, float]:
        """Where the motors of u and v are."""
        return self._extra[2] * self._step_um, self._extra[3] * self._step_um

    def begin(
        self, position_um: tuple[float, float], path_um: float = 0.0, lead_um: tuple[float, float] = (0.0, 0.0)
    ) -> tuple[float, float]:
        """Be at a place of the program and its path, without steps to there; return where x and y are then."""
        for k, um in enumerate((*position_um, *lead_um, path_um)):
            self._put(k, um * 1e-3)
        self._extra = self._steps_due()
        return position_um[0] + self.offset_um[0], position_um[1] + self.offset_um[1]

    def motor_steps(self, steps: Sequence[Step], path_um: float = 0.0) -> list[Step]:
        """Return the steps that the motors are to make for those of the program, which lead to a length of path."""
        made: list[Step] = []
        path_mm, end_mm = self._places[_PATH].setpoint, path_um * 1e-3
        for number, (time_ns, axis, direction) in enumerate(steps, 1):
            self._put(axis, self._places[axis].setpoint + direction * self._step_um * 1e-3)
            self._put(_PATH, path_mm + (end_mm - path_mm) * number / len(steps))
            due = self._steps_due()
            for k in _AXES:
                count = due[k] - self._extra[k] + (direction if k == axis else 0)
                made += [Step(time_ns, k, 1 if count > 0 else -1)] * abs(count)
            self._extra = due
        return made

    def _put(self, k: int, place_mm: float) -> None:
        place = self._places[k]
        place.setpoint = place.actual = place_mm

    def _steps_due(self) -> list[int]:
        """Return the steps beyond those of the program; followers come first, as errors may depend on them."""
        cams = self._elcam.follow()
        for k, place_mm in cams.items():
            self._put(k, place_mm)
        return [round((cams.get(k, 0.0) + self._elcam.compensation(k)) * 1e3 / self._step_um) for k in _AXES]

    def snapshot(self) -> dict[str, Any]:
        """Return what changes, fit for JSON."""
        return {
            "places": [place.setpoint for place in self._places], "extra": list(self._extra),
            "directions": {str(k): table.direction for k, table in self._elcam.tables.items()},
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue where `snapshot` was taken, with the same tables."""
        for k, place_mm in enumerate(state["places"]):
            self._put(k, place_mm)
        self._extra = list(state["extra"])
        for k, direction in state["directions"].items():
            self._elcam.tables[int(k)].go_on(direction, self._elcam.axes[self._elcam.tables[int(k)].master].setpoint)
