"""The layout of a recording in the viewer: views, curves and cameras."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from edmsim.geometry import Floats
from edmsim.recording.figures import palette
from edmsim.recording.rerun.gap import CURRENT_HEIGHT, SCOPE_SPACE, SCOPE_WIDTH, VOLTAGE_HEIGHT
from edmsim.recording.rerun.stream import CLASS_COLOURS, PATH, TIME
from edmsim.recording.scene import Scene, round_number

PLAYED_S = 60.0  # how long playing the whole cut back takes at the speed the recording opens with


class Series(NamedTuple):
    """One curve: its column in the table of windows, the name and colour it is shown with."""

    entity: str
    name: str
    colour: str


class Plot(NamedTuple):
    """One view of curves: where they are logged, and its title with the unit."""

    origin: str
    title: str
    series: tuple[Series, ...]


class Sizes(NamedTuple):
    """What the views need to know of a cut; the recording stores it, so that it can be laid out again."""

    # size_mm, height_mm, wire_diameter_um: the largest of the drawing's sides and the workpiece's height, that
    # height, the wire
    size_mm: float
    height_mm: float
    wire_diameter_um: float
    x0_mm: float  # x0_mm, y0_mm, x1_mm, y1_mm: box around the drawing
    y0_mm: float
    x1_mm: float
    y1_mm: float
    # deflection_factor, error_factor: how many times larger the wire's deflection and the profile error are drawn
    deflection_factor: float
    error_factor: float
    end_s: float  # machine time at the end


def sizes_of(scene: Scene, deflection_factor: float, end_s: float) -> Sizes:
    """Return what the views need to know of a cut."""
    return Sizes(
        scene.size_mm(), scene.height_mm, scene.wire_diameter_um, *scene.extent_mm(), deflection_factor,
        scene.error_factor(), end_s,
    )  # fmt: skip


PROCESS: tuple[Plot, ...] = (
    Plot("pulses", "pulses, %", tuple(Series(name, name, colour) for name, colour in CLASS_COLOURS.items())),
    Plot("feed", "feed, µm/s", (Series("feed_um_s", "feed", palette.SKY),)),
    Plot("gap", "gap, wire lag, profile error, µm", (
        Series("gap_um", "gap", palette.SKY), Series("lag_um", "wire lag", palette.ORANGE),
        Series("error_um", "profile error", palette.VERMILION),
    )),
    Plot("wire", "wire temperature, K", (Series("wire_temperature_K", "hottest place", palette.VERMILION),)),
    Plot("fluid", "debris, volume share", (Series("debris", "debris", palette.GREEN),)),
    Plot("gas", "gas on the wire's front, share", (Series("coverage", "mean over height", palette.SKY),)),
)  # fmt: skip
"""Views of the first tab."""

ELECTRICAL: tuple[Plot, ...] = (
    Plot("voltage", "gap voltage, V", (
        Series("mean_voltage_V", "mean voltage", palette.SKY),
        Series("net_voltage_V", "with equalising pulses", palette.ORANGE),
    )),
    Plot("current", "gap current, A", (Series("mean_current_A", "mean current", palette.VERMILION),)),
    Plot("times", "ignition delay, on-time, period, µs", (
        Series("mean_delay_us", "ignition delay", palette.SKY), Series("t_on_us", "on-time", palette.ORANGE),
        Series("t_period_us", "period", palette.MUTED),
    )),
    Plot("position", "guides on the table, µm", (
        Series("x_um", "X", palette.SKY), Series("y_um", "Y", palette.VERMILION),
    )),
    Plot("following", "following error of the drives, µm", (
        Series("following_x_um", "X", palette.SKY), Series("following_y_um", "Y", palette.VERMILION),
    )),
)  # fmt: skip
"""Views of the second tab; ``net_voltage_V`` is there of generators with equalising pulses only."""


def blueprint(sizes: Sizes, steps: tuple[Plot, ...] = ()) -> rrb.Blueprint:
    """Return the layout of one cut; `steps`, what an environment adds, are in a tab that is shown first."""
    # left the workpiece and the machine, below them the gap from above and the whole part, at the foot the
    # oscilloscope; right the series and the events
    factor = sizes.deflection_factor
    left = rrb.Vertical(
        rrb.Horizontal(
            workpiece_view(sizes, "", f"workpiece, mm (wire deflection × {factor:g})"), _machine_view(sizes),
            column_shares=[3, 2],
        ),
        rrb.Horizontal(gap_view(sizes, "", "at the wire from above, mid height, µm, to scale"), _top_view(sizes)),
        scope_view("", "gap voltage and current of the last pulses"),
        row_shares=[10, 9, 6],
    )  # fmt: skip
    right = rrb.Vertical(
        rrb.Tabs(
            *([_plots(steps, "actions, rewards, costs")] if steps else []),
            _plots(PROCESS, "process"), _plots(ELECTRICAL, "electrical, position"),
            plot_view(["slices"], "gas on the wire's front by height, share"),
        ),
        rrb.Tabs(events_view("", "events"), rrb.TextDocumentView(origin="about", name="about this recording")),
        row_shares=[4, 1],
    )
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[3, 2]),
        rrb.TimePanel(state="collapsed", timeline=TIME, playback_speed=playback_speed(sizes.end_s)),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def playback_speed(end_s: float) -> float:
    """Return the speed at which the whole cut plays in about `PLAYED_S`: 1, 2 or 5 times a power of ten."""
    return round_number(max(end_s / PLAYED_S, 1.0))


def _plots(plots: tuple[Plot, ...], name: str) -> rrb.Vertical:
    return rrb.Vertical(*(plot_view([plot.origin], plot.title) for plot in plots), name=name)


def plot_view(origins: Sequence[str], title: str) -> rrb.TimeSeriesView:
    """Return a view of the curves logged under some places, over all of the time."""
    everything = rr.TimeRange(start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite())
    return rrb.TimeSeriesView(
        origin="/", contents=[f"/{origin}/**" for origin in origins], name=title,
        axis_x=rrb.TimeAxis(view_range=everything),
    )  # fmt: skip


def events_view(prefix: str, name: str) -> rrb.TextLogView:
    """Return the view of the events."""
    return rrb.TextLogView(origin=f"{prefix}/events", name=name)


def workpiece_view(sizes: Sizes, prefix: str, name: str) -> rrb.Spatial3DView:
    """Return the view of the workpiece with its kerf, the wire in it, and the discharges."""
    size = 1.6 * sizes.size_mm
    middle = 0.6 * sizes.height_mm
    hidden = (
        "base", "cross/**", "deflection", "axis", "table/carriage", "table/plate", "table/corners", "table/error/**",
        "table/starts", "table/stop", "table/cut/**", "table/nominal/bottom",
    )  # fmt: skip
    return _space_view(
        f"{prefix}/world", name, hidden, (-0.45 * size, -0.6 * size, middle + 0.55 * size), (0.0, 0.0, middle),
        overrides={f"{prefix}/world/table/done": _history()},
    )  # fmt: skip


def _machine_view(sizes: Sizes) -> rrb.Spatial3DView:
    hidden = (
        "table/corners", "table/error/**", "table/done", "table/starts", "table/stop", "deflection", "axis", "guides",
    )  # fmt: skip
    name = f"machine, mm (wire deflection × {sizes.deflection_factor:g})"
    return _space_view("world", name, hidden, (-300.0, -470.0, 240.0), (5.0, 40.0, -30.0))


def _top_view(sizes: Sizes) -> rrb.Spatial3DView:
    x0, y0, x1, y1 = sizes.x0_mm, sizes.y0_mm, sizes.x1_mm, sizes.y1_mm
    middle = ((x0 + x1) / 2, (y0 + y1) / 2)
    away = sizes.height_mm + 1.0 * max(x1 - x0, y1 - y0, 1.0)
    hidden = ("carriage", "plate", "workpiece", "nominal/bottom", "cut/bottom", "cut/middle", "discharges")
    name = (
        f"part from above (deflection × {sizes.deflection_factor:g}, profile error × {sizes.error_factor:g}, "
        "at corners in µm)"
    )
    return _space_view(
        "world/table", name, hidden, (*middle, away), (*middle, sizes.height_mm), eye_up=(0.0, 1.0, 0.0),
        more=("world/deflection", "world/axis"), overrides={"world/table/done": _history()},
    )  # fmt: skip


def _space_view(
    origin: str, name: str, hidden: Sequence[str], position: tuple[float, float, float],
    look_target: tuple[float, float, float], *, eye_up: tuple[float, float, float] = (0.0, 0.0, 1.0),
    more: Sequence[str] = (), overrides: Any = None,
) -> rrb.Spatial3DView:
    """Return a view of what is logged under a place but for what is hidden, and of more."""
    return rrb.Spatial3DView(
        origin=origin, contents=[f"{origin}/**", *more, *(f"- {origin}/{part}" for part in hidden)], name=name,
        background=rrb.Background(color=palette.rgb(palette.INK)), line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(position=position, look_target=look_target, eye_up=eye_up),
        overrides=overrides,
    )  # fmt: skip


def gap_view(sizes: Sizes, prefix: str, name: str) -> rrb.Spatial2DView:
    """Return the view from above at the wire, in um."""
    reach = sizes.wire_diameter_um / 2 + 130.0
    return rrb.Spatial2DView(
        origin=f"{prefix}/top", name=name, background=rrb.Background(color=palette.rgb(palette.INK)),
        visual_bounds=rrb.VisualBounds2D(x_range=(-reach, reach), y_range=(-reach, reach)),
    )


def scope_view(prefix: str, name: str) -> rrb.Spatial2DView:
    """Return the oscilloscope."""
    high = VOLTAGE_HEIGHT + SCOPE_SPACE + CURRENT_HEIGHT
    return rrb.Spatial2DView(
        origin=f"{prefix}/scope", name=name, background=rrb.Background(color=palette.rgb(palette.INK)),
        visual_bounds=rrb.VisualBounds2D(x_range=(-26.0, SCOPE_WIDTH + 10.0), y_range=(-6.0, high + 20.0)),
    )


def _history() -> rrb.VisibleTimeRanges:
    """Draw all of the path that was cut up to the time shown, not only its latest piece."""
    start, now = rr.TimeRangeBoundary.infinite(), rr.TimeRangeBoundary.cursor_relative()
    return rrb.VisibleTimeRanges([rr.VisibleTimeRange(name, start=start, end=now) for name in (TIME, PATH)])


# Steps of an environment in the recording: what was commanded, and what it earned and cost.

RETURN, COST = "return", "cost"  # where what was earned and what it cost stand in a recording
TOTAL = "total"  # curve of their sums from the beginning on
_COLOURS = (
    palette.SKY, palette.ORANGE, palette.GREEN, palette.VERMILION, palette.PURPLE, palette.MUTED, palette.BLUE,
    palette.GAS,
)  # fmt: skip


class Steps(NamedTuple):
    """What an environment adds to the recording of its cut, step by step."""

    plots: tuple[Plot, ...]  # views, whose curves are logged under their origins
    values: Mapping[str, Floats]  # of every curve, by ``origin/entity``, its values (n,)
    t_s: Floats  # t_s, path_um: machine time and place along the path at the end of every step
    path_um: Floats
    notes: Sequence[str]  # how the cut was thinned, for the text about the recording


def steps_of(
    groups: Sequence[tuple[str, str, Sequence[str], Floats]], t_s: Floats, path_um: Floats, notes: Sequence[str],
) -> Steps:
    """Lay out curves in views: of each its origin, title with unit, names of curves, and values (n, curves)."""
    # NaN is not drawn, and curves that are 0 throughout are left out
    plots, values = [], {}
    for origin, title, names, columns in groups:
        shown = [
            (name, column) for name, column in zip(names, columns.T, strict=True)
            if name == TOTAL or np.any(np.nan_to_num(column) != 0.0)
        ]  # fmt: skip
        if not shown:
            continue
        colours = (_COLOURS[k % len(_COLOURS)] for k in range(len(shown)))
        curves = [Series(name, name.replace("_", " "), c) for (name, _), c in zip(shown, colours, strict=True)]
        plots.append(Plot(origin, title, tuple(curves)))
        values.update({f"{origin}/{name}": column for name, column in shown})
    return Steps(tuple(plots), values, t_s, path_um, notes)
