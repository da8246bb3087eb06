"""Data sets: what a controller did, as Minari keeps it, whole after an interruption."""

import shlex
import shutil
from pathlib import Path

import minari
import numpy as np
import pytest

from edmsim.envs.families import GapFeed
from edmsim.envs.registry import register
from edmsim.errors import InputError
from edmsim.evaluation.episode import cut
from edmsim.learning import dataset, policy_file

pytestmark = pytest.mark.filterwarnings("ignore")
ENV = "test/Short-v0"


@pytest.fixture(autouse=True)
def short_cuts():
    register(ENV, GapFeed, episode_s=0.4)


def loaded(folder, monkeypatch, name):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(folder))
    return minari.load_dataset(name)


@pytest.mark.slow
def test_a_data_set_has_what_the_controller_did(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    made = dataset.record(ENV, ["fixed", "voltage:reference_V=9"], 30, Path("."))
    assert [row.dataset_id for row in made] == ["test/short/fixed-v0", "test/short/voltage-reference-v-9-v0"]
    stored = loaded(tmp_path, monkeypatch, made[1].dataset_id)
    assert (stored.total_episodes, stored.total_steps) == (made[1].episodes, made[1].steps) == (2, 32)
    assert stored.recover_environment().unwrapped.family.action == "speed"
    for seed, episode in enumerate(stored.iterate_episodes()):
        result = cut(ENV, seed, "voltage:reference_V=9")  # the same without Gymnasium
        assert episode.rewards.sum() == pytest.approx(result.total_return, abs=1e-3)
        assert episode.infos["time_s"][-1] == pytest.approx(result.time_s)
        assert len(episode.observations) == len(episode.rewards) + 1 == len(episode.infos["cost"])
        assert episode.truncations.tolist() == [False] * 15 + [True]
    assert not (tmp_path / dataset.UNFINISHED).exists()


def test_the_printed_command_loads_from_a_folder_whose_name_has_a_space(tmp_path, monkeypatch, edmsim):
    monkeypatch.setattr(dataset, "record", lambda *_, **__: [dataset.Recorded("test/short/fixed-v0", 1, 15, 0, 2.0)])
    shown = edmsim("dataset", "edmsim/GapFeed-v2", "--out", str(tmp_path / "two words"))
    words = shlex.split(shown.out.partition("Load them: ")[2])
    assert words[:2] == [f"MINARI_DATASETS_PATH={tmp_path / 'two words'}", "python"]


@pytest.mark.slow
def test_an_interrupted_recording_goes_on_to_the_same(tmp_path, monkeypatch):
    def stop(name, done, steps):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        dataset.record(ENV, ["counts"], 30, tmp_path / "a", seed=3, watch=stop)
    with pytest.raises(InputError, match="recording of something else"):
        dataset.record(ENV, ["counts"], 30, tmp_path / "a", seed=4)
    dataset.record(ENV, ["fixed"], 1, tmp_path / "a", seed=4)  # leaves the episodes of the other
    seeds = []
    made = dataset._episode
    monkeypatch.setattr(dataset, "_episode", lambda env, name, seed: seeds.append(seed) or made(env, name, seed))
    first = dataset.record(ENV, ["counts"], 30, tmp_path / "a", seed=3)
    assert seeds == [4]  # the other one was there
    with pytest.raises(InputError, match=r"counts-v0: this data set would be replaced"):
        dataset.record(ENV, ["counts"], 30, tmp_path / "a", seed=3)
    assert dataset.record(ENV, ["counts"], 30, tmp_path / "b", seed=3) == first
    a, b = (loaded(tmp_path / name, monkeypatch, first[0].dataset_id) for name in "ab")
    for one, other in zip(a.iterate_episodes(), b.iterate_episodes(), strict=True):
        np.testing.assert_array_equal(one.actions, other.actions)
        np.testing.assert_array_equal(one.observations, other.observations)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"steps": 0}, "1 or more"),
        ({"seed": 1_000_000}, "seed is 1000000: give a whole number from 0 to 499999"),
        ({"controllers": ["genius"]}, "genius"),
        ({"controllers": []}, "no controller is named"),
        ({"controllers": ["fixed", "adaptive-off-time"]}, "turns the generator's knobs"),
        ({"controllers": ["fixed:offset_um=4"]}, "commands an offset"),
    ],
)
def test_bad_input_is_refused(tmp_path, options, named):
    with pytest.raises(InputError, match=named):
        dataset.record(**{"env_id": ENV, "controllers": ["fixed"], "steps": 20, "out": tmp_path, **options})
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_episodes_of_another_policy_of_the_same_name_are_not_taken(tmp_path):
    file = tmp_path / "policy.json"
    for suffix in (".json", ".npz"):
        shutil.copy(policy_file.locate("GapFeed-ppo").with_suffix(suffix), file.with_suffix(suffix))

    def stop(name, done, steps):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        dataset.record(ENV, [f"policy:{file}"], 30, tmp_path / "out", watch=stop)
    file.write_text(file.read_text().replace('"seed": 1,', '"seed": 2,'))
    with pytest.raises(InputError, match="recording of something else"):
        dataset.record(ENV, [f"policy:{file}"], 30, tmp_path / "out")


def test_two_controllers_of_one_data_set_are_refused(tmp_path):
    for suffix in ("json", "npz"):
        shutil.copy(Path(__file__).parents[2] / "models" / "policies" / f"GapFeed-ppo.{suffix}", tmp_path)
    copied = f"policy:{tmp_path / 'GapFeed-ppo.json'}"
    with pytest.raises(InputError, match="would both be the data set gapfeed-ppo"):
        dataset.record("edmsim/GapFeed-v2", ["policy:GapFeed-ppo", copied], 1, tmp_path)
