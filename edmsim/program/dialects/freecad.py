"""FreeCAD's post processor for wire EDM: any line end, comments behind any sign, coordinates in any scale."""

from __future__ import annotations

import re
from collections.abc import Sequence

from edmsim.program.dialects.dialect import Dialect

FREECAD = Dialect("freecad", "FreeCAD's wire post", comment=r"FreeCAD|begin preamble")

_COORDINATE = re.compile(r"[XYIJ][-+]?[\d.]", re.IGNORECASE)
_LINE_END = re.compile(r"(?<![^\d.\s()])[^\d.\s()]++$")
_MARKS = r"[^\w\s%/();#\[]"
# every blank and mark is looked at once: a line of nothing but blanks would else take hours
_MARKED_COMMENT = re.compile(rf"(?<!\s)(?:\s++|(?=N)|(?<!{_MARKS}))(?:N\d++)?+\s*+{_MARKS}++\s*+(?=\()")
_INCHES = re.compile(r"\(machine:[^)]*\bin/min\)", re.IGNORECASE)


def without_line_ends(lines: Sequence[str]) -> list[str]:
    """Take off what stands at the end of every line with coordinates, and signs that a comment begins with."""
    # what some of these lines lack is no line end, and neither is a single letter: they may be words that were spoilt
    bare = [re.sub(r"\([^()]*\)", "", line.partition(";")[0]).rstrip() for line in lines]
    ends = [_LINE_END.search(line) for line in bare if _COORDINATE.search(line)]
    found = {end and end[0] for end in ends}
    end = found.pop() if len(found) == 1 and len(ends) > 1 else None
    cut = lines if end is None or re.fullmatch("[A-Za-z]", end) else [
        line.rstrip()[: -len(end)] if line.rstrip().endswith(end) else line for line in lines
    ]  # fmt: skip
    return [_MARKED_COMMENT.sub("", line) for line in cut]


def has_inch_comment(text: str) -> bool:
    """Say whether its comments name inches as the unit."""
    return _INCHES.search(text) is not None
