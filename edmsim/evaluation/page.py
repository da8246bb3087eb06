"""An evaluation as a table on the screen, as JSON, and as the page ``docs/benchmark.md``."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from .compare import FIGURES, Comparison, Figure
from .episode import ORACLE, ORACLE_GAPS_UM

if TYPE_CHECKING:
    from rich.console import RenderableType

BAR_SHARE = 0.8
"""Share of the oracle's cutting rate that the best classic controller shall reach."""
BLIND = "fixed"
"""The controller that the best classic one shall break fewer wires than."""
_PERCENT = ("oracle_share", "short_share", "open_share")


def shown(name: str, figure: Figure) -> str:
    """Return a figure with its interval as text; empty where there is none."""
    if math.isnan(figure.value):
        return ""
    values = [100 * v if name in _PERCENT else v for v in (figure.value, figure.low, figure.high)]
    unit = " %" if name in _PERCENT else ""
    told = [f"{v:.0f}" if abs(v) >= 99.5 else f"{v:.1f}" for v in values]
    between = "" if math.isnan(figure.low) else f" ({told[1]} to {told[2]})"
    return f"{told[0]}{unit}{between}"


def columns(comparison: Comparison) -> list[str]:
    """Return the figures that the environment has."""
    return [
        name for name in FIGURES if any(not math.isnan(f[name].value) for f in comparison.figures.values())
    ]


def render(comparison: Comparison) -> RenderableType:
    """Return the table for the screen, the fastest controller first."""
    from rich.table import Table

    table = Table(title=_title(comparison))
    table.add_column("controller", no_wrap=True)
    used = columns(comparison)
    for name in used:
        table.add_column(FIGURES[name], justify="right")
    for controller in ranked(comparison):
        cells = (shown(name, comparison.figures[controller][name]) for name in used)
        table.add_row(controller, *(cell.replace(" (", "\n(") for cell in cells))
    return table


def ranked(comparison: Comparison) -> list[str]:
    """Return the controllers, the fastest first."""
    return sorted(comparison.figures, key=lambda name: -comparison.figures[name]["rate_mm2_min"].value)


def as_json(comparisons: Sequence[Comparison]) -> str:
    """Return everything as JSON: a list of environments; what was not measured is null."""
    return json.dumps([_plain(comparison) for comparison in comparisons], indent=2, allow_nan=False)


def _plain(comparison: Comparison) -> dict[str, Any]:
    return {
        "env_id": comparison.env_id,
        "resolution": comparison.resolution,
        "seeds": list(comparison.seeds),
        "edmsim_version": version("edmsim"),
        "controllers": {
            name: {key: {k: _number(v) for k, v in vars(figure).items()} for key, figure in figures.items()}
            for name, figures in comparison.figures.items()
        },
        "cuts": [
            {key: _number(value) for key, value in result._asdict().items()}
            for results in comparison.results.values() for result in results
        ],
    }  # fmt: skip


def _number(value: Any) -> Any:
    return None if isinstance(value, float) and math.isnan(value) else value


def _title(comparison: Comparison) -> str:
    return f"{comparison.env_id}, {len(comparison.seeds)} cuts each, resolution {comparison.resolution}"


def page(comparisons: Sequence[Comparison], command: str) -> str:
    """Return the page of the documentation.

    Parameters
    ----------
    comparisons : sequence of Comparison
    command : str
        The command that made it.
    """
    gaps = ", ".join(f"{gap:g}" for gap in ORACLE_GAPS_UM)
    parts = [
        "# Benchmark of feed controllers", "",
        f"Written by `{command}` (edmsim {version('edmsim')}); do not edit.", "",
        "Every controller makes the same cuts: machine constants drawn within their published ranges",
        "(`Machine.sample`), heights, tension and corner from one held-back seed each. Gains were found on other",
        "seeds by `python -m edmsim.evaluation.search` at resolution `fast`; each file in `models/gains/` names its",
        "command. `fixed` and `counts` keep their documented constants unless a file of gains stands there. In",
        "parentheses: 95 % bootstrap intervals over the cuts; where no wire was lost, what that length of cut can",
        "exclude (Poisson). The feed is limited to 100 um/s.", "",
        "- *Cutting rate*: length cut times local height over machine time; a lost wire costs the machine's time for",
        "  threading another, 60 s, and ends the cut.",
        "- *Jam*: the wire was driven into the metal beyond what the model holds for, or the controller gave up at a",
        "  short. A real wire would be lost as well, so jams count as lost wires beside breaks.",
        f"- *Oracle*: sees the true gap and wire temperature and rehearses each cut with gaps of {gaps} um, of which",
        "  the fastest counts. It only scales the others; it optimises the rate and nothing else.",
        "- *Profile error*: root mean square, of the cut edge at the contour (with whatever the offset is wrong for",
        "  the drawn machine), at the corner of the wire's true path within 0.3 mm of it.", "",
    ]  # fmt: skip
    for comparison in comparisons:
        parts += [f"## {comparison.env_id}", "", *_table(comparison), "", *bar(comparison), ""]
    return "\n".join(parts)


def _table(comparison: Comparison) -> list[str]:
    used = columns(comparison)
    lines = ["| controller | " + " | ".join(FIGURES[name] for name in used) + " |", "|---" * (len(used) + 1) + "|"]
    for controller in ranked(comparison):
        cells = (shown(name, comparison.figures[controller][name]) for name in used)
        lines.append(f"| `{controller}` | " + " | ".join(cells) + " |")
    lines += ["", f"{len(comparison.seeds)} cuts each, resolution `{comparison.resolution}`."]
    return lines


def bar(comparison: Comparison) -> list[str]:
    """Say whether the best classic controller reaches the bar, and by how much not.

    The best is the one with the fewest lost wires of those that reach 80 % of the oracle's rate, the faster of
    equals; if none does, the fastest.
    """
    classic = [name for name in ranked(comparison) if name not in (ORACLE, BLIND)]
    if not classic or BLIND not in comparison.figures:
        return ["The bar needs `fixed` and a classic controller: not compared here."]

    def share(name: str) -> float:
        return comparison.figures[name]["oracle_share"].value

    def lost(name: str) -> float:
        figures = comparison.figures[name]
        return figures["breaks_per_m"].value + figures["jams_per_m"].value

    able = [name for name in classic if share(name) >= BAR_SHARE]
    best = min(able, key=lost) if able else classic[0]
    broken, blind = (comparison.figures[name]["breaks_per_m"].value for name in (best, BLIND))
    outcome = "reached" if share(best) >= BAR_SHARE else f"missed by {BAR_SHARE - share(best):.0%}"
    lines = [
        f"Bar: at least {BAR_SHARE:.0%} of the oracle's rate with fewer wire breaks than `{BLIND}`. Best classic "
        f"controller: `{best}`, {share(best):.0%}: {outcome}."
    ]
    fewer = "fewer" if broken < blind else "as many" if broken == blind else "more"
    lines.append(
        f"Its breaks per metre: {broken:.1f} against {blind:.1f} ({fewer}"
        f"{'' if fewer == 'fewer' else ': missed'}); with jams {lost(best):.1f} against {lost(BLIND):.1f} "
        f"({'reached' if lost(best) < lost(BLIND) else 'missed'})."
    )
    if broken == blind == 0:
        lines.append(f"Neither broke a wire in these cuts, so breaks alone cannot tell them apart; `{BLIND}` loses "
                     "wires by driving them into the metal where it cuts faster than the machine removes.")
    return lines
