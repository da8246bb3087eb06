"""Comparisons: the same cuts for everyone, honest figures, and a command line that says them."""

import json
import math
from dataclasses import fields
from itertools import islice

import gymnasium
import numpy as np
import pytest

from edmsim import runs
from edmsim.controllers import FeedCommand, from_text, make
from edmsim.controllers.feed.laws import FixedController
from edmsim.envs import pass_laws
from edmsim.envs.episode import Task
from edmsim.envs.families import GapFeed
from edmsim.envs.part_task import Part
from edmsim.envs.registry import arguments_with, register
from edmsim.envs.reward import Weights
from edmsim.errors import InputError
from edmsim.evaluation import compare
from edmsim.evaluation.compare import as_json, render, shown
from edmsim.evaluation.episode import HELD_BACK, ORACLE_GAPS_UM, Episode, Result, engine_of, lines_of
from edmsim.learning import hyperparameters
from edmsim.learning.score import score
from edmsim.runs import RunTable, processors

GAP_FEED, CORNER, CONTOUR = "edmsim/GapFeed-v2", "edmsim/Corner-v3", "edmsim/Contour-v2"
WHOLE = Task.__init__


@pytest.fixture(scope="module")
def compared(short_episodes):
    return compare.evaluate(GAP_FEED, ["fixed", "voltage"], 3, resolution="fast")


def result(rate=10.0, outcome="finished", length=1.0, error=math.nan, reward=100.0, time_s=60.0):
    lost = int(outcome == "wire break")
    return Result(
        0, "any", outcome, time_s, length, 10.0, rate, reward, lost, float(lost), 0.1, 0.2, error, math.nan, 320.0
    )


def test_the_rate_of_a_policy_s_scores_counts_the_threading_after_a_lost_wire():
    whole, broken = result(10.0), result(5.0, outcome="wire break")  # 60 s each, and 60 s to thread another wire
    assert score([whole, broken], "fast").rate_mm2_min == pytest.approx(60.0 * 20.0 / 180.0)
    assert score([whole, whole], "fast").rate_mm2_min == pytest.approx(10.0)
    assert score([result(0.0)._replace(area_mm2=0.0), whole], "fast").rate_mm2_min == pytest.approx(5.0)


def test_policies_are_trained_on_what_controllers_are_compared_on():
    """An id says it all; a training only keeps a machine for some episodes, where the task lets it."""
    for env_id in compare.env_ids():
        keeps = {"machine_episodes"} & {argument.name for argument in fields(arguments_with(env_id))}
        for algo in ("ppo", "sac"):
            assert set(hyperparameters.load(env_id, algo).environment) == keeps


def test_an_environment_may_have_laws_and_a_scale_of_its_own():
    assert compare.usual("edmsim/MaxRate-v1")[:4] == ["fixed-period", "sato", "heat-flux", "heat-oracle"]
    lines = lines_of("edmsim/MaxRate-v1")
    assert (lines.blind, lines.reference) == ("fixed-period", "heat-oracle")
    assert (lines_of(GAP_FEED).blind, lines_of(GAP_FEED).reference) == ("fixed", "oracle")
    assert not {"fixed-period", "heat-oracle"} & set(compare.usual(GAP_FEED))


@pytest.mark.slow
def test_the_same_comparison_again_is_the_same(compared):
    assert as_json([compare.evaluate(GAP_FEED, ["fixed", "voltage"], 3, resolution="fast")]) == as_json([compared])


@pytest.mark.slow
def test_a_long_comparison_in_processes_finds_the_same(monkeypatch):
    monkeypatch.setattr(Task, "__init__", WHOLE)  # which no other process has shortened
    found = []
    for longest_s in (1e9, 0.0):
        monkeypatch.setattr(runs, "LONG_S", longest_s)
        found.append((engine_of(CORNER, 2) is None, repr(compare.run(CORNER, ["voltage"], 2, "fast"))))
    assert found == [(True, found[0][1]), (processors() == 1, found[0][1])]


def test_environments_that_other_processes_do_not_know_are_compared_here():
    register("here/Only-v0", GapFeed, height_mm=(8.0, 8.0))
    assert engine_of("here/Only-v0", 10**6) is None
    table, made = RunTable(), []
    for height_mm in (8.0, 4.0, 8.0):  # cuts of an earlier registration are not those of this one
        register("here/Only-v0", GapFeed, height_mm=(height_mm, height_mm), episode_s=0.1)
        made.append(compare.run("here/Only-v0", ["fixed"], 2, "fast", table=table))
    assert made[0] == made[2] != made[1]
    assert len(table.rows) == 4
    assert (engine_of(GAP_FEED, 10**6) is None) == (processors() == 1)


def test_every_controller_meets_the_held_back_machines(compared):
    assert compared.seeds == tuple(HELD_BACK + k for k in range(3))
    assert list(compared.results) == ["fixed", "voltage", "oracle"]
    for results in compared.results.values():
        assert tuple(r.seed for r in results) == compared.seeds


def test_every_controller_of_a_task_s_lines_can_be_made():
    for env_id in compare.env_ids():
        lines = lines_of(env_id)
        named = (lines.blind, *lines.rehearsed, *lines.compared)
        if isinstance(arguments_with(env_id), Part):
            assert all(callable(pass_laws.from_text(name).act) for name in named)
        else:
            assert [from_text(name).name for name in named] == [name.partition(":")[0] for name in named]


def test_the_oracle_is_the_bound_of_its_own_gaps(compared):
    seed = compared.seeds[0]
    laws = [make("oracle", gap_target_um=gap) for gap in ORACLE_GAPS_UM[::3]]
    own = [started(GAP_FEED, law, seed).run().total_return for law in laws]
    assert compared.results["oracle"][0].total_return >= max(own)


def started(env_id, controller, seed, **options):
    return Episode(Task(env_id, **options), controller, seed, "any")


def test_an_episode_is_the_environments_own():
    """The return is what an agent that commands the same feeds collects."""
    made = started(CORNER, make("fixed", feed_um_s=12.0), 3, leg_mm=0.04, episode_s=60.0).run()
    env = gymnasium.make(CORNER, action="speed", max_feed_um_s=12.0, leg_mm=0.04)
    env.reset(seed=3)
    total, over, action = 0.0, False, np.array([1.0, 0.0, 0.0, 0.0], np.float32)
    while not over:
        _, reward, terminated, truncated, info = env.step(action)
        total += float(reward)
        over = terminated or truncated
    assert made.outcome == "finished"
    assert made.total_return == pytest.approx(total)
    assert made.time_s == info["time_s"]


def test_an_episode_can_be_watched_window_by_window():
    watched = started(GAP_FEED, make("fixed", feed_um_s=12.0), 3)
    windows = [window.observation for window in islice(watched.windows(), 5)]
    assert watched.outcome is None
    assert [window.feed_um_s for window in windows] == pytest.approx([12.0] * 5)
    assert windows[-1].time_s == pytest.approx(5 * 255e-4)


def test_straight_cuts_have_no_path_error_corners_and_contours_have(compared):
    assert math.isnan(compared.results["voltage"][0].error_um)
    assert math.isnan(compared.figures["voltage"]["error_um"].value)
    corner = started(CORNER, make("fixed", feed_um_s=12.0), 3, leg_mm=0.04).run()
    assert 0.0 < corner.error_um < 20.0
    assert math.isnan(corner.edge_error_um)


@pytest.mark.slow
def test_the_edge_of_a_contour_is_measured():
    made = Episode(Task(CONTOUR, height_mm=(4.0, 6.0), episode_s=300.0), make("voltage"), 2, "any").run()
    assert 0.0 < made.error_um < 20.0
    assert 0.0 < made.edge_error_um < 60.0


@pytest.mark.slow
def test_a_policy_is_compared_like_any_other():
    compared = compare.evaluate(GAP_FEED, ["policy:GapFeed-ppo", "counts"], 2)
    assert list(compared.results) == ["policy:GapFeed-ppo", "counts", "fixed", "oracle"]
    assert "policy:GapFeed-ppo" in compare.usual(GAP_FEED)
    assert "policy:GapFeed-ppo" not in compare.usual(CORNER)


def test_a_jammed_wire_ends_the_cut_and_costs_threading():
    task = Task(GAP_FEED, planner="exact", episode_s=25.0, randomise=None, height_mm=None, tension=None)
    jammed = Episode(task, make("fixed", feed_um_s=100.0), 5, "fixed").run()
    assert jammed.outcome == "jammed"
    assert jammed.jammed
    assert not jammed.broke
    assert jammed.rate_mm2_min == pytest.approx(60 * jammed.area_mm2 / (jammed.time_s + 60.0))


def test_giving_up_costs_as_much_as_the_limit_it_avoids():
    class Quitter(FixedController):
        def update(self, window):
            return FeedCommand(0.0, "no more")

    reward = []
    for limit in (0.0, 2.0):
        task = Task(GAP_FEED, resolution="fast", weights=Weights(limit=limit))
        stopped = Episode(task, Quitter(feed_um_s=5.0), 5, "quitter").run()
        assert stopped.outcome == "stopped"
        assert stopped.jammed
        reward.append(stopped.total_return)
    assert reward[0] - reward[1] == pytest.approx(2.0 * 60 / 0.0255)


def test_a_rate_of_few_cuts_of_which_some_have_no_length_has_no_interval():
    some, many = np.array([1.0, 0.0]), np.append(np.ones(11), 0.0)
    for short in (0.0, 1e-9):
        figure = compare.ratio(some, np.array([1.0, short]))
        assert np.isnan([figure.low, figure.high]).all()
    assert (compare.ratio(many, many).value, compare.ratio(many, many).low) == (1.0, 1.0)


def test_losses_are_per_metre_of_all_cuts():
    results = [result(length=1.0), result(outcome="wire break", length=0.5), result(outcome="jammed", length=0.5)]
    figures = compare.figures_of(results, [result(20.0)] * 3, [result(5.0)] * 3)
    assert figures["breaks_per_m"].value == pytest.approx(1 / 0.002)
    assert figures["jams_per_m"].value == pytest.approx(1 / 0.002)
    assert figures["oracle_share"].value == pytest.approx(0.5)
    assert set(figures) == set(compare.FIGURES)


def test_no_loss_in_a_short_length_excludes_little():
    figures = compare.figures_of([result(length=0.5)] * 2, [result()] * 2, [result()] * 2)
    assert figures["breaks_per_m"] == compare.Figure(0.0, 0.0, pytest.approx(-math.log(0.05) / 0.001))


def coverage(draw, true):
    """Return how many of 1000 intervals of pairs hold the true ratio, in percent."""
    rng = np.random.default_rng(3)
    found = [compare.ratio(*draw(rng)) for _ in range(1000)]
    return sum(figure.low <= true <= figure.high for figure in found) / 10


@pytest.mark.parametrize("machines", [3, 6, 12])
def test_intervals_of_few_skewed_machines_hold_the_true_ratio(machines):
    def shares(rng):
        of_machine = rng.lognormal(0.0, 0.6, machines)
        return of_machine * rng.lognormal(-0.18, 0.6, machines), of_machine

    def breaks(rng):
        lengths = rng.uniform(0.5, 1.5, machines)
        return rng.poisson(3.0 * lengths).astype(float), lengths

    assert 89.0 <= coverage(shares, 1.0) <= 97.0
    assert 92.0 <= coverage(breaks, 3.0) <= 98.0


def test_the_interval_of_a_mean_may_be_below_zero():
    values = np.array([-1.0, 0.0, 1.0, 2.0])
    half = 3.1824463 * values.std(ddof=1) / 2
    assert compare.mean(values) == compare.Figure(0.5, pytest.approx(0.5 - half), pytest.approx(0.5 + half))
    of_each = compare.ratio(values, np.ones(4))
    assert (of_each.low, of_each.high) == (pytest.approx(0.5 - half), pytest.approx(0.5 + half))
    assert math.isnan(compare.mean(values[:1]).low)


def test_intervals_of_many_cuts_have_the_width_of_theory():
    values = np.random.default_rng(1).normal(10.0, 2.0, 400)
    figure = compare.ratio(values, np.ones(400))
    assert figure.value == pytest.approx(values.mean())
    assert figure.high - figure.low == pytest.approx(2 * 1.96 * values.std() / 20, rel=0.1)
    assert compare.ratio(np.full(5, 3.0), np.ones(5)) == compare.Figure(3.0, 3.0, 3.0)
    assert math.isnan(compare.ratio(np.array([]), np.array([])).value)


def test_a_score_is_what_was_rewarded_between_the_blind_and_the_reference_machine_by_machine():
    blind, oracle = ([result(reward=value) for value in values] for values in ((0, 0, 100, 50), (100, 200, 300, 40)))
    made = [result(reward=value) for value in (50, 200, 0, 45)]
    assert compare.scores(made, oracle, blind).tolist() == [0.5, 1.0, -0.5]  # the fourth machine tells nothing
    found = compare.interquartile_mean(np.array([-90.0, 0.2, 0.4, 0.6, 0.8, 5.0]))
    assert found.value == pytest.approx(0.5)
    assert found.low < found.value < found.high
    assert compare.figures_of(made, oracle, blind)["score"].value == pytest.approx(1 / 3)


def test_figures_are_shown_with_their_intervals():
    assert shown("rate_mm2_min", compare.Figure(12.34, 10.0, 123.4)) == "12.3 (10.0 to 123)"
    assert shown("short_share", compare.Figure(0.125, 0.1, 0.2)) == "12.5 % (10.0 to 20.0)"
    assert shown("error_um", compare.Figure(math.nan, math.nan, math.nan)) == ""
    assert shown("breaks_per_m", compare.Figure(0.0, 0.0, 419.0)) == "none (at most 419)"
    assert shown("breaks_per_m", compare.Figure(153.0, 0.0, 536.0)) == "153 (0.0 to 536)"


def test_the_table_fits_a_terminal_of_eighty_columns_and_says_what_it_means():
    from rich.console import Console

    made = {
        "oracle": [result(reward=100.0, error=1.0)] * 12, "fixed": [result(reward=0.0)] * 12,
        "adaptive-off-time": [result(reward=50.0), *[result(reward=60.0, outcome="wire break")] * 11],
    }
    figures = {name: compare.figures_of(cuts, made["oracle"], made["fixed"]) for name, cuts in made.items()}
    comparison = compare.Comparison(CONTOUR, "fast", tuple(range(12)), made, figures)
    texts = []
    for width in (80, 200):
        console = Console(width=width)
        with console.capture() as shown_there:
            console.print(render(comparison, width))
        texts.append(shown_there.get())
    narrow, wide = texts
    assert max(map(len, narrow.splitlines())) <= 80
    assert narrow.splitlines()[1].split() == [
        "controller", "score", "mm2/min", "short", "open", "s", "breaks", "jams",
    ]  # fmt: skip
    row = next(line for line in narrow.splitlines() if line.startswith("adaptive-off-time"))
    assert row.split()[-2:] == ["11", "0"]
    assert "1 what oracle earns" in " ".join(narrow.split())
    for said in ("breaks/m", "none", "(at most"):
        assert said in wide


@pytest.mark.parametrize(("env_id", "controllers", "seeds", "resolution", "words"), [
    ("edmsim/Gap-v1", ["fixed"], 3, "fast", "no environment 'edmsim/Gap-v1'; choose one of edmsim/GapFeed-v2"),
    (GAP_FEED, ["pid"], 3, "fast", "no feed controller 'pid'"),
    (GAP_FEED, [], 3, "fast", "no controller is named"),
    (GAP_FEED, "fixed", 3, "fast", "controllers is the text 'fixed': give a list, as ['fixed']"),
    (GAP_FEED, ["fixed"], 1, "fast", "seeds is 1: give a whole number, 2 or more"),
    (GAP_FEED, ["fixed"], 3, "best", "best"),
])  # fmt: skip
def test_what_cannot_be_compared_is_refused(env_id, controllers, seeds, resolution, words):
    with pytest.raises(InputError) as refused:
        compare.evaluate(env_id, controllers, seeds, resolution=resolution)
    assert words in str(refused.value)


@pytest.mark.slow
def test_the_command_prints_json(edmsim):
    slow = "fixed:feed_um_s=20,offset_um=0"  # its own comma parts no controllers
    words = ("--controllers", f"{slow},counts", "--seeds", 2, "--resolution", "fast", "--json")
    shown = edmsim("evaluate", GAP_FEED, *words)
    assert shown.status == 0
    (found,) = json.loads(shown.out)
    assert found["env_id"] == GAP_FEED
    assert set(found["controllers"]) == {"fixed", slow, "counts", "oracle"}
    assert found["controllers"][slow]["error_um"]["value"] is None
    assert len(found["cuts"]) == 8
