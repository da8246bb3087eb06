"""The scope of the UHU's terminal program: the tracking error as a curve over a moving time line, drawn by rerun."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.axis.drive import data_of
from edmsim.files import make_writable

_DATA = 0x80
_TIME = "simulated_time"
_CURVES = "duty", "current_A", "place_um", "speed_rad_s"
"""Curves besides the stream: columns of the bench's notes."""


class Scope:
    """Curves of a drive in rerun.

    Parameters
    ----------
    live : bool
        Whether to open rerun's viewer and draw while the drive runs.
    file : path, optional
        Recording to write, ``.rrd``.

    Raises
    ------
    InputError
        If the file cannot be written.
    """

    def __init__(self, live: bool, file: Path | None) -> None:
        import rerun as rr
        import rerun.blueprint as rrb

        if file is not None:
            make_writable(file.parent)
        views = [
            rrb.TimeSeriesView(name="tracking error, counts", contents=["/tracking_error"]),
            *(rrb.TimeSeriesView(name=name.replace("_", " "), contents=[f"/{name}"]) for name in _CURVES),
        ]
        self._zero = int(data_of("uhu")["law"]["stream_zero"])
        self._recording = rr.RecordingStream("edmsim_servo")
        if live:
            self._recording.spawn(memory_limit="500MB")
        sinks = ([rr.GrpcSink()] if live else []) + ([rr.FileSink(str(file))] if file is not None else [])
        self._recording.set_sinks(*sinks, default_blueprint=rrb.Blueprint(rrb.Vertical(*views)))

    def draw(self, heard: Sequence[tuple[int, float]], samples: NDArray[np.void]) -> None:
        """Draw what has come since the last call.

        Parameters
        ----------
        heard : sequence of (int, float)
            Bytes of the drive with their times in s; those of the analyser have bit 7 set.
        samples : records of `SAMPLE_ROW`
            The bench's notes.
        """
        stream = [(byte - _DATA - self._zero, at_s) for byte, at_s in heard if byte >= _DATA]
        if stream:
            self._send("tracking_error", np.array([at for _, at in stream]), np.array([error for error, _ in stream]))
        if len(samples):
            for name in _CURVES:
                self._send(name, samples["time_ns"] * 1e-9, samples[name])

    def _send(self, name: str, times_s: NDArray[np.float64], values: NDArray[np.float64]) -> None:
        import rerun as rr

        when = [rr.TimeColumn(_TIME, duration=times_s)]
        curve = rr.Scalars.columns(scalars=values.astype(np.float64))
        self._recording.send_columns(name, indexes=when, columns=curve)

    def close(self) -> None:
        """Write what is left."""
        self._recording.flush()
        self._recording.disconnect()
