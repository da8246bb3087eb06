"""What the table's errors do to a part: how far its wall is displaced by them, with and without compensation."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.controllers.axis.elcam import Elcam
from edmsim.controllers.axis.elcam_file import PATH, PLACES
from edmsim.controllers.axis.step_compensation import StepCompensation
from edmsim.geometry import Polyline, left_of
from edmsim.machine.machine import Machine
from edmsim.metrology.profile import ProfileError
from edmsim.plant.axes.still_table import StillTable
from edmsim.program.path import WireContour

Floats = NDArray[np.float64]
_PATH = PLACES.index(PATH)
_NEAR_MM = 1e-3
"""The tangent at a point is that between places so far to its sides (ours)."""


@dataclass(frozen=True)
class TableError:
    """Displacement of a part's wall by the table at the points of a `ProfileError`, positive where metal is left.

    Attributes
    ----------
    without_um : array (n,)
        With the table alone.
    left_um : array (n,)
        With the compensation that was in force; the same if there was none.
    """

    without_um: Floats
    left_um: Floats


def table_error(
    machine: Machine, contour: WireContour, profile: ProfileError, elcam: Elcam | None, start_um: float = 0.0
) -> TableError:
    """Return what the table contributes to a profile error, by its errors where the wire passes.

    The table is taken as it comes to rest there, backlash left out. Before the contour lie `start_um` of path.
    """
    line = Polyline(contour.nominal_mm, contour.closed)
    towards_left = left_of(line.tangent(profile.s_mm, _NEAR_MM))
    away = -towards_left if contour.part_side == "left" else towards_left
    points_um = profile.points_mm * 1e3
    way = shapely.LineString(contour.points_um)
    path_um = start_um + shapely.line_locate_point(way, shapely.points(points_um))  # where the wire passes nearest
    return TableError(
        (_displaced_um(machine, points_um, path_um, None) * away).sum(axis=1),
        (_displaced_um(machine, points_um, path_um, elcam) * away).sum(axis=1),
    )


def _displaced_um(machine: Machine, points_um: Floats, path_um: Floats, elcam: Elcam | None) -> Floats:
    """Return by how much the wire truly is off places (n, 2) of the program, with lengths of path (n,)."""
    table, step_um = StillTable(machine, nuts=False), machine.base.table.step_um.value
    compensation = None if elcam is None else StepCompensation(copy.deepcopy(elcam), step_um)  # it may be at work
    found = []
    for (x, y), path in zip(points_um.tolist(), path_um.tolist(), strict=True):
        motors = (x, y) if compensation is None else compensation.begin((x, y), path)
        found.append(table.move(motors))
    return np.array(found).reshape(-1, 2) - points_um


class MotorOffsets(NamedTuple):
    """What the motors' places are off others, in um, (n, 2): the program's, by the compensation, and the wire's."""

    program: Floats
    table: Floats


def motor_offsets_um(machine: Machine, motors_um: Floats, path_um: Floats, elcam: Elcam | None) -> MotorOffsets:
    """Return by how much motors at some places (n, 2) are off the program and off where the table truly is.

    The compensation is that of the motors' places, which differ from the program's by itself only, and of the lengths
    of path (n,) at which they were there.
    """
    table = StillTable(machine, nuts=False)
    by_path = elcam is not None and any(_PATH in (one.master, one.row_axis) for one in elcam.tables.values())
    seen = np.column_stack([motors_um, path_um if by_path else np.zeros(len(motors_um))])
    places, which = np.unique(seen, axis=0, return_inverse=True)
    program, astray = np.zeros((len(places), 2)), np.zeros((len(places), 2))
    compensation = None
    if elcam is not None:
        compensation = StepCompensation(copy.deepcopy(elcam), machine.base.table.step_um.value)
    for k, (x, y, path) in enumerate(places.tolist()):
        if compensation is not None:
            compensation.begin((x, y), path)
            program[k] = compensation.offset_um
        astray[k] = places[k, :2] - table.move((x, y))
    return MotorOffsets(program[which.reshape(-1)], astray[which.reshape(-1)])
