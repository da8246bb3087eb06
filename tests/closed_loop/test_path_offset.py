"""Guides beside the path: by whole steps, to the left of where it leads, and nothing forgotten."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmsim.closed_loop.simulation import Simulation
from edmsim.controllers.feed.laws import FixedController
from edmsim.controllers.planner.registry import PathOffset
from edmsim.errors import InputError
from edmsim.machine.machine import Machine
from edmsim.program.path import plan_path

TURN = np.array([(1000, 1000), (1100, 1000), (1100, 1100), (1000, 1100)])
PUNCH = Path(__file__).parents[2] / "envs" / "small_punch.ngc"


def test_it_is_reached_step_by_step_on_the_left_and_turns_with_the_path():
    offset = PathOffset(2.0)
    offset.begin_leg(TURN)
    assert offset.steps(7, 0.0, 5.0) == [(7, 1, 1)]
    assert offset.steps(8, 10.0, 5.0) == [(8, 1, 1)]
    assert offset.steps(9, 20.0, 5.0) == []  # 2 of 2.5 steps
    assert offset.lateral_um == (0.0, 4.0)
    assert offset.steps(10, 150.0, 5.0) == [(10, 0, -1), (10, 1, -1)]  # upwards now: the left is -x
    assert offset.steps(11, 150.0, 5.0) == [(11, 0, -1), (11, 1, -1)]
    assert offset.lateral_um == (-4.0, 0.0)
    offset.clear()
    assert offset.lateral_um == (0.0, 0.0)


@pytest.mark.slow
@given(st.lists(st.tuples(st.floats(0, 300), st.floats(-60, 60)), max_size=60), st.sampled_from([0.5, 2.0, 4.0]))
def test_an_axis_makes_a_step_a_window_and_never_more_than_its_target(windows, step_um):
    offset = PathOffset(step_um)
    offset.begin_leg(TURN)
    for time_ns, (path_um, target_um) in enumerate(windows):
        before = np.array(offset.lateral_um)
        steps = offset.steps(time_ns, path_um, target_um)
        moved = np.zeros(2)
        for _, axis, direction in steps:
            moved[axis] += direction * step_um
        assert np.abs(moved).max(initial=0.0) <= step_um
        np.testing.assert_array_equal(np.array(offset.lateral_um), before + moved)
    assert np.abs(offset.lateral_um).max() <= 60.0 + step_um / 2


def test_it_goes_on_where_it_was_saved():
    first, second = PathOffset(2.0), PathOffset(2.0)
    for offset in (first, second):
        offset.begin_leg(TURN)
    first.steps(0, 0.0, 30.0)
    second.restore(json.loads(json.dumps(first.snapshot())))
    assert second.lateral_um == first.lateral_um == (0.0, 2.0)


class Lateral(FixedController):
    """Feeds evenly beside the path, and does not look at its parameters."""

    name = "lateral"

    def __post_init__(self):
        pass


def simulation(offset_um):
    machine = Machine.load(height_mm=5.0)
    path = plan_path(PUNCH, auto_offset_mm=machine.auto_offset_mm)
    return Simulation(machine, path, Lateral(20.0, offset_um), seed=1, resolution="fast")


def test_a_cut_offsets_the_guides_laterally_and_counts_along_the_path():
    plain, shifted = simulation(0.0), simulation(-8.0)
    for _ in range(12):
        plain.step()
        shifted.step()
    assert shifted.path_um == plain.path_um
    assert shifted.position_um == plain.position_um
    assert shifted.commanded_um == plain.commanded_um
    (x0, y0), (x1, y1) = plain.plant.commanded_um, shifted.plant.commanded_um
    assert np.hypot(x1 - x0, y1 - y0) == 8.0


def test_a_cut_with_a_lateral_offset_is_resumed_to_the_bit():
    whole, first, second = simulation(6.0), simulation(6.0), simulation(6.0)
    for _ in range(6):
        whole.step()
    for _ in range(2):
        first.step()
    arrays, values = first.snapshot()
    second.restore(arrays, json.loads(json.dumps(values)))
    for _ in range(4):
        second.step()
    assert second.plant.commanded_um == whole.plant.commanded_um
    assert second.sums == whole.sums


@pytest.mark.parametrize("offset_um", [np.nan, np.inf])
def test_a_controller_commands_a_finite_offset(offset_um):
    with pytest.raises(InputError, match="the lateral controller commanded an offset of"):
        simulation(offset_um)
