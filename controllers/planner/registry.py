"""Planners by name: the ways from a path and a speed to the steps of two motors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.mcu.firmware.poscal import Unit
from edmsim.controllers.mcu.firmware.timers import SPEED_UNIT_NM_S
from edmsim.controllers.planner.dda import DdaPlanner
from edmsim.controllers.planner.literal import LiteralPlanner
from edmsim.controllers.planner.poscal import PoscalPlanner
from edmsim.controllers.planner.protocol import Planner
from edmsim.controllers.planner.sine_table import SineTablePlanner
from edmsim.errors import InputError

__all__ = ["PLANNERS", "Planner", "make_planner"]

PLANNERS: dict[str, type[PoscalPlanner] | type[LiteralPlanner] | type[DdaPlanner]] = {
    "poscal": PoscalPlanner,
    "poscal-literal": LiteralPlanner,
    "dda": DdaPlanner,
    "sine-table": SineTablePlanner,
}
"""Every planner by its name; the first is the default."""


def make_planner(
    name: str, points_um: NDArray[np.int64], speed_unit_nm_s: float = SPEED_UNIT_NM_S, unit: Unit = "um"
) -> Planner:
    """Make a planner for one path.

    Parameters
    ----------
    name : str
        ``poscal`` (POSCAL re-aimed at every step, the default), ``poscal-literal`` (once per move, as in
        1982), ``dda`` (an ideal line) or ``sine-table`` (``poscal`` with a table in place of the square root).
    points_um : int array (n, 2)
        Corner points of the path, 0..65535 um.
    speed_unit_nm_s : float
        Speed unit in nm/s: 262.5, or 252.6 as the thesis prints it (row T-A1).
    unit : {"um", "step"}
        What the position counters count: ``step`` takes points at whole steps, 0..131070 um (row T-61).

    Raises
    ------
    InputError
        If there is no planner of that name, or the path cannot be used.
    """
    if name not in PLANNERS:
        raise InputError(f"there is no planner {name!r}; choose one of {', '.join(PLANNERS)}")
    return PLANNERS[name](points_um, speed_unit_nm_s, unit)
