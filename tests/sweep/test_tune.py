"""A search of training settings: it goes on, is shared, is never worse, and tells what failed."""

import tomllib
from pathlib import Path

import pytest

from edmsim.controllers import from_text
from edmsim.errors import InputError
from edmsim.learning.hyperparameters import load
from edmsim.runs import LostJob
from edmsim.sweep import tune
from edmsim.sweep.tune import Trial, TrialResult, judge_trial, tune_controller, tune_training

ENV_ID = "edmsim/GapFeed-v2"


class Peak:
    """An engine that takes a clip range of 0.3 for the best, loses the third job, and may do something in between."""

    def __init__(self, then=None, stop_after=10**9):
        self.observed, self.then, self.left = list[Trial](), then, stop_after

    def done(self, function, jobs):
        assert function is judge_trial
        for job in jobs:
            if not self.left:
                raise KeyboardInterrupt
            self.left -= 1
            self.observed.append(job)
            if self.then is not None:
                self.then, then = None, self.then
                then()
            lost = job.number == 2
            result = TrialResult(-((job.values["clip_range"] - 0.3) ** 2))
            yield job, LostJob("the computer was lost") if lost else result


@pytest.mark.slow
def test_a_search_finds_what_is_best_and_goes_on(tmp_path):
    observed = []
    first = Peak(stop_after=10)
    with pytest.raises(KeyboardInterrupt):
        tune_training(ENV_ID, tmp_path, trials=30, engine=first, watch=lambda *a: observed.append(a))
    again = Peak()
    found = tune_training(ENV_ID, tmp_path, trials=30, engine=again, watch=lambda *a: observed.append(a))
    # the eleventh was asked for when the search was interrupted: it is made again, and counts once
    assert (found.trials, found.failed, len(again.observed)) == (30, 1, 20)
    assert found.values["clip_range"] == pytest.approx(0.3, abs=0.03)
    assert found.value >= max(found.first_value, observed[0][1])
    usual = load(ENV_ID, "ppo").algorithm
    assert first.observed[0].values == {name: pytest.approx(usual[name], rel=0.01) for name in found.values}
    assert tomllib.loads((tmp_path / "best.toml").read_text())["algorithm"] == found.values


def test_settings_in_use_are_tried_again_if_their_trial_was_interrupted(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        tune_training(ENV_ID, tmp_path, trials=1, engine=Peak(stop_after=0))
    found = tune_training(ENV_ID, tmp_path, trials=1, engine=(again := Peak()))
    usual = load(ENV_ID, "ppo").algorithm
    assert again.observed[0].values == {name: pytest.approx(usual[name], rel=0.01) for name in found.values}
    assert (found.trials, found.failed, found.first_value) == (1, 0, found.value)


def test_a_trial_of_a_killed_process_is_made_again_behind_a_journal_cut_off(tmp_path, monkeypatch):
    def killed(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as dying:
        dying.setattr(tune, "_tell", killed)
        with pytest.raises(KeyboardInterrupt):
            tune_training(ENV_ID, tmp_path, trials=1, engine=Peak())
    assert (tmp_path / "best.toml").exists()
    monkeypatch.setattr(tune, "_MARK", "another process with the same number")
    with (tmp_path / tune.JOURNAL).open("ab") as journal:
        journal.write(b'{"op_code": 4, "wor')
    found = tune_training(ENV_ID, tmp_path, trials=1, engine=(again := Peak()))
    assert (found.trials, found.failed, found.first_value) == (1, 0, found.value)
    assert [trial.number for trial in again.observed] == [1]


def test_processes_share_a_study(tmp_path):
    other = Peak()
    one = Peak(then=lambda: tune_training(ENV_ID, tmp_path, trials=8, engine=other))
    found = tune_training(ENV_ID, tmp_path, trials=16, engine=one)
    assert found.trials == 16
    assert (len(other.observed), len(one.observed)) == (8, 8)
    numbers = [trial.number for trial in (*one.observed, *other.observed)]
    assert sorted(numbers) == list(range(16))
    assert len({trial.values["clip_range"] for trial in (*one.observed, *other.observed)}) > 12


def test_settings_are_judged_by_training_seeds():
    judged = judge_trial(Trial(0, "controller", "fixed", {"feed_um_s": 400.0}, (3,)))
    assert "feed_um_s" in str(judged.error)
    with pytest.raises(InputError, match="training seeds"):
        tune_controller("fixed", "nowhere", seed=1_000_000)
    assert not Path("nowhere").exists()


@pytest.mark.parametrize(("options", "named"), [
    ({"controller": "genius"}, "counts"), ({"controller": "fixed", "trials": 0}, "1 or more"),
    ({"env_id": "edmsim/GapFeed-v2", "algo": "dqn"}, "ppo, sac"), ({"controller": "fixed", "seeds": 0}, "1 or more"),
    ({"env_id": "edmsim/GapFeed-v2", "algo": "imitation"}, "no settings of the algorithm 'imitation' are searched"),
    ({"env_id": "edmsim/GapFeed-v2", "algo": "sac", "steps": 5000}, "sac learns after 5000 steps"),
    ({"env_id": "edmsim/GapFeed-v2", "steps": 0}, "steps is 0: give a whole number, 1 or more"),
])  # fmt: skip
def test_what_cannot_be_searched_is_refused(options, named, tmp_path):
    with pytest.raises(InputError, match=named):
        (tune_training if "env_id" in options else tune_controller)(**options, out=tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_a_folder_has_one_study(tmp_path):
    tune_training(ENV_ID, tmp_path, trials=1, engine=Peak())
    with pytest.raises(InputError, match="GapFeed-v2 ppo, not of edmsim/GapFeed-v2 sac"):
        tune_training(ENV_ID, tmp_path, algo="sac", trials=1, engine=Peak())


def test_a_study_is_of_the_text_of_an_own_environment_which_trials_name_by_its_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "own.py"
    file.write_text(
        "from edmsim.envs import register\nfrom edmsim.envs.families import GapFeed\n\n\n"
        "class Own(GapFeed):\n    'Own.'\n\n\nregister('lab/Own-v0', Own)\n"
    )
    tune_training("own.py:lab/Own-v0", tmp_path, trials=1, engine=(made := Peak()))
    assert made.observed[0].name == f"{file}:lab/Own-v0"
    file.write_text(file.read_text() + "# another\n")
    with pytest.raises(InputError, match="one of your files has changed"):
        tune_training("own.py:lab/Own-v0", tmp_path, trials=1, engine=Peak())


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_a_training_leaves_its_policy(short_training, tmp_path):
    pytest.importorskip("stable_baselines3")

    class Here:
        def done(self, function, jobs):
            for job in jobs:
                yield job, function(job)

    found = tune_training("edmsim/GapFeed-v2", tmp_path, trials=2, seeds=1, steps=64, engine=Here())
    assert (found.trials, found.failed) == (2, 0)
    assert set(found.values) == {"learning_rate", "gamma", "gae_lambda", "clip_range"}
    assert from_text(f"policy:{tmp_path / 'policy.json'}").name == "policy"
