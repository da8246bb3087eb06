"""The pages of the environments, made of what the code declares, are their classes' docstrings."""

import inspect
import pydoc
import re
from dataclasses import fields
from pathlib import Path

import gymnasium as gym
import pytest

from edmsim.closed_loop.stops import WORDS, StopCause
from edmsim.envs import Family
from edmsim.envs.registry import env_id_of

from .conftest import NAMES

DOCS = Path(__file__).parents[2] / "docs"
GUIDE = (DOCS / "environments.md").read_text(encoding="utf-8")
SECTIONS = (
    "Description", "Action space", "Observation space", "Reward", "Starting state", "End of the episode", "Arguments",
    "Versions",
)  # fmt: skip


@pytest.fixture(params=(*NAMES, "MaxRate", "Part", "MaxRateShift", "ThinWireShift"))
def env_name(request):
    return request.param


@pytest.fixture
def env(env_name):
    return gym.make(env_id_of(env_name)).unwrapped


def section(env, title):
    """Text of one section of an environment's page."""
    found = re.search(rf"^{title}\n-+\n(.*?)(?=^[A-Z][\w ]*\n---|\Z)", inspect.getdoc(type(env)), re.M | re.S)
    assert found is not None, title
    return found[1]


def test_a_registered_environment_is_its_own_class_and_describes_itself(env, env_name):
    assert type(env).__name__ == f"{env_name}Env"
    headings = re.findall(r"^(\w[\w ]*)\n-+$", inspect.getdoc(type(env)), re.M)
    assert tuple(headings) == SECTIONS
    envs = gym.make_vec(env_id_of(env_name), num_envs=1, vectorization_mode="vector_entry_point", resolution="fast")
    assert type(envs.unwrapped.family).__name__ == env_name


def test_help_and_the_instance_show_the_page_too(env):
    page = inspect.getdoc(type(env))
    assert env.__doc__ == type(env).__doc__
    shown = pydoc.plain(pydoc.render_doc(type(env)))
    assert all(line in shown for line in page.splitlines())


def test_the_page_has_every_entry_of_the_spaces(env):
    actions, observations = section(env, "Action space"), section(env, "Observation space")
    assert f"``Box(-1, 1, {env.action_space.shape}, float32)``" in actions
    assert f"``Box({env.observation_space.shape}, float32)``" in observations
    row = re.compile(r"^(\d+) +(\w+) +\S+\.\.\S+ ", re.M)
    assert row.findall(actions) == [(str(k), name) for k, name in enumerate(env.family.action_names)]
    entries = [entry.name for entry in env.family.entries()]
    assert row.findall(observations) == [(str(k), name) for k, name in enumerate(entries) if "[" not in name]


def test_every_argument_says_what_it_means_on_the_page_and_the_family_does_once(env):
    for name in [*(field.name for field in fields(env.family)), "render_mode"]:
        assert re.search(rf"^{name} +``.+``  .*\w", section(env, "Arguments"), re.M), name
    for field in fields(Family):
        assert len(re.findall(rf"^{field.name}\n    \S", inspect.getdoc(Family), re.M)) == 1


def test_ends(env):
    text = section(env, "End of the episode")
    # an episode's time is a truncation, and no environment has drives that trip or a button
    none = {StopCause.RUNNING, StopCause.TIME_LIMIT, StopCause.DRIVE_TRIP, StopCause.EMERGENCY_STOP}
    for cause in set(StopCause) - none:
        assert f"``{WORDS[cause].info}``" in text
        assert f"`{WORDS[cause].info}`" in GUIDE


def test_spaces_and_lengths_of_the_guide(env, env_name):
    (line,) = (line for line in GUIDE.splitlines() if line.startswith(f"| [`{env_id_of(env_name)}`](tasks/"))
    _, _, actions, observations, seconds = (cell.strip() for cell in line.strip("| ").split(" | "))
    assert actions == f"`Box(-1, 1, {env.action_space.shape})`"
    assert observations == f"`Box({env.observation_space.shape})`"
    assert seconds == f"{env.family.episode_s:g} s"


def test_the_site_has_every_page_and_the_guide_every_word_of_info(make_env):
    for page in (DOCS / "tasks").glob("*.md"):
        assert f"tasks/{page.stem}\n" in (DOCS / "index.md").read_text(encoding="utf-8")
    env = make_env("GapFeed", length_mm=0.005)
    _, info = env.reset(seed=1)
    for key in (*info, *env.step(env.action_space.high)[4]):
        assert f"`{key}`" in GUIDE
