"""What ELCAM tables can do here beyond their document: all opt-in, nothing of it at the object interface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray


@dataclass
class CamExtensions:
    """Extensions of a table; as made, all are off.

    Attributes
    ----------
    cubic : bool
        Between points, a cubic through them with the slopes of the points' neighbours, instead of a straight line:
        it has no corners in speed, and passes through every point all the same.
    reversal : float
        For compensation tables: by how much the error is greater while the master moves up than while it moves
        down, in units of the follower. Half of it is added upwards and taken off downwards.
    """

    cubic: bool = False
    reversal: float = 0.0


def cubic(xs: NDArray[Any], ys: NDArray[Any], k: int, share: float) -> float:
    """Return Hermite's cubic on piece `k` at a share of its way, with Catmull and Rom's slopes for uneven points."""
    width = float(xs[k + 1]) - float(xs[k])
    y0, y1 = float(ys[k]), float(ys[k + 1])
    if width <= 0.0:
        return y0
    rise0 = _slope(xs, ys, k - 1, k + 1) * width if k > 0 else y1 - y0
    rise1 = _slope(xs, ys, k, k + 2) * width if k + 2 < len(xs) else y1 - y0
    away = 1.0 - share
    bend = share * away * (away * (rise0 - (y1 - y0)) - share * (rise1 - (y1 - y0)))
    return y0 + share * (y1 - y0) + bend


def _slope(xs: NDArray[Any], ys: NDArray[Any], a: int, b: int) -> float:
    width = float(xs[b]) - float(xs[a])
    return (float(ys[b]) - float(ys[a])) / width if width > 0.0 else 0.0


def blend(share: float) -> float:
    """Return how much of a ramp is done at a share of its time: without a jump in speed at either end."""
    share = min(max(share, 0.0), 1.0)
    return share * share * (3.0 - 2.0 * share)
