"""What a sweep says: effects of known size are found, fronts are fronts, and the command shows them."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from edmsim.cli import app as cli
from edmsim.sweep.summary import effect, effects, front_of, groups, pareto_front
from edmsim.sweep.table import as_table, read


@pytest.fixture
def table() -> object:
    """A table whose rate is twice the height and one for the controller, and in which one run failed."""
    noise = np.random.default_rng(0).normal(0.0, 0.01, (2, 3, 20))
    rows = [
        {"id": f"{k}-{height}-{seed}", "task": "a.ngc", "seed": seed, "machine_sample": None, "height_mm": height,
         "controller": controller, "error": None, "outcome": "finished", "ra_um": 1.0 + k,
         "cutting_rate_mm2_min": 2.0 * height + k + noise[k, height, seed], "error_rms_um": None,
         "short_share": 0.1, "total_return": None}
        for k, controller in enumerate(["counts", "voltage"]) for height in range(3) for seed in range(20)
    ]  # fmt: skip
    rows[5] |= {"error": "it went wrong", "outcome": None, "cutting_rate_mm2_min": None, "ra_um": None}
    return as_table(rows)


def test_means_count_failures_and_leave_them_out(table: object) -> None:
    found = groups(table)
    assert [list(group.settings.values()) for group in found[:2]] == [[0.0, "counts"], [0.0, "voltage"]]
    assert (found[0].runs, found[0].failed, found[0].finished) == (20, 1, 19)
    rate = found[5].figures["cutting_rate_mm2_min"]
    assert rate.low < rate.value < rate.high
    assert rate.value == pytest.approx(5.0, abs=0.01)


def test_effects_are_shares_of_the_variance(table: object) -> None:
    found = effects(table)
    assert list(found) == ["controller", "height_mm"]  # Ra follows the controller alone
    # the variances of 2 * {0, 1, 2} and of {0, 1} are 8/3 and 1/4
    assert found["height_mm"]["cutting_rate_mm2_min"].share == pytest.approx(8 / 3 / (8 / 3 + 0.25), abs=0.01)
    assert found["controller"]["cutting_rate_mm2_min"].share == pytest.approx(0.25 / (8 / 3 + 0.25), abs=0.015)
    assert found["height_mm"]["cutting_rate_mm2_min"].rank_correlation > 0.9
    assert np.isnan(found["controller"]["cutting_rate_mm2_min"].rank_correlation)
    assert np.isnan(found["height_mm"]["short_share"].share)  # it never changes


def test_chance_is_no_effect() -> None:
    rng = np.random.default_rng(1)
    shares = [effect(list(rng.integers(0, 4, 40)), rng.normal(size=40)).share for _ in range(200)]
    assert np.mean(shares) < 0.03
    smooth = rng.random(400)
    assert effect(list(smooth), smooth**3).share > 0.9  # of many values, in groups
    assert effect(list(smooth), smooth**3).rank_correlation == pytest.approx(1.0)


def test_the_front_is_what_nothing_surpasses(table: object) -> None:
    points = np.array([[1.0, 5.0], [2.0, 4.0], [1.5, 4.0], [2.0, 4.0], [0.0, 6.0]])
    assert pareto_front(points).tolist() == [True, True, False, True, True]
    found, front = front_of(table)
    best = {(g.settings["height_mm"], g.settings["controller"]) for g, on in zip(found, front, strict=True) if on}
    assert best == {(2.0, "counts"), (2.0, "voltage")}


def command(*words: object, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr(sys, "argv", ["edmsim", *map(str, words)])
    with pytest.raises(SystemExit) as left:
        cli.main()
    return int(left.value.code or 0)


def test_the_command_sweeps_shows_and_goes_on(
    line: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ("sweep", line, "--height", "5,8", "--t-on", "30,60", "--max-time=1", "--resolution", "fast", "--offset",
             "none", "--out", "o", "--processes", 1)  # fmt: skip
    assert command(*words, monkeypatch=monkeypatch) == 3  # some failed
    told = capsys.readouterr()
    assert "4 runs, 4 made now, 2 failed." in told.out
    assert "4/4" in told.err
    assert command(*words, monkeypatch=monkeypatch) == 3
    assert "4 runs, 0 made now, 2 failed." in capsys.readouterr().out
    assert command("sweep", "--show", "o", monkeypatch=monkeypatch) == 0
    shown = capsys.readouterr().out
    assert "4 runs, 2 failed" in shown
    assert "2 failed: t_on 60 us in t_period 100 us" in shown
    assert "height_mm" in shown
    with Image.open("o/pareto.png") as picture:
        assert picture.size[0] == 700
    assert len(read("o")) == 4


@pytest.mark.parametrize(("words", "named"), [
    (("line.ngc",), "--out DIR"), (("line.ngc", "--out", "o", "5"), "--height 5,10,20"),
    (("line.ngc", "--out", "o", "--height"), "--height has no values"),
    (("none.toml", "--out", "o"), "none.toml: cannot be read"), (("--show", "o"), "no result"),
    (("--show", "o", "line.ngc"), "takes no specification"), (("line.ngc", "--out", "o", "--colour", "1"), "colour"),
    (("line.ngc", "--out", "o", "--processes", "0"), "1 or more"),
    (("line.ngc", "--out", "o", "--processes", "1", "--ray", "auto"), "leave them out"),
    (("edmsim/Pond-v0", "--out", "o"), "edmsim/Pond-v0"),
])  # fmt: skip
def test_bad_usage_is_one_line(
    line: Path, words: tuple[str, ...], named: str, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(line.parent)
    assert command("sweep", *words, monkeypatch=monkeypatch) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.count("\n") == 1
    assert named in told.err
    assert not Path("o").exists()
