"""The live view of a real terminal: the 32 digits, the pulses in percent, and the operator's line below them."""

from __future__ import annotations

import time
from typing import Self

from rich.console import Console, Group
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from edmsim.consoles.computer_1982.devices import Interrupts, Keyboard
from edmsim.consoles.computer_1982.operation import LEGEND, Operation
from edmsim.controllers.mcu.chips.display import BANK
from edmsim.controllers.mcu.dialogue.front_panel import FIELDS
from edmsim.controllers.mcu.dialogue.main_program import Status
from edmsim.machine.setting import WINDOW_PULSES

_EVERY_S = 0.1
_BAR_CELLS = 40


class View(Keyboard):
    """A person's terminal with a panel that stays at its lower edge; what is printed scrolls above it."""

    def __init__(self, interrupts: Interrupts, console: Console | None = None) -> None:
        super().__init__(interrupts)
        self._console = console or Console(highlight=False)
        self._live = Live(console=self._console, auto_refresh=False, transient=True)
        self._partial = ""
        self._next_s = 0.0
        self._panel: Panel | None = None
        self._last_state: tuple[list[int], Status, bool] | None = None

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

    def refresh(self, operation: Operation) -> None:
        """Draw the machine, at most ten times a second."""
        if time.monotonic() < self._next_s:
            return
        self._next_s = time.monotonic() + _EVERY_S
        status = operation.status()._replace(time_s=0.0, voltage_V=0.0, current_A=0.0)
        state = operation.digits(), status, operation.at_panel
        if state != self._last_state:
            self._last_state = state
            self._panel = panel(*state)
            self._draw()

    def _draw(self) -> None:
        if self._panel is not None:
            self._live.update(Group(self._panel, Text(self._partial + "_")), refresh=True)


def panel(digits: list[int], status: Status, at_panel: bool) -> Panel:
    """Return the digits with their names, the keys where they are pressed, and the pulses of the last window."""
    keys = [Text(LEGEND, style="yellow")] if at_panel else []
    shown = Group(_digits(digits), *keys, Text(), _bars(status))
    return Panel(shown, title=status.state, title_align="left", expand=False)


def _digits(shown: list[int]) -> Table:
    """Two banks of sixteen; what is above 9 is dark."""
    table = Table.grid(padding=(0, 3))
    for bank in (0, BANK):
        fields = {name: place for name, place in FIELDS.items() if bank <= place[0] < bank + BANK}
        figures = [shown[first : first + count] for first, count in fields.values()]
        table.add_row(*(Text(name, style="dim") for name in fields))
        table.add_row(
            *(Text(" ".join(str(d) if d <= 9 else " " for d in digits), style="bold red") for digits in figures)
        )
    return table


def _bars(status: Status) -> Table:
    table = Table.grid(padding=(0, 1))
    for name, count, colour in (
        ("short", status.short, "red"), ("open", status.open, "yellow"), ("erosion", status.erosion, "green"),
    ):  # fmt: skip
        cells = round(count / WINDOW_PULSES * _BAR_CELLS)
        bar = Text("█" * cells + "·" * (_BAR_CELLS - cells), style=colour)
        table.add_row(name, f"{100 * count / WINDOW_PULSES:5.1f} %", bar)
    return table
