"""One episode for a controller: the same bits as the environment's."""

from __future__ import annotations

import numpy as np
import pytest

import edmsim
from edmsim.envs import Task
from edmsim.errors import InputError


def test_a_task_is_its_environment(make_env, env_name, make_task):
    env, task = make_env(env_name, action="speed", decision_s=None, max_feed_um_s=100.0), make_task(env_name)
    _, info = env.reset(seed=3)
    observed = task.reset(seed=3)
    assert (observed.short, observed.open, observed.path_um) == (0, 0, 0.0)
    assert task.scenario.plant_seed == info["plant_seed"]
    assert task.total_um == info["total_um"]
    action = np.zeros(env.action_space.shape, np.float32)
    action[0] = 0.25
    for _ in range(60):
        *_, info = env.step(action)
        result = task.advance(25.0)
    assert (result.observation.short, result.observation.open) == (info["short"], info["open"])
    assert result.observation.path_um == info["path_um"]
    assert result.truth.wire_temperature_K == info["wire_temperature_K"]
    assert result.area_mm2 == info["area_mm2"]
    assert not result.over


@pytest.mark.parametrize("name", ["counts", "fixed"])
def test_controllers_drive_it(name, make_task):
    task, controller = make_task("GapFeed"), edmsim.controllers.make(name)
    task.reset(seed=1)
    command = controller.reset(task.max_feed_um_s)
    for _ in range(400):
        result = task.advance(command.feed_um_s)
        assert not result.over
        command = controller.update(result.observation)
    assert task.path_um > 30


def test_setting_is_rounded_refused_or_done(make_task):
    task = make_task("Corner")
    task.reset(seed=1)
    result = task.advance(10.0, t_on_us=40.0)
    assert "2 A" in result.refused
    result = task.advance(10.0, t_on_us=20.4, t_period_us=148.0)
    assert result.refused is None
    assert (task.machine.t_on_us, task.machine.t_period_us) == (20.0, 150.0)
    assert result.observation.duration_s == pytest.approx(255 * 150e-6)
    task.reset(seed=1)
    assert task.machine.t_on_us == 30.0


@pytest.mark.slow
def test_program_of_two_contours_threads_between(tmp_path, make_task):
    square = "G1 X{0} Y0.05\nY0.1\nX{1}\nY0\nX{0}\nY0.05\nG40\n"
    file = tmp_path / "two.ngc"
    file.write_text(
        "G21 G90\nG0 X-0.5 Y0.05\nG41 D1\n" + square.format(0, 0.1) + "G0 X3 Y0.05\nG41 D1\n"
        + square.format(3.5, 3.6) + "M2\n"
    )
    task = make_task("Contour", program=file, height_mm=0.5)
    task.reset(seed=1)
    assert len(task.scenario.legs_um) == 2
    first, x = np.hypot(*np.diff(task.scenario.legs_um[0], axis=0).T).sum(), []
    while True:
        result = task.advance(60.0)
        x.append(task._sub_envs.fleet.plants[0].commanded_um[0])
        if result.over or task.path_um > first + 20:
            break
    assert task.path_um > first
    assert np.diff(x).max() > 1000  # a jump to the other contour's start


def test_it_refuses_what_it_cannot_do(make_task):
    task = make_task("GapFeed", length_mm=0.001)
    with pytest.raises(InputError, match="call reset"):
        task.advance(10.0)
    task.reset(seed=1)
    with pytest.raises(InputError, match="feed_um_s is nan"):
        task.advance(float("nan"))
    while not (result := task.advance(50.0)).over:
        pass
    assert result.done
    with pytest.raises(InputError, match=r"has ended \(done\)"):
        task.advance(10.0)
    with pytest.raises(InputError, match="no environment 'Lathe'"):
        Task("Lathe")
