"""Progress of a cut on the screen."""

from __future__ import annotations

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar

from edmsim.cosim.simulation import Progress


class ProgressBar:
    """Share of the path, simulated and wall time, feed, shorts and opens.

    Parameters
    ----------
    quiet : bool
        Show nothing.
    console : rich.console.Console
    """

    _EVERY_S = 0.1

    def __init__(self, quiet: bool, console: Console) -> None:
        self._bar = Bar(
            TextColumn("{task.percentage:5.1f} %"),
            BarColumn(bar_width=24),
            TextColumn("{task.fields[machine]} simulated in"),
            TimeElapsedColumn(),
            TextColumn("{task.fields[process]}"),
            console=console,
            disable=quiet,
        )
        self._task = self._bar.add_task("cut", total=1.0, machine="0:00:00", process="")
        self._next_s = 0.0
        self._started = False

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(self, *_: object) -> None:
        if self._started:
            self._bar.stop()

    def show(self, progress: Progress) -> None:
        """Take in a window; draw only every tenth of a second."""
        now = self._bar.get_time()
        at_end = progress.path_um >= progress.total_um - 2.0
        if now < self._next_s and not at_end:
            return
        self._next_s = now + self._EVERY_S
        if not self._started:  # not before the first window: bad input shall print its one line only
            self._started = True
            self._bar.start()
        minutes, seconds = divmod(int(progress.time_s), 60)
        self._bar.update(
            self._task,
            completed=min(1.0, progress.path_um / progress.total_um),
            machine=f"{minutes // 60}:{minutes % 60:02d}:{seconds:02d}",
            process=f"{progress.feed_um_s:5.1f} um/s  short {progress.short / 2.55:3.0f} %  "
            f"open {progress.open / 2.55:3.0f} %",
        )
