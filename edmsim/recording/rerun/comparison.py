"""Two cuts side by side: one recording with both, A and B, and a layout of its own."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from edmsim.recording.figures import palette
from edmsim.recording.rerun.blueprint import (
    Sizes,
    events_view,
    gap_view,
    playback_speed,
    plot_view,
    scope_view,
    workpiece_view,
)
from edmsim.recording.rerun.playback import APPLICATION, Playback, read_chunks
from edmsim.recording.rerun.stream import PATH, saved

if TYPE_CHECKING:
    import rerun.blueprint as rrb

SIDES = (("a", "A", palette.SKY), ("b", "B", palette.ORANGE))
"""Each cut's place in the recording, its letter and the colour of its curves."""
CURVES = (
    ("pulses/short", "short, %"),
    ("pulses/open", "open, %"),
    ("feed/feed_um_s", "feed, µm/s"),
    ("gap/gap_um", "gap, µm"),
    ("gap/lag_um", "wire lag, µm"),
    ("gap/error_um", "profile error, µm"),
    ("gas/coverage", "gas on the wire's front, share"),
)
"""Curves in which the cuts are compared, and the titles of their views."""
OF_EPISODES = (("earned/total", "return so far"), ("cost/total", "cost so far"))
"""Those that episodes of environments have besides; without them where neither is one."""


def write_comparison(file: Path, a: Path, b: Path) -> None:
    """Write two recordings as one that shows them side by side.

    Parameters
    ----------
    file : path
        What to write.
    a, b : path
        Recordings of cuts.

    Raises
    ------
    InputError
        As `edmsim.recording.rerun.playback.find_recording` for either.
    """
    import rerun as rr

    plays = [Playback(a), Playback(b)]
    folders = [play.recording.resolve().parent.name for play in plays]
    names = [f"{letter}: {folder}" for (_, letter, _), folder in zip(SIDES, folders, strict=True)]
    recording = rr.RecordingStream(APPLICATION, recording_id="comparison", send_properties=False)
    curves = CURVES + tuple(curve for curve in OF_EPISODES if any(f"/{curve[0]}" in _entities(p) for p in plays))
    with saved(recording, file, _blueprint([Sizes(*play.sizes) for play in plays], names, curves)):
        recording.send_recording_name(" and ".join(names))
        for (place, letter, colour), play in zip(SIDES, plays, strict=True):
            chunks = read_chunks(play.recording)
            recording.send_chunks(
                [chunk.with_entity_path(f"/{place}{chunk.entity_path}") for chunk in chunks
                 if not chunk.entity_path.startswith("/__")]
            )  # fmt: skip
            for entity, _ in curves:
                line = rr.SeriesLines(names=[letter], colors=[palette.rgb(colour)], widths=[1.3])
                recording.log(f"{place}/{entity}", line, static=True)


def _entities(play: Playback) -> set[str]:
    return {str(chunk.entity_path) for chunk in read_chunks(play.recording)}


def _blueprint(sizes: list[Sizes], names: list[str], curves: tuple[tuple[str, str], ...]) -> rrb.Blueprint:
    import rerun.blueprint as rrb

    columns = [
        rrb.Vertical(
            workpiece_view(size, f"/{place}", f"{name} (wire deflection × {size.deflection_factor:g})"),
            gap_view(size, f"/{place}", f"{letter}, at the wire from above, µm, to scale"),
            scope_view(f"/{place}", f"{letter}, gap voltage and current"),
            row_shares=[4, 4, 3],
        )
        for (place, letter, _), size, name in zip(SIDES, sizes, names, strict=True)
    ]  # fmt: skip
    plots = [plot_view([f"{place}/{entity}" for place, *_ in SIDES], title) for entity, title in curves]
    told = rrb.Horizontal(*(events_view(f"/{place}", f"{letter}, events") for place, letter, _ in SIDES))
    return rrb.Blueprint(
        rrb.Horizontal(*columns, rrb.Vertical(*plots, told), column_shares=[3, 3, 4]),
        rrb.TimePanel(state="collapsed", timeline=PATH, playback_speed=playback_speed(max(s.end_s for s in sizes))),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )
