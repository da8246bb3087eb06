"""Training, in a short form, and what it leaves."""

import errno
import os
import shutil
import signal
import sys
from importlib import resources

import numpy as np
import pytest
import torch
from stable_baselines3.common.vec_env import VecNormalize

from edmsim.envs.registry import arguments_with, registered_ids
from edmsim.errors import EdmsimError, InputError
from edmsim.files import locked
from edmsim.learning import hyperparameters, policy_file
from edmsim.learning import train as training
from edmsim.learning.score import RIVALS, measure
from edmsim.learning.train import train

pytestmark = [
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::UserWarning"),
]


@pytest.mark.parametrize("algo", hyperparameters.ALGORITHMS)
@pytest.mark.parametrize("env_id", registered_ids())
def test_every_environment_has_hyperparameters(env_id, algo):
    parameters = hyperparameters.load(env_id, algo)
    family = arguments_with(env_id, **parameters.environment)
    assert family.resolution == "fast"
    first = parameters.network.first_action
    assert first is None or (algo not in ("sac", "tqc") and len(first) == len(family.action_names))


def test_there_are_no_others():
    there = {f.name for f in (resources.files("edmsim.models") / "training").iterdir()}
    names = [env_id.removeprefix("edmsim/").rpartition("-v")[0] for env_id in registered_ids()]
    general = {f"{algo}.toml" for algo in hyperparameters.ALGORITHMS}
    assert general <= there
    assert there - general <= {f"{name}-{file}" for name in names for file in (*general, "bandit.toml")}


@pytest.mark.slow
def test_exploring_begins_around_the_first_action(short_training, tmp_path):
    trained = train("edmsim/ThinWire-v1", "ppo", tmp_path, steps=64, seed=3)
    middle = trained.normalise.normalize_obs(np.zeros(trained.model.observation_space.shape, np.float32))
    found = trained.model.predict(middle, deterministic=True)[0]
    assert found == pytest.approx(trained.hyperparameters.network.first_action, abs=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("algo", hyperparameters.ALGORITHMS)
def test_what_is_exported_does_what_was_trained(short_training, tmp_path, algo):
    messages = []
    trained = train("edmsim/Corner-v3", algo, tmp_path, steps=64, seed=3, watch=messages.append)
    file = tmp_path / "policy.json"
    policy_file.write(*trained.export("a test"), file)
    policy = policy_file.load(str(file))
    space = trained.model.observation_space
    observations = np.random.default_rng(0).uniform(space.low, space.high, (200, *space.shape)).astype(np.float32)
    expected = trained.model.predict(trained.normalise.normalize_obs(observations), deterministic=True)[0]
    found = np.array([policy.action(o) for o in observations])
    assert np.abs(found - expected).max() < 1e-5
    assert expected.std() > 1e-3
    assert messages[-1].steps == policy.card.steps >= 64
    assert list((tmp_path / "tensorboard").iterdir())


@pytest.mark.slow
@pytest.mark.usefixtures("signals")
@pytest.mark.parametrize("algo", hyperparameters.ALGORITHMS)
def test_a_training_stopped_goes_on_from_its_checkpoint(short_training, tmp_path, edmsim, monkeypatch, algo):
    settings = tmp_path / "steps.toml"
    settings.write_text("steps = 128\n")
    again = ("train", "edmsim/GapFeed-v2", "--algo", algo, "--score", 0, "--out", tmp_path, "--resume")
    command = (*again[:-1], "--settings", settings)
    step = training._Keeper._on_step

    number = signal.SIGINT if algo == "ppo" else signal.SIGTERM

    def interrupted(self):
        if self.num_timesteps > 64:  # in the second rollout, of which nothing is learned
            signal.raise_signal(number)
        return step(self)

    with monkeypatch.context() as patch:
        patch.setattr(training._Keeper, "_on_step", interrupted)
        status, out, err = edmsim(*command)
    assert (status, out) == (128 + number, "")
    assert f"--algo {algo} --seed 0 --resume --out {tmp_path} --score 0\n" in err
    assert [f.name for f in tmp_path.glob("checkpoint-*")] == ["checkpoint-000000000064"]
    assert not (tmp_path / "policy.json").exists()
    for refused, named in (
        ((*again, "--seed", 1), "was made with seed 0, not 1"),
        (command, "this folder has a training: continue it with --resume"),
        ((*again, "--steps", 63), "has 64 steps"),
    ):
        status, _, err = edmsim(*refused)
        assert (status, err.count("\n")) == (2, 1)
        assert named in err
    status, out, err = edmsim(*again)  # with the settings and the steps that it began with
    assert status == 0
    assert "policy:" in out
    card = policy_file.load(str(tmp_path / "policy.json")).card
    assert (card.steps, card.seed) == (128, 0)
    assert card.command == f"edmsim train edmsim/GapFeed-v2 --algo {algo} --steps 128 --seed 0 --settings {settings}"


@pytest.mark.slow
def test_a_damaged_checkpoint_is_refused_in_one_line(short_training, tmp_path, edmsim):
    words = ("train", "edmsim/GapFeed-v2", "--algo", "sac", "--steps", 64, "--score", 0, "--out", tmp_path)
    assert edmsim(*words).status == 0
    (checkpoint,) = tmp_path.glob("checkpoint-*")
    files = sorted(checkpoint.iterdir())
    assert [file.name for file in files] == ["model.zip", "normalise.pkl", "replay.pkl", "run.json"]
    for file in files:
        whole = file.read_bytes()
        file.write_bytes(whole[: len(whole) // 2])
        status, out, err = edmsim(*words, "--resume")
        assert (status, out, err.count("\n")) == (2, "", 1)
        assert f"{checkpoint}: the checkpoint is damaged" in err
        file.write_bytes(whole)
    assert edmsim(*words, "--resume").status == 0


@pytest.mark.slow
def test_a_kill_while_the_former_checkpoint_is_removed_leaves_the_last_one(short_training, tmp_path, monkeypatch):
    train("edmsim/GapFeed-v2", "ppo", tmp_path, steps=64)
    remove = shutil.rmtree

    def killed(folder, **options):
        if folder.exists():
            (folder / "model.zip").unlink()
            raise KeyboardInterrupt
        remove(folder, **options)

    monkeypatch.setattr("edmsim.learning.train.shutil.rmtree", killed)
    with pytest.raises(KeyboardInterrupt):
        train("edmsim/GapFeed-v2", "ppo", tmp_path, steps=128, resume=True)
    monkeypatch.undo()
    assert train("edmsim/GapFeed-v2", "ppo", tmp_path, resume=True).model.num_timesteps == 128


@pytest.mark.slow
def test_a_training_that_diverges_keeps_its_last_checkpoint(short_training, tmp_path, monkeypatch):
    step = training._Keeper._on_step

    def diverging(self):
        if self.num_timesteps == 96:
            self.model.policy.action_net.weight.data.fill_(np.nan)
        return step(self)

    monkeypatch.setattr(training._Keeper, "_on_step", diverging)
    with pytest.raises(EdmsimError, match="the training has diverged"):
        training.train("edmsim/GapFeed-v2", "ppo", tmp_path, steps=320)
    assert [f.name for f in tmp_path.glob("checkpoint-*")] == ["checkpoint-000000000064"]


@pytest.mark.slow
@pytest.mark.parametrize(("fits", "stays"), [(1, "continue its last checkpoint"), (0, "there is no checkpoint yet")])
def test_a_disk_full_in_a_training_leaves_its_last_checkpoint(
    short_training, tmp_path, edmsim, monkeypatch, fits, stays
):
    words = ("train", "edmsim/GapFeed-v2", "--steps", 128, "--score", 0, "--out", tmp_path)
    save, saved = VecNormalize.save, []

    def until_full(self, path):
        save(self, path)
        saved.append(path)
        if len(saved) > fits:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(VecNormalize, "save", until_full)
        status, _, err = edmsim(*words)
    assert (status, err.splitlines()[-1].count(stays)) == (1, 1)
    assert err.splitlines()[-1].startswith(f"edmsim: {tmp_path}: the training could not be written: No space left")
    assert sorted(each.name for each in tmp_path.iterdir()) == ["checkpoint-000000000064"] * fits + ["tensorboard"]
    assert edmsim(*words, *["--resume"] * fits).status == 0


@pytest.mark.slow
@pytest.mark.usefixtures("signals")
def test_a_training_that_learned_nothing_leaves_none(short_training, tmp_path, edmsim, monkeypatch):
    monkeypatch.setattr(training._Keeper, "_on_step", lambda _: signal.raise_signal(signal.SIGHUP))
    status, _, err = edmsim("train", "edmsim/GapFeed-v2", "--out", tmp_path)
    assert (status, err) == (128 + signal.SIGHUP, "edmsim: interrupted; nothing was trained\n")
    assert not list(tmp_path.glob("checkpoint-*"))


@pytest.mark.slow
def test_same_seed_same_policy(short_training, tmp_path):
    usual = hyperparameters.load("edmsim/GapFeed-v2", "ppo")
    wide = usual.model_copy(update={"network": usual.network.model_copy(update={"widths": [64, 64]})})

    def packed(folder, seed):
        trained = train("edmsim/GapFeed-v2", "ppo", tmp_path / folder, steps=64, seed=seed, parameters=wide)
        return trained.export("a test")[1]

    first = packed("a", 1)
    torch.set_num_threads(2)  # as with more processors, where weights are drawn in other sums
    assert packed("b", 1) == first
    assert packed("c", 2) != first


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("edmsim/Lathe-v1",), "edmsim/GapFeed-v2"),
        (("edmsim/GapFeed-v2", "--algo", "dqn"), "ppo, sac"),
        (("edmsim/GapFeed-v2", "--steps", 0), "1 or more"),
        (("edmsim/GapFeed-v2", "--seed", -1), "-1"),
        (("edmsim/GapFeed-v2", "--seed", 2**32), "from 0 to 4294967295"),
        (("edmsim/GapFeed-v2", "--score", 1), "2 or more"),
        (("edmsim/GapFeed-v2", "--algo", "sac", "--steps", 5000), "sac learns after 5000 steps (learning_starts)"),
        (("edmsim/GapFeed-v2", "--resume"), "no training to resume"),
        (("edmsim/GapFeed-v2", "--start", "policy:MaxRateShift-adapt"), "give one that has, as Corner-lag"),
        (("edmsim/GapFeed-v2", "--algo", "sac", "--start", "policy:GapFeed-ppo"), "choose its algorithm and network"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(tmp_path, edmsim, arguments, named):
    status, out, err = edmsim("train", *arguments, "--out", tmp_path / "out")
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    assert named in err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_the_command_leaves_a_policy_with_its_scores(short_training, short_episodes, tmp_path, edmsim, monkeypatch):
    monkeypatch.setattr("edmsim.learning.score.RESOLUTIONS", ("fast",))
    status, out, err = edmsim("train", "edmsim/GapFeed-v2", "--steps", 64, "--score", 2, "--out", tmp_path)
    assert status == 0, err
    assert "voltage" in out
    assert len(policy_file.load(str(tmp_path / "policy.json")).card.scores) == 3


def test_without_the_extra_it_is_one_line(tmp_path, edmsim, monkeypatch):
    monkeypatch.setitem(sys.modules, "tensorboard", None)  # the first of its modules that is imported
    monkeypatch.delitem(sys.modules, "edmsim.learning.train", raising=False)
    status, out, err = edmsim("train", "edmsim/GapFeed-v2", "--out", tmp_path / "out")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "pip install 'edmsim[rl]'" in err


@pytest.mark.slow
def test_a_policy_is_scored_with_its_rivals_on_the_same_episodes(monkeypatch, short_episodes):
    monkeypatch.setattr("edmsim.learning.score.RESOLUTIONS", ("fast",))
    found = [measure("edmsim/GapFeed-v2", "GapFeed-ppo", 2) for _ in range(2)]
    assert found[0] == found[1]
    assert [row.controller for row in found[0]] == ["policy", *RIVALS]
    for row in found[0]:
        assert 0 < row.rate_mm2_min < 100
        assert row.error_um is None
        assert row.breaks + row.limits == 0


def test_a_second_training_leaves_the_first_one_s_folder_alone(tmp_path):
    with locked(tmp_path, "edmsim train"), pytest.raises(InputError, match="edmsim train"):
        train("edmsim/GapFeed-v2", "ppo", tmp_path, steps=64)
