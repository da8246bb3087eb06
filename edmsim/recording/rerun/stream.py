"""Shared by all parts of a recording: timelines, how it is written."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import ParamSpec

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import rerun_bindings as bindings

from edmsim.files import replacing
from edmsim.geometry import Floats

TIME = "machine_time"  # timeline of machine time, a duration
PATH = "path_um"  # timeline of the place along the wire path, in whole um
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


def indexes(t_s: Floats, path_um: Floats) -> list[rr.TimeColumn]:
    """Return both timelines of rows."""
    return [rr.TimeColumn(TIME, duration=t_s), rr.TimeColumn(PATH, sequence=np.round(path_um).astype(np.int64))]


def log_changing(
    recording: rr.RecordingStream, entity: str, look: rr.AsComponents, when: list[rr.TimeColumn],
    columns: rr.ComponentColumnList,
) -> None:
    """Log what stays of an entity, its look, and what changes."""
    recording.log(entity, look, static=True)
    recording.send_columns(entity, when, columns)
