"""What made the profile error: shares of programmed path, planner, drive, wire and gap at every place of the edge.

Each share is how much further from the edge the wire's way passed than that of the step before: the programmed path
than the offset, the commanded position than the path, the guides than the commanded position, the wire than its
guides. The gap has the rest, so that the five add up to the error.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from edmsim.metrology.profile import ProfileError
from edmsim.program.path import WireContour

Floats = NDArray[np.float64]

SHARES = ("path", "planner", "drive", "wire", "gap")
"""Names of the shares, in the order of `error_shares`."""


def error_shares(profile: ProfileError, contour: WireContour, ways_um: Sequence[Floats]) -> Floats:
    """Split the profile error of one contour, whose offset is above 0.

    Parameters
    ----------
    profile : ProfileError
    contour : WireContour
    ways_um : three arrays (n, 2)
        Ways of commanded position, guides and wire along the contour in order of time, at most some um between two
        places; in um on the table.

    Returns
    -------
    array (5, places)
        Shares in um at ``profile.points_mm``, in the order of `SHARES`; positive where metal is left. They add up to
        ``profile.mean_um``, and are NaN where that is, and everywhere for a contour that was not begun.
    """
    points = profile.points_mm * 1000
    away = np.stack([_distance(points, way) for way in (contour.points_um.astype(np.float64), *ways_um)])
    last = profile.mean_um + contour.offset_um - away[-1]
    shares = np.concatenate([np.diff(away, axis=0, prepend=contour.offset_um), [last]])
    return np.where(np.isfinite(shares[-1]), shares, np.nan)


def _distance(points: Floats, way: Floats) -> Floats:
    """Distance of every point (n, 2) to the nearest place of a way (m, 2); NaN if there is none."""
    if len(way) < 2:
        return np.full(len(points), np.nan)
    tree = shapely.STRtree(shapely.linestrings(np.stack([way[:-1], way[1:]], axis=1)))
    _, distance = tree.query_nearest(shapely.points(points), return_distance=True, all_matches=False)
    return np.asarray(distance, np.float64)


def share_stats(shares_um: Floats, error_um: Floats) -> dict[str, dict[str, float]]:
    """Return for every share its ``mean``, ``rms``, ``max`` (of the magnitude) and ``of_mean_square``.

    Parameters
    ----------
    shares_um : array (5, n)
        Of one contour or of several, one behind the other; see `error_shares`.
    error_um : array (n,)
        The error they add up to.

    Returns
    -------
    dict
        By the names of `SHARES`, in um; ``of_mean_square`` is the mean of share times error over that of the error's
        square: these add up to 1, and one that makes up for others is negative. All are NaN if nothing was measured.
    """
    known = np.isfinite(shares_um).all(axis=0)
    shares, error = shares_um[:, known], error_um[known]
    if not len(error):
        return {name: dict.fromkeys(("mean", "rms", "max", "of_mean_square"), float("nan")) for name in SHARES}
    square = float(np.mean(error**2))
    return {
        name: {
            "mean": float(share.mean()), "rms": float(np.sqrt(np.mean(share**2))), "max": float(np.abs(share).max()),
            "of_mean_square": float(np.mean(share * error)) / square if square > 0 else float("nan"),
        }
        for name, share in zip(SHARES, shares, strict=True)
    }  # fmt: skip
