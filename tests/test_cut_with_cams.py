"""Tables with rows, cams, and SZELCAMPUFFER in a cut: E-2, E-26, E-32, E-44, E-46."""

import json
import re

import numpy as np
import pytest
import shapely

import edmsim
from edmsim.closed_loop.cycle import PlannerMotion
from edmsim.closed_loop.simulation import Simulation
from edmsim.controllers import axis, from_text
from edmsim.controllers.axis.elcam.file import Cam, ErrorTable, TableRows, load_tables, read_tables, text_of
from edmsim.controllers.axis.elcam.step_compensation import StepCompensation
from edmsim.controllers.planner.registry import PathOffset, make_planner
from edmsim.controllers.protocols import FeedCommand, Step
from edmsim.errors import InputError
from edmsim.machine.machine import Machine
from edmsim.machine.setting import guide_bends
from edmsim.metrology.edges import cut_edges
from edmsim.plant.plant import Plant
from edmsim.program.path import plan_path

LINE = "G21 G90\nG0 X0 Y0\nG1 X0.4\nM2\n"
FAST = {"height_mm": 3.0, "resolution": "fast", "controller": "fixed:feed_um_s=30"}
FLAT = [(-100.0, 0.0), (200.0, 0.0)]
TWENTY = [(-100.0, 20.0), (200.0, 20.0)]


@pytest.fixture
def line(tmp_path):
    file = tmp_path / "line.ngc"
    file.write_text(LINE, encoding="utf-8")
    return file


def rows_of(row_axis, first_mm, last_mm, interpolated=True, axis="y", master="x"):
    points = np.array([*FLAT, *TWENTY])
    return ErrorTable(axis, master, points, rows=TableRows(row_axis, first_mm, last_mm, 2, interpolated))


def simulation_of(line, tables, machine="agiecut-dem15", **options):
    machine = Machine.load(machine, height_mm=3.0)
    path = plan_path(line, "auto", auto_offset_mm=machine.auto_offset_mm, table_um=65_000, grid_um=1)
    options = {"max_time_s": 1.5, **options}
    controller = from_text("fixed:feed_um_s=30")
    return Simulation(machine, path, controller, resolution="fast", compensation=load_tables(tables), **options)


def turns(simulation):
    """Cut, and yield path, position of the table's axes and programmed position after every window, in um."""
    while simulation.outcome is None:
        simulation.step()
        yield simulation.path_um, np.array(simulation.plant.axes_um), np.array(simulation.position_um)


@pytest.mark.parametrize("options", [{}, {"drives": {name: axis.tuned("uhu") for name in "xy"}}])
def test_a_row_is_chosen_along_the_path(line, options):  # E-32, E-46
    simulation = simulation_of(line, [rows_of("path", 0.0, 0.04)], **options)
    off = [(path, place[1] - program[1]) for path, place, program in turns(simulation)]
    assert off[-1][0] > 35.0
    for path_um, y_um in off:
        assert y_um == pytest.approx(min(path_um / 2, 20.0), abs=3.5)  # motor steps are 2 um


def test_a_row_is_chosen_by_a_third_axis_hard_or_between_two(line):  # E-15, E-32, E-46, E-A3
    for interpolated, y_um in ((True, 15.0), (False, 20.0)):
        tables = [rows_of("y", 0.0, 10.0, interpolated, axis="x", master="x")]
        compensation = StepCompensation(load_tables(tables), 0.5)
        assert compensation.begin((3000.0, 7500.0)) == (3000.0 + y_um, 7500.0)
    compensation.begin((3000.0, 4990.0))
    made = compensation.motor_steps([Step(k, 1, 1) for k in range(40)])
    assert len([step for step in made if step.axis == 0]) == 40
    assert len({step.time_ns for step in made if step.axis == 0}) == 1  # all at once, half way between the rows
    start_mm = simulation_of(line, []).position_um[1] * 1e-3
    simulation = simulation_of(line, [rows_of("y", start_mm - 5.0, start_mm + 5.0, axis="y", master="x")])
    for _, place, program in turns(simulation):
        assert place[1] - program[1] == pytest.approx(10.0, abs=1.0)


def test_an_axis_of_the_upper_guide_chooses_a_row_and_is_compensated_itself():  # E-46, 4.2
    cam = Cam("u", "x", np.array([(0.0, 0.0), (10.0, 1.0)]))
    own = ErrorTable("u", "u", np.array([(-1.0, 0.0), (0.0, 0.0), (1.0, 30.0)]))
    compensation = StepCompensation(load_tables([rows_of("u", 0.0, 1.0), own, cam]), 2.0)
    assert compensation.begin((5000.0, 0.0)) == (5000.0, 10.0)
    assert compensation.upper_um == (516.0, 0.0)  # 500, and 15 of its own error
    made = compensation.motor_steps([Step(k, 0, 1) for k in range(500)])
    assert [sum(d for _, which, d in made if which == k) for k in range(4)] == [500, 1, 51, 0]  # u 600, and 18


@pytest.fixture(scope="module")
def led(tmp_path_factory):
    """A cut whose upper guide moves along the path from 0.25 to 0.3 mm beyond the lower one, and its track."""
    file = tmp_path_factory.mktemp("cams") / "line.ngc"
    file.write_text(LINE, encoding="utf-8")
    cam = Cam("v", "path", np.array([(0.0, 0.25), (0.05, 0.3), (10.0, 0.3)]))
    simulation = simulation_of(file, [cam], max_time_s=8.0)
    return simulation, list(turns(simulation))


def test_the_upper_guide_follows_the_path(led):  # 2.2.1, E-20, E-23
    for path_um, place, program in led[1]:
        assert place[3] == pytest.approx(min(250.0 + path_um, 300.0), abs=3.0)
        assert place[:3] == pytest.approx([*program, 0.0], abs=2.0)


def test_the_wall_leans_as_the_wire_does(led):
    simulation, _ = led
    field, machine = simulation.plant.field, simulation.machine
    middle = []
    for number in (0, field.n_slices - 1):
        edge = shapely.get_coordinates(cut_edges(field, number))
        y = edge[edge[:, 0] > edge[:, 0].max() - 0.1, 1]  # the end of the slot
        middle.append((y.min() + y.max()) / 2)
    clearance = machine.base.guides.clearance_mm.value
    slices_apart = machine.height_mm * (1 - 1 / field.n_slices)
    stiff_mm = guide_bends(machine).stiff_mm  # the wire bends this far inside the guides
    lean = 0.3 * slices_apart / (machine.height_mm + 2 * (clearance - stiff_mm))
    assert middle[1] - middle[0] == pytest.approx(lean, rel=0.15)


def test_the_upper_guide_is_in_place_before_the_cut_begins(line):  # E-44
    x_mm = simulation_of(line, []).position_um[0] * 1e-3
    with_x = Cam("u", "x", np.array([(0.0, 0.1), (x_mm, 0.3), (65.0, 0.1)]))
    simulation = simulation_of(line, [with_x, Cam("v", "path", np.array([(0.0, -0.2), (9.0, 0.0)]))])
    assert simulation.plant.axes_um[2:] == (300.0, -200.0)
    start = simulation.plant.axes_um
    simulation.step()
    assert np.abs(np.subtract(simulation.plant.axes_um, start)).max() <= 2.0
    plant = Plant(Machine.load(height_mm=3.0), resolution="fast")
    plant.rethread((*plant.commanded_um, 40.0, -20.0), 0)
    assert plant.axes_um[2:] == (40.0, -20.0)


def test_windows_that_end_early_lose_no_step_of_what_goes_by_the_path():
    # windows of an iso-energetic generator end when the pulses have ignited, so steps are planned beyond their end
    saw = np.array([(0.0, 0.0), (0.01, 0.01), (0.02, 0.0)])
    tables = [Cam("u", "path", saw), ErrorTable("y", "path", saw * (1.0, 1e3))]
    compensation, planner = StepCompensation(load_tables(tables), 2.0), make_planner("exact", [(0, 0), (300, 200)])
    motion = PlannerMotion(planner, None, 0.0, 0, FeedCommand(100.0), 100.0, PathOffset(2.0), compensation)
    made, start_ns = [], 0
    compensation.begin((0.0, 0.0))
    motion._offset.begin_leg(np.array([(0, 0), (300, 200)]))
    for end_ns in np.cumsum(np.tile([61_000_000, 47_000_000, 83_000_000], 15)).tolist():
        planned = motion.plan(start_ns, start_ns + 100_000_000, certain=False)
        made += [step for step in planned if step.time_ns < end_ns]
        motion.keep(start_ns, end_ns)
        start_ns = end_ns
        x, y, u, v = (2.0 * sum(step.direction for step in made if step.axis == k) for k in range(4))
        assert (u, v) == compensation.upper_um
        assert (x, y) == tuple(np.add(planner.position_um, compensation.offset_um))
    assert 250.0 < motion.path_um < 350.0


def test_it_goes_on_from_a_snapshot_bit_for_bit(line):
    tables = [rows_of("path", 0.0, 0.04), Cam("u", "path", np.array([(0.0, 0.0), (0.01, 0.01), (0.02, 0.0)]))]
    one, two = (simulation_of(line, tables) for _ in range(2))
    for _ in range(30):
        one.step()
    arrays, values = one.snapshot()
    two.restore(arrays, json.loads(json.dumps(values)))
    one.run()
    two.run()
    assert one.plant.axes_um == two.plant.axes_um
    assert one.plant.removed_mm3 == two.plant.removed_mm3


TABLE = '[[table]]\naxis = "x"\nmaster = "x"\n'
CAM = '[[cam]]\naxis = "u"\nmaster = "path"\npoints = [[0, 0], [1, 0.1]]\n'
ROWS = '[[table]]\naxis = "y"\nmaster = "x"\nrow_axis = "path"\nrow_range_mm = [0, 1]\n'


@pytest.mark.usefixtures("draws_pictures")
def test_the_report_says_what_followed_and_what_compensated(line, tmp_path):
    file = tmp_path / "tables.toml"
    file.write_text(CAM, encoding="utf-8")
    report = edmsim.cut(line, max_time_s=1, compensation=str(file), **FAST).report
    assert report["table_error_um"] is None
    assert any("u followed its cam along path" in notice for notice in report["notices"])
    file.write_text(f"{ROWS}rows = [[[-99, 0], [99, 0]], [[-99, 20], [99, 20]]]", encoding="utf-8")
    report = edmsim.cut(line, max_time_s=1, compensation=str(file), **FAST).report
    assert report["table_error_um"]["compensated"]
    assert not any("cam" in notice for notice in report["notices"])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (CAM.replace('"u"', '"x"'), "cam 1: the program moves x, and an axis that follows a cam takes no"),
        (CAM.replace('"u"', '"q"'), "cam 1: axis: must be 'x', 'y', 'u' or 'v'"),
        (CAM.replace("path", "u"), "cam 1: master: must be 'x', 'y' or 'path'"),
        (CAM.replace("0.1", "1.5"), "cam 1: u moves 1.5 mm for each mm of path after 0 mm; it must be at most 1"),
        (CAM + CAM, "cam 2: there is a cam of u already"),
        (CAM + "reversal_um = 2\n", "cam 1: reversal_um: unknown"),
        (CAM.replace("path", "x").replace("[1, 0.1]", "[99, 50]"), "the cam of u leads the upper guide 16."),
        ("", "a compensation file has one section"), ("[[table]", "not valid TOML"),
        ("[cam]\naxis = 3", "a compensation file has one section [[cam]] or more"),
        ('[[table]]\naxis = "x"\npoints = [[0, 0], [1, 1]]', "table 1: master: missing"),
        (f"{TABLE}points = [[0, 0], [1]]", "table 1: points.1.1: missing"),
        (f"{TABLE}points = [[0, nan], [1, 1]]", "points.0.1: must be a finite number"),
        (f"{TABLE}points = [[0, 0], [1, 1e300]]", "points.1.1: must be less than or equal to 10000"),
        (f"{TABLE}points = [[0, 0], [1, 1001]]", "changes by 1001 um from 0 to 1 mm; it must be at most 1000 um for"),
        (f'{TABLE}reversal_um = "a"\npoints = [[0, 0], [1, 1]]', "reversal_um: must be a valid number"),
        (f"{TABLE}reversal_um = -1e300\npoints = [[0, 0], [1, 1]]", "must be greater than or equal to -10000"),
        (f"{TABLE}points = [[0, 0], [1, 1]]\n" * 2, "table 2: there is a table of x along x already"),
        (f"{CAM}[cams]\na = 1", "unknown section 'cams'; there are: [[table]], [[cam]]"),
        (f"{ROWS}rows = []", "table 1: rows: must have at least 1 item"),
        (f"{ROWS}rows = 3", "rows: must be a valid list"),
        (f"{ROWS}rows = [[[0, 1]]]", "table 1: rows.0: must have at least 2 items"),
        (f"{ROWS}rows = [[[0, 1], [0, 2]]]", "rows.0: places must rise, but 0 mm follows 0 mm"),
        (f"{ROWS}rows = [[[0, 1], [5, 2]], [[0, 1], [4, 2]]]",
         "row 2 has 2 points from 0 to 4 mm; the first one has 2 from 0 to 5 mm, and all must be alike"),
        (f"{ROWS}rows = [[[0, 1], [5, 2]], [[0, 1], [1, 1], [5, 2]]]", "row 2 has 3 points"),
        (f"{ROWS}rows = [[[0, 1], [3, 2], [5, 2]], [[0, 1], [2, 1003], [5, 2]]]",
         "the error changes by 1001.33 um from row 1 to the next, 1 mm further; it must be at most 1000 um"),
        (f"{ROWS}rows = [[[0, 1], [5, 2]]]\npoints = [[0, 1], [5, 2]]", "points: unknown"),
        (f"{ROWS}points = [[0, 1], [5, 2]]", "row_axis: unknown"),
        (ROWS.replace("path", "z") + "rows = [[[0, 1], [5, 2]]]", "row_axis: must be 'x', 'y', 'u'"),
        (ROWS.replace("[0, 1]", "[1, 1]") + "rows = [[[0, 1], [5, 2]], [[0, 1], [5, 2]]]",
         "must begin and end apart"),
        (f"{ROWS}interpolate_rows = 1\nrows = [[[0, 1], [5, 2]]]",
         "interpolate_rows: must be a valid boolean"),
    ],
)  # fmt: skip
def test_a_bad_file_gets_one_line(line, text, message, tmp_path):
    file = tmp_path / "bad.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=re.escape(message)) as refused:
        edmsim.cut(line, compensation=str(file), max_time_s=1, **FAST)
    assert refused.value.file == (None if "leads" in message else str(file))  # the table is too small, not the file
    assert "\n" not in str(refused.value)


def test_what_is_written_is_read_again(tmp_path):
    file = tmp_path / "rows.toml"
    tables = [rows_of("u", -1.0, 2.5), rows_of("path", 3.0, 0.0, interpolated=False, axis="x")]
    file.write_text(text_of(tables), encoding="utf-8")
    again = read_tables(file)
    assert [table.rows for table in again] == [table.rows for table in tables]
    assert all(np.array_equal(a.points, b.points) for a, b in zip(again, tables, strict=True))


def many(count):
    return [ErrorTable("x", "x", np.column_stack([np.linspace(-1.0, 66.0, count), np.zeros(count)]))]


@pytest.mark.slow
def test_the_room_for_all_tables_comes_from_the_environment(line, tmp_path, monkeypatch):  # E-2, chapter 1
    file = tmp_path / "many.toml"
    file.write_text(text_of(many(6251)), encoding="utf-8")
    words = {"compensation": str(file), "max_time_s": 0.1, **FAST}
    monkeypatch.delenv("SZELCAMPUFFER", raising=False)
    load_tables(many(6250))
    with pytest.raises(InputError, match=r"many.toml: table 1: 6251 points .* 100000 bytes .* SZELCAMPUFFER"):
        edmsim.cut(line, **words)
    monkeypatch.setenv("SZELCAMPUFFER", "100016")
    assert edmsim.cut(line, **words).report["outcome"] == "time-limit"
    with pytest.raises(InputError, match="table 2: 3 points are more"):
        load_tables([*many(6250), ErrorTable("y", "x", np.array([(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)]))])
    for wrong in ("lots", "-1", "1e5", "67108865", "9" * 40, "٣"):
        monkeypatch.setenv("SZELCAMPUFFER", wrong)
        with pytest.raises(InputError, match=r"variable SZELCAMPUFFER is .*; it must be 0 to 67108864 bytes"):
            edmsim.cut(line, **words)
