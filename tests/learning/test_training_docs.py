"""The scores that docs/training.md tells are those of the policies."""

from __future__ import annotations

import json
from pathlib import Path

from edmsim.learning.score import RESOLUTIONS, RIVALS

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "training.md").read_text(encoding="utf-8")


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


if __name__ == "__main__":  # writes the table again
    shipped = sorted((ROOT / "models" / "policies").glob("*.json"))
    lines = [row for file in shipped for row in score_rows(file.stem, json.loads(file.read_text())["scores"])]
    before, rest = PAGE.split("<!-- scores -->")
    head = rest.split("<!-- /scores -->")[0].strip().splitlines()[:2]
    after = rest.split("<!-- /scores -->")[1]
    text = f"{before}<!-- scores -->\n" + "\n".join([*head, *lines]) + f"\n<!-- /scores -->{after}"
    (ROOT / "docs" / "training.md").write_text(text, encoding="utf-8")
