"""Training of a bandit: it finds what machines have in common, can be resumed, and its policy cuts."""

import json

import gymnasium as gym
import numpy as np
import pytest

from edmsim.controllers import from_text
from edmsim.envs import register
from edmsim.envs.episode import Task
from edmsim.envs.families import MaxRateShift
from edmsim.errors import InputError
from edmsim.evaluation.episode import Episode
from edmsim.learning import bandit
from edmsim.learning.bandit import Belief, History, Segment

ENV_ID = "edmsim/MaxRateShift-v0"
SHIPPED = bandit.settings_of(ENV_ID)
COUNT = 6
SETTINGS = SHIPPED.model_copy(update={"settings": SHIPPED.settings[:COUNT], "passes": 4})
SHORT = """law = "adaptive-hold"
segment_s = 0.4
settle_s = 0.1
first_s = 0.2
start_s = 0.2
passes = 3
machines = 3
settings = [{open_target_share = 0.0}, {open_target_share = 0.2}]
"""


def histories(count=60, noise=0.04):
    """Return histories of machines of two kinds, and their rates: on one a wide gap pays, on the other shorts do."""
    rng, made, rates = np.random.default_rng(2), [], []
    for machine in range(count):
        wide = machine % 2
        rate = np.array([0.0, 0.1, 0.2, 0.3, -0.1, -0.2]) * (1 if wide else -1) + 0.03 * rng.normal(size=COUNT)
        short = np.array([0.2, 0.1, 0.05, 0.0, 0.3, 0.4]) if wide else np.full(COUNT, 0.4)
        offset, rows = rng.normal(5.0, 1.0), []
        for _ in range(SETTINGS.passes):
            offset += 0.05 * rng.normal()
            for setting in rng.permutation(COUNT):
                area = 8.0 * np.exp(offset + rate[setting] + noise * rng.normal())
                rows.append([setting, 0.1, short[setting] + 0.01 * rng.normal(), 8.0, area])
        made.append(History(rows, [0.0] * COUNT, [40.0] * COUNT))
        rates.append(rate - rate.mean())
    return made, np.array(rates)


def test_the_prior_is_what_machines_have_in_common():
    made, rates = histories()
    prior = bandit.prior_of(made, SETTINGS)
    assert prior.noise[0] == pytest.approx(0.05, rel=0.2)  # with the meter's
    assert prior.noise[2] == pytest.approx(0.01, rel=0.2)
    assert prior.mean[:COUNT] == pytest.approx(rates.mean(axis=0), abs=0.02)
    assert np.diag(prior.covariance)[:COUNT] == pytest.approx(rates.var(axis=0), rel=0.3, abs=2e-3)


def test_with_the_prior_one_segment_tells_which_setting_pays():
    card = bandit.card_of(ENV_ID, SETTINGS, bandit.prior_of(histories()[0], SETTINGS), "", 0, 0)
    for short, best in ((0.2, {2, 3}), (0.4, {4, 5})):
        belief = Belief(card)
        belief.learn(0, Segment(6.0, 0.1, short))
        assert int(np.argmax(belief.at_best(0.0, 25.0))) in best


def test_lost_wires_are_counted_by_setting_and_machine():
    rng = np.random.default_rng(3)
    factor = rng.gamma(2.0, 0.5, size=(4000, 1))  # of a machine: a variance of a half
    cut_s = np.full((4000, 3), 100.0)
    lost = rng.poisson(factor * np.array([0.001, 0.004, 0.01]) * cut_s)
    per_s, weight_s = bandit.breaks_of(lost.astype(float), cut_s)
    assert per_s == pytest.approx([0.001, 0.004, 0.01], rel=0.15)
    assert weight_s == pytest.approx(2.0 / 0.005, rel=0.5)  # the shape over the mean rate
    per_s, weight_s = bandit.breaks_of(np.zeros((5, 2)), np.full((5, 2), 100.0))
    assert per_s == pytest.approx([0.001, 0.001], rel=0.05)  # as if one wire had been lost
    assert weight_s == 1000.0


def test_a_setting_is_no_worse_than_others_by_two_lost_wires_alone():
    cut_s = np.full((4, 2), 250.0)
    per_s, _ = bandit.breaks_of(np.array([[0.0, 1.0], [0.0, 0.0], [0.0, 1.0], [0.0, 0.0]]), cut_s)
    mean, shape = 3.0 / 2000.0, 1.0 / bandit.LEAST_SPREAD  # one more than were lost; no spread beyond chance
    assert per_s == pytest.approx([mean * shape / (shape + 1.5), mean * (shape + 2.0) / (shape + 1.5)])
    many, _ = bandit.breaks_of(20.0 * np.array([[0.0, 1.0], [0.0, 1.0], [0.0, 1.0], [0.0, 1.0]]), cut_s)
    assert many[1] > 10.0 * many[0]  # eighty wires are no chance


def test_machines_that_tried_too_little_are_left_out_and_none_is_refused():
    made, _ = histories(count=6)
    short = made[0]._replace(rows=made[0].rows[:COUNT])
    assert bandit.prior_of([short, *made[1:]], SETTINGS) != bandit.prior_of(made, SETTINGS)
    with pytest.raises(InputError, match="only 0 of 2 training machines"):
        bandit.prior_of([short, short], SETTINGS)


@pytest.fixture
def short_file(tmp_path):
    """A settings file for three machines and short segments."""
    (tmp_path / "short.toml").write_text(SHORT, encoding="utf-8")
    return tmp_path / "short.toml"


@pytest.mark.slow
def test_the_command_trains_a_policy_that_cuts_and_resumes(edmsim, tmp_path, short_file):
    out = tmp_path / "out"
    words = ["train", ENV_ID, "--algo", "bandit", "--score", "0", "--out", out]
    first = edmsim(*words, "--settings", short_file)
    assert first.status == 0
    assert "per hour" in first.out
    assert f"Compare it: edmsim evaluate {ENV_ID} --controllers policy:{out / 'policy.json'}" in first.out
    card = bandit.load(out / "policy.json")
    assert card.steps == 18  # two settings in three passes on three machines
    assert [setting["open_target_share"] for setting in card.settings] == [0.0, 0.2]
    rows = [json.loads(line) for line in (out / "histories.jsonl").read_text().splitlines()[1:]]
    assert {row["id"] for row in rows} == {"21000", "21001", "21002"}
    segments = np.array(rows[0]["rows"])
    assert segments[:, 3] == pytest.approx(0.3, abs=0.05)  # what is left of a segment
    assert set(segments[:, 0].tolist()) == {0.0, 1.0}
    controller = from_text(f"policy:{out / 'policy.json'}")
    assert Episode(Task(ENV_ID, episode_s=1.0), controller, 3, "bandit").run().outcome == "time"
    before = (out / "histories.jsonl").read_bytes()
    assert edmsim(*words, "--resume", "--steps", 19).status == 0  # a fourth machine
    assert (out / "histories.jsonl").read_bytes().startswith(before)
    assert edmsim(*words, "--settings", short_file).status == 2  # the folder has a training
    assert edmsim(*words, "--resume").status == 0  # with all machines that are recorded
    card = bandit.load(out / "policy.json")
    assert card.steps == 24
    assert card.command == f"edmsim train {ENV_ID} --algo bandit --steps 24 --seed 0 --settings {short_file}"
    fewer = edmsim(*words, "--resume", "--steps", 18)
    assert (fewer.status, bandit.load(out / "policy.json").steps) == (2, 24)
    assert "the training there has 24 steps: give as many or more, not 18" in fewer.err
    other = edmsim(*words, "--resume", "--seed", 5)
    assert other.status == 2
    assert "it has the runs of seed 0, not 5" in other.err
    begin = b'"rows": [['
    for old, new in ((b'"lost"', b'"last"'), (begin, begin + b'"a", '), (begin, begin + b"7, 0, 0, 1, 1], [")):
        (out / "histories.jsonl").write_bytes(before.replace(old, new, 1))
        damaged = edmsim(*words, "--resume")
        assert (damaged.status, damaged.err.count("\n")) == (2, 1)
        assert f"{out / 'histories.jsonl'}: the histories are damaged (" in damaged.err


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["edmsim/Corner-v3"], "edmsim/Corner-v3 is no shift"),
        ([ENV_ID, "--teacher", "counts"], "leave out --teacher counts"),
        ([ENV_ID, "--record-every", "2"], "--record-every"),
        ([ENV_ID, "--steps", "0"], "steps is 0"),
        ([ENV_ID, "--resume"], "no training to resume"),
        ([ENV_ID, "--algo", "bandits"], "unknown algorithm 'bandits'"),
    ],
)
def test_what_cannot_be_trained_is_refused_in_one_line(edmsim, tmp_path, words, named):
    refused = edmsim("train", "--algo", "bandit", "--out", tmp_path / "out", *words)
    assert refused.status == 2
    assert named in refused.err
    assert len(refused.err.splitlines()) == 1


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("passes = 2", "passes: must be greater than or equal to 3"),
        ("segment_s = 2.0\nsettle_s = 2.0", "settle_s (2) must be below segment_s"),
        ('law = "oracle"', "a machine could have"),
        ("settings = [{size = 1.0}, {size = 2.0}]", "no parameter 'size'"),
        ("speed = 1", "speed"),
        ("passes = 40", "a shift has 1200 s"),
        ("passes =", "not valid TOML"),
    ],
)
def test_settings_that_cannot_be_used_are_refused_in_one_line(tmp_path, text, named):
    (tmp_path / "own.toml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as refused:
        bandit.train(ENV_ID, tmp_path / "out", settings=bandit.settings_of(ENV_ID, tmp_path / "own.toml"))
    assert named in str(refused.value)


def test_a_shift_that_no_policy_file_describes_is_refused_before_its_machines_are_cut(tmp_path, monkeypatch):
    class Cornered(MaxRateShift):
        knows_corners = True

    register("lab/Cornered-v0", Cornered)
    monkeypatch.setattr(bandit, "record", lambda *_: pytest.fail("a machine was cut"))
    with pytest.raises(InputError, match="Cornered has other observations or actions"):
        bandit.train("lab/Cornered-v0", tmp_path, settings=SETTINGS)
    del gym.registry["lab/Cornered-v0"]


def test_every_shift_has_settings_of_its_own():
    for env_id in (ENV_ID, "edmsim/ThinWireShift-v0"):
        law = bandit.law_of(bandit.settings_of(env_id))
        first = bandit.settings_of(env_id).settings[0]
        for name, value in first.items():  # a new wire begins as the law itself does
            assert [getattr(one, name) for one in law.components if hasattr(one, name)] == [value]
