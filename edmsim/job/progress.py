"""How far a cut is: share of the path, machine and wall time, feed, shorts and opens."""

from __future__ import annotations

import time

from edmsim.controllers.pulse_counters import percent_of_window
from edmsim.cosim.simulation import Progress
from edmsim.progress import ShownProgress
from edmsim.recording.report import duration_text

_EVERY_S = 0.1
"""Between two looks at a cut: windows are shorter (ours)."""


class CutProgress:
    """What `edmsim.cut` calls back, as a bar.

    Parameters
    ----------
    bar : ShownProgress
    name : str
        What is cut.
    """

    def __init__(self, bar: ShownProgress, name: str) -> None:
        self._bar, self._name = bar, name
        self._share, self._times, self._looked_s = 0.0, "", 0.0

    def enter(self, phase: str) -> None:
        """Name what is being done from now on, or how it ended."""
        self._draw(phase, at_once=True)

    def show(self, progress: Progress) -> None:
        """Take in a window."""
        self._share = min(1.0, progress.path_um / progress.total_um)
        now = time.monotonic()
        if now < self._looked_s + _EVERY_S and self._share < 1.0:
            return
        self._looked_s = now
        self._times = f"{duration_text(progress.time_s)} simulated in {duration_text(progress.wall_time_s)}"
        short, open_ = percent_of_window(progress.short), percent_of_window(progress.open)
        self._draw(f"{progress.feed_um_s:.1f} um/s, short {short:.0f} %, open {open_:.0f} %")

    def _draw(self, words: str, at_once: bool = False) -> None:
        text = ", ".join(word for word in (self._times, words) if word)
        self._bar.show(self._name, self._share, 1.0, text, at_once)
