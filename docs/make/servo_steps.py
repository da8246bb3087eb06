"""The picture of `docs/servo-drives.md`: steps and moves of both drives on the table's axis, as delivered and tuned.

python docs/make/servo_steps.py
"""

from matplotlib.figure import Figure
from sections import DOCS

from edmsim.consoles.autotune import Tuning, autotune, draw_move, draw_step
from edmsim.controllers.axis.drive import axis_row
from edmsim.recording.figures.palette import INK
from edmsim.recording.figures.style import TITLE_PT, legend, write_figure

DRIVES = {"uhu": "UHU 3.00", "servo-module": "servo processor module"}


def figure(tunings: dict[str, Tuning]) -> Figure:
    """Draw a column for each drive, with steps above moves."""
    drawn = Figure(figsize=(7.2, 4.4), dpi=110, facecolor="white", layout="constrained")
    for column, (name, tuning) in enumerate(tunings.items()):
        step, move = drawn.add_subplot(2, 2, column + 1), drawn.add_subplot(2, 2, column + 3)
        draw_step(step, tuning)
        draw_move(move, tuning)
        step.set_title(DRIVES[name], fontsize=TITLE_PT, color=INK)
        legend(step, loc="upper right")
    return drawn


if __name__ == "__main__":
    drawn = figure({name: autotune(name, axis_row("table"), print) for name in DRIVES})
    write_figure(drawn, DOCS / "figures" / "servo-steps.png")
