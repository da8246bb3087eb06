"""Cuts begin on the middle of the machine's table, whatever its travel."""

from __future__ import annotations

from importlib import resources

import numpy as np
import pytest

import edmsim
from edmsim.errors import InputError


@pytest.fixture
def small_table(tmp_path):
    """The standard machine with a travel of 30 mm: its file."""
    text = (resources.files("edmsim.models") / "machines" / "agiecut-dem15.toml").read_text(encoding="utf-8")
    assert "travel_mm = { value = 65" in text
    file = tmp_path / "small.toml"
    file.write_text(text.replace("travel_mm = { value = 65", "travel_mm = { value = 30"), encoding="utf-8")
    return str(file)


def test_a_small_table_is_not_left(make_env, env_name, small_table):
    env = make_env(env_name, machine=edmsim.Machine.load(small_table), action="speed")
    env.reset(seed=1)
    for _ in range(5):
        *_, over, _, info = env.step(np.full(env.action_space.shape, 0.1, np.float32))
    assert not over, info["cause"]


def test_where_the_cut_begins(small_table, make_task):
    for machine, centre_um in ((edmsim.Machine.load(small_table), 15_000.0), (edmsim.Machine.load(), 32_500.0)):
        task = make_task("Corner", machine=machine)
        task.reset(1)
        assert task.scenario.legs_um[0][0].tolist() == [centre_um, centre_um]
        assert machine.base.table.centre_um == (centre_um, centre_um)


def test_a_cut_beyond_the_table_is_refused(small_table, make_task):
    with pytest.raises(InputError, match=r"length_mm is 20\.0: give a number above 0 and at most 12\.5"):
        make_task("GapFeed", machine=small_table, length_mm=20.0)
    with pytest.raises(InputError, match="at most 30"):
        make_task("GapFeed", length_mm=31.0)
