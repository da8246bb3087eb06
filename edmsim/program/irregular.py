"""Irregular DXF texts made regular for the recovering reader of the library, which drops what it does not expect."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise

from edmsim.errors import InputError
from edmsim.program.entities import CUT, UNDRAWN

_Tag = tuple[int, bytes, int]
"""Group code, value, and the line of the code."""

_PARTS = frozenset({"VERTEX", "INSERT"})
"""Kinds that decide what is cut without being cut themselves."""
_STRUCTURE = frozenset({"SECTION", "ENDSEC", "BLOCK", "ENDBLK", "SEQEND", "EOF"})
_MARKERS = {"LWPOLYLINE": b"AcDbPolyline", "SPLINE": b"AcDbSpline"}
"""Kinds that the library reads by their subclass markers (code 100) only, and the markers of their own codes."""
_COMMON = frozenset({5, 6, 8, 48, 60, 62, 67, 330, 370, 410, 420, 430, 440})
"""Codes before these markers: those that all entities have."""
_MARKED_FROM = b"AC1015"
"""A version that has these kinds: in older ones the library looks at no marker."""
_HEADER = b"0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\n%b\n0\nENDSEC\n" % _MARKED_FROM
_FIRST_HANDLE = 0x7F000000


@dataclass
class Regular:
    """A text that the recovering reader takes.

    Attributes
    ----------
    text : bytes
    left_out : Counter of str
        Entities that are not cut, by kind; they are no longer in the text.
    foreign : list of str
        Kinds of entities that cannot be cut.
    """

    text: bytes = b""
    left_out: Counter[str] = field(default_factory=Counter)
    foreign: list[str] = field(default_factory=list)


def regular(data: bytes) -> Regular:
    """Return a DXF text with X, Y and Z of every point directly behind one another, and every handle given once.

    DXF asks for no order within an entity. The library wants this one, and drops what comes otherwise.

    Raises
    ------
    InputError
        With its line: something else than a group code or number, an X without its Y, a file that is cut off.
    """
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
            raise InputError("this is no group code, and what follows cannot be read: export it as DXF again",
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
        raise InputError("this is no DXF drawing: it has no SECTION; export it as DXF again")
    if section:
        raise InputError("the drawing is cut off: its last section has no end; export it as DXF again",
                         line=len(lines))


def _refuse_no_numbers(entity: list[_Tag]) -> None:
    for code, value, line in entity:
        if 10 <= code < 60:
            try:
                float(value)
            except ValueError:
                told = repr(value.strip().decode("ascii", "replace"))
                raise InputError(f"{told} is no number: write it with a decimal point", line=line + 1) from None


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
