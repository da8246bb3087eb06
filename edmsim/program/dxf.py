"""DXF drawings read into closed outlines.

Read are LINE, ARC, CIRCLE, LWPOLYLINE, POLYLINE (2D), SPLINE and ELLIPSE in model space and in blocks (INSERT), on
any layer that is on. Loose ends within 5 um are joined. A closed contour that lies in no other, or in an even number
of others, is an outside (the part is within); in an odd number, a hole. The cut runs with the part on its left:
outsides counter-clockwise, holes clockwise. It begins where the contour's first entity in the file begins. Inner
contours come first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.program.arcs import CHORD_TOLERANCE_UM
from edmsim.program.crossing import refuse_self_crossing
from edmsim.program.drawn import Drawn
from edmsim.program.limits import FARTHEST_MM, check_contours, check_count, check_points, check_size
from edmsim.program.outline import JOIN_TOLERANCE_MM, Outline, Program, signed_area
from edmsim.program.splines import spline_points

if TYPE_CHECKING:
    from ezdxf.document import Drawing

UNIT_MM = {1: 25.4, 2: 304.8, 4: 1.0, 5: 10.0, 6: 1000.0, 9: 0.0254, 13: 0.001, 14: 100.0}
"""Millimetres per drawing unit by the header's $INSUNITS (DXF reference, code 70)."""

UNITS = {"in": 1, "ft": 2, "mm": 4, "cm": 5, "m": 6, "mil": 9, "um": 13}
"""Names of units, with their codes in the header."""

LEAST_EXTENT_MM = 0.5
"""A drawing that spans less has another unit than it says (ours: nothing smaller is cut with a wire)."""

_HARMLESS = frozenset({
    "TEXT", "MTEXT", "ATTDEF", "DIMENSION", "ARC_DIMENSION", "LEADER", "MULTILEADER", "TOLERANCE", "POINT",
    "HATCH", "IMAGE", "WIPEOUT", "VIEWPORT", "XLINE", "RAY", "PDFUNDERLAY", "OLE2FRAME", "ATTRIB",
})  # fmt: skip
_OUTERMOST: dict[str, Callable[[Any], Iterable[Any]]] = {
    "LINE": lambda entity: (entity.dxf.start, entity.dxf.end),
    "CIRCLE": lambda entity: _box(entity.dxf.center, entity.dxf.radius),
    "ARC": lambda entity: (entity.start_point, entity.end_point),
    "ELLIPSE": lambda entity: _box(entity.dxf.center, entity.dxf.major_axis.magnitude),
    "SPLINE": lambda entity: (*entity.control_points, *entity.fit_points),
}
"""Points between which an entity lies, or that its length follows from."""
_SHAPES = "lines, arcs, circles, polylines, splines or ellipses"
_FLAT = 0.9999


@dataclass(frozen=True)
class _Chain:
    """Points (n, 2) in mm of one entity or of several joined, and which line or arc each of the chords belongs to."""

    points: NDArray[np.float64]
    elements: NDArray[np.int64]

    @classmethod
    def of(cls, pieces: Sequence[NDArray[np.float64]]) -> _Chain:
        """Join the lines and arcs of an entity, which follow each other."""
        if not pieces:
            return cls(np.empty((0, 2)), np.empty(0, np.int64))
        points = np.concatenate([pieces[0], *(piece[1:] for piece in pieces[1:])])
        return cls(points, np.repeat(np.arange(len(pieces)), [len(piece) - 1 for piece in pieces]))

    def reversed(self) -> _Chain:
        """Return it run through from its end."""
        return _Chain(self.points[::-1], self.elements[::-1])

    @property
    def closed(self) -> bool:
        return float(np.hypot(*(self.points[0] - self.points[-1]))) <= JOIN_TOLERANCE_MM


def read_dxf(file: str | Path, layers: Sequence[str] = (), unit: str | None = None) -> Program:
    """Read a drawing.

    Parameters
    ----------
    file : path
        The drawing, any DXF version.
    layers : sequence of str
        Only these are cut; by default all that are on and not frozen.
    unit : {"mm", "um", "cm", "m", "in", "ft", "mil"}, optional
        Unit of the drawing; by default what its header says.

    Returns
    -------
    Program
        One closed outline per contour, holes before what is around them; the wire goes on the right.

    Raises
    ------
    InputError
        Not a DXF drawing, a layer or unit that there is not,
        an entity that cannot be cut, a contour that is open, branches, or meets another.
    """
    path = Path(file)
    try:
        outlines, notices = _outlines_of(_document(path), layers, unit)
    except InputError as error:
        raise InputError(error.reason, path) from None
    return Program(tuple(outlines), tuple(notices), str(path))


def _document(path: Path) -> Drawing:
    from ezdxf.filemanagement import readfile

    if path.is_dir():
        raise InputError("this is a directory: give the path of a DXF drawing")
    if not path.exists():
        raise InputError("no such file: give the path of a DXF drawing")
    check_size(path)
    with _read("this is not a DXF drawing that can be read"):
        return readfile(path)


@contextmanager
def _read(what: str) -> Iterator[None]:
    """Say in one line what cannot be read: on damaged drawings the library lets errors of any kind through."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        told = " ".join(ascii(str(error))[1:-1].split())[:200] or type(error).__name__
        raise InputError(f"{what} ({told}): export it as DXF again") from None


def _outlines_of(
    document: Drawing, layers: Sequence[str], unit: str | None
) -> tuple[list[Outline], list[str]]:
    with _read("its contents cannot be read"):
        unit_mm, notices = _unit(document, unit)
        chains = list(_chains(Drawn(document, layers), unit_mm, notices))
    if not chains:
        raise InputError(f"nothing to cut: draw {_SHAPES} in model space")
    check_count(sum(len(chain.points) for chain in chains))
    hint = f"; the drawing's unit is {unit_mm:g} mm: is that what was meant? If not, give --unit"
    low, high = (np.array([end(chain.points, axis=0) for chain in chains]) for end in (np.min, np.max))
    check_points(np.array([low.min(axis=0), high.max(axis=0)]), "the drawing", hint)
    extent = float((high.max(axis=0) - low.min(axis=0)).max())
    if extent < LEAST_EXTENT_MM:
        raise InputError(f"the drawing spans {extent:.3g} mm: a wire cuts nothing under {LEAST_EXTENT_MM:g} mm{hint}")
    contours = _join(_without_duplicates(chains, notices))
    check_contours(len(contours))
    for number, points in enumerate((contour.points for contour in contours), 1):
        refuse_self_crossing(points, (0,) * (len(points) - 1))
        if abs(signed_area(points)) < JOIN_TOLERANCE_MM**2:
            raise InputError(f"contour {number} at {_place(points[0])} encloses nothing: draw it closed")
    return _nested(contours), notices


def _unit(document: Drawing, given: str | None) -> tuple[float, list[str]]:
    code = int(document.header.get("$INSUNITS", 0))
    if given is not None:
        if given not in UNITS:
            raise InputError(f"the unit is {given!r}: give one of {', '.join(UNITS)}")
        said = f", though the drawing says {UNIT_MM[code]:g} mm" if code in UNIT_MM and code != UNITS[given] else ""
        return UNIT_MM[UNITS[given]], [f"the drawing is read in {given}, as asked{said}"]
    if code == 0:
        return 1.0, ["the drawing sets no unit ($INSUNITS): it is read as mm"]
    if code not in UNIT_MM:
        raise InputError(f"drawing unit $INSUNITS = {code} is not known here: give --unit, or save it in mm (4)")
    told = [f"the drawing's unit is {UNIT_MM[code]:g} mm ($INSUNITS = {code})"]
    return UNIT_MM[code], [] if code == 4 else told


def _chains(drawn: Drawn, unit_mm: float, notices: list[str]) -> Iterator[_Chain]:
    for entity in drawn:
        kind = entity.dxftype()
        if kind not in _HARMLESS:
            with _read(f"a {kind} in it cannot be read"):
                chain = _Chain.of(_pieces(entity, unit_mm))
            if len(chain.points) > 1 and np.ptp(chain.points, axis=0).max() > 0:
                yield chain
                continue
            kind += " of no length"
        drawn.leave_out(kind)
    notices += [f"{count} {kind} left out" for kind, count in sorted(drawn.left_out.items())]


def _pieces(entity: Any, unit_mm: float) -> list[NDArray[np.float64]]:
    """Return the lines and arcs of an entity, points (n, 2) in mm each."""
    kind = entity.dxftype()
    if kind == "LWPOLYLINE" or (kind == "POLYLINE" and entity.is_2d_polyline):
        _refuse_tilted(entity)
        return _polyline_pieces(entity, unit_mm)
    return [_points(entity, unit_mm)]


def _refuse_tilted(entity: Any) -> None:
    extrusion = np.array(tuple(entity.dxf.get("extrusion", (0, 0, 1))), np.float64)
    if abs(extrusion[2]) < _FLAT * np.linalg.norm(extrusion):
        raise InputError(f"a {entity.dxftype()} is drawn out of the XY plane: project the drawing to XY")


def _points(entity: Any, unit_mm: float) -> NDArray[np.float64]:
    """Return the points (n, 2) of an entity in mm, curves as chords within the tolerance."""
    kind, tolerance = entity.dxftype(), CHORD_TOLERANCE_UM / 1000 / unit_mm
    _refuse_tilted(entity)
    if kind in _OUTERMOST:
        outermost = np.array([(p[0], p[1]) for p in _OUTERMOST[kind](entity)], np.float64).reshape(-1, 2)
        check_points(outermost * unit_mm, f"a {kind}", f"; a drawing unit is {unit_mm:g} mm here; or give --unit")
    points: Iterable[Any]
    if kind == "LINE":
        points = [entity.dxf.start, entity.dxf.end]
    elif kind in ("ARC", "CIRCLE"):
        if not entity.dxf.radius * unit_mm <= FARTHEST_MM:
            raise InputError(f"a {kind} has a radius beyond {FARTHEST_MM:g} mm: draw a line")
        points = entity.flattening(min(tolerance, entity.dxf.radius / 4))
    elif kind == "ELLIPSE":
        points = entity.flattening(tolerance, segments=16)
    elif kind == "SPLINE":
        points = spline_points(entity, tolerance / 2)
    else:
        raise InputError(f"a {kind} cannot be cut: draw {_SHAPES}")
    return np.array([(p[0], p[1]) for p in points], np.float64).reshape(-1, 2) * unit_mm


def _box(centre: Any, reach: float) -> list[tuple[float, float]]:
    return [(centre[0] - reach, centre[1] - reach), (centre[0] + reach, centre[1] + reach)]


def _polyline_pieces(entity: Any, unit_mm: float) -> list[NDArray[np.float64]]:
    """Chain the lines and arcs of a polyline, each turned to begin where the last ended."""
    pieces = [_points(part, unit_mm) for part in entity.virtual_entities()]
    if len(pieces) > 1 and _gap(pieces[0][0], pieces[1]) < _gap(pieces[0][-1], pieces[1]):
        pieces[0] = pieces[0][::-1]
    chained = pieces[:1]
    for piece in pieces[1:]:
        end = chained[-1][-1]
        turned = np.hypot(*(piece[0] - end)) > np.hypot(*(piece[-1] - end))
        chained.append(piece[::-1] if turned else piece)
    return chained


def _gap(point: NDArray[np.float64], piece: NDArray[np.float64]) -> float:
    return float(np.hypot(*(piece[[0, -1]] - point).T).min())


def _without_duplicates(chains: list[_Chain], notices: list[str]) -> list[_Chain]:
    """Drop entities drawn twice: same ends and same middle within the join tolerance."""
    kept: dict[tuple[Any, ...], _Chain] = {}
    for chain in chains:
        kept.setdefault(_fingerprint(chain), chain)
    if len(kept) < len(chains):
        notices.append(f"{len(chains) - len(kept)} entities drawn twice are cut once")
    return list(kept.values())


def _fingerprint(chain: _Chain) -> tuple[Any, ...]:
    line = shapely.LineString(chain.points)
    middle = shapely.line_interpolate_point(line, 0.5, normalized=True)
    cells = [tuple(np.round(p / JOIN_TOLERANCE_MM).tolist()) for p in chain.points[[0, -1]]]
    centre = (line.centroid.x, line.centroid.y) if chain.closed else (middle.x, middle.y)
    spot = tuple(np.round(np.array([*centre, line.length]) / JOIN_TOLERANCE_MM).tolist())
    return (spot,) if chain.closed else (*sorted(cells), spot)


def _join(chains: list[_Chain]) -> list[_Chain]:
    """Join loose chains into closed contours, in the order of their first entities."""
    contours = [(i, chain) for i, chain in enumerate(chains) if chain.closed]
    loose = {i: chain for i, chain in enumerate(chains) if not chain.closed}
    partner = _partners({i: chain.points for i, chain in loose.items()})
    while loose:
        first = next(iter(loose))
        contours.append((first, _follow(first, loose, partner)))
    contours.sort(key=lambda contour: contour[0])
    return [
        replace(chain, points=np.concatenate([chain.points[:-1], chain.points[:1]])) for _, chain in contours
    ]


def _partners(loose: dict[int, NDArray[np.float64]]) -> dict[tuple[int, int], tuple[int, int]]:
    """Return for every end ``(chain, 0 or -1)`` the one end that meets it."""
    if not loose:
        return {}
    ends = [(i, end) for i in loose for end in (0, -1)]
    places = np.array([loose[i][end] for i, end in ends])
    points = [shapely.Point(place) for place in places]
    left, right = shapely.STRtree(points).query(points, predicate="dwithin", distance=JOIN_TOLERANCE_MM)
    meets: dict[int, list[int]] = {k: [] for k in range(len(ends))}
    for a, b in zip(left.tolist(), right.tolist(), strict=True):
        if a != b:
            meets[a].append(b)
    for k, others in meets.items():
        if len(others) > 1:
            raise InputError(f"{len(others) + 1} ends meet at {_place(places[k])}: a contour must not branch")
    open_ends = [k for k, others in meets.items() if not others]
    if open_ends:
        raise InputError(_open_reason(places, open_ends))
    return {ends[k]: ends[others[0]] for k, others in meets.items()}


def _open_reason(places: NDArray[np.float64], open_ends: list[int]) -> str:
    from scipy.spatial import KDTree

    ends = places[open_ends]
    distances, nearest = (np.atleast_2d(found) for found in KDTree(ends).query(ends, k=2))
    k = int(np.argmin(distances[:, 1]))
    first, second = sorted(nearest[k].tolist())
    return (f"a contour is open: a gap of {distances[k, 1]:.3f} mm between {_place(ends[first])} and "
            f"{_place(ends[second])}; close it within {JOIN_TOLERANCE_MM} mm")


def _follow(
    first: int, loose: dict[int, _Chain], partner: dict[tuple[int, int], tuple[int, int]]
) -> _Chain:
    pieces = [loose.pop(first)]
    number, begin = partner[first, -1]
    while number != first:
        piece = loose.pop(number)
        pieces.append(piece if begin == 0 else piece.reversed())
        number, begin = partner[number, -1 - begin]
    points = np.concatenate([pieces[0].points, *(piece.points[1:] for piece in pieces[1:])])
    counts = np.cumsum([0, *(int(piece.elements.max()) + 1 for piece in pieces[:-1])])
    own = [piece.elements + count for piece, count in zip(pieces, counts, strict=True)]
    return _Chain(points, np.concatenate(own))


def _nested(contours: list[_Chain]) -> list[Outline]:
    """Find out which contours lie in which, and turn and sort them accordingly."""
    polygons = [shapely.Polygon(contour.points) for contour in contours]
    lines = [polygon.exterior for polygon in polygons]
    for a, b in combinations(range(len(lines)), 2):
        if lines[a].intersects(lines[b]):
            spot = shapely.get_coordinates(lines[a].intersection(lines[b]))[0]
            raise InputError(f"two contours cross or touch at {_place(spot)}: keep them apart")
    # contains is false for a contour's own corner, which lies on its boundary
    depths = [sum(p.contains(shapely.Point(points[0])) for p in polygons) for points in (c.points for c in contours)]
    order = sorted(range(len(contours)), key=lambda i: -depths[i])
    return [_outline(contours[i], is_hole=depths[i] % 2 == 1) for i in order]


def _outline(contour: _Chain, is_hole: bool) -> Outline:
    turned = contour.reversed() if (signed_area(contour.points) < 0) != is_hole else contour
    elements = np.cumsum(np.diff(turned.elements, prepend=turned.elements[0]) != 0) + 1
    return Outline(
        np.ascontiguousarray(turned.points), (0,) * len(elements), True, "right", "left", np.empty((0, 2)),
        elements=tuple(elements.tolist()),
    )


def _place(point: NDArray[np.float64]) -> str:
    return f"X{point[0]:.3f} Y{point[1]:.3f} mm"
