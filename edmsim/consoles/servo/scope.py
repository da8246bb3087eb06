"""The scope of the UHU's terminal program: the tracking error as a curve over a moving time line, drawn by rerun."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edmsim.axis_bench.loop import SAMPLE_ROW
from edmsim.controllers.axis.drive import data_of
from edmsim.errors import InputError
from edmsim.files import make_writable
from edmsim.recording.rerun.viewer import LiveViewer

_DATA = 0x80
_TIME = "simulated_time"
_CURVES = "duty", "current_A", "place_um", "speed_rad_s"  # curves besides the stream: columns of the bench's notes
_BATCH_S = 0.1
"""Simulated time of what is drawn at once (ours); every piece has a head: with 100 a second files were four times
as large."""


class Scope:
    """Curves of a drive in rerun, live or in a recording; `streams` is whether the drive sends its tracking error."""

    def __init__(self, live: bool, file: Path | None, streams: bool = True) -> None:
        import rerun as rr
        import rerun.blueprint as rrb

        if file is not None:
            make_writable(file.parent)
            if file.is_dir():
                raise InputError("the recording is to be a file, for example scope.rrd, and this is a folder", file)
        error = [rrb.TimeSeriesView(name="tracking error, counts", contents=["/tracking_error"])]
        views = [
            *(error if streams else []),
            *(rrb.TimeSeriesView(name=name.replace("_", " "), contents=[f"/{name}"]) for name in _CURVES),
        ]
        self._zero = int(data_of("uhu")["law"]["stream_zero"])
        self._recording = rr.RecordingStream("edmsim_servo")
        self._heard: list[tuple[int, float]] = []
        self._samples: list[NDArray[np.void]] = []
        self._drawn_s = 0.0
        self._viewer = LiveViewer("the scope", "--record FILE.rrd keeps the curves") if live else None
        # what to tell the user of the viewer; empty if none runs
        self.notice = self._viewer.notice if self._viewer else ""
        sinks: list[rr.GrpcSink | rr.FileSink] = [rr.GrpcSink(self._viewer.source)] if self._viewer else []
        sinks += [rr.FileSink(str(file))] if file is not None else []
        self._recording.set_sinks(*sinks, default_blueprint=rrb.Blueprint(rrb.Vertical(*views)))

    def draw(self, heard: Sequence[tuple[int, float]], samples: NDArray[np.void]) -> None:
        """Take bytes with their times, those of the analyser with bit 7, and the bench's notes; draw when enough."""
        self._heard += [(byte, at_s) for byte, at_s in heard if byte >= _DATA]
        self._samples.append(samples)
        if len(samples) and samples["time_ns"][-1] * 1e-9 >= self._drawn_s + _BATCH_S:
            self._draw_batch()

    def _draw_batch(self) -> None:
        heard, self._heard = self._heard, []
        blocks, self._samples = self._samples, []
        if heard:
            errors = np.array([byte - _DATA - self._zero for byte, _ in heard])
            self._send("tracking_error", np.array([at_s for _, at_s in heard]), errors)
        samples = np.concatenate(blocks) if blocks else np.zeros(0, SAMPLE_ROW)
        if len(samples):
            self._drawn_s = samples["time_ns"][-1] * 1e-9
            for name in _CURVES:
                self._send(name, samples["time_ns"] * 1e-9, samples[name])

    def _send(self, name: str, times_s: NDArray[np.float64], values: NDArray[np.float64]) -> None:
        import rerun as rr

        when = [rr.TimeColumn(_TIME, duration=times_s)]
        curve = rr.Scalars.columns(scalars=values.astype(np.float64))
        self._recording.send_columns(name, indexes=when, columns=curve)

    def close(self) -> None:
        """Draw what is left, write it, and let the viewer go."""
        self._draw_batch()
        self._recording.flush()
        self._recording.disconnect()
        if self._viewer is not None:
            self._viewer.close()
