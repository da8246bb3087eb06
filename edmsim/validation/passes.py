"""Rows on programs: up to seven passes against a shop's table, their corners, accuracy and bow; tapered walls."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from edmsim.closed_loop.passes import PassRecord
from edmsim.closed_loop.simulation import Simulation
from edmsim.controllers import make
from edmsim.evaluation.technology_search import Job, cut_in_passes, cut_pass
from edmsim.geometry import Floats
from edmsim.job.plan import guides_of
from edmsim.machine.machine import Machine
from edmsim.machine.overrides import with_overrides
from edmsim.machine.technology import Technology, technology_for
from edmsim.metrology import error_budget, profile, roughness
from edmsim.program.outline import Outline, Program, Taper
from edmsim.program.path import plan_path
from edmsim.validation.rows import Checks, Row, Seeds, differences, worst

SHOP = "a job shop's table for 1 to 7 passes, brass 0.254 mm, steel, 25.4 mm high (second hand)"
TALL = "one cut of the same shop, 76.2 mm high (second hand)"
TRADE = "accuracy by number of passes: trade page, weak"
TARGET = "asked of the model, no publication; offsets and feeds of a job shop's table"
BOW = "a wire between guides under an even lateral load: bow q h^2 / (8 T) (derived)"
FOUND = "its technology was searched to match this figure: edmsim tune technology"
PAGE = "docs/theory/passes.md"

OFFSETS_MM = (
    (0.1727,), (0.2057, 0.1397), (0.2515, 0.1854, 0.1397), (0.2692, 0.2032, 0.1575, 0.1397),
    (0.2769, 0.2108, 0.1651, 0.1473, 0.1321), (0.2781, 0.2121, 0.1664, 0.1486, 0.1334, 0.1308),
    (0.2794, 0.2134, 0.1676, 0.1499, 0.1346, 0.1321, 0.1308),
)  # fmt: skip
FEEDS_MM_MIN = (3.05, 4.57, 4.06, 3.81, 4.57, 4.06, 3.56)
RA_UM = (1.52, 1.17, 1.07, 0.97, 0.30, 0.23, 0.18)
HEIGHT_MM, TALL_MM = 25.4, 76.2
LENGTH_MM = 1.4  # length of the straight cut through all passes (ours: 12 places are measured)
BOW_STEP_MM = 0.055
"""Difference of the offsets of the rough pass and the trim whose bow is measured (ours: it removes some 40 um)."""
CORNER_MM, END_MM = 2.0, 0.4
"""Length of both sides of the corner's edge, and of their far ends, which are left out because the cut begins or ends
there (ours: two cut-offs of roughness remain)."""
CUTOFF_MM = 0.8  # shorter wavelengths are roughness, not errors of size or form: ISO 21920-3, Ra of 0.1 to 2 um
CORNERS = 4  # seeds of these cuts (ours: their results differ by some 0.1 um)
ACCURACY_UM = {1: (15.0, 25.0), 2: (8.0, 12.0), 3: (3.0, 5.0), 4: (2.0, 3.0)}


class Chain(NamedTuple):
    """Results of a straight cut through all passes: their records, and Ra after each."""

    records: list[PassRecord]
    ra_um: list[float]

    def last_offset_um(self, number: int) -> float:
        """Return the offset with which a pass would have produced the drawn size."""
        wall = self.records[number - 1].wall
        return math.nan if wall is None else self.records[number - 1].offset_um - wall.mean_um


def chain(height_mm: float, passes: int, seed: int, resolution: str = "default") -> Chain:
    """Cut a straight edge through all passes of our technology, whose offsets were measured at `default`."""
    simulation = cut_in_passes(
        technology_for("tool-steel"), height_mm, passes, LENGTH_MM, seed=seed, resolution=resolution
    )
    records = simulation.passes.records
    volumes = [r.sums.crater_um3 / max(r.sums.spark + r.sums.arc, 1) for r in records]
    left = [math.nan if r.wall is None else r.wall.mean_um for r in records]
    taken = [0.0, *(-np.diff(left)).tolist()]
    flatness = simulation.machine.base.discharge.crater_flatness.value
    return Chain(records, roughness.face_roughness_um(volumes, taken, flatness))


def by_passes(seeds: Seeds) -> list[Row]:
    """Compare one to seven passes on 25.4 mm with the shop's table; one seed, because fine passes take minutes."""
    found = chain(HEIGHT_MM, 7, seeds[0])
    ends = [found.last_offset_um(number) for number in range(1, 8)]
    rows = []
    for passes, shop in enumerate(OFFSETS_MM, 1):
        steps = [found.records[k].offset_um - found.records[passes - 1].offset_um for k in range(passes)]
        ours = [ends[passes - 1] + step for step in steps]
        published, simulated, name = worst(
            [(mm * 1e3, um, f"pass {k}") for k, (mm, um) in enumerate(zip(shop, ours, strict=True), 1)]
        )
        rows.append(Row.value(
            "passes", f"offsets of {passes} in all, 25.4 mm (the one furthest off: {name})", SHOP,
            published=published, simulated=simulated, within=0.15, unit="um",
        ))  # fmt: skip
    for number, (feed, ra_um) in enumerate(zip(FEEDS_MM_MIN, RA_UM, strict=True), 1):
        rows.append(Row.value(
            "passes", f"feed of pass {number}, 25.4 mm", SHOP, published=feed,
            simulated=found.records[number - 1].feed_mm_min, within=0.3, unit="mm/min",
            note=PAGE + "#feeds-of-fine-passes",
        ))  # fmt: skip
        rows.append(Row.value(
            "passes", f"Ra after pass {number}, 25.4 mm", SHOP, published=ra_um,
            simulated=found.ra_um[number - 1], within=0.3, unit="um",
        ).calibration(FOUND))  # fmt: skip
    return rows


def tall(seeds: Seeds) -> list[Row]:
    """Compare a single pass on 76.2 mm with the shop's."""
    cuts = [chain(TALL_MM, 1, seed) for seed in seeds]
    return [
        Row.value("passes", "offset of one pass, 76.2 mm", TALL, published=183.0, within=0.15, unit="um",
                  simulated=[cut.last_offset_um(1) for cut in cuts]),
        Row.value("passes", "feed of one pass, 76.2 mm", TALL, published=0.89, within=0.3, unit="mm/min",
                  simulated=[cut.records[0].feed_mm_min for cut in cuts], note=PAGE + "#one-pass-of-a-tall-part"),
        Row.value("passes", "Ra of one pass, 76.2 mm", TALL, published=1.65, within=0.3, unit="um",
                  simulated=[cut.ra_um[0] for cut in cuts]).calibration(FOUND),
    ]  # fmt: skip


class Corner(NamedTuple):
    """Errors of an outer 90 degree corner and of its sides against the drawing, in um."""

    corner_um: float
    p95_um: float  # errors of the sides without roughness


def cut_corner(
    technology: Technology, passes: int, seed: int, side_mm: float,
    watch: Callable[[Simulation], None] = lambda _: None,
) -> Corner:
    """Cut an outer corner in passes, at the resolution at which the technology's offsets were measured."""
    edge = np.array([[0.0, 0.0], [side_mm, 0.0], [side_mm, -side_mm]])
    simulation = cut_in_passes(
        technology, HEIGHT_MM, passes, side_mm, seed=seed, resolution="default", edge_mm=edge, watch=watch
    )
    contour = simulation.path.contours[0]
    measured = profile.profile_error(simulation.plant.field, contour)
    ends = np.minimum(measured.s_mm, measured.s_mm[-1] - measured.s_mm) < END_MM
    error = np.where(ends, np.nan, measured.error_um - error_budget.unreachable_um(measured, contour))
    (found,) = profile.corners(contour, replace(measured, error_um=error))
    sides = [error[:, ~ends & side] for side in (measured.s_mm <= side_mm, measured.s_mm >= side_mm)]
    return Corner(found.error_um, profile.error_stats(np.hstack([without_roughness(side) for side in sides]))["p95"])


def without_roughness(error_um: Floats) -> Floats:
    """Return profiles (slices, n) with spacing `PROFILE_STEP_MM` without roughness, as a shop measures sizes."""
    # Gaussian filter of ISO 16610-21: it halves the amplitude at the cut-off's wavelength
    deviation = CUTOFF_MM * math.sqrt(math.log(2) / 2) / math.pi
    return np.asarray(gaussian_filter1d(error_um, deviation / profile.PROFILE_STEP_MM, axis=1, mode="reflect"))


def accuracy(seeds: Seeds) -> list[Row]:
    """Compare the accuracy by number of passes, and a corner's error after trims."""
    ours = technology_for("tool-steel")
    cuts = {n: [cut_corner(ours, n, seed, CORNER_MM) for seed in seeds[:CORNERS]] for n in ACCURACY_UM}
    rough, trimmed = (float(np.mean([abs(cut.corner_um) for cut in cuts[passes]])) for passes in (1, 3))
    return [
        *(
            Row.band("passes", f"accuracy of {passes} in all, 95 % of an edge without its roughness", TRADE, low=low,
                     high=high, simulated=[cut.p95_um for cut in cuts[passes]], unit="um", note=PAGE + "#accuracy")
            for passes, (low, high) in ACCURACY_UM.items()
        ),
        Row.band("passes", "error of an outer corner after three passes, over that after one", TARGET, low=0.0,
                 high=1 / 3, published="below a third (asked for)", simulated=trimmed / rough,
                 note=PAGE + "#outer-corners"),
    ]


def bow(seeds: Seeds) -> list[Row]:
    """Compare the bow after a trim over tension and energy of its pulses, on 25.4 mm."""
    at = technology_for("tool-steel").heights[0]
    job, offset_mm = Job("tool-steel", height_mm=at.height_mm, resolution="fast"), 0.3
    rough, trim = at.passes[0], at.passes[2]
    current_A, tension_N = trim.peak_current_A, trim.tension_N
    assert current_A is not None
    assert tension_N is not None
    changes = {
        "usual": {}, "slack": {"tension_N": tension_N / 2},
        "weak": {"peak_current_A": current_A / 4, "t_period_us": trim.t_period_us / 4},
    }  # fmt: skip
    bows: dict[str, list[float]] = {name: [] for name in changes}
    for seed in seeds[:3]:
        own = replace(job, seed=seed)
        metal = cut_pass(own, rough, 1, offset_mm, None).metal
        for name, change in changes.items():
            one = trim.model_copy(update=change)
            wall = cut_pass(own, one, 3, offset_mm - BOW_STEP_MM, metal).record.wall
            bows[name].append(math.nan if wall is None else wall.bow_um)
    return [
        Row.sign("passes", "bow of a trim at half the tension", BOW, rises=True, unit="um",
                 simulated=differences(bows["usual"], bows["slack"]), note=PAGE + "#bow"),
        Row.report("passes", "bow of a trim with a quarter of the energy per pulse, at equal power, less that bow",
                   "no sign is published; four times the discharges with half the push each push more",
                   simulated=differences(bows["usual"], bows["weak"]), unit="um"),
        Row.report("passes", "bow after a trim, 25.4 mm (above 0: convex)", "no table of straightness found",
                   simulated=bows["usual"], unit="um"),
    ]


# --- tapered walls: the ellipse of a tilted wire in a horizontal plane, and errors in the guides' heights ---

# A straight wall of 1.5 mm is cut, and measured in the lowest and the highest slice. The results include the rounding
# of the path to whole um and motor steps of 2 um; the error of a vertical wall at the same offset is subtracted.

ELLIPSE = "geometry: across the slope a wire that leans by a keeps (r + gap) / cos a in a horizontal plane"
PLAIN = "geometry: the offset r + gap leaves (r + gap) (1 / cos a - 1) too little"
GUIDE = "geometry: a lower guide e too high moves the wall by e tan a at its own height, by 0 at the upper guide"
WALL_HEIGHT_MM, WALL_MM = 10.0, 1.5
GUIDE_ERROR_MM = 0.1
SHORTEST_MM = 0.4  # distance from the ends of the wall within which nothing is measured


def _wall(angle_deg: float) -> Program:
    """Return a wall along x that is tilted towards the part, cut from a hole before it."""
    points = np.array([[0.0, 0.0], [WALL_MM, 0.0]])
    start_y_mm = -0.17 - max(0.0, -WALL_HEIGHT_MM * math.tan(math.radians(angle_deg)))
    outline = Outline(
        points, (0,), False, "right", "left", np.array([[-0.6, start_y_mm]]), (0,), 1, needs_lead_in=False,
        elements=(1,), taper=Taper((angle_deg,), corners="sharp"),
    )  # fmt: skip
    return Program((outline,), (), "wall")


def wall_errors_um(
    angle_deg: float, seed: int, *, offset_mm: float | None = None, guide_error_mm: float = 0.0
) -> Floats:
    """Cut a wall and return its profile error, slice by slice: positive is metal left."""
    machine = with_overrides(Machine.load(height_mm=WALL_HEIGHT_MM), (("guides.lower_error_mm", guide_error_mm),))
    path = plan_path(
        _wall(angle_deg), "auto" if offset_mm is None else offset_mm, auto_offset_mm=machine.auto_offset_mm,
        start_hole_radius_mm=0.15, guides=[guides_of(machine, (0.0, 0.0))],
    )  # fmt: skip
    cut = Simulation(machine, path, make("counts"), planner="exact", seed=seed, resolution="fast")
    cut.run()
    found = profile.profile_error(cut.plant.field, path.contours[0])
    inner = (found.s_mm > SHORTEST_MM) & (found.s_mm < WALL_MM - SHORTEST_MM)
    return np.asarray(np.nanmean(found.error_um[:, inner], axis=1))


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
    full_mm, cosine = Machine.load(height_mm=WALL_HEIGHT_MM).auto_offset_mm, math.cos(math.radians(15.0))

    ellipse, plain = (
        [wall_errors_um(15.0, seed, offset_mm=mm) for seed in seeds] for mm in (full_mm, full_mm * cosine)
    )
    return [Row.value(
        "taper", "15 degrees, undersize with the plain offset", PLAIN, published=1e3 * full_mm * (1 / cosine - 1),
        simulated=np.mean(np.subtract(ellipse, plain), axis=1), within=0.2, unit="um",
    )]  # fmt: skip


def check_guide(seeds: Seeds) -> list[Row]:
    """Compare the error in the lowest slice of a wall tilted by 15 degrees if the lower guide is 0.1 mm too high."""
    machine = Machine.load(height_mm=WALL_HEIGHT_MM)
    guides, tangent = guides_of(machine, (0.0, 0.0)), math.tan(math.radians(15.0))
    assert guides is not None
    low_mm, high_mm = guides.bends_mm(np.array([[0.0, tangent]]))[0].tolist()
    right, wrong = (
        np.array([wall_errors_um(15.0, seed, guide_error_mm=mm)[0] for seed in seeds]) for mm in (0.0, GUIDE_ERROR_MM)
    )
    z_mm = 0.5 * WALL_HEIGHT_MM / 5  # five slices
    share = (high_mm - z_mm) / (high_mm - low_mm - GUIDE_ERROR_MM)
    return [Row.value(
        "taper", "15 degrees, the lower guide 0.1 mm too high", GUIDE, within=0.1, unit="um",
        simulated=np.abs(wrong - right), published=1e3 * tangent * GUIDE_ERROR_MM * share,
    )]  # fmt: skip


CHECKS: Checks = {
    **dict.fromkeys((by_passes, tall, accuracy, bow), ("passes",)),
    **dict.fromkeys((check_faces, check_plain_offset, check_guide), ("taper",)),
}
