"""``edmsim warm-up``: after it a cut and an environment compile nothing."""

import subprocess
import sys

import pytest

from edmsim.cli import commands
from edmsim.envs import gap_servo, path_follower
from edmsim.plant import plant

USE = """
import gymnasium as gym
from numba.core import event

import edmsim, edmsim.envs

with event.install_recorder("numba:compile") as seen:
    env = gym.make("edmsim/HeightStep-v2", resolution="fast")
    env.reset(seed=3)
    env.step(env.action_space.sample())
    edmsim.cut({program!r}, resolution="fast", max_time_s=0.2, height_mm=5.0)
print([happened.data["dispatcher"].py_func.__qualname__ for _, happened in seen.buffer if happened.is_start])
"""


@pytest.mark.slow
def test_nothing_is_compiled_afterwards(monkeypatch, edmsim, small_punch):
    monkeypatch.setattr(plant, "shapes", lambda shapes=plant.shapes: shapes()[:1])
    status, out, _ = edmsim("warm-up")
    assert status == 0
    assert "is compiled, for all resolutions" in out
    code = USE.format(program=str(small_punch))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


@pytest.mark.slow
def test_servo_and_offset_of_environments_are_used(monkeypatch):
    """The other test finds them in the cache if an earlier one compiled them."""
    used = set()
    for module, name in ((gap_servo, "respond"), (path_follower, "lead_sideways")):
        whole = getattr(module, name)

        def call(*arguments, whole=whole, name=name):
            used.add(name)
            return whole(*arguments)

        monkeypatch.setattr(module, name, call)
    commands._use_once()
    assert used == {"respond", "lead_sideways"}
