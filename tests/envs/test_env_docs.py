"""The page on the environments says what the code does."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import gymnasium as gym
import pytest

import edmsim.envs
from edmsim.envs.families import FAMILIES
from edmsim.envs.lanes import CAUSES
from edmsim.envs.observation import CORNERS, MEASURED
from edmsim.envs.registration import EPISODE_STEPS

PAGE = (Path(__file__).parents[2] / "docs" / "environments.md").read_text(encoding="utf-8")


def rows(columns):
    """Cells of the page's tables of so many columns, by the first one."""
    lines = [line.strip("| ").split(" | ") for line in PAGE.splitlines() if line.startswith("|")]
    return {cells[0].strip("`"): [cell.strip() for cell in cells[1:]] for cells in lines if len(cells) == columns}


@pytest.mark.parametrize("entry", [*MEASURED, *CORNERS], ids=lambda entry: entry.name)
def test_entries_of_the_observation(entry):
    bounds, _ = rows(3)[entry.name]
    assert bounds == f"{entry.low:g}..{entry.high:g}"


def test_weights():
    for field in fields(edmsim.envs.Weights):
        _, straight, corner, contour = rows(5)[field.name]
        for name, cell in zip(FAMILIES, (straight, straight, corner, contour), strict=True):
            assert getattr(FAMILIES[name].own_weights, field.name) == float(cell)


@pytest.mark.parametrize("name", FAMILIES)
def test_spaces_and_lengths(name):
    env = gym.make(f"edmsim/{name}-v0", resolution="fast")
    _, actions, observations, steps = rows(5)[f"edmsim/{name}-v0"]
    assert actions == f"`Box(-1, 1, {env.action_space.shape})`"
    assert observations == f"`Box({env.observation_space.shape})`"
    assert int(steps.split()[0].replace(",", "")) == EPISODE_STEPS[name]


def test_causes_and_arguments():
    for cause in CAUSES[1:]:
        assert f"`{cause}`" in PAGE
    for family in FAMILIES.values():
        for field in fields(family):
            assert f"`{field.name}" in PAGE, field.name
