"""The native vector environment: its environment i is the single one with seed s + i, in all autoreset modes."""

import copy
import multiprocessing
import os
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import InvalidAction, ResetNeeded
from gymnasium.vector import AutoresetMode

from edmsim.errors import InputError

from .conftest import NAMES

MODES = (AutoresetMode.SAME_STEP, AutoresetMode.DISABLED)


def sync(make_env, name, num_envs, mode, **options):
    return gym.vector.SyncVectorEnv(
        [lambda: make_env(name, **options) for _ in range(num_envs)], autoreset_mode=mode
    )


def same(ours, theirs):
    """Whether two steps tell the same, bit for bit, where they tell anything."""
    for a, b in zip(ours[:-1], theirs[:-1], strict=True):
        assert a.dtype == b.dtype
        assert (a == b).all()
    same_info(ours[-1], theirs[-1])


def same_info(ours, theirs):
    """The single environment tells at every step what was drawn, the environments only where an episode begins."""
    for name, values in ours.items():
        if name.startswith("_"):
            assert (theirs[name] | ~values).all(), name
        elif name == "final_obs":
            for a, b in zip(values, theirs[name], strict=True):
                assert (a is None and b is None) or (a == b).all()
        elif isinstance(values, dict):
            same_info(values, theirs[name])
        else:
            mask = ours[f"_{name}"]
            assert (values[mask] == theirs[name][mask]).all(), name


@pytest.mark.slow
@pytest.mark.parametrize(("env_name", "mode"), [  # modes are of all environments alike
    *((name, AutoresetMode.NEXT_STEP) for name in NAMES), *(("Corner", mode) for mode in MODES),
], indirect=["env_name"])  # fmt: skip
def test_native_is_gymnasiums_own_vector(make_env, make_envs, env_name, actions_of, mode):
    # episodes so short that every sub-environment ends some, at different times where the cut is done first
    short = {"length_mm": 0.0005, "planner": "exact"} if env_name in ("GapFeed", "HeightStep") else {}
    short |= {"decision_s": 0.05} if env_name == "ThinWire" else {}
    options = {"max_episode_steps": 7} | short
    native = make_envs(env_name, 3, autoreset_mode=mode, **options)
    other = sync(make_env, env_name, 3, mode, **options)
    same(native.reset(seed=11), other.reset(seed=11))
    ended = 0
    for actions in actions_of(native.single_action_space, 25, 3, seed=4):
        ours, theirs = native.step(actions), other.step(actions)
        same(ours, theirs)
        done = ours[2] | ours[3]
        ended += int(done.sum())
        if mode is AutoresetMode.DISABLED and done.any():
            same(native.reset(options={"reset_mask": done}), other.reset(options={"reset_mask": done.copy()}))
    assert ended >= 3


@pytest.mark.slow
@pytest.mark.parametrize(("num_envs", "threads"), [(1, 1), (5, 1), (5, 2)])
def test_sub_environments_do_not_depend_on_company_or_threads(make_envs, actions_of, num_envs, threads):
    envs = make_envs("HeightStep", num_envs, threads=threads)
    reference = make_envs("HeightStep", 6, threads=2)
    envs.reset(seed=20)
    reference.reset(seed=20)
    for actions in actions_of(envs.single_action_space, 40, 6, seed=1):
        ours, theirs = envs.step(actions[:num_envs]), reference.step(actions)
        assert (ours[0] == theirs[0][:num_envs]).all()
        assert (ours[1] == theirs[1][:num_envs]).all()


def test_order_of_resets_does_not_matter(make_envs):
    one, other = (make_envs("Corner", 3, autoreset_mode="Disabled") for _ in range(2))
    one.reset(seed=4)
    other.reset(seed=99)
    for index in (2, 0, 1):
        mask = np.arange(3) == index
        observations, infos = other.reset(seed=4, options={"reset_mask": mask})
        assert infos["_plant_seed"].tolist() == mask.tolist()
    actions = np.full((3, 4), 0.1, np.float32)
    assert (one.step(actions)[0] == other.step(actions)[0]).all()
    assert observations.shape == (3, 51)


def test_randomised_machines_agree_with_the_single_environment(make_env, make_envs):
    options = {"randomise": ("gap", "dielectric"), "height_mm": (10.0, 30.0)}
    envs = make_envs("GapFeed", 2, **options)
    _, infos = envs.reset(seed=5)
    for index in range(2):
        env = make_env("GapFeed", **options)
        _, info = env.reset(seed=5 + index)
        assert {name: infos["drawn"][name][index] for name in info["drawn"]} == info["drawn"]
        ours = envs.step(np.full((2, 1), 0.5, np.float32)) if index == 0 else ours  # noqa: F821
        assert (env.step(np.array([0.5], np.float32))[0] == ours[0][index]).all()


def test_seeds_may_be_a_list(make_envs):
    one, other = make_envs("HeightStep", 2), make_envs("HeightStep", 2)
    _, infos = one.reset(seed=[8, 3])
    assert infos["plant_seed"][0] == other.reset(seed=8)[1]["plant_seed"][0]
    with pytest.raises(InputError, match="3 seeds were given for 2"):
        one.reset(seed=[1, 2, 3])


def test_copies_go_on_bit_for_bit(make_envs, actions_of):
    envs = make_envs("Corner", 2)
    actions = actions_of(envs.single_action_space, 20, 2)
    envs.reset(seed=5)
    for row in actions[:10]:
        envs.step(row)
    twin = pickle.loads(pickle.dumps(envs))  # as copy.deepcopy does it
    for row in actions[10:]:
        same(envs.step(row), twin.step(row))


def test_infos_are_the_callers_own(make_envs, actions_of):
    envs, written = (make_envs("Corner", 3, max_episode_steps=4) for _ in range(2))
    for env in (envs, written):
        env.reset(seed=5)
    steps = []
    for actions in actions_of(envs.single_action_space, 9, 3):
        ours, theirs = envs.step(actions), written.step(actions)
        same(ours, theirs)
        steps.append((ours, copy.deepcopy(ours)))
        for array in (theirs[-1]["feed_um_s"], theirs[-1]["area_mm2"], *theirs[-1]["reward_terms"].values()):
            array[:] = 1
    for now, then in steps:
        same(now, then)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system forks no processes")
def test_a_forked_process_goes_on_with_threads_of_its_own(make_envs):
    envs, actions = make_envs("GapFeed", 8, threads=2), np.full((8, 1), 0.5, np.float32)
    envs.reset(seed=1)
    envs.step(actions)
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe()
    child = context.Process(target=lambda: there.send(envs.step(actions)[0]), daemon=True)
    child.start()
    assert here.poll(30)
    assert (here.recv() == envs.step(actions)[0]).all()
    child.join()
    assert child.exitcode == 0


def test_errors_gymnasium_users_know(make_envs):
    envs = make_envs("GapFeed", 2, autoreset_mode="Disabled", max_episode_steps=1)
    actions = np.zeros((2, 1), np.float32)
    with pytest.raises(ResetNeeded, match="call reset"):
        envs.step(actions)
    envs.reset(seed=1)
    with pytest.raises(InvalidAction, match="shape"):
        envs.step(actions[:1])
    with pytest.raises(InvalidAction, match="finite"):
        envs.step(np.full((2, 1), np.nan, np.float32))
    envs.step(actions)
    with pytest.raises(ResetNeeded, match=r"sub-environments \[0, 1\]"):
        envs.step(actions)
    for mask in (np.array([True]), np.array([1, 0]), np.zeros(2, np.bool_), [[True], [True, False]]):
        with pytest.raises(InputError, match="reset_mask"):
            envs.reset(options={"reset_mask": mask})


def test_partial_first_reset_is_not_enough(make_envs):
    envs = make_envs("GapFeed", 2, autoreset_mode="Disabled")
    envs.reset(seed=1, options={"reset_mask": np.array([True, False])})
    with pytest.raises(ResetNeeded):
        envs.step(np.zeros((2, 1), np.float32))


@pytest.mark.parametrize(
    ("name", "value"), [("num_envs", 0), ("threads", 0), ("max_episode_steps", 1.5), ("autoreset_mode", "bad")]
)
def test_bad_arguments(name, value):
    from edmsim.envs import EdmVectorEnv

    with pytest.raises(InputError, match=name):
        EdmVectorEnv("GapFeed", **{name: value})


def test_a_specification_comes_back_from_json(make_envs):
    envs = make_envs("GapFeed", 2, autoreset_mode=AutoresetMode.SAME_STEP)
    spec = gym.envs.registration.EnvSpec.from_json(envs.spec.to_json())
    again = gym.make_vec(spec, num_envs=3, vectorization_mode="vector_entry_point")
    assert again.autoreset_mode is AutoresetMode.SAME_STEP


@pytest.mark.slow
def test_pictures_of_all_sub_environments(make_envs, monkeypatch):
    monkeypatch.setattr("edmsim.envs.render.has_gl", lambda: False)
    envs = make_envs("Corner", 2, render_mode="rgb_array")
    envs.reset(seed=1)
    assert [picture.shape for picture in envs.render()] == [(480, 640, 3)] * 2
    envs.close()


@pytest.mark.slow
def test_memory_does_not_grow(make_envs):
    from edmsim.bench.figures import _resident_MB

    envs = make_envs("GapFeed", 4, max_episode_steps=50, randomise=("guides",), tension=(8.0, 12.0))
    envs.reset(seed=1)
    actions = np.full((4, 1), 0.02, np.float32)
    for _ in range(1500):  # 30 episodes a sub-environment fill the caches
        envs.step(actions)
    before = _resident_MB()
    for _ in range(1500):
        envs.step(actions)
    assert _resident_MB() - before < 15
