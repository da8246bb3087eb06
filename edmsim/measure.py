"""Measurements of the machine: its table by ISO 230, its wire guides by a test cut.

>>> from edmsim.machine.machine import Machine
>>> found = measure_table(Machine.load("worn-table"), seed=1)
>>> f"{found.squareness_um_m:.0f} um/m"
'400 um/m'
>>> left = measure_table(Machine.load("worn-table"), seed=2, compensation=load_tables(found.tables()))
>>> round(found.along["x", "x"].figures()["accuracy"]), round(left.along["x", "x"].figures()["accuracy"])
(21, 3)
"""

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from edmsim import controllers, errors, numeric, screen
from edmsim.closed_loop.simulation import Progress, Simulation
from edmsim.controllers.axis.drive import data_of
from edmsim.controllers.axis.elcam.file import ErrorTable, load_tables
from edmsim.controllers.axis.elcam.module import Elcam
from edmsim.controllers.axis.elcam.step_compensation import StepCompensation
from edmsim.geometry import Floats, arc_lengths
from edmsim.job.plan import guides_of
from edmsim.machine.machine import Machine
from edmsim.metrology.profile import PROFILE_STEP_MM, ProfileError, profile_error, slice_heights_mm
from edmsim.plant.axes.geometric_errors import StillTable
from edmsim.program import outline, path
from edmsim.recording.figures.palette import BLUE, GRID, MUTED, VERMILION

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from edmsim.recording.scene import ErrorMap

__all__ = ["TableMeasurement", "load_tables", "measure_table"]


# A machine's table as ISO 230 evaluates it: positioning of an axis (230-2), and the circular test (230-4).
# Targets are approached from both sides, several times; a deviation is the true position of the axis less its target,
# and a compensation table has the opposite sign. The circular test measures how round and how large a circle is that
# two axes make together.

COVERAGE = 2.0  # standard deviations on either side of a mean in repeatability and accuracy (ISO 230-2)


@dataclass(frozen=True, eq=False)
class Positioning:
    """Deviations of an axis and the standard's figures, in um; targets in mm."""

    targets_mm: Floats  # (targets,)
    up_um: Floats  # (runs, targets): deviations at targets approached from below
    down_um: Floats  # deviations at targets approached from above

    def __post_init__(self) -> None:
        """Refuse arrays of unequal shapes, and fewer than two runs."""
        shape = self.up_um.shape
        if shape != self.down_um.shape or len(shape) != 2 or shape[1:] != self.targets_mm.shape or shape[0] < 2:
            reason = f"deviations need two runs or more to every target either way, not a shape of {shape}"
            raise errors.InputError(reason)

    @property
    def mean_up_um(self) -> Floats:
        """Mean deviation of every target approached from below."""
        return np.asarray(self.up_um.mean(axis=0))

    @property
    def mean_down_um(self) -> Floats:
        """Mean deviation of every target approached from above."""
        return np.asarray(self.down_um.mean(axis=0))

    @property
    def mean_um(self) -> Floats:
        """Bidirectional mean deviation of every target."""
        return 0.5 * (self.mean_up_um + self.mean_down_um)

    @property
    def reversal_um(self) -> Floats:
        """Reversal value of every target: mean from below less mean from above."""
        return self.mean_up_um - self.mean_down_um

    def figures(self) -> dict[str, float]:
        """Return the figures of the standard by name, in um.

        ``accuracy`` (A), ``systematic`` (E), ``mean_range`` (M), ``reversal`` (B, the greatest), ``mean_reversal``,
        ``repeatability`` (R, bidirectional), ``repeatability_up`` and ``_down``.
        """
        up, down = self.mean_up_um, self.mean_down_um
        spread_up, spread_down = (COVERAGE * runs.std(axis=0, ddof=1) for runs in (self.up_um, self.down_um))
        high = np.maximum(up + spread_up, down + spread_down)
        low = np.minimum(up - spread_up, down - spread_down)
        both = np.maximum(spread_up + spread_down + np.abs(self.reversal_um), 2 * np.maximum(spread_up, spread_down))
        return {
            "accuracy": float(high.max() - low.min()),
            "systematic": float(np.maximum(up, down).max() - np.minimum(up, down).min()),
            "mean_range": float(np.ptp(self.mean_um)),
            "reversal": float(np.abs(self.reversal_um).max()),
            "mean_reversal": float(self.reversal_um.mean()),
            "repeatability": float(both.max()),
            "repeatability_up": float(2 * spread_up.max()),
            "repeatability_down": float(2 * spread_down.max()),
        }


@dataclass(frozen=True, eq=False)
class CircularTest:
    """True positions of the table on a circle, in both directions."""

    radius_mm: float  # programmed
    # (n, 2), both: positions from the programmed centre, at equal steps of the angle from +x,
    # both in anticlockwise order
    anticlockwise_um: Floats
    clockwise_um: Floats

    @property
    def angle_rad(self) -> Floats:
        """Programmed angle of every position."""
        return np.asarray(2 * np.pi * np.arange(len(self.anticlockwise_um)) / len(self.anticlockwise_um))

    def deviation_um(self, clockwise: bool = False) -> Floats:
        """Return the radius of every position about the least-squares centre, less the programmed one, in um."""
        places = self.clockwise_um if clockwise else self.anticlockwise_um
        return np.asarray(np.hypot(*(places - _centre(places)).T) - self.radius_mm * 1e3)

    def figures(self) -> dict[str, float]:
        """Return the figures of the standard by name, in um.

        ``circular_deviation`` and ``circular_deviation_clockwise`` (G, about the least-squares centre),
        ``hysteresis`` (H, largest difference of the directions), ``radial_high`` and ``radial_low`` (F) of both.
        """
        first, second = self.deviation_um(), self.deviation_um(clockwise=True)
        centre = 0.5 * (_centre(self.anticlockwise_um) + _centre(self.clockwise_um))
        radii = [np.hypot(*(places - centre).T) for places in (self.anticlockwise_um, self.clockwise_um)]
        about_programmed = np.concatenate([
            np.hypot(*places.T) - self.radius_mm * 1e3 for places in (self.anticlockwise_um, self.clockwise_um)
        ])  # fmt: skip
        return {
            "circular_deviation": float(np.ptp(first)),
            "circular_deviation_clockwise": float(np.ptp(second)),
            "hysteresis": float(np.abs(radii[0] - radii[1]).max()),
            "radial_high": float(about_programmed.max()),
            "radial_low": float(about_programmed.min()),
        }


def _centre(places: Floats) -> Floats:
    """Return the centre of the least-squares circle through some positions, by two Gauss-Newton steps."""
    centre = places.mean(axis=0)
    for _ in range(2):
        away = places - centre
        radii = np.hypot(*away.T)
        normal = np.column_stack([away / radii[:, None], np.ones(len(places))])
        centre = centre + np.linalg.lstsq(normal, radii, rcond=None)[0][:2]
    return np.asarray(centre)


# Measuring a machine's table as with a laser interferometer, and the compensation tables that follow from it.


_INTERFEROMETER = data_of("interferometer")
_BEYOND_MM = 1.0  # distance of a compensation table's first and last point beyond the travel (ours)


@dataclass(frozen=True, eq=False)
class TableMeasurement:
    """Measurements of a table."""

    travel_mm: float
    # by the axis of the deviation and the axis that moved: positioning if they are equal, otherwise straightness and
    # squareness
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
    """The table with an interferometer, and with the control's compensation, if any."""

    def __init__(self, machine: Machine, compensation: Elcam | None, rng: np.random.Generator) -> None:
        self._table, self._rng = StillTable(machine), rng
        self._step_um = machine.base.table.step_um.value
        self._compensation = None if compensation is None else StepCompensation(compensation, self._step_um)
        self.centre_um = machine.base.table.centre_um

    def move(self, x_um: float, y_um: float) -> tuple[float, float]:
        """Move to a position, and return the true position of the table."""
        motors = (x_um, y_um) if self._compensation is None else self._compensation.begin((x_um, y_um))
        return self._table.move(motors)

    def deviation_um(self, x_um: float, y_um: float) -> Floats:
        """Move to a position, and return the readings of both axes less this position."""
        x, y = self.move(x_um, y_um)
        noise = self._rng.normal(0.0, _INTERFEROMETER["reading"]["noise_um"], 2)
        return np.array((x - x_um, y - y_um)) + noise

    def whole_steps(self, um: float) -> float:
        """Return the position of the nearest motor step."""
        return round(um / self._step_um) * self._step_um


@errors.refuses_wrong_types
def measure_table(
    machine: Machine, *, interval_mm: float | None = None, runs: int | None = None, seed: int = 0,
    compensation: Elcam | None = None,
) -> TableMeasurement:
    """Measure the positions of a machine's table at rest, along each axis through the middle, and on a circle.

    Parameters
    ----------
    machine : Machine
    interval_mm : float, optional
        Distance between targets, 0.02 mm to a quarter of the travel; by default 0.5.
    runs : int, optional
        Approaches of every target from each side, 2 to 100; by default 5.
    seed : int
        Seed of the noise of the readings.
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
        raise errors.InputError(f"an interval of {interval_mm:g} mm is not within 0.02..{travel_mm / 4:g} mm")
    if not 2 <= runs <= 100:
        raise errors.InputError(f"{runs} runs are not within 2..100: a spread needs two")
    bench = _Bench(machine, compensation, np.random.default_rng(numeric.whole_from("seed", seed, 0)))
    places = np.arange(interval_mm / 2, travel_mm, interval_mm)
    targets = np.array([bench.whole_steps(mm * 1e3) for mm in places])
    targets = targets[targets + _overrun_um(targets) <= travel_mm * 1e3]
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


def _overrun_um(targets: Floats) -> float:
    """Return how far a traverse begins before its first target, so that all are approached from one side."""
    return 0.25 * float(targets[1] - targets[0])


def _traverses(bench: _Bench, k: int, targets: Floats, runs: int) -> tuple[Floats, Floats]:
    """Move along an axis in both directions; return the deviations of both axes in each, (runs, targets, 2)."""
    passes = []
    for traverse in (targets, targets[::-1]) * runs:
        back = np.sign(traverse[1] - traverse[0]) * _overrun_um(targets)
        start = traverse[0] - back
        bench.move(*_at(bench, k, float(start), float(back)))  # the other axis is approached from both sides, too
        passes.append(np.array([bench.deviation_um(*_at(bench, k, float(um))) for um in (start, *traverse)])[1:])
    return np.array(passes[::2]), np.array(passes[1::2])[:, ::-1]


def _at(bench: _Bench, k: int, um: float, aside_um: float = 0.0) -> tuple[float, float]:
    x, y = bench.centre_um
    return (um, y + aside_um) if k == 0 else (x + aside_um, um)


def _round(bench: _Bench, circle: Sequence[Floats] | Floats) -> Floats:
    """Move round a circle twice; return the positions of the second round from the programmed centre."""
    x0, y0 = bench.centre_um
    places = []
    for x, y in [*circle, *circle]:
        at = bench.whole_steps(x0 + float(x)), bench.whole_steps(y0 + float(y))
        places.append(np.array((float(at[0]) - x0, float(at[1]) - y0)) + bench.deviation_um(*at))
    return np.array(places[len(circle) :])


_NAMES = {
    "accuracy": "accuracy A", "systematic": "systematic deviation E", "mean_range": "range of means M",
    "reversal": "greatest reversal value B", "mean_reversal": "mean reversal value",
    "repeatability": "repeatability R",
    "repeatability_up": "repeatability from below", "repeatability_down": "repeatability from above",
}  # fmt: skip
_OF_CIRCLE = {
    "circular_deviation": "circular deviation G", "circular_deviation_clockwise": "circular deviation G, clockwise",
    "hysteresis": "hysteresis H", "radial_high": "radial deviation F, greatest",
    "radial_low": "radial deviation F, least",
}  # fmt: skip


def headline(found: TableMeasurement) -> list[str]:
    """Return the main figures as sentences."""
    lines = [
        f"Accuracy (ISO 230-2) of {axis}: {found.along[axis, axis].figures()['accuracy']:.1f} um."
        for axis in ("x", "y")
    ]
    return [*lines, f"Out of square by {found.squareness_um_m:.0f} um/m."]


def as_json(found: TableMeasurement) -> str:
    """Return all figures in um as JSON."""
    figures = {axis: found.along[axis, axis].figures() for axis in ("x", "y")}
    return json.dumps(
        {**figures, "squareness_um_m": found.squareness_um_m, "circle": found.circle.figures()}, indent=2
    )


def render(found: TableMeasurement) -> screen.ScreenTable:
    """Return all figures as a table for the terminal."""
    table = screen.ScreenTable(
        "ISO 230-2, um", numbers=("x", "y"), title=f"{len(found.along['x', 'x'].targets_mm)} targets an axis"
    )
    x, y = (found.along[axis, axis].figures() for axis in ("x", "y"))
    for name, words in _NAMES.items():
        table.add_row(words, f"{x[name]:.2f}", f"{y[name]:.2f}")
    table.add_section()
    table.add_row("out of square, um/m", f"{found.squareness_um_m:.1f}", "")
    table.add_section()
    circle = found.circle.figures()
    for name, words in _OF_CIRCLE.items():
        table.add_row(f"{words} (ISO 230-4)", f"{circle[name]:.2f}", "")
    return table


_COLOURS = VERMILION, BLUE
_SMOOTHED_MM = 1.0  # length along the edge over which the wall is averaged: its roughness is several um (ours)


@errors.refuses_wrong_types
def table_figure(measured: Mapping[str, TableMeasurement]) -> "Figure":
    """Draw measurements of a table, once or before and after compensation.

    Parameters
    ----------
    measured : mapping of str to TableMeasurement
        By name in the legend, at most two.

    Returns
    -------
    Figure
        Deviations of x and of y along their own axes, in both directions (thin lines) and their mean; of y along x;
        and the circular test.
    """
    with _new_figure(measured, 6.4) as figure:
        for place, pair in enumerate((("x", "x"), ("y", "y"), ("y", "x")), 1):
            _draw(figure.add_subplot(2, 2, place), pair, measured)
        _draw_circles(
            figure.add_subplot(2, 2, 4, projection="polar"), {name: found.circle for name, found in measured.items()}
        )
    return figure


@contextmanager
def _new_figure(measured: Mapping[str, TableMeasurement], height_in: float) -> "Iterator[Figure]":
    """Yield a figure for one or two measurements, to be drawn in the style of all figures."""
    from edmsim.recording.figures.style import NotebookFigure, own_style

    if not 1 <= len(measured) <= len(_COLOURS):
        raise errors.InputError(f"a figure shows one or two measurements by name, not {len(measured)}")
    with own_style():
        yield NotebookFigure(figsize=(9.0, height_in), layout="constrained")


def _draw(axes: "Axes", pair: tuple[str, str], measured: Mapping[str, TableMeasurement]) -> None:
    """Draw the deviations of an axis along an axis."""
    for colour, (name, table) in zip(_COLOURS, measured.items(), strict=False):
        found = table.along[pair]
        for mean in (found.mean_up_um, found.mean_down_um):
            axes.plot(found.targets_mm, mean, color=colour, lw=0.5, alpha=0.6)
        axes.plot(found.targets_mm, found.mean_um, color=colour, lw=1.3, label=name)
    axes.set(title=f"{pair[0]} along {pair[1]}", xlabel="target, mm", ylabel="deviation, um")
    axes.grid(color=GRID)
    axes.legend(fontsize=8)


def _draw_circles(axes: "Axes", circles: Mapping[str, CircularTest]) -> None:
    deviations = [c.deviation_um(clockwise) for c in circles.values() for clockwise in (False, True)]
    most = max(float(np.abs(deviation).max()) for deviation in deviations)
    for colour, circle in zip(_COLOURS, circles.values(), strict=False):
        angle = np.append(circle.angle_rad, 2 * np.pi)
        for clockwise, style in ((False, "-"), (True, ":")):
            deviation = circle.deviation_um(clockwise)
            axes.plot(angle, np.append(deviation, deviation[0]), style, color=colour, lw=1.1)
    axes.plot(np.linspace(0, 2 * np.pi, 181), np.zeros(181), color=MUTED, lw=0.8)
    axes.set_ylim(-3 * most, 1.5 * most)
    radius = next(iter(circles.values())).radius_mm
    axes.set_title(f"radius on a circle of {radius:g} mm, um (clockwise dotted)", fontsize=9)


@errors.refuses_wrong_types
def part_figure(measured: Mapping[str, TableMeasurement], cuts: "Mapping[str, ErrorMap]") -> "Figure":
    """Draw a table's pitch error before and after compensation, and its effect on the wall of a part.

    Parameters
    ----------
    measured : mapping of str to TableMeasurement
        By name, at most two.
    cuts : mapping of str to ErrorMap
        The same contour, cut with both and with a perfect table (``"perfect table"``), which is subtracted from
        the others: wire and process are the same.
    """
    with _new_figure(measured, 5.0) as figure:
        drawn = figure.subplot_mosaic([["x", "y"], ["part", "part"]])
        for pair in (("x", "x"), ("y", "x")):
            _draw(drawn[pair[0]], pair, measured)
        _draw_part(drawn["part"], cuts)
    return figure


def _draw_part(axes: "Axes", cuts: "Mapping[str, ErrorMap]") -> None:
    """Draw the walls of a part, less that of a perfect table."""
    perfect = cuts["perfect table"].error_um
    names = [name for name in cuts if name != "perfect table"]
    for colour, name in zip(_COLOURS, names, strict=False):
        cut = cuts[name]
        along_mm = arc_lengths(cut.points_mm)
        axes.plot(along_mm, _smoothed(cut.error_um - perfect), color=colour, lw=1.3, label=name)
    axes.set(title="the part's wall, less that of a perfect table", xlabel="along the edge, mm", ylabel="error, um")
    axes.grid(color=GRID)
    axes.legend(fontsize=8)


def _smoothed(values: Floats) -> Floats:
    """Return running means of the finite values."""
    window = np.ones(round(_SMOOTHED_MM / PROFILE_STEP_MM))
    known = np.isfinite(values)
    count = np.convolve(known, window, "same")
    total = np.convolve(np.where(known, values, 0.0), window, "same")
    return np.asarray(np.divide(total, count, out=np.full(len(values), np.nan), where=count > 0))


# Heights of a machine's wire guides, from a test cut of a block whose walls lean to one side.
# If a guide is higher or lower than the control assumes, leaning walls move: towards the part on one side of the
# block, away from it on the other. The gap is the same on both sides, so it cancels in the difference.

SIDE_MM = 3.0  # length of the block's sides (ours: most of each is away from the corners)
WALL_UM = 1.5  # error that all slices of a leaning wall share (ours: 16 blocks, 3 to 15 degrees, true guides)
CORNER_MM = 0.6  # walls are not measured this near to a corner (ours: metal there is cut twice, or from the side)


class GuidesFound(NamedTuple):
    """The heights of the guides from a test cut."""

    # how much higher the guides are than the machine's file says
    lower_mm: float
    upper_mm: float
    uncertainty_mm: tuple[float, float]  # of these: from the scatter of the slices, and `WALL_UM`
    # (slices,) each: heights of the slices, and shifts of their walls in the direction in which they lean
    heights_mm: Floats
    shift_um: Floats


def block(angle_deg: float) -> outline.Program:
    """Return the program of the block: its walls along y lean towards -x, those along x do not."""
    half = SIDE_MM / 2
    points = half * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)], np.float64)
    walls = outline.Outline(
        points, (0,) * 4, True, "right", "left", np.empty((0, 2)), elements=(1, 2, 3, 4),
        taper=outline.Taper((0.0, angle_deg, 0.0, -angle_deg), corners="sharp"),
    )
    return outline.Program((walls,), (), "test block")


@errors.refuses_wrong_types
def measure_guides(
    machine: Machine, angle_deg: float = 10.0, errors_mm: tuple[float, float] = (0.0, 0.0), *, seed: int = 0,
    resolution: str = "fast", watch: Callable[[Progress], None] | None = None,
) -> GuidesFound:
    """Cut a block with leaning walls, with known errors compensated, and find the errors of the guides' heights."""
    if not 1.0 <= angle_deg <= 30.0:
        raise errors.InputError(f"a test block's walls cannot lean by {angle_deg:g} degrees: give 1 to 30")
    guides = guides_of(machine, errors_mm)
    travel_um = round(machine.base.table.travel_mm.value * 1e3)
    planned = path.plan_path(
        block(angle_deg), auto_offset_mm=machine.auto_offset_mm, table_um=travel_um, guides=[guides],
        lead_in_mm=1.0 + machine.height_mm * math.tan(math.radians(angle_deg)),
    )
    law = controllers.from_text("counts")
    cut = Simulation(machine, planned, law, planner="exact", seed=seed, resolution=resolution)
    outcome = cut.run(watch)
    if outcome != "finished":
        raise errors.EdmsimError(f"the test block was not cut to its end: {cut.reason or outcome}")
    assert guides is not None
    profile = profile_error(cut.plant.field, planned.contours[0])
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
    scatter_mm = [spread * math.sqrt(float(row @ covariance @ row)) / steep for row in known]
    spreads = [math.hypot(one_mm, WALL_UM * 1e-3 / tangent) for one_mm in scatter_mm]
    return GuidesFound(
        errors_mm[0] + places[0] - low_mm, errors_mm[1] + places[1] - high_mm, (spreads[0], spreads[1]), heights_mm,
        shift_um,
    )


def _shift_um(profile: ProfileError) -> Floats:
    """Return the deviation of the leaning walls towards -x, slice by slice."""
    middle = (profile.points_mm.min(axis=0) + profile.points_mm.max(axis=0)) / 2
    x, y = (profile.points_mm - middle).T
    counted = (np.abs(y) < SIDE_MM / 2 - CORNER_MM) & ~profile.at_lead_in
    left, right = (profile.error_um[:, counted & side] for side in (x < 0, x > 0))
    if not all(np.isfinite(side).any(axis=1).all() for side in (left, right)):
        raise errors.EdmsimError("the walls of the test block lie too far off to be measured: let them lean less")
    return np.asarray((np.nanmedian(left, axis=1) - np.nanmedian(right, axis=1)) / 2)
