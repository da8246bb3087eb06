"""Trim: the wall as it is measured, the effect of a pass, and what is refused."""

import math

import numpy as np
import pytest

from edmsim.envs import Trim
from edmsim.envs.families import GAP_UM
from edmsim.envs.sub_envs import FINISHED_UM, STRETCH_UM
from edmsim.errors import InputError
from edmsim.plant.workpiece.blanks import wall_error_um, wavy_wall
from edmsim.plant.workpiece.kerf_field import KerfField, Stock

STILL = {"wave_um": (6.0, 6.0), "wave_mm": (0.3, 0.3), "allowance_um": (8.0, 8.0), "height_mm": 20.0}


def field_of(stock: Stock, cell_um: float) -> KerfField:
    field = KerfField(3, stock, cell_um, extent_um=4000.0)
    field.allocate(2000.0, 1000.0, 600.0)
    return field


@pytest.mark.parametrize("off_um", [0.0, 5.0, -7.3])
def test_a_flat_wall_is_as_far_off_as_it_is(off_um):
    field = field_of(Stock((0.0, 0.0, 4000.0, 1000.0 + off_um)), 4.0)
    assert wall_error_um(field, 1000.0, 1900.0, 1924.0) == pytest.approx(abs(off_um), abs=4.0 / 32768)
    assert math.isnan(wall_error_um(field, 1000.0, 1900.0, 1901.0))  # no column's middle


def test_waves_of_arcs_have_the_error_of_parabolas():
    # about its middle a parabola of height a has sqrt(4/45 + 1/36) a: its variance, and the mean a/6 below
    field = field_of(wavy_wall((1600.0, 1000.0), 800.0, 12.0, 400.0, 0.0), 2.0)
    assert wall_error_um(field, 1000.0, 1600.0, 2400.0) == pytest.approx(math.sqrt(4 / 45 + 1 / 36) * 12.0, rel=0.02)


def test_errors_count_from_where_the_wall_is_finished(make_task):
    task = make_task("Trim", **STILL, length_mm=0.2)
    task.reset(seed=1)
    wall = task.scenario.wall
    x, y = (float(v) for v in task.scenario.legs_um[0][0])
    assert (wall.x_um, wall.y_um) == (x, y - task.machine.wire_diameter_um / 2 - GAP_UM)
    results = [task.advance(60.0)]
    while not results[-1].over:
        results.append(task.advance(60.0))
    assert results[-1].cause.name == "FINISHED"
    reached = np.array([result.observation.path_um for result in results])
    near = np.array([result.near for result in results])
    assert not near[reached < FINISHED_UM].any()
    assert near[reached > FINISHED_UM + STRETCH_UM + 10.0].all()
    assert all(result.error_um == 0.0 for result in results if not result.near)
    # what is measured on the way is the wall as it is in the end
    behind = wall.x_um + reached[-1] - FINISHED_UM
    left = wall_error_um(task.plant.field, wall.y_um, behind - STRETCH_UM, behind)
    assert results[-1].error_um == pytest.approx(left, abs=1.0)


def finished(make_task, feed_um_s: float, offset_um: float) -> float:
    """Error in the mean over a pass."""
    task = make_task("Trim", **STILL, length_mm=0.4)
    task.reset(seed=1)
    errors = []
    while True:
        result = task.advance(feed_um_s, offset_um=offset_um)
        if result.near:
            errors.append(result.error_um)
        if result.over:
            return float(np.mean(errors))


@pytest.mark.slow
def test_a_pass_takes_the_waves_off_and_its_feed_and_offset_say_how_deep(make_task):
    near, off, farther = (finished(make_task, 190.0, offset_um) for offset_um in (-2.0, 1.0, 4.0))
    before = math.hypot(8.0 - 1.0, 0.298 * 6.0)  # allowance, less a sixth of the waves, and their deviation
    assert near < 2.0
    assert near < off < farther < before
    assert finished(make_task, 40.0, -2.0) > near  # too deep
    assert finished(make_task, 40.0, 1.0) < off


def test_an_offset_counts_as_an_action_and_is_observed(make_env):
    env = make_env("Trim", **STILL)
    env.reset(seed=1)
    observation, _, _, _, info = env.step(np.array([0.2, 0.0, 0.0, -0.5], np.float32))
    assert info["offset_um"] == -6.0
    assert observation[-1] == -0.5
    assert env.unwrapped.family.action_names == ("feed", "on_time", "period_ratio", "offset")


def test_sub_environments_lead_their_guides_as_cuts_do(make_task):
    task = make_task("Corner", height_mm=5.0)
    task.reset(seed=1)
    x, y = task.plant.commanded_um
    for _ in range(5):
        task.advance(0.0, offset_um=7.0)
    assert task.plant.commanded_um == (x, y + 8.0)  # 3.5 steps, to the even whole
    for _ in range(5):
        task.advance(0.0)
    assert task.plant.commanded_um == (x, y)


def test_what_is_drawn_is_within_its_ranges(make_env):
    env = make_env("Trim")
    family = env.unwrapped.family
    for seed in range(5):
        drawn = env.reset(seed=seed)[1]["drawn"]
        for name in ("allowance_um", "wave_um", "wave_mm"):
            low, high = getattr(family, name)
            assert low <= drawn[name] <= high


@pytest.mark.parametrize(("arguments", "message"), [
    ({"wave_um": (0.0, 5.0)}, r"wave_um is \(0.0, 5.0\): give a number above 0, or the ends of a range"),
    ({"allowance_um": (5.0, 24.0)}, "come to 29 um, and the wire would stand in the metal: 27 um at the most"),
    ({"offset_um": 0.0}, "offset_um is 0.0"), ({"offset_um": 101.0}, "offset_um is 101.0"),
    ({"wave_mm": (0.5, 0.2)}, "wave_mm"),
])  # fmt: skip
def test_what_cannot_be_used_is_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        Trim(**arguments)
