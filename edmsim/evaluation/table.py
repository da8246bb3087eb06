"""An evaluation as a table on the screen or in Markdown, as JSON, and as a page with figures."""

import json
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Group
from rich.text import Text

from edmsim import __version__
from edmsim.evaluation.compare import FIGURES, Comparison, Figure
from edmsim.evaluation.lines import lines_of
from edmsim.files import make_writable, replacing
from edmsim.recording.figures.palette import BLUE, MUTED
from edmsim.screen import ScreenTable
from edmsim.user_code import policy_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

WIDE = 170  # columns of a terminal from which on the table shows intervals
HEADS = {
    "score": "score", "rate_mm2_min": "mm2/min", "oracle_share": "of oracle", "short_share": "short",
    "open_share": "open", "total_return": "return", "error_um": "path um", "edge_error_um": "edge um",
    "ra_um": "Ra um", "time_s": "s", "breaks_per_m": "breaks/m", "jams_per_m": "jams/m", "cost": "cost",
}  # fmt: skip
"""What stands over a column on the screen."""
NARROW = {"score", "rate_mm2_min", "short_share", "open_share", "edge_error_um", "ra_um", "time_s"}
"""Figures that a narrow terminal shows."""
RARE = {"breaks_per_m", "jams_per_m"}  # figures of which 0 is common, and its interval hard to read


def shown(name: str, figure: Figure) -> str:
    """Return a figure with its interval as text; empty if the figure is None."""
    if math.isnan(figure.value):
        return ""
    kind = FIGURES[name]
    is_share = kind.unit == "%"
    values = [100 * v if is_share else v for v in (figure.value, figure.low, figure.high)]
    unit = " %" if is_share else ""
    texts = [f"{v:.0f}" if abs(v) >= 99.5 else f"{v:.{kind.digits}f}" for v in values]
    if name in RARE and figure.value == 0.0:
        return f"none (at most {texts[2]})"
    between = "" if math.isnan(figure.low) else f" ({texts[1]} to {texts[2]})"
    return f"{texts[0]}{unit}{between}"


def ranked(comparison: Comparison, by: str = "score") -> list[str]:
    """Return the controllers, that with most of a figure first."""
    return sorted(comparison.figures, key=lambda name: -np.nan_to_num(comparison.figures[name][by].value))


def columns(comparison: Comparison) -> list[str]:
    """Return the figures that the environment has."""
    return [name for name in FIGURES if any(not math.isnan(f[name].value) for f in comparison.figures.values())]


def render(comparison: Comparison, width: int) -> Group:
    """Return the table for the terminal, best controller first, and the meaning of its columns.

    A wide terminal shows every figure with its interval, a narrow one only the most important figures.
    """
    wide = width >= WIDE
    used = [name for name in columns(comparison) if wide or name in NARROW]
    heads = [HEADS[name] for name in used] + ([] if wide else ["breaks", "jams"])
    table = ScreenTable(
        "controller", numbers=heads, title=_title(comparison), box=None, padding=(0, 2, 0, 0), title_justify="left"
    )
    for controller in ranked(comparison):
        figures = comparison.figures[controller]
        cells = [shown(name, figures[name]) for name in used]
        if wide:
            cells = [cell.replace(" (", "\n(") for cell in cells]
        else:
            cells = [cell.split(" (")[0] for cell in cells] + _events(comparison, controller)
        table.add_row(policy_of(controller), *cells)
    return Group(table, Text(f"\n{_meaning(comparison, wide)}"))


def _events(comparison: Comparison, controller: str) -> list[str]:
    """Return how many wires a controller lost, and how many of its cuts jammed."""
    cuts = comparison.results[controller]
    return [str(sum(cut.wires_lost for cut in cuts)), str(sum(cut.jammed for cut in cuts))]


def _meaning(comparison: Comparison, wide: bool) -> str:
    lines = lines_of(comparison.env_id)
    text = (
        f"score: 0 is what {lines.blind} earns, and 1 what {lines.reference} earns, the reference. "
        "short, open: shares of the pulses that are shorts or do not ignite."
    )
    if wide:
        return text + " In parentheses: 95 % intervals over the cuts."
    cuts = len(comparison.seeds)
    return f"{text} breaks, jams: of all {cuts} cuts together. --json prints more figures, with 95 % intervals."


def as_json(comparisons: Sequence[Comparison], policies: Mapping[str, Sequence[Any]] | None = None) -> str:
    """Return environments, then policies, as JSON; unknown values are null."""
    found = [_plain(comparison) for comparison in comparisons]
    for name, rows in (policies or {}).items():
        found.append({"policy": name, "scores": [_known(row._asdict()) for row in rows]})
    return json.dumps(found, indent=2, allow_nan=False)


def _plain(comparison: Comparison) -> dict[str, Any]:
    return {
        "env_id": comparison.env_id,
        "resolution": comparison.resolution,
        "seeds": list(comparison.seeds),
        "edmsim_version": __version__,
        "controllers": {
            name: {key: _known(vars(figure)) for key, figure in figures.items()}
            for name, figures in comparison.figures.items()
        },
        "cuts": [_known(result._asdict()) for results in comparison.results.values() for result in results],
    }  # fmt: skip


def _known(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values with None for NaN."""
    return {name: None if isinstance(value, float) and math.isnan(value) else value for name, value in values.items()}


def _title(comparison: Comparison) -> str:
    return f"{comparison.env_id}, {len(comparison.seeds)} cuts each, resolution {comparison.resolution}"


def markdown_table(comparison: Comparison) -> list[str]:
    """Return the lines of the table in Markdown, the best controller first, with all intervals."""
    used = columns(comparison)
    heads = " | ".join(FIGURES[name].heading for name in used)
    lines = [f"| controller | {heads} |", "|---" * (len(used) + 1) + "|"]
    for controller in ranked(comparison):
        cells = (shown(name, comparison.figures[controller][name]) for name in used)
        lines.append(f"| `{controller}` | " + " | ".join(cells) + " |")
    lines += ["", f"{len(comparison.seeds)} cuts each, resolution `{comparison.resolution}`."]
    return lines


NAME_LETTERS = 48  # a controller of more letters is named without its parameters in a figure: the table has them


def write_page(file: Path, comparisons: Sequence[Comparison]) -> None:
    """Write the page, and its figures as ``NAME-ENVIRONMENT.png`` in the same folder; see `draw`."""
    make_writable(file.parent)
    parts = ["# Controllers compared", ""]
    for made in comparisons:
        name = f"{file.stem}-{re.sub(r'[^0-9A-Za-z]+', '-', made.env_id.rpartition('/')[2])}.png"
        with replacing(file.with_name(name)) as partial:
            draw_returns(made).savefig(partial, format="png", dpi=110)
        lines = lines_of(made.env_id)
        parts += [
            f"## {made.env_id}", "", f"![Return of every cut, and the mean of each controller]({name})", "",
            "*Returns of the same machines under all controllers: a dot for each machine; the line is the mean with "
            "its 95 % interval.*", "", *markdown_table(made), "",
            f"Score: 0 is what `{lines.blind}` earns, 1 what `{lines.reference}` earns.", "",
        ]  # fmt: skip
    with replacing(file) as partial:
        partial.write_text("\n".join(parts), encoding="utf-8")


def draw_returns(made: Comparison) -> "Drawing":
    """Draw the returns of every controller, the best mean on top: a dot for a machine, the mean with its interval."""
    # a machine has the same height within the row of each controller
    from matplotlib.figure import Figure as Drawing

    names = ranked(made, "total_return")
    figure = Drawing(figsize=(7.2, 0.9 + 0.42 * len(names)), layout="constrained")
    axes = figure.add_subplot()
    within = np.linspace(0.28, -0.28, len(made.seeds))
    for row, name in enumerate(reversed(names)):
        returns = [cut.total_return for cut in made.results[name]]
        mean = made.figures[name]["total_return"]
        axes.plot(returns, row + within, ".", color=MUTED, ms=4)
        axes.plot([mean.low, mean.high], [row, row], color=BLUE, lw=1.2)
        axes.plot([mean.value, mean.value], [row - 0.3, row + 0.3], color=BLUE, lw=2.0)
    axes.set_yticks(range(len(names)), [_short(name) for name in reversed(names)])
    axes.set_xlabel("return of a cut")
    axes.spines[["top", "right"]].set_visible(False)
    return figure


def _short(name: str) -> str:
    return name if len(name) <= NAME_LETTERS else f"{name.partition(':')[0]} ..."
