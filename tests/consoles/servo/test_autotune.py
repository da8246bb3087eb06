"""``edmsim tune drive``: values found are better than those of delivery, can be typed in and saved; their picture."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from edmsim.axis_bench import AxisBench
from edmsim.consoles.autotune import (
    STEP_COUNTS,
    AxisResponse,
    AxisTrace,
    ModuleOperator,
    Tuning,
    UhuOperator,
    autotune,
    oscillation_of,
)
from edmsim.controllers.axis import CHIPS, tuned
from edmsim.controllers.axis.drive import axis_row, data_of
from edmsim.errors import InputError

FILES = {"uhu": "uhu", "servo-module": "servo_module"}
ONE_COUNT = 1 / STEP_COUNTS


@cache
def tuning(drive, axis):
    return autotune(drive, axis_row(axis), lambda line: None)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("drive", "axis"), [("uhu", "bench"), ("servo-module", "table"), ("servo-module", "fast")]
)
def test_a_tuned_drive_follows_better_than_as_delivered(drive, axis):  # U-25, U-58, M-37
    before, after = tuning(drive, axis).before.figures, tuning(drive, axis).after.figures
    assert after.rms < 0.7 * before.rms
    assert after.settling_s < 0.8 * before.settling_s
    assert after.overshoot < max(0.85 * before.overshoot, 1.5 * ONE_COUNT)  # the module begins without any


@pytest.mark.slow
def test_what_is_found_can_be_typed_in_and_is_there_after_power_up():  # U-58 step 5
    for drive, axis in (("uhu", "bench"), ("servo-module", "table")):
        found = tuning(drive, axis)
        bench = AxisBench({"x": CHIPS[drive](axis_row(axis))})
        bench.run(0.2)
        for line in found.lines:
            assert b"?" not in bench.talk(line.encode() + b"\r")
        bench.run(0.2)
        bench.power_cycle("x")
        bench.run(0.2)
        names = {row["letter"]: row["name"] for row in data_of(FILES[drive])["parameter"]}
        assert {bench.drive().parameters[names[letter]] for letter in found.values} == set(found.values.values())
        assert bench.pins().enabled
        bench.steps("x", 50)
        bench.run(0.4)
        assert int(bench.axis()["count"]) == pytest.approx(50, abs=1)


@pytest.mark.parametrize(
    ("drive", "axis"),
    [("uhu", "bench"), ("uhu", "table"), *(("servo-module", axis) for axis in ("bench", "table", "fast"))],
)
def test_a_drive_that_is_called_tuned_takes_a_jump_and_rests(drive, axis):
    bench = AxisBench({"x": tuned(drive, axis)})
    bench.run(0.1)
    bench.trace = True
    bench.talk(b"G50\r" if drive == "uhu" else b"+50\r")
    bench.run(0.4)
    place = bench.samples()["count"]
    assert place.max() < 1.6 * 50  # V adds to a jump, which no motion is
    assert place[-1] == pytest.approx(50, abs=2)
    assert np.ptp(place[-200:]) <= 1


@pytest.mark.parametrize("axis", ["bench", "table", "fast"])
def test_both_drives_make_an_axis_oscillate_alike(axis):
    uhu, module = (oscillation_of(kind(axis_row(axis))) for kind in (UhuOperator, ModuleOperator))
    assert module.period_s == pytest.approx(uhu.period_s, rel=0.25)
    assert 8 <= uhu.amplitude < 50
    duty = data_of("uhu")["pins"]["duty_high"] - data_of("uhu")["pins"]["duty_low"]
    full = data_of("servo_module")["chip"]["duty_centre"]
    assert module.gain / full == pytest.approx(uhu.gain * duty / 255, rel=0.6)


@pytest.mark.parametrize(
    "changes", [{"friction_Nm": 20.0, "stiction_Nm": 20.0}, {"backlash_um": 2000.0, "on_table": 1.0}]
)
def test_an_axis_that_cannot_be_tuned_is_refused_in_a_line(changes):  # U-59
    for drive in CHIPS:
        with pytest.raises(InputError, match="does not swing") as refused:
            autotune(drive, axis_row("bench", **changes), lambda line: None)
        assert "\n" not in str(refused.value)


@pytest.mark.parametrize(("error", "swings"), [
    ([50, 20, 5, 0, 0, 0, 0, 0], False),  # there and stays
    ([50, 20, -6, -2, 0, 0, 0, 0], False),  # beyond by an eighth
    ([50, 20, -12, -2, 0, 0, 0, 0], True),  # beyond by a quarter
    ([50, 20, -6, 6, 0, 0, 0, 0], True),  # and back
    ([50, -50, 50, -50, 50, -50, 50, -50], True),
    ([50, 40, 35, 35, 35, 35, 35, 35], False),  # friction holds it
    ([], True),  # the drive shows nothing
])  # fmt: skip
def test_an_answer_that_oscillates_differs_from_one_that_rests(error, swings):
    answer = AxisTrace(np.arange(len(error)) * 1e-3, np.array(error, np.int64))
    assert answer.oscillates(50, 0.15) == swings


def test_the_figures_of_an_answer():
    answer = AxisTrace(np.arange(6) * 1e-3, np.array([50, 20, -5, 2, 1, -1], np.int64))
    assert answer.overshoot(50) == pytest.approx(0.1)
    assert answer.settling_s == pytest.approx(3e-3)
    assert AxisTrace(answer.time_s, np.array([3, -4, 3, -4, 3, -4])).rms == pytest.approx(np.sqrt(12.5))


@pytest.mark.slow
def test_the_command_prints_what_to_type_and_draws_before_and_after(tmp_path, monkeypatch, piped):
    rests = True

    def found(drive, motor, tell):
        tell("told as it goes")
        assert motor.tobytes() == axis_row("table").tobytes()
        restless = AxisTrace(np.array([0.0, 0.2, 0.399]), np.array([STEP_COUNTS, -STEP_COUNTS, STEP_COUNTS]))
        before = AxisResponse(*[restless] * 3)
        return replace(tuning(drive, "table"), before=before, **({} if rests else {"after": before}))

    monkeypatch.setattr("edmsim.consoles.autotune.autotune", found)
    done = piped(b"", "tune", "drive", "servo-module", "--axis", "table", "--out", tmp_path / "steps.png")
    assert done.returncode == 0
    assert done.text[0].splitlines() == list(tuning("servo-module", "table").lines)
    assert "told as it goes" in done.text[1]
    assert "as delivered: overshoot 100 %, not settled, following error of a move 50.0 counts rms" in done.text[1]
    assert "tuned: overshoot 0 %, settled after 1" in done.text[1]
    picture = np.asarray(Image.open(tmp_path / "steps.png").convert("RGB")).reshape(-1, 3)
    assert len(np.unique(picture, axis=0)) > 10
    rests = False
    refused = piped(b"", "tune", "drive", "servo-module", "--axis", "table")
    assert (refused.returncode, refused.text[0]) == (2, "")
    assert "cannot be tuned for the axis table: no values were found with which it settles" in refused.text[1]


DOCS = Path(__file__).parents[3] / "docs"


@pytest.mark.slow
def test_the_picture_has_a_column_for_each_drive(load_script):
    steps = load_script(DOCS / "make" / "servo_steps.py")
    answer = AxisTrace(np.array([0.0, 0.01, 0.02]), np.array([STEP_COUNTS, 5, 0]))
    response = AxisResponse(*[answer] * 3)
    one = Tuning(("P1",), {"P": 1}, response, response)
    figure = steps.figure(dict.fromkeys(steps.DRIVES, one))
    assert [axes.get_title() for axes in figure.axes if axes.get_title()] == list(steps.DRIVES.values())
    drawn = figure.axes[0].get_lines()[-1].get_ydata()
    assert list(drawn) == [0, STEP_COUNTS - 5, STEP_COUNTS]
