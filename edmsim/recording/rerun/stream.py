"""Shared by all parts of a recording: timelines, colours of the classes, sizes on the screen."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import ParamSpec

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import rerun_bindings as bindings
from numpy.typing import NDArray

from edmsim.files import replacing
from edmsim.geometry import Floats
from edmsim.plant.kernel.state import ARC, OPEN, SHORT, SPARK
from edmsim.recording.figures import palette

TIME = "machine_time"  # timeline of machine time, a duration
PATH = "path_um"  # timeline of the place along the wire path, in whole um
CLASS_COLOURS = {"spark": palette.SKY, "open": palette.MUTED, "short": palette.VERMILION, "arc": palette.PURPLE}
"""Classes of pulses in the recording, whose ground is dark."""


_Args = ParamSpec("_Args")


def releasing(write: Callable[_Args, None]) -> Callable[_Args, None]:
    """Let a function release the recordings that it makes and disconnects, with their threads, when it is over."""

    @wraps(write)
    def released(*args: _Args.args, **options: _Args.kwargs) -> None:
        try:
            write(*args, **options)
        finally:
            bindings.flush_and_cleanup_orphaned_recordings()

    return released


@contextmanager
def saved(recording: rr.RecordingStream, file: str | Path, layout: rrb.Blueprint) -> Iterator[None]:
    """Write what is logged inside to a file, which is replaced whole or not at all; the recording is disconnected."""
    # rerun's own file sink waits for ever on a full disk, and takes no names that are not UTF-8
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
    """Make a layout the default one, as rerun does, and disconnect the stream for it, which rerun keeps for ever."""
    name = rr.get_application_id(recording)
    assert name is not None
    made = bindings.new_blueprint(name, make_default=False, make_thread_default=False, default_enabled=True)
    stream = rr.RecordingStream._from_native(made)
    stream.set_time("blueprint", sequence=0)
    layout._log_to_stream(stream)
    storage = stream.memory_recording().storage
    bindings.send_blueprint(storage, make_active=False, make_default=True, recording=recording.to_native())
    stream.disconnect()


def class_rgb(kind: NDArray[np.int16]) -> NDArray[np.uint8]:
    """Return the colours (..., 3) of pulses' classes."""
    table = np.zeros((4, 3), np.uint8)
    for code, name in ((OPEN, "open"), (SPARK, "spark"), (ARC, "arc"), (SHORT, "short")):
        table[code] = palette.rgb(CLASS_COLOURS[name])
    return np.asarray(table[kind], np.uint8)


def faded(colours: NDArray[np.uint8], left: Floats) -> NDArray[np.uint8]:
    """Return colours (n, 3) sunk into the ground to a share `left` (n,) of 0 to 1."""
    ground = np.array(palette.rgb(palette.INK), float)
    return np.asarray(np.round(ground + (colours - ground) * left[:, None]), np.uint8)


def indexes(t_s: Floats, path_um: Floats) -> list[rr.TimeColumn]:
    """Return both timelines of rows."""
    return [rr.TimeColumn(TIME, duration=t_s), rr.TimeColumn(PATH, sequence=np.round(path_um).astype(np.int64))]


def turned(points: Floats) -> Floats:
    """Return points (..., 2) as a view of two dimensions needs them: rerun counts y downwards there."""
    return np.asarray(points * np.array([1.0, -1.0]), np.float64)


def on_screen(points: float) -> list[float]:
    """Return a radius in points of the screen, which rerun tells from a length by its sign."""
    return [-points]


def log_changing(
    recording: rr.RecordingStream, entity: str, look: rr.AsComponents, when: list[rr.TimeColumn],
    columns: rr.ComponentColumnList,
) -> None:
    """Log what stays of an entity, its look, and what changes."""
    recording.log(entity, look, static=True)
    recording.send_columns(entity, when, columns)


def at_height(lines: Iterable[Floats], z_mm: float) -> list[Floats]:
    """Return lines (n, 2) as lines (n, 3) at a height."""
    return [np.column_stack([line, np.full(len(line), z_mm)]) for line in lines]


def log_lines(recording: rr.RecordingStream, entity: str, strips: list[Floats], colour: str) -> None:
    """Log lines in space that stay."""
    if strips:
        lines = rr.LineStrips3D(strips, colors=[palette.rgb(colour)], radii=on_screen(0.8))
        recording.log(entity, lines, static=True)


def log_points(
    recording: rr.RecordingStream, entity: str, places: list[tuple[float, float, float]], labels: list[str],
    colour: str,
) -> None:
    """Log labelled points that stay."""
    if places:
        points = rr.Points3D(places, labels=labels, colors=[palette.rgb(colour)], radii=on_screen(4.0))
        recording.log(entity, points, static=True)
