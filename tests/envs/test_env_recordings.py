"""Episodes as recordings: the same episode, its wire and gap as of a cut, and what steps commanded and earned."""

import copy
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
from rerun.chunk import RrdReader

from edmsim.envs import RecordRerun
from edmsim.errors import InputError
from edmsim.evaluation.episode import cut
from edmsim.recording.rerun.playback import Playback
from edmsim.recording.rerun.viewer import write_comparison

from .conftest import played


def rewarded(env, steps):
    """Rewards and infos of the steps, up to the episode's end."""
    actions = (np.full(env.action_space.shape, 0.2 * (-1) ** k) for k in range(steps))
    return [(reward, info) for _, reward, _, _, info in played(env, actions, seed=5)]


@pytest.fixture(scope="module")
def recorded(make_env, tmp_path_factory):
    """An episode of 1.5 s of decisions of 60 ms, recorded and not."""
    options = {"episode_s": 1.5, "decision_s": 0.06, "knobs": ["period"]}
    env = RecordRerun(make_env("HeightStep", **options), tmp_path_factory.mktemp("recorded"), every=1)
    made = rewarded(env, 100)
    env.close()
    return made, rewarded(make_env("HeightStep", **options), 100), env.recordings


def test_before_an_episode_there_is_nothing_to_record(make_env):
    with pytest.raises(InputError, match=r"no episode has begun: call reset\(\) first"):
        make_env("GapFeed").unwrapped.recorder()


def test_recording_changes_nothing(recorded) -> None:
    made, plain, folders = recorded
    assert made == plain
    assert len(made) > 15
    assert [folder.name for folder in folders] == ["episode-000000"]


def test_a_recording_shows_actions_rewards_and_costs_next_to_the_cut(recorded) -> None:
    made, _, (folder,) = recorded
    play = Playback(folder / "cut.rrd")
    times, total = play.series("/return/total")
    np.testing.assert_allclose(times, [info["time_s"] for _, info in made], atol=1e-9)
    np.testing.assert_allclose(total, np.cumsum([reward for reward, _ in made]))
    np.testing.assert_allclose(play.series("/action/feed")[1], 0.2 * (-1.0) ** np.arange(len(made)), rtol=1e-6)
    np.testing.assert_allclose(play.series("/action/period")[1], play.series("/action/feed")[1])
    shorts = [info["reward_terms"]["short"] for _, info in made]
    np.testing.assert_allclose(play.series("/reward/short")[1], shorts)
    assert len(play.series("/cost/total")[0]) == len(made)
    # every window of a decision is there, and the gap with its pulses
    windows = sum(info[kind] for _, info in made for kind in ("short", "open", "spark", "arc")) / 255
    assert len(play.series("/feed/feed_um_s")[0]) == windows > 2 * len(made)
    discharges, rays = (("/top/discharges", "Points2D:positions"), ("/top/rays", "LineStrips2D:strips"))
    assert all(len(play.points(*discharges, t)) > 0 for t in times[1:])
    assert rays in play
    assert len(play.points("/world/table/workpiece", "Mesh3D:vertex_positions", times[-1])) > 50


@pytest.mark.slow
def test_every_third_episode_is_recorded_also_one_left_before_its_end(make_env, tmp_path) -> None:
    env = RecordRerun(make_env("Corner", episode_s=0.1, decision_s=None), tmp_path / "new", every=3)
    for _ in range(4):
        rewarded(env, 2)
    other = copy.deepcopy(env)
    assert env.recordings == [tmp_path / "new" / "episode-000000"]
    other.step(env.action_space.sample())
    other.close()
    assert len(other.recordings) == 1  # what was under way stays with the original
    env.close()
    assert [folder.name for folder in env.recordings] == ["episode-000000", "episode-000003"]
    events = Playback(env.recordings[1] / "cut.rrd").rows("/events", "TextLog:text").values.to_pylist()
    assert events[-1] == ["running"]


@pytest.mark.slow
def test_a_recording_says_which_environment_and_episode_it_is_of(make_env, tmp_path) -> None:
    env = RecordRerun(make_env("Corner", episode_s=0.1, decision_s=None), tmp_path / "registered", every=1)
    for _ in range(2):
        rewarded(env, 1)
    env.close()
    titles = [Playback(folder / "cut.rrd").title for folder in env.recordings]
    assert titles == ["edmsim/Corner-v3, episode 0", "edmsim/Corner-v3, episode 1"]
    own = RecordRerun(make_env("Corner", episode_s=0.1, decision_s=None).unwrapped, tmp_path / "own", every=1)
    own.unwrapped.spec = None
    rewarded(own, 1)
    own.close()
    assert Playback(own.recordings[0] / "cut.rrd").title == "own, episode 0"


@pytest.mark.parametrize("every", [0, 1.5, True])
def test_other_environments_and_counts_are_refused(make_env, tmp_path, every) -> None:
    with pytest.raises(InputError, match="records environments of edmsim"):
        RecordRerun(gymnasium.make("CartPole-v1"), tmp_path)
    with pytest.raises(InputError, match=r"every is .*: give a whole number, 1 or more"):
        RecordRerun(make_env("GapFeed"), tmp_path, every=every)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_training_is_recorded_and_stays_the_same(tmp_path) -> None:
    ppo = pytest.importorskip("stable_baselines3").PPO
    from edmsim.envs import RecordEpisodes, make_sb3_vec_env

    def trained(callback):
        vec_env = make_sb3_vec_env("edmsim/GapFeed-v2", 2, seed=3, episode_s=0.2)
        return ppo("MlpPolicy", vec_env, n_steps=32, batch_size=32, seed=1, device="cpu").learn(64, callback=callback)

    recorder = RecordEpisodes(tmp_path, every=2)
    models = trained(recorder), trained(None)
    weights = [model.policy.action_net.weight.tolist() for model in models]
    assert weights[0] == weights[1]
    assert [folder.name for folder in recorder.recordings] == [f"episode-{k:06d}" for k in (0, 2)]
    on = RecordEpisodes(tmp_path, every=2)
    models[0].learn(64, callback=on, reset_num_timesteps=False)
    assert [folder.name for folder in on.recordings] == [f"episode-{k:06d}" for k in (4, 6)]
    play = Playback(recorder.recordings[0] / "cut.rrd")
    assert len(play.series("/feed/feed_um_s")[0]) == len(play.series("/action/feed")[0]) == 8
    assert play.title == "edmsim/GapFeed-v2, episode 0"


@pytest.mark.slow
def test_a_recording_is_shown_as_it_ends(make_env, tmp_path, monkeypatch) -> None:
    shown = []
    viewer = SimpleNamespace(show=lambda file: shown.append(file.is_file()), close=lambda: None)
    monkeypatch.setattr("edmsim.recording.rerun.viewer.LiveViewer", lambda *words: viewer)
    env = RecordRerun(make_env("GapFeed", episode_s=0.1), tmp_path, every=1, live=True)
    for _ in range(2):
        rewarded(env, 9)
    assert shown == [True, True]
    env.close()


@pytest.mark.slow
def test_a_policy_is_compared_with_a_law(tmp_path) -> None:
    for name in ("policy:GapFeed-ppo", "voltage"):
        cut("edmsim/GapFeed-v2", 1_000_000, name, record=tmp_path, episode_s=0.4)
    folders = [tmp_path / "GapFeed" / "seed-1000000" / name for name in ("policy-GapFeed-ppo", "voltage")]
    file = tmp_path / "both.rrd"
    write_comparison(file, *(folder / "cut.rrd" for folder in folders))
    found = {}
    for chunk in RrdReader(str(file)).stream().to_chunks():
        found[str(chunk.entity_path)] = max(chunk.num_rows, found.get(str(chunk.entity_path), 0))
    for letter in "ab":
        assert found[f"/{letter}/feed/feed_um_s"] == found[f"/{letter}/return/total"] == 16


@pytest.mark.slow
def test_a_cut_of_an_evaluation_is_recorded_and_stays_the_same(tmp_path) -> None:
    options = {"resolution": "fast", "episode_s": 0.6}
    made = cut("edmsim/Contour-v2", 1_000_000, "voltage:reference_V=9", record=tmp_path, **options)
    again = cut("edmsim/Contour-v2", 1_000_000, "voltage:reference_V=9", **options)
    assert repr(made) == repr(again)  # some are NaN
    (file,) = tmp_path.rglob("cut.rrd")
    assert file.relative_to(tmp_path).parts == ("Contour", "seed-1000000", "voltage-reference_V=9", "cut.rrd")
    play = Playback(file)
    assert play.series("/return/total")[1][-1] == pytest.approx(made.total_return)
    assert play.title == "Contour by voltage:reference_V=9, seed 1000000"
    assert len(play.series("/action/feed_um_s")[1]) > 20
