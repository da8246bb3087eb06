"""What a controller is told of a program of two contours: the same in a cut as in an evaluation."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from numpy.typing import NDArray

import edmsim
from edmsim.controllers import FeedCommand, WindowObservation, make
from edmsim.controllers.feed.mcu import McuController
from edmsim.envs.episode import Task
from edmsim.evaluation.episode import Episode
from edmsim.machine.machine import Machine

SQUARE = "G1 X{0} Y0.05\nY0.1\nX{1}\nY0\nX{0}\nY0.05\nG40\n"


class Listener:
    """Commands a steady feed, and keeps what it was told and shown."""

    name: ClassVar[str] = "listener"

    def __init__(self, t_period_us: float | None = None) -> None:
        self.t_period_us = t_period_us
        self.legs: list[tuple[NDArray[Any], float, float]] = []
        self.shown: list[list[WindowObservation]] = []

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        self.legs.append((points_um, start_um, machine.t_period_us))

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        self.shown.append([])
        return FeedCommand(33.0)

    def update(self, window: WindowObservation) -> FeedCommand:
        self.shown[-1].append(window)
        return FeedCommand(33.0, t_period_us=self.t_period_us)

    def snapshot(self) -> dict[str, float | int | str]:
        return {}

    def restore(self, state: dict[str, float | int | str]) -> None: ...


@pytest.fixture
def program(tmp_path: Path) -> Path:
    file = tmp_path / "two.ngc"
    file.write_text(
        "G21 G90\nG0 X-0.3 Y0.05\nG41 D1\n" + SQUARE.format(0, 0.1) + "G0 X3.2 Y0.05\nG41 D1\n"
        + SQUARE.format(3.5, 3.6) + "M2\n"
    )
    return file


def cut(program: Path, controller: Listener) -> Listener:
    edmsim.cut(program, height_mm=0.5, resolution="fast", controller=controller)
    return controller


def evaluated(program: Path, controller: Listener) -> Listener:
    task = Task("Contour", resolution="fast", program=program, height_mm=0.5, randomise=None)
    assert Episode(task, controller, 1, "listener").run().outcome == "finished"
    return controller


@pytest.mark.slow
def test_a_cut_and_an_evaluation_tell_a_controller_the_same_legs(program: Path) -> None:
    in_cut, in_evaluation = cut(program, Listener()), evaluated(program, Listener())
    for told in (in_cut, in_evaluation):
        assert len(told.legs) == len(told.shown) == 2
        (first, start, _), (_, second_start, _) = told.legs
        assert start == 0.0
        assert second_start == pytest.approx(np.hypot(*np.diff(first, axis=0).T).sum(), abs=3)
        assert told.shown[0][-1].path_um == pytest.approx(second_start, abs=3)
        assert second_start <= told.shown[1][0].path_um < second_start + 5
    for (points, start, _), (others, other_start, _) in zip(in_cut.legs, in_evaluation.legs, strict=True):
        np.testing.assert_allclose(points[-4:], others[-4:], atol=3)
        assert start == pytest.approx(other_start, abs=3)


@pytest.mark.slow
@pytest.mark.parametrize("run", [cut, evaluated])
def test_every_leg_begins_with_the_setting_of_the_set_up(program: Path, run: Any) -> None:
    told = run(program, Listener(t_period_us=150.0))
    assert [period for _, _, period in told.legs] == [100.0, 100.0]
    for shown in told.shown:
        assert shown[0].duration_s == pytest.approx(255 * 100e-6)
        assert shown[1].duration_s == pytest.approx(255 * 150e-6)


def test_the_1982_controller_knows_the_corners_of_a_later_leg() -> None:
    points = np.array([(30_000, 30_000), (30_300, 30_000), (30_300, 30_200)])
    seen = WindowObservation(0.0, 0.0255, 10, 30, 40.0, 1.0, 9.0, 20.0, 0.0)
    commands = []
    for start_um in (0.0, 812.0):
        controller = make("mcu", corner_um=50.0)
        assert isinstance(controller, McuController)
        controller.set_up(Machine.load(), points, start_um)
        controller.reset(33.0)
        places = np.arange(0.0, 480.0, 10.0) + start_um
        commands.append([controller.update(seen._replace(path_um=place)).t_on_us for place in places.tolist()])
    assert commands[0] == commands[1]
    assert min(commands[0]) < commands[0][0]
