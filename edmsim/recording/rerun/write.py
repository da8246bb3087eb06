"""``cut.rrd``: the cut as a rerun recording: machine, gap, oscilloscope, events and the series of the windows."""

import hashlib
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

from edmsim.cosim.stops import WORDS, StopCause
from edmsim.geometry import Floats
from edmsim.machine.machine import Machine
from edmsim.machine.setting import WINDOW_PULSES
from edmsim.plant.constants import wire_setup
from edmsim.plant.mechanics.model import build_model
from edmsim.recording.figures import palette
from edmsim.recording.report import PassFigures, Report, duration_text, mm_text, outcome_text, rate_text
from edmsim.recording.rerun import gap as log_gap
from edmsim.recording.rerun import machine as log_machine
from edmsim.recording.rerun.blueprint import ELECTRICAL, PROCESS, Series, Steps, blueprint, sizes_of
from edmsim.recording.rerun.machine import KERF_FRAMES, bodies_of, growing_kerf, shapes_of
from edmsim.recording.rerun.playback import APPLICATION, FORMAT, MADE_BY
from edmsim.recording.rerun.stream import indexes, log_changing, releasing, saved
from edmsim.recording.scene import Scene, round_factor
from edmsim.recording.stores import AROUND, PULSES, Closeups, Frames
from edmsim.recording.windows import (
    EQUALISING_COLUMNS,
    THREADING_S,
    column,
    columns,
    group_means,
    lag_along_um,
    pause_rows,
)

MOST = 300  # most events of a kind that are listed; of more, evenly spaced ones
_AT_CORNER_MM = 0.5  # the wire passes a corner of the drawing at most this far away
_LEVELS = {words.report: words.level for words in WORDS.values()}
_ALARM = WORDS[StopCause.PERSISTENT_SHORT].report


class Event(NamedTuple):
    """One event: the row of the table of windows it belongs to, its weight, and what happened."""

    row: int
    level: str
    text: str


def events(windows: pa.Table, scene: Scene, report: Report) -> list[Event]:
    """Return the events of a cut in order of time, places in the program's coordinates."""
    if len(windows) == 0:
        return []
    scene, origin_um = scene.in_program(), 1e3 * np.array(scene.origin_mm or (0.0, 0.0))
    t_s = column(windows, "t_s")
    place = columns(windows, "x_um", "y_um") - origin_um
    kind = "alarm: " if report.outcome == _ALARM else ""
    found = [
        Event(0, "INFO", f"begins at {_at(place[0])}"),
        *_retracts(windows, place), *_threadings(t_s, place), *_settings(windows), *_passes(t_s, report.passes),
        *_corners(scene, place),
        Event(len(windows) - 1, _LEVELS[report.outcome], kind + outcome_text(report)),
    ]  # fmt: skip
    return sorted(found, key=lambda event: event.row)


def _at(place_um: Floats) -> str:
    x_um, y_um = place_um.tolist()
    return f"X {mm_text(x_um * 1e-3)} Y {mm_text(y_um * 1e-3)} mm"


def _thinned(found: list[Event]) -> list[Event]:
    return [found[i] for i in _evenly(len(found), MOST)]


def _evenly(count: int, most: int) -> NDArray[np.intp]:
    """Return numbers of 0 to ``count - 1`` evenly spaced, the ends among them; of many, `most`."""
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


MAX_ROWS = 20_000  # most rows of a series; a longer table is averaged in groups


@releasing
def write_recording(
    file: str | Path, scene: Scene, windows: pa.Table, frames: Frames, closeups: Closeups, machine: Machine,
    report: Report, title: str, steps: Steps | None = None,
) -> None:  # fmt: skip
    """Write the recording; equal cuts give equal recordings, whatever the computer took for them."""
    closeup_rows = closeups.table()
    shapes = shapes_of(frames, closeup_rows)
    factor = round_factor(np.hypot(*np.moveaxis(shapes["deflection_um"], -1, 0)).ravel(), 0.05 * scene.size_mm())
    # batches cut off by a clock would differ from run to run
    recording = rr.RecordingStream(
        APPLICATION, recording_id=recording_id(report), send_properties=False,
        batcher_config=rr.ChunkBatcherConfig.NEVER(),
    )  # fmt: skip
    sizes = sizes_of(scene, factor, float(shapes["t_s"][-1]) if len(shapes) else 0.0)
    with saved(recording, file, blueprint(sizes, steps.plots if steps else ())):
        recording.send_recording_name(title)
        made = {"format": FORMAT, "version": report.edmsim_version, "sizes": list(sizes)}
        recording.log(MADE_BY, rr.TextDocument(json.dumps(made)), static=True)
        tolerance_mm = _log_machine(recording, scene, windows, machine, shapes, factor)
        log_gap.log_discharges(recording, scene, closeup_rows)
        above = _at_mid_height(scene, closeup_rows)
        log_gap.log_gap(recording, scene, above)
        log_gap.log_scope(recording, closeup_rows)
        log_gap.log_coverage(recording, scene, shapes)
        log_gap.log_bubbles(recording, scene, shapes, log_gap.travel_at(windows, shapes["t_s"]), factor)
        log_gap.log_top_bubbles(recording, scene, above)
        shown = events(windows, scene, report)
        rows = np.array([event.row for event in shown], np.int64)
        group = _log_series(recording, windows, rows, report.passes)
        _log_events(recording, windows, shown)
        if steps is not None:
            _log_steps(recording, steps)
        notes = [_thinning(frames, closeups)] if steps is None else steps.notes
        text = about(scene, report, title, factor, [*notes, _drawn(group, tolerance_mm)])
        recording.log("about", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)


def _at_mid_height(scene: Scene, closeups: NDArray[np.void]) -> NDArray[np.void]:
    """Return close-ups whose guides' axis is where a wire that leans would be at mid height without deflection."""
    if scene.lead is None:
        return closeups
    found = closeups.copy()
    found["guides_um"] += 1e3 * scene.lead_mm(closeups["path_um"], np.array([0.5 * scene.height_mm]))[:, 0]
    return found


def _log_machine(
    recording: rr.RecordingStream, scene: Scene, windows: pa.Table, machine: Machine, shapes: NDArray[np.void],
    factor: float,
) -> float:
    """Log machine, workpiece and wire; return within how many mm the growing kerf is drawn."""
    t_s, path_um = column(windows, "t_s"), column(windows, "path_um")
    model = build_model(wire_setup(machine), machine.base.model)
    log_machine.log_bodies(recording, bodies_of(model, scene.guides_z_mm[0]))
    growth = growing_kerf(scene, columns(windows, "x_um", "y_um"), path_um)
    log_machine.log_workpiece(recording, growth, t_s, path_um)
    log_machine.log_drawing(recording, scene)
    log_machine.log_errors(recording, scene)
    log_machine.log_faces(recording, scene)
    log_machine.log_marks(recording, scene, factor)
    log_machine.log_motion(recording, scene, shapes, factor)
    return growth.tolerance_mm


def _thinning(frames: Frames, closeups: Closeups) -> str:
    """Say what of the cut's windows is in the recording and what was left out."""
    return (
        f"The wire's shape and its gas: one window of {frames.stride}. Discharges, top view and oscilloscope: one of "
        f"{closeups.stride}; around retracts and corners, and at the end, all of them ({AROUND} before, {AROUND} "
        f"after; of many retracts, some). Of such a window its last {PULSES} pulses are kept."
    )


def _drawn(group: int, tolerance_mm: float) -> str:
    """Say how finely series and kerf are drawn."""
    return (
        "A point of a series is "
        + ("one window." if group == 1 else f"the mean of {group} windows, around events one window.")
        + f" The kerf grows in at most {KERF_FRAMES} steps, its edge drawn within {tolerance_mm * 1000:g} µm."
    )


def recording_id(report: Report) -> str:
    """Return the recording's identity: a digest of version, seed and settings."""
    made_with = {key: report[key] for key in ("edmsim_version", "seed", "settings")}
    return hashlib.sha256(json.dumps(made_with, sort_keys=True).encode()).hexdigest()[:32]


def about(scene: Scene, report: Report, title: str, factor: float, thinning: list[str]) -> str:
    """Return what a viewer of the recording needs to know, as Markdown."""
    lines = [
        f"# {title}",
        f"**{report.outcome}**" + (f": {report.reason}" if report.reason else ""),
        f"{duration_text(report.machining_time_s)}, {report.text('path_length_mm')}, {rate_text(report)}, "
        f"profile error {report.profile_error_um.worst_and_rms}",
        "## How it is drawn",
        "- In the machine view the wire stands and the table moves; the view from above moves with the table.",
        f"- Wire deflection is drawn **× {factor:g}** there, the profile error **× {scene.error_factor():g}** "
        "(blue: too much removed, orange: metal left). All else is to scale, in mm.",
        "- The view at the wire is to scale, in µm, at mid height; it moves with the guides, whose axis is the "
        "cross. Every ray that meets metal is drawn from the wire to it, the redder the narrower.",
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
        f"- seed: {report.seed}",
        *(f"- {key}: {value}" for key, value in report.settings.items()),
    ]
    return "\n\n".join(lines[:3]) + "\n\n" + "\n".join(lines[3:])


def _log_events(recording: rr.RecordingStream, windows: pa.Table, shown: list[Event]) -> None:
    if shown:
        rows = np.array([event.row for event in shown])
        recording.send_columns(
            "events",
            indexes(column(windows, "t_s")[rows], column(windows, "path_um")[rows]),
            rr.TextLog.columns(text=[event.text for event in shown], level=[event.level for event in shown]),
        )


def _log_series(
    recording: rr.RecordingStream, windows: pa.Table, event_rows: NDArray[np.int64], passes: Sequence[PassFigures]
) -> int:
    """Log every series; return how many windows each of its points is the mean of, away from events."""
    rows = len(windows)
    group = max(1, -(-rows // MAX_ROWS))
    if rows:
        absent = {extra.name for extra in EQUALISING_COLUMNS} - set(windows.column_names)
        curves = (
            (f"{plot.origin}/{series.entity}", series, _values(windows, series.entity))
            for plot in PROCESS + ELECTRICAL for series in plot.series if series.entity not in absent
        )  # fmt: skip
        times = column(windows, "t_s"), column(windows, "path_um")
        _log_curves(recording, curves, *times, group_starts(rows, group, event_rows), passes)
    return group


def _log_steps(recording: rr.RecordingStream, steps: Steps) -> None:
    """Log what an environment adds; a long episode as the means of neighbouring steps."""
    starts = np.arange(0, len(steps.t_s), max(1, -(-len(steps.t_s) // MAX_ROWS)))
    if len(starts):
        entities = ((f"{plot.origin}/{series.entity}", series) for plot in steps.plots for series in plot.series)
        curves = ((entity, series, steps.values[entity]) for entity, series in entities)
        _log_curves(recording, curves, steps.t_s, steps.path_um, starts)


def _log_curves(
    recording: rr.RecordingStream, curves: Iterable[tuple[str, Series, Floats]], t_s: Floats, path_um: Floats,
    starts: NDArray[np.int64], passes: Sequence[PassFigures] = (),
) -> None:
    """Log curves as the means of groups of rows: entity, look and values of each, of which NaN is left out."""
    # each pass has a timeline of its own besides, from its begin on
    pauses = pause_rows(t_s)
    starts = np.union1d(starts, pauses)  # no mean reaches over a pause
    threaded = indexes(t_s[pauses - 1] + THREADING_S / 2, path_um[pauses - 1])
    mean_t_s, mean_path_um = group_means(t_s, starts), group_means(path_um, starts)
    for entity, series, values in curves:
        look = rr.SeriesLines(names=[series.name], colors=[palette.rgb(series.colour)], widths=[1.3])
        mean = group_means(values, starts)
        known = np.isfinite(mean)
        when = indexes(mean_t_s[known], mean_path_um[known])
        log_changing(recording, entity, look, when, rr.Scalars.columns(scalars=mean[known]))
        _log_by_pass(recording, entity, passes, mean_t_s, mean)
        if len(pauses):  # a viewer draws no line over what is cleared
            recording.send_columns(entity, threaded, rr.Clear.columns(is_recursive=[False] * len(pauses)))


def _log_by_pass(
    recording: rr.RecordingStream, entity: str, passes: Sequence[PassFigures], t_s: Floats, values: Floats
) -> None:
    """Log a curve on the timeline of each pass, ``pass_1`` and so on; a tab's follow, as ``tab_1``."""
    for row in passes:
        mine = (t_s > row.begin_s) & (t_s <= row.end_s) & np.isfinite(values)
        contour = "" if row.contour == 1 else f"_of_contour_{row.contour}"
        name = f"{'tab' if row.piece == 'tab' else 'pass'}_{row.number}{contour}"
        if mine.any():
            when = [rr.TimeColumn(name, duration=t_s[mine] - row.begin_s)]
            recording.send_columns(entity, when, rr.Scalars.columns(scalars=values[mine]))


def _values(windows: pa.Table, name: str) -> Floats:
    """Return a column of the table; wire lag along the feed, pulse counts as a share in percent."""
    if name == "lag_um":
        return lag_along_um(windows)
    if name in ("short", "open", "spark", "arc"):
        total = sum(column(windows, kind) for kind in ("short", "open", "spark", "arc"))
        return np.asarray(100.0 * column(windows, name) / np.maximum(total, 1.0))
    return column(windows, name)


def group_starts(rows: int, size: int, event_rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the first row of every group: `size` rows each, but one only up to `AROUND` rows from an event."""
    # of many events only as many evenly spaced ones count as make `MAX_ROWS` rows
    most = MAX_ROWS // (2 * AROUND + 1)
    chosen = event_rows[_evenly(len(event_rows), most)]
    near = (chosen[:, None] + np.arange(-AROUND, AROUND + 2)).ravel()
    return np.unique(np.concatenate([np.arange(0, rows, size), near[(near >= 0) & (near < rows)]]))
