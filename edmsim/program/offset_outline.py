"""An outline with the wire's path beside it, and what such paths keep from each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.program.offset import normal, offset_closed, offset_open
from edmsim.program.outline import Outline, Program, Side
from edmsim.program.reach import check_reach

_KEPT_APART_MM = 0.002


@dataclass(frozen=True)
class OffsetOutline:
    """One outline with the wire's path beside it, both in mm in the program's coordinates."""

    outline: Outline
    path: NDArray[np.float64]
    nominal: NDArray[np.float64]
    offset_mm: float

    @property
    def edge(self) -> shapely.LineString:
        """The part's edge."""
        return shapely.LineString(self.nominal)


def offset_outline(program: Program, outline: Outline, offset_mm: float, notices: list[str]) -> OffsetOutline:
    """Return an outline with its path at an offset; adds what the wire cannot reach to the notices."""
    beside = offset_closed if outline.closed else offset_open
    points = outline.points_mm
    if outline.wire_side is None:
        try:
            return OffsetOutline(outline, points, beside(points, outline.part_side, offset_mm), offset_mm)
        except InputError:  # there is no such edge, but the wire can go as the program says
            notices.append(f"{outline.name} is cut as written; no edge lies at the offset beside it, so its profile "
                           "is measured from the wire's centre")
            return OffsetOutline(outline, points, points, 0.0)
    try:
        path = beside(points, outline.wire_side, offset_mm)
        notices += check_reach(points, path, offset_mm, outline.line_numbers, outline.elements)
    except InputError as error:
        raise located(error, program, outline) from None
    return OffsetOutline(outline, path, points, offset_mm)


def located(error: InputError, program: Program, outline: Outline) -> InputError:
    """Return an error with the outline's name and, if it has none, its line."""
    return InputError(f"{outline.name}: {error.reason}", program.source, error.line or outline.line)


def keep_apart(legs: Sequence[OffsetOutline], source: str) -> None:
    """Refuse compensated contours so near each other that cutting one would cut into the other."""
    shut = [leg for leg in legs if leg.outline.closed and leg.outline.wire_side]
    for leg in shut:
        line = shapely.LineString(leg.path)
        for other in shut:
            distance = line.distance(other.edge)
            if distance < leg.offset_mm - _KEPT_APART_MM:
                told = f"{leg.outline.name} is too near {other.outline.name.removeprefix('the ')}"
                reason = f"the wire's centre would pass {distance:.3f} mm from it, not {leg.offset_mm:.4f} mm"
                raise InputError(f"{told}: {reason}; move them apart", source, leg.outline.line)


def refuse_trims(legs: Sequence[OffsetOutline], source: str) -> None:
    """Refuse compensated contours with different offsets in one kerf: the second would be a trim cut."""
    for one, other in combinations([leg for leg in legs if leg.outline.wire_side], 2):
        apart = shapely.LineString(one.path).distance(shapely.LineString(other.path))
        if one.offset_mm != other.offset_mm and apart < one.offset_mm + other.offset_mm:
            told = f"{other.outline.name} has an offset of {other.offset_mm:g} mm"
            reason = f"{told} and lies in the kerf of a contour with {one.offset_mm:g} mm"
            raise InputError(f"{reason}: trim cuts are not simulated, leave one of them out", source,
                             other.outline.line)


def away(leg: OffsetOutline) -> NDArray[np.float64]:
    """Return the unit vector from the part to the start of the wire path."""
    waste: Side = "right" if leg.outline.part_side == "left" else "left"
    compensated = leg.outline.wire_side is not None
    foot = leg.nominal[0] if compensated else shapely.get_coordinates(
        leg.edge.interpolate(leg.edge.project(shapely.Point(leg.path[0]))))[0]
    across = leg.path[0] - foot
    distance = float(np.hypot(*across))
    return np.asarray(across / distance) if distance > 0 else normal(leg.path[:2], waste)
