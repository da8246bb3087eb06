"""Progress bars; in a file or a pipe, lines at intervals."""

import os
import sys
import time
from collections.abc import Callable
from functools import partial
from html import escape
from pkgutil import resolve_name
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Column

from edmsim.compiled import PROGRESS

LINE_EVERY_S = 10.0
"""Interval between lines of progress in a file or a pipe (ours)."""
NOTEBOOK_EVERY_S = 0.3
"""Interval between updates of the bar in a notebook (ours: smooth, and little work for a browser)."""


class ShownProgress:
    """One bar for each name that is shown. None is drawn before the first, so bad input prints only its own line.

    With `quiet` nothing is shown. With `keep` the finished bars, or in a file or a pipe the last line of each, stay.

    >>> with ShownProgress(quiet=True) as bar:
    ...     bar.show("cutting", 3, 10, "12 um/s")
    """

    def __init__(self, quiet: bool = False, keep: bool = False) -> None:
        self._console = Console(stderr=True)
        self._quiet, self._keep = quiet, keep
        self._bars = Progress(
            TextColumn("{task.description}"), BarColumn(bar_width=12), TextColumn("{task.fields[share]}"),
            TimeElapsedColumn(), TextColumn("{task.fields[text]}", table_column=Column(no_wrap=True, ratio=1)),
            console=self._console, transient=not keep, expand=True,
        )  # fmt: skip
        self._tasks: dict[str, TaskID] = {}
        self._display: Any = None
        self._drawn_s = time.monotonic()
        self._name = self._line = ""

    def __enter__(self) -> "ShownProgress":
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if self._bars.live.is_started:
            self._bars.stop()
        elif self._keep and self._line and kind is None:
            self._print()

    def show(
        self, name: str, done: float = 0.0, total: float | None = None, text: str = "", at_once: bool = False
    ) -> None:
        """Show progress in any unit; `total` is None if it is unknown.

        With `at_once` a notebook draws it without waiting for the interval, because something else begins.
        """
        if self._quiet:
            return
        share = f"{100 * done / total:.1f} %" if total else ""
        if self._console.is_terminal:
            if name not in self._tasks:
                self._bars.start()
                self._tasks[name] = self._bars.add_task(name, share="", text="")
            self._bars.update(self._tasks[name], completed=done, total=total, share=share, text=text)
        elif in_notebook():
            if at_once or self._display is None or self._is_due(NOTEBOOK_EVERY_S):
                self._draw_in_notebook(name, done / total if total else None, text)
        else:
            if self._keep and self._line and name != self._name:
                self._print()
            self._name = name
            self._line = " ".join(word for word in (name, share, text) if word)
            if self._is_due(LINE_EVERY_S):
                self._print()

    def _print(self) -> None:
        self._console.print(self._line, highlight=False, soft_wrap=True, markup=False)
        self._line = ""

    def of(self, name: str) -> Callable[..., None]:
        """Return ``watch(done, total)``, which calls `show` with a name."""
        return partial(self.show, name)

    def _is_due(self, every_s: float) -> bool:
        now = time.monotonic()
        is_due = now >= self._drawn_s + every_s
        if is_due:
            self._drawn_s = now
        return is_due

    def _draw_in_notebook(self, name: str, share: float | None, text: str) -> None:
        percent, value = ("", "") if share is None else (f"{100 * share:.1f} %", f' value="{share:.4f}"')
        words = f"{name}: " + ", ".join(word for word in (percent, text) if word)
        data = {"text/plain": words, "text/html": f'<progress max="1"{value}></progress> {escape(words)}'}
        if self._display is None:
            display: Callable[..., Any] = resolve_name("IPython.display:display")
            self._display = display(data, raw=True, display_id=True)
        else:
            self._display.update(data, raw=True)


def in_notebook() -> bool:
    """Return whether this is a notebook in which progress is not switched off."""
    ipython = sys.modules.get("IPython")  # a notebook has imported it already; elsewhere the import would take time
    shell = None if ipython is None else ipython.get_ipython()
    return getattr(shell, "kernel", None) is not None and os.environ.get(PROGRESS) != "0"
