"""The reward is the sum of its named terms, at every step of every environment."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from edmsim.envs import Weights

NAMES = [f.name for f in fields(Weights)]
ALL = {"progress": 0.7, "short": 0.3, "open": 0.2, "profile": 0.5, "time": 0.1, "done": 5.0, "limit": 1.0}
ROUNDING = 1e-12


@pytest.mark.slow
@pytest.mark.parametrize(("feed", "end"), [(0.05, None), (0.8, "limit"), (1.0, "limit")])
def test_single(make_env, env_name, feed, end):
    # feeds at which wires jam
    env = make_env(env_name, action="speed", planner="exact", decision_s=None, weights=ALL)
    env.reset(seed=4)
    action = np.zeros(env.action_space.shape, np.float32)
    action[0] = feed
    for _ in range(300):
        _, reward, over, _, info = env.step(action)
        terms = info["reward_terms"]
        assert list(terms) == NAMES
        assert all(type(term) is float for term in terms.values())
        assert sum(terms.values()) == pytest.approx(reward, abs=ROUNDING, rel=ROUNDING)
        assert (terms["limit"], terms["wire_break"], terms["done"]) == (-60 / 0.0255 if over else 0.0, 0.0, 0.0)
        if over:
            break
    assert over == (end is not None and env_name != "Trim")  # nothing is in front of a wire that goes along a wall


def test_at_the_path_s_end(make_env):
    env = make_env("GapFeed", action="speed", length_mm=0.005, weights=ALL)
    env.reset(seed=1)
    over = False
    while not over:
        _, reward, over, _, info = env.step(np.array([0.2], np.float32))
        assert sum(info["reward_terms"].values()) == pytest.approx(reward, abs=ROUNDING)
    assert info["cause"] == "done"
    assert info["reward_terms"]["done"] == 5.0


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_vector(make_envs, env_name, mode):
    options = {"action": "speed", "decision_s": None, "weights": ALL, "max_episode_steps": 60}
    envs = make_envs(env_name, 3, autoreset_mode=mode, **options)
    envs.reset(seed=2)
    actions = np.zeros(envs.action_space.shape, np.float32)
    actions[:, 0] = 0.1, 0.3, 1.0
    ended = 0
    for _ in range(140):
        _, rewards, over, cut_off, info = envs.step(actions)
        final = info.get("final_info", info)
        mask = final["_reward_terms"]
        total = sum(final["reward_terms"][name] for name in NAMES)
        assert total.shape == (3,)
        np.testing.assert_allclose(total[mask], rewards[mask], rtol=ROUNDING, atol=ROUNDING)
        assert [name for name in final["reward_terms"] if name[0] != "_"] == NAMES
        ended += int((over | cut_off).sum())
    assert ended >= 3
    envs.close()
