"""A learner of one's own leaves as a policy file that does what it does, and a learner begins with a policy file."""

import json
import shutil
from functools import partial
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import A2C, DQN, PPO, SAC, TD3
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack, VecMonitor, VecNormalize

from edmsim import models
from edmsim.envs import make_sb3_vec_env
from edmsim.errors import InputError
from edmsim.job.cut import cut
from edmsim.learning import export_sb3, policy_file, start_sb3
from edmsim.learning import train as training
from edmsim.learning.score import TrainOptions
from edmsim.learning.train import train

pytestmark = [
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::UserWarning"),
]
SMALL = {"net_arch": [16, 8]}
KINDS = {
    "ppo": partial(PPO, "MlpPolicy", n_steps=16, batch_size=32),
    "ppo-gsde": partial(PPO, "MlpPolicy", n_steps=16, batch_size=32, use_sde=True),
    "a2c": partial(A2C, "MlpPolicy", n_steps=8),
    "recurrent-ppo": partial(RecurrentPPO, "MlpLstmPolicy", n_steps=16, batch_size=32),
    "sac": partial(SAC, "MlpPolicy", learning_starts=8, train_freq=8),
    "tqc": partial(TQC, "MlpPolicy", learning_starts=8, train_freq=8),
    "td3": partial(TD3, "MlpPolicy", learning_starts=8, train_freq=8),
}
SETTINGS = {"resolution": "fast", "planner": "exact", "height_mm": 5.0}


def learner(kind, vec_env, steps=32, **network):
    torch.set_num_threads(1)
    made = KINDS[kind](vec_env, policy_kwargs={**SMALL, **network}, seed=2, device="cpu")
    return made.learn(steps) if steps else made


def most_apart(model, vec_env, policy, steps=25):
    """Largest difference of actions over some steps, in which both see the same."""
    raw, worst, state, memory = vec_env, 0.0, None, policy.fresh_memory()
    while hasattr(raw, "venv"):
        raw = raw.venv
    raw.seed(13)  # these two wires last that long
    observed = raw.reset()
    for k in range(steps):
        normal = vec_env.normalize_obs(observed) if isinstance(vec_env, VecNormalize) else observed
        expected, state = model.predict(normal, state, np.full(len(observed), k == 0), deterministic=True)
        action, memory = policy.act(observed[0], memory)
        worst = max(worst, float(np.abs(action - expected[0]).max()))
        observed, _, done, _ = raw.step(expected)
        assert not done.any()
    return worst


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_policy_does_what_its_learner_does_through_the_normalisation(kind, tmp_path):
    vec_env = VecNormalize(VecMonitor(make_sb3_vec_env("edmsim/GapFeed-v2", 2, seed=1, **SETTINGS)), clip_obs=5.0)
    model = learner(kind, vec_env)
    policy = export_sb3(model, vec_env, tmp_path / "own" / "policy.json")
    assert most_apart(model, vec_env, policy) < 2e-6
    card = policy_file.load(str(tmp_path / "own" / "policy.json")).card
    assert (card.env_id, card.environment) == ("edmsim/GapFeed-v2", {"height_mm": 5.0})
    assert (card.algorithm, card.clip, card.steps, card.seed) == (kind.removesuffix("-gsde"), 5.0, 32, 2)
    assert card.observation[0].mean == vec_env.obs_rms.mean[0]
    assert repr(policy) == f"<Policy of edmsim/GapFeed-v2: {card.algorithm}, 32 steps>"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wrap", "network"),
    [
        (lambda vec_env: vec_env, {"activation_fn": torch.nn.ReLU}),
        (VecMonitor, {"net_arch": []}),
        (partial(VecNormalize, norm_obs=False), {"net_arch": {"pi": [12], "vf": [7]}}),
    ],
)
def test_without_a_normalisation_it_sees_what_is_shown(wrap, network, tmp_path):
    vec_env = wrap(make_sb3_vec_env("edmsim/ThinWire-v1", 2, seed=1, decision_s=None))
    model = learner("ppo", vec_env, **network)
    assert most_apart(model, vec_env, export_sb3(model, vec_env, tmp_path / "policy.json")) < 2e-6


@pytest.mark.slow
def test_the_sub_environments_may_be_single_environments_of_stable_baselines3(tmp_path):
    arguments = {"decision_s": None, "wave_um": (5.0, 6.0)}
    wrapped = make_vec_env("edmsim/Trim-v1", 2, env_kwargs=arguments, wrapper_class=gym.wrappers.NormalizeReward)
    vec_env = VecNormalize(wrapped)
    model = learner("sac", vec_env, steps=16)
    policy = export_sb3(model, vec_env, tmp_path / "policy.json")
    assert policy.card.env_id == "edmsim/Trim-v1"
    assert policy.card.environment == {"decision_s": None, "wave_um": [5.0, 6.0]}
    assert most_apart(model, vec_env, policy, 10) < 2e-6


@pytest.mark.slow
def test_it_cuts_a_part_and_is_compared(tmp_path, small_punch, short_episodes, edmsim):
    vec_env = VecNormalize(make_sb3_vec_env("edmsim/GapFeed-v2", 2, seed=1))
    export_sb3(learner("recurrent-ppo", vec_env), vec_env, tmp_path / "policy.json")
    named = f"policy:{tmp_path / 'policy.json'}"
    done = cut(small_punch, controller=named, height_mm=5.0, resolution="fast", max_time_s=1.0)
    assert done.windows.num_rows > 30
    status, out, err = edmsim(
        "evaluate", "edmsim/GapFeed-v2", "--controllers", named, "--seeds", 2, "--resolution", "fast", "--json"
    )
    assert status == 0, err
    assert [row["controller"] for row in json.loads(out)[0]["cuts"]].count(named) == 2


def test_what_a_file_cannot_hold_is_refused_in_a_line_and_leaves_none(tmp_path):
    file = tmp_path / "policy.json"

    def refused(model, vec_env, match):
        with pytest.raises(InputError, match=match):
            export_sb3(model, vec_env, file)
        assert not list(tmp_path.iterdir())

    bare = make_sb3_vec_env("edmsim/GapFeed-v2", 2)
    new = partial(learner, steps=0)
    refused(new("ppo", bare, activation_fn=torch.nn.ELU), bare, "ELU: a policy file holds linear layers")
    refused(SAC("MlpPolicy", bare, use_sde=True, device="cpu"), bare, "SAC's network has Hardtanh: a policy file")
    refused(new("recurrent-ppo", bare, n_lstm_layers=2), bare, "LSTM.*more than a policy file holds")
    stacked = VecFrameStack(bare, 2)
    refused(new("ppo", stacked), stacked, "VecFrameStack around the environment may change")
    twice = VecNormalize(VecNormalize(bare))
    refused(new("ppo", twice), twice, "normalised twice")
    refused(new("ppo", bare), make_sb3_vec_env("edmsim/GapFeed-v2", 2, history=2), "other observations or actions")
    refused(new("ppo", VecNormalize(bare)), bare, "learned from normalised observations")
    normalised = VecNormalize(bare)
    model = new("ppo", normalised)
    normalised.obs_rms.update(np.ones((2, *bare.observation_space.shape)))
    refused(model, VecNormalize(bare), "other means and variances than the learner's")

    class Halved(FlattenExtractor):
        def forward(self, observations):
            return super().forward(observations) / 2

    refused(new("ppo", bare, features_extractor_class=Halved), bare, "that Halved returns: use MlpPolicy")
    broken = new("ppo", bare)
    broken.policy.action_net.bias.data[:] = float("nan")
    refused(broken, bare, "not finite")
    levels = DummyVecEnv([lambda: gym.wrappers.DiscretizeAction(gym.make("edmsim/GapFeed-v2"), 7)])
    for model in (new("ppo", levels), DQN("MlpPolicy", levels, buffer_size=10)):
        refused(model, levels, r"chooses among Discrete\(7\)")
    scaled = DummyVecEnv([lambda: gym.wrappers.RescaleAction(gym.make("edmsim/GapFeed-v2"), -1.0, 1.0)])
    refused(new("ppo", scaled), scaled, "RescaleAction around the environment")
    other = DummyVecEnv([lambda: gym.make("Pendulum-v1")])
    refused(new("ppo", other), other, "PendulumEnv is not an environment of edmsim, or in other processes")
    with pytest.raises(InputError, match=r"name the policy's file NAME\.json"):
        export_sb3(new("ppo", bare), bare, tmp_path / "policy.zip")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ppo", "recurrent-ppo", "tqc"])
def test_a_learner_begins_with_the_policy_of_another(kind, tmp_path):
    vec_env = VecNormalize(make_sb3_vec_env("edmsim/GapFeed-v2", 2, seed=1))
    policy = export_sb3(learner(kind, vec_env), vec_env, tmp_path / "policy.json")
    others = VecNormalize(make_sb3_vec_env("edmsim/GapFeed-v2", 2, seed=4))
    second = learner(kind, others, steps=0)
    assert most_apart(second, others, policy) > 1e-3
    start_sb3(second, others, f"policy:{tmp_path / 'policy.json'}")
    others.training = False
    assert most_apart(second, others, policy) < 2e-6
    again = export_sb3(second, others, tmp_path / "again.json")
    for one, other in zip(policy.weights + policy.biases, again.weights + again.biases, strict=True):
        assert np.array_equal(one, other)
    assert again.card.observation == policy.card.observation
    others.training = True
    second.learn(32)
    assert 32 < others.obs_rms.count < 200  # the statistics go on from those of the policy


def without_file(arguments, file):
    """Return a new policy of an environment that needs a file, which is deleted."""
    vec_env = VecNormalize(make_sb3_vec_env(**arguments))
    policy = export_sb3(learner("ppo", vec_env, 0), vec_env, file.with_name("policy.json"))
    file.unlink()
    return policy


def test_a_policy_needs_neither_program_nor_machine_nor_technology_of_its_training(tmp_path, small_punch):
    file = Path(shutil.copy(small_punch, tmp_path / "part.ngc"))
    policy = without_file({"env_id": "Contour", "program": str(file), "episode_s": 5.0}, file)
    assert policy.family().episode_s == 5.0
    table = tmp_path / "large.toml"
    shutil.copy(models.path("machines/production-400.toml"), table)
    policy = without_file({"env_id": "GapFeed", "machine": str(table), "length_mm": 150.0, "history": 2}, table)
    assert (policy.family().history, policy.card.environment["length_mm"]) == (2, 150.0)
    technology = tmp_path / "own.toml"
    shutil.copy(models.path("technologies/tool-steel-brass-254.toml"), technology)
    policy = without_file({"env_id": "Part", "technology": str(technology), "pause_octaves": 1.0}, technology)
    assert policy.arguments().pause_octaves == 1.0


def test_a_learner_begins_with_a_policy_of_passes(tmp_path):
    vec_env = VecNormalize(make_sb3_vec_env("Part", 1))
    policy = export_sb3(learner("ppo", vec_env, 0), vec_env, tmp_path / "policy.json")
    second = PPO("MlpPolicy", vec_env, policy_kwargs=SMALL, seed=3, device="cpu")
    start_sb3(second, vec_env, policy)
    assert np.array_equal(second.policy.action_net.weight.detach().numpy().T, policy.weights[-1].astype(np.float32))
    with pytest.raises(InputError, match=r"learnt with pause_octaves 2\.0, the training has 1\.0"):
        start_sb3(second, VecNormalize(make_sb3_vec_env("Part", 1, pause_octaves=1.0)), policy)


def test_the_critics_targets_come_from_the_policy_that_td3_begins_with(tmp_path):
    vec_env = VecNormalize(make_sb3_vec_env("edmsim/GapFeed-v2", 1, seed=1))
    export_sb3(learner("td3", vec_env, 0), vec_env, tmp_path / "policy.json")
    second = TD3("MlpPolicy", vec_env, policy_kwargs=SMALL, seed=3, device="cpu")
    start_sb3(second, vec_env, str(tmp_path / "policy.json"))
    observed = torch.rand(5, 46)
    assert torch.equal(second.actor_target(observed), second.actor(observed))


@pytest.mark.slow
def test_a_training_begins_with_a_shipped_policy(short_training, tmp_path, edmsim, monkeypatch):
    started = []
    monkeypatch.setattr(training, "_learn", lambda trained, *_, **__: started.append(trained))
    words = "train", "edmsim/GapFeed-v2", "--start", "policy:GapFeed-ppo", "--steps", 64, "--score", 0
    status, _, err = edmsim(*words, "--out", tmp_path)
    assert status == 0, err
    shipped, first = policy_file.load("GapFeed-ppo"), policy_file.load(str(tmp_path / "policy.json"))
    assert first.card.observation == shipped.card.observation
    assert "--start policy:GapFeed-ppo" in first.card.command
    observed = np.random.default_rng(0).uniform(0, 1, (20, len(shipped.card.observation))).astype(np.float32)
    assert all(np.array_equal(first.action(row), shipped.action(row)) for row in observed)
    model, normalise = started[0].model, started[0].normalise
    normal = normalise.normalize_obs(observed)
    expected = [shipped.action(row) for row in observed]
    assert np.abs(model.predict(normal, deterministic=True)[0] - expected).max() < 2e-6


@pytest.mark.parametrize(
    ("env_id", "algo", "policy", "options", "match"),
    [
        ("GapFeed", "sac", "GapFeed-ppo", {}, "output by clip; the learner has .* output by tanh"),
        ("GapFeed", "recurrent-ppo", "GapFeed-ppo", {}, "sees 46 entries and sets feed; .* sees 16 entries"),
        ("Corner", "ppo", "GapFeed-ppo", {}, "of edmsim/GapFeed-v2, sees 46 .* sees 51 entries and sets target"),
        ("GapFeed", "ppo", "Corner-lag", {}, "of edmsim/Corner-v3, sees .* sees 46 entries and sets feed"),
        ("GapFeed", "ppo", "GapFeed-ppo", {"residual": "voltage"}, "adds to no law, the training to voltage by 5"),
        ("GapFeed", "ppo", "GapFeed-ppo", {"privileged_critic": True}, "privileged critic"),
    ],
)
def test_a_policy_that_a_training_cannot_begin_with_is_refused(env_id, algo, policy, options, match, tmp_path):
    parameters = TrainOptions(**options).parameters(env_id, algo).model_copy(update={"num_envs": 1})
    with pytest.raises(InputError, match=match):
        train(env_id, algo, tmp_path, parameters=parameters, steps=64, begin_from=policy_file.load(policy))


def test_a_training_takes_the_policys_layers_unless_its_settings_name_others(tmp_path):
    vec_env = VecNormalize(make_sb3_vec_env("edmsim/Corner-v3", 1, seed=1))
    layers = {"net_arch": [24, 24], "activation_fn": torch.nn.ReLU}
    export_sb3(learner("ppo", vec_env, 0, **layers), vec_env, tmp_path / "policy.json")
    options = TrainOptions(start=f"policy:{tmp_path / 'policy.json'}")
    parameters = options.parameters("Corner", "ppo")
    assert (parameters.network.widths, parameters.network.activation) == ([24, 24], "relu")
    # the noise is that of Corner's hyperparameters; without one it is less than from scratch
    assert parameters.network.log_std_init == TrainOptions().parameters("Corner", "ppo").network.log_std_init
    assert TrainOptions().parameters("GapFeed", "ppo").network.log_std_init is None
    assert TrainOptions(start="policy:GapFeed-ppo").parameters("GapFeed", "ppo").network.log_std_init == -1.0
    assert TrainOptions().parameters("Corner", "ppo").network.widths == [64, 64]
    settings = tmp_path / "settings.toml"
    settings.write_text("[network]\nwidths = [32, 32]\n", encoding="utf-8")
    other = options._replace(settings=settings)
    parameters = other.parameters("Corner", "ppo").model_copy(update={"num_envs": 1})
    with pytest.raises(InputError, match=r"layers \[24, 24\] with relu.*the learner has hidden layers \[32, 32\]"):
        train("Corner", "ppo", tmp_path, parameters=parameters, steps=64, begin_from=options.policy())
    settings.write_text("[network]\nlog_std_init = -3.0\n", encoding="utf-8")  # of the exploration alone
    network = other.parameters("Corner", "ppo").network
    assert (network.widths, network.activation, network.log_std_init) == ([24, 24], "relu", -3.0)


def test_another_scale_of_actions_or_no_normalisation_is_refused():
    vec_env = VecNormalize(make_sb3_vec_env("edmsim/GapFeed-v2", 1, max_change_um_s=8.0))
    wide = {"net_arch": [64, 64]}
    with pytest.raises(InputError, match=r"max_change_um_s 4\.0, the training has 8\.0"):
        start_sb3(learner("ppo", vec_env, 0, **wide), vec_env, "GapFeed-ppo")
    speeds = VecNormalize(make_sb3_vec_env("edmsim/GapFeed-v2", 1, action="speed"))
    with pytest.raises(InputError, match="learnt with action change, the training has speed"):
        start_sb3(learner("ppo", speeds, 0, **wide), speeds, "GapFeed-ppo")
    with pytest.raises(InputError, match="wrap the environment in VecNormalize"):
        start_sb3(learner("ppo", vec_env.venv, 0, **wide), vec_env.venv, "GapFeed-ppo")
    usual = make_sb3_vec_env("edmsim/GapFeed-v2", 1)
    with pytest.raises(InputError, match="the learner acts in another environment"):
        start_sb3(learner("ppo", VecNormalize(usual), 0, **wide), VecNormalize(usual), "GapFeed-ppo")
    with pytest.raises(InputError, match="there is no policy 'GapFeed-dqn'"):
        start_sb3(learner("ppo", vec_env, 0, **wide), vec_env, "policy:GapFeed-dqn")
