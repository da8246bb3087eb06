"""A controller meets the same plant in a cut, in an evaluation and in an environment: one contract between them."""

from typing import ClassVar

import gymnasium as gym
import numpy as np
import pytest

from edmsim.closed_loop.simulation import Simulation
from edmsim.controllers import FeedCommand
from edmsim.envs.episode import Task
from edmsim.evaluation.episode import Episode
from edmsim.machine.machine import Machine
from edmsim.machine.overrides import with_overrides
from edmsim.program.path import plan_path

MAX_FEED_UM_S = 32.0
"""A power of 2 that every planner runs: actions hold feeds of whole eighths of a um/s without rounding."""
MACHINE = with_overrides(Machine.load(height_mm=0.5), [("table.max_feed_um_s", MAX_FEED_UM_S)])
SHOWN = ("short", "open", "feed_um_s", "path_um")
SEED = 3


class Law:
    """Slows down with the shorts, retracts once a leg and changes the setting twice; keeps all it was shown."""

    name: ClassVar[str] = "law"

    def __init__(self, sets=True):
        self.sets = sets  # whether it also asks for other settings
        self.shown = []
        self.commands = []
        self.legs = []
        self.limits = []

    def set_up(self, machine, points_um, start_um):
        self.legs.append((points_um.tolist(), start_um, (machine.t_on_us, machine.t_period_us), len(self.shown)))

    def reset(self, max_feed_um_s):
        self.limits.append(max_feed_um_s)
        self._window = 0
        return self._ask(FeedCommand(20.0, t_period_us=120.0 if self.sets else None))

    def update(self, window):
        self.shown.append(window)
        self._window += 1
        if self._window == 60 and self.sets:
            return self._ask(FeedCommand(25.0, t_on_us=MACHINE.t_on_us - 3.0, t_period_us=150.0))
        back = 40 <= self._window < 45
        return self._ask(FeedCommand(-12.5 if back else 30.0 - window.short / 8))

    def _ask(self, command):
        self.commands.append(command)
        return command

    def snapshot(self):
        return {}

    def restore(self, state): ...


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    file = tmp_path_factory.mktemp("contract") / "two.ngc"
    file.write_text("G21 G90\nG0 X0 Y0\nG1 X0.2\nY0.05\nG0 X3 Y0.1\nG1 X3.2\nY0.05\nM2\n")
    return file


def options(program, planner):
    return {"program": program, "machine": MACHINE, "planner": planner, "resolution": "fast",
            "max_feed_um_s": MAX_FEED_UM_S, "randomise": None, "height_mm": None, "tension": None}


def cut(program, planner, law):
    """Cut it with the plant's seed that an episode draws."""
    task = Task("Contour", **options(program, planner))
    task.reset(SEED)
    path = plan_path(program, auto_offset_mm=MACHINE.auto_offset_mm)
    seed = task.scenario.plant_seed
    simulation = Simulation(MACHINE, path, law, planner=planner, seed=seed, resolution="fast")
    assert simulation.run() == "finished"
    return law


def evaluated(program, planner, law):
    task = Task("Contour", **options(program, planner))
    assert Episode(task, law, SEED, law.name).run().outcome == "finished"
    return law


def bits(window):
    """Every field, to the bit; NaN equals NaN."""
    return [repr(value) if isinstance(value, tuple) else float(value).hex() for value in window]


@pytest.mark.slow
@pytest.mark.parametrize("planner", ["exact", "poscal"])
def test_a_cut_and_an_evaluation_show_a_controller_the_same(program, planner):
    in_cut, in_evaluation = cut(program, planner, Law()), evaluated(program, planner, Law())
    assert in_cut.limits == in_evaluation.limits == [MAX_FEED_UM_S] * 2
    assert in_cut.legs == in_evaluation.legs
    assert [bits(window) for window in in_cut.shown] == [bits(window) for window in in_evaluation.shown]
    assert in_cut.commands == in_evaluation.commands
    exercised(in_cut)


def exercised(law):
    """The program led through metal, backwards, and through three settings in each leg."""
    (points, start_um, *_), (_, second_um, *_) = law.legs
    assert (start_um, second_um) == (0.0, pytest.approx(np.hypot(*np.diff(points, axis=0).T).sum(), abs=3))
    assert [setting for *_, setting, _ in law.legs] == [(MACHINE.t_on_us, MACHINE.t_period_us)] * 2  # of the set-up
    assert sum(window.short for window in law.shown) > 0
    assert sum(window.open for window in law.shown) > 0
    for *_, first in law.legs:
        leg = law.shown[first:]
        assert leg[44].path_um < leg[39].path_um
        assert [leg[k].duration_s for k in (0, 59, 60)] == pytest.approx([255 * t for t in (120e-6, 120e-6, 150e-6)])


@pytest.mark.slow
@pytest.mark.parametrize("planner", ["exact", "poscal"])
def test_an_environment_driven_by_the_same_feeds_shows_the_same(program, planner):
    law = cut(program, planner, Law(sets=False))
    feeds = [command.feed_um_s for command in law.commands]
    later = law.legs[1][-1]
    del feeds[later]  # wanted after a leg's last window, and replaced by the next leg's first command
    env = gym.make("edmsim/Contour-v2", action="speed", history=1, **options(program, planner))
    env.reset(seed=SEED)
    generator = MACHINE.generator
    scale = np.array([
        255, 255, generator.open_voltage_V.value, generator.mean_current_limit_A.value,
        generator.ignition_wait_us.value if generator.ignition_wait_us else MACHINE.t_on_us,
    ])  # fmt: skip
    threading_s = 0.0
    for number, window in enumerate(law.shown, 1):
        observed, _, terminated, _, info = env.step(np.array([feeds[number - 1] / MAX_FEED_UM_S], np.float32))
        assert terminated == (number == len(law.shown))
        assert [info[name] for name in SHOWN] == [getattr(window, name) for name in SHOWN]
        shares = window.short, window.open, window.mean_voltage_V, window.mean_current_A, window.mean_delay_us
        measured = np.array(shares) / scale
        np.testing.assert_allclose(observed[[0, 1, 3, 4, 5]], np.nan_to_num(measured, nan=1.0), rtol=1e-6, atol=1e-7)
        threading_s = info["time_s"] - window.time_s
        assert (threading_s == 0.0) == (number != later)  # `info` tells the time when the fresh wire is threaded
        if threading_s:
            assert threading_s > MACHINE.base.table.threading_s.value
    assert info["cause"] == "done"
