"""The lines of a DXF file: group codes and values, coordinates put in the order that the library reads them in."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import pairwise

from edmsim.errors import InputError

_Tag = tuple[int, bytes, int]
"""Group code, value, and the line of the code."""

_DRAWN = frozenset({b"LINE", b"ARC", b"CIRCLE", b"ELLIPSE", b"SPLINE", b"LWPOLYLINE", b"VERTEX", b"INSERT"})
"""Kinds of entities whose coordinates decide what is cut."""


def ordered(data: bytes) -> bytes:
    """Return a DXF text with X, Y and Z of every point directly behind one another, without comments.

    DXF asks for no order. The library wants this one, and drops what comes otherwise.

    Raises
    ------
    InputError
        With its line: something else than a group code, an X without its Y, a file that is cut off.
    """
    tags = list(_tags(data))
    begins = [i for i, (code, _, _) in enumerate(tags) if code in (0, 9)]
    entities = [tags[a:b] for a, b in pairwise([0, *begins, len(tags)])]
    return b"".join(b"%d\n%b\n" % tag[:2] for entity in entities for tag in _in_order(entity))


def _tags(data: bytes) -> Iterator[_Tag]:
    lines = data.removeprefix(b"\xef\xbb\xbf").splitlines()
    section, has_section = False, False
    for number in range(0, len(lines) - 1, 2):
        code, value = re.match(rb"\s*(-?\d{1,9})\s*$", lines[number]), lines[number + 1]
        if code is None:
            raise InputError("this is no group code, and what follows cannot be read: export it as DXF again",
                             line=number + 1)
        tag = (int(code[1]), value, number + 1)
        if tag[0] == 0:
            kind = value.strip().upper()
            section = kind == b"SECTION" or (section and kind != b"ENDSEC")
            has_section |= section
        if tag[0] != 999:
            yield tag
        if tag[0] == 0 and kind == b"EOF":
            return
    if not has_section:
        raise InputError("this is no DXF drawing: it has no SECTION; export it as DXF again")
    if section:
        raise InputError("the drawing is cut off: its last section has no end; export it as DXF again",
                         line=len(lines))


def _in_order(entity: list[_Tag]) -> list[_Tag]:
    """Return the tags of one entity or variable, each Y and Z behind its X, the n-th behind the n-th."""
    from ezdxf.lldxf.types import POINT_CODES

    if entity and entity[0][1].strip().upper() in _DRAWN:
        _refuse_no_numbers(entity)
    codes = [code for code, _, _ in entity]
    behind: dict[int, list[_Tag]] = {}
    moved: set[int] = set()
    for x_code in sorted(POINT_CODES.intersection(codes)):
        x, y, z = ([i for i, code in enumerate(codes) if code == x_code + step] for step in (0, 10, 20))
        if len(x) != len(y):
            _refuse_halves(entity, x_code)
            continue
        heights = z if len(z) == len(x) else [None] * len(x)
        for point in zip(x, y, heights, strict=True):
            rest = [i for i in point[1:] if i is not None]
            behind[point[0]] = [entity[i] for i in rest]
            moved.update(rest)
    return [t for i, tag in enumerate(entity) if i not in moved for t in (tag, *behind.get(i, ()))]


def _refuse_no_numbers(entity: list[_Tag]) -> None:
    for code, value, line in entity:
        if 10 <= code < 60:
            try:
                float(value)
            except ValueError:
                raise InputError(f"{value.decode('ascii', 'replace')!r} is no number: write it with a decimal point",
                                 line=line + 1) from None


def _refuse_halves(entity: list[_Tag], x_code: int) -> None:
    _, kind, line = entity[0]
    if kind.strip().upper() in _DRAWN:
        raise InputError(f"{kind.strip().decode('ascii')} has X and Y without each other (group codes {x_code} "
                         f"and {x_code + 10}): export it as DXF again", line=line)
