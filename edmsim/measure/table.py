"""Measuring a machine's table as with a laser interferometer, and the compensation tables that follow from it.

>>> from edmsim.machine.machine import Machine
>>> found = measure_table(Machine.load("worn-table"), seed=1)
>>> f"{found.squareness_um_m:.0f} um/m"
'400 um/m'
>>> left = measure_table(Machine.load("worn-table"), seed=2, compensation=load_tables(found.tables()))
>>> round(found.along["x", "x"].figures()["accuracy"]), round(left.along["x", "x"].figures()["accuracy"])
(21, 3)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.axis.drive import data_of
from edmsim.controllers.axis.elcam.file import ErrorTable, load_tables
from edmsim.controllers.axis.elcam.step_compensation import StepCompensation
from edmsim.errors import InputError
from edmsim.measure.iso_230 import CircularTest, Positioning
from edmsim.plant.axes.still_table import StillTable

if TYPE_CHECKING:
    from edmsim.controllers.axis.elcam.module import Elcam
    from edmsim.machine.machine import Machine

__all__ = ["TableMeasurement", "load_tables", "measure_table"]

_INTERFEROMETER = data_of("interferometer")
_BEYOND_MM = 1.0  # how far the first and the last point of a compensation table lie outside the travel (ours)
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class TableMeasurement:
    """Measurements of a table.

    Attributes
    ----------
    travel_mm : float
    along : dict of (str, str) to Positioning
        By the axis of the deviation and the axis that moved: positioning if they are equal, otherwise
        straightness and squareness.
    circle : CircularTest
    """

    travel_mm: float
    along: dict[tuple[str, str], Positioning]
    circle: CircularTest

    @property
    def squareness_um_m(self) -> float:
        """Angle between the ways of x and y beyond 90 degrees, in um per m (urad)."""
        across = [found for (axis, master), found in self.along.items() if axis != master]
        slopes = [np.polyfit(found.targets_mm, found.mean_um, 1)[0] for found in across]
        return float(-1e3 * sum(slopes))

    def tables(self, cubic: bool = False) -> list[ErrorTable]:
        """Return the compensation tables: the negative deviations, constant beyond the ends.

        Parameters
        ----------
        cubic : bool
            Interpolate with cubics.
        """
        made = []
        for (axis, master), found in self.along.items():
            x = np.concatenate([[-_BEYOND_MM], found.targets_mm, [self.travel_mm + _BEYOND_MM]])
            error = np.pad(-found.mean_um, 1, mode="edge")
            reversal = -float(found.reversal_um.mean())
            if axis != master or abs(reversal) < _INTERFEROMETER["reading"]["noise_um"]:
                reversal = 0.0
            made.append(ErrorTable(axis, master, np.column_stack([x, error]), reversal, cubic))
        return made


class _Bench:
    """The table with an interferometer on it, and a compensation, if there is one."""

    def __init__(self, machine: Machine, compensation: Elcam | None, rng: np.random.Generator) -> None:
        self._table, self._rng = StillTable(machine), rng
        self._step_um = machine.base.table.step_um.value
        self._compensation = None if compensation is None else StepCompensation(compensation, self._step_um)
        self.centre_um = machine.base.table.centre_um

    def deviation_um(self, x_um: float, y_um: float) -> Floats:
        """Move to a place, and return by how much the readings of both axes are off it."""
        motors = (x_um, y_um) if self._compensation is None else self._compensation.begin((x_um, y_um))
        x, y = self._table.move(motors)
        noise = self._rng.normal(0.0, _INTERFEROMETER["reading"]["noise_um"], 2)
        return np.array((x - x_um, y - y_um)) + noise

    def whole_steps(self, um: float) -> float:
        """Return the place of the nearest motor step."""
        return round(um / self._step_um) * self._step_um


def measure_table(
    machine: Machine, *, interval_mm: float | None = None, runs: int | None = None, seed: int = 0,
    compensation: Elcam | None = None,
) -> TableMeasurement:
    """Measure a machine's table at rest, each axis through the middle, and round a circle.

    Parameters
    ----------
    machine : Machine
    interval_mm : float, optional
        Between targets, 0.02 mm to a quarter of the travel; by default 0.5.
    runs : int, optional
        To every target from each side, 2 to 100; by default 5.
    seed : int
        Of the noise of the readings.
    compensation : Elcam, optional
        The control's compensation, from `edmsim.controllers.axis.elcam.file.load_tables`.

    Raises
    ------
    InputError
        If interval or number of runs is out of range.
    """
    data = _INTERFEROMETER["run"]
    travel_mm = machine.base.table.travel_mm.value
    interval_mm = data["interval_mm"] if interval_mm is None else interval_mm
    runs = data["runs"] if runs is None else runs
    if not 0.02 <= interval_mm <= travel_mm / 4:
        raise InputError(f"an interval of {interval_mm:g} mm is not within 0.02..{travel_mm / 4:g} mm")
    if not 2 <= runs <= 100:
        raise InputError(f"{runs} runs are not within 2..100: a spread needs two")
    bench = _Bench(machine, compensation, np.random.default_rng(seed))
    places = np.arange(interval_mm / 2, travel_mm, interval_mm)
    targets = np.array([bench.whole_steps(mm * 1e3) for mm in places])
    along = {}
    for k, master in enumerate(("x", "y")):
        up, down = _traverses(bench, k, targets, runs)
        for j, axis in enumerate(("x", "y")):
            along[axis, master] = Positioning(targets * 1e-3, up[:, :, j], down[:, :, j])
    radius_um = min(data["circle_mm"], travel_mm / 3) * 1e3
    angle = 2 * np.pi * np.arange(data["circle_places"]) / data["circle_places"]
    circle = np.column_stack([np.cos(angle), np.sin(angle)]) * radius_um
    return TableMeasurement(
        travel_mm, along, CircularTest(radius_um * 1e-3, _round(bench, circle), _round(bench, circle[::-1])[::-1])
    )


def _traverses(bench: _Bench, k: int, targets: Floats, runs: int) -> tuple[Floats, Floats]:
    """Go to and fro along an axis, (runs, targets, 2) deviations of both axes upwards and downwards."""
    passes = []
    beyond = 0.25 * (targets[1] - targets[0])  # beyond the ends, so that every target is come upon from one side
    for way in (targets, targets[::-1]) * runs:
        start = way[0] - np.sign(way[1] - way[0]) * beyond
        passes.append(np.array([bench.deviation_um(*_at(bench, k, float(um))) for um in (start, *way)])[1:])
    return np.array(passes[::2]), np.array(passes[1::2])[:, ::-1]


def _at(bench: _Bench, k: int, um: float) -> tuple[float, float]:
    x, y = bench.centre_um
    return (um, y) if k == 0 else (x, um)


def _round(bench: _Bench, circle: Sequence[Floats] | Floats) -> Floats:
    """Go round twice, and return the places of the second time from the programmed centre."""
    x0, y0 = bench.centre_um
    places = []
    for x, y in [*circle, *circle]:
        at = bench.whole_steps(x0 + float(x)), bench.whole_steps(y0 + float(y))
        places.append(np.array((float(at[0]) - x0, float(at[1]) - y0)) + bench.deviation_um(*at))
    return np.array(places[len(circle) :])
