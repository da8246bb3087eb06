"""A program's conditions with a user's table: every pass is cut with the settings of its condition."""

import re
from pathlib import Path

import pytest

import edmsim
from edmsim.calibration import read_log
from edmsim.errors import InputError
from edmsim.job.options import CutSettings
from edmsim.job.plan import check, prepared
from edmsim.recording.windows import write_windows

EXAMPLES = Path(__file__).parents[1] / "examples" / "dialects"
PUNCH, TABLE = EXAMPLES / "punch-sodick.nc", EXAMPLES / "conditions.toml"
SET_UP = {
    "machine": "production", "generator": "production", "wire": "brass-250", "conditions": str(TABLE),
}


def test_every_pass_has_the_settings_of_its_condition():
    ready = prepared(PUNCH, CutSettings(**SET_UP, planner="exact"))
    rough, first, second = (one.machine for one in ready.setups)
    assert [m.t_on_us for m in (rough, first, second)] == [1.2, 0.6, 0.3]
    assert [m.tension for m in (rough, first, second)] == [12.0, 14.0, 16.0]
    assert [one.controller.name for one in ready.setups] == ["counts", "trim", "trim"]
    assert ready.approach.machine.t_on_us == 1.0  # C000, which the program calls before C001
    assert not any("technology" in notice for notice in ready.path.notices)


@pytest.mark.slow
def test_the_log_of_passes_that_a_program_has_is_none_to_fit_to(tmp_path):
    result = edmsim.cut(PUNCH, **SET_UP, planner="exact", resolution="fast", max_time_s=0.1)
    write_windows(result.windows, tmp_path / "log.parquet")
    with pytest.raises(InputError, match="it is the log of a cut in 3 passes"):
        read_log(tmp_path / "log.parquet")


def test_one_pass_is_cut_with_its_condition(tmp_path):
    program, table = tmp_path / "line.nc", tmp_path / "table.toml"
    program.write_text("C001 = 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15\nC001\nG41 H0\nG0 X0. Y0.\nG1 X2. Y0.\nX4.\nM02\n")
    table.write_text("[C001]\nt_on_us = 2.0\ntension_N = 9.0\nfeed_um_s = 12.0\n")
    ready = prepared(program, CutSettings(conditions=str(table), dialect="sodick"))
    assert (ready.machine.t_on_us, ready.machine.tension) == (2.0, 9.0)
    assert ready.controller.name == "trim"
    assert not any("stands still" in notice for notice in ready.path.notices)


def test_a_feed_that_the_planner_rounds_to_nothing_is_said_before_the_cut(tmp_path):
    program, table = tmp_path / "line.nc", tmp_path / "table.toml"
    program.write_text("C001\nG41 H0\nG0 X0. Y0.\nG1 X2. Y0.\nX4.\nM02\n")
    table.write_text("[C001]\nfeed_um_s = 0.13\n")
    still = (
        "the wire stands still: a feed of 0.13 um/s is below half a unit of the planner poscal, 0.131 um/s; choose "
        "the planner exact, or a higher feed"
    )
    settings = CutSettings(conditions=str(table), dialect="sodick")
    assert still in check(program, settings).path.notices
    assert still not in check(program, settings.model_copy(update={"planner": "exact"})).path.notices
    options = {"resolution": "fast", "max_time_s": 0.1, "dialect": "sodick"}
    with pytest.warns(UserWarning, match=re.escape(still)):
        result = edmsim.cut(program, conditions=str(table), **options)
    assert result.report.notices.count(still) == 1
    assert not result.report.path_length_mm
    moving = edmsim.cut(program, controller="fixed:feed_um_s=0.14", **options, ignore="C001")
    assert not any("stands still" in notice for notice in moving.report.notices)


@pytest.mark.parametrize(("options", "reason"), [
    ({"tension": 11.0}, r"the table of conditions decides tension of C0*1: leave the option out"),
    ({"technology": "tool-steel-brass-254"}, "both decide the passes"),
    ({"tab_mm": 3.0}, "a tab is for passes: the program has its own, leave it out"),
    ({"after_tab": "cut"}, "what is done before a tab is for passes: the program has its own"),
    ({"passes": 3}, "conditions set the program's own passes: leave out their table, or the number"),
])  # fmt: skip
def test_options_that_contradict_the_table_are_refused(options, reason):
    with pytest.raises(InputError, match=reason):
        prepared(PUNCH, CutSettings(**SET_UP, planner="exact", **options))


def test_a_table_that_the_program_does_not_call_is_refused(tmp_path):
    program = tmp_path / "line.ngc"
    program.write_text("C1\nG0 X0. Y0.\nG1 X2.\n")  # without a dialect C has no meaning
    with pytest.raises(InputError, match="calls no condition: leave the table out, or name its --dialect"):
        prepared(program, CutSettings(conditions=str(TABLE)))


def test_a_feed_of_a_later_pass_that_cannot_be_run_is_refused_before_anything_is_cut():
    with pytest.raises(InputError, match=r"feed_um_s of the trim controller is 75.0 um/s, but the machine runs at"):
        edmsim.cut(PUNCH, **SET_UP, planner="poscal", resolution="fast")


def test_a_pass_with_two_conditions_is_refused(tmp_path):
    program = tmp_path / "two.nc"
    text = PUNCH.read_text(encoding="utf-8").replace("M00", "M01")
    place = text.rindex("C001")
    program.write_text(text[:place] + "C002" + text[place + 4 :], encoding="utf-8")
    with pytest.raises(InputError, match=r"pass 1 is cut with C00\d and with C00\d: give all its contours one"):
        prepared(program, CutSettings(**SET_UP, planner="exact"))
