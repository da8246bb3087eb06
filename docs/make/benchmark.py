"""``docs/benchmark.md``: controllers and policies compared, and whether anything is left to be learned.

python docs/make/benchmark.py docs/benchmark.md edmsim/GapFeed-v1 edmsim/HeightStep-v1 edmsim/Corner-v1 ...
"""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from edmsim import __version__
from edmsim.envs.registry import resolve
from edmsim.errors import EdmsimError
from edmsim.evaluation.compare import Comparison, check, evaluate, usual
from edmsim.evaluation.episode import ORACLE_GAPS_UM, episodes
from edmsim.evaluation.table import markdown_table, ranked, shown

INTRODUCTION = """\
# Benchmark of feed controllers

Written by `{command}` (edmsim {version}); do not edit.

`edmsim evaluate ID` without options makes the same cuts: every controller those of the id's held-back seeds, from
1,000,000 on, on machines drawn as the [environment](environments.md) says. Gains of the classic controllers were
found on other seeds, and for the return of the first versions of GapFeed and HeightStep, by `edmsim search-gains`;
each file in `models/gains/` names its command. `counts` keeps its documented constants: those a search
finds for it hunt where windows last 0.25 s or the removal halves, which a machine's default must not
(`tests/controllers/test_feed_controllers.py`). In parentheses: 95 % bootstrap intervals over the cuts; where no wire
was lost, what that length of cut can exclude (Poisson).

- *Score*: (return - return of `fixed`) / (return of the oracle - return of `fixed`), machine by machine; the
  interquartile mean of these. 0 is a feed that knows nothing, 1 the reference. It leaves out the best and the worst
  quarter, and with them single lost wires: these stand in the mean return, the cost and the breaks beside it.
- *Oracle*, the reference: sees the true gap and wire temperature and rehearses each cut with gaps of {gaps} um, of
  which the one that earns most counts. It chooses nothing but the feed.
- On MaxRate `fixed-period` is 0 and `heat-oracle` 1, which sets the pulse period by the wire's true temperature.
- *Cutting rate*: length cut times local height over machine time; a lost wire costs the machine's time for
  threading another, 60 s, and ends the cut; on MaxRate it costs 20 s, and the cut goes on.
- *Jam*: a short that stayed, the wire driven into the metal beyond what the model holds for, or a controller that
  gave up at a short. A real wire would be lost as well, so jams cost what breaks do.
- *Return, cost*: sums of the environment's rewards and costs ([environments](environments.md)).
- *Path error*: root mean square, over the length cut, of the distance from the path to the wire's true place.
  *Edge error*: of the cut edge from the contour, with whatever the offset is wrong for the drawn machine.
"""
NEARLY_ALL = 0.95
"""Score of a constant set-point from which on nothing worth the while is left to be learned."""


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
        parts += [line for text in verdicts(comparison) for line in (text, "")]
    return "\n".join(parts)


def verdicts(comparison: Comparison) -> list[str]:
    """Return a paragraph on the best classic controller, and one for every policy."""
    figures = comparison.figures
    best = next((name for name in ranked(comparison) if name not in comparison.scale and not _is_policy(name)), None)
    if best is None:
        return []
    score = figures[best]["score"]
    text = f"The best classic controller, `{best}`, scores {shown('score', score)}."
    if score.high - score.low > 1.0:
        text += " So few cuts of so different machines tell little."
    elif score.value >= NEARLY_ALL:
        text += (
            " A constant set-point under a servo reaches the reference here, which chooses nothing but the feed: of "
            "the feed nothing worth the while is left to be learned."
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
    parser.add_argument("page", type=Path, help="file to write")
    parser.add_argument("env_ids", nargs="+", metavar="ENV_ID", help="environments")
    parser.add_argument("--controllers", metavar="A,B", help="feed controllers; all by default")
    parser.add_argument("--seeds", type=int, help="cuts of each controller; those of the benchmark by default")
    parser.add_argument("--resolution", help="fast, default or fine; the environment's by default")
    asked = parser.parse_args()
    try:
        chosen = {
            env_id: usual(env_id) if asked.controllers is None else asked.controllers.split(",")
            for env_id in map(resolve, asked.env_ids)
        }
        for env_id, named in chosen.items():
            check(env_id, named, episodes(env_id) if asked.seeds is None else asked.seeds, asked.resolution)
    except EdmsimError as error:
        parser.error(str(error))
    asked.page.touch()
    found = [evaluate(env_id, named, asked.seeds, resolution=asked.resolution) for env_id, named in chosen.items()]
    command = shlex.join(["python", "docs/make/benchmark.py", *sys.argv[1:]])
    asked.page.write_text(page(found, command), encoding="utf-8")


if __name__ == "__main__":
    main()
