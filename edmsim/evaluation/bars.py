"""The bars that classic controllers and policies are held to, and by how much each is reached or missed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edmsim.evaluation.compare import Comparison, Figure, ratio
from edmsim.evaluation.episode import ORACLE
from edmsim.learning.policy_file import shipped

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
    " Why: the error is the lead of the wire, which the field pulls into the corner. Where the wire hardly leads, in "
    "thin work cut fast, the policy's long pulses gain nothing."
)
"""Why a bar was missed by the policies that are shipped: to be written anew with others."""


def told(comparison: Comparison) -> list[str]:
    """Return a paragraph for every bar of the environment."""
    policies = [name for name in comparison.results if name.startswith("policy:")]
    of = _OF_POLICIES.get(comparison.env_id)
    return [_classic(comparison), *(of(comparison, policy) for policy in policies if of is not None)]


def ranked(comparison: Comparison, by: str = "rate_mm2_min") -> list[str]:
    """Return the controllers, that with most of a figure first."""
    return sorted(comparison.figures, key=lambda name: -comparison.figures[name][by].value)


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
    return reason if missed and policy.removeprefix("policy:") in shipped(comparison.env_id) else ""


_OF_POLICIES = {
    "edmsim/GapFeed-v0": _learning, "edmsim/HeightStep-v0": _learning, "edmsim/Corner-v0": _corner,
}  # fmt: skip


def _values(comparison: Comparison, name: str, figure: str) -> NDArray[np.float64]:
    return np.array([getattr(result, figure) for result in comparison.results[name]])


def _percent(figure: Figure) -> str:
    return f"{figure.value:.0%} ({figure.low:.0%} to {figure.high:.0%})"
