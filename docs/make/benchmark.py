"""``docs/benchmark.md``: controllers and policies compared, and whether anything is left to be learned.

python docs/make/benchmark.py                     # the page of docs/leaderboard.json
python docs/make/benchmark.py all                 # makes every cut again, writes the leaderboard, then the page
python docs/make/benchmark.py edmsim/Corner-v2    # cuts one environment again
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from edmsim.errors import EdmsimError
from edmsim.evaluation import leaderboard
from edmsim.evaluation.compare import Comparison, env_ids, evaluate
from edmsim.evaluation.lines import ORACLE_GAPS_UM, USUAL, lines_of
from edmsim.evaluation.table import markdown_table, ranked, shown

BOARD, PAGE = (Path(__file__).parents[1] / name for name in ("leaderboard.json", "benchmark.md"))
INTRODUCTION = """\
# Benchmark of feed controllers

Each table below compares controllers on the cuts of one environment. This command makes such a table of two
controllers on four machines; name your own in their place:

```sh
edmsim evaluate edmsim/GapFeed-v2 --controllers counts,voltage --seeds 4
```

`edmsim evaluate edmsim/GapFeed-v2` without options makes the whole table; `--page compared.md` writes it as a page
with a figure, for as many controllers and policies as are named. All controllers cut the same machines and
workpieces, which are drawn as the [environment](environments.md) says, from seeds that are held back: no gain was
searched on them.

Look at the *score* first. A score of 0 is what `fixed` earns, which feeds at one speed and looks at nothing; 1 is
what the oracle earns, which sees the true gap. Values in parentheses are 95 % bootstrap intervals over the cuts.

- *Score*: (return - return of `fixed`) / (return of the oracle - return of `fixed`), machine by machine. The table
  shows the interquartile mean, which leaves out the best and the worst quarter of the machines. A single lost wire
  therefore shows in the mean return, the cost and the breaks, but not in the score.
- *Oracle*: the reference. It sees the true gap and wire temperature, and makes each cut with gaps of {gaps} um; the
  one that earns most counts. It chooses nothing but the feed.
- *Cutting rate*: length cut times local height over machine time. A lost wire costs the time to thread another one,
  60 s (MaxRate: 20 s), and ends the cut if there is no other.
- *Jam*: a short that stayed, a wire driven into the metal further than the model holds, or a controller that gave
  up at a short. On a real machine the wire would be lost, so that a jam costs as much as a break.
- *Wire breaks, jams*: "none (at most 419)" says that no wire broke, but that the cuts are too short to exclude up
  to 419 breaks per m (Poisson).
- *Return, cost*: the sums of the environment's rewards and costs ([environments](environments.md)).
- *Path error*: root mean square of the distance from the path to the wire's true place, over the length cut; in
  Corner over the length within 100 um of the corner; in Trim of the finished wall's distance from its place.
- *Edge error*: the same for the distance from the contour to the cut edge. It contains the error of an offset that
  is wrong for the drawn machine.

Five environments have other references. In Corner a score of 0 is the constant setting that earned most on 12
training machines, in Trim the constant feed and offset that did on 12, and in ThinWire the fastest constant setting
that broke no wire of 24 (`python docs/make/lines.py` makes these cuts). The oracle of the latter two makes each
cut several times and keeps the best: in Trim with twelve pairs of feed and offset, in ThinWire with six periods. A
controller that finds out more within the cut may earn more than that. In Corner 1 is `lead-oracle`, which leads the
guides by the wire's true bend. In MaxRate `fixed-period` is 0, and 1 is `heat-oracle`, which sets the period by the
wire's true temperature. In MaxRateShift 0 is the best law of MaxRate, `heat-flux`, and 1 is `heat-oracle`; in
ThinWireShift 0 is the constant of ThinWire and 1 is `climb`, its best law: some of its wires break before they boil,
so that the true temperature is no bound. In Part 0 is what the technology has, and 1 is `corrected`, a law without
any privilege; errors and Ra there are of the finished parts.

The gains of the classic controllers were found by `edmsim tune gains NAME --method evolution --out DIR` on other
seeds of GapFeed and HeightStep, for the return, the feed of `fixed` by `python docs/make/lines.py`; each file in
`models/gains/` names its command.
`counts` keeps its documented constants. A search finds others that earn more, but with them the feed oscillates where
windows last 0.25 s or the removal halves, and a machine's default must not do that
(`tests/controllers/test_feed_controllers.py`).
"""
CLOSING = """\
---

`python docs/make/benchmark.py` writes this page from `docs/leaderboard.json`, which holds every cut, and
`python docs/make/benchmark.py all` makes both again.
"""
NEARLY_ALL = 0.95
"""Score of a constant set-point from which on little can be gained by a better law."""


def page(comparisons: Sequence[Comparison]) -> str:
    """Return the page of the documentation."""
    gaps = ", ".join(f"{gap:g}" for gap in ORACLE_GAPS_UM)
    parts = [INTRODUCTION.format(gaps=gaps), *headroom(comparisons), ""]
    for comparison in comparisons:
        parts += [f"## {comparison.env_id}", "", *markdown_table(comparison), ""]
        parts += [line for text in verdicts(comparison) for line in (text, "")]
    return "\n".join([*parts, CLOSING])


def headroom(comparisons: Sequence[Comparison]) -> list[str]:
    """Return a table of what a constant, the best law and the reference earn in every environment."""
    heads = "environment", "constant, score 0", "best law", "its score", "reference, score 1", "wires lost, jams"
    rows = ["## What is left to be learned", "", f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for comparison in comparisons:
        lines, best = lines_of(comparison.env_id), _best_law(comparison)
        compared = (lines.blind, best or lines.blind, lines.reference)
        returns = [shown("total_return", comparison.figures[name]["total_return"]) for name in compared]
        lost = "; ".join(
            f"{sum(cut.wires_lost for cut in comparison.results[name])}, "
            f"{sum(cut.jammed for cut in comparison.results[name])}"
            for name in compared
        )
        score = shown("score", comparison.figures[compared[1]]["score"])
        rows.append(f"| {comparison.env_id} | {returns[0]} | {returns[1]} | {score} | {returns[2]} | {lost} |")
    return [*rows, "", "Mean returns; wires lost and jams of the three, in this order."]


def _best_law(comparison: Comparison) -> str | None:
    """Return the classic controller of the best score, apart from the lines."""
    lines = lines_of(comparison.env_id)
    ends = lines.blind, lines.reference
    return next((name for name in ranked(comparison) if name not in ends and not _is_policy(name)), None)


def verdicts(comparison: Comparison) -> list[str]:
    """Return a paragraph on the best classic controller, and one for every policy."""
    figures, best = comparison.figures, _best_law(comparison)
    if best is None:
        return []
    score = figures[best]["score"]
    text = f"The best classic controller, `{best}`, scores {shown('score', score)}."
    if score.high - score.low > 1.0:
        text += " So few cuts of so different machines tell little."
    elif score.value >= NEARLY_ALL and best.startswith("adaptive-hold"):
        text += " A law that finds out what the machine bears comes as far as the reference here."
    elif score.value >= NEARLY_ALL and lines_of(comparison.env_id) is not USUAL:
        text += " A constant setting reaches the reference here, which chooses among constants and longer pauses."
    elif score.value >= NEARLY_ALL:
        text += (
            " A servo with a constant set-point already comes as far as the reference here, which chooses nothing "
            "but the feed, so little can be gained by a better feed law."
        )
    return [text, *(_of_policy(comparison, name, best) for name in figures if _is_policy(name))]


def _is_policy(name: str) -> bool:
    return name.startswith("policy:")


def _of_policy(comparison: Comparison, policy: str, best: str) -> str:
    own, other = (comparison.figures[name]["score"] for name in (policy, best))
    verdict = "no more and no less for certain"
    if own.low > other.high or own.high < other.low:
        verdict = "more" if own.low > other.high else "less"
    return f"`{policy}` scores {shown('score', own)}, {verdict} than `{best}`."


def main() -> None:
    """Compare, and write the page."""
    parser = argparse.ArgumentParser(description="Write a page of the benchmark.")
    parser.add_argument("env_ids", nargs="*", metavar="ENV_ID", help="environments to cut again, or all")
    requested = parser.parse_args().env_ids
    try:
        for env_id in env_ids() if requested == ["all"] else requested:
            leaderboard.write(BOARD, [evaluate(env_id)])
        board = leaderboard.read(BOARD)
    except EdmsimError as error:
        parser.error(str(error))
    PAGE.write_text(page([board[env_id] for env_id in env_ids() if env_id in board]), encoding="utf-8")


if __name__ == "__main__":
    main()
