"""``cut.rrd``: the cut as a rerun recording: machine, gap, oscilloscope, events and the series of the windows."""

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import wraps
from pathlib import Path
from typing import Any, NamedTuple, ParamSpec

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb
import rerun_bindings as bindings
from numpy.typing import NDArray

from edmsim.closed_loop.stops import WORDS, StopCause
from edmsim.files import replacing
from edmsim.geometry import Floats
from edmsim.machine.machine import Machine
from edmsim.machine.setting import WINDOW_PULSES
from edmsim.plant.constants import wire_setup
from edmsim.plant.mechanics.model import build_model
from edmsim.recording.figures import palette
from edmsim.recording.report import (
    PassFigures,
    Report,
    duration_text,
    mm_text,
    outcome_text,
    rate_text,
    settings_in_words,
)
from edmsim.recording.rerun import logs
from edmsim.recording.rerun.playback import APPLICATION, FORMAT, MADE_BY, PATH, TIME, Sizes
from edmsim.recording.scene import Scene, round_factor, round_number
from edmsim.recording.windows import (
    AROUND,
    PULSES,
    THREADING_S,
    Closeups,
    Frames,
    column,
    columns,
    group_means,
    pause_rows,
    quantity,
)

# The layout of a recording in the viewer: views, curves and cameras.

PLAYED_S = 60.0  # about the time for playing the whole cut at the initial speed


class Series(NamedTuple):
    """One curve: its column in the table of windows, its name and its colour."""

    entity: str
    name: str
    colour: str


class Plot(NamedTuple):
    """One view of curves: their origin in the recording, and the title with the unit."""

    origin: str
    title: str
    series: tuple[Series, ...]


PROCESS: tuple[Plot, ...] = (
    Plot("pulses", "pulses, %", tuple(Series(name, name, colour) for name, colour in palette.CLASS_COLOURS.items())),
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
    Plot("position", "commanded position on the table, µm", (
        Series("x_um", "X", palette.SKY), Series("y_um", "Y", palette.VERMILION),
    )),
    Plot("following", "following error of the drives, µm", (
        Series("following_x_um", "X", palette.SKY), Series("following_y_um", "Y", palette.VERMILION),
    )),
)  # fmt: skip
"""Views of the second tab; only generators with equalising pulses have ``net_voltage_V``."""


def blueprint(sizes: Sizes, steps: tuple[Plot, ...] = ()) -> rrb.Blueprint:
    """Return the layout of one cut; `steps`, the views that an environment adds, are in the first tab."""
    # left: workpiece and machine, below them the gap and the whole part from above, at the bottom the oscilloscope;
    # right: series and events
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
    return played(rrb.Horizontal(left, right, column_shares=[3, 2]), TIME, sizes.end_s)


def played(views: rrb.Horizontal, timeline: str, end_s: float) -> rrb.Blueprint:
    """Return a layout without panels; at its speed, a round number, the whole cut plays in about `PLAYED_S`."""
    speed = round_number(max(end_s / PLAYED_S, 1.0))
    return rrb.Blueprint(
        views, rrb.TimePanel(state="collapsed", timeline=timeline, playback_speed=speed),
        rrb.BlueprintPanel(state="collapsed"), rrb.SelectionPanel(state="collapsed"),
    )


def _plots(plots: tuple[Plot, ...], name: str) -> rrb.Vertical:
    return rrb.Vertical(*(plot_view([plot.origin], plot.title) for plot in plots), name=name)


def plot_view(origins: Sequence[str], title: str) -> rrb.TimeSeriesView:
    """Return a view of the curves logged under some origins, over the whole time."""
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
    # shows the whole kerf around the drawing
    away = sizes.height_mm + max(x1 - x0, y1 - y0, 1.0) + 4e-3 * sizes.wire_diameter_um
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
    """Return a view of the entities under an origin, without `hidden` and with `more`."""
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
    high = logs.VOLTAGE_HEIGHT + logs.SCOPE_SPACE + logs.CURRENT_HEIGHT
    return rrb.Spatial2DView(
        origin=f"{prefix}/scope", name=name, background=rrb.Background(color=palette.rgb(palette.INK)),
        visual_bounds=rrb.VisualBounds2D(x_range=(-26.0, logs.SCOPE_WIDTH + 10.0), y_range=(-6.0, high + 20.0)),
    )


def _history() -> rrb.VisibleTimeRanges:
    """Return the time range for drawing all of the path that was cut so far, not only its latest piece."""
    start, now = rr.TimeRangeBoundary.infinite(), rr.TimeRangeBoundary.cursor_relative()
    return rrb.VisibleTimeRanges([rr.VisibleTimeRange(name, start=start, end=now) for name in (TIME, PATH)])


# Steps of an environment in the recording: actions, rewards and costs.

RETURN, COST = "return", "cost"  # origins of rewards and costs in a recording
TOTAL = "total"  # curve of their sums since the beginning
_COLOURS = (
    palette.SKY, palette.ORANGE, palette.GREEN, palette.VERMILION, palette.PURPLE, palette.MUTED, palette.BLUE,
    palette.GAS,
)  # fmt: skip


class Steps(NamedTuple):
    """Data that an environment adds to the recording of its cut, per step."""

    plots: tuple[Plot, ...]  # views, whose curves are logged under their origins
    values: Mapping[str, Floats]  # values (n,) of every curve, by ``origin/entity``
    t_s: Floats  # t_s, path_um: machine time and place along the path at the end of every step
    path_um: Floats
    notes: Sequence[str]  # on the thinning of the cut, for the text about the recording


def steps_of(
    groups: Sequence[tuple[str, str, Sequence[str], Floats]], t_s: Floats, path_um: Floats, notes: Sequence[str],
) -> Steps:
    """Return curves in views; a group has origin, title with unit, names of curves, and values (n, curves)."""
    # NaN is not drawn, and curves that are always 0 are omitted
    plots, values = [], {}
    for origin, title, names, lines in groups:
        shown = [
            (name, column) for name, column in zip(names, lines.T, strict=True)
            if name == TOTAL or np.any(np.nan_to_num(column) != 0.0)
        ]  # fmt: skip
        if not shown:
            continue
        colours = (_COLOURS[k % len(_COLOURS)] for k in range(len(shown)))
        curves = [Series(name, name.replace("_", " "), c) for (name, _), c in zip(shown, colours, strict=True)]
        plots.append(Plot(origin, title, tuple(curves)))
        values.update({f"{origin}/{name}": column for name, column in shown})
    return Steps(tuple(plots), values, t_s, path_um, notes)


MOST = 300  # most listed events of a kind; if there are more, evenly spaced ones
_AT_CORNER_MM = 0.5  # greatest distance at which the wire passes a corner of the drawing
_LEVELS = {words.report: words.level for words in WORDS.values()}
_ALARM = WORDS[StopCause.PERSISTENT_SHORT].report


class Event(NamedTuple):
    """One event: its row in the table of windows, its level, and its text."""

    row: int
    level: str
    text: str


def events(windows: pa.Table, scene: Scene, report: Report) -> list[Event]:
    """Return the events of a cut in order of time, with places in the program's coordinates."""
    if len(windows) == 0:
        return []
    origin_um = 1e3 * np.array(scene.origin_mm or (0.0, 0.0))
    t_s = column(windows, "t_s")
    place = columns(windows, "x_um", "y_um") - origin_um
    kind = "alarm: " if report.outcome == _ALARM else ""
    found = [
        Event(0, "INFO", f"begins at {_at(place[0])}"),
        *_retracts(windows, place), *_threadings(t_s, place), *_settings(windows), *_passes(t_s, report.passes),
        *_corners(scene.in_program(), scene.axis_um(place, column(windows, "path_um"))),
        Event(len(windows) - 1, _LEVELS[report.outcome], kind + outcome_text(report)),
    ]  # fmt: skip
    return sorted(found, key=lambda event: event.row)


def _at(place_um: Floats) -> str:
    return "X {} Y {} mm".format(*map(mm_text, (place_um * 1e-3).tolist()))


def _thinned(found: list[Event]) -> list[Event]:
    return [found[i] for i in _evenly(len(found), MOST)]


def _evenly(count: int, most: int) -> NDArray[np.intp]:
    """Return at most `most` evenly spaced numbers from 0 to ``count - 1``, with both ends."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))


def _retracts(windows: pa.Table, place: Floats) -> list[Event]:
    back = column(windows, "feed_um_s") < 0
    begins = np.flatnonzero(back & ~np.concatenate([[False], back[:-1]]))
    ends = np.flatnonzero(back & ~np.concatenate([back[1:], [False]]))
    path, short = column(windows, "path_um"), 100.0 * column(windows, "short") / WINDOW_PULSES
    return _thinned(
        [
            Event(a, "WARN", f"retract at {_at(place[a])}: {short[max(a - 1, 0)]:.0f} % short, "
                                  f"{path[max(a - 1, 0)] - path[b]:.0f} µm back")
            for a, b in zip(begins.tolist(), ends.tolist(), strict=True)
        ]
    )  # fmt: skip


def _threadings(t_s: Floats, place: Floats) -> list[Event]:
    gone = pause_rows(t_s)
    return _thinned(
        [Event(int(i), "INFO", f"wire threaded at {_at(place[i])} after {t_s[i] - t_s[i - 1]:.0f} s") for i in gone]
    )


def _settings(windows: pa.Table) -> list[Event]:
    on, period = column(windows, "t_on_us"), column(windows, "t_period_us")
    changed = np.flatnonzero((np.diff(on) != 0) | (np.diff(period) != 0)) + 1
    return _thinned([Event(int(i), "INFO", f"generator set to {on[i]:g} µs of {period[i]:g} µs") for i in changed])


def _passes(t_s: Floats, passes: Sequence[PassFigures]) -> list[Event]:
    return [
        Event(
            min(int(np.searchsorted(t_s, row.begin_s)), len(t_s) - 1), "INFO",
            f"pass {row.number} of the {row.piece} begins, offset {row.offset_um / 1e3:.3f} mm",
        )
        for row in passes
    ]  # fmt: skip


def _corners(scene: Scene, place: Floats) -> list[Event]:
    found = []
    for corner in scene.corners:
        away = np.hypot(*(place / 1000.0 - (corner.x_mm, corner.y_mm)).T)
        nearest = int(away.argmin())
        if away[nearest] <= _AT_CORNER_MM:
            error = f", error {corner.error_um:+.1f} µm" if np.isfinite(corner.error_um) else ""
            where = _at(np.array([corner.x_mm, corner.y_mm]) * 1000.0)
            found.append(Event(nearest, "INFO", f"corner of {corner.turn_deg:+.0f}° at {where}{error}"))
    return _thinned(found)


# Writing of a recording.

_Args = ParamSpec("_Args")


def releasing(write: Callable[_Args, None]) -> Callable[_Args, None]:
    """Decorate a function to release the recordings it has disconnected, and their threads, when it returns."""

    @wraps(write)
    def released(*args: _Args.args, **options: _Args.kwargs) -> None:
        try:
            write(*args, **options)
        finally:
            with suppress(RuntimeError):  # a forked process cannot flush its parent's recordings, and need not
                bindings.flush_and_cleanup_orphaned_recordings()

    return released


@contextmanager
def saved(recording: rr.RecordingStream, file: str | Path, layout: rrb.Blueprint) -> Iterator[None]:
    """Write all that is logged in the block to a file, which is replaced only when complete; then disconnect."""
    # rerun's own file sink waits forever on a full disk, and accepts only names that are UTF-8
    memory = recording.memory_recording()
    try:
        _send_blueprint(recording, layout)
        yield
        recording.flush()
        with replacing(file) as partial:
            partial.write_bytes(memory.drain_as_bytes())
    finally:
        recording.disconnect()


def _send_blueprint(recording: rr.RecordingStream, layout: rrb.Blueprint) -> None:
    """Make a layout the default, as rerun does, but disconnect its stream, which rerun would keep forever."""
    name = rr.get_application_id(recording)
    assert name is not None
    made = bindings.new_blueprint(name, make_default=False, make_thread_default=False, default_enabled=True)
    stream = rr.RecordingStream._from_native(made)
    stream.set_time("blueprint", sequence=0)
    layout._log_to_stream(stream)
    storage = stream.memory_recording().storage
    bindings.send_blueprint(storage, make_active=False, make_default=True, recording=recording.to_native())
    stream.disconnect()


MAX_ROWS = 20_000  # most rows of a series; longer tables are averaged in groups of rows


@releasing
def write_recording(
    file: str | Path, scene: Scene, windows: pa.Table, frames: Frames, closeups: Closeups, machine: Machine,
    report: Report, title: str, steps: Steps | None = None,
) -> None:  # fmt: skip
    """Write the recording; equal cuts give equal recordings, independent of computing time."""
    closeup_rows = closeups.table()
    shapes = logs.shapes_of(frames, closeup_rows)
    factor = round_factor(np.hypot(*np.moveaxis(shapes["deflection_um"], -1, 0)).ravel(), 0.05 * scene.size_mm())
    # no batches by time, because they would differ from run to run
    recording = rr.RecordingStream(
        APPLICATION, recording_id=recording_id(report), send_properties=False,
        batcher_config=rr.ChunkBatcherConfig.NEVER(),
    )  # fmt: skip
    sizes = Sizes(
        scene.size_mm(), scene.height_mm, scene.wire_diameter_um, *scene.extent_mm(), factor, scene.error_factor(),
        end_s=float(shapes["t_s"][-1]) if len(shapes) else 0.0,
    )
    with saved(recording, file, blueprint(sizes, steps.plots if steps else ())):
        recording.send_recording_name(title)
        made = {"format": FORMAT, "version": report.edmsim_version, "sizes": list(sizes)}
        recording.log(MADE_BY, rr.TextDocument(json.dumps(made)), static=True)
        tolerance_mm = _log_machine(recording, scene, windows, machine, factor)
        if len(shapes):
            logs.log_motion(recording, scene, shapes, factor)
            logs.log_coverage(recording, scene, shapes)
            logs.log_bubbles(recording, scene, shapes, logs.travel_at(windows, shapes["t_s"]), factor)
        if len(closeup_rows):
            above = _at_the_wall(scene, closeup_rows)
            logs.log_discharges(recording, scene, closeup_rows)
            logs.log_gap(recording, scene, above)
            logs.log_scope(recording, closeup_rows)
            logs.log_top_bubbles(recording, scene, above)
        shown = events(windows, scene, report)
        rows = np.array([event.row for event in shown], np.int64)
        group = _log_series(recording, windows, rows, report.passes)
        _log_events(recording, windows, shown)
        if steps is not None:
            _log_steps(recording, steps)
        notes = [_thinning(frames, closeups)] if steps is None else steps.notes
        text = about(scene, report, title, factor, [*notes, _drawn(group, tolerance_mm)])
        recording.log("about", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)


def _at_the_wall(scene: Scene, closeups: NDArray[np.void]) -> NDArray[np.void]:
    """Return close-ups; if the wire leans, guides' axis and discharges are shifted to the height of the wall."""
    if scene.lead is None:
        return closeups
    found, slices, path_um = closeups.copy(), closeups["deflection_um"].shape[1], closeups["path_um"]
    found["guides_um"] = scene.axis_um(closeups["guides_um"], path_um, scene.middle_mm())
    heights_mm = scene.height_mm * (np.arange(slices) + 0.5) / slices
    led_um = closeups["guides_um"][:, None] + 1e3 * scene.lead_mm(path_um, heights_mm) - found["guides_um"][:, None]
    at_slice = np.maximum(closeups["pulses"]["slice"], 0).astype(np.int64)
    for axis, name in enumerate(("x_um", "y_um")):
        found["pulses"][name] -= np.take_along_axis(led_um[..., axis], at_slice, axis=1)
    return found


def _log_machine(
    recording: rr.RecordingStream, scene: Scene, windows: pa.Table, machine: Machine, factor: float
) -> float:
    """Log machine, workpiece and static entities; return the tolerance in mm of the growing kerf's edge."""
    t_s, path_um = column(windows, "t_s"), column(windows, "path_um")
    model = build_model(wire_setup(machine), machine.base.model)
    logs.log_bodies(recording, logs.bodies_of(model, scene.guides_z_mm[0]))
    growth = logs.growing_kerf(scene, columns(windows, "x_um", "y_um"), path_um)
    logs.log_workpiece(recording, growth, t_s, path_um)
    logs.log_drawing(recording, scene)
    logs.log_errors(recording, scene)
    logs.log_faces(recording, scene)
    logs.log_marks(recording, scene, factor)
    logs.log_gap_marks(recording, scene)
    return growth.tolerance_mm


def _thinning(frames: Frames, closeups: Closeups) -> str:
    """Return how the cut's windows are thinned in the recording."""
    return (
        f"The wire's shape and its gas: one window of {frames.stride}. Discharges, top view and oscilloscope: one of "
        f"{closeups.stride}; around retracts and corners, and at the end, all of them ({AROUND} before, {AROUND} "
        f"after; of many retracts, some). Of such a window its last {PULSES} pulses are kept."
    )


def _drawn(group: int, tolerance_mm: float) -> str:
    """Return how finely series and kerf are drawn."""
    return (
        "A point of a series is "
        + ("one window." if group == 1 else f"the mean of {group} windows, around events one window.")
        + f" The kerf grows in at most {logs.KERF_FRAMES} steps, its edge drawn within {tolerance_mm * 1000:g} µm."
    )


def recording_id(report: Report) -> str:
    """Return the identity of the recording: a digest of version, seed and settings."""
    made_with = {key: report[key] for key in ("edmsim_version", "seed", "settings")}
    return hashlib.sha256(json.dumps(made_with, sort_keys=True).encode()).hexdigest()[:32]


def about(scene: Scene, report: Report, title: str, factor: float, thinning: list[str]) -> str:
    """Return the text about the recording, as Markdown."""
    lines = [
        f"# {title}",
        f"**{report.outcome}**" + (f": {report.reason}" if report.reason else ""),
        f"{duration_text(report.machining_time_s)}, {report.text('path_length_mm')}, {rate_text(report)}, "
        f"profile error {report.profile_error_um.worst_and_rms}",
        "## How it is drawn",
        "- In the machine view the wire stands and the table moves; the view from above moves with the table.",
        f"- Wire deflection is drawn **× {factor:g}** there, the profile error **× {scene.error_factor():g}** "
        "(blue: too much removed, orange: metal left). All else is to scale, in mm.",
        "- The view at the wire is to scale, in µm, at mid height; its cross is the guides' axis as commanded. "
        "Every ray that meets metal is drawn from the wire to it, the redder the narrower.",
        *(
            ["- The coloured face is the cut face as the last pass that ended left it, where it is off its own mean."]
            if scene.pass_faces else []
        ),
        "- Discharges are drawn on the metal, in the middle of their slice of height, and fade: "
        "blue sparks, pink arcs, red contacts.",
        "- Pale bubbles show gas on the wire's front, one for every slice: where gas covers a slice wholly, it is as "
        "wide as the slice is high; its area grows with the share. In the view at the wire it lies at the slice's "
        "last discharge and is as wide as that share of the wire's front half.",
        "- The oscilloscope shows the model's pulses: voltage until ignition, then burning; no rise times.",
        *(f"- {line}" for line in thinning),
        "## Settings",
        *(f"- {name}: {value}" for name, value in settings_in_words(report)),
    ]
    return "\n\n".join(lines[:3]) + "\n\n" + "\n".join(lines[3:])


def _log_events(recording: rr.RecordingStream, windows: pa.Table, shown: list[Event]) -> None:
    if shown:
        rows = np.array([event.row for event in shown])
        recording.send_columns(
            "events",
            logs.indexes(column(windows, "t_s")[rows], column(windows, "path_um")[rows]),
            rr.TextLog.columns(text=[event.text for event in shown], level=[event.level for event in shown]),
        )


def _log_series(
    recording: rr.RecordingStream, windows: pa.Table, event_rows: NDArray[np.int64], passes: Sequence[PassFigures]
) -> int:
    """Log every series; return the number of windows per point away from events."""
    rows = len(windows)
    group = max(1, -(-rows // MAX_ROWS))
    if rows:
        known = {*windows.column_names, "lag_um"}
        curves = (
            (f"{plot.origin}/{series.entity}", series, quantity(windows, series.entity))
            for plot in PROCESS + ELECTRICAL for series in plot.series if series.entity in known
        )  # fmt: skip
        times = column(windows, "t_s"), column(windows, "path_um")
        _log_curves(recording, curves, *times, group_starts(rows, group, event_rows), passes)
    return group


def _log_steps(recording: rr.RecordingStream, steps: Steps) -> None:
    """Log the steps of an environment; of a long episode, the means of groups of steps."""
    starts = np.arange(0, len(steps.t_s), max(1, -(-len(steps.t_s) // MAX_ROWS)))
    if len(starts):
        entities = ((f"{plot.origin}/{series.entity}", series) for plot in steps.plots for series in plot.series)
        curves = ((entity, series, steps.values[entity]) for entity, series in entities)
        _log_curves(recording, curves, steps.t_s, steps.path_um, starts)


def _log_curves(
    recording: rr.RecordingStream, curves: Iterable[tuple[str, Series, Floats]], t_s: Floats, path_um: Floats,
    starts: NDArray[np.int64], passes: Sequence[PassFigures] = (),
) -> None:
    """Log curves (entity, look, values) as means of groups of rows, without NaN."""
    # each pass also has its own timeline, which starts with the pass
    pauses = pause_rows(t_s)
    starts = np.union1d(starts, pauses)  # no mean over a pause
    threaded = logs.indexes(t_s[pauses - 1] + THREADING_S / 2, path_um[pauses - 1])
    mean_t_s, mean_path_um = group_means(t_s, starts), group_means(path_um, starts)
    for entity, series, values in curves:
        mean = group_means(values, starts)
        known = np.isfinite(mean)
        if not known.any():  # it would hide the other curves of its view
            continue
        look = rr.SeriesLines(names=[series.name], colors=[palette.rgb(series.colour)], widths=[1.3])
        when = logs.indexes(mean_t_s[known], mean_path_um[known])
        logs.log_changing(recording, entity, look, when, rr.Scalars.columns(scalars=mean[known]))
        _log_by_pass(recording, entity, passes, mean_t_s, mean)
        if len(pauses):  # cleared values interrupt the drawn line
            recording.send_columns(entity, threaded, rr.Clear.columns(is_recursive=[False] * len(pauses)))


def _log_by_pass(
    recording: rr.RecordingStream, entity: str, passes: Sequence[PassFigures], t_s: Floats, values: Floats
) -> None:
    """Log a curve on the timeline of each pass, such as ``pass_1``, or ``tab_1`` for a tab's."""
    for row in passes:
        mine = (t_s > row.begin_s) & (t_s <= row.end_s) & np.isfinite(values)
        contour = "" if row.contour == 1 else f"_of_contour_{row.contour}"
        name = f"{'tab' if row.piece == 'tab' else 'pass'}_{row.number}{contour}"
        if mine.any():
            when = [rr.TimeColumn(name, duration=t_s[mine] - row.begin_s)]
            recording.send_columns(entity, when, rr.Scalars.columns(scalars=values[mine]))


def group_starts(rows: int, size: int, event_rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the first row of every group: `size` rows each, but single rows up to `AROUND` rows from an event."""
    # at most `MAX_ROWS` rows around events; if there are more, evenly spaced events are chosen
    most = MAX_ROWS // (2 * AROUND + 1)
    chosen = event_rows[_evenly(len(event_rows), most)]
    near = (chosen[:, None] + np.arange(-AROUND, AROUND + 2)).ravel()
    return np.unique(np.concatenate([np.arange(0, rows, size), near[(near >= 0) & (near < rows)]]))
