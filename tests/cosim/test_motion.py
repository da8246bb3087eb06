"""Evenly spaced steps: at the asked speed, either way, along either axis, however the windows are cut."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmsim import Machine, Plant
from edmsim.cosim.motion import EvenSteps
from edmsim.cosim.straight import Traverse
from edmsim.validation.setups import FRAIL, altered, in_a_hole


@given(feed=st.floats(0.5, 400.0), windows=st.lists(st.integers(10_000, 30_000_000), min_size=1, max_size=40))
def test_steps_are_evenly_spaced_whatever_the_windows_are(feed: float, windows: list[int]) -> None:
    motion, now, times = EvenSteps(2.0, feed), 0, []
    for length in windows:
        steps = [step for step in motion.plan(now, now + 30_000_000) if step[0] < now + length]
        motion.keep(now, now + length)
        times += [time for time, _, _ in steps]
        now += length
    every_ns = 2.0 / feed * 1e9
    assert times == pytest.approx([every_ns * (k + 1) for k in range(len(times))], abs=3)
    assert len(times) == pytest.approx(now / every_ns, abs=1)
    assert motion.path_um == pytest.approx(feed * now * 1e-9)


def test_no_feed_makes_no_steps() -> None:
    assert EvenSteps(2.0, 0.0).plan(0, 10**9) == []


def drive(plant: Plant, feed_um_s: float, seconds: float, axis: int) -> None:
    motion, end_ns = EvenSteps(plant.machine.base.table.step_um.value, feed_um_s), plant.time_ns + seconds * 1e9
    motion.axis = axis
    while plant.time_ns < end_ns:
        start_ns = plant.time_ns
        plant.advance(motion.plan(start_ns, start_ns + plant.window_ns))
        motion.keep(start_ns, plant.time_ns)


def test_a_plant_is_driven_either_way_along_either_axis() -> None:
    plant = Plant(Machine.load(height_mm=5.0), seed=1, resolution="fast")
    x, y = plant.commanded_um
    drive(plant, -25.0, 1.0, 0)
    drive(plant, 10.0, 1.0, 1)
    assert plant.commanded_um == pytest.approx((x - 25.0, y + 10.0), abs=2.0)


def test_a_straight_cut_ends_when_the_wire_breaks() -> None:
    frail = in_a_hole(altered(Machine.load(height_mm=5.0), FRAIL), 10.0, 1)
    assert Traverse(frail, 1.0).run(5.0)[-1].broken
    assert frail.time_ns < 1e9
