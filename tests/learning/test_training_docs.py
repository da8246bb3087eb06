"""What docs/training.md shows runs as it stands there, and its scores are those of the policies."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest

from edmsim.learning.score import RESOLUTIONS, RIVALS

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
    assert len(card["scores"]) == 9


def test_the_scores_are_those_of_the_policies():
    table = PAGE.split("<!-- scores -->")[1].split("<!-- /scores -->")[0]
    rows = [line for line in table.splitlines() if line.startswith("|")][2:]
    files = sorted((ROOT / "models" / "policies").glob("*.json"))
    assert rows == [row for file in files for row in score_rows(file.stem, json.loads(file.read_text())["scores"])]


def score_rows(name, scores):
    """Rows of the table: a policy at one resolution, and its rivals there."""
    for resolution in RESOLUTIONS:
        here = {row["controller"]: row for row in scores if row["resolution"] == resolution}
        policy = here["policy"]
        made = policy, *map(here.get, RIVALS)
        returns = [f"{row['mean_return']:.0f} ± {row['return_error']:.0f}" for row in made]
        pair = policy, here[RIVALS[0]]
        errors = ["" if row["error_um"] is None else f"{row['error_um']:.2f}" for row in pair]
        cells = [f"{policy['rate_mm2_min']:.1f}", *errors, f"{policy['breaks']}, {policy['limits']}"]
        yield f"| `{name}` | {resolution} | " + " | ".join([*returns, *cells]) + " |"


if __name__ == "__main__":  # writes the table anew
    shipped = sorted((ROOT / "models" / "policies").glob("*.json"))
    lines = [row for file in shipped for row in score_rows(file.stem, json.loads(file.read_text())["scores"])]
    before, rest = PAGE.split("<!-- scores -->")
    head = rest.split("<!-- /scores -->")[0].strip().splitlines()[:2]
    after = rest.split("<!-- /scores -->")[1]
    text = f"{before}<!-- scores -->\n" + "\n".join([*head, *lines]) + f"\n<!-- /scores -->{after}"
    (ROOT / "docs" / "training.md").write_text(text, encoding="utf-8")
