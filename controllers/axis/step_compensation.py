"""Compensation between a planner and stepping motors: steps more or less, where a table says the axes are wrong.

A motor that takes steps reports no place that an error could be taken off, so the error is added to its setpoint
("G3-ElCam Interface", chapter 2.2.1), in whole steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from edmsim.controllers.axis.elcam import Elcam
from edmsim.controllers.axis.elcam_places import CamPlace
from edmsim.controllers.protocols import Step
from edmsim.errors import InputError


class StepCompensation:
    """What stands between a planner's steps and the motors of x and y.

    Parameters
    ----------
    elcam : Elcam
        With compensation tables in mm, of `edmsim.controllers.axis.elcam_file.load_tables`.
    step_um : float
        Travel of a step.

    Attributes
    ----------
    offset_um : (float, float)
        By how much the motors stand further than the program says.

    Raises
    ------
    InputError
        The axes of the tables' control have no places that can be set.
    """

    def __init__(self, elcam: Elcam, step_um: float) -> None:
        self._places = [axis for axis in elcam.axes if isinstance(axis, CamPlace)]
        if len(self._places) != len(elcam.axes):
            raise InputError("the tables must be those of load_tables: they belong to a control with axes of its own")
        self._elcam = elcam
        self._step_um = step_um
        self._extra = [0, 0]

    @property
    def offset_um(self) -> tuple[float, float]:
        """Extra steps in um."""
        return self._extra[0] * self._step_um, self._extra[1] * self._step_um

    def begin(self, position_um: tuple[float, float]) -> tuple[float, float]:
        """Stand at a place of the program, without steps to there; return where the motors stand then."""
        for place, um in zip(self._places, position_um, strict=False):
            place.setpoint = place.actual = um * 1e-3
        self._extra = self._wanted()
        return position_um[0] + self.offset_um[0], position_um[1] + self.offset_um[1]

    def motor_steps(self, steps: Sequence[Step]) -> list[Step]:
        """Return the steps that the motors are to make for those of the program."""
        made: list[Step] = []
        for time_ns, axis, direction in steps:
            place = self._places[axis]
            place.setpoint = place.actual = place.setpoint + direction * self._step_um * 1e-3
            wanted = self._wanted()
            for k in (0, 1):
                count = wanted[k] - self._extra[k] + (direction if k == axis else 0)
                made += [Step(time_ns, k, 1 if count > 0 else -1)] * abs(count)
            if axis > 1:
                made.append(Step(time_ns, axis, direction))
            self._extra = wanted
        return made

    def _wanted(self) -> list[int]:
        return [round(self._elcam.compensation(k) * 1e3 / self._step_um) for k in (0, 1)]

    def snapshot(self) -> dict[str, Any]:
        """Return what changes, fit for JSON."""
        return {
            "places": [place.setpoint for place in self._places], "extra": list(self._extra),
            "directions": {str(k): table.direction for k, table in self._elcam.tables.items()},
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue where `snapshot` was taken, with the same tables."""
        for place, mm in zip(self._places, state["places"], strict=True):
            place.setpoint = place.actual = mm
        self._extra = list(state["extra"])
        for k, direction in state["directions"].items():
            self._elcam.tables[int(k)].go_on(direction, self._elcam.axes[self._elcam.tables[int(k)].master].setpoint)
