"""Figures of the part and its kerf: profile error map and its shares, corner detail, kerf over the height."""

import numpy as np
import pyarrow as pa
import shapely
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from edmsim.errors import InputError
from edmsim.geometry import Floats, arc_lengths
from edmsim.metrology.edges import filled
from edmsim.metrology.profile import CornerError
from edmsim.metrology.shares import SHARES
from edmsim.recording.figures import palette, style
from edmsim.recording.figures.profile import draw_errors, label_corners
from edmsim.recording.report import Report, mm_text
from edmsim.recording.scene import ErrorMap, Scene
from edmsim.recording.windows import columns

_COLOURS = palette.SKY, palette.PURPLE, palette.GREEN, palette.BLUE, palette.ORANGE
_SHOWN = 99.0  # percentile of all errors that the axes hold; single corners may leave them (ours)


def shares_figure(scene: Scene) -> Figure:
    """Draw the profile error and its shares over the distance along the nominal edges, a panel each, on one scale."""
    figure = style.column_figure(5.6, top_in=0.25, left_in=0.52)
    split = [edge for edge in scene.maps if edge.shares_um is not None and np.isfinite(edge.error_um).any()]
    if not split:
        return style.nothing_to_show(figure, "no shares: no error was measured, or the wire's centre ran on the edge")
    s_mm, error, shares = _joined(split)
    panels = figure.subplots(1 + len(SHARES), 1, sharex=True, sharey=True, gridspec_kw={"hspace": 0.22})
    names, colours = ("profile error", *SHARES), (palette.INK, *_COLOURS)
    for axes, name, values, colour in zip(panels, names, (error, *shares), colours, strict=True):
        style.dress(axes, "", "")
        axes.axhline(0.0, color=palette.MUTED, linewidth=0.6)
        axes.plot(s_mm, values, color=colour, linewidth=0.7)
        known = values[np.isfinite(values)]
        rms, mean = np.sqrt(np.mean(known**2)), f"{known.mean():+.1f}".replace("-", "−")
        title = f"{name}: mean {mean}, {rms:.1f} µm rms"
        axes.set_title(title, fontsize=style.TICK_PT, color=palette.INK, loc="left", pad=2)
    limit = 1.2 * max(float(np.nanpercentile(np.abs([error, *shares]), _SHOWN)), 0.5)
    panels[0].set_ylim(-limit, limit)
    panels[0].margins(x=0)
    panels[-1].set_xlabel("along the nominal edge, mm", fontsize=style.LABEL_PT, color=palette.MUTED)
    panels[len(SHARES) // 2].set_ylabel("µm, + metal left", fontsize=style.LABEL_PT, color=palette.MUTED)
    return figure


def _joined(split: list[ErrorMap]) -> tuple[Floats, Floats, Floats]:
    """Way along the edges, error and shares of several contours in a row, NaN between them."""
    ways, errors, shares, begin = [], [], [], 0.0
    for edge in split:
        assert edge.shares_um is not None
        way = begin + arc_lengths(edge.points_mm)
        begin = float(way[-1])
        ways.append(np.append(way, begin))
        errors.append(np.append(edge.error_um, np.nan))
        shares.append(np.column_stack([edge.shares_um, np.full(len(SHARES), np.nan)]))
    return np.concatenate(ways), np.concatenate(errors), np.concatenate(shares, axis=1)


CORNER_REACH_MM = 0.4  # half the width of what a corner's detail shows (ours: kerf and wire are in it whole)


LABELLED = 6  # corners whose error is written beside them: the worst ones


def error_figure(scene: Scene) -> Figure:
    """Draw the profile error along the nominal edge, exaggerated, with colours for sign and size."""
    if not len(scene.known_errors()):
        return style.nothing_to_show(style.column_figure(2.0), "no profile error: no edge of the part was measured")
    scene = scene.in_program()
    points = np.concatenate([edge.nominal_mm for edge in scene.maps])
    (x0, y0), (x1, y1) = points.min(axis=0), points.max(axis=0)
    margin = 0.08 * max(x1 - x0, y1 - y0)
    across, high = x1 - x0 + 2 * margin, y1 - y0 + 2 * margin
    figure = style.column_figure(float(np.clip(2.9 * high / across, 1.0, 4.2)) + 0.85, top_in=0.49)
    axes = figure.add_subplot()
    style.dress(axes, *scene.axis_labels())
    axes.grid(visible=False)
    factor = scene.error_factor()
    lines = draw_errors(axes, scene, factor, (0.4, 1.2), 0.4, 3)
    assert lines is not None
    for edge in scene.maps:
        axes.plot(*edge.nominal_mm.T, color=palette.INK, linewidth=0.6, linestyle=(0, (5, 3)), zorder=2)
    axes.set_aspect("equal")
    axes.set_xlim(x0 - margin, x1 + margin)
    axes.set_ylim(y0 - margin, y1 + margin)
    axes.apply_aspect()  # labels are placed by what they would cover
    box = {"boxstyle": "round,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.8}
    label_corners(axes, scene, LABELLED, style.TICK_PT, box, 5)
    style.colour_bar(figure, lines, f"profile error, µm: − undercut, + metal left; drawn × {factor:g}")
    return figure


def corner_figure(scene: Scene, windows: pa.Table, corner: int | None = None) -> Figure:
    """Draw one corner: above, metal and paths to scale; below, the deviations along the corner.

    The wire's path is that of its middle between the faces, averaged over windows.

    Parameters
    ----------
    corner : int, optional
        Index in ``scene.corners``; by default that of the largest error.

    Raises
    ------
    InputError
        If there is no such corner.
    """
    figure = style.column_figure(5.2, top_in=0.55)
    if not scene.corners and corner is None:
        return style.nothing_to_show(figure, "no corner: the edge as drawn has none")
    chosen = _chosen_corner(scene, corner)
    detail, below = figure.subplots(2, 1, height_ratios=[2.6, 1.0], gridspec_kw={"hspace": 0.5})
    place = np.array([chosen.x_mm, chosen.y_mm])
    _draw_detail(detail, scene, windows, place)
    _draw_deviation(below, scene, windows, place)
    x, y = map(mm_text, (place - (scene.origin_mm or (0.0, 0.0))).tolist())
    error = "not measured" if np.isnan(chosen.error_um) else f"{chosen.error_um:+.1f} µm".replace("-", "−")
    detail.set_title(
        f"corner at X {x} Y {y} mm, {chosen.turn_deg:+.0f}°: {error}".replace("-", "−"),
        fontsize=style.LABEL_PT, color=palette.INK, loc="left", pad=28,
    )  # fmt: skip
    return figure


def _chosen_corner(scene: Scene, corner: int | None) -> CornerError:
    if corner is None:
        return max(scene.corners, key=lambda c: -1.0 if np.isnan(c.error_um) else abs(c.error_um))
    if not 0 <= corner < len(scene.corners):
        raise InputError(f"there is no corner {corner}: the cut has corners 0 to {len(scene.corners) - 1}")
    return scene.corners[corner]


def _paths_um(windows: pa.Table, place_mm: Floats, reach_mm: float) -> tuple[Floats, Floats]:
    """Guides and wire near a place, relative to it in um: rows (n, 2) in order of time, NaN between visits."""
    guides = columns(windows, "x_um", "y_um") - 1000 * place_mm
    wire = guides - columns(windows, "lag_x_um", "lag_y_um")
    away = np.abs(guides).max(axis=1) > 1000 * reach_mm
    return np.where(away[:, None], np.nan, guides), np.where(away[:, None], np.nan, wire)


def _draw_detail(axes: Axes, scene: Scene, windows: pa.Table, place_mm: Floats) -> None:
    reach = 1000 * CORNER_REACH_MM
    style.dress(axes, "X from the corner, µm", "Y from the corner, µm")
    axes.grid(visible=False)
    axes.set_facecolor(palette.METAL)
    edges = scene.cut_edges_mm[scene.middle_slice()] if scene.cut_edges_mm else ()
    box = shapely.box(*(place_mm - CORNER_REACH_MM), *(place_mm + CORNER_REACH_MM))
    kerf = filled(shapely.MultiLineString([line for line in edges if len(line) > 1]))
    shown = shapely.intersection(shapely.make_valid(kerf), box)
    style.fill(axes, shapely.transform(shown, lambda mm: 1000 * (mm - place_mm)))
    for number, line in enumerate(edges):
        axes.plot(
            *(1000 * (line - place_mm)).T, color="#3d4852", linewidth=0.8, zorder=3,
            label="metal edge, mid height" if number == 0 else None,
        )  # fmt: skip
    for number, edge in enumerate(scene.maps):
        axes.plot(
            *(1000 * (edge.nominal_mm - place_mm)).T, color=palette.INK, linewidth=0.8, linestyle=(0, (5, 3)),
            zorder=4, label="nominal edge" if number == 0 else None,
        )  # fmt: skip
    guides, wire = _paths_um(windows, place_mm, 2 * CORNER_REACH_MM)
    axes.plot(*guides.T, color=palette.ORANGE, linewidth=0.9, zorder=5, label="guides")
    axes.plot(*wire.T, color=palette.BLUE, linewidth=0.6, zorder=6, label="wire")
    nearest = np.nanargmin(np.hypot(*guides.T)) if np.isfinite(guides).any() else None
    if nearest is not None:
        radius = scene.wire_diameter_um / 2
        round_wire = {"fill": False, "color": palette.BLUE, "linewidth": 0.7, "linestyle": ":"}
        axes.add_patch(Circle(tuple(wire[nearest]), radius, **round_wire))
    axes.set_xlim(-reach, reach)
    axes.set_ylim(-reach, reach)
    axes.set_aspect("equal")
    style.legend(axes, above=True, columns=2)


def _draw_deviation(axes: Axes, scene: Scene, windows: pa.Table, place_mm: Floats) -> None:
    """How far wire and metal edge are off, over the distance from the corner along the nominal edge."""
    style.dress(axes, "along the nominal edge from the corner, µm", "off, µm")
    axes.axhline(0.0, color=palette.MUTED, linewidth=0.6)
    axes.axvline(0.0, color=palette.GRID, linewidth=0.8)
    reach = 1000 * CORNER_REACH_MM
    for edge in scene.maps:
        off = np.hypot(*(edge.points_mm - place_mm).T)
        if len(off) and off.min() < 1e-3:
            at, turn = int(off.argmin()), np.hypot(*np.diff(edge.points_mm, axis=0).T)
            s = 1000 * (np.concatenate([[0.0], np.cumsum(turn)]) - turn[:at].sum())
            total = 1000 * turn.sum()
            s = (s + total / 2) % total - total / 2 if np.allclose(edge.nominal_mm[0], edge.nominal_mm[-1]) else s
            order = np.argsort(s)
            error = edge.error_um[order]
            axes.plot(s[order], error, color="#3d4852", linewidth=1.0, label="profile error (+ metal left)")
            _draw_lag(axes, windows, edge.points_mm[order], s[order], place_mm, edge.outward()[order])
            break
    axes.set_xlim(-reach, reach)
    style.legend(axes, above=True)


def _draw_lag(axes: Axes, windows: pa.Table, edge_mm: Floats, s: Floats, place_mm: Floats, outward: Floats) -> None:
    """The wire's displacement from its guides, away from the part, at the nearest place of the edge."""
    from scipy.spatial import cKDTree

    guides = columns(windows, "x_um", "y_um") / 1000
    near = np.hypot(*(guides - place_mm).T) < 2 * CORNER_REACH_MM
    if not near.any():
        return
    lag = columns(windows, "lag_x_um", "lag_y_um")[near]
    nearest = cKDTree(edge_mm).query(guides[near])[1]
    away = -(lag * outward[nearest]).sum(axis=1)
    places, group = np.unique(nearest, return_inverse=True)
    mean = np.bincount(group, away) / np.bincount(group)
    axes.plot(s[places], mean, color=palette.BLUE, linewidth=0.9, label="wire off its guides (+ away from the part)")


def kerf_figure(report: Report) -> Figure:
    """Draw the kerf's cross-section over the workpiece's height, averaged along the cut.

    The band covers nine tenths of the measured places. The gap between wire and walls is enlarged, and the wire left
    out.
    """
    figure = style.column_figure(2.9, top_in=0.36)
    slices = report.kerf_section
    section = [row for row in slices if row.places]
    if not section:
        return style.nothing_to_show(figure, "no kerf: there was no place to measure its width")
    radius = report.settings["wire_diameter_um"] / 2
    z = np.array([row.height_mm for row in section])
    panels = figure.subplots(1, 2, sharey=True, gridspec_kw={"wspace": 0.1})
    for panel, side in zip(panels, ("rest", "part"), strict=True):
        mean, low, high = (
            np.array([row[side][key] for row in section]) - radius for key in ("mean_um", "p5_um", "p95_um")
        )
        panel.fill_betweenx(z, low, high, color=palette.BLUE, alpha=0.18, linewidth=0)
        panel.plot(mean, z, color=palette.BLUE, linewidth=1.3, marker="o", markersize=2.5)
        style.dress(panel, f"wire to wall of the {side}, µm", "")
    low, high = (f(limit for panel in panels for limit in panel.get_xlim()) for f in (min, max))
    panels[0].set_xlim(high, low)  # the wire stands between both walls
    panels[1].set_xlim(low, high)
    panels[0].set_ylabel("height over the lower face, mm", fontsize=style.LABEL_PT, color=palette.MUTED)
    panels[0].set_ylim(0, slices[-1].height_mm + slices[0].height_mm)
    panels[0].set_title(
        f"kerf {report.text('kerf_um.mean')} on average, wire {2 * radius:g} µm\n"
        "line: mean along the cut, band: nine tenths", fontsize=style.LABEL_PT, color=palette.INK, loc="left",
    )  # fmt: skip
    return figure
