"""The pages of the environments, their classes' docstrings, say what the code does."""

from __future__ import annotations

import ast
import inspect
import re
from dataclasses import MISSING, fields, replace
from pathlib import Path

import gymnasium as gym
import pytest

from edmsim.cosim.stops import WORDS, StopCause
from edmsim.envs.batch import entries_of
from edmsim.envs.observation import of_a_step
from edmsim.envs.registry import env_id_of

from .conftest import NAMES

DOCS = Path(__file__).parents[2] / "docs"
GUIDE = (DOCS / "environments.md").read_text(encoding="utf-8")
SECTIONS = (
    "Description", "Action space", "Observation space", "Reward", "Starting state", "End of the episode", "Arguments",
    "Versions",
)  # fmt: skip


@pytest.fixture(params=(*NAMES, "MaxRate"))
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


def table(text, columns):
    """Cells of the rows of a table of so many columns."""
    found = []
    for edges, body in re.findall(r"^(=[= ]+)\n.*\n=[= ]+\n((?:[^=\n].*\n)+)=[= ]+$", text, re.M):
        places = [match.span() for match in re.finditer("=+", edges)]
        if len(places) == columns:
            ends = [*(start for start, _ in places[1:]), None]
            found += [
                [line[start:end].strip().strip("`") for (start, _), end in zip(places, ends, strict=True)]
                for line in body.splitlines()
            ]
    assert found
    return found


def test_a_registered_environment_is_its_own_class_and_describes_itself(env, env_name):
    assert type(env).__name__ == f"{env_name}Env"
    headings = re.findall(r"^(\w[\w ]*)\n-+$", inspect.getdoc(type(env)), re.M)
    assert tuple(headings) == SECTIONS
    lanes = gym.make_vec(env_id_of(env_name), num_envs=1, vectorization_mode="vector_entry_point", resolution="fast")
    assert type(lanes.unwrapped).__name__ == f"{env_name}VectorEnv"


def test_actions(env):
    text = section(env, "Action space")
    assert f"``Box(-1, 1, {env.action_space.shape}, float32)``" in text
    rows = table(text, 5)
    assert [(row[0], row[1]) for row in rows] == [(str(k), name) for k, name in enumerate(env.family.action_names)]
    for row, low, high in zip(rows, env.action_space.low, env.action_space.high, strict=True):
        assert row[2] == f"{low:g}..{high:g}"


def test_observations(env):
    text = section(env, "Observation space")
    assert f"``Box({env.observation_space.shape}, float32)``" in text
    listed = entries_of(env.family)
    rows = table(text, 5)
    assert len(rows) == len(entries_of(replace(env.family, history=1)))
    for index, name, bounds, *_ in rows:
        k = int(index)
        assert name == listed[k].name
        assert bounds == f"{env.observation_space.low[k]:g}..{env.observation_space.high[k]:g}"
    per_window = len(of_a_step(env.family.locates_discharges))
    assert f"Entries 0 to {per_window - 1} " in text
    assert f"{per_window} to {per_window * env.family.history - 1} are the same of the three steps before" in text


def test_reward(env):
    rows = table(section(env, "Reward"), 3)
    weights = env.family.reward_weights
    assert [(name, float(weight)) for name, _, weight in rows] == [
        (field.name, getattr(weights, field.name)) for field in fields(weights)
    ]


def test_ends(env):
    text = section(env, "End of the episode")
    # an episode's time is a truncation, and no environment has drives that trip or a button
    none = {StopCause.RUNNING, StopCause.TIME_LIMIT, StopCause.DRIVE_TRIP, StopCause.EMERGENCY_STOP}
    causes = set(StopCause) - none
    for cause in (WORDS[cause].info for cause in causes):
        assert f"``{cause}``" in text
        assert f"`{cause}`" in GUIDE
    assert f"Truncated after {env.family.episode_s:g} s of cutting" in text


def test_arguments(env):
    rows = table(section(env, "Arguments"), 4)
    told = {name: ast.literal_eval(default) for name, default, *_ in rows}
    has = {field.name: field.default for field in fields(env.family)}
    assert MISSING not in has.values()
    assert told == {**has, "render_mode": None}
    assert len(rows) == len(told)


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
