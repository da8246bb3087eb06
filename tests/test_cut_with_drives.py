"""``edmsim.cut(drive=...)``: servo drives under the table, following errors reported, a trip that stops."""

import json
from pathlib import Path

import numpy as np
import pytest

import edmsim
from edmsim.controllers.axis import uhu
from edmsim.recording.windows import column

SLOT = Path(__file__).parents[1] / "examples" / "slot.iso"


@pytest.mark.slow
@pytest.mark.parametrize("drive", ["uhu", "servo-module", "eanpos"])
def test_a_cut_under_a_servo_drive_follows_its_steps(drive):
    result = edmsim.cut(SLOT, height_mm=10, resolution="fast", drive=drive, max_time_s=6)
    report = result.report
    assert report["outcome"] == "time-limit"
    assert report["settings"]["drive"] == drive
    error = np.hypot(column(result.windows, "following_x_um"), column(result.windows, "following_y_um"))
    assert report["following_error_um"]["max"] == pytest.approx(error.max())
    assert 0.1 < report["following_error_um"]["rms"] < 8.0
    assert report["path_length_mm"] > 0.02


def test_a_stepper_has_no_following_error():
    result = edmsim.cut(SLOT, height_mm=10, resolution="fast", max_time_s=2)
    assert result.report["following_error_um"] == {"max": 0.0, "rms": 0.0}


@pytest.mark.slow
def test_a_following_error_stops_the_machine_and_leaves_with_3(monkeypatch, tmp_path, edmsim):
    tuned = dict(uhu.DATA["tuned"]["table"], error_limit=10)
    monkeypatch.setitem(uhu.DATA["tuned"], "table", tuned)
    words = ("cut", SLOT, "--drive", "uhu", "--height", 10, "--resolution", "fast", "--quiet", "--max-time", 10)
    assert edmsim(*words, "--out", tmp_path / "cut").status == 3
    report = json.loads((tmp_path / "cut" / "report.json").read_text(encoding="utf-8"))
    assert report["outcome"] == "drive-trip"
    assert "has shut off its motor" in report["reason"]


TWO_SQUARES = """G21 G90
G0 X-0.4 Y0.1
G41
G1 X0 Y0.1
Y0.21
X0.21
Y0
X0
Y0.1
G40
G0 X3.6 Y2.1
G41
G1 X4 Y2.1
Y2.2
X4.2
Y2
X4
Y2.1
G40
M2
"""


@pytest.mark.slow
@pytest.mark.usefixtures("draws_pictures")
def test_the_shares_of_the_error_do_not_take_a_rapid_for_a_cut(tmp_path):
    """On the move between two contours the wire is not in the metal."""
    (tmp_path / "two.ngc").write_text(TWO_SQUARES)
    result = edmsim.cut(tmp_path / "two.ngc", height_mm=1, resolution="fast")
    assert result.report["outcome"] == "finished"
    assert result.report["profile_error_um"]["shares"]["planner"]["max"] < 5.0
