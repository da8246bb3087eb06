"""Search of a controller's settings: what a user's own declares, the robust choice and its spread, refusals."""

import tomllib
from dataclasses import replace

import pytest

from edmsim.errors import InputError
from edmsim.runs import LostJob
from edmsim.sweep import tune
from edmsim.sweep.tune import Trial, judge_trial, tune_controller

FIRMWARE = """\
from edmsim.controllers.feed.laws import FixedController


class Firmware(FixedController):
    name = "firmware"
    BOUNDS = {BOUNDS}

    def __init__(self, feed_um_s=5.0, window_s=0.1):
        super().__init__(feed_um_s=feed_um_s)
        self.window_s = window_s
"""
USUAL = '{"feed_um_s": (1.0, 30.0), "window_s": (0.01, 1.0, "log")}'


def written(folder, bounds=USUAL):
    file = folder / "firmware.py"
    file.write_text(FIRMWARE.replace("{BOUNDS}", bounds))
    return f"{file}:Firmware"


class Machines:
    """An engine whose machines differ by their seed: 10 um/s do well on most of them, 6 on all."""

    def __init__(self, lost=-9):
        self.observed = list[Trial]()
        self.lost = lost

    def done(self, function, jobs):
        assert function is judge_trial
        for job in jobs:
            self.observed.append(job)
            feed = job.values["feed_um_s"]
            returns = tuple(-100.0 if feed > 6.5 and seed % 4 == 0 else feed for seed in job.seeds)
            lost = job.number == self.lost
            result = tune.TrialResult(tune.worst_share_mean(returns), None, {}, returns)
            yield job, LostJob("the computer was lost") if lost else result


def test_the_choice_is_robust_and_its_spread_is_of_other_machines(tmp_path):
    engine, observed = Machines(), list[tuple[int, float]]()
    own = written(tmp_path)
    found = tune_controller(
        own, tmp_path / "study", trials=25, seeds=4, engine=engine, watch=lambda *a: observed.append(a)
    )
    assert 5.5 < found.values["feed_um_s"] <= 6.5
    assert found.spread.worst == found.spread.low == found.values["feed_um_s"]
    assert found.first_spread.worst == 5.0
    assert (found.trials, found.failed, found.machines) == (25, 0, 4 * tune.FRESH)
    again = [trial for trial in engine.observed if trial.seeds == tuple(range(8))]
    assert len(again) == 1 + tune.FINALISTS
    tried = [seed for trial in engine.observed[:25] for seed in trial.seeds]
    assert tried == list(range(8, 8 + 25 * 4))  # every trial has machines of its own, and none of these
    assert engine.observed[0].values == {"feed_um_s": 5.0, "window_s": 0.1}  # what is in use comes first
    assert observed[-1][0] == 25
    best = tomllib.loads((tmp_path / "study" / "best.toml").read_text())["parameters"]
    assert best == found.values
    same = Machines()
    assert tune_controller(own, tmp_path / "study", trials=25, seeds=4, engine=same) == found
    assert not same.observed  # the finalists' cuts are not made again, either
    more = Machines()
    tune_controller(own, tmp_path / "study", trials=27, seeds=4, engine=more)
    assert [trial.number for trial in more.observed if len(trial.seeds) == 4] == [25, 26]  # the study goes on


def test_values_stay_within_narrow_bounds_and_differ(tmp_path):
    bounds = '{"feed_um_s": (4.5628, 30.0), "window_s": (995.4, 996.4)}'
    file = written(tmp_path, bounds)
    own = tmp_path / "firmware.py"
    own.write_text(own.read_text().replace("feed_um_s=5.0, window_s=0.1", "feed_um_s=4.5628, window_s=995.7"))
    engine = Machines()
    found = tune_controller(file, tmp_path / "study", trials=10, seeds=1, engine=engine)
    trials = [trial.values for trial in engine.observed[:10]]
    assert trials[0] == {"feed_um_s": 4.5628, "window_s": 995.7}
    assert all(995.4 <= values["window_s"] <= 996.4 for values in trials)
    assert len({values["window_s"] for values in trials}) == 10
    assert found.values in trials


@pytest.mark.slow
def test_a_trial_cuts_on_drawn_machines(tmp_path):
    own = written(tmp_path)
    options = {"resolution": "fast", "episode_s": 1.0, "height_mm": 10.0}
    trial = Trial(0, "controller", own, {"feed_um_s": 6.0}, (1, 2), options=options)
    worths = [judge_trial(one) for one in (trial, replace(trial, seeds=(2, 1)))]
    assert worths[0].error is None
    assert worths[0].returns == worths[1].returns[::-1]
    assert worths[0].returns[0] != worths[0].returns[1]
    assert worths[0].value == min(worths[0].returns)
    failed = judge_trial(Trial(0, "controller", own, {"feed_um_s": 6.0, "gain": 1.0}, (1,), options=options))
    assert "no parameter 'gain'" in str(failed.error)


def test_ours_are_searched_alike(tmp_path):
    found = tune_controller("fixed", tmp_path / "study", trials=25, seeds=4, engine=Machines())
    assert found.first_spread.worst < 4.0 < found.values["feed_um_s"] <= 6.5
    with pytest.raises(InputError, match="of fixed, not of counts"):
        tune_controller("counts", tmp_path / "study", trials=1, engine=Machines())
    for other, said in (({"seeds": 5}, "of seeds 4, not 5"), ({"seed": 9, "seeds": 4}, "of seed 0, not 9"),
                        ({"seeds": 4, "height_mm": 7}, "'height_mm': 7")):
        with pytest.raises(InputError, match=said):
            tune_controller("fixed", tmp_path / "study", trials=26, engine=Machines(), **other)


def test_bounds_are_read_as_declared(tmp_path):
    feeds, windows = tune.Bound(1.0, 30.0), tune.Bound(0.01, 1.0, "log")
    assert tune.bounds_of(written(tmp_path)) == {"feed_um_s": feeds, "window_s": windows}


@pytest.mark.parametrize(("bounds", "said"), [
    ("{}", "does not say what is searched"), ("3", "does not say what is searched"),
    ('{"gain": (1, 2)}', "its parameters are feed_um_s, window_s"),
    ('{"feed_um_s": (2, 1)}', "from a number to a greater one"),
    ('{"feed_um_s": (0, 1, "log")}', 'with "log" from above 0, not '),
    ('{"feed_um_s": (0, float("inf"))}', "from a number to a greater one"), ('{"feed_um_s": 4}', "not 4"),
    ('{"feed_um_s": (1, 2, "cubic")}', "from a number to a greater one"),
])  # fmt: skip
def test_bounds_that_say_nothing_are_refused(tmp_path, bounds, said):
    with pytest.raises(InputError, match=said):
        tune_controller(written(tmp_path, bounds), tmp_path / "study", engine=Machines())
    assert not (tmp_path / "study").exists()


@pytest.mark.parametrize(("arguments", "said"), [
    (["own.py:A"], "--out"), (["--out", "s"], "missing"), (["a.py:A", "--colour", "5", "--out", "s"], "--colour"),
    (["firmware.py", "--out", "s"], "names no controller of your own"),
    (["none.py:A", "--out", "s"], "no such file"),
])  # fmt: skip
def test_the_command_refuses_in_one_line(arguments, said, monkeypatch, edmsim, tmp_path):
    monkeypatch.chdir(tmp_path)
    shown = edmsim("tune", "controller", *arguments)
    assert (shown.status, shown.err.count("\n")) == (2, 1)
    assert said in shown.err


def test_a_finalist_that_is_lost_is_said(tmp_path):
    with pytest.raises(InputError, match="trial -1 could not be tried again: the computer was lost"):
        tune_controller(written(tmp_path), tmp_path / "study", trials=2, seeds=2, engine=Machines(lost=-1))
