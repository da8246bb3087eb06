"""How far a cut is: share of the path, machine and wall time, feed, shorts and opens."""

from __future__ import annotations

import time

from edmsim.controllers.pulse_counters import percent_of_window
from edmsim.cosim.simulation import Progress
from edmsim.progress import ShownProgress
from edmsim.recording.report import duration_text

_EVERY_S = 0.1  # between two looks at a cut: windows are shorter (ours)


class CutProgress:
    """What `edmsim.cut` calls back, as a bar."""

    def __init__(self, bar: ShownProgress, name: str) -> None:
        self._bar, self._name = bar, name
        self._last: Progress | None = None
        self._drawn_s = 0.0

    def enter(self, phase: str) -> None:
        """Name what is being done from now on, or how it ended."""
        self._draw(phase, at_once=True)

    def show(self, progress: Progress) -> None:
        """Take in a window."""
        self._last = progress
        now = time.monotonic()
        if now < self._drawn_s + _EVERY_S:
            return
        self._drawn_s = now
        short, open_ = percent_of_window(progress.short), percent_of_window(progress.open)
        self._draw(f"{progress.feed_um_s:.1f} um/s, short {short:.0f} %, open {open_:.0f} %")

    def _draw(self, words: str, at_once: bool = False) -> None:
        share, times = 0.0, ""
        if (last := self._last) is not None:
            share = min(1.0, last.path_um / last.total_um)
            times = f"{duration_text(last.time_s)} simulated in {duration_text(last.wall_time_s)}, "
        self._bar.show(self._name, share, 1.0, times + words, at_once)
