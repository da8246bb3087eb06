"""LinuxCNC with four axes, as cutters of foam with a hot wire have them: U V are coordinates of the upper plane."""

from __future__ import annotations

import re
from collections.abc import Iterable

from edmsim.program.dialects.dialect import Dialect

LINUXCNC = Dialect(
    "linuxcnc",
    "LinuxCNC with four axes",
    upper="absolute",
    evidence=((r"[UV][-+\d.]+", r"G64(?!\d)"),),
    comment=r"linuxcnc|foam|hot.?wire|\b(?:UV|XY).?plane",
)

_PLANE = re.compile(r"\b(XY|UV)[ -]?PLANE\D*?([-+]?(?:\d+\.?\d*|\.\d+))", re.IGNORECASE)


def plane_heights(comments: Iterable[str]) -> dict[str, float]:
    """Return the heights that comments give the planes, as ``(UV plane Z20)``: by ``XY`` and ``UV``, as written."""
    return {found[1].upper(): float(found[2]) for text in comments for found in _PLANE.finditer(text)}
