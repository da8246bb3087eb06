"""docs/benchmark.md: by how much the bars are reached or missed, under the command that found it."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from edmsim.evaluation import episode
from edmsim.evaluation.compare import Comparison, figures_of
from edmsim.evaluation.episode import Result

SCRIPT = Path(__file__).parents[2] / "docs" / "make" / "benchmark.py"
GAP_FEED, CORNER = "edmsim/GapFeed-v1", "edmsim/Corner-v1"


@pytest.fixture(scope="module")
def benchmark(load_script: Callable[[Path], ModuleType]) -> ModuleType:
    return load_script(SCRIPT)


def result(rate=10.0, outcome="finished", error=math.nan, earned=100.0, time_s=60.0) -> Result:
    return Result(0, "any", outcome, time_s, 1.0, 10.0, rate, earned, 0.1, 0.2, error, math.nan, 320.0)


def comparison(env_id: str = GAP_FEED, **results: Result) -> Comparison:
    made = {name.replace("_", ":"): [one, one] for name, one in results.items()}
    figures = {name: figures_of(found, made["oracle"]) for name, found in made.items()}
    return Comparison(env_id, "fast", (1, 2), made, figures)


def test_the_classic_bar_is_told_whether_reached_or_missed(benchmark: ModuleType) -> None:
    (text,) = benchmark.bars(comparison(oracle=result(20.0), counts=result(17.0), fixed=result(8.0, "wire break")))
    assert "`counts` has 85% (reached)" in text
    assert "against 1000.0 (reached)" in text
    (text,) = benchmark.bars(comparison(oracle=result(20.0), counts=result(14.0, "wire break"), fixed=result(8.0)))
    assert "70% (missed by 10%)" in text
    assert "against 0.0 (missed)" in text
    (text,) = benchmark.bars(comparison(oracle=result(20.0), counts=result(17.0), fixed=result(8.0, "jammed")))
    assert "cannot tell them apart" in text
    assert "with jams 0.0 against 1000.0" in text


def test_the_learning_bar_is_against_the_classic_that_earns_most(benchmark: ModuleType) -> None:
    made = comparison(
        oracle=result(20.0, earned=300.0), counts=result(17.0, earned=90.0), fixed=result(8.0, earned=100.0),
        policy_mine=result(9.0, earned=105.0),
    )  # fmt: skip
    assert "`policy:mine` has 105% (105% to 105%) of the return of `fixed` (missed by 5%)" in benchmark.bars(made)[1]


def test_the_corner_bar_is_of_error_and_time(benchmark: ModuleType) -> None:
    made = comparison(
        CORNER, oracle=result(20.0, error=1.0), counts=result(10.0, error=2.0, time_s=50.0), fixed=result(8.0),
        policy_mine=result(9.0, error=0.9, time_s=60.0),
    )  # fmt: skip
    text = benchmark.bars(made)[1]
    assert "45% (45% to 45%) of the error (reached) in 120% (120% to 120%) of the time (missed by 10%)" in text


def test_the_page_names_its_command_and_all_controllers(
    benchmark: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    short = {**episode.ARGUMENTS[GAP_FEED], "length_mm": 0.08}
    monkeypatch.setattr(episode, "ARGUMENTS", {**episode.ARGUMENTS, GAP_FEED: short})
    file = tmp_path / "benchmark.md"
    words = [str(file), GAP_FEED, "--controllers", "fixed,voltage", "--seeds", "2", "--resolution", "fast"]
    monkeypatch.setattr(sys, "argv", [str(SCRIPT), *words])
    benchmark.main()
    text = file.read_text(encoding="utf-8")
    assert f"`python docs/make/benchmark.py {' '.join(words)}`" in text
    for name in ("fixed", "voltage", "oracle"):
        assert f"| `{name}` |" in text
    assert "nan" not in text


def test_what_cannot_be_compared_is_refused_before_anything_is_written(
    benchmark: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "benchmark.md"
    monkeypatch.setattr(sys, "argv", [str(SCRIPT), str(file), GAP_FEED, "--controllers", "pid"])
    with pytest.raises(SystemExit) as left:
        benchmark.main()
    assert left.value.code == 2
    assert "no feed controller 'pid'" in capsys.readouterr().err
    assert not file.exists()
