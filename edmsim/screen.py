"""The terminal: tables of any width, and progress bars; in a file or a pipe, lines at intervals."""

import os
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from html import escape
from typing import Any

from rich import progress, table
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderResult
from rich.text import Text

from edmsim.compiled import PROGRESS

LEAST_NAME = 8
"""Least length of a shortened name (ours)."""
CUT = "…"
"""Stands for the omitted part of a name."""


class ScreenTable(table.Table):
    """A table that fits the terminal: names are shortened, sentences wrap, and numbers stay complete.

    In columns other than `numbers`, words that are too long, such as paths, lose their middle; different words stay
    different. If the numbers are wider than the terminal, the table continues below with the other columns, after the
    first `keys` columns, which identify the row.
    """

    def __init__(self, *names: str, numbers: Sequence[str] = (), keys: int = 1, **options: Any) -> None:
        super().__init__(*names, **options)
        self._keys = keys
        for head in numbers:
            self.add_column(head, justify="right")

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield the table unchanged, or one or more tables that fit."""
        full_widths = [_width([column.header, *column.cells]) for column in self.columns]
        wide = options.update(max_width=sum(full_widths) + 1000)
        natural = super().__rich_measure__(console, wide).maximum
        if natural <= options.max_width or not self.columns:
            yield from super().__rich_console__(console, options)
            return
        around = natural - sum(full_widths)  # width of the borders and padding of all columns
        for number, block in enumerate(self._blocks(options.max_width, around)):
            if number and self.box is None:
                yield Text()
            yield self._part(block, number == 0)

    def _blocks(self, width: int, around: int) -> list[dict[int, int]]:
        """Return the columns and widths of each table; all have the key columns, the first of equal width."""
        each = around / len(self.columns)
        least = [self._least(column) for column in self.columns]
        keys = list(range(self._keys))
        others = range(len(keys), len(self.columns))
        if sum(least[k] + each for k in keys) + max((least[k] + each for k in others), default=0) > width:
            keys, others = [0], range(1, len(self.columns))
        blocks = [list(keys)]
        for k in others:
            if len(blocks[-1]) > len(keys) and sum(least[c] + each for c in [*blocks[-1], k]) > width:
                blocks.append(list(keys))
            blocks[-1].append(k)
        shared = [self._shared(block, least, width - each * len(block)) for block in blocks]
        first = min(block[0] for block in shared)
        return [{**block, 0: first} for block in shared]

    def _shared(self, block: list[int], least: list[int], width: float) -> dict[int, int]:
        """Return column widths: the least width of each, and the rest divided evenly among those that need more."""
        widths = {k: least[k] for k in block}
        full_widths = {k: _width([self.columns[k].header, *self.columns[k].cells]) for k in block}
        left = int(width) - sum(widths.values())
        while left > 0 and (wanting := [k for k in block if widths[k] < full_widths[k]]):
            # names first, because the heads of numbers may take several lines
            wanting = [k for k in wanting if not _has_numbers(self.columns[k])] or wanting
            for k in sorted(wanting, key=lambda k: widths[k])[:left]:
                widths[k] += 1
                left -= 1
        if left < 0 and not _has_numbers(self.columns[block[0]]):
            widths[0] = max(widths[0] + left, 1)  # folded, so nothing is lost
        return widths

    def _least(self, column: table.Column) -> int:
        """Return the least width: numbers need all of it, names enough to stay different."""
        if _has_numbers(column):
            names = shortened(self._heads(), _shortest(self._heads()))
            return max(_width(column.cells), _width(names.get(word, word) for word in _words([column.header])))
        return _shortest(_words([column.header, *column.cells]))

    def _heads(self) -> list[str]:
        return _words(column.header for column in self.columns if _has_numbers(column))

    def _part(self, widths: dict[int, int], is_first: bool) -> table.Table:
        part = table.Table(
            title=self.title if is_first else None, caption=self.caption if is_first else None, box=self.box,
            padding=self.padding, pad_edge=self.pad_edge, show_header=self.show_header, style=self.style,
            title_justify=self.title_justify, caption_justify=self.caption_justify,
        )  # fmt: skip
        cells = []
        for k, width in widths.items():
            column = self.columns[k]
            known = self._heads() if _has_numbers(column) else _words([column.header, *column.cells])
            names = shortened(known, width) if width >= LEAST_NAME else {}
            head = _replaced(column.header, names)
            rest = list(column.cells) if _has_numbers(column) else [_replaced(cell, names) for cell in column.cells]
            part.add_column(head, justify=column.justify, style=column.style, width=width, overflow="fold")
            cells.append(rest)
        for row, texts in zip(self.rows, zip(*cells, strict=True), strict=True):
            part.add_row(*texts, style=row.style, end_section=row.end_section)
        return part


def shortened(names: Iterable[str], width: int) -> dict[str, str]:
    """Shorten names to a width so that different names stay different; empty if that is impossible.

    The omitted part is the middle, or as near to it as possible while the names stay different.
    """
    distinct = set(names)
    long = [name for name in distinct if cell_len(name) > width]
    taken = distinct - set(long)
    heads = sorted(range(width), key=lambda head: (abs(2 * head + 1 - width), head))
    for head in heads:
        tail = width - 1 - head
        found = {name: name[:head] + CUT + (name[-tail:] if tail else "") for name in long}
        if len(set(found.values()) | taken) == len(distinct):
            return {**{name: name for name in taken}, **found}
    return {}


def _shortest(words: list[str]) -> int:
    """Return the least width to which different words can be shortened and stay different."""
    longest = max(map(cell_len, words), default=0)
    return next((width for width in range(LEAST_NAME, longest) if shortened(words, width)), longest)


def _has_numbers(column: table.Column) -> bool:
    return column.justify == "right"


def _plain(cell: Any) -> str:
    return cell.plain if isinstance(cell, Text) else str(cell)


def _words(cells: Iterable[Any]) -> list[str]:
    return [word for cell in cells for word in _plain(cell).split()]


def _width(cells: Iterable[Any]) -> int:
    return max((cell_len(line) for cell in cells for line in _plain(cell).splitlines()), default=0)


def _replaced(cell: Any, names: dict[str, str]) -> Any:
    """Return a cell with its long words shortened."""
    text = _plain(cell)
    changed = text
    for word in sorted({word for word in text.split() if names.get(word, word) != word}, key=len, reverse=True):
        changed = changed.replace(word, names[word])
    return cell if changed == text else Text(changed, getattr(cell, "style", ""))


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
        text = progress.TextColumn("{task.fields[text]}", table_column=table.Column(no_wrap=True, ratio=1))
        self._bars = progress.Progress(
            progress.TextColumn("{task.description}"), progress.BarColumn(bar_width=12),
            progress.TextColumn("{task.fields[share]}"), progress.TimeElapsedColumn(), text, console=self._console,
            transient=not keep, expand=True,
        )  # fmt: skip
        self._tasks: dict[str, progress.TaskID] = {}
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
        return lambda *shown: self.show(name, *shown)

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
            self._display = sys.modules["IPython.display"].display(data, raw=True, display_id=True)
        else:
            self._display.update(data, raw=True)


def in_notebook() -> bool:
    """Return whether this is a notebook in which progress is not switched off."""
    ipython = sys.modules.get("IPython")  # a notebook has imported it already; elsewhere the import would take time
    shell = None if ipython is None else ipython.get_ipython()
    return getattr(shell, "kernel", None) is not None and os.environ.get(PROGRESS) != "0"
