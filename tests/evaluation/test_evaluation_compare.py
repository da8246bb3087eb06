"""Comparisons: the same cuts for everyone, honest figures, and a command line that says them."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest

from edmsim import cli
from edmsim.controllers import make
from edmsim.errors import InputError, WireInMetalError
from edmsim.evaluation import scenarios
from edmsim.evaluation.compare import FIGURES, Comparison, Figure, evaluate, figures_of, ratio
from edmsim.evaluation.episode import Episode, Result
from edmsim.evaluation.page import as_json, bar, page, shown

GAP_FEED, CORNER = "edmsim/GapFeed-v0", "edmsim/Corner-v0"


@pytest.fixture(scope="module", autouse=True)
def short_cuts():
    """Cuts a tenth as long."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scenarios, "LENGTH_UM", 100.0)
        patch.setattr(scenarios, "STRETCH_UM", 50.0)
        yield


@pytest.fixture(scope="module")
def compared(short_cuts) -> Comparison:
    return evaluate(GAP_FEED, ["fixed", "voltage"], 3, resolution="fast")


def result(rate=10.0, outcome="finished", length=1.0, error=math.nan) -> Result:
    return Result(0, "any", outcome, 60.0, length, 10.0, rate, 0.1, 0.2, error, 320.0)


@pytest.mark.parametrize("env_id", scenarios.env_ids())
def test_a_seed_draws_the_same_cut_again_and_another_seed_another(env_id: str) -> None:
    first, again, other = (scenarios.draw(env_id, seed) for seed in (7, 7, 8))
    assert first.machine == again.machine
    assert np.array_equal(first.points_um, again.points_um)
    assert first.machine != other.machine
    assert first.machine.base.gap != other.machine.base.gap


def test_what_is_drawn_stays_within_its_ranges() -> None:
    for seed in range(20):
        step = scenarios.draw("edmsim/HeightStep-v0", seed)
        tall, thin = step.machine.height_mm, step.stock.steps[0].height_mm
        assert scenarios.TALL_MM[0] <= tall <= scenarios.TALL_MM[1]
        assert scenarios.THIN_SHARE[0] <= thin / tall <= scenarios.THIN_SHARE[1]
        assert scenarios.TENSION[0] <= step.machine.tension <= scenarios.TENSION[1]
        (ax, ay), (bx, by), (cx, cy) = scenarios.draw(CORNER, seed).points_um
        turn = math.degrees(math.atan2(cy - by, cx - bx) - math.atan2(by - ay, bx - ax))
        assert scenarios.TURN_DEG[0] - 1e-9 <= abs(turn) <= scenarios.TURN_DEG[1] + 1e-9


def test_the_same_comparison_again_is_the_same(compared: Comparison) -> None:
    assert as_json([evaluate(GAP_FEED, ["fixed", "voltage"], 3, resolution="fast")]) == as_json([compared])


def test_every_controller_meets_the_held_back_machines(compared: Comparison) -> None:
    assert compared.seeds == tuple(scenarios.HELD_BACK + k for k in range(3))
    assert list(compared.results) == ["fixed", "voltage", "oracle"]
    for results in compared.results.values():
        assert tuple(r.seed for r in results) == compared.seeds


def test_the_oracle_is_the_bound_of_its_own_gaps(compared: Comparison) -> None:
    seed = compared.seeds[0]
    own = [
        Episode(scenarios.draw(GAP_FEED, seed), make("oracle", gap_target_um=gap), seed, "fast").run().rate_mm2_min
        for gap in (4.0, 7.0)
    ]
    assert compared.results["oracle"][0].rate_mm2_min >= max(own)
    assert compared.figures["oracle"]["oracle_share"] == Figure(1.0, 1.0, 1.0)


def test_cutting_rate_is_area_over_time(compared: Comparison) -> None:
    for r in compared.results["voltage"]:
        assert r.outcome == "finished"
        height = scenarios.draw(GAP_FEED, r.seed).machine.height_mm
        assert r.length_mm == pytest.approx(0.1)
        assert r.rate_mm2_min == pytest.approx(60 * 0.1 * height / r.time_s)


def test_a_stepped_workpiece_counts_its_local_height() -> None:
    scenario = scenarios.draw("edmsim/HeightStep-v0", 3)
    episode = Episode(scenario, make("voltage"), 3, "fast")
    done = episode.run()
    tall, thin = scenario.machine.height_mm, scenario.stock.steps[0].height_mm
    thin_slices = round(float(episode.plant.field.relief.heights_mm(np.array([[32_575.0, 32_500.0]]))[0] / tall * 5))
    assert abs(thin_slices / 5 - thin / tall) <= 0.1
    assert done.area_mm2 == pytest.approx(0.05 * tall * (2 + thin_slices / 5), rel=0.05)


def test_the_corner_is_measured_and_the_straight_cut_is_not(compared: Comparison) -> None:
    turned = Episode(scenarios.draw(CORNER, 5), make("voltage"), 5, "fast").run()
    assert 0.0 < turned.error_um < 60.0
    assert math.isnan(compared.results["voltage"][0].error_um)
    assert math.isnan(compared.figures["voltage"]["error_um"].value)


def test_a_jammed_wire_ends_the_cut_and_costs_threading(monkeypatch: pytest.MonkeyPatch) -> None:
    episode = Episode(scenarios.draw(GAP_FEED, 5), make("fixed", feed_um_s=10.0), 5, "fast")
    for _ in range(40):
        assert episode.step() is None
    window = episode.plant.advance()

    def jam(_steps):
        raise WireInMetalError("the wire was driven into the metal", 1.0, (0.0, 0.0), window)

    monkeypatch.setattr(episode.plant, "advance", jam)
    jammed = episode.run()
    assert jammed.outcome == "jammed"
    assert jammed.jammed
    assert not jammed.broke
    assert jammed.rate_mm2_min == pytest.approx(60 * jammed.area_mm2 / (jammed.time_s + 60.0))


def test_losses_are_per_metre_of_all_cuts() -> None:
    results = [result(length=1.0), result(outcome="wire break", length=0.5), result(outcome="jammed", length=0.5)]
    figures = figures_of(results, [result(20.0)] * 3)
    assert figures["breaks_per_m"].value == pytest.approx(1 / 0.002)
    assert figures["jams_per_m"].value == pytest.approx(1 / 0.002)
    assert figures["oracle_share"].value == pytest.approx(0.5)
    assert set(figures) == set(FIGURES)


def test_no_loss_in_a_short_length_excludes_little() -> None:
    figures = figures_of([result(length=0.5)] * 2, [result()] * 2)
    assert figures["breaks_per_m"] == Figure(0.0, 0.0, pytest.approx(-math.log(0.05) / 0.001))


def test_bootstrap_intervals_have_the_width_of_theory() -> None:
    values = np.random.default_rng(1).normal(10.0, 2.0, 400)
    figure = ratio(values, np.ones(400))
    assert figure.value == pytest.approx(values.mean())
    assert figure.high - figure.low == pytest.approx(2 * 1.96 * values.std() / 20, rel=0.1)
    assert ratio(np.full(5, 3.0), np.ones(5)) == Figure(3.0, 3.0, 3.0)
    assert math.isnan(ratio(np.array([]), np.array([])).value)


def comparison(**rates_and_outcomes: tuple[float, str]) -> Comparison:
    results = {name: [result(rate, outcome)] * 2 for name, (rate, outcome) in rates_and_outcomes.items()}
    figures = {name: figures_of(found, results["oracle"]) for name, found in results.items()}
    return Comparison(GAP_FEED, "fast", (1, 2), results, figures)


def test_the_bar_is_told_whether_reached_or_missed() -> None:
    good = comparison(oracle=(20.0, "finished"), counts=(17.0, "finished"), fixed=(8.0, "wire break"))
    told = " ".join(bar(good))
    assert "`counts`, 85%: reached" in told
    assert "(fewer)" in told
    slow = comparison(oracle=(20.0, "finished"), counts=(14.0, "wire break"), fixed=(8.0, "finished"))
    told = " ".join(bar(slow))
    assert "70%: missed by 10%" in told
    assert "(more: missed)" in told
    level = comparison(oracle=(20.0, "finished"), counts=(17.0, "finished"), fixed=(8.0, "jammed"))
    told = " ".join(bar(level))
    assert "(as many: missed)" in told
    assert "cannot tell them apart" in told
    assert "(reached)" in told


def test_the_page_names_its_command_and_all_controllers(compared: Comparison) -> None:
    text = page([compared], "edmsim evaluate something")
    assert "`edmsim evaluate something`" in text
    for name in ("fixed", "voltage", "oracle"):
        assert f"| `{name}` |" in text
    assert "nan" not in text


def test_figures_are_shown_with_their_intervals() -> None:
    assert shown("rate_mm2_min", Figure(12.34, 10.0, 123.4)) == "12.3 (10.0 to 123)"
    assert shown("short_share", Figure(0.125, 0.1, 0.2)) == "12.5 % (10.0 to 20.0)"
    assert shown("error_um", Figure(math.nan, math.nan, math.nan)) == ""


@pytest.mark.parametrize(
    ("env_id", "controllers", "seeds", "resolution", "words"),
    [
        ("edmsim/Gap-v0", ["fixed"], 3, "fast", "no environment 'edmsim/Gap-v0'; choose one of edmsim/GapFeed-v0"),
        (GAP_FEED, ["pid"], 3, "fast", "no feed controller 'pid'"),
        (GAP_FEED, [], 3, "fast", "no controller is named"),
        (GAP_FEED, ["fixed"], 1, "fast", "1 seeds give no interval"),
        (GAP_FEED, ["fixed"], 3, "best", "best"),
    ],
)
def test_what_cannot_be_compared_is_refused(env_id, controllers, seeds, resolution, words) -> None:
    with pytest.raises(InputError) as refused:
        evaluate(env_id, controllers, seeds, resolution=resolution)
    assert words in str(refused.value)


def edmsim(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr(sys, "argv", ["edmsim", *map(str, arguments)])
    with pytest.raises(SystemExit) as left:
        cli.main()
    return left.value.code if isinstance(left.value.code, int) else 0


def test_the_command_prints_json_and_writes_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "benchmark.md"
    status = edmsim(monkeypatch, "evaluate", GAP_FEED, "--controllers", "fixed,counts", "--seeds", 2,
                    "--resolution", "fast", "--json", "--write", file)  # fmt: skip
    assert status == 0
    (told,) = json.loads(capsys.readouterr().out)
    assert told["env_id"] == GAP_FEED
    assert set(told["controllers"]) == {"fixed", "counts", "oracle"}
    assert told["controllers"]["fixed"]["error_um"]["value"] is None
    assert len(told["cuts"]) == 6
    assert "edmsim evaluate edmsim/GapFeed-v0 --controllers fixed,counts --seeds 2" in file.read_text()


def test_the_command_refuses_before_it_begins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert edmsim(monkeypatch, "evaluate", GAP_FEED, "--controllers", "pid") == 2
    assert capsys.readouterr().err.startswith("edmsim: there is no feed controller 'pid'")
    assert edmsim(monkeypatch, "evaluate", GAP_FEED, "--write", tmp_path / "no" / "page.md") == 2
    assert "cannot be written" in capsys.readouterr().err
