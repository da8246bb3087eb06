"""How the recording is laid out when it is opened: which views, which curves, seen from where."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from edmsim.recording import palette
from edmsim.recording.frames import Frames
from edmsim.recording.scene import Scene, round_number

if TYPE_CHECKING:
    import rerun.blueprint as rrb

TIME = "machine_time"
"""Timeline of machine time, a duration."""
PATH = "path_um"
"""Timeline of the place along the wire path, in whole um."""
PLAYED_S = 60.0
"""How long playing the whole cut back takes at the speed the recording opens with."""


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


PROCESS: tuple[Plot, ...] = (
    Plot(
        "pulses",
        "pulses, %",
        (
            Series("spark", "spark", palette.BLUE),
            Series("open", "open", palette.MUTED),
            Series("short", "short", palette.VERMILION),
            Series("arc", "arc", palette.PURPLE),
        ),
    ),
    Plot("feed", "feed, µm/s", (Series("feed_um_s", "feed", palette.BLUE),)),
    Plot(
        "gap",
        "gap, wire lag, profile error, µm",
        (
            Series("gap_um", "gap", palette.SKY),
            Series("lag_um", "wire lag", palette.ORANGE),
            Series("error_um", "profile error", palette.VERMILION),
        ),
    ),
    Plot("wire", "wire temperature, K", (Series("wire_temperature_K", "hottest place", palette.VERMILION),)),
    Plot("fluid", "debris, volume share", (Series("debris", "debris", palette.GREEN),)),
)
"""Views of the first tab."""

ELECTRICAL: tuple[Plot, ...] = (
    Plot("voltage", "gap voltage, V", (Series("mean_voltage_V", "mean voltage", palette.BLUE),)),
    Plot("current", "gap current, A", (Series("mean_current_A", "mean current", palette.VERMILION),)),
    Plot(
        "times",
        "ignition delay, on-time, period, µs",
        (
            Series("mean_delay_us", "ignition delay", palette.SKY),
            Series("t_on_us", "on-time", palette.ORANGE),
            Series("t_period_us", "period", palette.MUTED),
        ),
    ),
    Plot(
        "position",
        "guides on the table, µm",
        (Series("x_um", "X", palette.BLUE), Series("y_um", "Y", palette.VERMILION)),
    ),
)
"""Views of the second tab."""


def blueprint(scene: Scene, frames: Frames, factor: float) -> rrb.Blueprint:
    """Return the layout: machine and top view left, the series right; `factor` is the wire's exaggeration."""
    import rerun.blueprint as rrb

    left = rrb.Vertical(
        _machine_view(scene, factor),
        rrb.Horizontal(
            _top_view(scene, factor),
            rrb.TextDocumentView(origin="about", name="about this recording"),
            column_shares=[3, 2],
        ),
        row_shares=[1, 1],
    )
    right = rrb.Tabs(_plots(PROCESS, "process"), _plots(ELECTRICAL, "electrical, position"))
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[3, 2]),
        rrb.TimePanel(state="collapsed", timeline=TIME, playback_speed=playback_speed(frames)),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def playback_speed(frames: Frames) -> float:
    """Return the speed at which the whole cut plays in about `PLAYED_S`: 1, 2 or 5 times a power of ten."""
    longest_s = float(frames.t_s[-1]) if len(frames) else 0.0
    return round_number(max(longest_s / PLAYED_S, 1.0))


def _plots(plots: tuple[Plot, ...], name: str) -> rrb.Vertical:
    import rerun as rr
    import rerun.blueprint as rrb

    everything = rr.TimeRange(start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite())
    axis = rrb.TimeAxis(view_range=everything)
    views = (rrb.TimeSeriesView(origin=plot.origin, name=plot.title, axis_x=axis) for plot in plots)
    return rrb.Vertical(*views, name=name)


def _machine_view(scene: Scene, factor: float) -> rrb.Spatial3DView:
    import rerun.blueprint as rrb

    size = 1.35 * scene.size_mm()
    middle = scene.height_mm / 2
    return rrb.Spatial3DView(
        origin="world",
        contents=["world/**", "- world/table/corners", "- world/deflection", "- world/axis"],
        name=f"machine, mm (wire deflection × {factor:g}, profile error × {scene.error_factor():g})",
        background=rrb.Background(color=palette.rgb(palette.INK)),
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(
            position=(-0.9 * size, -1.3 * size, middle + 0.8 * size),
            look_target=(0.0, 0.0, middle),
            eye_up=(0.0, 0.0, 1.0),
        ),
        overrides={"world/table/done": _history()},
    )


def _top_view(scene: Scene, factor: float) -> rrb.Spatial3DView:
    import rerun.blueprint as rrb

    x0, y0, x1, y1 = scene.extent_mm()
    middle = ((x0 + x1) / 2, (y0 + y1) / 2)
    away = scene.height_mm + 0.95 * max(x1 - x0, y1 - y0, 1.0)
    return rrb.Spatial3DView(
        origin="world/table",
        contents=[
            "world/table/**",
            "world/deflection",
            "world/axis",
            *(
                f"- world/table/{low}"
                for low in ("plate", "blank", "nominal/bottom", "cut/bottom", "cut/middle")
            ),
        ],
        name=f"from above, on the table (wire deflection × {factor:g})",
        background=rrb.Background(color=palette.rgb(palette.INK)),
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(
            position=(*middle, away), look_target=(*middle, scene.height_mm), eye_up=(0.0, 1.0, 0.0)
        ),
        overrides={"world/table/done": _history()},
    )


def _history() -> rrb.VisibleTimeRanges:
    """Draw all of the path that was cut up to the time shown, not only its latest piece."""
    import rerun as rr
    import rerun.blueprint as rrb

    start, now = rr.TimeRangeBoundary.infinite(), rr.TimeRangeBoundary.cursor_relative()
    return rrb.VisibleTimeRanges([rr.VisibleTimeRange(name, start=start, end=now) for name in (TIME, PATH)])
