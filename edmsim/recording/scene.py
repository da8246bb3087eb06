"""The geometry of figures and recordings: the drawing, the remaining metal, the error between them.

It is stored in ``part.npz``, so that figures can be made again from a cut's folder.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.files import make_writable, read_arrays, replacing
from edmsim.geometry import CORNER_DEG, Floats, arc_lengths, interpolated, left_of
from edmsim.metrology.edges import filled
from edmsim.metrology.error_budget import SHARES
from edmsim.metrology.profile import CornerError
from edmsim.plant.workpiece.height_steps import Relief, middle_slice
from edmsim.plant.workpiece.kerf_field import Stock

SPECK_SHARE = 0.01  # of the wire's cross-section; less is a speck (ours: a crater or two; any kerf is larger)
Polylines = tuple[Floats, ...]  # lines of shape (n, 2) in mm on the table


@dataclass(frozen=True, eq=False)
class ErrorMap:
    """One nominal edge and the profile error along it."""

    nominal_mm: Floats  # (m, 2): the part's edge as drawn, mm on the table
    part_side: Literal["left", "right"]  # side of the part, looking along the edge
    points_mm: Floats  # (n, 2): measured places; n may be 0
    # (n,): mean profile error over the height: positive is metal left on the part; NaN if unknown
    error_um: Floats
    # (5, n): its shares by cause (`edmsim.metrology.error_budget.error_shares`), if known
    shares_um: Floats | None = None
    unreachable_um: Floats | None = None  # (n,): metal that the round wire cannot reach, if known
    face_um: Floats | None = None  # (slices, n): profile error of every slice from the lowest, if known

    def reached_um(self) -> Floats:
        """Return the error (n,) within the wire's reach; NaN elsewhere."""
        if self.unreachable_um is None:
            return self.error_um
        return np.where(self.unreachable_um == 0, self.error_um, np.nan)

    def outward(self) -> Floats:
        """Return unit vectors (n, 2) away from the part at `points_mm`, smooth across corners."""
        if len(self.points_mm) < 2:
            return np.zeros_like(self.points_mm)
        normal = left_of(np.gradient(self.points_mm, axis=0)) * (1.0 if self.part_side == "right" else -1.0)
        length = np.hypot(normal[:, 0], normal[:, 1])[:, None]
        return np.asarray(np.divide(normal, length, out=np.zeros_like(normal), where=length > 0))

    def exaggerated_mm(self, factor: float) -> Floats:
        """Return the edge (n, 2) in mm, its error multiplied by `factor`; NaN out of the wire's reach."""
        return np.asarray(self.points_mm + self.outward() * (self.reached_um() * factor / 1000.0)[:, None])

    def pieces(self, factor: float) -> tuple[Floats, Floats]:
        """Return the pieces (m, 2, 2) of `exaggerated_mm` and their errors (m,), without corners and NaN."""
        shown, normal, error = self.exaggerated_mm(factor), self.outward(), self.reached_um()
        begin = np.arange(len(shown) if np.allclose(self.nominal_mm[0], self.nominal_mm[-1]) else len(shown) - 1)
        end = (begin + 1) % max(len(shown), 1)  # a closed edge ends where it begins
        mean = (error[begin] + error[end]) / 2
        smooth = np.einsum("ij,ij->i", normal[begin], normal[end]) > np.cos(np.radians(CORNER_DEG))
        known = smooth & np.isfinite(mean)
        return np.stack([shown[begin], shown[end]], axis=1)[known], mean[known]

    def out_of_reach_mm(self) -> Polylines:
        """Return the sections of the edge in mm that the round wire cannot reach."""
        if self.unreachable_um is None:
            return ()
        away = self.unreachable_um > 0
        edges = np.flatnonzero(np.diff(away)) + 1
        runs = np.split(np.arange(len(away)), edges)
        return tuple(self.points_mm[run] for run in runs if len(run) > 1 and away[run[0]])


@dataclass(frozen=True, eq=False)
class Terrace:
    """Upper faces of a stepped workpiece at one height: their outlines, and the height in mm."""

    outlines_mm: Polylines
    height_mm: float


@dataclass(frozen=True, eq=False)
class PassFace:
    """The cut face of a contour as a pass left it."""

    contour: int  # number of its map, from 0
    time_s: float  # time_s, path_um: machine time and length of path at its end
    path_um: float
    points_mm: Floats  # (n, 2): places of the nominal edge, at mid height if the wall leans
    error_um: Floats  # (slices, n): profile error, from the lowest slice: positive is metal left


@dataclass(frozen=True, eq=False)
class Scene:
    """The drawing of one cut."""

    maps: tuple[ErrorMap, ...]  # one per contour, in cutting order
    cut_edges_mm: tuple[Polylines, ...]  # edges of the remaining metal, per slice from the bottom
    corners: tuple[CornerError, ...]
    starts_mm: Floats  # (k, 2): start holes
    stock_mm: tuple[float, float, float, float]  # the blank on the table
    height_mm: float  # greatest height of the workpiece
    guides_z_mm: tuple[float, float]  # heights of the wire guides over the workpiece's bottom; the lower is negative
    wire_diameter_um: float
    # place of the wire at mid height when the machine stopped; None if the cut finished
    stop_mm: tuple[float, float] | None = None
    # levels of a stepped workpiece, from the lowest; empty if its height is constant
    terraces: tuple[Terrace, ...] = ()
    # (n, 3): centres and radii of the holes in the blank before the first spark; a slot is a row of holes
    holes_mm: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    cut: str | None = None  # identity of the cut: `edmsim.recording.report.cut_id`
    origin_mm: tuple[float, float] | None = None  # the program's zero on the table; None without a program
    # if the wire leans, for points of the path: length of path in um, u and v in mm, and the heights in mm at which
    # the wire bends at the lower and the upper guide
    lead: Floats | None = None
    walls_mm: tuple[Polylines, ...] = ()  # edges of tapered contours as drawn on the lower and the upper face
    pass_faces: tuple[PassFace, ...] = ()  # faces after each pass, in order

    def lead_mm(self, path_um: Floats, heights_mm: Floats) -> Floats:
        """Return the wire's distance in mm (n, heights, 2) from the lower guide's axis, by lengths of path."""
        if self.lead is None:
            return np.zeros((len(path_um), len(heights_mm), 2))
        along, *known = self.lead.T
        u, v, low, high = (np.interp(path_um, along, column)[:, None] for column in known)
        share = (heights_mm[None, :] - low) / (high - low)
        return np.stack([share * u, share * v], axis=2)

    def axis_um(self, guides_um: Floats, path_um: Floats, height_mm: float | None = None) -> Floats:
        """Return the guides' axis in um (n, 2), by default at mid height, from lower guide and lengths of path."""
        at_mm = 0.5 * self.height_mm if height_mm is None else height_mm
        return np.asarray(guides_um + 1e3 * self.lead_mm(path_um, np.array([at_mm]))[:, 0])

    def as_drawn_mm(self, height_mm: float) -> list[Floats]:
        """Return the contours' edges as drawn at a height."""
        share = height_mm / self.height_mm
        walls = [(1 - share) * below + share * above for below, above in self.walls_mm]
        return walls or [edge.nominal_mm for edge in self.maps]

    @property
    def speck_mm2(self) -> float:
        """Areas below this are specks: single craters next to the kerf, or crumbs of metal in it."""
        return SPECK_SHARE * math.pi / 4 * (self.wire_diameter_um * 1e-3) ** 2

    def __repr__(self) -> str:
        """Return counts and the blank's size instead of all points."""
        x0, y0, x1, y1 = self.stock_mm
        return (
            f"<Scene: {len(self.maps)} contours, {len(self.corners)} corners, {len(self.cut_edges_mm)} slices, "
            f"blank {x1 - x0:.1f} x {y1 - y0:.1f} x {self.height_mm:g} mm>"
        )

    def in_program(self) -> "Scene":
        """Return the scene in the program's coordinates, its origin at zero; unchanged without a program."""
        if self.origin_mm is None:
            return self
        by = np.array(self.origin_mm)
        (dx, dy), (x0, y0, x1, y1) = self.origin_mm, self.stock_mm
        return replace(
            self,
            maps=tuple(replace(m, nominal_mm=m.nominal_mm - by, points_mm=m.points_mm - by) for m in self.maps),
            cut_edges_mm=tuple(tuple(line - by for line in lines) for lines in self.cut_edges_mm),
            corners=tuple(replace(c, x_mm=c.x_mm - dx, y_mm=c.y_mm - dy) for c in self.corners),
            starts_mm=self.starts_mm.reshape(-1, 2) - by,
            holes_mm=self.holes_mm - (dx, dy, 0.0),
            stock_mm=(x0 - dx, y0 - dy, x1 - dx, y1 - dy),
            stop_mm=None if self.stop_mm is None else (self.stop_mm[0] - dx, self.stop_mm[1] - dy),
            terraces=tuple(replace(t, outlines_mm=tuple(p - by for p in t.outlines_mm)) for t in self.terraces),
            walls_mm=tuple(tuple(line - by for line in lines) for lines in self.walls_mm),
            pass_faces=tuple(replace(face, points_mm=face.points_mm - by) for face in self.pass_faces),
            origin_mm=(0.0, 0.0),
        )

    def at_middle(self) -> "Scene":
        """Return the scene with edges, errors and corners of a tapered, stepped part at the height `middle_mm`."""
        # they are known at half the greatest height, where a lower level has no metal
        if not (self.walls_mm and self.terraces):
            return self
        drawn_mm = self.as_drawn_mm(self.middle_mm())
        known_mm, moved_mm = (np.concatenate(lines) for lines in ([m.nominal_mm for m in self.maps], drawn_mm))
        corners = []
        for corner in self.corners:
            x, y = moved_mm[np.hypot(*(known_mm - (corner.x_mm, corner.y_mm)).T).argmin()].tolist()
            corners.append(replace(corner, x_mm=x, y_mm=y))
        maps = []
        for edge, there in zip(self.maps, drawn_mm, strict=True):
            along = shapely.line_locate_point(shapely.LineString(edge.nominal_mm), shapely.points(edge.points_mm))
            points = interpolated(along, arc_lengths(edge.nominal_mm), there)
            maps.append(replace(edge, nominal_mm=there, points_mm=points))
        return replace(self, maps=tuple(maps), corners=tuple(corners))

    def bored(self) -> shapely.Geometry:
        """Return the area of the holes."""
        return shapely.union_all([shapely.Point(x, y).buffer(radius) for x, y, radius in self.holes_mm])

    def kerf(self) -> shapely.Geometry:
        """Return the area cut at mid height: within the edges of `middle_edges_mm`, by the even-odd rule."""
        return filled(shapely.MultiLineString([line for line in self.middle_edges_mm() if len(line) > 1]))

    def axis_labels(self) -> tuple[str, str]:
        """Return the figures' axis labels."""
        whose = "on the table" if self.origin_mm is None else "of the program"
        return f"X {whose}, mm", f"Y {whose}, mm"

    def extent_mm(self) -> tuple[float, float, float, float]:
        """Return the box (x_min, y_min, x_max, y_max) of nominal edges, start holes and stop place."""
        stop_mm = np.reshape(self.stop_mm or (), (-1, 2))
        points = np.concatenate([*(m.nominal_mm for m in self.maps), self.starts_mm.reshape(-1, 2), stop_mm])
        if len(points) == 0:
            return self.stock_mm
        (x0, y0), (x1, y1) = points.min(axis=0), points.max(axis=0)
        return float(x0), float(y0), float(x1), float(y1)

    def size_mm(self) -> float:
        """Return the largest of the drawing's sides and the workpiece height in mm."""
        x0, y0, x1, y1 = self.extent_mm()
        return max(x1 - x0, y1 - y0, self.height_mm)

    def middle_slice(self) -> int:
        """Return the number of the slice at half the lowest level's height, which has metal everywhere."""
        lowest_mm = self.terraces[0].height_mm if self.terraces else self.height_mm
        return middle_slice(lowest_mm, self.height_mm, len(self.cut_edges_mm))

    def middle_edges_mm(self) -> Polylines:
        """Return the edges of the remaining metal in the `middle_slice`."""
        return self.cut_edges_mm[self.middle_slice()] if self.cut_edges_mm else ()

    def middle_mm(self) -> float:
        """Return the height in mm of the middle of the `middle_slice` over the workpiece's bottom."""
        return (self.middle_slice() + 0.5) * self.height_mm / max(len(self.cut_edges_mm), 1)

    def middle_text(self) -> str:
        """Return in words how high the `middle_slice` is."""
        return f"{self.middle_mm():.3g} mm high" if self.terraces else "mid height"

    def known_errors(self) -> Floats:
        """Return the profile errors of all contours in um within the wire's reach."""
        known = [m.reached_um() for m in self.maps]
        return np.concatenate([np.zeros(0), *(error[np.isfinite(error)] for error in known)])

    def error_limit_um(self) -> float:
        """Return the profile error at the ends of the colour scale: the 99th percentile, at least 0.1 um."""
        known = self.known_errors()
        return max(float(np.percentile(np.abs(known), 99)), 0.1) if len(known) else 0.1

    def error_factor(self) -> float:
        """Return the factor by which to enlarge the error: a round number, 1 without an error."""
        x0, y0, x1, y1 = self.extent_mm()
        return round_factor(self.known_errors(), 0.035 * max(x1 - x0, y1 - y0))


def terraces(relief: Relief | None, stock_mm: tuple[float, float, float, float]) -> tuple[Terrace, ...]:
    """Return the levels of a stepped workpiece from the lowest up; none if its height is constant."""
    if relief is None:
        return ()
    blank = shapely.box(*stock_mm)
    lower = [(shapely.transform(face, lambda um: um * 1e-3), height) for face, height in relief.faces_um]
    rest = blank.difference(shapely.union_all([face for face, _ in lower]))
    faces = [(face.intersection(blank), height) for face, height in [*lower, (rest, relief.height_mm)]]
    return tuple(Terrace(polylines(face), height) for face, height in faces if face.area > 0)


def holes_mm(stock: Stock) -> Floats:
    """Return the holes (n, 3) of a blank before the first spark: centres and radii."""
    return np.array(stock.holes_um, np.float64).reshape(-1, 3) * 1e-3


def polylines(geometry: shapely.Geometry | Sequence[shapely.Geometry]) -> Polylines:
    """Return the lines of a geometry in mm, simplified within half a um; of polygons, their rings."""
    parts = shapely.get_parts(np.atleast_1d(np.asarray(geometry, dtype=object)))
    polygons = shapely.get_type_id(parts) == shapely.GeometryType.POLYGON
    lines = np.concatenate([parts[~polygons], shapely.get_rings(parts[polygons])])
    thin = shapely.simplify(lines, 0.0005)
    return tuple(shapely.get_coordinates(line) for line in thin if not line.is_empty)


def grid_triangles(rows: int, columns: int) -> NDArray[np.int64]:
    """Return the triangles (n, 3) of a grid, as indices of its points row by row."""
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    return np.concatenate([np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, c), (a, c, d))])


def round_factor(values_um: Floats, shown_mm: float) -> float:
    """Return the round factor, at least 1, with which the 99th percentile is drawn about `shown_mm` long."""
    finite = np.abs(values_um[np.isfinite(values_um)])
    large = float(np.percentile(finite, 99)) if len(finite) else 0.0
    if large == 0.0:
        return 1.0
    return round_number(max(shown_mm * 1000.0 / large, 1.0))


def round_number(limit: float) -> float:
    """Return the largest number not above `limit`, a positive number, that is 1, 2 or 5 times a power of ten."""
    decade = 10.0 ** np.floor(np.log10(limit))
    return float(max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= limit * (1 + 1e-12)))


VERSION = 4  # of the file's layout
_FIELDS = "stock_mm", "height_mm", "guides_z_mm", "wire_diameter_um", "stop_mm", "origin_mm", "cut"


def write_scene(scene: Scene, file: str | Path) -> None:
    """Write a scene and make its folder; an existing file is replaced only when complete."""
    document = {
        "version": VERSION, **{name: getattr(scene, name) for name in _FIELDS},
        "part_sides": [edge.part_side for edge in scene.maps],
        "terrace_heights_mm": [terrace.height_mm for terrace in scene.terraces],
    }
    corners = [(c.x_mm, c.y_mm, c.turn_deg, c.error_um) for c in scene.corners]
    arrays = {
        **_flat("nominal", [[edge.nominal_mm] for edge in scene.maps]),
        **_flat("measured", [[_columns(edge)] for edge in scene.maps]),
        **_flat("edges", scene.cut_edges_mm),
        **_flat("walls", scene.walls_mm),
        "lead": np.zeros((0, 5)) if scene.lead is None else scene.lead,
        **_flat("passes", [[np.column_stack([face.points_mm, face.error_um.T])] for face in scene.pass_faces]),
        "pass_ends": np.reshape([(f.contour, f.time_s, f.path_um) for f in scene.pass_faces], (-1, 3)),
        **_flat("terraces", [terrace.outlines_mm for terrace in scene.terraces]),
        "corners": np.reshape(np.array(corners, float), (-1, 4)),
        "starts_mm": scene.starts_mm, "holes_mm": scene.holes_mm,
        **{
            f"unreachable.{number}": edge.unreachable_um
            for number, edge in enumerate(scene.maps) if edge.unreachable_um is not None
        },
        **{f"face.{number}": edge.face_um for number, edge in enumerate(scene.maps) if edge.face_um is not None},
        "fields": np.frombuffer(json.dumps(document).encode(), np.uint8),
    }
    make_writable(Path(file).parent)
    with replacing(file) as partial, partial.open("wb") as opened:
        np.savez_compressed(opened, allow_pickle=False, **arrays)


def _columns(edge: ErrorMap) -> Floats:
    """Return places, error and shares by cause as columns; shares of contours that were not split are NaN."""
    unknown = np.full((len(SHARES), len(edge.points_mm)), np.nan)
    return np.column_stack([edge.points_mm, edge.error_um, *(unknown if edge.shares_um is None else edge.shares_um)])


def read_scene(file: str | Path) -> Scene:
    """Read a ``part.npz``; raises `InputError` if the file is missing, damaged, or of another layout."""
    try:
        arrays = read_arrays(Path(file).read_bytes())
        document = json.loads(arrays["fields"].tobytes())
        if document["version"] != VERSION:
            raise InputError(f"written in layout {document['version']}, layout {VERSION} is needed: cut again", file)
        return _scene(arrays, document)
    except FileNotFoundError:
        raise InputError("no such file, a part.npz written by a cut is needed", file) from None
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError, OverflowError) as error:
        raise InputError(f"damaged, a part.npz written by a cut is needed ({error})", file) from None


def _scene(arrays: Mapping[str, NDArray[Any]], document: Mapping[str, Any]) -> Scene:
    measured = [lines[0] for lines in _groups(arrays, "measured")]
    nominal = [lines[0] for lines in _groups(arrays, "nominal")]
    plain = ((name, document[name]) for name in _FIELDS)
    fields: dict[str, Any] = {name: tuple(value) if isinstance(value, list) else value for name, value in plain}
    return Scene(
        maps=tuple(
            ErrorMap(
                line, side, rows[:, :2], rows[:, 2], rows[:, 3:].T if np.isfinite(rows[:, 3:]).any() else None,
                arrays.get(f"unreachable.{number}"), arrays.get(f"face.{number}"),
            )
            for number, (line, side, rows) in enumerate(zip(nominal, document["part_sides"], measured, strict=True))
        ),
        cut_edges_mm=_groups(arrays, "edges"),
        corners=tuple(CornerError(*(float(v) for v in row)) for row in arrays["corners"]),
        starts_mm=arrays["starts_mm"],
        terraces=tuple(
            Terrace(lines, height)
            for lines, height in zip(_groups(arrays, "terraces"), document["terrace_heights_mm"], strict=True)
        ),
        holes_mm=arrays["holes_mm"].reshape(-1, 3),
        lead=arrays["lead"] if len(arrays["lead"]) else None,
        walls_mm=_groups(arrays, "walls"),
        pass_faces=tuple(
            PassFace(int(contour), float(time_s), float(path_um), rows[:, :2], rows[:, 2:].T)
            for (contour, time_s, path_um), (rows,) in zip(
                arrays["pass_ends"], _groups(arrays, "passes"), strict=True
            )
        ),
        **fields,
    )


def _flat(name: str, groups: Sequence[Sequence[Floats]]) -> dict[str, NDArray[Any]]:
    """Return groups of lines as three arrays: all points, number of points per line, number of lines per group."""
    lines = [line for group in groups for line in group]
    return {
        f"{name}.points": np.concatenate(lines) if lines else np.zeros((0, 2)),
        f"{name}.lengths": np.array([len(line) for line in lines], np.int64),
        f"{name}.groups": np.array([len(group) for group in groups], np.int64),
    }


def _groups(arrays: Mapping[str, NDArray[Any]], name: str) -> tuple[Polylines, ...]:
    points, lengths, groups = (arrays[f"{name}.{part}"] for part in ("points", "lengths", "groups"))
    counts = np.concatenate([lengths, groups])
    if counts.dtype.kind != "i" or (counts < 0).any() or lengths.sum() != len(points) or groups.sum() != len(lengths):
        raise ValueError(f"the lines of {name} do not add up")
    lines = iter(np.split(points, np.cumsum(lengths)[:-1]) if len(lengths) else [])
    return tuple(tuple(next(lines) for _ in range(count)) for count in groups)
