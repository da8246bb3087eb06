"""The picture of docs/servo-drives.md is made by the code as it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from edmsim.consoles.servo.autotune import STEP_COUNTS, AxisResponse, Oscillation, Tuning
from edmsim.consoles.servo.operator import AxisTrace

DOCS = Path(__file__).parents[3] / "docs"


@pytest.mark.slow
def test_the_picture_has_a_column_for_each_drive(load_script):
    steps = load_script(DOCS / "make" / "servo_steps.py")
    answer = AxisTrace(np.array([0.0, 0.01, 0.02]), np.array([STEP_COUNTS, 5, 0]))
    response = AxisResponse(*[answer] * 3)
    one = Tuning(("P1",), {"P": 1}, Oscillation(1.0, 0.01, 10.0), response, response)
    figure = steps.figure(dict.fromkeys(steps.DRIVES, one))
    assert [axes.get_title() for axes in figure.axes if axes.get_title()] == list(steps.DRIVES.values())
    drawn = figure.axes[0].get_lines()[-1].get_ydata()
    assert list(drawn) == [0, STEP_COUNTS - 5, STEP_COUNTS]
    assert steps.PICTURE.is_file()
    assert f"]({steps.PICTURE.relative_to(DOCS)})" in (DOCS / "servo-drives.md").read_text(encoding="utf-8")
