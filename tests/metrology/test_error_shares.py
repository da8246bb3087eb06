"""Shares of the profile error against ways whose distance from the edge is known in closed form."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edmsim.metrology.profile import ProfileError
from edmsim.metrology.shares import SHARES, error_shares, share_stats
from edmsim.program.path import WireContour

OFFSET_UM = 155.0
SQUARE_MM = np.array([(2.0, 2.0), (6.0, 2.0), (6.0, 6.0), (2.0, 6.0), (2.0, 2.0)])
PATH_UM = 1000 * (4.0 + (SQUARE_MM - 4.0) * (2.0 + OFFSET_UM / 1000) / 2.0)
"""Round the square, the part on its left."""
ALONG = np.linspace(0.25, 0.75, 11)
"""Places on every side, far from its corners, as shares of it."""
NORMALS = np.repeat([(0.0, -1.0), (1.0, 0.0), (0.0, 1.0), (-1.0, 0.0)], len(ALONG), axis=0)
CONTOUR = WireContour(np.round(PATH_UM).astype(np.int64), 0, SQUARE_MM, True, "left", offset_um=OFFSET_UM)

move = st.tuples(st.floats(-30.0, 30.0), st.floats(-30.0, 30.0))


def measured(error_um: np.ndarray) -> ProfileError:
    points = np.concatenate([a + ALONG[:, None] * (b - a) for a, b in pairwise(SQUARE_MM)])
    s = np.arange(len(points), dtype=float)
    return ProfileError(points, s, np.atleast_2d(error_um), np.zeros(len(points), bool))


def way(moved: np.ndarray) -> np.ndarray:
    """A dense way round the square, a window every 0.8 um or so, moved by some um."""
    share = np.linspace(0.0, 4.0, 22_000)
    return np.column_stack([np.interp(share, range(5), PATH_UM[:, k]) for k in (0, 1)]) + moved


@pytest.mark.slow
@settings(max_examples=5, deadline=None)
@given(move, move, move, st.floats(-20.0, 20.0))
def test_a_way_that_is_moved_leaves_what_it_is_further_off_each_side(planner, drive, wire, gap) -> None:
    moves = np.cumsum([planner, drive, wire], axis=0)
    off = NORMALS @ np.array([planner, drive, wire]).T
    error = off.sum(axis=1) + gap
    shares = error_shares(measured(error), CONTOUR, [way(moved) for moved in moves])
    assert shares.shape == (len(SHARES), len(error))
    np.testing.assert_allclose(shares[0], 0.0, atol=1e-6)
    np.testing.assert_allclose(shares[1:4].T, off, atol=1e-6)
    np.testing.assert_allclose(shares[4], gap, atol=1e-6)
    np.testing.assert_allclose(shares.sum(axis=0), error, atol=1e-6)
    stats = share_stats(shares, error)
    assert stats["gap"]["mean"] == pytest.approx(gap, abs=1e-6)
    assert stats["wire"]["max"] == pytest.approx(np.abs(off[:, 2]).max(), abs=1e-6)
    if np.abs(error).max() > 1e-3:
        assert sum(share["of_mean_square"] for share in stats.values()) == pytest.approx(1.0)


def test_an_inner_corner_the_wire_cannot_reach_belongs_to_the_path() -> None:
    inner = WireContour(np.round(_inside()).astype(np.int64), 0, SQUARE_MM, True, "right", offset_um=OFFSET_UM)
    corner = ProfileError(SQUARE_MM[:1], np.zeros(1), np.array([[64.2]]), np.zeros(1, bool))
    dense = np.concatenate([np.linspace(a, b, 5000) for a, b in pairwise(_inside())])
    shares = error_shares(corner, inner, [dense] * 3)
    assert shares[0, 0] == pytest.approx(OFFSET_UM * (2**0.5 - 1), abs=1e-6)
    assert shares[1:4, 0] == pytest.approx(np.zeros(3), abs=0.1)


def _inside() -> np.ndarray:
    return 1000 * (4.0 + (SQUARE_MM - 4.0) * (2.0 - OFFSET_UM / 1000) / 2.0)


@pytest.mark.slow
def test_what_was_not_measured_has_no_shares() -> None:
    error = np.zeros(len(NORMALS))
    error[3] = np.nan
    shares = error_shares(measured(error), CONTOUR, [way(np.zeros(2))] * 3)
    assert np.isnan(shares[:, 3]).all()
    assert np.isfinite(np.delete(shares, 3, axis=1)).all()
    not_begun = error_shares(measured(error), CONTOUR, [np.zeros((0, 2))] * 3)
    assert np.isnan(not_begun).all()
    assert all(np.isnan(value) for share in share_stats(not_begun, error).values() for value in share.values())
