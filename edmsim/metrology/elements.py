"""The profile error line by line and arc by arc of the program."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edmsim.metrology.profile import ProfileError, error_stats
from edmsim.program.path import WireContour

Floats = NDArray[np.float64]

_ROUND_MM = 0.003
"""Points of an arc lie on its circle within this: chord tolerance and rounding (ours)."""


@dataclass(frozen=True)
class ElementError:
    """A line or arc of the edge as drawn, and its error.

    Attributes
    ----------
    contour, element : int
        Number of the contour in the order of cutting, and of the element along it, both from 1.
    line : int or None
        The program's line; None for a drawing.
    kind : {"line", "arc", "curve"}
    radius_mm : float or None
        Of an arc.
    x_mm, y_mm, end_x_mm, end_y_mm : float
        First and last point on the table.
    length_mm : float
    mean_um, rms_um : float
        Of the profile error over the element and all slices, without what is out of the wire's reach; NaN if unknown.
    low_um, high_um : float
        Least and greatest of the same: positive is metal left.
    """

    contour: int
    element: int
    line: int | None
    kind: str
    radius_mm: float | None
    x_mm: float
    y_mm: float
    end_x_mm: float
    end_y_mm: float
    length_mm: float
    mean_um: float
    rms_um: float
    low_um: float
    high_um: float


def element_errors(
    number: int, contour: WireContour, profile: ProfileError, unreachable_um: Floats
) -> list[ElementError]:
    """Return the error of every element of a contour, in order; none if the contour does not know its elements.

    Parameters
    ----------
    number : int
        Of the contour, from 1.
    contour : WireContour
    profile : ProfileError
    unreachable_um : array (n,)
        By `edmsim.metrology.reach.unreachable_um`.
    """
    if not contour.elements:
        return []
    begins = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(contour.nominal_mm, axis=0).T))])
    chord_of = np.clip(np.searchsorted(begins, profile.s_mm, side="right") - 1, 0, len(contour.elements) - 1)
    elements = np.array([element for element, _ in contour.elements])
    error = profile.error_um - unreachable_um
    return [
        _element(number, contour, np.flatnonzero(elements == element), error[:, elements[chord_of] == element])
        for element in np.unique(elements)
    ]


def _element(number: int, contour: WireContour, chords: NDArray[np.intp], error_um: Floats) -> ElementError:
    points = contour.nominal_mm[np.append(chords, chords[-1] + 1)]
    element, line = contour.elements[chords[0]]
    kind, radius_mm = _shape(points)
    known = error_um[np.isfinite(error_um)]
    low, high, mean = (float(f(known)) if len(known) else float("nan") for f in (np.min, np.max, np.mean))
    (x, y), (end_x, end_y) = points[0].tolist(), points[-1].tolist()
    return ElementError(
        number, element, line or None, kind, radius_mm, x, y, end_x, end_y,
        float(np.hypot(*np.diff(points, axis=0).T).sum()), mean, error_stats(known)["rms"], low, high,
    )  # fmt: skip


def _shape(points: Floats) -> tuple[str, float | None]:
    """Say whether points (n, 2) are a line, an arc of some radius, or another curve."""
    if len(points) == 2:
        return "line", None
    third = (len(points) - 1) // 3
    picked = points[[0, len(points) // 2, -1]] if third == 0 else points[[0, third, 2 * third]]
    a, b, c = picked @ (1, 1j)
    cross = ((b - a).conjugate() * (c - a)).imag
    if abs(cross) < _ROUND_MM * abs(c - a):
        return ("line", None) if _is_straight(points) else ("curve", None)
    centre = a + (abs(b - a) ** 2 * (c - a) - abs(c - a) ** 2 * (b - a)) / (2j * cross)
    radii = np.abs(points @ (1, 1j) - centre)
    return ("arc", float(radii.mean())) if np.ptp(radii) < 2 * _ROUND_MM else ("curve", None)


def _is_straight(points: Floats) -> bool:
    along = points - points[0]
    x, y = along[-1]
    return bool(np.abs(along @ (-y, x)).max() < _ROUND_MM * np.hypot(x, y))
