"""``docs/benchmark.md`` and its like: controllers and policies compared, and how far each is from its bar.

python docs/make/benchmark.py docs/benchmark.md edmsim/GapFeed-v0 edmsim/HeightStep-v0 edmsim/Corner-v0
"""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edmsim import __version__, models
from edmsim.envs.registry import resolve
from edmsim.errors import EdmsimError
from edmsim.evaluation.compare import Comparison, Figure, check, evaluate, ratio, usual
from edmsim.evaluation.episode import ORACLE, ORACLE_GAPS_UM
from edmsim.evaluation.table import markdown_table, ranked

INTRODUCTION = """\
# Benchmark of feed controllers

Written by `{command}` (edmsim {version}); do not edit.

Every controller makes the same cuts: episodes of the environments in which every constant that has a published range
is drawn (`Machine.sample`), and heights and tension, from one held-back seed each
(`edmsim.evaluation.episode.ARGUMENTS`). The gains of the classic controllers were found on other seeds of GapFeed
and HeightStep by `edmsim search-gains`, for the return, at resolution `fast`; each file in `models/gains/` names its
command. `counts` keeps its documented constants: those a search finds for it (389 in place of 367 of return on the
training seeds) hunt where windows last 0.25 s or the removal halves, which a machine's default must not
(`tests/controllers/test_feed_controllers.py`). In parentheses: 95 % bootstrap intervals over the cuts; where no
wire was lost, what that length of cut can exclude (Poisson). The planner `poscal` runs the path, so the feed is at
most 33.3 um/s.

- *Cutting rate*: length cut times local height over machine time; a lost wire costs the machine's time for
  threading another, 60 s, and ends the cut.
- *Jam*: a short that stayed, the wire driven into the metal beyond what the model holds for, or a controller that
  gave up at a short. A real wire would be lost as well, so jams count as lost wires beside breaks.
- *Oracle*: sees the true gap and wire temperature and rehearses each cut with gaps of {gaps} um, of which the
  fastest counts. It only scales the others; it optimises the rate and nothing else, so others may earn more return.
- *Return*: sum of the environment's rewards ([environments](environments.md)).
- *Path error*: root mean square, over the length cut, of the distance from the path to the wire's true place.
  *Edge error*: of the cut edge from the contour, with whatever the offset is wrong for the drawn machine.
"""
SHARE = 0.8
"""Share of the oracle's cutting rate that the best classic controller shall reach."""
BLIND = "fixed"
"""The controller that the best classic one shall break fewer wires than."""
GAIN = 1.1
"""Return of a policy over that of the classic controller that earns most."""
RIVAL = "counts"
ERROR, TIME = 0.5, 1.1
"""Path error at the corner and machine time of a policy, over those of `RIVAL`."""
WHY_LEARNING = (
    " Why: a feed is all there is to choose, and the search has put the classic references where they pay most; "
    "compare the return of the oracle, which sees the gap."
)
WHY_CORNER = (
    " Why: with gas the wire hardly leads or lags at a corner of this cut, so there is little error to take away; "
    "and the policy was trained for less than half of the steps that its learning file names."
)
"""Why a bar was missed by the policies that are shipped: other policies need other reasons."""


def page(comparisons: Sequence[Comparison], command: str) -> str:
    """Return the page of the documentation.

    Parameters
    ----------
    comparisons : sequence of Comparison
    command : str
        The command that made it.
    """
    gaps = ", ".join(f"{gap:g}" for gap in ORACLE_GAPS_UM)
    parts = [INTRODUCTION.format(command=command, version=__version__, gaps=gaps)]
    for comparison in comparisons:
        parts += [f"## {comparison.env_id}", "", *markdown_table(comparison), ""]
        parts += [line for text in bars(comparison) for line in (text, "")]
    return "\n".join(parts)


def bars(comparison: Comparison) -> list[str]:
    """Return a paragraph for every bar of the environment."""
    policies = [name for name in comparison.results if name.startswith("policy:")]
    of = _OF_POLICIES.get(comparison.env_id)
    return [_classic(comparison), *(of(comparison, policy) for policy in policies if of is not None)]


def _classics(comparison: Comparison, by: str) -> list[str]:
    return [name for name in ranked(comparison, by) if name != ORACLE and not name.startswith("policy:")]


def _classic(comparison: Comparison) -> str:
    """Judge the best classic controller: of those that reach the share, the one with the fewest lost wires."""
    classic = [name for name in _classics(comparison, "rate_mm2_min") if name != BLIND]
    if not classic or BLIND not in comparison.figures:
        return "The classic bar needs `fixed` and another classic controller: not compared here."
    figures = comparison.figures

    def share(name: str) -> float:
        return figures[name]["oracle_share"].value

    def lost(name: str) -> float:
        return figures[name]["breaks_per_m"].value + figures[name]["jams_per_m"].value

    able = [name for name in classic if share(name) >= SHARE]
    best = min(able, key=lost) if able else classic[0]
    outcome = "reached" if share(best) >= SHARE else f"missed by {SHARE - share(best):.0%}"
    broken, blind = (figures[name]["breaks_per_m"].value for name in (best, BLIND))
    verdict = "reached" if broken < blind else "missed"
    text = (
        f"Classic bar, at least {SHARE:.0%} of the oracle's rate with fewer wire breaks than `{BLIND}`: `{best}` has "
        f"{share(best):.0%} ({outcome}) and {broken:.1f} breaks per m against {blind:.1f} ({verdict}); with jams "
        f"{lost(best):.1f} against {lost(BLIND):.1f}."
    )
    if broken == blind == 0:
        text += " Neither broke a wire in these cuts, so breaks cannot tell them apart."
    return text


def _learning(comparison: Comparison, policy: str) -> str:
    best = _classics(comparison, "total_return")
    if not best:
        return "The learning bar needs a classic controller: not compared here."
    found = ratio(_values(comparison, policy, "total_return"), _values(comparison, best[0], "total_return"))
    outcome = "reached" if found.value >= GAIN else f"missed by {GAIN - found.value:.0%}"
    return (
        f"Learning bar, {GAIN - 1:.0%} more return than the best classic controller: `{policy}` has "
        f"{_percent(found)} of the return of `{best[0]}` ({outcome})."
        + _why(WHY_LEARNING, comparison, policy, found.value < GAIN)
    )


def _corner(comparison: Comparison, policy: str) -> str:
    if RIVAL not in comparison.results:
        return f"The corner bar needs `{RIVAL}`: not compared here."
    error, time = (
        ratio(_values(comparison, policy, name), _values(comparison, RIVAL, name)) for name in ("error_um", "time_s")
    )
    verdicts = [
        "reached" if found.value <= limit else f"missed by {found.value - limit:.0%}"
        for found, limit in ((error, ERROR), (time, TIME))
    ]
    return (
        f"Corner bar, {ERROR:.0%} of the path error of `{RIVAL}` in at most {TIME:.0%} of its time: `{policy}` has "
        f"{_percent(error)} of the error ({verdicts[0]}) in {_percent(time)} of the time ({verdicts[1]})."
        + _why(WHY_CORNER, comparison, policy, error.value > ERROR)
    )


def _why(reason: str, comparison: Comparison, policy: str, missed: bool) -> str:
    """Return the reason if it is known: of a shipped policy, not of anybody's."""
    return reason if missed and policy.removeprefix("policy:") in models.policies(comparison.env_id) else ""


_OF_POLICIES = {
    "edmsim/GapFeed-v0": _learning, "edmsim/HeightStep-v0": _learning, "edmsim/Corner-v0": _corner,
}  # fmt: skip


def _values(comparison: Comparison, name: str, figure: str) -> NDArray[np.float64]:
    return np.array([getattr(result, figure) for result in comparison.results[name]])


def _percent(figure: Figure) -> str:
    return f"{figure.value:.0%} ({figure.low:.0%} to {figure.high:.0%})"


def main() -> None:
    """Compare, and write the page."""
    parser = argparse.ArgumentParser(description="Write a page of the benchmark.")
    parser.add_argument("page", type=Path, help="file to write")
    parser.add_argument("env_ids", nargs="+", metavar="ENV_ID", help="environments")
    parser.add_argument("--controllers", metavar="A,B", help="feed controllers; all by default")
    parser.add_argument("--seeds", type=int, default=20, help="cuts of each controller")
    parser.add_argument("--resolution", default="default", help="fast, default or fine")
    asked = parser.parse_args()
    try:
        chosen = {
            env_id: usual(env_id) if asked.controllers is None else asked.controllers.split(",")
            for env_id in map(resolve, asked.env_ids)
        }
        for env_id, named in chosen.items():
            check(env_id, named, asked.seeds, asked.resolution)
    except EdmsimError as error:
        parser.error(str(error))
    asked.page.touch()
    found = [evaluate(env_id, named, asked.seeds, resolution=asked.resolution) for env_id, named in chosen.items()]
    command = shlex.join(["python", "docs/make/benchmark.py", *sys.argv[1:]])
    asked.page.write_text(page(found, command), encoding="utf-8")


if __name__ == "__main__":
    main()
