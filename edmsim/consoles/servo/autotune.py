"""``edmsim tune drive``: parameters for a drive on an axis, found over its serial line, and their effect.

A relay experiment measures how fast the axis is; then the manual's recipe tunes the drive. The bench measures the
drive as delivered and as tuned, sample by sample. The result is the lines that a person would type.

*The relay experiment*: with infinite gain the axis oscillates (Åström and Hägglund 1984), at the ultimate period.
The ultimate gain is ``4 h / (pi a)`` for a relay of height h and an oscillation of amplitude a. Over a drive's
serial line, the relay is the largest P with all other gains 0; its height is the limit of the output.

*The recipe* is that of the UHU's manual (rows U-25, U-58), step by step, for either drive. The module's guide has no
recipe. It has a recorder to "evaluate different tuning settings" (4.20), and a feed-forward of velocity, which is
measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.consoles.servo.operator import MOVE_RATE, AxisTrace, ModuleOperator, Operator, UhuOperator
from edmsim.controllers.axis import CHIPS
from edmsim.errors import InputError, one_of
from edmsim.recording.figures.palette import BLUE, MUTED, VERMILION
from edmsim.recording.figures.style import column_figure, dress, legend

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_HEIGHT, _FACTOR, _HIGHEST = 25, 1.5, 500
"""Height of the first relay, factor to the next, and the highest, in the units of T or of C (ours)."""
_COUNTS = range(8, 50)
"""Amplitudes to measure (ours): far above a count, and within the 63 counts that the UHU's stream shows."""
_KICK, _FEWEST_SWINGS = 4, 4


class Oscillation(NamedTuple):
    """Oscillation of an axis: ultimate gain in units of output per count, period in s, amplitude in counts."""

    gain: float
    period_s: float
    amplitude: float


def oscillation_of(operator: Operator) -> Oscillation:
    """Measure an axis' oscillation under a relay, with its height adjusted to a measurable amplitude."""
    heights = {_HEIGHT}
    height = _HEIGHT
    while True:
        operator.enter({**operator.relay, "E": operator.no_trip, operator.height: height})
        answer = operator.step(_KICK, MOVE_RATE)
        late = answer.time_s > answer.time_s[-1] / 3
        error, time_s = answer.error[late], answer.time_s[late]
        amplitude = float(np.ptp(error)) / 2
        factor = _FACTOR if amplitude < _COUNTS.start else 1 / _FACTOR if amplitude >= _COUNTS.stop else 1.0
        next_height = round(height * factor)
        if next_height in heights or not 1 < next_height <= _HIGHEST:
            break
        height = next_height
        heights.add(height)
    high = error > error.mean()
    rises = time_s[1:][high[1:] & ~high[:-1]]
    if len(rises) < _FEWEST_SWINGS:
        raise InputError(
            f"the axis does not swing steadily under a relay of {operator.height}{height}: it is held fast, runs "
            "away, or has play before its encoder"
        )
    return Oscillation(4 * height / (math.pi * amplitude), float(np.diff(rises).mean()), amplitude)


_STEPS = 10, -10, 50, -50
"""Steps of a trial in counts (ours): within friction's reach, and as many as the UHU's stream shows."""
_OVERSHOOT, _I_ADDS = 0.15, 0.15  # overshoots that are no oscillation (ours): while P is raised, and what I may add
_SHARE_OF_ULTIMATE, _LEAD = 0.3, 0.125
"""First gains as shares of the ultimate gain and of its period: Ziegler and Nichols 1942 have 0.6 and 1/8; half of
their gain, as what follows raises it."""
_RAISE, _LOWER, _BACK_OFF = 1.12, 0.8, 0.9
"""A gain over that of the trial before (ours); the manual's "about 10 % to give a safety margin"."""
_MORE, _FIRST, _STOPPED, _IN_VAIN, _SWEEPS = 1.4, 50, 0.8, 3, 2
"""Factor between two values of what compensates, the first value, the share of the highest P below which it stops no
oscillation any more, how many such values end it, and how often each letter is gone through (ours)."""
_MARGIN = 1.25  # factor by which all gains may grow without oscillation (ours): motors warm up and tables are loaded
_FINE = 1.6, 0.6, 1.3, 0.75, 1.3, 0.75, 1.1, 0.9, 1.1, 0.9  # factors of the fine tuning (ours)
_LARGEST = {"H": 20_000}  # manual of the UHU: the largest useful value; other gains go up to a word's
_WORD = 65_535
_FULL = 256  # gains of both drives are in 1/256
_BETTER, _WORSE = 0.8, 3.0
"""Every figure shall be so much of that upon delivery; power of the ratio by which one is not (ours)."""

Values = Mapping[str, int]


class Figures(NamedTuple):
    """Results of a trial: overshoot as a share, settling time in s, rms following error of a move in counts."""

    overshoot: float
    settling_s: float
    rms: float

    def cost(self, before: Figures | None) -> float:
        """Return one number, the smaller the better; what is worse than before counts more than what is better."""
        least = 0.25, 0.002, 1.0  # as much again counts double: what friction, intervals and counts do not let fall
        cost = math.prod(own + low for own, low in zip(self, least, strict=True))
        for own, other, low in zip(self, before or self, least, strict=True):
            cost *= max((own + low) / (_BETTER * other + low), 1.0) ** _WORSE
        return cost


class Recipe:
    """Trials of one operator."""

    def __init__(self, operator: Operator, say: Callable[[str], None]) -> None:
        self._operator, self._say = operator, say
        self._fixed = {**operator.fixed, "E": operator.no_trip}
        delivered = {letter: operator.delivered[letter] for letter in operator.gains}
        self._before = self.tried({**self._fixed, **delivered}, math.inf)

    def run(self, oscillation: Oscillation) -> dict[str, int]:
        """Tune by the answer to the relay; returns letters and values, also those that stay."""
        values = self._raised_p(self._first(oscillation))
        for _ in range(_SWEEPS):
            for letter in self._operator.gains[1:-1]:
                values = self._compensated(values, letter)
        if isinstance(self._operator, ModuleOperator):
            values = fed_forward(self._operator, values)
            self._say(f"V{values['V']}, which a steady motion takes")
        return dict(self._refined(self._raised_i(values)))

    def tried(self, values: Values, most_overshoot: float) -> Figures | None:
        """Type some values in and look at steps and a move; return None if the axis oscillates."""
        operator = self._operator
        operator.enter(values)
        beyond = settling_s = 0.0
        for counts in _STEPS:
            answer, large = operator.step(counts), abs(counts) == max(_STEPS)
            if answer.oscillates(abs(counts), most_overshoot if large else math.inf):
                return None
            if large:
                settling_s += answer.settling_s / 2
                beyond = max(beyond, answer.overshoot(abs(counts)))
        there, back = operator.move(1).rms, operator.move(-1).rms
        return Figures(beyond, settling_s, math.hypot(there, back) / math.sqrt(2))

    def _calm(self, values: Values, overshoot: float = _OVERSHOOT) -> bool:
        return self.tried(values, overshoot) is not None

    def _cost(self, values: Values, overshoot: float = _OVERSHOOT) -> float:
        figures = self.tried(values, overshoot)
        if figures is None:
            return math.inf
        if isinstance(self._operator, ModuleOperator) and "V" not in values:
            figures = figures._replace(rms=0.0)  # V will see to it
        return figures.cost(self._before)

    def _first(self, oscillation: Oscillation) -> Values:
        """Return values to begin with: those of delivery without I, or the relay's if they oscillate (step 2)."""
        operator = self._operator
        values = {**self._fixed, **{letter: operator.delivered[letter] for letter in operator.gains}, "I": 0}
        if not self._calm(values, math.inf):
            gain = _SHARE_OF_ULTIMATE * oscillation.gain * _FULL
            values |= dict.fromkeys(operator.gains, 0)
            values["P"] = max(round(gain), 1)
            values["D"] = max(round(gain * oscillation.period_s * _LEAD / operator.interval_s), 1)
        while not self._calm(values):
            if values["P"] <= 1:
                raise InputError("no values bring this axis to rest: it swings even with P1")
            values["P"] = int(values["P"] * _LOWER)
        while max(abs(operator.move(1).error)) > operator.shown:
            operator.rate_Hz /= 2
        self._say("begins with " + " ".join(f"{letter}{values[letter]}" for letter in operator.gains))
        return values

    def _raised_p(self, values: Values) -> Values:
        """Raise P until the axis oscillates, and take a tenth off (step 3)."""
        p = values["P"]
        while p > 1 and not self._calm({**values, "P": p}):
            p = int(p * _LOWER)
        higher = math.ceil(p * _RAISE)
        while higher <= _WORD and self._calm({**values, "P": higher}):
            p, higher = higher, math.ceil(higher * _RAISE)
        return {**values, "P": max(round(_BACK_OFF * p), 1)}

    def _compensated(self, values: Values, letter: str) -> Values:
        """Raise what compensates, P to its limit each time, while that stops oscillation; keep the best (step 3)."""
        best, least, highest = values, self._cost(values), values["P"]
        in_vain = 0
        while in_vain < _IN_VAIN:
            raised = min(math.ceil(max(values[letter], _FIRST) * _MORE), _LARGEST.get(letter, _WORD))
            if raised == values[letter]:
                break
            values = self._raised_p({**values, letter: raised})
            in_vain = in_vain + 1 if values["P"] < _STOPPED * highest else 0
            highest = max(highest, values["P"])
            cost = self._cost(values)
            if cost < least and self._has_margin(values):
                best, least = values, cost
        self._say(f"{letter}{best[letter]} with P{best['P']}")
        return best

    def _has_margin(self, values: Values) -> bool:
        larger = {letter: round(_MARGIN * values[letter]) for letter in self._operator.gains}
        return self._calm({**values, **larger}, math.inf)

    def _raised_i(self, values: Values) -> Values:
        """Raise I until the axis oscillates and take a tenth off (step 4), or less if that is better."""
        without = self.tried(values, math.inf)
        if without is None:
            raise InputError("no values bring this axis to rest for long")
        best, least, i = 0, without.cost(self._before), 1
        while (cost := self._cost({**values, "I": i}, without.overshoot + _I_ADDS)) < math.inf:
            if cost < least:
                best, least = i, cost
            i = math.ceil(i * _RAISE)
        best = min(best, int(_BACK_OFF * i))
        self._say(f"I{best}; from I{i} on it oscillates")
        return {**values, "I": best}

    def _refined(self, values: Values) -> Values:
        """Change every value a little and keep what is better: the fine tuning after the recipe."""
        operator, best, least = self._operator, values, self._cost(values, math.inf)
        together = [operator.gains, *((letter,) for letter in values if letter in (*operator.gains, "V"))]
        for factor in _FINE:
            for letters in together:
                changed = {**best, **{letter: round(best[letter] * factor) for letter in letters}}
                cost = self._cost(changed, math.inf) if changed != best else least
                if cost < least and self._has_margin(changed):
                    best, least = changed, cost
        return best


def fed_forward(operator: ModuleOperator, values: Values) -> Values:
    """Return values whose V is what a steady motion takes, friction left out: half of there less back."""
    operator.enter(values)
    there, speed = operator.output_at_speed(1)
    back, _ = operator.output_at_speed(-1)
    return {**values, "V": max(round((there - back) / 2 / speed * _FULL), 0)}


STEP_COUNTS = 50  # step of the measurement (ours): one that the UHU's stream shows
_MEASURED_S, _DRAWN_MS = 0.4, 120.0  # time for which an answer is measured, and for which a step's is drawn (ours)
_TRIP = 4  # following error that trips the drive, over that of the move; or twice the step (ours)
_OPERATORS: dict[str, type[Operator]] = {kind.chip: kind for kind in (UhuOperator, ModuleOperator)}


@dataclass(frozen=True)
class AxisResponse:
    """An axis under a drive: its answers to a step up, a step down and a move, at every sample."""

    up: AxisTrace
    down: AxisTrace
    move: AxisTrace

    @property
    def figures(self) -> Figures:
        """Largest overshoot and longest settling time of the steps, and the move's rms following error."""
        return Figures(
            max(self.up.overshoot(STEP_COUNTS), self.down.overshoot(STEP_COUNTS)),
            max(self.up.settling_s, self.down.settling_s), self.move.rms,
        )


@dataclass(frozen=True)
class Tuning:
    """Tuning result."""

    lines: tuple[str, ...]  # what to type: values, the restart and the saving
    values: dict[str, int]  # letters and values
    oscillation: Oscillation
    # the drive as delivered, though with an error limit out of reach, and tuned
    before: AxisResponse
    after: AxisResponse


def autotune(name: str, motor: NDArray[np.void], say: Callable[[str], None]) -> Tuning:
    """Tune a drive (``uhu`` or ``servo-module``) for an axis of `axis_row`; `say` is called with what is done."""
    if name not in _OPERATORS:
        raise InputError(f"there is no drive {name!r} with a serial line; choose one of {one_of(name, CHIPS)}")
    kind = _OPERATORS[name]
    operator = kind(motor)
    oscillation = oscillation_of(operator)
    say(f"a relay makes the axis swing {1 / oscillation.period_s:.0f} times a second")
    values = Recipe(operator, say).run(oscillation)
    before = measured(kind(motor), {"E": kind.no_trip})
    after = measured(kind(motor), values)
    values["E"] = max(2 * STEP_COUNTS, math.ceil(_TRIP * float(np.abs(after.move.error).max())))
    values = {letter: values[letter] for letter in (*kind.gains, "V", "E", *kind.fixed) if letter in values}
    lines = tuple(f"{letter}{value}" for letter, value in values.items())
    return Tuning((*lines, "R", *kind.saving), values, oscillation, before, after)


def measured(operator: Operator, values: dict[str, int]) -> AxisResponse:
    """Type some values in, and measure two steps and a move on the bench."""
    operator.enter(values)
    up, down = _answer_to_step(operator, 1), _answer_to_step(operator, -1)
    rows, start_s = _traced(operator, lambda: operator.send_steps(1))
    error = rows["setpoint"] - rows["count"]
    return AxisResponse(up, down, AxisTrace(rows["time_ns"] * 1e-9 - start_s, error - error[0]))


def _answer_to_step(operator: Operator, way: int) -> AxisTrace:
    start_count = int(operator.bench.axis()["count"])
    rows, start_s = _traced(operator, lambda: operator.send_step(way * STEP_COUNTS))
    return AxisTrace(rows["time_ns"] * 1e-9 - start_s, STEP_COUNTS - way * (rows["count"] - start_count))


def _traced(operator: Operator, begin: Callable[[], float]) -> tuple[NDArray[np.void], float]:
    """Restart the loop, begin something, and return the samples from then on, and when it began."""
    bench = operator.bench
    operator.restart()
    bench.trace = True
    bench.samples()
    start_s = begin()
    bench.run(_MEASURED_S)
    rows = bench.samples()
    bench.trace = False
    return rows[rows["time_ns"] * 1e-9 >= start_s], start_s


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


def _before_and_after(before: AxisTrace, after: AxisTrace) -> tuple[tuple[AxisTrace, str, str], ...]:
    return (before, "as delivered", VERMILION), (after, "tuned", BLUE)
