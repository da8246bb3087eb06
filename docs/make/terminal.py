"""The picture of `docs/controller-1982.md`: the terminal's 24 lines, with the monitor above the live view of a cut.

python docs/make/terminal.py
"""

from matplotlib.figure import Figure
from rich.console import Console, Group
from rich.style import Style
from rich.text import Text
from sections import DOCS

import edmsim
from edmsim.consoles.computer_1982.operation import Operation
from edmsim.consoles.computer_1982.rig import Rig
from edmsim.consoles.computer_1982.session import Session, panel
from edmsim.consoles.devices import Interrupts
from edmsim.recording.figures.style import write_figure

COLUMNS, LINES = 80, 24
TYPED = (
    "G 0400", "TI 30 TP 100 SPEED 110", "NEW 32700 32500", "START", "WAIT 3", "MON", "D 2040,2061", "D 2070,2083",
    "S 204C 40", "D 4020,4022",
)  # fmt: skip
WIDTH_IN, HEIGHT_IN, FONT_PT = 8.0, 4.6, 9.2
BACKGROUND, PHOSPHOR = "#10160f", "#9be58f"
COLOURS = {"red": "#ff5d4a", "yellow": "#ffd24a", "green": PHOSPHOR}


class _Screen:
    """A terminal that types the lines of `TYPED`, and stores the output and the live view after the last line."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._lines = list(TYPED)
        self.at_end = False
        self.shown = ""
        self.view = panel([0] * 32, Operation(rig).status(), at_panel=False)

    def read(self, timeout_s: float | None) -> bytes:
        """Return the next line."""
        if self._lines:
            return f"{self._lines.pop(0)}\n".encode()
        operation = Operation(self._rig)
        self.view, self.at_end = panel(operation.digits(), operation.status(), at_panel=False), True
        return b""

    def write(self, data: bytes) -> None:
        """Store the output."""
        self.shown += data.decode("ascii").replace("\r", "")

    def refresh(self, operation: Operation) -> None:
        """Do nothing, because the live view is needed only at the end."""


def screen() -> list[list[tuple[str, Style | None]]]:
    """Return the last 24 lines, each as pieces of text with their styles."""
    rig = Rig(edmsim.Machine.load(height_mm=10.0), resolution="fast")
    display = _Screen(rig)
    Session(rig, display, Interrupts(), monitor=True).run()
    text = display.shown.split("\nREADY")[0].removesuffix("\n. ")
    console = Console(width=COLUMNS, force_terminal=True, color_system="truecolor", legacy_windows=False)
    lines = console.render_lines(Group(Text(text), display.view, Text(". _")), console.options, pad=False)
    return [[(piece.text, piece.style) for piece in line] for line in lines[-LINES:]]


def figure() -> Figure:
    """Draw the lines."""
    drawn = Figure(figsize=(WIDTH_IN, HEIGHT_IN), dpi=110, facecolor=BACKGROUND)
    for row, line in enumerate(screen()):
        column = 0
        for text, style in line:
            named = style.color.name if style is not None and style.color is not None else ""
            faint = style is not None and style.dim
            for offset, character in enumerate(text):
                drawn.text(
                    (column + offset + 2) / (COLUMNS + 4), 1 - (row + 1.5) / (LINES + 2), character,
                    family="DejaVu Sans Mono", size=FONT_PT, ha="center", va="center",
                    color=COLOURS.get(named, PHOSPHOR), alpha=0.6 if faint else 1.0,
                )  # fmt: skip
            column += len(text)
    return drawn


if __name__ == "__main__":
    write_figure(figure(), DOCS / "figures" / "terminal.png")
