"""DXF drawings read into closed outlines.

Read are LINE, ARC, CIRCLE, LWPOLYLINE, POLYLINE (2D or flat), SPLINE and ELLIPSE in model space and in blocks
(INSERT), on any layer that is on. Loose ends within 5 um are joined, what lies within 5 um is joined away. A closed
contour that lies in no other, or in an even number of others, is an outside (the part is within); in an odd number, a
hole. The cut runs with the part on its left: outsides counter-clockwise, holes clockwise. It begins where the
contour's first entity in the file begins. Inner contours come first.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.program.chains import Chain
from edmsim.program.crossing import refuse_self_crossing
from edmsim.program.drawing_file import look_into
from edmsim.program.drawn import Drawn
from edmsim.program.duplicates import without_duplicates
from edmsim.program.entities import POLYLINES, SHAPES, UNDRAWN, named, pieces_of
from edmsim.program.joining import joined_contours, spot
from edmsim.program.limits import check_contours, check_count, check_points
from edmsim.program.outline import JOIN_TOLERANCE_MM, Outline, Program, signed_area

if TYPE_CHECKING:
    from ezdxf.document import Drawing

UNIT_MM = {1: 25.4, 2: 304.8, 4: 1.0, 5: 10.0, 6: 1000.0, 9: 0.0254, 13: 0.001, 14: 100.0}
"""Millimetres per drawing unit by the header's $INSUNITS (DXF reference, code 70)."""

UNITS = {"in": 1, "ft": 2, "mm": 4, "cm": 5, "m": 6, "mil": 9, "um": 13}
"""Names of units, with their codes in the header."""

LEAST_EXTENT_MM = 0.5
"""A drawing that spans less has another unit than it says (ours: nothing smaller is cut with a wire)."""


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
        (chains, unit_mm, notices), irregular = look_into(path, lambda document: _content(document, layers, unit))
        outlines = _nested(_contours(chains, unit_mm, notices))
    except InputError as error:
        raise InputError(error.reason, path, error.line) from None
    return Program(tuple(outlines), (*irregular, *notices), str(path))


def _content(
    document: Drawing, layers: Sequence[str], unit: str | None
) -> tuple[list[Chain], float, list[str]]:
    """Return what is drawn, the drawing's unit in mm, and notices."""
    unit_mm, notices = _unit(document, unit)
    drawn = Drawn(document, layers)
    chains = list(_chains(drawn, unit_mm))
    notices += [f"{count} {kind} left out" for kind, count in sorted(drawn.left_out.items())]
    short = Counter(kind for chain, kind in chains for kind in _short(chain, kind))
    if short:
        told = ", ".join(f"{count} {kind}" for kind, count in sorted(short.items()))
        notices.append(f"what lies within {JOIN_TOLERANCE_MM} mm is joined away, as ends within it are: {told}")
    return [chain for chain, _ in chains], unit_mm, notices


def _chains(drawn: Drawn, unit_mm: float) -> Iterator[tuple[Chain, str]]:
    """Go through the entities that have a length, each with its kind."""
    count = 0
    for place, entity in enumerate(drawn):
        kind = entity.dxftype()
        if kind not in UNDRAWN:
            pieces = _read(entity, unit_mm)
            count += sum(map(len, pieces))
            check_count(count)
            chain = Chain.of(pieces, place) if pieces else None
            if chain is not None and len(chain.points) > 1:
                yield chain, kind
                continue
            kind += " of no length"
        drawn.leave_out(kind)


def _read(entity: Any, unit_mm: float) -> list[NDArray[np.float64]]:
    """Return the pieces of an entity; the library lets errors of any kind through."""
    try:
        return pieces_of(entity, unit_mm)
    except InputError:
        raise
    except Exception:
        kind = entity.dxftype()
        raise InputError(f"{named(kind)} in it cannot be read: draw it again, or export it as DXF again") from None


def _short(chain: Chain, kind: str) -> Iterator[str]:
    """Name what of an entity lies within the tolerance that joins ends: all of it, or segments of a polyline."""
    if chain.is_short:
        yield kind
    elif kind in POLYLINES:
        yield from (f"{kind} segment" for _, short in chain.parts() if short)


def _contours(chains: list[Chain], unit_mm: float, notices: list[str]) -> list[Chain]:
    if not chains:
        raise InputError(f"nothing to cut: draw {SHAPES} in model space")
    hint = f"; the drawing's unit is {unit_mm:g} mm: is that what was meant? If not, give --unit"
    low, high = (np.array([end(chain.points, axis=0) for chain in chains]) for end in (np.min, np.max))
    check_points(np.array([low.min(axis=0), high.max(axis=0)]), "the drawing", hint)
    extent = float((high.max(axis=0) - low.min(axis=0)).max())
    if extent < LEAST_EXTENT_MM:
        raise InputError(f"the drawing spans {extent:.3g} mm: a wire cuts nothing under {LEAST_EXTENT_MM:g} mm{hint}")
    contours = _once(joined_contours(_once(chains, "entity", "entities", notices)), "contour", "contours", notices)
    check_contours(len(contours))
    for number, points in enumerate((contour.points for contour in contours), 1):
        refuse_self_crossing(points, (0,) * (len(points) - 1))
        if abs(signed_area(points)) < JOIN_TOLERANCE_MM**2:
            raise InputError(f"contour {number} at {spot(points[0])} encloses nothing: draw it closed")
    return contours


def _once(chains: list[Chain], one: str, several: str, notices: list[str]) -> list[Chain]:
    kept = without_duplicates(chains)
    twice = len(chains) - len(kept)
    if twice:
        what = f"1 {one} drawn twice is" if twice == 1 else f"{twice} {several} drawn twice are"
        notices.append(f"{what} cut once")
    return kept


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


def _nested(contours: list[Chain]) -> list[Outline]:
    """Find out which contours lie in which, and turn and sort them accordingly."""
    polygons = [shapely.Polygon(contour.points) for contour in contours]
    lines = [polygon.exterior for polygon in polygons]
    for a, b in combinations(range(len(lines)), 2):
        if lines[a].intersects(lines[b]):
            meeting = shapely.get_coordinates(lines[a].intersection(lines[b]))[0]
            raise InputError(f"two contours cross or touch at {spot(meeting)}: keep them apart")
    # contains is false for a contour's own corner, which lies on its boundary
    depths = [sum(p.contains(shapely.Point(points[0])) for p in polygons) for points in (c.points for c in contours)]
    order = sorted(range(len(contours)), key=lambda i: -depths[i])
    return [_outline(contours[i], is_hole=depths[i] % 2 == 1) for i in order]


def _outline(contour: Chain, is_hole: bool) -> Outline:
    turned = contour.reversed() if (signed_area(contour.points) < 0) != is_hole else contour
    elements = np.cumsum(np.diff(turned.elements, prepend=turned.elements[0]) != 0) + 1
    return Outline(
        np.ascontiguousarray(turned.points), (0,) * len(elements), True, "right", "left", np.empty((0, 2)),
        elements=tuple(elements.tolist()),
    )
