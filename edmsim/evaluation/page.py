"""An evaluation as a table on the screen, as JSON, and as the page ``docs/benchmark.md``."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from edmsim import __version__
from edmsim.evaluation.bars import ranked, told
from edmsim.evaluation.compare import FIGURES, Comparison, Figure
from edmsim.evaluation.episode import ORACLE_GAPS_UM

if TYPE_CHECKING:
    from rich.console import RenderableType

WIDE = 170
"""Columns of a terminal from which on the table shows intervals."""
_INTRODUCTION = """\
# Benchmark of feed controllers

Written by `{command}` (edmsim {version}); do not edit.

Every controller makes the same cuts: episodes of the environments in which every constant that has a published
range is drawn (`Machine.sample`), and heights and tension, from one held-back seed each
(`edmsim.evaluation.episode.ARGUMENTS`). The gains of the classic controllers were found on other seeds of GapFeed
and HeightStep by `edmsim search-gains`, for the return, at resolution `fast`; each file in
`models/gains/` names its command. `counts` keeps its documented constants: those a search finds for it (1014 in
place of 835 of return on the training seeds) hunt where windows last 0.25 s or the removal halves, which a machine's
default must not (`tests/controllers/test_feed_controllers.py`). In parentheses: 95 % bootstrap intervals over the
cuts; where no wire was lost, what that length of cut can exclude (Poisson). The feed is limited to 100 um/s.

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
_SHORT = {
    "rate_mm2_min": "mm2/min", "oracle_share": "of oracle", "short_share": "short", "open_share": "open",
    "total_return": "return", "error_um": "path um", "edge_error_um": "edge um", "time_s": "s",
    "breaks_per_m": "breaks/m", "jams_per_m": "jams/m",
}
"""Heads of the table on the screen."""
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


def render(comparison: Comparison, width: int) -> RenderableType:
    """Return the table for the screen, the fastest controller first; intervals where there is room for them."""
    from rich.table import Table

    table = Table(title=_title(comparison))
    table.add_column("controller", no_wrap=True)
    used = columns(comparison)
    for name in used:
        table.add_column(_SHORT[name], justify="right")
    for controller in ranked(comparison):
        cells = (shown(name, comparison.figures[controller][name]) for name in used)
        short = controller.removeprefix("policy:")
        table.add_row(short, *(cell.replace(" (", "\n(") if width >= WIDE else cell.split(" (")[0] for cell in cells))
    return table


def as_json(comparisons: Sequence[Comparison]) -> str:
    """Return everything as JSON: a list of environments; what was not measured is null."""
    return json.dumps([_plain(comparison) for comparison in comparisons], indent=2, allow_nan=False)


def _plain(comparison: Comparison) -> dict[str, Any]:
    return {
        "env_id": comparison.env_id,
        "resolution": comparison.resolution,
        "seeds": list(comparison.seeds),
        "edmsim_version": __version__,
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
    parts = [_INTRODUCTION.format(command=command, version=__version__, gaps=gaps)]
    for comparison in comparisons:
        parts += [f"## {comparison.env_id}", "", *markdown_table(comparison), "", *_spaced(told(comparison))]
    return "\n".join(parts)


def _spaced(paragraphs: Sequence[str]) -> list[str]:
    return [line for text in paragraphs for line in (text, "")]


def markdown_table(comparison: Comparison) -> list[str]:
    """Return the lines of the table in Markdown, the fastest controller first, with all intervals."""
    used = columns(comparison)
    lines = ["| controller | " + " | ".join(FIGURES[name] for name in used) + " |", "|---" * (len(used) + 1) + "|"]
    for controller in ranked(comparison):
        cells = (shown(name, comparison.figures[controller][name]) for name in used)
        lines.append(f"| `{controller}` | " + " | ".join(cells) + " |")
    lines += ["", f"{len(comparison.seeds)} cuts each, resolution `{comparison.resolution}`."]
    return lines
