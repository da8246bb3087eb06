"""Progress of a cut in a notebook: one line with a bar, drawn over while the cut goes on."""

from __future__ import annotations

import math
import os
import sys
import time
from html import escape
from typing import Any

from edmsim.compiled.specialised import PROGRESS
from edmsim.controllers.pulse_counters import percent_of_window
from edmsim.cosim.simulation import Progress
from edmsim.recording.report import duration_text

_EVERY_S = 0.3
"""Wall time between two pictures of the bar (ours: seen to move, and little for a browser)."""


class NotebookProgress:
    """A bar under the cell that cuts: share of the path, machine and wall time, feed, shorts and opens.

    Parameters
    ----------
    title : str
        What is cut.
    display : callable
        IPython's `display`.
    """

    def __init__(self, title: str, display: Any) -> None:
        self._title, self._display = title, display
        self._handle: Any = None
        self._share, self._text, self._next_s = 0.0, "", -math.inf

    def enter(self, phase: str) -> None:
        """Name what is being done from now on."""
        self._draw(phase)

    def show(self, progress: Progress) -> None:
        """Take in a window; draw only now and then."""
        now, self._share = time.monotonic(), min(1.0, progress.path_um / progress.total_um)
        self._text = f"{duration_text(progress.time_s)} simulated in {duration_text(progress.wall_time_s)}"
        if now >= self._next_s:
            self._next_s = now + _EVERY_S
            short, open_ = percent_of_window(progress.short), percent_of_window(progress.open)
            counts = f"short {short:.0f} %, open {open_:.0f} %"
            self._draw(f"{progress.feed_um_s:.1f} µm/s, {counts}")

    def end(self, how: str) -> None:
        """Say how the cut ended."""
        self._draw(how)

    def _draw(self, said: str) -> None:
        words = [f"{100 * self._share:.1f} %", self._text, said]
        text = f"{self._title}: " + ", ".join(word for word in words if word)
        bar = f'<progress max="1" value="{self._share:.4f}"></progress> {escape(text)}'
        data = {"text/plain": text, "text/html": bar}
        if self._handle is None:
            self._handle = self._display(data, raw=True, display_id=True)
        else:
            self._handle.update(data, raw=True)


def notebook_progress(title: str) -> NotebookProgress | None:
    """Return a bar if this is a notebook and nobody has switched bars off."""
    # a notebook has loaded IPython; nobody else need wait for it
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    if getattr(shell, "kernel", None) is None or os.environ.get(PROGRESS) == "0":
        return None
    from IPython.display import display

    return NotebookProgress(title, display)
