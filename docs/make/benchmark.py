"""``docs/benchmark.md``: comparison of controllers and policies, with the headroom of learning.

python docs/make/benchmark.py                     # the page of docs/leaderboard.jsonl
python docs/make/benchmark.py all                 # makes every cut again, writes the leaderboard, then the page
python docs/make/benchmark.py edmsim/Corner-v3    # cuts one environment again
"""

import argparse
from collections.abc import Sequence

from sections import DOCS, table

from edmsim.envs.registry import registered_ids
from edmsim.errors import EdmsimError
from edmsim.evaluation.compare import CUT_TEXTS, Comparison, evaluate, leaderboard, markdown_table, ranked, shown
from edmsim.evaluation.episode import ORACLE_GAPS_UM, USUAL, lines_of
from edmsim.runs import RunTable

BOARD, PAGE = DOCS / "leaderboard.jsonl", DOCS / "benchmark.md"
INTRODUCTION = """\
# Benchmark of feed controllers

```sh
edmsim evaluate edmsim/GapFeed-v2 --controllers counts,voltage --seeds 4
```

This command compares two controllers on four machines. Without options, `edmsim evaluate edmsim/GapFeed-v2` makes the
whole table of this page; `--page compared.md` writes a page with a figure. All controllers cut the same machines and
workpieces, drawn as the [environment](environments.md) says, from held-back seeds, which no search used. With
`--page FILE` or `--leaderboard FILE` finished cuts are saved: after Ctrl-C or a kill the same command resumes. A
leaderboard is a table of cuts, to which further comparisons add theirs.

Look at the *score* first. It is 0 for the return of one controller and 1 for that of another:

| environment | score 0 | score 1, the reference |
|---|---|---|
| GapFeed, HeightStep, Contour | `fixed`, a constant feed | `oracle` |
| Corner | constant setting that earned most on 48 machines | `lead-oracle`, which knows the wire's true bend |
| MaxRate | a period of 40 us, which broke no wire of 24 | `heat-oracle`, which knows the wire's true temperature |
| ThinWire | fastest constant setting that broke no wire of 24 | the best of six periods for each machine |
| Trim | constant feed and offset that earned most on 48 | the best of twelve such pairs for each machine |
| Part | the technology | `corrected`, a law without privileged knowledge |
| MaxRateShift | `heat-flux`, the best law of MaxRate | `adaptive-hold`, a law without privileged knowledge |
| ThinWireShift | the constant of ThinWire | `climb`, its best law |

`oracle` sees the true gap and wire temperature, and sets only the feed. It makes each cut with gaps of {gaps}
um, and the cut with the highest return counts. The constants were chosen on training machines
(`python docs/make/lines.py` makes these cuts). In Trim and ThinWire a controller that learns more within the cut may
earn more than the reference. In the shifts no reference knows the wire's temperature, because some wires break before
they boil.

Values in parentheses are 95 % intervals over the cuts. The columns are

- *Score*: (return - return at 0) / (return at 1 - return at 0), machine by machine. The table shows the interquartile
  mean, which leaves out the best and the worst quarter of the machines. So a single lost wire shows in the mean
  return, the cost and the breaks, but not in the score.
- *Cutting rate*: length cut times local height over machine time. A lost wire costs the time to thread another
  one, 60 s (MaxRate: 20 s), and ends the cut if there is no other. The next column divides it by the reference's.
- *Wire breaks, jams*: a jam is a persistent short, a wire driven into the metal beyond the range of the model, or a
  controller that gave up at a short. It costs as much as a break, because on a real machine the wire would be lost.
  "None (at most 419)" means that no wire broke, but that the cuts are too short to exclude up to 419 breaks per m
  (Poisson).
- *Return, cost*: the sums of the environment's rewards and costs ([environments](environments.md#reward)).
- *Path error*: root mean square of the distance from the path to the wire's true position, over the length cut;
  in Corner over the length within 100 um of the corner; in Trim of the finished wall's distance from its target.
- *Edge error*: the same for the distance from the contour to the cut edge. It includes the error of an offset
  that is wrong for the drawn machine. In Part it is that of the finished parts, and so is Ra.

The laws have gains that `python docs/make/gains.py NAME` found on other seeds of GapFeed and HeightStep, for the
return (those of `oracle` for the rate); each file in `models/gains/` names its command. `counts` has its documented
constants. A search finds others that earn more, but with them the feed oscillates in windows of 0.25 s or at half the
removal, which a machine's default must not do (`tests/controllers/test_feed_controllers.py`).
"""
CLOSING = """\
---

`python docs/make/benchmark.py` writes this page from `docs/leaderboard.jsonl`, which holds every cut, and
`python docs/make/benchmark.py all` makes both again.
"""
NEARLY_ALL = 0.95
"""Score of a constant set-point above which a better law can gain little."""


def page(comparisons: Sequence[Comparison]) -> str:
    """Return the page of the documentation."""
    gaps = ", ".join(f"{gap:g}" for gap in ORACLE_GAPS_UM)
    parts = [INTRODUCTION.format(gaps=gaps), *headroom(comparisons), ""]
    for comparison in comparisons:
        parts += [f"## {comparison.env_id}", "", *markdown_table(comparison), ""]
        parts += [line for text in verdicts(comparison) for line in (text, "")]
    return "\n".join([*parts, CLOSING])


def headroom(comparisons: Sequence[Comparison]) -> list[str]:
    """Return a table of the returns of a constant, the best law and the reference in every environment."""
    rows = []
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
        rows.append((comparison.env_id, returns[0], returns[1], score, returns[2], lost))
    heads = "environment", "constant, score 0", "best law", "its score", "reference, score 1", "wires lost, jams"
    return [
        "## Constants, laws and references", "", table(heads, rows), "",
        "Mean returns; wires lost and jams of the three, in this order.",
    ]  # fmt: skip


def _best_law(comparison: Comparison) -> str | None:
    """Return the classic controller with the best score, except the constant and those that see the true gap."""
    blind = lines_of(comparison.env_id).blind
    honest = (name for name in ranked(comparison) if "oracle" not in name and not _is_policy(name))
    return next((name for name in honest if name != blind), None)


def verdicts(comparison: Comparison) -> list[str]:
    """Return a paragraph on the best classic controller, and one for every policy."""
    figures, best = comparison.figures, _best_law(comparison)
    if best is None:
        return []
    score, reference = figures[best]["score"], lines_of(comparison.env_id).reference
    does = "is the reference" if best == reference else f"scores {shown('score', score)}"
    text = f"The best classic controller, `{best}`, {does}."
    if best == reference:
        pass
    elif score.high - score.low > 1.0:
        text += " These are too few cuts for such different machines."
    elif score.value >= NEARLY_ALL and lines_of(comparison.env_id).blind != USUAL.blind:
        text += " So a constant setting reaches the reference, which chooses among constants and longer pauses."
    elif score.value >= NEARLY_ALL:
        text += (
            " So a servo with a constant set-point reaches the reference, which sets only the feed: a better feed "
            "law would gain little."
        )
    return [text, *(_of_policy(comparison, name, best) for name in figures if _is_policy(name))]


def _is_policy(name: str) -> bool:
    return name.startswith("policy:")


def _of_policy(comparison: Comparison, policy: str, best: str) -> str:
    own, other = (comparison.figures[name]["score"] for name in (policy, best))
    verdict = "not significantly different from"
    if own.low > other.high or own.high < other.low:
        verdict = "more than" if own.low > other.high else "less than"
    return f"`{policy}` scores {shown('score', own)}, {verdict} `{best}`."


def main() -> None:
    """Compare, and write the page."""
    parser = argparse.ArgumentParser(description="Write a page of the benchmark.")
    parser.add_argument("env_ids", nargs="*", metavar="ENV_ID", help="environments to cut again, or all")
    requested = parser.parse_args().env_ids
    try:
        for env_id in registered_ids() if requested == ["all"] else requested:
            cuts = RunTable(BOARD, texts=CUT_TEXTS)
            cuts.keep([row for row in cuts.rows.values() if row["env_id"] != env_id])
            evaluate(env_id, table=cuts)
        board = leaderboard(BOARD)
    except EdmsimError as error:
        parser.error(str(error))
    compared = [board[of] for env_id in registered_ids() for of in board if of[0] == env_id]
    PAGE.write_text(page(compared), encoding="utf-8")


if __name__ == "__main__":
    main()
