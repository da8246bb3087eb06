"""The figures of ``edmsim bench`` are there, positive and of the same run."""

import signal
from pathlib import Path

import gymnasium
import pytest

from edmsim.bench import figures, workloads
from edmsim.errors import InputError


@pytest.fixture
def short(monkeypatch):
    """A few windows only, and no new process."""
    monkeypatch.setattr(workloads, "SETTLE_WINDOWS", 1)
    for name, value in (
        ("TIMED_WINDOWS", 2), ("REPEATS", 4), ("MUJOCO_WINDOWS", 1), ("THREAD_S", 0.05),
        ("MEMORY_S", 0.1), ("NUM_ENVS", 2), ("SETTLE_STEPS", 8), ("SLICE_S", 0.01), ("SLICES", 1), ("KNOB_STEPS", 5),
        ("RESETS", 2), ("EPISODES", 1), ("CUT_WINDOWS", 2), ("CUT_SETTLE_WINDOWS", 1), ("CALLS", 10),
        ("SPAN_S", 0.05), ("SERVO_REPEATS", 1),
    ):
        monkeypatch.setattr(figures, name, value)
    monkeypatch.setattr(figures, "cold_start_s", lambda: 0.5)


@pytest.mark.slow
@pytest.mark.timeout(400)
@pytest.mark.usefixtures("short")
def test_figures():
    measured = figures.measure()
    assert {"pulses_per_s", "realtime_factor", "cold_start_s"} <= set(measured)
    assert {"vector_env_steps_per_s_fast", "half_cheetah_vector_steps_per_s"} <= set(measured)
    growth = measured.pop("memory_growth_MB")
    assert abs(growth) < 200.0
    assert abs(measured.pop("controller_overhead")) < 10
    assert all(value > 0 for value in measured.values())
    assert measured["pulses_per_s"] < measured["ray_sums_per_s"]
    assert measured["thread_efficiency"] == measured["threads_plants"] / measured["threads_compute"]
    assert measured["realtime_factor"] == pytest.approx(measured["pulses_per_s"] * 100e-6)


@pytest.mark.slow
@pytest.mark.usefixtures("short")
def test_the_table_of_environments_has_a_row_for_every_number_of_them_and_of_threads(load_script):
    script = load_script(Path(__file__).parents[2] / "docs" / "make" / "vector_envs.py")
    rows = script.rates(counts=(1, 3), threads=(1, 2))
    assert [(row.environments, row.threads) for row in rows] == [(1, 1), (1, 2), (3, 1), (3, 2)]
    assert all(row.windows_per_s > 0 and row.processor_us > 0 for row in rows)


def test_a_comparison_without_its_environment_says_what_to_install(monkeypatch):
    def missing(*_, **__):
        raise gymnasium.error.DependencyNotInstalled("imageio")

    monkeypatch.setattr(gymnasium, "make_vec", missing)
    with pytest.raises(InputError, match=r"pip install \"gymnasium\[mujoco\]\""):
        figures._half_cheetahs(2)


@pytest.mark.usefixtures("signals")
def test_ctrl_c_waits_until_the_other_environments_are_made():
    made = []

    def make():
        with figures.half_cheetahs():
            signal.raise_signal(signal.SIGINT)
            made.append(True)

    with pytest.raises(KeyboardInterrupt):
        make()
    assert made


def test_cold_start_includes_a_window_of_pulses():
    scope: dict[str, object] = {}
    exec(figures._COLD, scope)
    assert scope["plant"].pulses == 255


@pytest.mark.slow
def test_round_trips_and_speeds_of_every_board(monkeypatch):
    monkeypatch.setattr(figures, "ROUND_TRIPS", 20)
    monkeypatch.setattr(figures, "MACHINE_S", 0.2)
    found = figures.serial_figures(lambda name: None)
    assert {name for name in found if name.endswith("_realtime_factor")} == {
        f"{name}_realtime_factor" for name in ("powercore", "powercore-v2", "spark")
    }  # fmt: skip
    for board in ("spark", "powercore"):
        median, high, greatest = (found[f"{board}_round_trip_{title}_ms"] for title in ("median", "p99", "greatest"))
        assert 0 < median <= high <= greatest


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_training_is_timed_against_half_cheetah(monkeypatch):
    monkeypatch.setattr(figures, "ROLLOUT", 8)
    monkeypatch.setattr(figures, "SPELLS", 1)
    observed = []
    found = figures.training_figures(observed.append, counts=(2,))
    assert list(found) == [
        f"{learner}{name}_{what}_2" for learner in ("", "default_")
        for name in ("training", "half_cheetah_training") for what in ("steps_per_s", "env_share")
    ]  # fmt: skip
    assert observed == ["first rollouts of 2 environments", "2 environments, 1 of 1"]
    assert all(value > 0.0 for value in found.values())
    assert all(value < 1.0 for name, value in found.items() if "share" in name)
