"""What of a drawn edge a wire of some radius and gap cannot make: inner corners, small radii, grooves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.program.offset import REACH_TOLERANCE_MM, too_narrow

_MOST_NAMED = 5
_SHARP_DEG = 15.0
"""Lines that meet at less are taken for tangents (ours)."""


@dataclass(frozen=True)
class Unreachable:
    """A place of the edge that the wire leaves metal on.

    Attributes
    ----------
    place_mm : (x, y)
        Where most stays.
    left_mm : float
        How much, from the edge to the wire's envelope.
    radius_mm : float or None
        Inner radius as drawn, 0 for a sharp corner; None for a groove or a step narrower than the wire.
    line : int
        The line of the program, 0 if there is none.
    """

    place_mm: tuple[float, float]
    left_mm: float
    radius_mm: float | None
    line: int


def check_reach(
    edge: NDArray[np.float64], path: NDArray[np.float64], distance_mm: float, line_numbers: Sequence[int],
    elements: Sequence[int],
) -> list[str]:
    """Name what of an edge the wire cannot make.

    Parameters
    ----------
    edge, path : float64 array (n, 2)
        Nominal edge and wire path in mm.
    distance_mm : float
        The offset between them: wire radius and gap.
    line_numbers : sequence of int
        Per chord of the edge.
    elements : sequence of int
        Per chord of the edge, which line or arc it belongs to: within one there are no corners.

    Returns
    -------
    notices : list of str
        Inner radii and grooves, the worst first, and all sharp inner corners in one.

    Raises
    ------
    InputError
        A groove, a neck or a radius in which more metal than the offset stays.
    """
    found = unreachable(edge, path, distance_mm, line_numbers, elements)
    corners = [place for place in found if place.radius_mm == 0]
    others = [place for place in found if place.radius_mm != 0]
    if others and others[0].left_mm > distance_mm:
        x, y = others[0].place_mm
        reason = f"{others[0].left_mm:.3f} mm of metal would stay at X{x:.3f} Y{y:.3f}"
        raise InputError(too_narrow(distance_mm, reason), line=others[0].line or None)
    notices = [_notice(place, distance_mm) for place in others[:_MOST_NAMED]]
    if len(others) > _MOST_NAMED:
        notices.append(f"{len(others) - _MOST_NAMED} more inner radii or grooves are too small for the wire")
    if corners:
        what = "1 sharp inner corner becomes" if len(corners) == 1 else f"{len(corners)} sharp inner corners become"
        notices.append(
            f"{what} an inner radius of {distance_mm:.3f} mm, wire and gap: {'' if len(corners) == 1 else 'up to '}"
            f"{corners[0].left_mm:.3f} mm of metal stays, {_at(corners[0])}"
        )
    return notices


def unreachable(
    edge: NDArray[np.float64], path: NDArray[np.float64], distance_mm: float, line_numbers: Sequence[int],
    elements: Sequence[int],
) -> list[Unreachable]:
    """Return the places of an edge that the wire leaves metal on, the worst first; parameters as `check_reach`."""
    if distance_mm == 0:
        return []
    left = shapely.distance(shapely.LineString(path), shapely.points(edge)) - distance_mm
    sharp = _sharp(edge, elements)
    found, in_run = [], np.zeros(len(edge), np.bool_)
    for chords in _runs(~_touched(edge, path, distance_mm), edge):
        vertices = np.append(chords, chords[-1] + 1)
        in_run[vertices] = True
        radius_mm = _radius_mm(edge, vertices, sharp)
        # a corner lies at its vertex, all else in the middle of a chord
        spots = edge[vertices[sharp[vertices]]] if radius_mm == 0 else (edge[chords] + edge[chords + 1]) / 2
        stays = np.atleast_1d(shapely.distance(shapely.LineString(path), shapely.points(spots))) - distance_mm
        worst = int(stays.argmax())
        x, y = spots[worst].tolist()
        most = max(float(stays[worst]), float(left[vertices].max()))
        found.append(Unreachable((x, y), most, radius_mm, line_numbers[int(chords[min(worst, len(chords) - 1)])]))
    for vertex in np.flatnonzero(sharp & ~in_run & (left > REACH_TOLERANCE_MM)).tolist():
        x, y = edge[vertex].tolist()
        found.append(Unreachable((x, y), float(left[vertex]), 0.0, line_numbers[vertex]))
    return sorted(found, key=lambda place: -place.left_mm)


def _sharp(edge: NDArray[np.float64], elements: Sequence[int]) -> NDArray[np.bool_]:
    """Say of every point of an edge whether two lines or arcs meet there at an angle; of a closed one's last, no."""
    steps = np.diff(edge, axis=0) @ (1, 1j)
    turn = np.abs(np.angle(steps / np.roll(steps, 1)))
    marks = np.asarray(elements)
    sharp = (turn > np.radians(_SHARP_DEG)) & (marks != np.roll(marks, 1))
    sharp[0] &= bool((edge[0] == edge[-1]).all())
    return np.append(sharp, False)


def _runs(missed: NDArray[np.bool_], edge: NDArray[np.float64]) -> list[NDArray[np.intp]]:
    """Return the chords in a row that the wire does not touch, run by run, also past a closed edge's end."""
    numbers = np.flatnonzero(missed)
    if not len(numbers):
        return []
    runs = np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1)
    goes_on = bool((edge[0] == edge[-1]).all()) and len(runs) > 1 and missed[0] and missed[-1]
    return [*runs[1:-1], np.concatenate([runs[-1], runs[0]])] if goes_on else runs


def _radius_mm(
    edge: NDArray[np.float64], vertices: NDArray[np.intp], sharp: NDArray[np.bool_]
) -> float | None:
    """Return the inner radius of a run: 0 with one sharp corner, None with more; else that through three points."""
    corners = int(sharp[vertices].sum())
    if corners or len(vertices) < 3:
        return 0.0 if corners == 1 else None
    a, b, c = edge[vertices[[0, len(vertices) // 2, -1]]] @ (1, 1j)
    twice_area = abs(((b - a).conjugate() * (c - a)).imag)
    return float(abs(b - a) * abs(c - b) * abs(a - c) / (2 * twice_area)) if twice_area > 0 else None


def _notice(place: Unreachable, distance_mm: float) -> str:
    stays = f"{place.left_mm:.3f} mm of metal stays"
    if place.radius_mm is None:
        return f"the contour is narrower than wire and gap, {2 * distance_mm:.3f} mm, {_at(place)}: {stays}"
    return (f"the inner radius of {place.radius_mm:.3f} mm {_at(place)} is smaller than wire and gap make it, "
            f"{distance_mm:.3f} mm: {stays}")


def _at(place: Unreachable) -> str:
    x, y = place.place_mm
    return f"at X{x:.3f} Y{y:.3f}" + (f" (line {place.line})" if place.line else "")


def _touched(edge: NDArray[np.float64], path: NDArray[np.float64], distance_mm: float) -> NDArray[np.bool_]:
    """Say for each chord whether the wire touches its middle four fifths."""
    steps = np.diff(edge, axis=0)
    middles = shapely.linestrings(np.stack([edge[:-1] + 0.1 * steps, edge[1:] - 0.1 * steps], axis=1))
    line = shapely.LineString(path)
    shapely.prepare(line)
    return np.asarray(shapely.dwithin(line, middles, distance_mm + REACH_TOLERANCE_MM), np.bool_)
