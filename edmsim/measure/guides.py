"""Where a machine's wire guides are, found from a test cut: a block whose walls lean to one side.

A guide that is higher or lower than the control knows moves a leaning wall, towards the part on one side of the block
and away from it on the other. What the gap takes is the same on both, and goes out.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers import from_text
from edmsim.cosim.simulation import Progress, Simulation
from edmsim.errors import EdmsimError, InputError
from edmsim.job.cut import guides_of
from edmsim.machine.machine import Machine
from edmsim.metrology.profile import ProfileError, profile_error, slice_heights_mm
from edmsim.program.outline import Outline, Program, Taper
from edmsim.program.path import plan_path

SIDE_MM = 3.0  # sides of the block (ours: most of each lies away from its corners)
CORNER_MM = 0.6  # so near to its corners a wall is not looked at (ours: what is cut twice there, or from the side)


class GuidesFound(NamedTuple):
    """What a test cut says of the guides."""

    # how much higher the guides are than the machine's file says
    lower_mm: float
    upper_mm: float
    uncertainty_mm: tuple[float, float]  # standard errors of these
    # (slices,): by how much the walls were moved the way they lean, slice by slice
    heights_mm: NDArray[np.float64]
    shift_um: NDArray[np.float64]


def block(angle_deg: float) -> Program:
    """Return the program of the block: its walls along y lean towards -x, those along x do not."""
    half = SIDE_MM / 2
    points = half * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)], np.float64)
    outline = Outline(
        points, (0,) * 4, True, "right", "left", np.empty((0, 2)), elements=(1, 2, 3, 4),
        taper=Taper((0.0, angle_deg, 0.0, -angle_deg), corners="sharp"),
    )
    return Program((outline,), (), "test block")


def measure_guides(
    machine: Machine, angle_deg: float = 10.0, errors_mm: tuple[float, float] = (0.0, 0.0), *, seed: int = 0,
    resolution: str = "fast", watch: Callable[[Progress], None] | None = None,
) -> GuidesFound:
    """Cut a block whose walls lean by an angle, and find from them where the guides are, less the errors known."""
    if not 1.0 <= angle_deg <= 30.0:
        raise InputError(f"a test block's walls cannot lean by {angle_deg:g} degrees: give 1 to 30")
    guides = guides_of(machine, errors_mm)
    travel_um = round(machine.base.table.travel_mm.value * 1e3)
    path = plan_path(
        block(angle_deg), auto_offset_mm=machine.auto_offset_mm, table_um=travel_um, guides=[guides],
        lead_in_mm=1.0 + machine.height_mm * math.tan(math.radians(angle_deg)),
    )
    cut = Simulation(machine, path, from_text("counts"), planner="exact", seed=seed, resolution=resolution)
    outcome = cut.run(watch)
    if outcome != "finished":
        raise EdmsimError(f"the test block was not cut to its end: {cut.reason or outcome}")
    assert guides is not None
    contour = path.contours[0]
    profile = profile_error(cut.plant.field, contour)
    shift_um = _shift_um(profile)
    heights_mm = slice_heights_mm(cut.plant.field, machine.height_mm)
    tangent = math.tan(math.radians(angle_deg))
    low_mm, high_mm = guides.bends_mm(np.array([[tangent, 0.0]]))[0].tolist()
    distance_mm = high_mm - low_mm
    share = shift_um * 1e-3 / (tangent * distance_mm)
    (rise, start), covariance = np.polyfit(heights_mm, share, 1, cov="unscaled")
    spread = float(np.std(share - (start + rise * heights_mm), ddof=2))
    steep = 1.0 / distance_mm + rise
    places = [(at + low_mm / distance_mm - start) / steep for at in (0.0, 1.0)]
    known = [np.array([place, 1.0]) for place in places]
    errors = [spread * math.sqrt(float(row @ covariance @ row)) / steep for row in known]
    return GuidesFound(
        errors_mm[0] + places[0] - low_mm, errors_mm[1] + places[1] - high_mm, (errors[0], errors[1]), heights_mm,
        shift_um,
    )


def _shift_um(profile: ProfileError) -> NDArray[np.float64]:
    """Return by how much the leaning walls lie further towards -x than they should, slice by slice."""
    middle = (profile.points_mm.min(axis=0) + profile.points_mm.max(axis=0)) / 2
    x, y = (profile.points_mm - middle).T
    counted = (np.abs(y) < SIDE_MM / 2 - CORNER_MM) & ~profile.at_lead_in
    left, right = (np.nanmedian(profile.error_um[:, counted & side], axis=1) for side in (x < 0, x > 0))
    return np.asarray((left - right) / 2)
