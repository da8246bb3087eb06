"""docs/planners.md: every planner and speed, written by the code as it is; and the errors it tells are errors."""

import math
from pathlib import Path

import numpy as np
import pytest

from edmsim.controllers.planner.errors import COMPARED, LONG_UM, SHORT_UM, SPEEDS, MoveError, around, move

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "planners.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def planners(load_script):
    return load_script(DOCS / "make" / "planners.py")


def table(heading):
    """Cells of a section's table, without its rule."""
    lines = PAGE.split(f"## {heading}")[1].split("\n## ")[0].splitlines()
    head, _, *rows = [tuple(map(str.strip, line.strip("|").split("|"))) for line in lines if line.startswith("|")]
    return head, rows


@pytest.mark.parametrize("heading", [f"Long moves, {LONG_UM} um", f"Short moves, {SHORT_UM} um"])
def test_the_page_has_every_planner_at_every_speed(planners, heading):
    head, rows = table(heading)
    assert head == planners.HEADS
    assert [row[:2] for row in rows] == [(f"`{planner}`", str(speed)) for planner in COMPARED for speed in SPEEDS]
    assert (DOCS / "planners.png").is_file()


@pytest.mark.slow
@pytest.mark.parametrize("planner", COMPARED)
def test_its_short_moves_are_those_of_the_present_code(planners, planner):
    _, rows = table(f"Short moves, {SHORT_UM} um")
    for speed in (2, 127):
        assert planners.row(planner, speed, around(planner, SHORT_UM, speed)) in rows


@pytest.mark.slow
def test_its_failures_are_those_of_the_present_code(planners):  # T-G6, T-G9, T-G11, T-G12
    _, rows = table("Where the algorithm of 1982 fails")
    short = [failure for failure in planners.FAILURES if max(failure.run_um) <= 10_000]
    assert all(planners.failure_row(failure) in rows for failure in short)
    assert len(rows) == len(planners.FAILURES)


@pytest.mark.slow
def test_page_and_picture_are_written(planners, tmp_path, monkeypatch):
    moves = {
        (planner, length, speed): np.tile([1.0, 0.5, 0.1, 0.2, 1.0], (360, 1))
        for planner in COMPARED for length in (LONG_UM, SHORT_UM) for speed in SPEEDS
    }  # fmt: skip
    monkeypatch.setattr(planners, "measure", lambda: moves)
    planners.write(tmp_path / "planners.md")
    assert (tmp_path / "planners.md").read_text(encoding="utf-8").startswith("# Planners\n")
    assert (tmp_path / "planners.png").stat().st_size > 5000


def test_a_straight_move_along_an_axis_has_no_error_but_its_ends():
    found = move("dda", (1000, 0), 64)
    assert found.path_max_um == 0.0
    assert found.end_um == 0.0
    assert found.speed_percent == pytest.approx(0.0, abs=1e-3)
    assert found.ripple_percent < 0.1


def test_a_lost_axis_is_reported_as_the_end_s_error_and_45_degrees_as_the_path_s():  # T-G11, T-G9
    lost = move("poscal-literal", (10_000, 30), 127)
    assert (lost.path_max_um, lost.end_um) == pytest.approx((30.0, 30.0), abs=1e-3)
    slow = move("poscal-literal", (700, 300), 1)
    # both axes at one unit: 300 um up the diagonal the short one has arrived
    assert slow.path_max_um == pytest.approx(400 * 300 / math.hypot(700, 300), abs=1.5)


@pytest.mark.parametrize(("planner", "speed"), [("poscal", 3), ("sine-table", 5), ("dda", 99)])
def test_between_the_speeds_of_the_page_it_is_no_worse(planner, speed):  # T-G12
    found = MoveError(*around(planner, 400, speed, np.arange(0.25, 360, 7.3)).T)
    assert np.max(found.path_max_um) < 2.0
    assert np.abs(found.speed_percent).max() < 1.5
    assert np.max(found.end_um) <= math.sqrt(2) + 1e-9
