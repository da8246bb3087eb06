"""The style of all figures; those for a paper are one column wide, with small type."""

import io
import pathlib
import textwrap
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import Any, Literal, ParamSpec, TypeVar

import shapely
from matplotlib import rc_context, rcdefaults
from matplotlib.axes import Axes
from matplotlib.backend_bases import RendererBase
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.text import Text

from edmsim.errors import refuses_wrong_types
from edmsim.files import check_suffix, make_writable, replacing
from edmsim.recording.figures.palette import ERROR_STOPS, GRID, INK, LINE, MUTED

FORMATS = ("pdf", "svg", "png")  # file formats of figures
WIDTH_IN = 3.5  # width of one column of a journal (89 mm)
DPI = 200
ERROR_COLOURS = LinearSegmentedColormap.from_list("profile error", ERROR_STOPS)
LABEL_PT, TICK_PT, TITLE_PT = 7.5, 7.0, 8.5
_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")


@contextmanager
def own_style() -> Iterator[None]:
    """Use matplotlib's defaults in the block instead of the user's style."""
    with rc_context():
        rcdefaults()
        yield


def in_style(draw: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """Decorate a function to draw in `own_style`, with its arguments checked by `refuses_wrong_types`."""
    checked = refuses_wrong_types(draw)

    @wraps(draw)
    def run(*args: _Arguments.args, **options: _Arguments.kwargs) -> _Result:
        with own_style():
            return checked(*args, **options)

    return run


class NotebookFigure(Figure):
    """A figure that a notebook displays as it does pyplot's figures, without pyplot and a display."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        FigureCanvasAgg(self)

    def _repr_png_(self) -> bytes:
        return figure_png(self)


class ColumnFigure(NotebookFigure):
    """A figure one column wide, whose left margin grows if labels need it."""

    def draw(self, renderer: RendererBase) -> None:
        """Draw the figure; if labels would be cut off on the left, move the axes to the right."""
        boxes = [box for axes in self.axes if (box := axes.yaxis.get_tightbbox(renderer)) is not None]
        if (least := min((box.x0 for box in boxes), default=0.0)) < 0:
            self.subplots_adjust(left=self.subplotpars.left - least / self.bbox.width)
        super().draw(renderer)


@in_style
def figure_png(figure: Figure, dpi: float | Literal["figure"] = "figure") -> bytes:
    """Return a figure as PNG, always the same bytes."""
    written = io.BytesIO()
    figure.savefig(written, format="png", dpi=dpi, metadata={"Software": "edmsim"})
    return written.getvalue()


def check_figure(file: pathlib.Path) -> str:
    """Return the format in which a figure is written, one of `FORMATS`; raises `InputError` for another suffix."""
    return check_suffix(file, "a figure", *(f".{kind}" for kind in FORMATS)).removeprefix(".")


@in_style
def write_figure(figure: Figure, file: str | pathlib.Path) -> None:
    """Write a figure in the format of the file's suffix; an existing file is replaced only when complete."""
    file = pathlib.Path(file)
    kind = check_figure(file)
    make_writable(file.parent)
    with replacing(file) as partial:
        if kind == "png":
            content = figure_png(figure)
        else:
            memory = io.BytesIO()  # because savefig ends in other errors on a full disk
            figure.savefig(memory, format=kind)
            content = memory.getvalue()
        partial.write_bytes(content)


def quiet(axes: Axes) -> None:
    """Remove the axes' right and upper border, and draw the others and the grid in pale colours."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(LINE)
    axes.tick_params(labelsize=8, colors=MUTED, length=3, width=0.6)
    axes.grid(color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)


def shrink_to(text: Text, right: float) -> None:
    """Reduce a text's size if it would come near `right`, a place in dots."""
    place = text.get_window_extent()
    room = right - place.x0 - 2 * place.height
    if place.width > room:
        text.set_fontsize(text.get_fontsize() * room / place.width)


def fill(axes: Axes, region: shapely.Geometry, colour: str = "white", label: str | None = None) -> None:
    """Fill the polygons of a region, without their holes."""
    for polygon in shapely.get_parts(region):
        if polygon.geom_type == "Polygon":
            rings = [Path(shapely.get_coordinates(ring), closed=True) for ring in shapely.get_rings(polygon)]
            shape = Path.make_compound_path(*rings)
            axes.add_patch(PathPatch(shape, facecolor=colour, edgecolor="none", zorder=1, label=label))
            label = None


def column_figure(height_in: float, *, top_in: float = 0.1, left_in: float = 0.48, right_in: float = 0.1) -> Figure:
    """Return an empty figure of one column's width, with an Agg canvas, without pyplot."""
    # margins are arguments, because matplotlib would need as long to find them as to draw the figure
    # no layout engine: one in the user's rcParams would move the margins
    figure = ColumnFigure(figsize=(WIDTH_IN, height_in), dpi=DPI, facecolor="white", layout="none")
    figure.subplots_adjust(left_in / WIDTH_IN, 0.38 / height_in, 1 - right_in / WIDTH_IN, 1 - top_in / height_in)
    return figure


def colour_bar(figure: Figure, lines: ScalarMappable, label: str) -> None:
    """Draw the colour bar along the figure's upper edge; it takes 0.46 inches."""
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
    """Draw the legend inside the axes, or in rows above them."""
    style: dict[str, Any] = {
        "fontsize": TICK_PT, "labelcolor": INK, "handlelength": 1.4, "handletextpad": 0.5, "columnspacing": 1.0,
        "labelspacing": 0.3, "borderaxespad": 0.3, "title": title, "title_fontsize": TICK_PT,
        "alignment": "left",
    }
    if above:
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, frameon=False, **style)
    else:
        axes.legend(loc=loc, ncols=columns, facecolor="white", edgecolor="none", framealpha=0.85, **style)


class EmptyFigure(NotebookFigure):
    """A low figure with the reason `why` there is nothing to draw."""

    def __init__(self, why: str) -> None:
        super().__init__(figsize=(WIDTH_IN, 1.0), dpi=DPI, facecolor="white", layout="none")
        self.why = why
        self.text(0.5, 0.5, textwrap.fill(why, 50), ha="center", va="center", fontsize=LABEL_PT, color=MUTED)
