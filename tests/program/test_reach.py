"""Notices before the cut name corners that the wire cannot make, with place and radius."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmsim.program.offset import unreachable
from edmsim.program.path import plan_path

OFFSET_MM = 0.155


def notices(folder, corner):
    """Plan an opening of 10 by 10 mm with this lower right corner; return the notices of what cannot be made."""
    file = folder / "opening.ngc"
    file.write_text(f"G92 X5 Y5\nG41 D1 G1 X5 Y0\n{corner}\nY10\nX0\nY0\nX5\nG40\nM02\n")
    notices = plan_path(file, OFFSET_MM, auto_offset_mm=1.0).notices
    return [notice for notice in notices if "wire and gap" in notice]


def test_a_small_inner_radius_is_named_with_its_place(tmp_path):
    radius, corners = notices(tmp_path, "X9.9\nG3 X10 Y0.1 I0 J0.1\nG1")
    assert radius.startswith("the inner radius of 0.100 mm at X9.9")
    assert "(line 4)" in radius
    assert f"{(OFFSET_MM - 0.1) * (math.sqrt(2) - 1):.3f} mm of metal stays" in radius
    assert corners.startswith("3 sharp inner corners become an inner radius of 0.155 mm")


@pytest.mark.parametrize("radius_mm", [0.005, 0.015, 0.02])
def test_a_radius_of_one_or_two_chords_is_no_groove_and_no_corner(tmp_path, radius_mm):
    corner = f"X{10 - radius_mm:.3f}\nG3 X10 Y{radius_mm:.3f} I0 J{radius_mm:.3f}\nG1"
    radius, corners = notices(tmp_path, corner)
    assert radius.startswith(f"the inner radius of {radius_mm:.3f} mm at X9.99")
    assert corners.startswith("3 sharp inner corners")


def test_a_radius_that_the_wire_makes_is_not_named(tmp_path):
    (corners,) = notices(tmp_path, "X9.8\nG3 X10 Y0.2 I0 J0.2\nG1")
    assert corners.startswith("3 sharp inner corners")


def test_a_groove_narrower_than_the_wire_is_named(tmp_path):
    groove, _ = notices(tmp_path, "X7\nY-0.05\nX7.2\nY0\nX10")
    assert groove.startswith("the contour is narrower than wire and gap, 0.310 mm, at X7")


def test_outer_corners_and_an_offset_of_0_leave_nothing(tmp_path):
    file = tmp_path / "punch.ngc"
    file.write_text("G92 X5 Y-2\nG42 D1 G1 X5 Y0\nX10\nY10\nX0\nY0\nX5\nG40\nM02\n")
    for offset in (OFFSET_MM, 0.0):
        assert not any("wire and gap" in notice for notice in plan_path(file, offset, auto_offset_mm=1.0).notices)


@given(half_deg=st.floats(10.0, 80.0), offset_mm=st.floats(0.02, 0.3))
def test_a_sharp_corner_keeps_what_a_circle_in_it_leaves(half_deg, offset_mm):
    half = math.radians(half_deg)
    edge = 5 * np.array([(math.cos(half), math.sin(half)), (0.0, 0.0), (math.cos(half), -math.sin(half))])
    away = offset_mm / math.sin(half)
    path = np.array([edge[0] + (away, 0.0), (away, 0.0), edge[2] + (away, 0.0)])
    left_mm = offset_mm * (1 / math.sin(half) - 1)
    found = unreachable(edge, path, offset_mm, (3, 4), (1, 2))
    if left_mm < 0.002:
        assert found == []
    else:
        (corner,) = found
        assert corner.left_mm == pytest.approx(left_mm, rel=1e-9)
        assert (corner.place_mm, corner.radius_mm, corner.line) == ((0.0, 0.0), 0.0, 4)
