"""A table of 130 x 130 mm: positions counted in steps, from the program to the report."""

import numpy as np
import pytest

import edmsim
from edmsim.controllers.mcu.firmware.poscal import unit_for
from edmsim.controllers.planner.registry import PLANNERS, kind_of, make_planner
from edmsim.errors import InputError
from edmsim.plant.constants import full_mechanics
from edmsim.plant.resolution import resolution
from edmsim.validation.setups import altered

SECOND = 1_000_000_000
COUNTING = [name for name in PLANNERS if kind_of(name).counts]
# From 115 mm down to 15 mm, drawn at odd um.
LONG = "G21 G90\nG0 X100.001 Y0\nG1 X0 Y20.003\nM2\n"


@pytest.fixture
def cut_on(own_file, tmp_path):
    """Cut a program on a machine with another travel of its table."""

    def run(travel_mm, program=LONG, **settings):
        travel = "travel_mm = { value = 65.0", f"travel_mm = {{ value = {travel_mm}"
        file = tmp_path / "long.ngc"
        file.write_text(program)
        options = {"resolution": "fast", "height_mm": 5.0, "max_time_s": 1.0, "controller": "fixed:feed_um_s=30"}
        return edmsim.cut(file, machine=own_file("machines", "agiecut-dem15", travel), **{**options, **settings})

    return run


@pytest.mark.slow
@pytest.mark.parametrize("planner", COUNTING)
def test_a_job_of_100_mm_is_cut_where_the_table_has_130_mm(cut_on, planner):  # T-61
    result = cut_on(130.0, planner=planner)
    assert result.report["settings"]["position_unit"] == "step"
    points = result.path.contours[0].points_um
    assert (points % 2 == 0).all()
    assert abs(points.min(axis=0) + points.max(axis=0) - 130_000).max() <= 2
    x, y = (result.windows.column(name).to_numpy() for name in ("x_um", "y_um"))
    assert points[0, 0] == pytest.approx(115_000, abs=2)
    assert x[-1] == pytest.approx(points[0, 0] - 29, abs=4)
    assert (x % 2 == 0).all()
    assert (y % 2 == 0).all()


def test_the_laboratory_table_refuses_it_and_counts_um(cut_on):  # T-61
    with pytest.raises(InputError, match=r"spans 100\.001 x 20\.003 mm: the table has 65 x 65 mm"):
        cut_on(65.0)
    assert cut_on(65.0, "G21 G90\nG0 X9 Y0\nG1 X0\nM2\n").report["settings"]["position_unit"] == "um"
    with pytest.raises(InputError, match="the table has 40 x 40 mm"):
        cut_on(40.0)


def test_more_than_16_bits_of_steps_are_refused(cut_on):  # T-61, T-60
    with pytest.raises(InputError, match=r"a table of 132 mm is too large: 16 bits count 131\.07 mm in steps"):
        cut_on(132.0)
    assert [unit_for(travel) for travel in (65_535, 65_536, 131_070)] == ["um", "step", "step"]


@pytest.mark.parametrize("name", COUNTING)
def test_a_planner_runs_the_same_way_in_either_unit(name):  # T-61
    near = np.array([(4000, 4000), (4300, 4180), (4100, 4180)])
    far = near + 100_000
    um, steps = make_planner(name, near), make_planner(name, far, unit="step")
    there = [planner.advance(0, 90 * SECOND, 64) for planner in (um, steps)]
    if name != "poscal-literal":  # in steps, REDUC drops one bit less
        assert there[0] == there[1]
    assert um.done
    assert steps.done
    assert steps.position_um == tuple(far[-1])


@pytest.mark.parametrize("name", COUNTING)
def test_counting_steps_takes_whole_steps_up_to_131_mm(name):  # T-61, T-A11
    make_planner(name, np.array([(0, 0), (131_070, 131_070)]), unit="step")
    with pytest.raises(InputError, match=r"outside the table's 0\.\.131070 um"):
        make_planner(name, np.array([(0, 0), (131_072, 0)]), unit="step")
    with pytest.raises(InputError, match=r"point 1 of the path, \(7, 0\) um, is not a whole number of 2 um steps"):
        make_planner(name, np.array([(0, 0), (7, 0)]), unit="step")


@pytest.mark.parametrize("travel_mm", [65.0, 130.0])
def test_the_full_model_stops_behind_the_table_s_travel(travel_mm):  # T-61
    machine = altered(edmsim.Machine.load(height_mm=5), {"base.table.travel_mm": travel_mm})
    model = full_mechanics(machine, resolution("fast")).model
    for axis in "xy":
        assert model.joint(axis).range == pytest.approx([-1e-3, travel_mm * 1e-3 + 1e-3], abs=1e-12)
