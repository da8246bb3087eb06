"""docs/benchmark.md: what each controller scores, under the command that found it."""

import math
import sys
from pathlib import Path

import pytest

from edmsim.envs.registry import env_id_of
from edmsim.evaluation.compare import Comparison, figures_of, leaderboard
from edmsim.evaluation.episode import Result

DOCS = Path(__file__).parents[2] / "docs"
SCRIPT = DOCS / "make" / "benchmark.py"
GAP_FEED = "edmsim/GapFeed-v2"


@pytest.fixture(scope="module")
def benchmark(load_script):
    return load_script(SCRIPT)


def result(rate=10.0, outcome="finished", error=math.nan, reward=100.0, time_s=60.0):
    lost = int(outcome == "wire break")
    return Result(0, "any", outcome, time_s, 1.0, 10.0, rate, reward, lost, 0.0, 0.1, 0.2, error, math.nan, 320.0)


def comparison(env_id=GAP_FEED, **results):
    made = {name.replace("_", ":"): [one, one] for name, one in results.items()}
    figures = {name: figures_of(found, made["oracle"], made["fixed"]) for name, found in made.items()}
    return Comparison(env_id, "fast", (1, 2), made, figures)


def test_it_is_reported_where_a_constant_set_point_reaches_the_reference(benchmark):
    made = {"oracle": result(reward=100.0), "fixed": result(reward=0.0), "counts": result(reward=60.0)}
    (text,) = benchmark.verdicts(comparison(**made))
    assert text == "The best classic controller, `counts`, scores 0.60 (0.60 to 0.60)."
    (text,) = benchmark.verdicts(comparison(**made, voltage=result(reward=97.0)))
    assert "`voltage`, scores 0.97" in text
    assert "So a servo with a constant set-point reaches the reference" in text


@pytest.mark.parametrize(
    ("reward", "verdict"), [(80.0, "more than"), (40.0, "less than"), (60.0, "not significantly different from")]
)
def test_a_policy_is_compared_with_the_best_classic_controller(benchmark, reward, verdict):
    made = {"oracle": result(reward=100.0), "fixed": result(reward=0.0), "counts": result(reward=60.0)}
    text = benchmark.verdicts(comparison(**made, policy_mine=result(reward=reward)))[1]
    assert text.startswith(f"`policy:mine` scores 0.{reward:.0f}")
    assert verdict in text


def test_one_command_makes_leaderboard_and_page(benchmark, tmp_path, monkeypatch):
    for name, file in (("BOARD", "board.json"), ("PAGE", "page.md")):
        monkeypatch.setattr(benchmark, name, tmp_path / file)
    made = comparison(oracle=result(reward=120.0), fixed=result(reward=10.0), voltage=result())

    def evaluate(env_id, table):
        for name, cuts in made.results.items():
            for seed, cut in enumerate(cuts):
                row = {**cut._asdict(), "controller": name, "seed": seed}
                table.add({"id": f"{name} {seed}", "env_id": env_id, "resolution": "fast", **row})

    monkeypatch.setattr(benchmark, "evaluate", evaluate)
    monkeypatch.setattr(sys, "argv", [str(SCRIPT), GAP_FEED])
    benchmark.main()
    text = (tmp_path / "page.md").read_text(encoding="utf-8")
    for name in ("fixed", "voltage", "oracle"):
        assert f"| `{name}` |" in text
    assert "nan" not in text
    (tmp_path / "page.md").unlink()
    monkeypatch.setattr(sys, "argv", [str(SCRIPT)])
    benchmark.main()
    assert (tmp_path / "page.md").read_text(encoding="utf-8") == text  # of the leaderboard alone


def test_an_environment_there_is_not_is_refused(benchmark, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(benchmark, "PAGE", tmp_path / "page.md")
    monkeypatch.setattr(sys, "argv", [str(SCRIPT), "edmsim/Lathe-v1"])
    with pytest.raises(SystemExit) as left:
        benchmark.main()
    assert left.value.code == 2
    assert "edmsim/Lathe-v1" in capsys.readouterr().err
    assert not (tmp_path / "page.md").exists()


NO_CURVE = {"Part"}
"""Tasks whose pages say that no learner has been trained on them for long."""


@pytest.mark.slow
def test_every_task_has_a_page_with_its_picture_lines_and_learning_curve(load_script):
    tasks = load_script(SCRIPT.parent / "tasks.py")
    board = leaderboard(DOCS / "leaderboard.jsonl")
    assert {(env_id_of(name), "fast") for name in tasks.PAGES} == set(board)
    for name, page in tasks.PAGES.items():
        text = (DOCS / "tasks" / f"{page}.md").read_text(encoding="utf-8")
        lines = tasks.lines(board[env_id_of(name), "fast"])
        assert f"<!-- begin lines -->\n\n{lines}\n\n<!-- end lines -->" in text, "run: python docs/make/tasks.py"
        assert f".{name}Env\n```" in text
        assert f"`{env_id_of(name)}`" in text or f" {env_id_of(name)}`" in text
        for picture in (f"{page}.png", *([] if name in NO_CURVE else [f"{page}-learning.png"])):
            assert f"]({picture})" in text
            assert (DOCS / "tasks" / picture).is_file()
