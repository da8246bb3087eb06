"""The scope of the consoles: curves over simulated time, drawn by rerun, live or in a recording.

The UHU's terminal program draws the tracking error in this way, over a moving time line.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.files import make_room

_TIME = "simulated_time"
_BATCH_S = 0.1
"""Simulated time of one batch of points (ours). Every batch has a header: with 100 a second, files were four times
as large."""


class Scope:
    """Curves in rerun, live or in a recording; `titles` are those of their views by the curves' names."""

    def __init__(self, live: bool, file: Path | None, titles: Mapping[str, str]) -> None:
        import rerun as rr
        import rerun.blueprint as rrb

        from edmsim.recording.rerun.viewer import LiveViewer

        if file is not None:
            make_room(file, "a recording of the scope", ".rrd")
            try:
                file.write_bytes(b"")  # because rerun prints a traceback for a file that it cannot create
            except OSError as error:
                raise InputError(f"the recording cannot be written: {error.strerror}", file) from None
        views = [rrb.TimeSeriesView(name=title, contents=[f"/{name}"]) for name, title in titles.items()]
        self._recording = rr.RecordingStream("edmsim_scope")
        self._waiting: dict[str, list[tuple[NDArray[np.float64], NDArray[Any]]]] = {}
        self._viewer = LiveViewer("the scope", "--record FILE.rrd keeps the curves") if live else None
        # message about the viewer; empty if none runs
        self.notice = self._viewer.notice if self._viewer else ""
        sinks: list[rr.GrpcSink | rr.FileSink] = [rr.GrpcSink(self._viewer.source)] if self._viewer else []
        sinks += [rr.FileSink(str(file))] if file is not None else []
        self._recording.set_sinks(*sinks, default_blueprint=rrb.Blueprint(rrb.Vertical(*views)))

    def draw(self, name: str, times_s: NDArray[np.float64], values: NDArray[Any]) -> None:
        """Add points to a curve; full batches are drawn."""
        if not len(times_s):
            return
        waiting = self._waiting.setdefault(name, [])
        waiting.append((times_s, values))
        if times_s[-1] >= waiting[0][0][0] + _BATCH_S:
            self._draw_batch()

    def _draw_batch(self) -> None:
        import rerun as rr

        for name, points in self._waiting.items():
            times_s, values = (np.concatenate(column) for column in zip(*points, strict=True))
            curve = rr.Scalars.columns(scalars=values.astype(np.float64))
            self._recording.send_columns(name, indexes=[rr.TimeColumn(_TIME, duration=times_s)], columns=curve)
        self._waiting.clear()

    def close(self) -> None:
        """Draw the last batch, write the recording and close the viewer."""
        self._draw_batch()
        self._recording.flush()
        self._recording.disconnect()
        if self._viewer is not None:
            self._viewer.close()


@contextmanager
def scope_for(
    live: bool, file: Path | None, titles: Mapping[str, str], say: Callable[[str], None]
) -> Iterator[Scope | None]:
    """Open the scope that a command's options ask for, if any, and close it at the end."""
    scope = Scope(live, file, titles) if live or file is not None else None
    if scope is not None and scope.notice:
        say(scope.notice)
    try:
        yield scope
    finally:
        if scope is not None:
            scope.close()
