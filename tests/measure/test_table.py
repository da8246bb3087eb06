"""ISO 230-2 and ISO 230-4 on numbers worked by hand, and on tables and guides whose errors are known."""

import numpy as np
import pytest

from edmsim.controllers.axis.elcam.file import ErrorTable, load_tables, read_tables, text_of
from edmsim.errors import EdmsimError, InputError
from edmsim.machine.components import Constant
from edmsim.machine.machine import Machine
from edmsim.machine.overrides import with_overrides
from edmsim.measure import CircularTest, Positioning, measure_guides, measure_table, table_figure
from edmsim.plant.axes.geometric_errors import StillTable


def test_figures_of_positioning_are_those_of_the_standard():
    up = np.array([[1.0, 4.0], [3.0, 6.0]])  # means 2 and 5, standard deviations sqrt(2)
    down = np.array([[-1.0, 2.0], [-1.0, 2.0]])  # means -1 and 2, no spread
    found = Positioning(np.array([10.0, 20.0]), up, down).figures()
    spread = 2 * np.sqrt(2)
    assert found == pytest.approx({
        "accuracy": (5 + spread) - min(2 - spread, -1.0), "systematic": 6.0, "mean_range": 3.0, "reversal": 3.0,
        "mean_reversal": 3.0, "repeatability": max(spread + 3.0, 2 * spread), "repeatability_up": 2 * spread,
        "repeatability_down": 0.0,
    })  # fmt: skip


def test_one_run_has_no_spread():
    with pytest.raises(InputError, match="two runs or more"):
        Positioning(np.zeros(2), np.zeros((1, 2)), np.zeros((1, 2)))


def circle(radius_um=10_000.0, scale=(1.0, 1.0), centre=(0.0, 0.0), n=360):
    angle = 2 * np.pi * np.arange(n) / n
    return np.column_stack([np.cos(angle), np.sin(angle)]) * radius_um * scale + centre


def test_a_shifted_circle_is_round_and_an_ellipse_is_not():
    shifted = CircularTest(10.0, circle(centre=(5.0, -3.0)), circle(centre=(5.0, -3.0))).figures()
    assert shifted["circular_deviation"] == pytest.approx(0.0, abs=1e-3)
    assert shifted["radial_high"] == pytest.approx(np.hypot(5.0, 3.0), abs=0.1)
    oval = CircularTest(10.0, circle(scale=(1.001, 1.0)), circle()).figures()
    assert oval["circular_deviation"] == pytest.approx(10.0, abs=0.1)
    assert oval["circular_deviation_clockwise"] == pytest.approx(0.0, abs=1e-3)
    assert oval["hysteresis"] == pytest.approx(10.0, abs=0.1)


def machine_of(backlash_um=0.0):
    machine = Machine.load("worn-table")
    table = machine.base.table.model_copy(update={"backlash_um": Constant(value=backlash_um, source="ours")})
    return machine.model_copy(update={"base": machine.base.model_copy(update={"table": table})})


@pytest.mark.parametrize("interval_mm", [6.1321, 0.5, 16.25])
def test_a_run_stays_within_the_travel(monkeypatch, interval_mm):
    places, move = [], StillTable.move
    monkeypatch.setattr(StillTable, "move", lambda table, um: places.append(um) or move(table, um))
    found = measure_table(Machine.load("worn-table"), interval_mm=interval_mm, runs=2)
    assert 0.0 <= np.min(places) <= np.max(places) <= 1e3 * found.travel_mm
    assert found.along["x", "x"].targets_mm[-1] > found.travel_mm - 1.25 * interval_mm


@pytest.mark.slow
def test_the_run_finds_backlash_and_takes_it_out():
    found = measure_table(machine_of(8.0), seed=1)
    figures = found.along["x", "x"].figures()
    assert figures["mean_reversal"] == pytest.approx(-8.0, abs=0.1)  # it lags either way
    pitch = next(t for t in found.tables() if t.axis == t.master == "x")
    assert pitch.reversal_um == pytest.approx(8.0, abs=0.1)
    for across in (t for t in found.tables() if t.axis != t.master):  # whose axis is at rest, in its backlash
        assert np.interp(32.5, *across.points.T) == pytest.approx(0.0, abs=0.3)
    left = measure_table(machine_of(8.0), seed=2, compensation=load_tables(found.tables()))
    assert abs(left.along["x", "x"].figures()["mean_reversal"]) < 1.0
    assert left.circle.figures()["hysteresis"] < 0.4 * found.circle.figures()["hysteresis"]


def test_the_run_finds_the_errors_of_the_file():
    found = measure_table(Machine.load("worn-table"), seed=3)
    assert found.squareness_um_m == pytest.approx(400.0, abs=2.0)
    x = found.along["x", "x"]
    slope = np.polyfit(x.targets_mm, x.mean_um, 1)[0]
    assert slope * 1e3 == pytest.approx(-200.0, abs=10.0)
    assert found.tables()[0].reversal_um == 0.0


@pytest.mark.slow
def test_curves_between_points_need_fewer_of_them():
    left = {}
    for cubic in (False, True):
        tables = measure_table(Machine.load("worn-table"), interval_mm=1.0, seed=1).tables(cubic)
        again = measure_table(Machine.load("worn-table"), interval_mm=0.25, seed=2, compensation=load_tables(tables))
        left[cubic] = again.along["x", "x"].mean_um.std()
    assert left[True] < 0.75 * left[False]


def test_a_file_holds_what_was_measured(tmp_path):
    file = tmp_path / "tables.toml"
    tables = [ErrorTable("x", "y", np.array([(0.0, 1.5), (10.0, -2.25)]), 3.5, True)]
    file.write_text(text_of(tables, ["a head"]), encoding="utf-8")
    (read,) = read_tables(file)
    assert (read.axis, read.master, read.reversal_um, read.cubic) == ("x", "y", 3.5, True)
    assert read.points.tolist() == tables[0].points.tolist()


def test_the_figure_shows_before_and_after():
    found = measure_table(Machine.load("worn-table"), interval_mm=4.0, runs=2, seed=1)
    figure = table_figure({"as it is": found, "compensated": found})
    assert len(figure.axes) == 4
    assert [text.get_text() for text in figure.axes[0].get_legend().get_texts()] == ["as it is", "compensated"]
    assert hasattr(figure, "_repr_png_")
    for count in (0, 3):
        with pytest.raises(InputError, match=f"one or two measurements by name, not {count}"):
            table_figure({str(number): found for number in range(count)})


LOWER_MM, UPPER_MM = 0.1, -0.06


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_errors_of_both_guides_are_found_from_a_leaning_block():
    machine = with_overrides(
        Machine.load(height_mm=6.0), (("guides.lower_error_mm", LOWER_MM), ("guides.upper_error_mm", UPPER_MM))
    )
    found = measure_guides(machine, 15.0, seed=1)
    for value, true, uncertainty in zip(found[:2], (LOWER_MM, UPPER_MM), found.uncertainty_mm, strict=True):
        assert abs(value - true) < 2 * uncertainty < 0.02
    # a lower guide that is too high takes the wall back at its own height, an upper one that is too low takes it on
    assert found.shift_um[0] < -3.0


@pytest.mark.parametrize(("angle", "said"), [(0.5, "give 1 to 30"), (31.0, "give 1 to 30")])
def test_a_block_that_does_not_lean_is_refused(angle, said):
    with pytest.raises(InputError, match=said):
        measure_guides(Machine.load(height_mm=6.0), angle)


def test_a_block_whose_walls_are_not_where_they_can_be_measured_is_an_error(monkeypatch):
    monkeypatch.setattr("edmsim.measure.Simulation.run", lambda *_: "finished")  # all of the metal is left
    with pytest.raises(EdmsimError, match="lie too far off to be measured: let them lean less"):
        measure_guides(Machine.load(height_mm=6.0))


def test_a_machine_whose_upper_guide_does_not_move_is_refused():
    machine = Machine.load(height_mm=6.0)
    guides = machine.base.guides.model_copy(update={"upper_travel_mm": None})
    still = machine.model_copy(update={"base": machine.base.model_copy(update={"guides": guides})})
    with pytest.raises(InputError, match="no movable upper guide"):
        measure_guides(still)
