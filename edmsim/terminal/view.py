"""The live view of a real terminal: the 32 digits, the pulses in percent, and the operator's line below them."""

from __future__ import annotations

import time
from typing import Self

from rich.console import Console, Group
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from .devices import Interrupts, Keyboard
from .rig import Rig

_EVERY_S = 0.1
_BAR_CELLS = 40


class View(Keyboard):
    """A person's terminal with a panel that stays at its lower edge; what is printed scrolls above it.

    Parameters
    ----------
    interrupts : Interrupts
    console : rich.console.Console, optional
    """

    def __init__(self, interrupts: Interrupts, console: Console | None = None) -> None:
        super().__init__(interrupts)
        self._console = console or Console(highlight=False)
        self._live = Live(console=self._console, auto_refresh=False, transient=True)
        self._partial = ""
        self._next_s = 0.0
        self._panel: Panel | None = None

    def __enter__(self) -> Self:
        self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    def write(self, data: bytes) -> None:
        """Print finished lines above the panel; keep the begun one in it."""
        for character in data.decode("ascii", "replace"):
            if character == "\n":
                self._live.console.print(Text(self._partial))
                self._partial = ""
            elif character == "\b":
                self._partial = self._partial[:-1]
            elif character == "\a":
                self._console.bell()
            elif character != "\r":
                self._partial += character
        # BS, space, BS takes a character back: the space came and went
        self._draw()

    def refresh(self, rig: Rig) -> None:
        """Draw the machine, at most ten times a second."""
        if time.monotonic() >= self._next_s:
            self._next_s = time.monotonic() + _EVERY_S
            self._panel = panel(rig)
            self._draw()

    def _draw(self) -> None:
        if self._panel is not None:
            self._live.update(Group(self._panel, Text(self._partial + "_")), refresh=True)


def panel(rig: Rig) -> Panel:
    """Return the digits, the pulse percentages and what the generator does."""
    status = rig.status()
    grid = Table.grid(padding=(0, 2))
    for text in rig.digits():
        grid.add_row(Text(text, style="bold red"))
    bars = Table.grid(padding=(0, 1))
    for name, count, colour in (
        ("short", status.short, "red"),
        ("open", status.open, "yellow"),
        ("erosion", status.erosion, "green"),
    ):
        cells = round(count / 255 * _BAR_CELLS)
        bars.add_row(name, f"{count / 2.55:5.1f} %", Text("█" * cells + "·" * (_BAR_CELLS - cells), style=colour))
    return Panel(Group(grid, bars), title=status.state, title_align="left", expand=False)
