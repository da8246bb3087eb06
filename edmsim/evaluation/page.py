"""A page of Markdown that compares controllers on one set of machines, with a figure for every environment."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from edmsim.evaluation.compare import Comparison
from edmsim.evaluation.lines import lines_of
from edmsim.evaluation.table import markdown_table, ranked
from edmsim.files import make_writable, replacing
from edmsim.recording.figures.palette import BLUE, MUTED

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAME_LETTERS = 48  # a controller of more letters is named without its parameters in a figure: the table has them


def write(file: Path, comparisons: Sequence[Comparison]) -> None:
    """Write the page, and the figures beside it as ``NAME-ENVIRONMENT.png``; see `draw`."""
    make_writable(file.parent)
    parts = ["# Controllers compared", ""]
    for made in comparisons:
        name = f"{file.stem}-{re.sub(r'[^0-9A-Za-z]+', '-', made.env_id.rpartition('/')[2])}.png"
        with replacing(file.with_name(name)) as partial:
            draw(made).savefig(partial, format="png", dpi=110)
        lines = lines_of(made.env_id)
        parts += [
            f"## {made.env_id}", "", f"![Return of every cut, and the mean of each controller]({name})", "",
            "*Returns of the same machines under all controllers: a dot for each machine; the line is the mean with "
            "its 95 % interval.*", "", *markdown_table(made), "",
            f"Score: 0 is what `{lines.blind}` earns, 1 what `{lines.reference}` earns.", "",
        ]  # fmt: skip
    with replacing(file) as partial:
        partial.write_text("\n".join(parts), encoding="utf-8")


def draw(made: Comparison) -> Figure:
    """Draw the returns of every controller, the best mean on top: a dot for a machine, the mean with its interval."""
    # a machine has the same height within the row of each controller
    # a machine has the same height within the row of each controller
    from matplotlib.figure import Figure

    names = ranked(made, "total_return")
    figure = Figure(figsize=(7.2, 0.9 + 0.42 * len(names)), layout="constrained")
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
