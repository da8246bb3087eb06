"""Environments for tests: coarse, thin, and made by their names."""

import gymnasium as gym
import numpy as np
import pytest

import edmsim  # noqa: F401 - registers the environments
from edmsim.envs import Task
from edmsim.envs.registry import env_id_of

NAMES = ("GapFeed", "HeightStep", "Corner", "Contour", "ThinWire", "Trim")
STANDARD = {"resolution": "fast", "randomise": None, "height_mm": None, "tension": None}
"""Arguments with which nothing of the standard machine is drawn."""


def played(env, actions, seed=1):
    """Return the steps of an episode, as `env.step` returns them, until it ends or there is no other action."""
    env.reset(seed=seed)
    steps = []
    for action in actions:
        steps.append(env.step(np.array(action, np.float32)))
        if steps[-1][2] or steps[-1][3]:
            break
    return steps


def infos_of(env, actions):
    """Return the infos of the steps of an episode."""
    return [step[4] for step in played(env, actions)]


@pytest.fixture(params=NAMES)
def env_name(request):
    return request.param


@pytest.fixture(scope="session")
def make_env():
    """Make a single environment of the standard machine."""

    def make(name, **options):
        return gym.make(env_id_of(name), **{**STANDARD, **options})

    return make


@pytest.fixture(scope="session")
def make_envs():
    """Make a native vector environment of the standard machine."""

    def make(name, num_envs, **options):
        return gym.make_vec(
            env_id_of(name), num_envs=num_envs, vectorization_mode="vector_entry_point",
            **{**STANDARD, **options},
        )

    return make


@pytest.fixture(scope="session")
def make_task():
    """Make a task of the standard machine."""

    def make(name, **options):
        return Task(name, **{**STANDARD, **options})

    return make


@pytest.fixture(scope="session")
def actions_of():
    """Actions (steps, num_envs, width) that wander about: what a learner tries first."""

    def draw(space, steps, num_envs, seed=0):
        rng = np.random.default_rng(seed)
        return rng.uniform(-1, 1, (steps, num_envs, space.shape[0])).astype(np.float32)

    return draw
