"""``edmsim servo --autotune``: values for a drive on an axis, found at its serial line, and what they change.

A relay experiment tells how fast the axis is, the manual's recipe follows, and then the drive as delivered and the
tuned one are both measured on the bench, sample by sample. The result is what a person would type.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.axis import CHIPS
from edmsim.errors import InputError, one_of
from edmsim.recording.figures.palette import BLUE, MUTED, VERMILION
from edmsim.recording.figures.style import column_figure, dress, legend
from edmsim.servo.answer import Answer
from edmsim.servo.operator import ModuleOperator, Operator, UhuOperator
from edmsim.servo.recipe import Figures, Recipe
from edmsim.servo.relay import Swing, swing_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STEP_COUNTS = 50
"""Step of the measurement (ours): one that the UHU's stream shows."""
_MEASURED_S, _DRAWN_MS = 0.4, 120.0
"""Time for which an answer is measured, and for which a step's is drawn (ours)."""
_TRIP = 4
"""A following error so many times that of the move, or twice the step, trips the drive (ours)."""
_OPERATORS: dict[str, type[Operator]] = {kind.chip: kind for kind in (UhuOperator, ModuleOperator)}


@dataclass(frozen=True)
class AxisResponse:
    """An axis under a drive: its answers to a step up, a step down and a move, at every sample."""

    up: Answer
    down: Answer
    move: Answer

    @property
    def figures(self) -> Figures:
        """Largest overshoot and longest settling time of the steps, and the move's rms following error."""
        return Figures(
            max(self.up.overshoot(STEP_COUNTS), self.down.overshoot(STEP_COUNTS)),
            max(self.up.settling_s, self.down.settling_s), self.move.rms,
        )


@dataclass(frozen=True)
class Tuning:
    """What was found.

    Attributes
    ----------
    lines : tuple of str
        What to type: values, the restart and the saving.
    values : dict of str to int
        Letters and values.
    swing : Swing
        The axis under a relay.
    before, after : AxisResponse
        The drive as delivered, though with an error limit out of reach, and tuned.
    """

    lines: tuple[str, ...]
    values: dict[str, int]
    swing: Swing
    before: AxisResponse
    after: AxisResponse


def autotune(name: str, motor: NDArray[np.void], say: Callable[[str], None]) -> Tuning:
    """Tune a drive for an axis.

    Parameters
    ----------
    name : str
        ``uhu`` or ``servo-module``.
    motor : record array (1,)
        The axis, see `edmsim.controllers.axis.drive.axis_row`.
    say : callable
        Told what is being done, a line at a time.

    Returns
    -------
    Tuning

    Raises
    ------
    InputError
        There is no such drive; the axis does not swing under a relay; or no values bring it to rest.
    """
    if name not in _OPERATORS:
        raise InputError(f"there is no drive {name!r} with a serial line; choose one of {one_of(name, CHIPS)}")
    kind = _OPERATORS[name]
    operator = kind(motor)
    swing = swing_of(operator)
    say(f"a relay makes the axis swing {1 / swing.period_s:.0f} times a second")
    values = Recipe(operator, say).run(swing)
    before = measured(kind(motor), {"E": kind.no_trip})
    after = measured(kind(motor), values)
    values["E"] = max(2 * STEP_COUNTS, math.ceil(_TRIP * float(np.abs(after.move.error).max())))
    values = {letter: values[letter] for letter in (*kind.gains, "V", "E", *kind.kept) if letter in values}
    lines = tuple(f"{letter}{value}" for letter, value in values.items())
    return Tuning((*lines, "R", *kind.saving), values, swing, before, after)


def measured(operator: Operator, values: dict[str, int]) -> AxisResponse:
    """Type some values in, and measure two steps and a move on the bench."""
    operator.enter(values)
    up, down = _answer_to_step(operator, 1), _answer_to_step(operator, -1)
    rows, begun_s = _traced(operator, lambda: operator.send_steps(1))
    error = rows["setpoint"] - rows["count"]
    return AxisResponse(up, down, Answer(rows["time_ns"] * 1e-9 - begun_s, error - error[0]))


def _answer_to_step(operator: Operator, way: int) -> Answer:
    begun_at = int(operator.bench.axis()["count"])
    rows, begun_s = _traced(operator, lambda: operator.send_step(way * STEP_COUNTS))
    return Answer(rows["time_ns"] * 1e-9 - begun_s, STEP_COUNTS - way * (rows["count"] - begun_at))


def _traced(operator: Operator, begin: Callable[[], float]) -> tuple[NDArray[np.void], float]:
    """Restart the loop, begin something, and return the samples from then on, and when it began."""
    bench = operator.bench
    operator.restart()
    bench.trace = True
    bench.samples()
    begun_s = begin()
    bench.run(_MEASURED_S)
    rows = bench.samples()
    bench.trace = False
    return rows[rows["time_ns"] * 1e-9 >= begun_s], begun_s


def draw(tuning: Tuning) -> Figure:
    """Draw the answers to a step and the following error of a move, before and after."""
    figure = column_figure(3.9, left_in=0.52, top_in=0.28)
    step, move = figure.subplots(2, 1)
    figure.subplots_adjust(hspace=0.35)
    draw_step(step, tuning)
    draw_move(move, tuning)
    legend(step, above=True, columns=2)
    return figure


def draw_step(axes: Axes, tuning: Tuning) -> None:
    """Draw the answers to a step before and after."""
    axes.axhline(STEP_COUNTS, color=MUTED, lw=0.7, ls="--")
    for answer, name, colour in _before_and_after(tuning.before.up, tuning.after.up):
        axes.step(answer.time_s * 1e3, STEP_COUNTS - answer.error, where="post", color=colour, lw=1.0, label=name)
    dress(axes, "time, ms", "place after a step, counts")
    axes.set(xlim=(0, _DRAWN_MS), ylim=(-0.6 * STEP_COUNTS, 2.2 * STEP_COUNTS))


def draw_move(axes: Axes, tuning: Tuning) -> None:
    """Draw the following error of a move before and after."""
    for answer, name, colour in _before_and_after(tuning.before.move, tuning.after.move):
        axes.plot(answer.time_s * 1e3, answer.error, color=colour, lw=0.8, label=name)
    dress(axes, "time, ms", "following error, counts")
    most = 1.2 * max(float(np.abs(tuning.after.move.error).max()), 1.5 * STEP_COUNTS)
    axes.set(xlim=(0, 1e3 * _MEASURED_S), ylim=(-most, most))


def _before_and_after(before: Answer, after: Answer) -> tuple[tuple[Answer, str, str], ...]:
    return (before, "as delivered", VERMILION), (after, "tuned", BLUE)
