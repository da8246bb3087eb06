"""Results of a cut: measurements of the part, report, tables, drawing and remaining metal, and their files."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
import shapely

from edmsim import __version__, files, numeric
from edmsim.closed_loop import straight
from edmsim.closed_loop.passes import FACE_EVERY, PassRecord, Sums, programmed_um
from edmsim.closed_loop.simulation import Simulation
from edmsim.errors import EdmsimError, InputError, one_of, refuses_wrong_types
from edmsim.geometry import Floats
from edmsim.job.options import METADATA_KEY, CutSettings
from edmsim.machine.machine import Machine, constants_digest
from edmsim.machine.setting import AIR_SHARE, discharge_current_A
from edmsim.metrology import edges, error_budget, kerf, profile, roughness
from edmsim.plant.resolution import resolution as resolution_named
from edmsim.plant.workpiece import height_steps, kerf_field
from edmsim.program.path import CutPath, WireContour
from edmsim.recording import report as reports
from edmsim.recording.scene import ErrorMap, PassFace, Scene, holes_mm, polylines, terraces, write_scene
from edmsim.recording.windows import CUT_KEY, Closeups, Frames, WindowTable, cut_alone, durations_s, write_windows

if TYPE_CHECKING:
    import pyarrow as pa
    from matplotlib.figure import Figure

# Measurements of the part, for report, picture and recording.


_HEIGHT_STEP_UM = 10.0  # spacing of points on the path at which the local height is evaluated


class Inspection(NamedTuple):
    """Everything measured on the part."""

    part: reports.Report  # with the figures of the part alone
    scene: Scene  # geometry of the pictures
    # (windows,): profile error at the place of every window; NaN where none was measured
    error_um: Floats


def totals(simulation: Simulation, windows: WindowTable, wall_time_s: float) -> reports.Totals:
    """Return the sums over the cut."""
    values, records = windows.columns(), simulation.passes.records
    cut = cut_alone(values, np.array(simulation.plant.field.stock.holes_um, np.float64).reshape(-1, 3))
    # in passes only the area of the rough one, because trims cut it again; it may begin inside the start hole
    spans = [(max(a, r.begin_um), min(b, r.end_um)) for r in records if r.number == 1 for a, b in cut.stretches_um]
    spans += [(a, b) for a, b in cut.stretches_um if all(r.end_um <= a or b <= r.begin_um for r in records)]
    took_s = durations_s(values)
    at_limit = values["feed_um_s"] > 0.99 * simulation.max_feed_um_s  # tolerance, because feeds are whole speed units
    all_s = float(took_s[cut.rows].sum())
    return reports.Totals(
        simulation.plant.time_ns * 1e-9, wall_time_s, simulation.sums, simulation.path_um * 1e-3,
        sum(_area_mm2(simulation, *span) for span in spans), cut.time_s, simulation.plant.removed_mm3,
        simulation.max_feed_um_s, float(took_s[cut.rows & at_limit].sum()) / all_s if all_s else math.nan,
    )  # fmt: skip


def _area_mm2(simulation: Simulation, from_um: float, to_um: float) -> float:
    """Return the area cut along a part of the path in mm2: length times local height, along the wire if it tilts."""
    length, relief = max(to_um - from_um, 0.0), simulation.plant.field.relief
    if length <= 0 or (relief is None and not simulation.path.leans):
        return length * simulation.machine.height_mm * 1e-3
    paths = simulation.path.wire_paths
    # moves between contours cut nothing, so their length is 0
    moves = np.concatenate([np.append(np.diff(path.along_um), 0.0) for path in paths])
    slant = np.concatenate([np.append(path.slant, 1.0) for path in paths])
    place, wall = (np.concatenate([[0.0], np.cumsum(um)[:-1]]) for um in (moves, moves * slant))
    edges = np.linspace(from_um, to_um, math.ceil(length / _HEIGHT_STEP_UM) + 1)
    walls_um = np.diff(np.interp(edges, place, wall))
    if relief is None:
        return float(walls_um.sum()) * simulation.machine.height_mm * 1e-3
    points = np.concatenate([path.at_mid_height() for path in paths])
    middle = np.column_stack([np.interp((edges[1:] + edges[:-1]) / 2, place, column) for column in points.T])
    return float((walls_um * relief.heights_mm(middle)).sum()) * 1e-3


def inspect(simulation: Simulation, windows: WindowTable) -> Inspection:
    """Measure the part as it is now, finished or not."""
    field, machine = simulation.plant.field, simulation.machine
    profiles = [_error_of_edge(field, contour) for contour in simulation.path.contours]
    contours = tuple(contour.at_mid_height() for contour in simulation.path.contours)
    table, lead = _table(simulation, profiles), _lead(simulation.path)
    tracks_um = _tracks_um(simulation, windows)
    shares_um = _shares(simulation, profiles, tracks_um)
    left_um = [error_budget.unreachable_um(p, k) for k, p in zip(contours, profiles, strict=True)]
    found = [c for k, p in zip(contours, profiles, strict=True) for c in profile.corners(k, p)]
    scene = Scene(
        maps=tuple(
            ErrorMap(k.nominal_mm, k.part_side, p.points_mm, p.mean_um, split, left, p.error_um)
            for k, p, split, left in zip(contours, profiles, shares_um, left_um, strict=True)
        ),
        cut_edges_mm=tuple(polylines(edges.cut_edges(field, s)) for s in range(field.n_slices)),
        corners=tuple(found),
        starts_mm=np.array([contour.points_um[0] * 1e-3 for contour in contours]),
        stock_mm=simulation.path.stock_mm,
        height_mm=machine.height_mm,
        terraces=terraces(field.relief, simulation.path.stock_mm),
        guides_z_mm=machine.guides_z_mm,
        wire_diameter_um=machine.wire_diameter_um,
        holes_mm=holes_mm(field.stock),
        origin_mm=simulation.path.origin_mm,
        lead=lead,
        walls_mm=tuple(
            tuple(k.at_height(z).nominal_mm for z in (0.0, machine.height_mm)) for k in simulation.path.contours
        ) if lead is not None else (),
        pass_faces=_pass_faces(simulation.passes.records, profiles),
    )
    if simulation.outcome != "finished":
        x, y = scene.axis_um(np.array([simulation.commanded_um]), np.array([simulation.path_um]))[0].tolist()
        scene = replace(scene, stop_mm=(x * 1e-3, y * 1e-3))
    in_passes = bool(simulation.passes.records)
    commanded_um = windows.motion()[0] if in_passes else np.concatenate([commanded for commanded, _, _ in tracks_um])
    part = _part(simulation, profiles, scene, left_um, table)
    axis_um = scene.axis_um(commanded_um, windows.motion()[-1])
    return Inspection(part, scene, profile.nearest_error_um(axis_um, profiles))


def _pass_faces(records: list[PassRecord], profiles: list[profile.ProfileError]) -> tuple[PassFace, ...]:
    """Return the faces after each finished pass."""
    return tuple(
        PassFace(
            record.contour - 1, record.end_s, record.end_um, profiles[record.contour - 1].points_mm[::FACE_EVERY],
            np.array(record.face_um),
        )
        for record in records if record.face_um
    )  # fmt: skip


def _lead(path: CutPath) -> Floats | None:
    """Return the rows of `Scene.lead` of a path; None if no wire leans."""
    if not path.leans:
        return None
    rows, passed_um = [], 0.0
    for wire_path in path.wire_paths:
        along = passed_um + wire_path.along_um
        passed_um = along[-1]
        still = np.column_stack([np.zeros((len(along), 3)), np.ones(len(along))])
        lean = wire_path.lean
        led = still if lean is None else np.column_stack([lean.upper_um * 1e-3, lean.bends_mm])
        rows.append(np.column_stack([along, led]))
    return np.concatenate(rows)


def _error_of_edge(field: kerf_field.KerfField, contour: WireContour) -> profile.ProfileError:
    """Measure a contour's profile error; it is NaN without offset, because the wire's centre line is not an edge."""
    found = profile.profile_error(field, contour)
    return found if contour.offset_um else replace(found, error_um=np.full_like(found.error_um, np.nan))


def _profile_errors(
    contours: tuple[WireContour, ...], profiles: list[profile.ProfileError], left_um: list[Floats], scene: Scene,
    origin_mm: tuple[float, float],
) -> reports.ProfileErrors:
    """Return the profile error's statistics, with and without the metal that the wire cannot reach."""
    reached = [p.error_um - left for p, left in zip(profiles, left_um, strict=True)]
    shares_um = [edge.shares_um for edge in scene.maps]

    def worst(reachable: bool) -> reports.ErrorPlace:
        found = error_budget.worst_place(contours, profiles, left_um, shares_um, reachable=reachable)
        if found is None:
            return reports.ErrorPlace()
        x_mm, y_mm = found.x_mm - origin_mm[0], found.y_mm - origin_mm[1]
        return reports.ErrorPlace(x_mm, y_mm, found.error_um, found.why, found.made_by)

    left = _spread([error.ravel() for error in reached])
    return reports.ProfileErrors(
        **_spread([p.error_um.ravel() for p in profiles]), at=worst(False),
        reachable=reports.ReachableError(**left, at=worst(True)), shares=_share_stats(scene),
    )  # fmt: skip


def _element(found: profile.ElementError, origin_mm: tuple[float, float]) -> reports.Element:
    """Return an element in the program's coordinates."""
    row = asdict(found)
    for name, zero_mm in zip(("x_mm", "y_mm", "end_x_mm", "end_y_mm"), origin_mm * 2, strict=True):
        row[f"program_{name}"] = row.pop(name) - zero_mm
    return reports.Element(**row)


def _tracks_um(simulation: Simulation, windows: WindowTable) -> list[tuple[Floats, ...]]:
    """Return the tracks of commanded position, guides and wire, (n, 2) each, contour by contour."""
    # a contour begins after a threading, which takes the longest times between two windows
    commanded, following, lag, time_s, path_um = windows.motion()
    guides = commanded - following
    if simulation.elcam is not None or simulation.machine.base.geometry.has_errors:
        program_um = programmed_um(simulation.legs, path_um)
        program, table = error_budget.motor_offsets_um(
            simulation.machine, commanded, program_um, path_um, simulation.elcam
        )
        commanded, guides = commanded - program, guides - table
    if simulation.passes.records:
        tracks_um = (commanded, guides, guides - lag)
        return _last_tracks_um(simulation, tracks_um, time_s)
    threaded = sum(leg.threads for leg in simulation.legs[1 : simulation.leg + 1])
    longest = np.argsort(np.diff(time_s), kind="stable")[::-1][:threaded]
    begins = np.full(len(simulation.path.contours) - 1, len(time_s))
    begins[:threaded] = np.sort(longest) + 1
    tracks = (np.split(track, begins) for track in (commanded, guides, guides - lag))
    return list(zip(*tracks, strict=True))


def _last_tracks_um(
    simulation: Simulation, tracks_um: tuple[Floats, ...], time_s: Floats
) -> list[tuple[Floats, ...]]:
    """Return the tracks of the last pass of each contour, because it made the wall; NaN between its pieces."""
    found = []
    for contour, last in enumerate(_last_passes(simulation), 1):
        mine = np.zeros(len(time_s), np.bool_)
        for record in simulation.passes.records:
            if (record.contour, record.number) == (contour, last):
                mine |= (time_s > record.begin_s) & (time_s <= record.end_s)
        rows = np.flatnonzero(mine)
        # a tab's pass begins elsewhere than the profile's ends
        begins = np.flatnonzero(np.diff(rows) > 1) + 1
        found.append(tuple(np.insert(track[rows], begins, np.nan, axis=0) for track in tracks_um))
    return found


def pass_figures(simulation: Simulation) -> tuple[reports.PassFigures, ...]:
    """Return the figures of every pass; empty for a cut in one pass."""
    records = simulation.passes.records
    return tuple(
        figures
        for piece in dict.fromkeys((r.contour, r.piece) for r in records)
        for figures in _figures_of([r for r in records if (r.contour, r.piece) == piece], simulation)
    )


def _figures_of(records: list[PassRecord], simulation: Simulation) -> list[reports.PassFigures]:
    """Return the figures of the passes along one piece, which follow each other on the same face."""
    machines = [simulation.machine_of(record.number) for record in records]
    walls = [kerf.unknown_wall(()) if r.wall is None else r.wall for r in records]
    lefts = [wall.mean_um for wall in walls]
    taken = [math.nan, *np.subtract(lefts[:-1], lefts[1:]).tolist()]
    volumes = [r.sums.crater_um3 / max(r.sums.spark + r.sums.arc, 1) for r in records]
    faces = roughness.face_roughness_um(volumes, taken, machines[0].base.discharge.crater_flatness.value)
    found, heated = [], math.nan
    for record, machine, wall, took, ra_um in zip(records, machines, walls, taken, faces, strict=True):
        own_um = roughness.heat_affected_um(machine, _discharge_us(machine, record.sums))
        heated = own_um if record is records[0] else float(np.maximum(own_um, heated - took))
        length_mm, seconds = (record.end_um - record.begin_um) * 1e-3, record.end_s - record.begin_s
        face_mm2 = _area_mm2(simulation, record.begin_um, record.end_um)
        left, pulses = wall.mean_um, max(record.sums.pulses, 1)
        found.append(reports.PassFigures(
            record.contour, record.number, record.piece, record.reversed, record.begin_s, record.end_s, length_mm,
            60 * face_mm2 / seconds if seconds > 0 else math.nan, record.offset_um,
            record.offset_um - left, left, took, wall.straightness_um, wall.bow_um, wall.ripple_um, wall.ripple_mm,
            list(wall.slices_um), ra_um, heated, record.sums.short / pulses, record.sums.open / pulses,
        ))  # fmt: skip
    return found


def _discharge_us(machine: Machine, sums: Sums) -> float:
    """Return the mean duration of the discharges of a cut or a pass, from their energy; 0 if there were none."""
    power_W = machine.material.burning_voltage_V.value * discharge_current_A(machine)
    return sums.energy / (max(sums.spark + sums.arc, 1) * power_W) * 1e6


def _shares(
    simulation: Simulation, profiles: list[profile.ProfileError], tracks_um: list[tuple[Floats, ...]]
) -> list[Floats | None]:
    """Split the profile error of each contour into shares; None if the contour has no offset, or leans."""
    each = zip(profiles, simulation.path.contours, tracks_um, _last_passes(simulation), strict=True)
    return [
        error_budget.error_shares(profile, contour, tracks, last)
        if contour.offset_um and contour.lean is None else None
        for profile, contour, tracks, last in each
    ]  # fmt: skip


def _last_passes(simulation: Simulation) -> list[int | None]:
    """Return the last pass begun on every contour; None if there is none, or in a cut in one pass."""
    contours = range(1, len(simulation.path.contours) + 1)
    return [max((r.number for r in simulation.passes.records if r.contour == k), default=None) for k in contours]


def _table(simulation: Simulation, profiles: list[profile.ProfileError]) -> reports.TableShare | None:
    """Return the effect of the table's errors on the part; None for a perfect table without compensation."""
    machine, elcam, contours = simulation.machine, simulation.elcam, simulation.path.contours
    compensated = elcam is not None and any(table.corrects for table in elcam.tables.values())
    if not compensated and not machine.base.geometry.has_errors:
        return None
    starts_um = np.cumsum([0.0, *(path.along_um[-1] for path in simulation.path.wire_paths[:-1])])
    of_contours = [starts_um[np.array(simulation.path.contour_of) == k] for k in range(len(contours))]
    places = zip(contours, profiles, of_contours, _last_passes(simulation), strict=True)
    found = [error_budget.table_error(machine, k, p, elcam, starts, last) for k, p, starts, last in places]
    cut = [np.isfinite(p.mean_um) for p in profiles]  # only where there is an edge that was cut
    bare = [p.error_um + (t.without_um - t.left_um) for p, t in zip(profiles, found, strict=True)]
    return reports.TableShare(
        without_um=_spread([t.without_um[k] for t, k in zip(found, cut, strict=True)]),
        left_um=_spread([t.left_um[k] for t, k in zip(found, cut, strict=True)]),
        profile_without_um=_spread([b.ravel() for b in bare]),
        compensated=compensated,
    )


def _spread(errors_um: list[Floats]) -> reports.Spread:
    return reports.Spread(**profile.error_stats(np.concatenate(errors_um)))


def _part(
    simulation: Simulation, profiles: list[profile.ProfileError], scene: Scene, left_um: list[Floats],
    table: reports.TableShare | None,
) -> reports.Report:
    field, machine, sums = simulation.plant.field, simulation.machine, simulation.sums
    contours = tuple(contour.at_mid_height() for contour in simulation.path.contours)
    widths = [kerf.kerf_width(field, k, machine.wire_diameter_um) for k in simulation.path.contours]
    kerf_um = reports.Kerf(**kerf.width_stats(np.concatenate([w.width_um.ravel() for w in widths])))
    ignited = sums.spark + sums.arc
    flatness = machine.base.discharge.crater_flatness.value
    heated_um = roughness.heat_affected_um(machine, _discharge_us(machine, sums)) if ignited else None
    origin_mm = simulation.path.origin_mm
    passes = pass_figures(simulation)
    last = max(passes, key=_as_last, default=None)
    offset_mm = math.nan if simulation.path.offset_um is None else simulation.path.offset_um * 1e-3
    finished = [
        of_one for number, of_one in enumerate(zip(contours, profiles, left_um, strict=True), 1)
        if _is_finished(number, of_one[0], simulation.passes.records)
    ]
    mean_um = error_budget.mean_error_um(*(zip(*finished, strict=True) if finished else ((), (), ())))
    elements = (
        found
        for number, of_contour in enumerate(zip(contours, profiles, left_um, strict=True), 1)
        for found in profile.element_errors(number, *of_contour)
    )
    return reports.Report(
        origin_mm=reports.Origin(*origin_mm), kerf_um=kerf_um, kerf_section=_section(widths, machine.height_mm),
        profile_error_um=_profile_errors(contours, profiles, left_um, scene, origin_mm),
        offset=reports.Offset(offset_mm, mean_um, round(offset_mm - mean_um * 1e-3, 4)),
        elements=[_element(found, origin_mm) for found in elements], table_error_um=table,
        corners=[
            reports.Corner(c.x_mm - origin_mm[0], c.y_mm - origin_mm[1], c.x_mm, c.y_mm, c.turn_deg, c.error_um)
            for c in scene.corners
        ],
        heights=_heights(profiles, machine.height_mm), passes=list(passes),
        surface=reports.Surface(
            last.ra_um if last else roughness.roughness_um(sums.crater_um3 / ignited, flatness) if ignited else None,
            last.heat_affected_um if last else heated_um,
            _electrolysed_um(simulation, kerf_um),
        ),
    )  # fmt: skip


def _is_finished(number: int, contour: WireContour, records: Sequence[PassRecord]) -> bool:
    """Return whether all passes of a contour have been cut; True if it has none, because its wall is final."""
    return sum(r.contour == number and r.wall is not None for r in records) == len(contour.passes)


def _as_last(one: reports.PassFigures | PassRecord) -> tuple[bool, float]:
    """Return a sort key: the pass with the greatest one made the face of the part."""
    return one.piece == "profile", one.end_s


def _electrolysed_um(simulation: Simulation, kerf_um: reports.Kerf) -> float | None:
    """Return the depth dissolved by the water, in passes only by the last, because trims remove earlier layers."""
    sums, length_um, machine = simulation.sums, simulation.path_um, simulation.machine
    gap_um = ((math.nan if kerf_um.mean is None else kerf_um.mean) - machine.wire_diameter_um) / 2
    if simulation.passes.records:
        last = max(simulation.passes.records, key=_as_last)
        sums, length_um = last.sums, last.end_um - last.begin_um
        left_um = math.nan if last.wall is None else last.wall.mean_um
        gap_um = last.offset_um - left_um - machine.wire_diameter_um / 2
    return roughness.electrolysed_um(machine, sums.voltage_s / (length_um * 1e-3), gap_um) if length_um else None


def _heights(profiles: list[profile.ProfileError], height_mm: float) -> list[reports.HeightError]:
    """Return the profile error slice by slice, over all contours."""
    error_um = np.concatenate([p.error_um for p in profiles], axis=1)
    slice_mm = height_mm / len(error_um)
    found = []
    for number, row in enumerate(error_um):
        known = row[np.isfinite(row)]
        mean, rms = (float(known.mean()), float(np.sqrt(np.mean(known**2)))) if len(known) else (math.nan, math.nan)
        found.append(reports.HeightError((number + 0.5) * slice_mm, mean, rms))
    return found


def _share_stats(scene: Scene) -> dict[str, dict[str, float]] | None:
    split = [(edge.shares_um, edge.error_um) for edge in scene.maps if edge.shares_um is not None]
    if not split:
        return None
    shares_um, error_um = np.concatenate([s for s, _ in split], axis=1), np.concatenate([e for _, e in split])
    return error_budget.share_stats(shares_um, error_um)


def _section(widths: list[kerf.KerfWidth], height_mm: float) -> list[reports.KerfSlice]:
    """Combine the walls measured along all contours, slice by slice."""
    part = np.concatenate([w.part_um for w in widths], axis=1)
    rest = np.concatenate([w.width_um for w in widths], axis=1) - part
    slice_mm = height_mm / len(part)
    return [
        reports.KerfSlice((number + 0.5) * slice_mm, int(np.isfinite(ours).sum()), _wall(ours), _wall(others))
        for number, (ours, others) in enumerate(zip(part, rest, strict=True))
    ]


def _wall(distance_um: Floats) -> reports.Wall:
    known = distance_um[np.isfinite(distance_um)]
    if not len(known):
        return reports.Wall()
    low, high = np.percentile(known, (5, 95))
    return reports.Wall(float(known.mean()), float(low), float(high))





# The result, and its files.


class Recorders(NamedTuple):
    """The recorders of a cut."""

    windows: WindowTable  # a row per window
    frames: Frames  # the wire's shape, thinned
    closeups: Closeups  # windows kept pulse by pulse


def recorders_for(machine: Machine, lower_regions: Sequence[height_steps.LowerRegion], resolution: str) -> Recorders:
    """Return empty recorders for a cut of a workpiece with some height steps."""
    size = resolution_named(resolution)
    lowest_mm = min([region.height_mm for region in lower_regions], default=machine.height_mm)
    middle = height_steps.middle_slice(lowest_mm, machine.height_mm, size.slices)
    windows = WindowTable(machine.generator.equalising is not None)
    return Recorders(windows, Frames(size.slices), Closeups(size.slices, size.rays, middle))


@refuses_wrong_types
def sample_like(report: reports.Report, windows: pa.Table, *, pulses: int = straight.PULSES) -> straight.PulseSample:
    """Sample pulses of a straight cut with a cut's set-up, seed and resolution, at its median feed.

    The workpiece has its greatest height, and the mechanics are always modal.
    """
    feed_um_s, open_, *others = (windows[name].to_numpy() for name in ("feed_um_s", "open", "short", "spark", "arc"))
    cutting = (feed_um_s > 0) & (open_ < AIR_SHARE * sum(others, open_))
    if not cutting.any():
        raise InputError("the cut has no window with metal near the wire")
    settings = CutSettings.of_report(report)
    machine = settings.load_machine()
    if constants_digest(machine) != report.settings["constants_sha256"]:
        raise InputError("a file of the set-up has other constants than the cut had: undo the change, or cut again")
    median_um_s, resolution = float(np.median(feed_um_s[cutting])), settings.resolution
    return straight.sample_pulses(machine, median_um_s, seed=settings.seed, pulses=pulses, resolution=resolution)


def sample_or_reason(report: reports.Report, windows: pa.Table) -> straight.PulseSample | str:
    """Return the sample of `sample_like`, or the message of its error."""
    try:
        return sample_like(report, windows)
    except EdmsimError as error:
        return str(error)


@dataclass(frozen=True, eq=False)
class CutResult:
    """Results of a cut."""

    report: reports.Report  # the fields of ``report.json``
    windows: pa.Table  # a row per window of 255 pulses: ``windows.parquet``; its metadata have the `CutSettings`
    path: CutPath  # the wire's path
    field: kerf_field.KerfField  # the remaining metal
    frames: Frames  # the wire's shape in a subset of windows
    scene: Scene  # the drawing: nominal and cut edges, errors, corners
    closeups: Closeups  # windows with every pulse: a subset, and all of them around events
    machine: Machine  # the set-up

    def __repr__(self) -> str:
        """Return the outcome and key figures; the report has the others."""
        shown = ("machining time", "path", "kerf", "profile error", "corners")
        lines = [f"  {name:14} {text}" for name, text in reports.summary(self.report) if name in shown]
        return "\n".join([f"<CutResult of {self.report.title}: {reports.outcome_text(self.report)}", *lines]) + ">"

    def _repr_html_(self) -> str:
        """Show table and picture in a notebook."""
        from edmsim.recording.html_report import card

        return card(self.report, self.plot())

    @refuses_wrong_types
    def plot(self, figure: str = "profile") -> Figure:
        """Draw a figure of the cut; a notebook shows it if it is the last line of a cell.

        Parameters
        ----------
        figure : str
            ``"profile"``, the picture of ``profile.png``: part, error and process; or a figure of ``edmsim report``:
            ``"profile-error"``, ``"error-shares"``, ``"corner"``, ``"kerf-section"``, ``"face"``, ``"passes"``,
            ``"pulses"``, ``"short-open"``, ``"ignition-delay"``, ``"wire-spectrum"``. The last two simulate single
            pulses of a straight cut with the same set-up, which takes some seconds.

        Returns
        -------
        matplotlib.figure.Figure
            With an Agg canvas; ``plot().savefig("cut.pdf")`` writes it.

        Raises
        ------
        InputError
            If there is no such figure, or this cut has no single pulses.
        """
        from edmsim.recording.html_report import OF_CUT, OF_SAMPLE

        if figure in OF_CUT:
            return OF_CUT[figure](self.report, self.windows, self.scene)
        if figure in OF_SAMPLE:
            return OF_SAMPLE[figure](sample_like(self.report, self.windows), self.windows, self.report)
        raise InputError(f"there is no figure '{figure}'; there are: {one_of(figure, [*OF_CUT, *OF_SAMPLE])}")

    @refuses_wrong_types
    def contour(
        self, slice_index: int | None = None, *, coordinates: Literal["program", "table"] = "program",
        specks: bool = False,
    ) -> shapely.MultiPolygon:
        """Return the metal removed from one slice as shapely polygons in mm; holes are remaining metal.

        Parameters
        ----------
        slice_index : int, optional
            0 is the bottom; by default the slice at mid height, for a stepped workpiece that of its lowest part.
        coordinates : {"program", "table"}
            Those of the program or drawing, or the table's, as in `windows`, `path` and `field`. They differ by
            ``path.origin_mm``.
        specks : bool
            Whether to keep single craters next to the kerf and crumbs of metal in it, smaller than a hundredth of
            the wire's cross-section.

        Raises
        ------
        InputError
            If there is no such slice, or there are no such coordinates.
        """
        if coordinates not in ("program", "table"):
            raise InputError(f"there are no coordinates '{coordinates}'; there are: program, table")
        removed = edges.contour(self.field, self.scene.middle_slice() if slice_index is None else slice_index)
        if not specks:
            removed = edges.without_specks(removed, self.scene.speck_mm2)
        if coordinates == "table":
            return removed
        return shapely.transform(removed, lambda mm: mm - self.path.origin_mm)

    @refuses_wrong_types
    def write_traces(
        self, file: str | Path, *, every_us: float = 0.5, begin_s: float = 0.0, end_s: float = math.inf
    ) -> None:
        """Write samples of gap voltage and current, as of an oscilloscope, to a Parquet file.

        The file has the last 96 pulses of some windows: a subset over the whole cut, and every window around retracts
        and corners (`closeups`). Each sample has the true class of its pulse, as a label for a discriminator.

        Parameters
        ----------
        file : path
            Columns ``window_t_s`` (s, the ``t_s`` of the row of `windows`), ``time_us`` (since that window's
            begin), ``voltage_V``, ``current_A``, ``pulse`` (number of the pulse in its window's excerpt) and
            ``kind`` (``open``, ``spark``, ``arc`` or ``short``).
        every_us : float
            Time between samples, 0.001 or more. Edges are vertical: the model has no rise times, lines or noise.
        begin_s, end_s : float
            Only windows that end within this span of machine time.

        Raises
        ------
        InputError
            If the time between samples is below 0.001 us, a limit of the span is not a number, the span has none of
            the cut's windows with samples, or the file cannot be written.
        """
        for name, time_s in (("begin_s", begin_s), ("end_s", end_s)):
            if numeric.real(time_s) is None or math.isnan(time_s):
                raise InputError(f"{name} is {time_s!r}: give a machine time in s")
        files.make_room(Path(file), "a file of traces", ".parquet")
        self.closeups.write_traces(file, every_us, begin_s, end_s)

    @refuses_wrong_types
    def write(self, folder: str | Path, enter: Callable[[str], None] | None = None) -> None:
        """Write ``report.json`` and ``.html``, ``windows.parquet``, ``profile.png``, ``part.npz`` and ``cut.rrd``.

        They replace those of an earlier cut together, when all are complete.

        Parameters
        ----------
        folder : path
        enter : callable, optional
            Called with the name of a phase when it begins: figures, recording.

        Raises
        ------
        InputError
            If the folder cannot be written to.
        OSError
            If writing fails later, for example on a full disk.
        """
        from edmsim.recording.html_report import write_html
        from edmsim.recording.rerun.write import write_recording

        tell = enter or (lambda _: None)
        with files.together(files.make_writable(folder), "report.json") as target:
            tell("figures")
            write_windows(self.windows, target / "windows.parquet")
            write_scene(self.scene, target / "part.npz")
            sample, page = sample_or_reason(self.report, self.windows), target / "report.html"
            picture = write_html(self.report, self.windows, self.scene, sample, page)
            (target / "profile.png").write_bytes(picture)
            tell("recording")
            write_recording(
                target / reports.RECORDING, self.scene, self.windows, self.frames, self.closeups, self.machine,
                self.report, self.report.title,
            )
            reports.write_json(self.report, target / "report.json")


def result_of(
    simulation: Simulation, recorders: Recorders, settings: CutSettings, made_with: Mapping[str, Any],
    notices: Sequence[str], wall_time_s: float,
) -> CutResult:
    """Measure the part after the cut, and return the cut's result."""
    found = inspect(simulation, recorders.windows)
    windows = recorders.windows.to_arrow(found.error_um)
    assert simulation.outcome is not None
    report = reports.build_report(
        found.part, windows, totals(simulation, recorders.windows, wall_time_s), outcome=simulation.outcome,
        reason=simulation.reason, notices=notices, seed=settings.seed, settings=made_with, version=__version__,
    )
    whose, passes = reports.cut_id(report), simulation.path.passes
    logged = settings if passes == 1 else settings.model_copy(update={"passes": passes})  # also the program's own
    return CutResult(
        report, windows.replace_schema_metadata({METADATA_KEY: logged.model_dump_json(), CUT_KEY: whose}),
        simulation.path, simulation.plant.field, recorders.frames, replace(found.scene, cut=whose),
        recorders.closeups, simulation.machine,
    )  # fmt: skip


def remake(
    directory: str | Path, figures: str | Path | None, kind: str, leave_out: Callable[[str], None]
) -> list[Path]:
    """Write a folder's ``report.html`` again, or its figures as separate files; return the files written."""
    from edmsim.recording.figures.style import FORMATS, write_figure
    from edmsim.recording.html_report import pictures, write_html

    if kind not in FORMATS:
        raise InputError(f"figures cannot be written as '{kind}'; there are: {one_of(kind, FORMATS)}")
    cut = reports.read_cut(directory)
    sample = sample_or_reason(cut.report, cut.windows)
    target = files.folder_of(directory if figures is None else figures)
    if figures is None:
        with files.locked(target):
            write_html(*cut, sample, target / "report.html")
        return [target / "report.html"]
    written, captions = [], []
    for picture in pictures(*cut, sample, leave_out):
        written.append(target / f"{picture.name}.{kind}")
        write_figure(picture.figure, written[-1])
        captions.append(f"{written[-1].name}: {picture.caption}\n")
    written.append(files.make_writable(target) / "captions.txt")
    with files.replacing(written[-1]) as partial:
        partial.write_text("".join(captions), encoding="utf-8")
    return written
