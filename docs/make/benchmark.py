"""``docs/benchmark.md``: controllers and policies compared, and whether anything is left to be learned.

python docs/make/benchmark.py                     # the page of docs/leaderboard.json
python docs/make/benchmark.py all                 # makes every cut again, writes the leaderboard, then the page
python docs/make/benchmark.py edmsim/Corner-v1    # cuts one environment again
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

Written by `python docs/make/benchmark.py` from `docs/leaderboard.json`, which has every cut; do not edit.
`python docs/make/benchmark.py all` makes both again.

`edmsim evaluate ID` without options makes the same cuts: every controller those of the id's held-back seeds, from
1,000,000 on, on machines drawn as the [environment](environments.md) says. Gains of the classic controllers were
found on other seeds, and for the return of the first versions of GapFeed and HeightStep, by `edmsim search-gains`;
each file in `models/gains/` names its command. `counts` keeps its documented constants: those a search
finds for it hunt where windows last 0.25 s or the removal halves, which a machine's default must not
(`tests/controllers/test_feed_controllers.py`). In parentheses: 95 % bootstrap intervals over the cuts. "None (at
most 419)" means that no wire broke, in so short a length of cut that up to 419 breaks per m cannot be excluded
(Poisson).

- *Score*: (return - return of `fixed`) / (return of the oracle - return of `fixed`), machine by machine; the
  interquartile mean of these. 0 is a feed that knows nothing, 1 the reference. It leaves out the best and the worst
  quarter, and with them single lost wires: these count in the mean return, the cost and the breaks beside it.
- *Oracle*, the reference: sees the true gap and wire temperature and rehearses each cut with gaps of {gaps} um, of
  which the one that earns most counts. It chooses nothing but the feed.
- Corner, ThinWire and MaxRate have lines of their own. In Corner a score of 0 is the constant setting of least
  error near the corner on 8 training machines, in ThinWire the fastest one that broke no wire of 24. The reference
  rehearses each cut with what can be set: how much longer the period is within 100 um of the corner, 1 to 3 times, or
  the period itself. It is no bound: a setting that changes within the cut may earn more. On MaxRate `fixed-period` is
  0 and `heat-oracle` 1, which sets the pulse period by the wire's true temperature.
- *Cutting rate*: length cut times local height over machine time; a lost wire costs the machine's time for
  threading another, 60 s (MaxRate: 20 s), and ends the cut where no other wire is left.
- *Jam*: a short that stayed, the wire driven into the metal beyond what the model holds for, or a controller that
  gave up at a short. A real wire would be lost as well, so jams cost what breaks do.
- *Return, cost*: sums of the environment's rewards and costs ([environments](environments.md)).
- *Path error*: root mean square, over the length cut, of the distance from the path to the wire's true place; in
  Corner over the length within 100 um of the corner.
  *Edge error*: of the cut edge from the contour, with whatever the offset is wrong for the drawn machine.
"""
NEARLY_ALL = 0.95
"""Score of a constant set-point from which on little can be gained by a better law."""


def page(comparisons: Sequence[Comparison]) -> str:
    """Return the page of the documentation."""
    gaps = ", ".join(f"{gap:g}" for gap in ORACLE_GAPS_UM)
    parts = [INTRODUCTION.format(gaps=gaps)]
    for comparison in comparisons:
        parts += [f"## {comparison.env_id}", "", *markdown_table(comparison), ""]
        parts += [line for text in verdicts(comparison) for line in (text, "")]
    return "\n".join(parts)


def verdicts(comparison: Comparison) -> list[str]:
    """Return a paragraph on the best classic controller, and one for every policy."""
    figures, lines = comparison.figures, lines_of(comparison.env_id)
    ends = lines.blind, lines.reference
    best = next((name for name in ranked(comparison) if name not in ends and not _is_policy(name)), None)
    if best is None:
        return []
    score = figures[best]["score"]
    text = f"The best classic controller, `{best}`, scores {shown('score', score)}."
    if score.high - score.low > 1.0:
        text += " So few cuts of so different machines tell little."
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
    given = parser.parse_args().env_ids
    try:
        for env_id in env_ids() if given == ["all"] else given:
            leaderboard.write(BOARD, [evaluate(env_id)])
        board = leaderboard.read(BOARD)
    except EdmsimError as error:
        parser.error(str(error))
    PAGE.write_text(page([board[env_id] for env_id in env_ids() if env_id in board]), encoding="utf-8")


if __name__ == "__main__":
    main()
