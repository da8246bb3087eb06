"""The search of gains: it finds, it repeats itself, and it stays away from the held-back seeds."""

import itertools
import math
import tomllib
from pathlib import Path

import pytest

from edmsim import models
from edmsim.controllers import found_gains, make
from edmsim.errors import InputError
from edmsim.evaluation.episode import HELD_BACK, Result
from edmsim.sweep.tune import BOUNDS, training_seeds


@pytest.fixture(autouse=True)
def short(short_episodes):
    """Cut a fraction as long."""


def result(controller, rate, reward):
    return Result(
        0, controller, "finished", 60.0, 1.0, 10.0, rate, reward, 0, 0.0, 0.1, 0.2, math.nan, math.nan, 320.0
    )


@pytest.fixture
def gains_script(load_script):
    return load_script(Path(__file__).parents[2] / "docs" / "make" / "gains.py")


@pytest.mark.slow
def test_gains_are_scored_on_real_cuts_the_same_every_time(gains_script):
    made = [gains_script.run_all(training_seeds(3, 1), lambda: make("voltage", reference_V=9.0)) for _ in range(2)]
    assert str(made[0]) == str(made[1])  # as text, in which one NaN is like another
    assert len(made[0]) == len(gains_script.ENV_IDS)
    assert gains_script.score(made[0]) > 0


@pytest.mark.slow
@pytest.mark.parametrize("end", [0, 1])
def test_every_feed_that_is_searched_can_be_run(gains_script, end):
    feed_um_s = BOUNDS["fixed"]["feed_um_s"][end]
    made = gains_script.run_all(training_seeds(3, 1), lambda: make("fixed", feed_um_s=feed_um_s))
    assert len(made) == len(gains_script.ENV_IDS)


def test_the_oracle_is_scored_by_its_rate_the_others_by_their_return(gains_script):
    assert gains_script.score([result("oracle", 10.0, 1.0), result("oracle", 20.0, 1.0)]) == 15.0
    assert gains_script.score([result("counts", 10.0, 1.0), result("counts", 20.0, 2.0)]) == 1.5


def test_held_back_seeds_are_never_trained_on():
    assert max(training_seeds(HELD_BACK - 2, 2)) == HELD_BACK - 1
    for seed in (-1, HELD_BACK - 1, HELD_BACK):
        with pytest.raises(InputError, match=f"lie from 0 to {HELD_BACK - 1}: {seed} to {seed + 1} do not"):
            training_seeds(seed, 2)


@pytest.mark.parametrize("name", sorted(set(BOUNDS) - {"counts"}))
def test_the_found_gains_are_used_and_name_their_command(name):
    text = models.path(f"gains/{name}.toml").read_text(encoding="utf-8")
    assert f"python docs/make/gains.py {name}" in text
    gains = tomllib.loads(text)["gains"]
    found_gains(name).clear()
    assert set(gains) == set(BOUNDS[name])
    for gain, value in gains.items():
        low, high = BOUNDS[name][gain]
        assert low <= value <= high
        assert getattr(make(name), gain) == value
    assert getattr(make(name, **{gain: low}), gain) == low


def test_the_script_of_the_gains_finds_the_best_and_repeats_itself_also_interrupted(
    gains_script, tmp_path, monkeypatch
):
    """Of cuts that earn most, 100, with a reference of 12 V and little proportional action."""
    script = gains_script
    monkeypatch.chdir(tmp_path)
    calls, interrupt_at = itertools.count(), [-1]

    def cuts(seeds, controller):
        if next(calls) == interrupt_at[0]:
            raise KeyboardInterrupt
        law = controller()
        reward = 100.0 - 10 * abs(law.reference_V - 12.0) - law.proportional_um_s_V
        return [result("voltage", 1.0, reward)] * len(seeds)

    monkeypatch.setattr(script, "run_all", cuts)
    gains, value = script.search("voltage", 120, 3)
    assert gains["reference_V"] == pytest.approx(12.0, abs=1.0)
    assert 80.0 < value < 100.0
    made = next(calls)
    script.FOLDER = Path("again")
    interrupt_at[0] = made + 20
    with pytest.raises(KeyboardInterrupt):
        script.search("voltage", 120, 3)
    assert script.search("voltage", 120, 3) == (gains, value)
    with pytest.raises(InputError, match="it has the runs of seed 3, not 4"):
        script.search("voltage", 120, 4)
