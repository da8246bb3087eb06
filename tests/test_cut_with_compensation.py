"""``edmsim.cut(compensation=...)`` and ``edmsim measure table``: errors are measured, compensated, and reported."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

import edmsim
from edmsim.closed_loop.simulation import Simulation
from edmsim.controllers import axis, from_text
from edmsim.controllers.axis.elcam.file import ErrorTable, load_tables, read_tables, text_of
from edmsim.controllers.axis.elcam.step_compensation import StepCompensation
from edmsim.controllers.protocols import Step
from edmsim.errors import InputError
from edmsim.machine.machine import Machine
from edmsim.measure import measure_table
from edmsim.program.path import plan_path
from edmsim.recording.report import summary

SMALL = Path(__file__).with_name("punch_1500_um.ngc")
FAST = {"height_mm": 5.0, "resolution": "fast", "controller": "fixed:feed_um_s=30"}
BAD = """
like = "agiecut-dem15"
title = "a table so bad that a part of 1.5 mm shows it"
[geometry]
x_pitch_um_m = { value = 9000.0, source = "ours" }
y_pitch_um_m = { value = 9000.0, source = "ours" }
squareness_um_m = { value = 12000.0, source = "ours" }
"""


@pytest.fixture(scope="module")
def bad(tmp_path_factory):
    file = tmp_path_factory.mktemp("machines") / "bad.toml"
    file.write_text(BAD, encoding="utf-8")
    return str(file)


@pytest.fixture(scope="module")
def tables(bad):
    return measure_table(Machine.load(bad), seed=1).tables()


@pytest.fixture
def file(tables, tmp_path):
    target = tmp_path / "table.toml"
    target.write_text(text_of(tables, ["as measured"]), encoding="utf-8")
    return target


def simulation_of(tables, machine, **options):
    machine = Machine.load(machine, height_mm=5.0)
    path = plan_path(SMALL, "auto", auto_offset_mm=machine.auto_offset_mm, table_um=65_000, grid_um=1)
    return Simulation(
        machine, path, from_text("fixed:feed_um_s=30"), resolution="fast", max_time_s=4.0,
        compensation=None if tables is None else load_tables(tables), **options,
    )  # fmt: skip


@pytest.mark.parametrize("options", [{}, {"drives": {name: axis.tuned("uhu") for name in "xy"}}])
def test_the_wire_is_where_the_program_wants_it(tables, bad, options):
    # E-31, E-32, E-33, E-A1: on the machine's table, under steppers and under drives
    for compensation, most in ((tables, 1.2), (None, 30.0)):
        simulation = simulation_of(compensation, bad, **options)
        errors = []
        while simulation.outcome is None:
            simulation.step()
            errors.append(np.hypot(*(np.array(simulation.plant.place_um) - simulation.position_um)))
        assert simulation.outcome == "time-limit"
        assert (5.0 if compensation is None else 0.0) < np.mean(errors) < most  # a motor step is 2 um
        assert np.array(simulation.commanded_um) == pytest.approx(simulation.position_um, abs=2.0)


@pytest.mark.slow
def test_the_report_has_the_profile_error_with_and_without(file, bad):
    bare = edmsim.cut(SMALL, max_time_s=40, machine=bad, **FAST).report
    cut = edmsim.cut(SMALL, max_time_s=40, machine=bad, compensation=str(file), **FAST).report
    table = cut["table_error_um"]
    assert not bare["table_error_um"]["compensated"]
    assert table["compensated"]
    assert table["left_um"]["max"] < 0.2 * table["without_um"]["max"]
    assert table["profile_without_um"]["rms"] > cut["profile_error_um"]["rms"] + 1.0
    assert table["profile_without_um"]["rms"] == pytest.approx(bare["profile_error_um"]["rms"], rel=0.25)
    assert cut["settings"]["compensation"] == str(file)
    assert len(cut["settings"]["compensation_sha256"]) == 16
    shares = [report["profile_error_um"]["shares"]["drive"]["rms"] for report in (bare, cut)]
    assert shares[1] < 0.3 * shares[0]  # the effect of the table is shown with the drives
    assert cut["notices"] == bare["notices"]
    assert re.search(r"max, .* rms; compensated to .* max", dict(summary(cut))["table"])
    assert "profile error without compensation" in dict(summary(cut))
    assert re.fullmatch(r"moves the wall by [\d.]+ µm max, [\d.]+ µm rms", dict(summary(bare))["table"])


@pytest.mark.slow
def test_the_report_counts_neither_backlash_nor_what_takes_it_out_as_errors_left(tmp_path):
    machine, tables = tmp_path / "worn.toml", tmp_path / "tables.toml"
    machine.write_text(BAD.replace("[geometry]", 'table.backlash_um = {value = 8.0, source = "ours"}\n[geometry]'))
    tables.write_text(text_of(measure_table(Machine.load(machine), seed=1).tables()), encoding="utf-8")
    cut = edmsim.cut(SMALL, machine=str(machine), compensation=str(tables), **FAST).report
    assert cut["table_error_um"]["left_um"]["max"] < 2.0  # one motor step
    shares = cut["profile_error_um"]["shares"]
    assert shares["planner"]["max"] < 2.0
    assert shares["drive"]["rms"] < 2.5


def test_a_table_that_is_too_short_is_reported(tmp_path):
    # E-A14
    short = tmp_path / "short.toml"
    short.write_text(text_of([ErrorTable("x", "x", np.array([(0.0, 1.0), (10.0, 2.0)]))]), encoding="utf-8")
    notices = edmsim.cut(SMALL, max_time_s=1, compensation=str(short), **FAST).report["notices"]
    assert any("beyond the compensation table of x along x" in notice for notice in notices)


def test_a_resumed_cut_still_knows_of_a_table_that_was_too_short():
    first, second = (load_tables([ErrorTable("x", "x", np.array([(0.0, 1.0), (10.0, 2.0)]))]) for _ in range(2))
    one, two = StepCompensation(first, 2.0), StepCompensation(second, 2.0)
    for x_um, held in ((9000.0, False), (11_000.0, True), (9000.0, True)):
        one.begin((x_um, 0.0))
        two.restore(json.loads(json.dumps(one.snapshot())))
        assert (first.tables[0].held, second.tables[0].held) == (held, held)


def test_a_drive_tuned_for_other_steps_is_refused():
    with pytest.raises(InputError, match=r"the drive of x \(uhu\) moves 2 um at a step; this machine's steps are 1"):
        edmsim.cut(SMALL, machine="worn-table", drive="uhu:M=9", height_mm=5.0, resolution="fast", max_time_s=1)


def test_steps_are_added_where_the_error_grows_and_left_out_where_it_falls():
    # E-A1: (0 mm, 0 um) to (1 mm, 100 um): a step more for every ten
    points = np.array([(0.0, 0.0), (1.0, 100.0), (2.0, 0.0)])
    compensation = StepCompensation(load_tables([ErrorTable("y", "x", points)]), 2.0)
    assert compensation.begin((0.0, 0.0)) == (0.0, 0.0)
    up = compensation.motor_steps([Step(k, 0, 1) for k in range(500)])
    assert sum(d for _, k, d in up if k == 0) == 500
    assert sum(d for _, k, d in up if k == 1) == 50
    assert compensation.offset_um == (0.0, 100.0)
    down = compensation.motor_steps([Step(k, 0, 1) for k in range(500)])
    assert sum(d for _, k, d in down if k == 1) == -50
    assert compensation.begin((1000.0, 500.0)) == (1000.0, 600.0)
    own = StepCompensation(load_tables([ErrorTable("x", "x", points)]), 2.0)
    own.begin((1000.0, 0.0))
    assert sum(d for _, _, d in own.motor_steps([Step(k, 0, 1) for k in range(500)])) == 450


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_tables(tmp_path / "none.toml")


@pytest.mark.slow
def test_measure_table_writes_what_cut_reads(edmsim, tmp_path):
    made, left, picture = tmp_path / "made here.toml", tmp_path / "left.toml", tmp_path / "table.png"
    words = ["measure", "table", "--machine", "worn-table", "--runs", 2]
    shown = edmsim(*words, "--out", made, "--plot", picture)
    assert shown.status == 0
    assert "out of square" in shown.out
    assert f"--machine worn-table --compensation '{made}'" in shown.out.replace("\n", "")
    assert picture.stat().st_size > 10_000
    assert {(t.axis, t.master) for t in read_tables(made)} == {("x", "x"), ("y", "y"), ("x", "y"), ("y", "x")}
    document = json.loads(edmsim(*words, "--compensation", made, "--out", left, "--json").out)
    assert abs(document["squareness_um_m"]) < 40.0  # 400 without compensation
    assert document["x"]["accuracy"] < 4.0  # 21 without compensation; most of the rest is the motor's steps
    assert document["circle"]["circular_deviation"] < 6.0  # 21 without compensation
    rest = edmsim(*words, "--compensation", made, "--out", left)
    assert "Cut with it" not in rest.out  # the new tables do not replace those in force
    assert "worn-table with made here.toml in force" in left.read_text()
    assert edmsim(*words, "--out", made / "a.toml").status == 2  # a file is not a folder
    once = edmsim("measure", "table", "--runs", 1)
    assert once.status == 2
    assert "1 runs are not within 2..100: a spread needs two" in once.err
    assert edmsim("measure", "table", "--interval", 0.001).status == 2
