"""Policies with memory, beside a law, under a bound on costs, and with a critic that knows more."""

import json

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3.common.logger import Logger

from edmsim.envs.episode import Task
from edmsim.envs.families import GapFeed
from edmsim.envs.sb3 import make_sb3_vec_env
from edmsim.errors import InputError
from edmsim.learning import hyperparameters, policy_file
from edmsim.learning.policy_controller import PolicyController
from edmsim.learning.sb3 import CostVecEnv, Multiplier, TaughtVecEnv, vec_env_of
from edmsim.learning.score import TrainOptions
from edmsim.learning.train import train
from tests.learning.test_policy_controller import started

pytestmark = [
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::UserWarning"),
]


def exported(tmp_path, env_id, algo, steps=64, algorithm=(), **options):
    """Train for some windows; return what was trained, and the policy as it is read from its files."""
    usual = TrainOptions(**options).parameters(env_id, algo)
    parameters = usual.model_copy(update={"algorithm": usual.algorithm | dict(algorithm)})
    trained = train(env_id, algo, tmp_path, steps=steps, seed=3, parameters=parameters)
    policy_file.write(*trained.export("a test"), tmp_path / "policy.json")
    return trained, policy_file.load(str(tmp_path / "policy.json"))


RECURRENT = "[network]\nlstm = 64\n[environment]\nhistory = 1\n"


@pytest.mark.slow
@pytest.mark.parametrize("algo", ["recurrent-ppo", "imitation"])
def test_a_recurrent_policy_remembers_as_it_was_trained(short_training, tmp_path, algo):
    (tmp_path / "own.toml").write_text(RECURRENT if algo == "imitation" else "")
    trained, policy = exported(tmp_path, "edmsim/GapFeed-v2", algo, settings=tmp_path / "own.toml")
    space = trained.model.observation_space
    observed = np.random.default_rng(0).uniform(0, 1, (20, *space.shape)).astype(np.float32)
    state, memory, found, expected = None, policy.fresh_memory(), [], []
    for k, observation in enumerate(observed):
        normal = trained.normalise.normalize_obs(observation)
        action, state = trained.model.predict(normal, state, np.array([k == 0]), deterministic=True)
        expected.append(action)
        action, memory = policy.act(observation, memory)
        found.append(action)
    assert np.abs(np.array(found) - expected).max() < 1e-5
    assert np.abs(policy.action(observed[-1]) - found[-1]).max() > 1e-6  # what it saw before counts
    assert policy.card.lstm == 64


@pytest.mark.slow
def test_a_recurrent_policy_forgets_at_a_leg_and_goes_on_from_a_snapshot(short_training, tmp_path):
    _, policy = exported(tmp_path, "edmsim/GapFeed-v2", "recurrent-ppo")
    first, second = PolicyController(policy), PolicyController(policy)
    task = Task("GapFeed")
    started(second, task)
    command = start = started(first, task)
    for _ in range(12):
        observed = task.advance(command.feed_um_s).observation
        command = first.update(observed)
    second.restore(json.loads(json.dumps(first.snapshot())))
    assert second.update(observed) == first.update(observed)
    assert first.reset(task.max_feed_um_s) == start


def test_a_correction_beyond_an_action_of_1_adds_no_more_than_1():
    residual, family = policy_file.Residual(law="counts", range_um_s=5.0), GapFeed()
    assert residual.action(family, 10.0, 3.0) == residual.action(family, 10.0, 1.0) == np.float32(0.15)
    assert residual.action(family, 10.0, -3.0) == residual.action(family, 10.0, -1.0) == np.float32(0.05)


@pytest.mark.slow
def test_a_residual_policy_adds_to_its_law_in_a_cut_what_it_added_in_training(short_training, tmp_path):
    law = "voltage:reference_V=20"  # a gap wide enough that the law asks for less than the planner's greatest feed
    trained, policy = exported(tmp_path, "edmsim/GapFeed-v2", "ppo", residual=law)
    assert policy.card.residual.law == law
    vec_env = vec_env_of("edmsim/GapFeed-v2", trained.hyperparameters, 5).learned_on
    observed = vec_env.reset()
    task, controller = Task("GapFeed"), PolicyController(policy)
    command, feeds = started(controller, task), set()
    for _ in range(60):
        observed, _, done, infos = vec_env.step(np.array([policy.action(row) for row in observed], np.float32))
        result = task.advance(command.feed_um_s)
        assert result.observation.feed_um_s == infos[0]["feed_um_s"]
        feeds.add(infos[0]["feed_um_s"])
        if done[0]:
            break
        command = controller.update(result.observation)
    assert len(feeds) > 5


@pytest.mark.slow
def test_an_imitation_does_what_its_teacher_does(short_training, tmp_path):
    teacher = "set-point:open_target_share=0.05,on_factor=0.5,period_factor=0.8,offset_um=6"
    soon = {"batch_size": 64, "learning_rate": 0.01}
    _, policy = exported(tmp_path, "edmsim/Corner-v3", "imitation", steps=768, algorithm=soon, teacher=teacher)
    task, controller = Task("Corner"), PolicyController(policy)
    command, first = started(controller, task), task.machine
    for _ in range(60):
        command = controller.update(task.advance(command.feed_um_s, command.t_on_us, command.t_period_us).observation)
    assert command.t_on_us == pytest.approx(0.5 * first.t_on_us, abs=1.0)
    assert command.t_period_us == pytest.approx(0.8 * first.t_period_us, abs=5.0)
    assert command.offset_um == pytest.approx(6.0, abs=1.0)


@pytest.mark.slow
def test_a_recurrent_imitation_learns_from_what_it_remembered_when_it_cut(short_training, tmp_path):
    (tmp_path / "own.toml").write_text(f"{RECURRENT}[algorithm]\nlearning_rate = 1e-12\n")
    trained, _ = exported(tmp_path, "edmsim/GapFeed-v2", "imitation", steps=256, settings=tmp_path / "own.toml")
    model, buffer = trained.model, trained.model.rollout_buffer
    decisions = model.n_steps * model.n_envs
    assert len(model.starts) == 256 // decisions > 1
    assert model.memories[1][0].any()
    model.starts, model.memories = model.starts[-1:], model.memories[-1:]  # of the rollout that the buffer has
    rows, mean = model.drawn(torch.as_tensor(buffer.observations.reshape(decisions, -1)))
    gaussian = torch.distributions.Normal(mean, model.policy.log_std.exp())
    actions = torch.as_tensor(buffer.actions.reshape(decisions, -1))[rows]
    found = gaussian.log_prob(actions).sum(dim=1).detach().numpy()
    assert found == pytest.approx(buffer.log_probs.reshape(decisions)[rows.numpy()], abs=1e-3)


@pytest.mark.slow
def test_a_recurrent_imitation_resumes_with_all_rollouts(short_training, tmp_path):
    (tmp_path / "own.toml").write_text(RECURRENT)
    trained, _ = exported(tmp_path, "edmsim/GapFeed-v2", "imitation", settings=tmp_path / "own.toml")
    rollouts = len(trained.model.starts)
    again = train("edmsim/GapFeed-v2", "imitation", tmp_path, steps=128, seed=3, resume=True)
    assert len(again.model.starts) == len(again.model.memories) == len(again.model.states) > rollouts


def test_a_teacher_says_what_it_would_do_where_the_learner_is():
    taught = TaughtVecEnv(make_sb3_vec_env("edmsim/GapFeed-v2", 2, seed=3, action="speed"), "fixed:feed_um_s=9")
    observed = [taught.reset()]
    for feed in (0.01, 0.02, -0.01):
        observed.append(taught.step(np.full((2, 1), feed, np.float32))[0])
    found, targets = taught.taken()
    assert np.array_equal(found, np.concatenate(observed[:-1]))
    assert targets == pytest.approx(np.full((6, 1), 9.0 / 100.0))
    taught.step(np.zeros((2, 1), np.float32))
    assert np.array_equal(taught.taken()[0], observed[-1])  # what was taken is forgotten


@pytest.mark.parametrize(
    ("algo", "options", "named"),
    [
        ("sac", {"privileged_critic": True}, "ppo, ppo-lag"),
        ("ppo", {"residual": "own.py:Law"}, "own.py"),
        ("ppo", {"residual": "oracle"}, "oracle"),
        ("ppo", {"teacher": "voltage"}, "a teacher is for imitation"),
        ("ppo", {"residual": "adaptive-off-time"}, "a law that only feeds"),
        ("ppo", {"residual": "set-point"}, "a law that only feeds"),  # at the operator's setting
        ("imitation", {"teacher": "unknown"}, "there is no feed controller 'unknown'"),
        ("imitation", {"teacher": "adaptive-off-time"}, "turns the generator's knobs"),
        ("imitation", {"env_id": "edmsim/Corner-v3", "teacher": "voltage"},
         r"^teacher: voltage holds no share of open pulses"),
    ],
)
def test_what_cannot_be_learned_is_refused(short_training, tmp_path, algo, options, named):
    with pytest.raises(InputError, match=named):
        exported(tmp_path / "out", **{"env_id": "edmsim/GapFeed-v2", "algo": algo, **options})
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("entry", ['action = "servo"', "decision_s = 0.2"])
def test_a_residual_replaces_no_settings_in_silence(tmp_path, entry):
    (tmp_path / "own.toml").write_text(f"[environment]\n{entry}\n", encoding="utf-8")
    with pytest.raises(InputError, match=f"own.toml: .*leave environment.{entry.split()[0]} out"):
        TrainOptions(tmp_path / "own.toml", residual="counts").parameters("edmsim/GapFeed-v2", "ppo")


@pytest.mark.parametrize(("env_id", "teacher"), [
    ("edmsim/MaxRate-v1", "heat-oracle"), ("edmsim/MaxRateShift-v0", "adaptive-hold"), ("edmsim/Trim-v1", "voltage"),
])  # fmt: skip
def test_the_usual_teacher_is_a_tasks_reference_unless_that_rehearses(env_id, teacher):
    assert hyperparameters.load(env_id, "imitation").teacher == teacher


@pytest.mark.slow
def test_a_policy_does_not_depend_on_what_only_its_critic_sees(short_training, tmp_path):
    trained, policy = exported(tmp_path, "edmsim/GapFeed-v2", "ppo", steps=128, privileged_critic=True)
    shown = trained.vec_env.edm.observation_space.shape[0]
    wide = trained.model.observation_space.shape[0]
    assert wide > shown == len(policy.card.observation)
    rng = np.random.default_rng(0)
    observed = rng.uniform(0, 1, (50, wide)).astype(np.float32)
    other = observed.copy()
    other[:, shown:] += 1.0
    normal, changed = (trained.normalise.normalize_obs(rows) for rows in (observed, other))
    expected = trained.model.predict(normal, deterministic=True)[0]
    np.testing.assert_array_equal(trained.model.predict(changed, deterministic=True)[0], expected)
    values = [trained.model.policy.predict_values(torch.as_tensor(rows)) for rows in (normal, changed)]
    assert (values[0] - values[1]).abs().min() > 1e-6
    assert np.abs(np.array([policy.action(row[:shown]) for row in observed]) - expected).max() < 1e-5


def test_costs_beyond_the_limit_raise_their_price():
    vec_env = CostVecEnv(make_sb3_vec_env("edmsim/GapFeed-v2", 2, seed=1, max_episode_steps=2), 10.0)
    plain = make_sb3_vec_env("edmsim/GapFeed-v2", 2, seed=1, max_episode_steps=2)
    assert (vec_env.reset() == plain.reset()).all()
    for _ in range(2):
        rewards = [env.step(np.zeros((2, 1), np.float32))[1] for env in (vec_env, plain)]
        np.testing.assert_array_equal(*rewards)  # nothing broke
    assert vec_env.ended == [0.0, 0.0]
    multiplier = Multiplier(vec_env, 0.1, 20.0)
    multiplier.model = type("Learner", (), {"logger": Logger(None, [])})()
    for ended, price in (([1.0, 0.2], 20.0), ([0.0], 18.0), ([], 18.0)):
        vec_env.ended = ended
        multiplier._on_rollout_end()
        assert vec_env.multiplier == pytest.approx(price)


@pytest.mark.slow
def test_the_bound_and_the_curve_of_a_checkpoint_are_taken_up(short_training, tmp_path):
    short = tmp_path / "short.toml"
    short.write_text("[environment]\nepisode_s = 0.4\n")
    parameters = hyperparameters.load("edmsim/GapFeed-v2", "ppo-lag", short)
    trained = train("edmsim/GapFeed-v2", "ppo-lag", tmp_path, steps=64, seed=1, parameters=parameters)
    assert trained.vec_env.costs.multiplier != 7.0
    (run,) = tmp_path.glob("checkpoint-*/run.json")
    document = json.loads(run.read_text())
    run.write_text(json.dumps({**document, "multiplier": 7.0}))
    again = train("edmsim/GapFeed-v2", "ppo-lag", tmp_path, steps=64, seed=1, resume=True)
    assert again.vec_env.costs.multiplier == 7.0
    assert again.curve == trained.curve
    assert [steps for steps, _ in again.curve] == [*range(34, 65, 2)]


def test_settings_of_a_search_are_those_of_a_training(tmp_path):
    file = tmp_path / "best.toml"
    file.write_text("[algorithm]\nlearning_rate = 0.002\n[network]\nwidths = [8]\n")
    usual, found = (hyperparameters.load("edmsim/GapFeed-v2", "ppo", parameters) for parameters in (None, file))
    assert found.algorithm == {**usual.algorithm, "learning_rate": 0.002}
    assert found.network.widths == [8]


@pytest.mark.parametrize(
    ("algo", "text", "named"),
    [
        ("ppo", "[gains]\nk = 1", "gains"),
        ("ppo", "steps = 0", "steps"),
        ("ppo", "algorithm = 3", "algorithm"),
        ("ppo", "[algorithm]\nspeed = 1", "algorithm has no entry 'speed'; it has learning_rate"),
        ("ppo", "[algorithm]\ntau = 0.1", "algorithm has no entry 'tau'"),
        ("ppo", "[algorithm]\nlearning_rate = 'a'", "algorithm.learning_rate"),
        ("ppo", "[algorithm]\nlearning_rate = inf", "algorithm.learning_rate"),
        ("ppo", "[algorithm]\nbatch_size = 1", "algorithm.batch_size"),
        ("ppo", "num_envs = 1\n[algorithm]\nn_steps = 1", "a rollout of num_envs * n_steps is 1 step"),
        ("sac", "[algorithm]\nent_coef = 'automatic'", "algorithm.ent_coef"),
        ("sac", "[algorithm]\nent_coef = 'auto_0'", "algorithm.ent_coef"),
        ("ppo", "[algorithm]\nent_coef = 'auto'", "algorithm.ent_coef is a number; sac and tqc find one"),
        ("ppo", "[network]\nwidths = [0]", "network.widths"),
        ("ppo", "[network]\nlog_std_init = 9", "network.log_std_init"),
        ("ppo", "[network]\nfirst_action = [0.1, 0.2]", "network.first_action has 2 entries; an action has feed"),
        ("sac", "[network]\nfirst_action = [0.1]", "network.first_action is for PPO"),
        ("sac", "[network]\nlstm = 8", "network.lstm is for recurrent-ppo and imitation; the algorithm is sac"),
        ("ppo", "[lagrangian]\nrate = 1", "lagrangian is for the algorithm ppo-lag"),
        ("ppo", "[environment]\nhight_mm = 30", "did you mean 'height_mm'?"),
        ("ppo", "[environment]\nheight_mm = 'a'", "environment: height_mm is 'a'"),
    ],
)
def test_settings_that_cannot_be_used_are_refused_with_file_and_entry(tmp_path, algo, text, named):
    file = tmp_path / "own.toml"
    file.write_text(text)
    with pytest.raises(InputError) as refused:
        hyperparameters.load("edmsim/GapFeed-v2", algo, file)
    assert refused.value.file == str(file)
    assert named in refused.value.reason


@pytest.mark.slow
def test_a_policy_file_names_no_code_to_run(short_training, tmp_path):
    exported(tmp_path, "edmsim/GapFeed-v2", "ppo", residual="voltage")
    file = tmp_path / "policy.json"
    document = json.loads(file.read_text())
    document["residual"]["law"] = "evil.py:Law"
    file.write_text(json.dumps(document))
    with pytest.raises(InputError, match="a law of edmsim"):
        policy_file.load(str(file))


def test_infos_of_resets_and_steps_have_the_same_keys():
    env = gym.make("edmsim/Corner-v3")
    _, start = env.reset(seed=1)
    *_, stepped = env.step(env.action_space.sample())
    _, again = env.reset(seed=1)
    assert start == again
    assert list(start) == list(stepped)
    assert start["drawn"] == stepped["drawn"]
    assert start["cost"] == start["area_mm2"] == sum(start["reward_terms"].values()) == 0.0
