"""Population-based training: what it refuses, and what a training takes over from another one.

`test_sweep_cluster.py` trains a population.
"""

import math

import pytest

from edmsim import files
from edmsim.errors import InputError
from edmsim.learning import hyperparameters
from edmsim.learning.train import train
from edmsim.sweep import population
from edmsim.sweep.population import train_population

ENV = "edmsim/GapFeed-v2"


@pytest.mark.parametrize(("options", "named"), [
    ({"population": 3}, "population is 3: give a whole number, 4 or more"), ({"generations": 0}, "1 or more"),
    ({"steps": 9}, "fewer than 10 generations"), ({"algo": "dqn"}, "ppo, sac"),
    ({"seed": 1_000_000}, "training seeds"), ({"algo": "imitation"}, "algorithm 'imitation'"),
    ({"algo": "tqc", "steps": 5000}, "tqc learns after 5000 steps"), ({"seeds": 0}, "1 or more"),
    ({"population": math.nan}, "population is nan"),
])  # fmt: skip
def test_what_cannot_be_bred_is_refused(options, named, tmp_path):
    with pytest.raises(InputError, match=named):
        train_population(ENV, tmp_path / "new", **options)
    assert not (tmp_path / "new").exists()


def test_a_second_population_in_the_folder_is_refused(monkeypatch, tmp_path):
    monkeypatch.setattr(population.runs, "Cluster", lambda address: None)
    monkeypatch.setattr(population, "_run", lambda *_: pytest.fail("it began"))
    other = files.locked(tmp_path, "edmsim tune population")
    with other, pytest.raises(InputError, match="another edmsim tune population is at work in this folder"):
        train_population(ENV, tmp_path)


def test_the_command_refuses_in_one_line(edmsim, tmp_path):
    refused = edmsim("tune", "population", ENV, "--out", tmp_path / "new", "--learners", "2")
    assert (refused.status, len(refused.err.splitlines())) == (2, 1)
    assert "population is 2: give a whole number, 4 or more" in refused.err


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_training_begins_from_another_ones_checkpoint(short_training, tmp_path):
    """Weights, statistics and count are the other's; seed and settings are its own."""
    first = train(ENV, "ppo", tmp_path / "first", steps=64, seed=1)
    (checkpoint,) = (tmp_path / "first").glob("checkpoint-*")
    usual = hyperparameters.load(ENV, "ppo")
    changed = {**usual.algorithm, "learning_rate": 7e-5, "gamma": 0.96, "clip_range": 0.3, "gae_lambda": 0.9}
    options = usual.model_copy(update={"algorithm": changed})
    stays = train(ENV, "ppo", tmp_path / "same", steps=64, seed=2, parameters=options, begin_from=checkpoint)
    assert stays.model.num_timesteps == 64
    assert stays.normalise.obs_rms.count == first.normalise.obs_rms.count
    for name, value in first.model.policy.state_dict().items():
        assert (stays.model.policy.state_dict()[name] == value).all()
    second = train(ENV, "ppo", tmp_path / "second", steps=128, seed=2, parameters=options, begin_from=checkpoint)
    model = second.model
    assert (model.num_timesteps, model.seed, model.gamma, model.gae_lambda) == (128, 2, 0.96, 0.9)
    assert (model.learning_rate, model.clip_range(1.0), second.normalise.gamma) == (7e-5, 0.3, 0.96)
    assert model.rollout_buffer.gamma == 0.96
    assert model.policy.optimizer.param_groups[0]["lr"] == 7e-5
    assert checkpoint.is_dir()
