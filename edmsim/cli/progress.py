"""Progress of a cut on the screen."""

from __future__ import annotations

import math
import time

from rich.console import Console
from rich.progress import BarColumn, ProgressColumn, Task, TextColumn
from rich.text import Text

from edmsim.controllers.pulse_counters import percent_of_window
from edmsim.cosim.simulation import Progress
from edmsim.screen import ScreenProgress

_CUTTING = "cutting"


class ProgressBar:
    """Share of the path, simulated and wall time, and the phase: with feed, shorts and opens, or for how long.

    Parameters
    ----------
    quiet : bool
        Show nothing.
    console : rich.console.Console
    """

    _EVERY_S = 0.1

    def __init__(self, quiet: bool, console: Console) -> None:
        self._bar = ScreenProgress(
            TextColumn("{task.percentage:5.1f} %"),
            BarColumn(bar_width=24),
            TextColumn("{task.fields[machine]} simulated in"),
            _WallTime(),
            _Phase(),
            TextColumn("{task.fields[process]}"),
            console=console,
            disable=quiet,
        )
        now = time.monotonic()
        self._task = self._bar.add_task(
            "cut", total=1.0, machine=_clock(0), process="", phase=_CUTTING, since=now, wall_time_s=0.0, refreshed=now
        )
        self._next_s = -math.inf
        self._started = False

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(self, *_: object) -> None:
        if self._started:
            self._bar.stop()

    def enter(self, phase: str) -> None:
        """Name what is being done from now on."""
        if not self._started:  # not before the cut begins: bad input shall print its one line only
            self._started = True
            self._bar.start()
        self._bar.update(self._task, phase=phase, since=time.monotonic(), process="", refresh=True)

    def show(self, progress: Progress) -> None:
        """Take in a window; draw only every tenth of a second."""
        now = time.monotonic()
        at_end = progress.path_um >= progress.total_um - 2.0
        if now < self._next_s and not at_end:
            self._bar.tasks[0].fields.update(wall_time_s=progress.wall_time_s, refreshed=now)
            return
        self._next_s = now + self._EVERY_S
        self._bar.update(
            self._task,
            completed=min(1.0, progress.path_um / progress.total_um),
            machine=_clock(progress.time_s),
            wall_time_s=progress.wall_time_s,
            refreshed=now,
            process=f"{progress.feed_um_s:5.1f} um/s  short {percent_of_window(progress.short):3.0f} %  "
            f"open {percent_of_window(progress.open):3.0f} %",
        )


class _WallTime(ProgressColumn):
    """The computer's time for the cut, as its report will say it: it runs while the cut does."""

    def render(self, task: Task) -> Text:
        running_s = time.monotonic() - task.fields["refreshed"] if task.fields["phase"] == _CUTTING else 0.0
        return Text(_clock(task.fields["wall_time_s"] + running_s), style="progress.elapsed")


class _Phase(ProgressColumn):
    """What is being done; behind the cut also for how long."""

    def render(self, task: Task) -> Text:
        phase, since = task.fields["phase"], task.fields["since"]
        return Text(phase if phase == _CUTTING else f"{phase} {_clock(time.monotonic() - since)}")


def _clock(seconds: float) -> str:
    minutes, rest = divmod(int(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{rest:02d}"
