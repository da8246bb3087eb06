"""The adapter for stable-baselines3."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from edmsim.envs import make_sb3_vec_env
from edmsim.errors import InputError


def test_end_of_an_episode_is_told_as_learners_want_it():
    env = make_sb3_vec_env("edmsim/GapFeed-v1", 2, seed=3, max_episode_steps=4, planner="exact")
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
    for lane, info in enumerate(infos):
        assert info["TimeLimit.truncated"]
        assert (info["terminal_observation"][10:20] == observations[lane, :10]).all()
        assert info["feed_um_s"] == pytest.approx(13.0)
    assert env.env_method("change", height_mm=[5.0, 5.0]) == [None, None]
    assert [info["drawn"]["height_mm"] for info in (env.reset(), env.reset_infos)[1]] == [5.0, 5.0]
    with pytest.raises(InputError, match="history cannot change"):
        env.env_method("change", history=2)
    with pytest.raises(InputError, match="all lanes or none"):
        env.env_method("change", indices=0)
    assert env.get_attr("render_mode") == [None, None]
    assert env.env_is_wrapped(object) == [False, False]
    env.close()


def test_same_seed_same_trajectory():
    def rewards():
        env = make_sb3_vec_env("edmsim/HeightStep-v1", 2, seed=3, resolution="fast")
        env.reset()
        return [env.step(np.full((2, 1), 0.3, np.float32))[1].tolist() for _ in range(10)]

    assert rewards() == rewards()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_ppo_learns_on_it():
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecNormalize

    env = VecNormalize(make_sb3_vec_env("edmsim/GapFeed-v1", 4, resolution="fast", max_episode_steps=100))
    model = PPO("MlpPolicy", env, n_steps=64, batch_size=64, seed=1, device="cpu").learn(512)
    assert model.num_timesteps >= 512


def test_it_takes_edmsims_environments_only():
    with pytest.raises((InputError, TypeError)):
        make_sb3_vec_env("CartPole-v1", 2)
