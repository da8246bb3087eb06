"""A policy that chooses settings of a law: it finds the best one, uses what it learned before, and goes on."""

import json

import numpy as np
import pytest

from edmsim.controllers import from_text
from edmsim.controllers.protocols import WindowObservation, set_up_controller
from edmsim.controllers.user_controllers import check_controller
from edmsim.envs.episode import Task
from edmsim.errors import InputError
from edmsim.evaluation.episode import Episode
from edmsim.learning import bandit, score
from edmsim.learning.bandit import BanditCard, BanditController, Belief, Segment

ENV_ID = "edmsim/MaxRateShift-v0"
SETTINGS = [{"open_target_share": 0.0, "shortest_us": 18.0}, {"open_target_share": 0.1, "shortest_us": 12.5},
            {"open_target_share": 0.3, "shortest_us": 12.5}]  # fmt: skip

LOST_S = 25.0  # that a lost wire costs


def card(**changes):
    size = 3 * len(SETTINGS)
    usual = {
        "format": bandit.FORMAT, "env_id": ENV_ID, "environment": {}, "law": "adaptive-hold",
        "settings": SETTINGS, "segment_s": 0.5, "settle_s": 0.1, "first_s": 0.5, "start_s": 0.2, "trial_s": 2.0,
        "trial_bonus": 2.0, "bonus": 0.3, "mean": [0.0] * size, "covariance": (0.04 * np.eye(size)).tolist(),
        "noise": [0.05, 0.02, 0.02], "offset_drift": 0.02, "drift": 0.01, "breaks": [0.002] * len(SETTINGS),
        "breaks_s": 100.0, "algorithm": "none", "command": "none",
        "seed": None, "steps": 0, "versions": {},
    }  # fmt: skip
    return BanditCard(**{**usual, **changes})


@pytest.fixture
def policy(tmp_path):
    bandit.write(card(), tmp_path / "policy.json")
    return from_text(f"policy:{tmp_path / 'policy.json'}")


@pytest.mark.slow
def test_it_begins_a_leg_as_it_began_the_first():
    settings = [{"on_factor": 0.8 + 0.1 * k, "period_factor": 1.0 + k} for k in range(3)]
    check_controller(lambda: BanditController(card(law="set-point", settings=settings)))


def test_a_setting_has_the_laws_own_values_of_parameters_that_only_others_name():
    settings = [{}, {"open_target_share": 0.25}, {"short_weight": 0.5}]
    made = BanditController(card(law="adaptive-hold:short_weight=0.3", settings=settings))
    set_up_controller(made, Task(ENV_ID).machine, np.array([[0.0, 0.0], [9000.0, 0.0]]), 0.0)
    made.reset(100.0)
    made.clock_s, values = 0.0, []
    for made.setting in (0, 1, 2, 0):
        made.update(WindowObservation(0.0, 0.0102, 5, 15, 30.0, 10.0, 9.0, 20.0, 0.0, fifths=(47, 47, 47, 47, 47)))
        names, components = ("open_target_share", "short_weight"), made.law.components
        values.append([getattr(one, name) for name in names for one in components if hasattr(one, name)])
    assert values == [[values[0][0], 0.3], [0.25, 0.3], [values[0][0], 0.5], [values[0][0], 0.3]]


def best(belief, bonus, lost_s):
    """Return the setting that is the best with this bonus."""
    return int(np.argmax(belief.at_best(bonus, lost_s)))


def cut(belief, rates, segments, bonus, offset=5.0, noise=0.03):
    """Return the settings that a belief chooses where they have these logarithms of rates."""
    rng, chosen, setting = np.random.default_rng(1), [], 0
    for _ in range(segments):
        belief.learn(setting, Segment(offset + rates[setting] + noise * rng.normal(), 0.1, 0.1))
        setting = best(belief, bonus, LOST_S)
        chosen.append(setting)
    return chosen


@pytest.mark.parametrize("fastest", [0, 1, 2])
def test_the_setting_that_cuts_fastest_is_found_whatever_the_rate_of_the_machine(fastest):
    rates = np.where(np.arange(3) == fastest, 0.2, 0.0)
    for offset in (-3.0, 8.0):
        chosen = cut(Belief(card()), rates, 40, 0.5, offset)
        assert chosen[-20:].count(fastest) >= 18


def test_one_setting_tells_of_another_by_what_machines_have_in_common():
    covariance = 0.04 * np.eye(9)
    covariance[5, 5] = 0.01  # opens under the third setting ...
    covariance[2, 5] = covariance[5, 2] = 0.018  # ... come with its rate
    belief = Belief(card(covariance=covariance.tolist(), mean=[0.0] * 9))
    belief.learn(2, Segment(0.0, 0.2, 0.0))
    found = belief.mean[2] - belief.mean[0]
    by_hand = np.array([0.04 + 25.0, 0.018])  # of the rate, by rate and opens: their covariance with it
    measured = np.array([[0.04 + 25.0 + 0.05**2, 0.018], [0.018, 0.01 + 0.02**2]])
    expected = by_hand @ np.linalg.solve(measured, [0.0, 0.2])
    first = np.array([25.0, 0.0]) @ np.linalg.solve(measured, [0.0, 0.2])
    assert found == pytest.approx(expected - first, rel=1e-9)
    assert found > 0.2


def test_drift_makes_an_old_measurement_uncertain_again():
    belief = Belief(card(drift=0.05))
    cut(belief, np.array([0.1, 0.0, 0.0]), 30, 0.0)
    assert best(belief, 0.0, LOST_S) == 0
    assert best(belief, 3.0, LOST_S) != 0


def test_a_setting_that_loses_wires_gives_way_to_one_that_cuts_a_little_slower():
    belief = Belief(card(breaks_s=50.0))
    for setting, rate in enumerate((0.05, 0.0, -0.3)):
        for _ in range(10):
            belief.learn(setting, Segment(5.0 + rate, 0.1, 0.1))
    belief.cut_s[:] = 200.0
    assert best(belief, 0.0, LOST_S) == 0
    belief.lost[0] = 2  # two wires in 250 s, with 0.1 of the prior: 21 % of the time; else 1 %
    assert belief.net(LOST_S)[0] == pytest.approx(belief.mean[0] - np.log(1.0 + 2.1 / 250.0 * LOST_S))
    assert best(belief, 0.0, LOST_S) == 1
    belief.begin()
    assert not belief.lost.any()


def test_a_setting_that_can_hardly_be_the_best_is_not_tried(tmp_path):
    tried = []
    for deviation in (0.01, 0.2):
        covariance = np.diag([deviation**2] * 3 + [0.04] * 6)
        mean = [0.0, 0.0, -0.2, *[0.1] * 6]
        bandit.write(card(mean=mean, covariance=covariance.tolist()), tmp_path / "policy.json")
        controller = from_text(f"policy:{tmp_path / 'policy.json'}")
        tried.append([controller.choose() for _ in range(2)])
    assert 2 not in tried[0]
    assert tried[1] == [1, 2]


def test_in_a_shift_settings_are_tried_and_a_new_wire_begins_with_the_first(policy):
    episode = Episode(Task(ENV_ID, episode_s=4.0), policy, 3, "bandit")
    states = [(policy.setting, policy.clock_s, policy.law.measure.open_target_share) for _ in episode.windows()]
    assert episode.outcome == "time"
    assert {setting for setting, _, _ in states} == {0, 1, 2}
    assert min(clock_s for _, clock_s, _ in states) < -0.45  # the first wire begins for longer than later ones
    for setting, clock_s, target in states:
        assert target == SETTINGS[setting if clock_s >= 0.0 else 0]["open_target_share"]
    policy.setting, policy.clock_s, policy.broken = 2, 0.1, False
    policy.wire_lost()
    assert not policy.belief.lost.any()  # the first shows the law what wires bear
    policy.clock_s = 0.1
    policy.wire_lost()
    assert policy.belief.lost.tolist() == [0.0, 0.0, 1.0]
    policy.wire_lost()  # before the setting was in force again
    assert policy.belief.lost.tolist() == [0.0, 0.0, 1.0]
    usual = WindowObservation(0.0, 0.01, 5, 15, 30.0, 10.0, 9.0, 20.0, 0.0, fifths=(47, 47, 47, 47, 47))
    policy.update(usual)
    assert policy.law.measure.open_target_share == 0.0
    for _ in range(20):
        policy.update(usual)
    assert policy.law.measure.open_target_share == 0.3


def test_a_snapshot_goes_on_bit_for_bit(policy, tmp_path):
    second = from_text(f"policy:{tmp_path / 'policy.json'}")
    usual = WindowObservation(0.0, 0.0102, 5, 15, 30.0, 10.0, 9.0, 20.0, 0.0, fifths=(47, 47, 47, 47, 47))
    for each in (policy, second):
        set_up_controller(each, Task(ENV_ID).machine, np.array([[0.0, 0.0], [9000.0, 0.0]]), 0.0)
        each.reset(400.0)
    for k in range(130):
        policy.update(usual._replace(path_um=0.3 * k))
    second.restore(json.loads(json.dumps(policy.snapshot())))
    after = [usual._replace(short=40, path_um=40.0 + 0.2 * k) for k in range(60)]
    assert [policy.update(w) for w in after] == [second.update(w) for w in after]
    assert policy.snapshot() == second.snapshot()


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"mean": [0.0] * 8}, "must have 9 entries"),
        ({"settle_s": 0.5}, "settle_s"),
        ({"breaks": [0.0]}, "breaks must have 3 entries"),
        ({"law": "heat-oracle"}, "a machine could have"),
        ({"law": "unknown"}, "unknown"),
        ({"settings": [{"size": 1.0}] * 3}, "no parameter 'size'"),
    ],
)
def test_a_file_that_does_not_fit_is_refused_in_one_line(tmp_path, changes, match):
    stored = {**card().model_dump(), **changes}
    (tmp_path / "policy.json").write_text(json.dumps(stored), encoding="utf-8")
    with pytest.raises(InputError, match=match):
        from_text(f"policy:{tmp_path / 'policy.json'}")


def test_its_card_takes_scores(tmp_path):
    file = tmp_path / "policy.json"
    bandit.write(card(), file)
    row = score.Score("policy", "fast", 2, 1.0, 0.1, 10.0, None, 4.0, 0, 0)
    score.write_card(str(file), [row])
    assert bandit.load(file).scores == [row._asdict()]
    assert score.env_id_of(str(file)) == ENV_ID


@pytest.mark.parametrize(
    ("fifths", "share"),
    [((100,) * 5, 1.0), ((100, 100, 100, 50, 0), 0.7), ((130, 100, 5, 0, 0), 0.409), ((90, 0, 0, 0, 0), 0.2)],
)
def test_the_local_height_follows_from_where_pulses_ignite(fifths, share):
    assert bandit.height_share(fifths) == pytest.approx(share, abs=0.01)
