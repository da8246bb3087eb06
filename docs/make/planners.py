"""``docs/planners.md`` and its picture: path error of each planner, and moves on which the algorithm of 1982 fails.

python docs/make/planners.py
"""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from sections import DOCS, table

from edmsim.controllers.planner.errors import (
    COMPARED,
    DIRECTIONS_DEG,
    LONG_UM,
    MACHINE,
    SHORT_UM,
    SPEEDS,
    STRETCH_UM,
    MoveError,
    around,
    move,
)
from edmsim.controllers.planner.registry import PLANNERS
from edmsim.recording.figures.palette import BLUE, GREEN, GRID, INK, MUTED, ORANGE, PURPLE, VERMILION
from edmsim.recording.figures.style import write_figure

Errors = Mapping[tuple[str, int, int], NDArray[np.float64]]
"""Results of `around` by planner, length in um and speed in units."""

HEADS = ("planner", "speed", "path max, um", "path rms, um", "mean speed, %", "ripple, %", "end, um")
FAILURE_HEADS = (
    "row", "move, um", "speed", "what happens", "path max, um", "mean speed, %", "end, um", "`mcu`: path max, um",
    "`mcu`: mean speed, %", "default: path max, um", "default: mean speed, %",
)  # fmt: skip


class Failure(NamedTuple):
    """A move that the requirements name, with their text on it."""

    row: str
    run_um: tuple[int, int]
    speed: int
    what: str


LOST = Failure("T-G11", (30_000, 100), 127, "REDUC drops the short component: that axis never moves")

FAILURES = (
    Failure("T-G9", (1000, 100), 1, "one unit to either axis: 45 degrees"),
    Failure("T-G9", (700, 300), 2, "one unit to either axis: 45 degrees"),
    Failure("T-G12", (10_000, 5_000), 4, "a third of a unit rounded off: 1492 um"),
    Failure("T-G12", (10_000, 5_000), 32, "it happens to fit: 1.8 um"),
    Failure("T-G12", (10_000, 5_000), 127, "rounding of the axis speeds: 41 um"),
    Failure("T-G12", (20_000, 12_345), 127, "REDUC and rounding: 106 um"),
    LOST,
    Failure("T-G6", (23_296, 23_296), 127, "the sum of squares wraps: 856 units an axis for 90"),
)

_INTRODUCTION = """\
# Planners

    edmsim cut examples/punch.ngc --planner exact --out out/exact

A planner turns path and speed into the steps of two motors.

| planner | |
|---|---|
| `poscal` | the default: the integer routines of 1982, aimed at every step at a point 32 um ahead |
| `poscal-literal` | the algorithm of the thesis: POSCAL once per move, and each axis stops at its own target |
| `dda` | an ideal line: each axis within half a step of a point that runs along it |
| `sine-table` | like `poscal`, with the direction from a table of 255 sines in place of the square root (T-72) |
| `exact` | an ideal line in whole attometres: any feed in nm/s, any corners, no limit of the feed but the machine's |
| `mcu` | no planner: the computer of 1982 makes the steps, with `--controller mcu --planner poscal-literal` |

The planner sets the times of the steps, with any controller. The exception is `--controller mcu --planner
poscal-literal`, which runs no planner: the program stores XVELOC and YVELOC, the counters of the 8253 run down, and
their interrupts make the steps ([the controller of 1982](controller-1982.md#what-makes-the-steps)).

The tables below have the errors on straight moves over {long} um and over {short} um, in {directions} directions,
1 degree apart, at {speeds} speeds of 1 to 127 units of 262.5 nm/s (`python docs/make/planners.py`):

- *path*: distance of the position counters from the line after every step, the largest and the rms of all directions.
  The motors have steps of 2 um.
- *mean speed*: from the first step to the last, along the line, relative to the commanded one; the lowest and the
  highest of all directions. Over {short} um one step is {quantum:.0f} % of the distance.
- *ripple*: rms deviation of the speed over stretches of {stretch:g} um from its mean, in the worst direction; that of
  `dda` comes from the steps alone.
- *end*: distance of the motors' last position from the end of the move, in the worst direction.

## What follows

- `poscal` keeps the line to {poscal:.2f} um, `sine-table` to {table:.2f} um and `dda` to {dda:.2f} um, in every
  direction and at every speed: all within one step. `sine-table` is as accurate as `poscal`: an entry is wrong by at
  most half a step of the table, and the next motor step corrects that.
- The mean speed of `poscal` and `sine-table` is right to {speed:.1f} % over {long} um; their axis speeds are rounded
  down. `poscal-literal` rounds down to whole units, so one axis may need twice the time of the other. If the sum of
  squares wraps, it runs too fast, at worst many times (last table).
- `poscal-literal` leaves the line by up to {literal:.0f} um within {long} um: one unit is coarse at low speed, and
  nothing corrects the error on the way. It reaches the end because each axis stops at its own target, but not if
  REDUC has dropped an axis ({lost:.0f} um off in the last table).
- `mcu` has the errors of `poscal-literal`, within {machine:.2f} um: its steps come some 0.1 ms later, which is two
  thousandths of a step at the greatest speed. In a cut the speed changes, and each axis takes the new speed at its
  own next interrupt: a cut along (1500, 400) um in 20 mm of steel left the line by 11 um with `mcu`, a third of it
  in the first seconds, while the feed rose to its limit. At a constant 127 units it is 8.2 um.

![Path error of each planner by direction](planners.png)
"""


def measure() -> dict[tuple[str, int, int], NDArray[np.float64]]:
    """Run every move of the page, and print the progress."""
    errors = {}
    for planner in COMPARED:
        for length in (LONG_UM, SHORT_UM):
            for speed in SPEEDS:
                print(f"{planner}, {length} um, {speed} units", file=sys.stderr)
                errors[planner, length, speed] = around(planner, length, speed)
    return errors


def page(errors: Errors) -> str:
    """Return the page of the documentation."""
    parts = [_introduction(errors)]
    for length, name in ((LONG_UM, "Long moves"), (SHORT_UM, "Short moves")):
        rows = [row(planner, speed, errors[planner, length, speed]) for planner in COMPARED for speed in SPEEDS]
        parts += [f"## {name}, {length} um\n", table(HEADS, rows) + "\n"]
    parts += [
        "## Where the algorithm of 1982 fails\n",
        "Moves on which `poscal-literal` fails, and the default planner on the same moves. The first column is the\n"
        "row in [the planner's rows](controller-1982.md). A distance under *what happens* follows from the axis\n"
        "speeds alone; the path also has the timers' whole counts and the steps of 2 um.\n",
        table(FAILURE_HEADS, [failure_row(failure) for failure in FAILURES]),
    ]
    return "\n".join(parts) + "\n"


def row(planner: str, speed: int, errors: NDArray[np.float64]) -> tuple[str, ...]:
    """Return a row of a table: a planner at one speed, over all directions."""
    found = MoveError(*errors.T)
    low, high = np.min(found.speed_percent), np.max(found.speed_percent)
    ripple = np.max(found.ripple_percent)
    return (
        f"`{planner}`", str(speed), f"{np.max(found.path_max_um):.2f}",
        f"{np.sqrt(np.mean(np.square(found.path_rms_um))):.2f}", f"{low:+.1f} .. {high:+.1f}",
        "" if np.isnan(ripple) else f"{ripple:.1f}", f"{np.max(found.end_um):.2f}",
    )  # fmt: skip


def failure_row(failure: Failure) -> tuple[str, ...]:
    """Return a row of the last table."""
    literal = move("poscal-literal", failure.run_um, failure.speed)
    machine = move(MACHINE, failure.run_um, failure.speed)
    default = move("poscal", failure.run_um, failure.speed)
    return (
        failure.row, str(failure.run_um), str(failure.speed), failure.what, f"{literal.path_max_um:.1f}",
        f"{literal.speed_percent:+.1f}", f"{literal.end_um:.1f}", f"{machine.path_max_um:.1f}",
        f"{machine.speed_percent:+.1f}", f"{default.path_max_um:.2f}", f"{default.speed_percent:+.1f}",
    )  # fmt: skip


def _introduction(errors: Errors) -> str:
    def worst(planner: str) -> float:
        return max(float(found[:, 0].max()) for (name, _, _), found in errors.items() if name == planner)

    steered = np.concatenate([errors[name, LONG_UM, v] for name in ("poscal", "sine-table") for v in SPEEDS])
    literal, itself = (
        np.concatenate([errors[name, LONG_UM, v] for v in SPEEDS]) for name in ("poscal-literal", MACHINE)
    )
    return _INTRODUCTION.format(
        directions=len(DIRECTIONS_DEG), speeds=len(SPEEDS), long=LONG_UM, short=SHORT_UM, stretch=STRETCH_UM,
        quantum=100 * 2 / SHORT_UM,
        poscal=worst("poscal"), table=worst("sine-table"), dda=worst("dda"), speed=np.abs(steered[:, 2]).max(),
        literal=literal[:, 0].max(), machine=np.abs(itself[:, 0] - literal[:, 0]).max(),
        lost=move("poscal-literal", LOST.run_um, LOST.speed).end_um,
    )  # fmt: skip


def figure(errors: Errors) -> Figure:
    """Draw the largest path error over the direction of a long move, slow and fast."""
    drawn = Figure(figsize=(9.0, 3.6), dpi=110, facecolor="white", layout="constrained")
    colours = dict(zip(PLANNERS, (BLUE, VERMILION, GREEN, ORANGE, PURPLE), strict=True))
    panels = drawn.subplots(1, 2, sharey=True)
    for axes, speed in zip(panels, (4, 127), strict=True):
        for planner, colour in colours.items():
            away = errors[planner, LONG_UM, speed][:, 0]
            axes.plot(list(DIRECTIONS_DEG), away, color=colour, lw=1.1, label=planner)
        axes.axhline(2.0, color=MUTED, lw=0.8, ls="--")
        axes.set(yscale="log", xlim=(0, 360), xticks=range(0, 361, 45), xlabel="direction, degrees")
        axes.set_title(f"{LONG_UM / 1000:g} mm at speed {speed}", fontsize=10, color=INK)
        axes.grid(color=GRID)
    panels[0].set_ylabel("largest path error, µm")
    panels[0].text(4, 2.1, "one step", fontsize=8, color=MUTED)
    panels[1].legend(fontsize=8, loc="upper right")
    return drawn


def write(file: Path) -> None:
    """Measure, and write the page and its picture, ``planners.png`` in the same folder."""
    errors = measure()
    write_figure(figure(errors), file.with_name("planners.png"))
    file.write_text(page(errors), encoding="utf-8")


if __name__ == "__main__":
    write(DOCS / "planners.md")
