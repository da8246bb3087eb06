"""What the table's errors do to a part: how far its wall is displaced by them, with and without compensation."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.axis.elcam import Elcam
from edmsim.controllers.axis.step_compensation import StepCompensation
from edmsim.geometry import Polyline, left_of
from edmsim.machine.machine import Machine
from edmsim.metrology.profile import ProfileError
from edmsim.plant.axes.still_table import StillTable
from edmsim.program.path import WireContour

Floats = NDArray[np.float64]
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
    machine: Machine, contour: WireContour, profile: ProfileError, elcam: Elcam | None
) -> TableError:
    """Return what the table contributes to a profile error, by its errors where the wire passes.

    The table is taken as it comes to rest there, backlash left out.
    """
    line = Polyline(contour.nominal_mm, contour.closed)
    towards_left = left_of(line.tangent(profile.s_mm, _NEAR_MM))
    away = -towards_left if contour.part_side == "left" else towards_left
    points_um = profile.points_mm * 1e3
    return TableError(
        (_displaced_um(machine, points_um, None) * away).sum(axis=1),
        (_displaced_um(machine, points_um, elcam) * away).sum(axis=1),
    )


def _displaced_um(machine: Machine, points_um: Floats, elcam: Elcam | None) -> Floats:
    """Return by how much the wire truly is off places (n, 2) of the program."""
    table, step_um = StillTable(machine, nuts=False), machine.base.table.step_um.value
    compensation = None if elcam is None else StepCompensation(copy.deepcopy(elcam), step_um)  # it may be at work
    found = []
    for x, y in points_um.tolist():
        motors = (x, y) if compensation is None else compensation.begin((x, y))
        found.append(table.move(motors))
    return np.array(found).reshape(-1, 2) - points_um


class MotorOffsets(NamedTuple):
    """What the motors' places are off others, in um, (n, 2): the program's, by the compensation, and the wire's."""

    program: Floats
    table: Floats


def motor_offsets_um(machine: Machine, motors_um: Floats, elcam: Elcam | None) -> MotorOffsets:
    """Return by how much motors at some places (n, 2) stand off the program and off where the table truly is.

    The compensation is that of the motors' places, which differ from the program's by itself only.
    """
    table = StillTable(machine, nuts=False)
    places, which = np.unique(motors_um, axis=0, return_inverse=True)
    program, astray = np.zeros_like(places), np.zeros_like(places)
    compensation = None
    if elcam is not None:
        compensation = StepCompensation(copy.deepcopy(elcam), machine.base.table.step_um.value)
    for k, (x, y) in enumerate(places.tolist()):
        if compensation is not None:
            compensation.begin((x, y))
            program[k] = compensation.offset_um
        astray[k] = places[k] - table.move((x, y))
    return MotorOffsets(program[which.reshape(-1)], astray[which.reshape(-1)])
