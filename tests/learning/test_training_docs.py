"""What docs/training.md shows runs as it stands there, and its scores are those of the policies."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "training.md").read_text(encoding="utf-8")
COMMANDS = [shlex.split(line) for line in re.findall(r"^(edmsim (?:train|cut) .*)$", PAGE, re.MULTILINE)]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::UserWarning", "ignore::DeprecationWarning")
def test_the_page_leads_to_a_part_that_was_cut(short, edmsim, tmp_path, monkeypatch):
    for name in ("stable_baselines3", "tensorboard"):
        pytest.importorskip(name)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    assert [words[1] for words in COMMANDS] == ["train", "cut", "cut"]
    for words in COMMANDS:
        less = ("--steps", 64, "--score", 2) if words[1] == "train" else ("--max-time", 1, "--resolution", "fast")
        status, _, err = edmsim(*words[1:], *less)
        assert status in (0, 3), err  # 3: stopped by the time limit added here
    assert (tmp_path / "out" / "punch" / "report.json").is_file()
    card = json.loads((tmp_path / "out" / "gap" / "policy.json").read_text())
    assert len(card["scores"]) == 6


def test_the_scores_are_those_of_the_policies():
    table = PAGE.split("<!-- scores -->")[1].split("<!-- /scores -->")[0]
    rows = [line for line in table.splitlines() if line.startswith("|")][2:]
    told = []
    for file in sorted((ROOT / "models" / "policies").glob("*.json")):
        scores = json.loads(file.read_text())["scores"]
        for policy, counts in zip(scores[::2], scores[1::2], strict=True):
            told.append(
                f"| `{file.stem}` | {policy['resolution']} "
                f"| {policy['mean_return']:.0f} ± {policy['return_error']:.0f} "
                f"| {counts['mean_return']:.0f} ± {counts['return_error']:.0f} | {policy['rate_mm2_min']:.1f} "
                f"| {counts['rate_mm2_min']:.1f} | {policy['breaks']}, {policy['limits']} "
                f"| {counts['breaks']}, {counts['limits']} |"
            )
    assert rows == told
