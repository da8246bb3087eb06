"""DXF drawings read into closed outlines.

Read are LINE, ARC, CIRCLE, LWPOLYLINE, POLYLINE (2D or flat), SPLINE and ELLIPSE in model space and in blocks
(INSERT), on any layer that is on. Loose ends within 5 um are joined, what lies within 5 um is joined away. A closed
contour that lies in no other, or in an even number of others, is an outside (the part is within); in an odd number, a
hole. The cut runs with the part on its left: outsides counter-clockwise, holes clockwise. It begins where the
contour's first entity in the file begins. Inner contours come first.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.program.chains import Chain, joined_contours, spot, without_duplicates
from edmsim.program.drawing_file import look_into
from edmsim.program.entities import CUT, POLYLINES, SHAPES, UNDRAWN, named, pieces_of
from edmsim.program.limits import MOST_POINTS, check_contours, check_count, check_points
from edmsim.program.outline import JOIN_TOLERANCE_MM, Outline, Program, refuse_self_crossing, signed_area

if TYPE_CHECKING:
    from ezdxf.document import Drawing


_DEEPEST = 16  # blocks within blocks (ours: deeper ones hold themselves)

_MOST_NAMED = 20

_EQUAL = 1e-9
"""Angles that differ by less, in degrees or radians, are equal; so are radii and 0 (ours: what arithmetic leaves)."""


class Drawn:
    """The entities of a drawing's model space that are to be cut, of some layers or of all that are shown."""

    def __init__(self, document: Drawing, layers: Sequence[str], without: str | None = None) -> None:
        self._document = document
        self._without = "" if without is None else without.strip().lower()
        self._layers = frozenset(name.strip().lower() for name in layers)
        self.left_out: dict[str, int] = {}
        self._count = 0
        self._refuse_unknown_layers()
        self._shrink_points()
        self._unmoved = {block.name: _taken_out(block) for block in document.blocks}

    def __iter__(self) -> Iterator[Any]:
        """Go through them, in the order of the file."""
        for entity in self._document.modelspace():
            yield from self._parts(entity, _property(entity, "layer", "0"), 0)

    def leave_out(self, kind: str) -> None:
        """Count what is not cut."""
        self.left_out[kind] = self.left_out.get(kind, 0) + 1

    def _parts(self, entity: Any, layer: str, depth: int) -> Iterator[Any]:
        """Return an entity, or those of its block; what lies on layer 0 in a block is on the layer of the block."""
        kind = entity.dxftype()
        if kind != "INSERT":
            if self._is_cut(entity, kind, layer):
                yield entity
            return
        if depth > _DEEPEST:
            raise InputError(f"the block {entity.dxf.name} lies in itself, or over {_DEEPEST} deep: explode it")
        if entity.block() is None:
            raise InputError(f"the block {entity.dxf.name} is not in the drawing: bind external references and save")
        if self._is_frozen(layer) or _property(entity, "invisible", 0):
            self.leave_out("INSERT on a layer that is off")
            return
        copies = entity.multi_insert() if entity.mcount > 1 else [entity]
        for copy in copies:
            for part in (*copy.virtual_entities(), *self._unmoved[entity.block().name]):
                self._count += 1
                if self._count > MOST_POINTS:
                    raise InputError(f"its blocks hold more than {MOST_POINTS} entities, more than any cut has")
                own = _property(part, "layer", "0")
                yield from self._parts(part, layer if own == "0" else own, depth + 1)

    def _is_cut(self, entity: Any, kind: str, layer: str) -> bool:
        if layer.lower() == self._without:
            return False
        if not self._is_shown(entity, layer):
            self.leave_out(f"{kind} on a layer that is off")
        elif self._layers and layer.lower() not in self._layers:
            self.leave_out(f"{kind} on a layer not asked for")
        else:
            return True
        return False

    def _is_shown(self, entity: Any, layer: str) -> bool:
        if layer.lower() == "defpoints" or _property(entity, "invisible", 0):
            return False
        layers = self._document.layers
        return not layers.has_entry(layer) or bool(layers.get(layer).is_on() and not layers.get(layer).is_frozen())

    def _is_frozen(self, layer: str) -> bool:
        layers = self._document.layers
        return layers.has_entry(layer) and bool(layers.get(layer).is_frozen())

    def _shrink_points(self) -> None:
        """Make arcs with equal angles the points that CAD programs draw: the library makes them full circles."""
        blocks: Any = self._document.blocks
        for block in blocks:
            for arc in block.query("ARC"):
                if math.isclose(arc.dxf.start_angle, arc.dxf.end_angle, abs_tol=_EQUAL):
                    arc.dxf.radius = 0.0
            for ellipse in block.query("ELLIPSE"):
                if math.isclose(ellipse.dxf.start_param, ellipse.dxf.end_param, abs_tol=_EQUAL):
                    common = {name: ellipse.dxf.get(name) for name in ("layer", "invisible")}
                    block.add_arc(ellipse.dxf.center, 0.0, 0.0, 0.0, dxfattribs=common)
                    block.delete_entity(ellipse)

    def _refuse_unknown_layers(self) -> None:
        blocks = (entity for block in self._document.blocks for entity in block)
        there = {str(entity.dxf.layer) for entity in blocks if entity.dxf.hasattr("layer")}
        there |= {layer.dxf.name for layer in self._document.layers} | {"0"}
        unknown = self._layers - {name.lower() for name in there}
        if unknown:
            listed = ", ".join(sorted(there)[:_MOST_NAMED]) + (", ..." if len(there) > _MOST_NAMED else "")
            raise InputError(f"the drawing has no layer {', '.join(sorted(unknown))}; there are: {listed}")


def _taken_out(block: Any) -> list[Any]:
    """Take out of a block what is not cut: the library drops, explodes or fails on some of it when it moves it."""
    others = [] if block.is_any_layout else [
        entity for entity in block
        if entity.dxftype() not in CUT | {"INSERT"}
        or (entity.dxftype() in ("ARC", "CIRCLE") and abs(entity.dxf.radius) < _EQUAL)
    ]
    for entity in others:
        block.unlink_entity(entity)
    return others


def _property(entity: Any, name: str, default: Any) -> Any:
    """Return what all entities have; the library keeps it elsewhere for kinds that it does not know."""
    if entity.dxf.is_supported(name):
        return entity.dxf.get(name, default)
    return entity.graphic_properties().get(name, default)


UNIT_MM = {1: 25.4, 2: 304.8, 4: 1.0, 5: 10.0, 6: 1000.0, 9: 0.0254, 13: 0.001, 14: 100.0}
"""Millimetres per drawing unit by the header's $INSUNITS (DXF reference, code 70)."""

UNITS = {"in": 1, "ft": 2, "mm": 4, "cm": 5, "m": 6, "mil": 9, "um": 13}
"""Names of units, with their codes in the header."""

LEAST_EXTENT_MM = 0.5
"""A drawing that spans less has another unit than it says (ours: nothing smaller is cut with a wire)."""


def read_dxf(
    file: str | Path, layers: Sequence[str] = (), unit: str | None = None, without: str | None = None
) -> Program:
    """Read a drawing.

    Parameters
    ----------
    file : path
        The drawing, any DXF version.
    layers : sequence of str
        Layers to cut; by default all that are on and not frozen.
    unit : {"mm", "um", "cm", "m", "in", "ft", "mil"}, optional
        Unit of the drawing; by default that of its header.
    without : str, optional
        A layer not to cut.

    Returns
    -------
    Program
        One closed outline per contour, inner ones first; the wire runs on the right.

    Raises
    ------
    InputError
        If the file is not a DXF drawing, a layer or unit is unknown, an entity cannot be cut,
        or a contour is open, branches, or meets another.
    """
    path = Path(file)
    try:
        (chains, unit_mm, notices), irregular = look_into(
            path, lambda document: _content(document, layers, unit, without)
        )
        outlines = _nested(_contours(chains, unit_mm, notices))
    except InputError as error:
        raise InputError(error.reason, path, error.line) from None
    return Program(tuple(outlines), (*irregular, *notices), str(path))


def _content(
    document: Drawing, layers: Sequence[str], unit: str | None, without: str | None
) -> tuple[list[Chain], float, list[str]]:
    """Return what is drawn, the drawing's unit in mm, and notices."""
    unit_mm, notices = _unit(document, unit)
    drawn = Drawn(document, layers, without)
    chains = list(_chains(drawn, unit_mm))
    notices += [f"{count} {kind} left out" for kind, count in sorted(drawn.left_out.items())]
    short = Counter(kind for chain, kind in chains for kind in _short(chain, kind))
    if short:
        listed = ", ".join(f"{count} {kind}" for kind, count in sorted(short.items()))
        notices.append(f"what lies within {JOIN_TOLERANCE_MM} mm is joined away, as ends within it are: {listed}")
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
    distinct = without_duplicates(chains)
    twice = len(chains) - len(distinct)
    if twice:
        what = f"1 {one} drawn twice is" if twice == 1 else f"{twice} {several} drawn twice are"
        notices.append(f"{what} cut once")
    return distinct


def _unit(document: Drawing, chosen: str | None) -> tuple[float, list[str]]:
    code = int(document.header.get("$INSUNITS", 0))
    if chosen is not None:
        if chosen not in UNITS:
            raise InputError(f"the unit is {chosen!r}: give one of {', '.join(UNITS)}")
        said = f", though the drawing says {UNIT_MM[code]:g} mm" if code in UNIT_MM and code != UNITS[chosen] else ""
        return UNIT_MM[UNITS[chosen]], [f"the drawing is read in {chosen}, as requested{said}"]
    if code == 0:
        return 1.0, ["the drawing sets no unit ($INSUNITS): it is read as mm"]
    if code not in UNIT_MM:
        raise InputError(f"drawing unit $INSUNITS = {code} is not known here: give --unit, or save it in mm (4)")
    listed = [f"the drawing's unit is {UNIT_MM[code]:g} mm ($INSUNITS = {code})"]
    return UNIT_MM[code], [] if code == 4 else listed


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
