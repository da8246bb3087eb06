"""The adapter for stable-baselines3."""

import re
from functools import partial

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from stable_baselines3.common.vec_env import DummyVecEnv

import edmsim
from edmsim.controllers import from_text
from edmsim.envs import make_sb3_vec_env
from edmsim.errors import InputError


def test_end_of_an_episode_is_reported_as_learners_want_it():
    env = make_sb3_vec_env("edmsim/GapFeed-v2", 2, seed=3, max_episode_steps=4, planner="exact")
    first = env.reset()
    assert not first[:, :40].any()
    actions = np.full((2, 1), 0.5, np.float32)
    for _ in range(3):
        observations, rewards, done, infos = env.step(actions)
        assert not done.any()
        assert [info["dt_s"] for info in infos] == pytest.approx([0.0255] * 2)
        assert set(infos[0]["reward_terms"]) > {"progress", "wire_break"}
    last, rewards, done, infos = env.step(actions)
    assert done.all()
    assert rewards.dtype == np.float32
    assert not last[:, :40].any()  # already the next episode
    for index, info in enumerate(infos):
        assert info["TimeLimit.truncated"]
        assert (info["terminal_observation"][10:20] == observations[index, :10]).all()
        assert info["feed_um_s"] == pytest.approx(13.0)
    assert env.env_method("change", height_mm=[5.0, 5.0]) == [None, None]
    assert [info["drawn"]["height_mm"] for info in (env.reset(), env.reset_infos)[1]] == [5.0, 5.0]
    with pytest.raises(InputError, match="history cannot change"):
        env.env_method("change", history=2)
    with pytest.raises(InputError, match="all sub-environments or none"):
        env.env_method("change", indices=0)
    env.close()


def test_an_info_is_a_mapping_of_what_the_single_environment_tells():
    vec_env = make_sb3_vec_env("edmsim/GapFeed-v2", 2, seed=3, planner="exact", max_episode_steps=2)
    single = gym.make("edmsim/GapFeed-v2", planner="exact")
    action = np.full(1, 0.5, np.float32)
    vec_env.reset(), single.reset(seed=4)
    first = vec_env.step(np.stack([action, action]))[3][1]
    expected = single.step(action)[4]
    for name in ("drawn", "plant_seed", "total_um"):
        del expected[name]  # in vector environments only at resets
    assert first == expected == dict(first) == first.copy()
    assert (first.get("episode"), first.get("cost"), "_cost" in first) == (None, 0.0, False)
    with pytest.raises(KeyError, match="episode"):
        _ = first["episode"]
    _, _, done, infos = vec_env.step(np.stack([action, action]))
    assert done.all()
    assert infos[1]["dt_s"] == single.step(action)[4]["dt_s"]
    assert set(vec_env.reset_infos[1]) == {"drawn", "plant_seed", "total_um"}
    assert first == expected  # it is of its step
    first["note"] = 1
    del first["cost"]
    assert (first["note"], first.get("cost"), len(first)) == (1, None, len(expected))


def of_single_environments(num_envs, **options):
    """What stable-baselines3 itself makes of as many single environments."""
    return DummyVecEnv([lambda: gym.make("edmsim/GapFeed-v2", **options) for _ in range(num_envs)])


ATTRIBUTES = "action_space", "observation_space", "reward_space", "render_mode", "metadata", "family"


@pytest.mark.slow
@pytest.mark.parametrize("indices", [None, 1, np.int64(2), [0, 2], (2, 0), range(2), np.array([1, 2]), -1, []])
def test_attributes_are_each_sub_environments_own_as_of_single_environments(indices):
    options = {"height_mm": 5.0, "history": 3, "action": "servo", "knobs": ["on_time"]}
    vec_env, others = make_sb3_vec_env("edmsim/GapFeed-v2", 3, **options), of_single_environments(3, **options)
    theirs = np.atleast_1d(indices).tolist() if indices is not None else None
    for name in ATTRIBUTES:
        assert vec_env.get_attr(name, indices) == others.get_attr(name, theirs), name
    ours = vec_env.get_attr("spec", indices)
    assert [spec.kwargs for spec in ours] == [spec.kwargs for spec in others.get_attr("spec", theirs)]
    assert all(gym.make(spec).unwrapped.family == vec_env.env.family for spec in ours)
    assert vec_env.env_is_wrapped(gym.Wrapper, indices) == [False] * len(ours)


def test_a_sub_environments_draws_and_spaces_are_its_own():
    vec_env, others = (make(3) for make in (partial(make_sb3_vec_env, "edmsim/GapFeed-v2"), of_single_environments))
    for env in (vec_env, others):
        env.seed(7)
        env.reset()
    assert vec_env.get_attr("np_random_seed") == others.get_attr("np_random_seed") == [7, 8, 9]
    draws = [[rng.random() for rng in env.get_attr("np_random")] for env in (vec_env, others)]
    assert draws[0] == draws[1]
    first, second, _ = vec_env.get_attr("action_space")
    first.seed(1), second.seed(2)
    assert first is vec_env.get_attr("action_space", 0)[0]
    assert first.sample() != second.sample()


def test_what_an_attribute_is_set_to_is_the_sub_environments_and_what_they_share_is_refused():
    vec_env = make_sb3_vec_env("edmsim/GapFeed-v2", 3)
    vec_env.set_attr("note", "thin", indices=1)
    assert vec_env.get_attr("note", 1) == ["thin"]
    assert vec_env.has_attr("family")
    assert not vec_env.has_attr("note")  # the others have none
    assert not vec_env.has_attr("num_envs")  # a single environment has no such number
    with pytest.raises(InputError, match=r"height_mm cannot be set: .*env_method\('change'"):
        vec_env.set_attr("height_mm", 5.0)
    for name in ("action_space", "render_mode", "attach_controller"):
        with pytest.raises(InputError, match=f"{name} cannot be set"):
            vec_env.set_attr(name, None, indices=[0])
    rng = np.random.default_rng(5)
    vec_env.set_attr("np_random", rng, indices=2)
    vec_env.reset()
    again = make_sb3_vec_env("edmsim/GapFeed-v2", 1)
    again.set_attr("np_random", np.random.default_rng(5))
    again.reset()
    assert vec_env.reset_infos[2]["drawn"] == again.reset_infos[0]["drawn"]
    with pytest.raises(IndexError, match="there are 3 sub-environments"):
        vec_env.get_attr("family", 3)


@pytest.mark.slow
def test_methods_are_called_of_the_sub_environments_named(monkeypatch):
    monkeypatch.setattr("edmsim.envs.render.has_gl", lambda: False)
    vec_env = make_sb3_vec_env("edmsim/GapFeed-v2", 3, render_mode="rgb_array", planner="exact")
    vec_env.seed(1)
    vec_env.reset()
    assert [picture.shape for picture in vec_env.env_method("render", indices=[0, 2])] == [(480, 640, 3)] * 2
    law, = vec_env.env_method("attach_controller", from_text("fixed:feed_um_s=12.5"), indices=1)
    assert law.begin().feed_um_s == 12.5
    assert vec_env.metadata["render_fps"] == 39
    assert [picture.shape for picture in vec_env.get_images()] == [(480, 640, 3)] * 3
    with pytest.raises(AttributeError):
        vec_env.env_method("unheard_of")


def test_options_of_a_reset_reach_all_sub_environments_or_each_its_own():
    machines = [edmsim.Machine.load(height_mm=height) for height in (5.0, 7.0)]
    vec_env = make_sb3_vec_env("edmsim/GapFeed-v2", 2, seed=4)
    vec_env.set_options({"machine": machines[1]})
    vec_env.reset()
    assert [info["drawn"]["height_mm"] for info in vec_env.reset_infos] == [7.0, 7.0]
    vec_env.set_options([{"machine": machine} for machine in machines])
    vec_env.reset()
    assert [info["drawn"]["height_mm"] for info in vec_env.reset_infos] == [5.0, 7.0]
    vec_env.reset()  # options count once
    assert {info["drawn"]["height_mm"] for info in vec_env.reset_infos}.isdisjoint({5.0, 7.0})
    for refused, said in (
        ([{}], "1 options were given for 2"), ({"reset_mask": [True, False]}, "no option 'reset_mask'"),
        ([{}, {"machine": "worn-table"}], "give an edmsim.Machine"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=said):
            vec_env.set_options(refused)
    vec_env.reset()  # what was refused is forgotten


def test_gymnasiums_vector_has_the_attributes_of_its_sub_environments_too():
    settings = {"height_mm": 6.0}
    native = gym.make_vec("edmsim/Trim-v1", num_envs=2, vectorization_mode="vector_entry_point", **settings)
    other = gym.make_vec("edmsim/Trim-v1", num_envs=2, vectorization_mode="sync", **settings)
    for name in ATTRIBUTES:
        assert native.get_attr(name) == other.get_attr(name), name
    assert native.call("attach_controller", from_text("fixed"))[1].begin
    for place, law, said in ((2, from_text("fixed"), "index is 2"), (0, "fixed", "'fixed' is not a feed controller")):
        with pytest.raises(InputError, match=said):
            native.unwrapped.attach_controller(place, law)
    native.set_attr("note", ["a", "b"])
    assert native.call("note") == native.get_attr("note") == ("a", "b")
    with pytest.raises(InputError, match="3 values were given for 2"):
        native.set_attr("note", [1, 2, 3])


@pytest.mark.parametrize(("env_id", "said"), [
    ("CartPole-v1", "'CartPole-v1'; choose one of edmsim/GapFeed-v2"),
    ("edmsim/GapFeed-v1", "did you mean 'edmsim/GapFeed-v2'?"),
])
def test_it_takes_edmsims_environments_only(env_id, said):
    with pytest.raises(InputError, match=re.escape(said)):
        make_sb3_vec_env(env_id, 2)
