"""The short form of the soak, and of what it measures with."""

import gc
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.soak import endurance, kills, vectors
from tests.soak.memory import growth

REPOSITORY = Path(__file__).parents[2]
pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="it looks into /proc"),
    pytest.mark.filterwarnings("ignore"),  # of Python, that threads and fork do not mix
]


@pytest.fixture
def young():
    """Let the garbage collector skip what other tests hold: every look at the memory took half a second."""
    gc.collect()
    gc.freeze()


def test_growth_is_found_and_none_is_none():
    noise = np.random.default_rng(0).normal(0.0, 1e4, 201)
    at = [float(k) for k in range(201)]
    flat = growth(at, list(1e8 + noise))
    assert flat.low < 0.0 < flat.high
    leak = growth(at, list(1e8 + noise + 5e3 * np.arange(201)))
    assert 0.0 < leak.low < 5e3 < leak.high
    settles = growth(at, [1e8 + min(t, 30.0) * 1e6 for t in at])  # grows while it begins, then no more
    assert (settles.mean, settles.low, settles.high) == (0.0, 0.0, 0.0)


@pytest.mark.slow
def test_memory_that_is_held_is_measured():
    """In a process of its own: here, what other tests left may be given back between the two looks."""
    looks = (
        "import numpy as np\n"
        "from tests.soak.memory import resident_bytes\n"
        "before = resident_bytes()\n"
        "held = np.ones(8_000_000)\n"
        "print(resident_bytes() - before, held.nbytes)\n"
    )
    run = subprocess.run([sys.executable, "-c", looks], capture_output=True, text=True, check=True, cwd=REPOSITORY)
    grown, held = map(int, run.stdout.split())
    assert 0.9 * held < grown < 1.1 * held


@pytest.mark.slow
@pytest.mark.usefixtures("young")
def test_a_plant_goes_on_from_its_snapshots(monkeypatch):
    monkeypatch.setattr(endurance, "SAMPLES", 14)
    monkeypatch.setattr(endurance, "CHECKED", 2)
    found = endurance.simulate(2.0)
    assert (found["restored"], found["equal"]) == (2, 2)
    assert found["windows"] > 70


@pytest.mark.slow
@pytest.mark.usefixtures("young")
def test_environments_step_in_a_memory_of_one_size(monkeypatch):
    monkeypatch.setattr(endurance, "SAMPLES", 14)
    found = endurance.step(448)
    assert found["steps"] == 448


@pytest.mark.slow
@pytest.mark.usefixtures("young")
def test_plants_and_environments_leave_nothing_open():
    assert set(vectors.open_and_close(3)["left"].values()) == {0}


@pytest.mark.slow
def test_a_cut_killed_at_any_moment_is_finished_as_if_it_were_not(tmp_path, monkeypatch):
    monkeypatch.setitem(kills.SETTINGS, "max_time_s", 1.5)
    found = kills.kill(3, tmp_path)
    assert found["killed"] == 3
    assert found["equal"] == found["cuts"] >= 1


@pytest.mark.slow
def test_environments_in_other_processes_are_the_same(monkeypatch):
    monkeypatch.setattr(vectors, "COUNT", 1)  # a spawned process imports everything again
    found = vectors.compare(10, (("AsyncVectorEnv", "spawn"), ("SubprocVecEnv", "fork")))
    assert found["same_rewards"] == {"AsyncVectorEnv, spawn": True, "SubprocVecEnv, fork": True}
    assert set(found["left"].values()) == {0}
