"""The look shared by the figures for a paper: one column wide, small type, colours that everyone can distinguish."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from edmsim.recording.figures.palette import INK, MUTED
from edmsim.recording.figures.profile import quiet

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

WIDTH_IN = 3.5  # width of one column of a journal (89 mm)
DPI = 200
LABEL_PT, TICK_PT, TITLE_PT = 7.5, 7.0, 8.5


def column_figure(height_in: float, *, top_in: float = 0.1, left_in: float = 0.48, right_in: float = 0.1) -> Figure:
    """Return an empty figure of one column's width, with an Agg canvas; pyplot is not touched."""
    # margins are arguments: to have them found by matplotlib takes as long as to draw the figure
    from edmsim.recording.figures.canvas import NotebookFigure

    # a layout engine of the user's own rcParams would move the margins
    figure = NotebookFigure(figsize=(WIDTH_IN, height_in), dpi=DPI, facecolor="white", layout="none")
    figure.subplots_adjust(left_in / WIDTH_IN, 0.38 / height_in, 1 - right_in / WIDTH_IN, 1 - top_in / height_in)
    return figure


def colour_bar(figure: Figure, lines: ScalarMappable, label: str) -> None:
    """Draw the scale of colours along the figure's upper edge; it takes 0.46 inches."""
    height_in = figure.get_figheight()
    margins = figure.subplotpars
    place = figure.add_axes((margins.left, 1 - 0.41 / height_in, margins.right - margins.left, 0.05 / height_in))
    bar = figure.colorbar(lines, cax=place, orientation="horizontal", extendfrac=0.03)
    bar.outline.set_visible(False)
    place.xaxis.set_ticks_position("top")
    place.xaxis.set_label_position("top")
    place.tick_params(labelsize=TICK_PT, colors=MUTED, length=2, pad=1)
    bar.set_label(label, fontsize=LABEL_PT, color=MUTED, labelpad=3)


def dress(axes: Axes, x: str, y: str) -> None:
    """Label the axes and give them the look of all figures."""
    quiet(axes)
    axes.tick_params(labelsize=TICK_PT)
    axes.set_xlabel(x, fontsize=LABEL_PT, color=MUTED)
    axes.set_ylabel(y, fontsize=LABEL_PT, color=MUTED)


def legend(
    axes: Axes, *, above: bool = False, columns: int = 1, loc: Literal["best", "upper right"] = "best",
    title: str | None = None,
) -> None:
    """Explain what is drawn: inside the axes, or in a row above them."""
    style: dict[str, Any] = {
        "fontsize": TICK_PT, "labelcolor": INK, "handlelength": 1.4, "handletextpad": 0.5, "columnspacing": 1.0,
        "labelspacing": 0.3, "borderaxespad": 0.3, "title": title, "title_fontsize": TICK_PT,
        "alignment": "left",
    }
    if above:
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, frameon=False, **style)
    else:
        axes.legend(loc=loc, ncols=columns, facecolor="white", edgecolor="none", framealpha=0.85, **style)


def nothing_to_show(figure: Figure, why: str) -> Figure:
    """Say on an empty figure why it is empty."""
    figure.text(0.5, 0.5, why, ha="center", va="center", fontsize=LABEL_PT, color=MUTED, wrap=True)
    return figure
