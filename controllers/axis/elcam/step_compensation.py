"""Error tables and cams of ELCAM in a cut: steps between a planner and the motors.

Steps are added or left out to compensate errors and move followers. A stepping motor reports no position to correct,
so the error is added to its setpoint ("G3-ElCam Interface", chapter 2.2.1), in whole steps. An axis of the upper
guide that follows a cam has only these steps.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.axis.elcam.file import NAMES, PATH, PLACES
from edmsim.controllers.axis.elcam.module import CamPlace, Elcam
from edmsim.controllers.axis.elcam.table import CamTable
from edmsim.controllers.protocols import Step
from edmsim.errors import InputError

_AXES = range(len(NAMES))
_PATH = PLACES.index(PATH)


class StepCompensation:
    """Offset between a planner's steps and the motors: tables of `load_tables` move these by `offset_um`."""

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
        """Positions of the u and v motors."""
        return self._extra[2] * self._step_um, self._extra[3] * self._step_um

    def begin(
        self, position_um: tuple[float, float], path_um: float = 0.0, lead_um: tuple[float, float] = (0.0, 0.0)
    ) -> tuple[float, float]:
        """Set the program's position and length of path, without steps; return the resulting position of x and y."""
        for k, um in enumerate((*position_um, *lead_um, path_um)):
            self._put(k, um * 1e-3)
        self._extra = self._steps_due()
        return position_um[0] + self.offset_um[0], position_um[1] + self.offset_um[1]

    def motor_steps(self, steps: Sequence[Step], path_um: float = 0.0, of: int | None = None) -> list[Step]:
        """Return the motors' steps for steps of the program, the first of `of` steps up to a length of path."""
        made: list[Step] = []
        path_mm, end_mm, planned = self._places[_PATH].setpoint, path_um * 1e-3, of or len(steps)
        for number, (time_ns, axis, direction) in enumerate(steps, 1):
            self._put(axis, self._places[axis].setpoint + direction * self._step_um * 1e-3)
            self._put(_PATH, path_mm + (end_mm - path_mm) * number / planned)
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
        """Return the steps in addition to the program's; followers are first, because errors may depend on them."""
        cams = self._elcam.follow()
        for k, place_mm in cams.items():
            self._put(k, place_mm)
        return [round((cams.get(k, 0.0) + self._elcam.compensation(k)) * 1e3 / self._step_um) for k in _AXES]

    def snapshot(self) -> dict[str, Any]:
        """Return the state as types of JSON."""
        return {
            "places": [place.setpoint for place in self._places], "extra": list(self._extra),
            "directions": {str(k): table.direction for k, table in self._elcam.tables.items()},
            "held": [k for k, table in self._elcam.tables.items() if table.held],
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore the state of a `snapshot`, with the same tables."""
        for k, place_mm in enumerate(state["places"]):
            self._put(k, place_mm)
        self._extra = list(state["extra"])
        for k, direction in state["directions"].items():
            table = self._elcam.tables[int(k)]
            table.direction, table.last_master = direction, self._elcam.axes[table.master].setpoint
            table.held = int(k) in state["held"]


_STEEPEST_WIRE = 0.1
"""Greatest lead of the upper guide as a share of the guides' distance (ours): the slices of the gap are computed as
upright, which is valid for small angles."""
_PLACES = 1000  # positions of its master at which a cam is evaluated, in addition to its points (ours)


def check_cams(elcam: Elcam, contours_um: Sequence[NDArray[np.int64]], guide_distance_mm: float) -> None:
    """Raise `InputError` if a cam moves the upper guide too far on a contour, with its axis, lead and limit."""
    points_mm = np.concatenate(contours_um) * 1e-3
    length_mm = sum(float(np.hypot(*np.diff(points, axis=0).T).sum()) for points in contours_um) * 1e-3
    ranges = {0: points_mm[:, 0], 1: points_mm[:, 1], len(PLACES) - 1: np.array([0.0, length_mm])}
    most_mm = _STEEPEST_WIRE * guide_distance_mm
    for table in elcam.tables.values():
        if not table.leads:
            continue
        places = ranges[table.master]
        place_mm, lead_mm = _furthest(table, float(places.min()), float(places.max()))
        if lead_mm > most_mm:
            raise InputError(
                f"the cam of {NAMES[table.axis]} leads the upper guide {lead_mm:.3f} mm away from the lower one, at "
                f"{PLACES[table.master]} {place_mm:.3f} mm; between guides {guide_distance_mm:g} mm apart it may be "
                f"{most_mm:.3f} mm"
            )


def _furthest(table: CamTable, low_mm: float, high_mm: float) -> tuple[float, float]:
    """Return the position in the master's range at which the follower is furthest from 0, and its distance (mm)."""
    own = table.points[: table.size_master, 0]
    period = own[-1] - own[0]
    first, last = (np.floor((end - own[0]) / period) for end in (low_mm, high_mm))
    passes = np.unique([first, first + 1, last - 1, last])
    corners = (own[None, :] + passes[:, None] * period).ravel()
    corners = corners[(corners > low_mm) & (corners < high_mm)]
    places = np.concatenate([corners, np.linspace(low_mm, high_mm, _PLACES)])
    lead = np.abs([table.follow(place, 0.0) for place in places.tolist()])
    k = int(np.argmax(lead))
    return float(places[k]), float(lead[k])
