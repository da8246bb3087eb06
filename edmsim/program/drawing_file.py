"""A DXF file opened: by the strict reader of the library, or where that fails by the one that recovers.

For the latter, which drops what it does not expect, irregular texts are made regular.
"""

from __future__ import annotations

import io
import logging
import re
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from edmsim.errors import InputError
from edmsim.program.entities import CUT, SHAPES, UNDRAWN, named
from edmsim.program.limits import check_size

if TYPE_CHECKING:
    from ezdxf.document import Drawing


_Tag = tuple[int, bytes, int]  # group code, value, and the line of the code

_PARTS = frozenset({"VERTEX", "INSERT"})  # kinds that decide what is cut without being cut themselves
_STRUCTURE = frozenset({"SECTION", "ENDSEC", "BLOCK", "ENDBLK", "SEQEND", "EOF"})
_MARKERS = {"LWPOLYLINE": b"AcDbPolyline", "SPLINE": b"AcDbSpline"}
"""Kinds that the library reads by their subclass markers (code 100) only, and the markers of their own codes."""
_COMMON = frozenset({5, 6, 8, 48, 60, 62, 67, 330, 370, 410, 420, 430, 440})
"""Codes before these markers: those that all entities have."""
_MARKED_FROM = b"AC1015"  # a version that has these kinds: in older ones the library looks at no marker
_HEADER = b"0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\n%b\n0\nENDSEC\n" % _MARKED_FROM
_FIRST_HANDLE = 0x7F000000


@dataclass
class Regular:
    """A text that the recovering reader takes."""

    text: bytes = b""
    # entities that are not cut, by kind; they are no longer in the text
    left_out: Counter[str] = field(default_factory=Counter)
    foreign: list[str] = field(default_factory=list)  # kinds of entities that cannot be cut


def regular(data: bytes) -> Regular:
    """Return a DXF text with X, Y and Z of every point directly behind one another, and every handle given once."""
    # DXF asks for no order within an entity; the library wants this one, and drops what comes otherwise
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
            if kind in UNDRAWN:
                found.left_out[kind] += 1
                continue
            if kind in CUT | _PARTS:
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
    """Give an entity whose handle another one has a handle of its own."""
    own = b"%X" % (_FIRST_HANDLE + len(taken))
    return [(5, own, tag[2]) if tag[0] == 5 and tag[1].strip() in taken | {b"0"} else tag for tag in entity]


def _at_least_marked(version: bytes) -> bytes:
    return max(version.strip(), _MARKED_FROM) if re.fullmatch(rb"\s*AC\d{4}\s*", version) else _MARKED_FROM


def _marked(kind: str, entity: list[_Tag]) -> list[_Tag]:
    """Put the subclass markers where they are left out."""
    if kind not in _MARKERS or any(code == 100 for code, _, _ in entity):
        return entity
    head, rest = entity[0], entity[1:]
    common = [tag for tag in rest if tag[0] in _COMMON]
    own = [tag for tag in rest if tag[0] not in _COMMON]
    return [head, (100, b"AcDbEntity", head[2]), *common, (100, _MARKERS[kind], head[2]), *own]


def _in_order(kind: str, entity: list[_Tag]) -> list[_Tag]:
    """Return the tags of one entity or variable, each Y and Z behind its X, the n-th behind the n-th."""
    from ezdxf.lldxf.types import POINT_CODES

    codes = [code for code, _, _ in entity]
    behind: dict[int, list[_Tag]] = {}
    moved: set[int] = set()
    for x_code in sorted(POINT_CODES.intersection(codes)):
        x, y, z = ([i for i, code in enumerate(codes) if code == x_code + step] for step in (0, 10, 20))
        if len(x) == len(y):
            heights = z if len(z) == len(x) else [None] * len(x)
            for point in zip(x, y, heights, strict=True):
                rest = [i for i in point[1:] if i is not None]
                behind[point[0]] = [entity[i] for i in rest]
                moved.update(rest)
        elif kind in CUT | _PARTS:
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
    """Open a drawing and return what `look` finds in it, and notices of what is irregular or not cut."""
    # what `look` raises besides `InputError` says that the document is damaged
    from ezdxf.filemanagement import readfile

    data = _read(path)
    with _heard() as warnings:
        try:
            found = look(_without_own_unit(readfile(path), data))
        except InputError:
            raise
        except Exception:  # the library lets errors of any kind through, here and below
            pass
        else:
            return found, [f"the drawing is irregular ({_summed_up(warnings)}): {_COMPARE}"] if warnings else []
        if data.startswith(_BINARY_DXF):
            raise InputError(f"this binary DXF drawing is damaged: {_EXPORT}")
        drawing = regular(data)
        try:
            found = look(_without_own_unit(_recovered(drawing.text), data))
        except InputError:
            raise
        except Exception:
            if drawing.foreign:
                raise InputError(f"{named(drawing.foreign[0])} cannot be cut: draw {SHAPES}") from None
            raise InputError(f"this DXF drawing is damaged, its contents cannot be read: {_EXPORT}") from None
    left_out = [f"{count} {kind} left out" for kind, count in sorted(drawing.left_out.items())]
    return found, [f"the drawing is irregular and is read by recovering what it holds: {_COMPARE}", *left_out]


def _read(path: Path) -> bytes:
    if path.is_dir():
        raise InputError("this is a directory: give the path of a DXF drawing")
    if not path.exists():
        raise InputError("no such file: give the path of a DXF drawing")
    check_size(path)
    try:
        data = path.read_bytes()
    except OSError:
        raise InputError("this file cannot be read: see who may read it") from None
    _refuse_others(data)
    return data


def _refuse_others(data: bytes) -> None:
    """Say what a file is that is not a DXF drawing."""
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
    """Take out the unit that the library sets where a drawing says none."""
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


def _summed_up(warnings: list[str]) -> str:
    others = f", and {len(warnings) - 1} more" if len(warnings) > 1 else ""
    return f"{warnings[0].rstrip('. ')}{others}"
