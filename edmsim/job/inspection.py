"""Inspection of a cut part: its measurements for report, picture and recording."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.cosim.passes import FACE_EVERY, PassRecord, Sums
from edmsim.cosim.simulation import Simulation
from edmsim.cosim.stops import StopCause
from edmsim.machine.machine import Machine
from edmsim.machine.setting import discharge_current_A
from edmsim.metrology import shares as causes
from edmsim.metrology.edges import cut_edges
from edmsim.metrology.kerf import KerfWidth, kerf_width, unknown_wall, width_stats
from edmsim.metrology.profile import ElementError, ProfileError, corners, element_errors, error_stats, profile_error
from edmsim.metrology.roughness import electrolysed_um, face_roughness_um, heat_affected_um, roughness_um
from edmsim.plant.workpiece.height_steps import Relief
from edmsim.plant.workpiece.kerf_field import KerfField, Stock
from edmsim.program.path import CutPath, WireContour
from edmsim.recording import report
from edmsim.recording.scene import ErrorMap, PassFace, Scene, Terrace, polylines
from edmsim.recording.windows import CutAlone, WindowTable, cut_alone, durations_s

_WINDOW_REACH_MM = 0.5  # a window belongs to a place of the profile only within this distance of the wire
_HEIGHT_STEP_UM = 10.0  # the local height is looked up this often along the path


@dataclass(frozen=True)
class Inspection:
    """Everything measured on the part."""

    part: report.Report  # with the figures of the part alone
    scene: Scene  # geometry of the pictures
    # (windows,): profile error at the place of every window; NaN where none was measured
    error_um: NDArray[np.float64]


def totals(simulation: Simulation, windows: WindowTable, wall_time_s: float) -> report.Totals:
    """Return what was counted over the cut."""
    cut = _cut_alone(simulation, windows)
    return report.Totals(
        simulation.plant.time_ns * 1e-9, wall_time_s, simulation.sums, simulation.path_um * 1e-3,
        _face_mm2(simulation, cut), cut.time_s, simulation.plant.removed_mm3, simulation.max_feed_um_s,
        _limited_share(simulation, windows, cut),
    )  # fmt: skip


def _face_mm2(simulation: Simulation, cut: CutAlone) -> float:
    """Return the area that was cut; of passes, that of the rough one, which the others cut again."""
    records = simulation.passes.records
    ways = [(r.begin_um, r.end_um) for r in records if r.number == 1] if records else cut.ways_um
    return sum(_area_mm2(simulation, *way) for way in ways)


def _cut_alone(simulation: Simulation, windows: WindowTable) -> CutAlone:
    values = windows.columns()
    holes_um = np.array(simulation.plant.field.stock.holes_um, np.float64).reshape(-1, 3)
    return cut_alone(
        values["t_s"], np.column_stack([values["x_um"], values["y_um"]]), values["path_um"],
        values["spark"] + values["arc"], holes_um,
    )


def _limited_share(simulation: Simulation, windows: WindowTable, cut: CutAlone) -> float:
    """Return the share of the cut at the greatest feed; feeds are whole speed units, so 1 % below it."""
    values = windows.columns()
    took_s = durations_s(values)
    at_limit = values["feed_um_s"] > 0.99 * simulation.max_feed_um_s
    all_s = float(took_s[cut.rows].sum())
    return float(took_s[cut.rows & at_limit].sum()) / all_s if all_s else math.nan


def _area_mm2(simulation: Simulation, from_um: float, to_um: float) -> float:
    """Return a way along the path times the local height in mm2; of a tilted wire, the height along it."""
    length, relief = to_um - from_um, simulation.plant.field.relief
    if length <= 0 or (relief is None and not simulation.path.leans):
        return length * simulation.machine.height_mm * 1e-3
    ways = [way for contour in simulation.path.contours for way in contour.ways]
    # a way between contours is not a cut: it counts for nothing
    moves = np.concatenate([np.append(np.diff(way.along_um), 0.0) for way in ways])
    slant = np.concatenate([np.append(way.slant, 1.0) for way in ways])
    place, wall = (np.concatenate([[0.0], np.cumsum(um)[:-1]]) for um in (moves, moves * slant))
    edges = np.linspace(from_um, to_um, math.ceil(length / _HEIGHT_STEP_UM) + 1)
    walls_um = np.diff(np.interp(edges, place, wall))
    if relief is None:
        return float(walls_um.sum()) * simulation.machine.height_mm * 1e-3
    points = np.concatenate([way.at_mid_height() for way in ways])
    middle = np.column_stack([np.interp((edges[1:] + edges[:-1]) / 2, place, column) for column in points.T])
    return float((walls_um * relief.heights_mm(middle)).sum()) * 1e-3


def inspect(simulation: Simulation, windows: WindowTable) -> Inspection:
    """Measure the part as it is now, finished or not."""
    field, machine = simulation.plant.field, simulation.machine
    profiles = [_error_of_edge(field, contour) for contour in simulation.path.contours]
    contours = tuple(contour.at_mid_height() for contour in simulation.path.contours)
    table = _table(simulation, profiles)
    ways_um = _ways_um(simulation, windows)
    shares = _shares(simulation, profiles, ways_um)
    left_um = [causes.unreachable_um(p, k) for k, p in zip(contours, profiles, strict=True)]
    found = [c for k, p in zip(contours, profiles, strict=True) for c in corners(k, p)]
    scene = Scene(
        maps=tuple(
            ErrorMap(k.nominal_mm, k.part_side, p.points_mm, p.mean_um, split, left, p.error_um)
            for k, p, split, left in zip(contours, profiles, shares, left_um, strict=True)
        ),
        cut_edges_mm=tuple(polylines(cut_edges(field, s)) for s in range(field.n_slices)),
        corners=tuple(found),
        starts_mm=np.array([contour.points_um[0] * 1e-3 for contour in contours]),
        stock_mm=simulation.path.stock_mm,
        height_mm=machine.height_mm,
        terraces=terraces(field.relief, simulation.path.stock_mm),
        guides_z_mm=machine.guides_z_mm,
        wire_diameter_um=machine.wire_diameter_um,
        holes_mm=holes_mm(field.stock),
        origin_mm=simulation.path.origin_mm,
        lead=_lead(simulation.path),
        walls_mm=tuple(
            tuple(k.at_height(z).nominal_mm for z in (0.0, machine.height_mm)) for k in simulation.path.contours
        ) if _lead(simulation.path) is not None else (),
        pass_faces=_pass_faces(simulation.passes.records, profiles),
    )
    if simulation.cause is not StopCause.FINISHED:
        x, y = scene.axis_um(np.array([simulation.commanded_um]), np.array([simulation.path_um]))[0].tolist()
        scene = replace(scene, stop_mm=(x * 1e-3, y * 1e-3))
    in_passes = bool(simulation.passes.records)
    commanded_um = windows.ways_um()[0] if in_passes else np.concatenate([commanded for commanded, _, _ in ways_um])
    part = _part(simulation, profiles, scene, left_um, table)
    axis_um = scene.axis_um(commanded_um, windows.ways_um()[-1])
    return Inspection(part, scene, _error_per_window(axis_um, profiles))


def _pass_faces(records: list[PassRecord], profiles: list[ProfileError]) -> tuple[PassFace, ...]:
    """Return the faces that finished passes left."""
    return tuple(
        PassFace(
            record.contour - 1, record.end_s, record.end_um, profiles[record.contour - 1].points_mm[::FACE_EVERY],
            np.array(record.face_um),
        )
        for record in records if record.face_um
    )  # fmt: skip


def _lead(path: CutPath) -> NDArray[np.float64] | None:
    """Return the rows of `Scene.lead` of a path; None if no wire leans."""
    if not path.leans:
        return None
    rows, passed_um = [], 0.0
    for way in (way for contour in path.contours for way in contour.ways):
        along = passed_um + way.along_um
        passed_um = along[-1]
        still = np.column_stack([np.zeros((len(along), 3)), np.ones(len(along))])
        lean = way.lean
        led = still if lean is None else np.column_stack([lean.upper_um * 1e-3, lean.bends_mm])
        rows.append(np.column_stack([along, led]))
    return np.concatenate(rows)


def _error_of_edge(field: KerfField, contour: WireContour) -> ProfileError:
    """Measure a contour's profile error; what the wire's centre was to follow is not an edge, and has none."""
    found = profile_error(field, contour)
    return found if contour.offset_um else replace(found, error_um=np.full_like(found.error_um, np.nan))


def _profile_errors(
    contours: tuple[WireContour, ...], profiles: list[ProfileError], left_um: list[NDArray[np.float64]], scene: Scene,
    origin_mm: tuple[float, float],
) -> report.ProfileErrors:
    """Set the profile error beside what the wire can reach."""
    reached = [p.error_um - left for p, left in zip(profiles, left_um, strict=True)]
    shares = [edge.shares_um for edge in scene.maps]

    def worst(reachable: bool) -> report.ErrorPlace:
        return _place(causes.worst_place(contours, profiles, left_um, shares, reachable=reachable), origin_mm)

    left = _spread([error.ravel() for error in reached])
    return report.ProfileErrors(
        **_spread([p.error_um.ravel() for p in profiles]), at=worst(False),
        reachable=report.ReachableError(**left, at=worst(True)), shares=_share_stats(scene),
    )  # fmt: skip


def _place(worst: causes.WorstPlace | None, origin_mm: tuple[float, float]) -> report.ErrorPlace:
    if worst is None:
        return report.ErrorPlace()
    x_mm, y_mm = worst.x_mm - origin_mm[0], worst.y_mm - origin_mm[1]
    return report.ErrorPlace(x_mm, y_mm, worst.error_um, worst.why, worst.made_by)


def _element(found: ElementError, origin_mm: tuple[float, float]) -> report.Element:
    """Return an element in the program's coordinates."""
    row = asdict(found)
    for name, zero_mm in zip(("x_mm", "y_mm", "end_x_mm", "end_y_mm"), origin_mm * 2, strict=True):
        row[f"program_{name}"] = row.pop(name) - zero_mm
    return report.Element(**row)


def _ways_um(simulation: Simulation, windows: WindowTable) -> list[tuple[NDArray[np.float64], ...]]:
    """Return the ways of commanded position, guides and wire, (n, 2) each, contour by contour."""
    # a contour begins where a wire was threaded: the longest times between two windows
    commanded, following, lag, time_s, path_um = windows.ways_um()
    guides = commanded - following
    if simulation.elcam is not None or simulation.machine.base.geometry.has_errors:
        program, table = causes.motor_offsets_um(simulation.machine, commanded, path_um, simulation.elcam)
        commanded, guides = commanded - program, guides - table
    if simulation.passes.records:
        ways_um = (commanded, guides, guides - lag)
        return _last_ways_um(simulation.passes.records, len(simulation.path.contours), ways_um, time_s)
    threaded = sum(leg.threads for leg in simulation.legs[1 : simulation.leg + 1])
    longest = np.argsort(np.diff(time_s), kind="stable")[::-1][:threaded]
    begins = np.full(len(simulation.path.contours) - 1, len(time_s))
    begins[:threaded] = np.sort(longest) + 1
    ways = (np.split(way, begins) for way in (commanded, guides, guides - lag))
    return list(zip(*ways, strict=True))


def _last_ways_um(
    records: list[PassRecord], contours: int, ways_um: tuple[NDArray[np.float64], ...], time_s: NDArray[np.float64]
) -> list[tuple[NDArray[np.float64], ...]]:
    """Return the ways of the last passes, contour by contour: they made the wall."""
    found = []
    for contour in range(1, contours + 1):
        own = [r for r in records if r.contour == contour]
        last = max([r.number for r in own], default=0)
        mine = np.zeros(len(time_s), np.bool_)
        for record in own:
            if record.number == last:
                mine |= (time_s > record.begin_s) & (time_s <= record.end_s)
        found.append(tuple(way[mine] for way in ways_um))
    return found


def pass_figures(simulation: Simulation) -> tuple[report.PassFigures, ...]:
    """Return what every pass of a cut did; none of a cut in one pass."""
    records = simulation.passes.records
    return tuple(
        figures
        for piece in dict.fromkeys((r.contour, r.piece) for r in records)
        for figures in _figures_of([r for r in records if (r.contour, r.piece) == piece], simulation)
    )


def _figures_of(records: list[PassRecord], simulation: Simulation) -> list[report.PassFigures]:
    """Return the figures of the passes along one piece, which follow each other on the same face."""
    machines = [simulation.machine_of(record.number) for record in records]
    walls = [unknown_wall(()) if r.wall is None else r.wall for r in records]
    lefts = [wall.mean_um for wall in walls]
    taken = [math.nan, *(before - now for before, now in pairwise(lefts))]
    volumes = [r.sums.crater_um3 / max(r.sums.spark + r.sums.arc, 1) for r in records]
    faces = face_roughness_um(volumes, taken, machines[0].base.discharge.crater_flatness.value)
    found, heated = [], math.nan
    for record, machine, wall, took, ra_um in zip(records, machines, walls, taken, faces, strict=True):
        own_um = heat_affected_um(machine, _discharge_us(machine, record.sums))
        heated = own_um if record is records[0] else float(np.maximum(own_um, heated - took))
        length_mm, seconds = (record.end_um - record.begin_um) * 1e-3, record.end_s - record.begin_s
        face_mm2 = _area_mm2(simulation, record.begin_um, record.end_um)
        left, pulses = wall.mean_um, max(record.sums.pulses, 1)
        found.append(report.PassFigures(
            record.contour, record.number, record.piece, record.reversed, record.begin_s, record.end_s, length_mm,
            60 * face_mm2 / seconds if seconds > 0 else math.nan, record.offset_um,
            record.offset_um - left, left, took, wall.straightness_um, wall.bow_um, wall.ripple_um, wall.ripple_mm,
            list(wall.slices_um), ra_um, heated, record.sums.short / pulses, record.sums.open / pulses,
        ))  # fmt: skip
    return found


def _discharge_us(machine: Machine, sums: Sums) -> float:
    """Return how long the discharges of a cut or a pass burnt on average, by their energy; 0 if there were none."""
    power_W = machine.material.burning_voltage_V.value * discharge_current_A(machine)
    return sums.energy / (max(sums.spark + sums.arc, 1) * power_W) * 1e6


def _shares(
    simulation: Simulation, profiles: list[ProfileError], ways_um: list[tuple[NDArray[np.float64], ...]]
) -> list[NDArray[np.float64] | None]:
    """Split the profile error; not where the wire's centre runs on the edge itself, or leans."""
    records, contours = simulation.passes.records, simulation.path.contours
    last_cut = [max((r.number for r in records if r.contour == k), default=None) for k in range(1, len(contours) + 1)]
    return [
        causes.error_shares(profile, contour, ways, last) if contour.offset_um and contour.lean is None else None
        for profile, contour, ways, last in zip(profiles, contours, ways_um, last_cut, strict=True)
    ]


def terraces(relief: Relief | None, stock_mm: tuple[float, float, float, float]) -> tuple[Terrace, ...]:
    """Return the levels of a stepped workpiece from the lowest up; none if it is as high everywhere."""
    if relief is None:
        return ()
    blank = shapely.box(*stock_mm)
    lower = [(shapely.transform(face, lambda um: um * 1e-3), height) for face, height in relief.faces_um]
    rest = blank.difference(shapely.union_all([face for face, _ in lower]))
    faces = [(face.intersection(blank), height) for face, height in [*lower, (rest, relief.height_mm)]]
    return tuple(Terrace(polylines(face), height) for face, height in faces if face.area > 0)


def holes_mm(stock: Stock) -> NDArray[np.float64]:
    """Return the holes (n, 3) of a blank before the first spark: centres and radii."""
    return np.array(stock.holes_um, np.float64).reshape(-1, 3) * 1e-3


def _table(simulation: Simulation, profiles: list[ProfileError]) -> report.TableShare | None:
    """Return what the table's errors do to the part; None for a perfect table that nothing compensates."""
    machine, elcam, contours = simulation.machine, simulation.elcam, simulation.path.contours
    compensated = elcam is not None and any(table.corrects for table in elcam.tables.values())
    if not compensated and not machine.base.geometry.has_errors:
        return None
    starts = np.cumsum([0.0, *(k.length_um for k in contours[:-1])]).tolist()
    places = zip(contours, profiles, starts, strict=True)
    found = [causes.table_error(machine, k, p, elcam, start_um) for k, p, start_um in places]
    cut = [np.isfinite(p.mean_um) for p in profiles]  # only where there is an edge that was cut
    bare = [p.error_um + (t.without_um - t.left_um) for p, t in zip(profiles, found, strict=True)]
    return report.TableShare(
        without_um=_spread([t.without_um[k] for t, k in zip(found, cut, strict=True)]),
        left_um=_spread([t.left_um[k] for t, k in zip(found, cut, strict=True)]),
        profile_without_um=_spread([b.ravel() for b in bare]),
        compensated=compensated,
    )


def _spread(errors_um: list[NDArray[np.float64]]) -> report.Spread:
    return report.Spread(**error_stats(np.concatenate(errors_um)))


def _part(
    simulation: Simulation, profiles: list[ProfileError], scene: Scene, left_um: list[NDArray[np.float64]],
    table: report.TableShare | None,
) -> report.Report:
    field, machine, sums = simulation.plant.field, simulation.machine, simulation.sums
    contours = tuple(contour.at_mid_height() for contour in simulation.path.contours)
    widths = [kerf_width(field, k, machine.wire_diameter_um) for k in simulation.path.contours]
    kerf = report.Kerf(**width_stats(np.concatenate([w.width_um.ravel() for w in widths])))
    ignited = sums.spark + sums.arc
    flatness = machine.base.discharge.crater_flatness.value
    heated_um = heat_affected_um(machine, _discharge_us(machine, sums)) if ignited else None
    origin_mm = simulation.path.origin_mm
    passes = pass_figures(simulation)
    last = max(passes, key=_as_last, default=None)
    offset_mm = math.nan if simulation.path.offset_um is None else simulation.path.offset_um * 1e-3
    finished = [
        of_one for number, of_one in enumerate(zip(contours, profiles, left_um, strict=True), 1)
        if _is_finished(number, of_one[0], simulation.passes.records)
    ]
    mean_um = causes.mean_error_um(*(zip(*finished, strict=True) if finished else ((), (), ())))
    elements = (
        found
        for number, of_contour in enumerate(zip(contours, profiles, left_um, strict=True), 1)
        for found in element_errors(number, *of_contour)
    )
    return report.Report(
        origin_mm=report.Origin(*origin_mm), kerf_um=kerf, kerf_section=_section(widths, machine.height_mm),
        profile_error_um=_profile_errors(contours, profiles, left_um, scene, origin_mm),
        offset=report.Offset(offset_mm, mean_um, round(offset_mm - mean_um * 1e-3, 4)),
        elements=[_element(found, origin_mm) for found in elements], table_error_um=table,
        corners=[
            report.Corner(c.x_mm - origin_mm[0], c.y_mm - origin_mm[1], c.x_mm, c.y_mm, c.turn_deg, c.error_um)
            for c in scene.corners
        ],
        heights=_heights(profiles, machine.height_mm), passes=list(passes),
        surface=report.Surface(
            last.ra_um if last else roughness_um(sums.crater_um3 / ignited, flatness) if ignited else None,
            last.heat_affected_um if last else heated_um,
            _electrolysed_um(simulation, kerf),
        ),
    )  # fmt: skip


def _is_finished(number: int, contour: WireContour, records: Sequence[PassRecord]) -> bool:
    """Say whether all passes of a contour have been cut; the wall of one without passes is as it will be."""
    return sum(r.contour == number and r.wall is not None for r in records) == len(contour.passes)


def _as_last(one: report.PassFigures | PassRecord) -> tuple[bool, float]:
    """Rank passes: the face of the part is that of the greatest."""
    return one.piece == "profile", one.end_s


def _electrolysed_um(simulation: Simulation, kerf: report.Kerf) -> float | None:
    """Return the depth that the water dissolved: in passes, in the last one, as trims take more than a layer."""
    sums, length_um = simulation.sums, simulation.path_um
    gap_um = ((math.nan if kerf.mean is None else kerf.mean) - simulation.machine.wire_diameter_um) / 2
    if simulation.passes.records:
        last = max(simulation.passes.records, key=_as_last)
        sums, length_um = last.sums, last.end_um - last.begin_um
        left_um = math.nan if last.wall is None else last.wall.mean_um
        gap_um = last.offset_um - left_um - simulation.machine.wire_diameter_um / 2
    return electrolysed_um(simulation.machine, sums.voltage_s / (length_um * 1e-3), gap_um) if length_um else None


def _heights(profiles: list[ProfileError], height_mm: float) -> list[report.HeightError]:
    """Return the profile error slice by slice, over all contours."""
    error_um = np.concatenate([p.error_um for p in profiles], axis=1)
    slice_mm = height_mm / len(error_um)
    found = []
    for number, row in enumerate(error_um):
        known = row[np.isfinite(row)]
        mean, rms = (float(known.mean()), float(np.sqrt(np.mean(known**2)))) if len(known) else (math.nan, math.nan)
        found.append(report.HeightError((number + 0.5) * slice_mm, mean, rms))
    return found


def _share_stats(scene: Scene) -> dict[str, dict[str, float]] | None:
    split = [(edge.shares_um, edge.error_um) for edge in scene.maps if edge.shares_um is not None]
    if not split:
        return None
    return causes.share_stats(np.concatenate([s for s, _ in split], axis=1), np.concatenate([e for _, e in split]))


def _section(widths: list[KerfWidth], height_mm: float) -> list[report.KerfSlice]:
    """Put the walls measured along all contours together, slice by slice."""
    part = np.concatenate([w.part_um for w in widths], axis=1)
    rest = np.concatenate([w.width_um for w in widths], axis=1) - part
    slice_mm = height_mm / len(part)
    return [
        report.KerfSlice((number + 0.5) * slice_mm, int(np.isfinite(ours).sum()), _wall(ours), _wall(others))
        for number, (ours, others) in enumerate(zip(part, rest, strict=True))
    ]


def _wall(distance_um: NDArray[np.float64]) -> report.Wall:
    known = distance_um[np.isfinite(distance_um)]
    if not len(known):
        return report.Wall()
    low, high = np.percentile(known, (5, 95))
    return report.Wall(float(known.mean()), float(low), float(high))


def _error_per_window(guides_um: NDArray[np.float64], profiles: list[ProfileError]) -> NDArray[np.float64]:
    """Profile error at the point of the edge nearest to the wire, window by window."""
    from scipy.spatial import KDTree

    points = np.concatenate([p.points_mm for p in profiles])
    error = np.append(np.concatenate([p.mean_um for p in profiles]), np.nan)
    _, nearest = KDTree(points).query(guides_um * 1e-3, distance_upper_bound=_WINDOW_REACH_MM)
    return np.asarray(error[nearest])
