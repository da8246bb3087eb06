"""Rows on tapered walls: the ellipse of a tilted wire in a horizontal plane, and errors in the guides' heights.

A straight wall of 1.5 mm is cut, and measured in the lowest and the highest slice. The results include the rounding
of the path to whole um and motor steps of 2 um; the error of a vertical wall at the same offset is subtracted.
"""

import math

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers import make
from edmsim.cosim.simulation import Simulation
from edmsim.job.plan import guides_of
from edmsim.machine.machine import Machine
from edmsim.machine.overrides import with_overrides
from edmsim.metrology.profile import profile_error
from edmsim.program.outline import Outline, Program, Taper
from edmsim.program.path import plan_path
from edmsim.validation.rows import Checks, Row, Seeds

ELLIPSE = "geometry: across the slope a wire that leans by a keeps (r + gap) / cos a in a horizontal plane"
PLAIN = "geometry: the offset r + gap leaves (r + gap) (1 / cos a - 1) too little"
GUIDE = "geometry: a lower guide e too high moves the wall by e tan a at its own height, by 0 at the upper guide"
HEIGHT_MM, LENGTH_MM = 10.0, 1.5
GUIDE_ERROR_MM = 0.1
SHORTEST_MM = 0.4  # distance from the ends of the wall within which nothing is measured


def _wall(angle_deg: float) -> Program:
    """A wall along x that is tilted towards the part, cut from a hole before it."""
    points = np.array([[0.0, 0.0], [LENGTH_MM, 0.0]])
    start_y_mm = -0.17 - max(0.0, -HEIGHT_MM * math.tan(math.radians(angle_deg)))
    outline = Outline(
        points, (0,), False, "right", "left", np.array([[-0.6, start_y_mm]]), (0,), 1, needs_lead_in=False,
        elements=(1,), taper=Taper((angle_deg,), corners="sharp"),
    )  # fmt: skip
    return Program((outline,), (), "wall")


def wall_errors_um(
    angle_deg: float, seed: int, *, offset_mm: float | None = None, guide_error_mm: float = 0.0
) -> NDArray[np.float64]:
    """Cut a wall and return its profile error, slice by slice: positive is metal left."""
    machine = with_overrides(Machine.load(height_mm=HEIGHT_MM), (("guides.lower_error_mm", guide_error_mm),))
    path = plan_path(
        _wall(angle_deg), "auto" if offset_mm is None else offset_mm, auto_offset_mm=machine.auto_offset_mm,
        start_hole_radius_mm=0.15, guides=[guides_of(machine, (0.0, 0.0))],
    )  # fmt: skip
    cut = Simulation(machine, path, make("counts"), planner="exact", seed=seed, resolution="fast")
    cut.run()
    profile = profile_error(cut.plant.field, path.contours[0])
    inner = (profile.s_mm > SHORTEST_MM) & (profile.s_mm < LENGTH_MM - SHORTEST_MM)
    return np.asarray(np.nanmean(profile.error_um[:, inner], axis=1))


def check_faces(seeds: Seeds) -> list[Row]:
    """Compare the lower and upper contours of tilted walls, with the offset by the ellipse."""
    rows = []
    for angle_deg in (3.0, 15.0):
        errors = np.array([wall_errors_um(angle_deg, seed) for seed in seeds])
        for name, of_face in (("lower", errors[:, 0]), ("upper", errors[:, -1])):
            rows.append(Row.band(
                "taper", f"{angle_deg:g} degrees, error of the {name} contour", ELLIPSE, low=-5.0, high=5.0,
                simulated=of_face, unit="um",
            ))  # fmt: skip
    return rows


def check_plain_offset(seeds: Seeds) -> list[Row]:
    """Compare the error of a wall tilted by 15 degrees if its offset is that of a vertical one."""
    full_mm, cosine = Machine.load(height_mm=HEIGHT_MM).auto_offset_mm, math.cos(math.radians(15.0))

    ellipse, plain = (
        [wall_errors_um(15.0, seed, offset_mm=mm) for seed in seeds] for mm in (full_mm, full_mm * cosine)
    )
    return [Row.value(
        "taper", "15 degrees, undersize with the plain offset", PLAIN, published=1e3 * full_mm * (1 / cosine - 1),
        simulated=np.mean(np.subtract(ellipse, plain), axis=1), within=0.2, unit="um",
    )]  # fmt: skip


def check_guide(seeds: Seeds) -> list[Row]:
    """Compare the error in the lowest slice of a wall tilted by 15 degrees if the lower guide is 0.1 mm too high."""
    machine = Machine.load(height_mm=HEIGHT_MM)
    guides, tangent = guides_of(machine, (0.0, 0.0)), math.tan(math.radians(15.0))
    assert guides is not None
    low_mm, high_mm = guides.bends_mm(np.array([[0.0, tangent]]))[0].tolist()
    right, wrong = (
        np.array([wall_errors_um(15.0, seed, guide_error_mm=mm)[0] for seed in seeds]) for mm in (0.0, GUIDE_ERROR_MM)
    )
    z_mm = 0.5 * HEIGHT_MM / 5  # five slices
    share = (high_mm - z_mm) / (high_mm - low_mm - GUIDE_ERROR_MM)
    return [Row.value(
        "taper", "15 degrees, the lower guide 0.1 mm too high", GUIDE, within=0.1, unit="um",
        simulated=np.abs(wrong - right), published=1e3 * tangent * GUIDE_ERROR_MM * share,
    )]  # fmt: skip


CHECKS: Checks = dict.fromkeys((check_faces, check_plain_offset, check_guide), ("taper",))
