"""Reading of DXF drawings into closed outlines.

These are read: LINE, ARC, CIRCLE, LWPOLYLINE, POLYLINE (2D or flat), SPLINE and ELLIPSE in model space and in blocks
(INSERT), on any layer that is on. Loose ends within 5 um are joined, and entities within 5 um with their
neighbours. A closed contour inside an even number of others (or none) is an outer contour, with the part inside;
inside an odd number it is a hole. The part is on the left of the cut: outer contours run counter-clockwise, holes
clockwise. A cut begins where the contour's first entity in the file begins. Inner contours come first.
"""

from __future__ import annotations

import io
import logging
import math
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import combinations, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.errors import InputError, located, refuses_wrong_types
from edmsim.program import entities
from edmsim.program.limits import MOST_POINTS, check_contours, check_count, check_points, read_bytes
from edmsim.program.outline import JOIN_TOLERANCE_MM, Outline, Program, refuse_self_crossing, signed_area

if TYPE_CHECKING:
    from ezdxf.document import Drawing


# Opening of a DXF file: by the strict reader of ezdxf or, if that fails, by its recovering reader. The latter drops
# unexpected contents, so irregular texts are made regular before.

_Tag = tuple[int, bytes, int]  # group code, value, and the line of the code
_PARTS = frozenset({"VERTEX", "INSERT"})  # kinds that are not cut themselves but decide what is cut
_STRUCTURE = frozenset({"SECTION", "ENDSEC", "BLOCK", "ENDBLK", "SEQEND", "EOF"})
_MARKERS = {"LWPOLYLINE": b"AcDbPolyline", "SPLINE": b"AcDbSpline"}
"""Kinds that ezdxf reads only if they have subclass markers (code 100), and the marker of their own codes."""
_COMMON = frozenset({5, 6, 8, 48, 60, 62, 67, 330, 370, 410, 420, 430, 440})
"""Codes before these markers, common to all entities."""
_MARKED_FROM = b"AC1015"  # version with these kinds; in older ones ezdxf ignores the markers
_HEADER = b"0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\n%b\n0\nENDSEC\n" % _MARKED_FROM
_FIRST_HANDLE = 0x7F000000


@dataclass
class Regular:
    """A DXF text that the recovering reader accepts."""

    text: bytes = b""
    # entities that are not cut, by kind; they are removed from the text
    left_out: Counter[str] = field(default_factory=Counter)
    foreign: list[str] = field(default_factory=list)  # kinds of entities that cannot be cut


def regular(data: bytes) -> Regular:
    """Return a DXF text in which X, Y and Z of a point follow each other directly and all handles are different."""
    # DXF requires no order within an entity, but ezdxf requires this one, and drops points in another order
    tags = list(_tags(data))
    begins = [i for i, (code, _, _) in enumerate(tags) if code in (0, 9)]
    section, header, found = "", _HEADER, Regular()
    handles, lines = set[bytes](), list[bytes]()
    for a, b in pairwise([0, *begins, len(tags)]):
        entity = tags[a:b]
        kind = entity[0][1].strip().upper().decode("ascii", "replace") if entity else ""
        if kind == "SECTION":
            section = entity[1][1].strip().decode("ascii", "replace") if len(entity) > 1 else ""
        elif kind == "$ACADVER":
            header = b""
            entity[1:] = [(code, _at_least_marked(value), line) for code, value, line in entity[1:]]
        elif section in ("ENTITIES", "BLOCKS"):
            if kind in entities.UNDRAWN:
                found.left_out[kind] += 1
                continue
            if kind in entities.CUT | _PARTS:
                _refuse_no_numbers(entity)
                entity = _marked(kind, _with_own_handle(entity, handles))
            elif kind not in _STRUCTURE:
                found.foreign.append(kind)
        handles |= {value.strip() for code, value, _ in entity if code == 5}
        lines += [b"%d\n%b\n" % tag[:2] for tag in _in_order(kind, entity)]
    found.text = header + b"".join(lines)
    return found


def _tags(data: bytes) -> Iterator[_Tag]:
    lines = data.removeprefix(b"\xef\xbb\xbf").splitlines()
    section, has_section = False, False
    for number in range(0, len(lines) - 1, 2):
        found, value = re.match(rb"\s*(-?\d{1,9})\s*$", lines[number]), lines[number + 1]
        if found is None:
            raise InputError("this is not a group code, and what follows cannot be read: export it as DXF again",
                             line=number + 1)
        code, kind = int(found[1]), value.strip().upper()
        if code == 0:
            section = kind == b"SECTION" or (section and kind != b"ENDSEC")
            has_section |= section
        if code != 999:
            yield code, value, number + 1
        if (code, kind) == (0, b"EOF"):
            return
    if not has_section:
        raise InputError("this is not a DXF drawing: it has no SECTION; export it as DXF again")
    if section:
        raise InputError("the drawing is cut off: its last section has no end; export it as DXF again",
                         line=len(lines))


def _refuse_no_numbers(entity: list[_Tag]) -> None:
    for code, value, line in entity:
        if 10 <= code < 60:
            try:
                float(value)
            except ValueError:
                quoted = repr(value.strip().decode("ascii", "replace"))
                raise InputError(f"{quoted} is not a number: write it with a decimal point", line=line + 1) from None


def _with_own_handle(entity: list[_Tag], taken: set[bytes]) -> list[_Tag]:
    """Replace the handle of an entity if another entity has it."""
    own = b"%X" % (_FIRST_HANDLE + len(taken))
    return [(5, own, tag[2]) if tag[0] == 5 and tag[1].strip() in taken | {b"0"} else tag for tag in entity]


def _at_least_marked(version: bytes) -> bytes:
    return max(version.strip(), _MARKED_FROM) if re.fullmatch(rb"\s*AC\d{4}\s*", version) else _MARKED_FROM


def _marked(kind: str, entity: list[_Tag]) -> list[_Tag]:
    """Add the subclass markers if they are missing."""
    if kind not in _MARKERS or any(code == 100 for code, _, _ in entity):
        return entity
    head, rest = entity[0], entity[1:]
    common = [tag for tag in rest if tag[0] in _COMMON]
    own = [tag for tag in rest if tag[0] not in _COMMON]
    return [head, (100, b"AcDbEntity", head[2]), *common, (100, _MARKERS[kind], head[2]), *own]


def _in_order(kind: str, entity: list[_Tag]) -> list[_Tag]:
    """Return the tags of one entity or variable, with the n-th Y and Z directly after the n-th X."""
    from ezdxf.lldxf.types import POINT_CODES

    codes = [code for code, _, _ in entity]
    behind: dict[int, list[_Tag]] = {}
    moved: set[int] = set()
    for x_code in sorted(POINT_CODES.intersection(codes)):
        x, y, z = ([i for i, code in enumerate(codes) if code == x_code + step] for step in (0, 10, 20))
        if len(x) == len(y):
            for at, *rest in zip(x, y, *([z] if len(z) == len(x) else []), strict=True):
                behind[at] = [entity[i] for i in rest]
                moved.update(rest)
        elif kind in entities.CUT | _PARTS:
            raise InputError(f"{kind} has X and Y without each other (group codes {x_code} and {x_code + 10}): "
                             "export it as DXF again", line=entity[0][2])
    return [t for i, tag in enumerate(entity) if i not in moved for t in (tag, *behind.get(i, ()))]


_BINARY_DXF = b"AutoCAD Binary DXF\r\n\x1a\x00"
_UTF16 = re.compile(rb"\xff\xfe|\xfe\xff|(\s\0)*\d\0|(\0\s)*\0\d")
_UNIT = "$INSUNITS"
_EXPORT = "export it as DXF again"
_COMPARE = "compare the picture of its path with it"
Found = TypeVar("Found")


def look_into(path: Path, look: Callable[[Drawing], Found]) -> tuple[Found, list[str]]:
    """Open a drawing; return the result of `look`, and notices of contents that are irregular or not cut."""
    # if `look` raises anything but `InputError`, the document is damaged
    from ezdxf.filemanagement import readfile

    data = read_bytes(path, "a DXF drawing")
    _refuse_others(data)
    with _heard() as warnings:
        try:
            found = look(_without_own_unit(readfile(path), data))
        except InputError:
            raise
        except Exception:  # ezdxf may raise any exception, here and below
            pass
        else:
            if not warnings:
                return found, []
            others = f", and {len(warnings) - 1} more" if len(warnings) > 1 else ""
            return found, [f"the drawing is irregular ({warnings[0].rstrip('. ')}{others}): {_COMPARE}"]
        if data.startswith(_BINARY_DXF):
            raise InputError(f"this binary DXF drawing is damaged: {_EXPORT}")
        drawing = regular(data)
        try:
            found = look(_without_own_unit(_recovered(drawing.text), data))
        except InputError:
            raise
        except Exception:
            if drawing.foreign:
                what = entities.named(drawing.foreign[0])
                raise InputError(f"{what} cannot be cut: draw {entities.SHAPES}") from None
            raise InputError(f"this DXF drawing is damaged, its contents cannot be read: {_EXPORT}") from None
    left_out = [f"{count} {kind} left out" for kind, count in sorted(drawing.left_out.items())]
    return found, [f"the drawing is irregular and is read by recovering what it holds: {_COMPARE}", *left_out]


def _refuse_others(data: bytes) -> None:
    """Refuse a file that is not a DXF drawing; the message says what it is."""
    if data.startswith(_BINARY_DXF):
        return
    if not data.strip():
        raise InputError(f"this file is empty: {_EXPORT}")
    if re.match(rb"AC1[.\d]|AC2\.|MC0\.", data):
        raise InputError("this is a DWG file, whatever its name: save it as DXF")
    if _UTF16.match(data):
        raise InputError("this is text in UTF-16: save it as UTF-8")
    if not re.match(rb"(\xef\xbb\xbf)?\s*-?\d+\s*[\r\n]", data):
        kind = "a binary file" if b"\0" in data else "text that does not begin with a group code"
        raise InputError(f"this is not a DXF drawing but {kind}: {_EXPORT}")


def _without_own_unit(document: Drawing, data: bytes) -> Drawing:
    """Remove the unit that ezdxf sets if a drawing has none."""
    if _UNIT.encode() not in data and _UNIT in document.header:
        del document.header[_UNIT]
    return document


def _recovered(data: bytes) -> Drawing:
    from ezdxf import recover
    from ezdxf.audit import AuditError as Flaw

    document, repairs = recover.read(io.BytesIO(data))
    losses = {
        Flaw.REMOVED_INVALID_GRAPHIC_ENTITY, Flaw.REMOVED_ENTITY_WITH_INVALID_OWNER_HANDLE,
        Flaw.INVALID_ENTITY_HANDLE, Flaw.UNDEFINED_BLOCK, Flaw.UNDEFINED_BLOCK_NAME, Flaw.INVALID_SPLINE_DEFINITION,
        Flaw.INVALID_SPLINE_CONTROL_POINT_COUNT, Flaw.INVALID_SPLINE_FIT_POINT_COUNT,
        Flaw.INVALID_SPLINE_KNOT_VALUE_COUNT, Flaw.INVALID_SPLINE_WEIGHT_COUNT, Flaw.FOUND_TAG_OUTSIDE_SECTION,
        Flaw.MISSING_SECTION_NAME_TAG,
    }  # fmt: skip
    lost = sum(entry.code in losses for entry in (*repairs.errors, *repairs.fixes))
    if lost:
        raise InputError(f"this DXF drawing is damaged, {lost} of its parts cannot be read: {_EXPORT}")
    return document


@contextmanager
def _heard() -> Iterator[list[str]]:
    """Collect the library's warnings instead of printing them."""
    heard: list[str] = []

    class Listener(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            heard.append(record.getMessage())

    logger, listener = logging.getLogger("ezdxf"), Listener(logging.WARNING)
    propagate = logger.propagate
    logger.addHandler(listener)
    logger.propagate = False
    try:
        yield heard
    finally:
        logger.removeHandler(listener)
        logger.propagate = propagate


_DEEPEST = 16  # blocks within blocks (ours: deeper ones contain themselves)
_MOST_NAMED = 20
_EQUAL = 1e-9
"""Angles that differ by less, in degrees or radians, are equal; so are radii and 0 (ours: rounding errors)."""
_TURN_RAD = 1e-8  # tolerance of a full turn of an ellipse (ours: two numbers of eight decimals)


class Drawn:
    """The entities of a drawing's model space that are to be cut, on some layers or on all visible ones."""

    def __init__(self, document: Drawing, layers: Sequence[str], without: str | None = None) -> None:
        self._document = document
        self._without = "" if without is None else without.strip().lower()
        self._layers = {name.strip().lower(): name.strip() for name in layers}
        self.left_out = Counter[str]()  # entities that are not cut, by kind
        self._count = 0
        self._refuse_unknown_layers()
        self._take_turns()

    def __iter__(self) -> Iterator[Any]:
        """Yield the entities in the order of the file."""
        for entity in self._document.modelspace():
            yield from self._parts(entity, _property(entity, "layer", "0"), 0)

    def _parts(self, entity: Any, layer: str, depth: int) -> Iterator[Any]:
        """Yield an entity, or those of its block; entities on layer 0 of a block are on the layer of the block."""
        kind = entity.dxftype()
        if kind != "INSERT":
            if self._is_cut(entity, kind, layer):
                yield entity
            return
        if depth > _DEEPEST:
            raise InputError(f"the block {entity.dxf.name} lies in itself, or over {_DEEPEST} deep: explode it")
        if entity.block() is None:
            raise InputError(f"the block {entity.dxf.name} is not in the drawing: bind external references and save")
        layers = self._document.layers
        frozen = layers.has_entry(layer) and layers.get(layer).is_frozen()
        if frozen or _property(entity, "invisible", 0):
            self.left_out["INSERT on a layer that is off"] += 1
            return
        for copy in entity.multi_insert() if entity.mcount > 1 else [entity]:
            place = copy.matrix44()
            for part in entity.block():
                self._count += 1
                if self._count > MOST_POINTS:
                    raise InputError(f"its blocks hold more than {MOST_POINTS} entities, more than any cut has")
                own = _property(part, "layer", "0")
                for drawn in self._parts(part, layer if own == "0" else own, depth + 1):
                    yield from _moved(drawn, place)

    def _is_cut(self, entity: Any, kind: str, layer: str) -> bool:
        layers, name = self._document.layers, layer.lower()
        off = layers.has_entry(layer) and not (layers.get(layer).is_on() and not layers.get(layer).is_frozen())
        if name == self._without:
            return False
        if off or name == "defpoints" or _property(entity, "invisible", 0):
            self.left_out[f"{kind} on a layer that is off"] += 1
        elif self._layers and name not in self._layers:
            self.left_out[f"{kind} on a layer not asked for"] += 1
        else:
            return True
        return False

    def _take_turns(self) -> None:
        """Convert arcs with equal angles to points, as CAD programs draw them; make full ellipses begin at 0."""
        # ezdxf reads the former as full circles, and drops the latter if they begin elsewhere
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
                    continue
                start, end = ellipse.dxf.start_param, ellipse.dxf.end_param
                if start != 0 and abs(math.remainder(end - start, math.tau)) <= _TURN_RAD:
                    ellipse.dxf.start_param, ellipse.dxf.end_param = 0.0, math.tau

    def _refuse_unknown_layers(self) -> None:
        blocks = (entity for block in self._document.blocks for entity in block)
        there = {str(entity.dxf.layer) for entity in blocks if entity.dxf.hasattr("layer")}
        there |= {layer.dxf.name for layer in self._document.layers} | {"0"}
        unknown = self._layers.keys() - {name.lower() for name in there}
        if unknown:
            listed = ", ".join(sorted(there)[:_MOST_NAMED]) + (", ..." if len(there) > _MOST_NAMED else "")
            missing = ", ".join(self._layers[name] for name in sorted(unknown))
            raise InputError(f"the drawing has no layer {missing}; there are: {listed}")


def _moved(entity: Any, place: Any) -> Iterator[Any]:
    """Yield an entity of a block, transformed to the block's place; if it is stretched, an arc becomes an ellipse."""
    # ezdxf misplaces rotated blocks in a stretched one, and drops, explodes or fails on entities that are not cut
    from ezdxf.entities.ellipse import Ellipse
    from ezdxf.math.transformtools import NonUniformScalingError

    kind = entity.dxftype()
    if kind not in entities.CUT or (kind in ("ARC", "CIRCLE") and abs(entity.dxf.radius) < _EQUAL):
        yield entity
        return
    if kind == "SPLINE":
        entity = entities.with_control_points(entity)
    try:
        yield entity.copy().transform(place)
    except NonUniformScalingError:
        if kind in entities.POLYLINES:
            for piece in entity.virtual_entities():
                yield from _moved(piece, place)
        else:
            yield Ellipse.from_arc(entity).transform(place)


def _property(entity: Any, name: str, default: Any) -> Any:
    """Return a property that all entities have; ezdxf stores it elsewhere for unknown kinds."""
    if entity.dxf.is_supported(name):
        return entity.dxf.get(name, default)
    return entity.graphic_properties().get(name, default)


UNIT_MM = {1: 25.4, 2: 304.8, 4: 1.0, 5: 10.0, 6: 1000.0, 9: 0.0254, 13: 0.001, 14: 100.0}
"""Millimetres per drawing unit by the header's $INSUNITS (DXF reference, code 70)."""

UNITS = {"in": 1, "ft": 2, "mm": 4, "cm": 5, "m": 6, "mil": 9, "um": 13}  # names, with their codes in the header
LEAST_EXTENT_MM = 0.5  # a drawing that spans less has another unit (ours: nothing smaller is cut with a wire)


@refuses_wrong_types
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
    with located(path):
        (chains, unit_mm, notices), irregular = look_into(
            path, lambda document: _content(document, layers, unit, without)
        )
        outlines = _nested(_contours(chains, unit_mm, notices))
    return Program(tuple(outlines), (*irregular, *notices), str(path))


def _content(
    document: Drawing, layers: Sequence[str], unit: str | None, without: str | None
) -> tuple[list[entities.Chain], float, list[str]]:
    """Return the chains of a drawing, its unit in mm, and notices."""
    unit_mm, notices = _unit(document, unit)
    drawn = Drawn(document, layers, without)
    chains = list(_chains(drawn, unit_mm))
    notices += [f"{count} {kind} left out" for kind, count in sorted(drawn.left_out.items())]
    short = Counter(kind for chain, kind in chains for kind in _short(chain, kind))
    if short:
        listed = ", ".join(f"{count} {kind}" for kind, count in sorted(short.items()))
        notices.append(f"parts within {JOIN_TOLERANCE_MM} mm are joined with their neighbours: {listed}")
    return [chain for chain, _ in chains], unit_mm, notices


def _chains(drawn: Drawn, unit_mm: float) -> Iterator[tuple[entities.Chain, str]]:
    """Yield the entities that have a length as chains, each with its kind."""
    count = 0
    for place, entity in enumerate(drawn):
        kind = entity.dxftype()
        if kind not in entities.UNDRAWN:
            pieces = _read(entity, unit_mm)
            count += sum(map(len, pieces))
            check_count(count)
            chain = entities.Chain.of(pieces, place) if pieces else None
            if chain is not None and len(chain.points) > 1:
                yield chain, kind
                continue
            kind += " of no length"
        drawn.left_out[kind] += 1


def _read(entity: Any, unit_mm: float) -> list[NDArray[np.float64]]:
    """Return the pieces of an entity; raises `InputError` whatever ezdxf raises."""
    try:
        return entities.pieces_of(entity, unit_mm)
    except InputError:
        raise
    except Exception:
        what = entities.named(entity.dxftype())
        raise InputError(f"{what} in it cannot be read: draw it again, or export it as DXF again") from None


def _short(chain: entities.Chain, kind: str) -> Iterator[str]:
    """Yield names of parts within the tolerance that joins ends: the whole entity, or segments of a polyline."""
    if chain.is_short:
        yield kind
    elif kind in entities.POLYLINES:
        yield from (f"{kind} segment" for _, short in chain.parts() if short)


def _contours(chains: list[entities.Chain], unit_mm: float, notices: list[str]) -> list[entities.Chain]:
    if not chains:
        raise InputError(f"nothing to cut: draw {entities.SHAPES} in model space")
    hint = f"; the drawing's unit is {unit_mm:g} mm: is that what was meant? If not, give --unit"
    low, high = (np.array([end(chain.points, axis=0) for chain in chains]) for end in (np.min, np.max))
    check_points(np.array([low.min(axis=0), high.max(axis=0)]), "the drawing", hint)
    extent = float((high.max(axis=0) - low.min(axis=0)).max())
    if extent < LEAST_EXTENT_MM:
        raise InputError(f"the drawing spans {extent:.3g} mm: a wire cuts nothing under {LEAST_EXTENT_MM:g} mm{hint}")
    joined = entities.joined_contours(_once(chains, "entity", "entities", notices))
    contours = _once(joined, "contour", "contours", notices)
    check_contours(len(contours))
    for number, points in enumerate((contour.points for contour in contours), 1):
        refuse_self_crossing(points, (0,) * (len(points) - 1))
        if abs(signed_area(points)) < JOIN_TOLERANCE_MM**2:
            raise InputError(f"contour {number} at {entities.spot(points[0])} encloses nothing: draw it closed")
    return contours


def _once(chains: list[entities.Chain], one: str, several: str, notices: list[str]) -> list[entities.Chain]:
    distinct = entities.without_duplicates(chains)
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


def _nested(contours: list[entities.Chain]) -> list[Outline]:
    """Find which contours are inside which, and orient and sort them accordingly."""
    polygons = [shapely.Polygon(contour.points) for contour in contours]
    lines = [polygon.exterior for polygon in polygons]
    for a, b in combinations(range(len(lines)), 2):
        if lines[a].intersects(lines[b]):
            meeting = shapely.get_coordinates(lines[a].intersection(lines[b]))[0]
            raise InputError(f"two contours cross or touch at {entities.spot(meeting)}: keep them apart")
    # `contains` is False for a contour's own corner, which is on its boundary
    depths = [sum(p.contains(shapely.Point(points[0])) for p in polygons) for points in (c.points for c in contours)]
    order = sorted(range(len(contours)), key=lambda i: -depths[i])
    return [_outline(contours[i], is_hole=depths[i] % 2 == 1) for i in order]


def _outline(contour: entities.Chain, is_hole: bool) -> Outline:
    turned = contour.reversed() if (signed_area(contour.points) < 0) != is_hole else contour
    elements = np.cumsum(np.diff(turned.elements, prepend=turned.elements[0]) != 0) + 1
    return Outline(
        np.ascontiguousarray(turned.points), (0,) * len(elements), True, "right", "left", np.empty((0, 2)),
        elements=tuple(elements.tolist()),
    )
