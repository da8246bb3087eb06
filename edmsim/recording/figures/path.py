"""The wire's path before the cut: edges as drawn, the kerf it is to make, start holes and blank."""

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from edmsim.geometry import arc_lengths, interpolated
from edmsim.numeric import above_zero
from edmsim.program.path import CutPath, WireContour
from edmsim.recording.figures.cut import pass_colour
from edmsim.recording.figures.palette import BLUE, GREEN, INK, METAL, MUTED, VERMILION
from edmsim.recording.figures.style import NotebookFigure, fill, in_style, quiet

_ARROWS = 4  # arrows on a contour: enough to see which way it is cut
_WIRES = 150  # places at which a leaning wire is drawn


@in_style
def path_figure(path: CutPath, title: str, kerf_um: float) -> Figure:
    """Draw a path in the program's coordinates; the kerf is wire and twice the gap."""
    above_zero("kerf_um", kerf_um)
    figure = NotebookFigure(figsize=(9.0, 8.0), dpi=130, facecolor="white", layout="none")
    two_rows = path.leans or any(contour.passes for contour in path.contours)  # of the legend
    axes = figure.add_axes((0.09, 0.08, 0.88, 0.80 if two_rows else 0.82))
    quiet(axes)
    axes.grid(visible=False)
    axes.set_aspect("equal", adjustable="datalim")
    _draw_blank(axes, path, kerf_um)
    for number, contour in enumerate(path.contours):
        faces = _faces(contour)
        for name, (edge_colour, way_colour), face in faces:
            edge = face.nominal_mm - path.origin_mm
            label = f"edge as drawn{name}" if number == 0 else None
            axes.plot(*edge.T, color=edge_colour, linewidth=0.9, zorder=4, label=label)
            _draw_ways(axes, path, face, (name, way_colour), number == 0)
            _draw_arrows(axes, face.points_um / 1e3 - path.origin_mm)
        if len(faces) == 2:
            _draw_wires(axes, *(face.points_um / 1e3 - path.origin_mm for _, _, face in faces))
        way = contour.points_um / 1e3 - path.origin_mm
        axes.annotate(
            str(number + 1), way[0], xytext=(8, 8), textcoords="offset points", fontsize=9, color=GREEN, zorder=6
        )
    starts = path.start_holes_um / 1e3 - path.origin_mm
    axes.plot(*starts.T, "^", color=GREEN, markeredgecolor="white", zorder=6, label="start hole")
    axes.set_xlabel("X of the program, mm", fontsize=9, color=MUTED)
    axes.set_ylabel("Y of the program, mm", fontsize=9, color=MUTED)
    axes.legend(
        loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4 if path.leans else 5, frameon=False, fontsize=8.5,
        labelcolor=INK,
    )
    figure.text(0.09, 0.955, title, fontsize=14, fontweight="bold", color=INK)
    return figure


def _faces(contour: WireContour) -> list[tuple[str, tuple[str, str], WireContour]]:
    """Return names, colours of edge and way, and contours of the faces on which a contour is drawn."""
    if contour.lean is None:
        return [("", (INK, BLUE), contour)]
    return [
        (", below", (INK, BLUE), contour.at_height(0.0)),
        (", above", (MUTED, VERMILION), contour.at_height(contour.lean.height_mm)),
    ]


def _draw_wires(axes: Axes, below: np.ndarray, above: np.ndarray) -> None:
    """Draw the wire in some places, from the lower face to the upper one."""
    passed = arc_lengths((below + above) / 2)
    at = np.linspace(0.0, passed[-1], _WIRES)
    ends = [interpolated(at, passed, way) for way in (below, above)]
    wires = LineCollection(list(np.stack(ends, axis=1)), color=GREEN, linewidth=0.4, zorder=3, label="wire")
    axes.add_collection(wires)


def _draw_ways(axes: Axes, path: CutPath, contour: WireContour, face: tuple[str, str], labelled: bool) -> None:
    """Draw the wire's centre on a face, of every pass in its colour; a tab's passes are dashed."""
    where, colour = face
    if not contour.passes:
        way, label = contour.points_um / 1e3 - path.origin_mm, f"wire's centre{where}" if labelled else None
        axes.plot(*way.T, color=colour, linewidth=0.9, zorder=3, label=label)
        return
    for one in contour.passes:
        said = one.piece == "profile" and where in ("", ", below")
        name = f"pass {one.number}, {one.offset_um / 1e3:.3f} mm" if said else None
        style = "-" if one.piece == "profile" else (0, (3, 1.5))
        way = one.points_um / 1e3 - path.origin_mm
        axes.plot(
            *way.T, color=pass_colour(one.number), linewidth=0.8, linestyle=style, zorder=3,
            label=name if labelled else None,
        )  # fmt: skip


def _draw_blank(axes: Axes, path: CutPath, kerf_um: float) -> None:
    (x0, y0, x1, y1), (dx, dy) = path.stock_mm, path.origin_mm
    blank = Rectangle((x0 - dx, y0 - dy), x1 - x0, y1 - y0, facecolor=METAL, edgecolor=MUTED, linewidth=0.8, zorder=0)
    axes.add_patch(blank)
    ways = [
        shapely.LineString(way / 1e3 - path.origin_mm)
        for contour in path.contours for _, _, face in _faces(contour) for way in face.ways_um
    ]
    kerf = shapely.union_all([way.buffer(kerf_um / 2e3) for way in ways])
    fill(axes, kerf, "#cfe3f1", "kerf")
    for place_um in path.start_holes_um:
        hole = Circle(
            place_um / 1e3 - path.origin_mm, path.start_hole_radius_mm, facecolor="white", edgecolor=MUTED, zorder=2
        )
        axes.add_patch(hole)


def _draw_arrows(axes: Axes, way: np.ndarray) -> None:
    """Point along the cut."""
    line = shapely.LineString(way)
    for share in (np.arange(_ARROWS) + 0.5) / _ARROWS:
        at = share * line.length
        tail, head = (shapely.get_coordinates(line.interpolate(s))[0] for s in (at, at + 1e-3 * line.length))
        axes.annotate("", head, tail, arrowprops={"arrowstyle": "-|>", "color": BLUE, "linewidth": 0.9}, zorder=5)
