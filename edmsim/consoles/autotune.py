"""``edmsim tune drive``: parameters for a drive on an axis, found over its serial line, and their effect.

A relay experiment measures how fast the axis is; then the manual's recipe tunes the drive. The bench measures the
drive as delivered and as tuned, sample by sample. The result is the lines that a person would type.
*The relay experiment*: with infinite gain the axis oscillates (Åström and Hägglund 1984), at the ultimate period.
The ultimate gain is ``4 h / (pi a)`` for a relay of height h and an oscillation of amplitude a. Over a drive's
serial line, the relay is the largest P with all other gains 0; its height is the limit of the output.
*The recipe* is that of the UHU's manual (rows U-25, U-58), step by step, for either drive. The module's guide has
no recipe. It has a recorder to "evaluate different tuning settings" (4.20), and a feed-forward of velocity, which
is measured.
"""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from edmsim.axis_bench import AxisBench
from edmsim.consoles.servo import STREAM, bench_for
from edmsim.controllers.axis import CHIPS
from edmsim.errors import InputError
from edmsim.files import make_writable
from edmsim.recording.figures.palette import BLUE, MUTED, VERMILION
from edmsim.recording.figures.style import check_figure, column_figure, dress, in_style, legend, write_figure

# An operator at a drive's serial line: types values, steps or moves the axis, and watches what the drive sends.
# Both chips send the tracking error: the UHU by the stream for its analyser (rows U-33 to U-36), the servo module
# by its recorder (guide 4.20). The operator uses nothing else. It reads overshoot, settling time and oscillation
# from the response to a step of the setpoint.

_REBOUND, _LEAST_COUNTS, _RESTLESS_COUNTS = 0.08, 2.5, 2
"""Limits below which a response is not an oscillation (ours): rebound after the overshoot as a share of the step; the
same in counts, because of encoder and friction; and the movement in counts at the end of a settled response."""
_SETTLED_COUNTS = 1  # an axis within this error has settled: the encoder's resolution


class AxisTrace(NamedTuple):
    """Response to a step or a move."""

    time_s: NDArray[np.float64]  # (n,): times since the beginning of the step or move
    # (n,): setpoint minus position in counts; after a step in either direction, positive is short of the setpoint
    error: NDArray[np.int64]

    def overshoot(self, counts: int) -> float:
        """Return the overshoot of a step of `counts`, as a share of the step; 0 without an overshoot."""
        return max(float(-self.error.min()) / counts, 0.0)

    @property
    def settling_s(self) -> float:
        """Time after which the error stays within a count; the whole time if it never does."""
        outside = np.flatnonzero(np.abs(self.error) > _SETTLED_COUNTS)
        return float(self.time_s[outside[-1]]) if len(outside) else 0.0

    @property
    def rms(self) -> float:
        """Root mean square of the error in counts."""
        return float(np.sqrt(np.mean(self.error.astype(np.float64) ** 2)))

    def oscillates(self, counts: int, most_overshoot: float) -> bool:
        """Return whether the response to a step of `counts` overshoots too far or does not come to rest."""
        end = self.error[len(self.error) * 3 // 4 :]
        if not len(end) or np.ptp(end) > _RESTLESS_COUNTS:
            return True
        there = np.flatnonzero(self.error <= 0)
        if not len(there):
            return False
        beyond = self.error[there[0] :]
        lowest = int(beyond.argmin())
        back = float(beyond[lowest:].max())
        too_far = float(-beyond[lowest]) > max(most_overshoot * counts, _LEAST_COUNTS)
        return too_far or back > max(_REBOUND * counts, _LEAST_COUNTS)


_START_S = 0.05  # time for the start-up text (ours)
_REST_S = 0.2  # time for an axis to come to rest (ours)
_BITS = 10  # per byte on the line: start bit, eight data bits, stop bit
STEP_RATE, MOVE_RATE, _AT_ONCE, _OUTPUT = 1, 2, 24, 96
"""Parts of a recorder's code (guide 4.20): rates, no trigger, the output instead of the error."""
_WATCHED_S = {STEP_RATE: 0.3, MOVE_RATE: 0.5}
"""Recording time of a response (ours): that of a full recorder and its dump."""
_SPEED_SHARE, _MOST_HZ, _RAMP_S = 0.2, 20_000.0, 0.05
"""Speed of a move as a share of the motor's no-load speed, its limit in counts/s, and the ramps' time (ours)."""


class Operator(ABC):
    """An operator who tunes a drive, as delivered, on an axis; `rate_Hz` are the steps per second of a move."""

    chip: ClassVar[str]
    gains: ClassVar[tuple[str, ...]]
    """Letters of the tuned gains: P, then the gains that damp oscillation in the manual's order, then I."""
    fixed: ClassVar[Mapping[str, int]]  # parameters that are constant during the search
    relay: ClassVar[Mapping[str, int]]
    """Settings that make the loop a relay: the largest gain alone, with a limit as its height."""
    height: ClassVar[str]  # parameter that sets the relay's height
    no_trip: ClassVar[int]  # an error limit that is never reached
    shown: ClassVar[int]  # largest error that the drive sends, in counts
    step_line: ClassVar[bytes]  # line that steps the setpoint, for its number
    saving: ClassVar[tuple[str, ...]]  # lines that save the typed values

    def __init__(self, motor: NDArray[np.void]) -> None:
        drive = CHIPS[self.chip](motor)
        self.baud = drive.baud
        self.bench = AxisBench({"x": drive})
        self.bench.run(_START_S)
        free_rad_s = float(motor["supply_V"][0] / motor["torque_Nm_A"][0])
        self.rate_Hz = min(_SPEED_SHARE * free_rad_s * float(motor["counts_per_rad"][0]), _MOST_HZ)
        self.delivered = {row["letter"]: int(row["value"]) for row in drive.data["parameter"]}
        self._typed: dict[str, int] = {}

    @property
    def interval_s(self) -> float:
        """Time from one recalculation to the next."""
        record = self.bench.drive().record
        return float(record["num"][0] / record["den"][0]) * 1e-9

    def enter(self, values: Mapping[str, int]) -> None:
        """Type the values that have changed, restart the loop, and let the axis come to rest."""
        for letter, value in values.items():
            if self._typed.get(letter) != value:
                self.bench.talk(f"{letter}{value}\r".encode("ascii"))
        self._typed.update(values)
        self.restart()
        self.bench.run(_REST_S)

    def restart(self) -> None:
        """Set the setpoint to the present position."""
        self.bench.talk(b"R\r")

    def step(self, counts: int, code: int = STEP_RATE) -> AxisTrace:
        """Step the setpoint and record; the error is positive while the axis is short of the setpoint."""
        self.restart()
        self._watch(code)
        answer = self._watched(self.send_step(counts), _WATCHED_S[code])
        return answer._replace(error=answer.error if counts > 0 else -answer.error)

    def move(self, direction: int) -> AxisTrace:
        """Send the step pulses of a move with ramps, as the machine's computer would, and record."""
        self.restart()
        self._watch(MOVE_RATE)
        return self._watched(self.send_steps(direction), _WATCHED_S[MOVE_RATE])

    def send_step(self, counts: int) -> float:
        """Send the line that steps the setpoint; return the time in s at which it has arrived."""
        line = self.step_line % counts
        self.bench.send(line)
        return self.bench.time_s + _BITS * len(line) / self.baud

    def send_steps(self, direction: int) -> float:
        """Send the step pulses of a move of 0.25 s in a direction; return the time in s of the first."""
        accel_Hz_s = self.rate_Hz / _RAMP_S
        self.bench.steps("x", direction * round(4 * _RAMP_S * self.rate_Hz), self.rate_Hz, accel_Hz_s)
        return self.bench.time_s

    @abstractmethod
    def _watch(self, code: int) -> None:
        """Make the drive send its errors from here on; a recorder is started with its code."""

    @abstractmethod
    def _watched(self, since_s: float, seconds: float) -> AxisTrace:
        """Wait `seconds`, and return the errors that the drive has sent since the time `since_s`."""


class UhuOperator(Operator):
    """An operator who tunes a UHU with its analyser, by the manual's text on fine tuning (rows U-25 and U-58)."""

    chip = "uhu"
    gains = "P", "H", "D", "I"
    fixed: ClassVar = {"X": 5000, "T": 255, "N": 1000, "C": 63}
    relay: ClassVar = {"P": 65535, "I": 0, "D": 0, "H": 0, "X": 65535, "N": 65535}
    height, no_trip, shown = "T", 30_000, 62
    step_line, saving = b"G%d\r", ("S0", "S2")

    def _watch(self, code: int) -> None:
        self.bench.send(b"A\r")
        self.bench.run(0.02)
        self.bench.received()

    def _watched(self, since_s: float, seconds: float) -> AxisTrace:
        self.bench.run(seconds)
        since_s += _BITS / self.baud  # transmission time of a byte
        data = self.bench.received_at()
        heard = [(at_s - since_s, byte) for byte, at_s in data if byte >= STREAM and at_s >= since_s]
        self.bench.send(b"Z\r")
        self.bench.run(0.02)
        zero = STREAM + int(CHIPS[self.chip].data["law"]["stream_zero"])
        return AxisTrace(np.array([at_s for at_s, _ in heard]), np.array([byte - zero for _, byte in heard]))


class ModuleOperator(Operator):
    """An operator who tunes a servo module with its recorder, as in 4.20 of the guide."""

    chip = "servo-module"
    gains = "P", "D", "I"
    fixed: ClassVar = {"C": 760, "L": 6}
    relay: ClassVar = {"P": 65535, "I": 0, "D": 0}
    height, no_trip, shown = "C", 40_000, 32_767
    step_line, saving = b"%+d\r", ("S",)

    def _watch(self, code: int) -> None:
        self._every = 1 << (code & 7)
        self.bench.received()
        self.bench.send(b"Z%d\r" % code)

    def _watched(self, since_s: float, seconds: float) -> AxisTrace:
        self.bench.run(seconds)
        lines = self.bench.received().decode("ascii")
        shown = np.array([int(number) for number in re.findall(r"^(-?\d+)\r$", lines, re.MULTILINE)])
        return AxisTrace(self._every * self.interval_s * np.arange(len(shown), dtype=np.float64), shown)

    def output_at_speed(self, direction: int) -> tuple[float, float]:
        """Move at constant speed; return the output in duty counts, and the commanded counts per cycle."""
        self.send_steps(direction)
        self.bench.run(_RAMP_S)
        self._watch(MOVE_RATE + _AT_ONCE + _OUTPUT)
        shown = self._watched(self.bench.time_s, _WATCHED_S[MOVE_RATE]).error
        steady = self.rate_Hz * self.interval_s * direction
        n = round(2 * _RAMP_S / (self._every * self.interval_s))
        return float(shown[:n].mean()), steady


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
_OVERSHOOT, _I_ADDS = 0.15, 0.15  # allowed overshoot while P is raised, and its increase by I (ours)
_SHARE_OF_ULTIMATE, _LEAD = 0.3, 0.125
"""First gains as shares of the ultimate gain and of its period: Ziegler and Nichols 1942 have 0.6 and 1/8; half of
their gain, because the next steps raise it."""
_RAISE, _LOWER, _BACK_OFF = 1.12, 0.8, 0.9
"""Factors from one trial's gain to the next (ours); the manual's "about 10 % to give a safety margin"."""
_MORE, _FIRST, _STOPPED, _IN_VAIN, _SWEEPS = 1.4, 50, 0.8, 3, 2
"""Search for a compensating gain (ours): factor between two values; first value; a value fails if P's limit is below
this share of the highest P; number of successive failures that end the search; number of searches per gain."""
_MARGIN = 1.25  # factor by which all gains may grow without oscillation (ours): motors warm up and tables are loaded
_FINE = 1.6, 0.6, 1.3, 0.75, 1.3, 0.75, 1.1, 0.9, 1.1, 0.9  # factors of the fine tuning (ours)
_LARGEST = {"H": 20_000}  # manual of the UHU: the largest useful value; the limit of other gains is `_WORD`
_WORD = 65_535
_FULL = 256  # gains of both drives are in 1/256
_BETTER, _WORSE = 0.8, 3.0
"""Target of every figure as a share of the delivered drive's; exponent of the ratio to a missed target (ours)."""

Values = Mapping[str, int]


class Figures(NamedTuple):
    """Results of a trial: overshoot as a share, settling time in s, rms following error of a move in counts."""

    overshoot: float
    settling_s: float
    rms: float

    def cost(self, before: Figures | None) -> float:
        """Return a cost, the smaller the better; a figure worse than `before` counts more than a better one."""
        least = 0.25, 0.002, 1.0  # added to the figures, which friction, intervals and counts keep above 0
        cost = math.prod(own + low for own, low in zip(self, least, strict=True))
        for own, other, low in zip(self, before or self, least, strict=True):
            cost *= max((own + low) / (_BETTER * other + low), 1.0) ** _WORSE
        return cost


class Recipe:
    """The manual's recipe, carried out by one operator."""

    def __init__(self, operator: Operator, say: Callable[[str], None]) -> None:
        self._operator, self._say = operator, say
        self._fixed = {**operator.fixed, "E": operator.no_trip}
        delivered = {letter: operator.delivered[letter] for letter in operator.gains}
        self._before = self.tried({**self._fixed, **delivered}, math.inf)

    def run(self, oscillation: Oscillation) -> dict[str, int]:
        """Tune, beginning with the relay's oscillation; return all letters and values, also constant ones."""
        values = self._raised_p(self._first(oscillation))
        for _ in range(_SWEEPS):
            for letter in self._operator.gains[1:-1]:
                values = self._compensated(values, letter)
        if isinstance(self._operator, ModuleOperator):
            values = fed_forward(self._operator, values)
            self._say(f"V{values['V']}, which a steady motion takes")
        return dict(self._refined(self._raised_i(values)))

    def tried(self, values: Values, most_overshoot: float) -> Figures | None:
        """Enter values and return the figures of steps and a move; None if the axis oscillates."""
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
            figures = figures._replace(rms=0.0)  # V will reduce it
        return figures.cost(self._before)

    def _first(self, oscillation: Oscillation) -> Values:
        """Return the first values: the delivered ones without I, or the relay's if those oscillate (step 2)."""
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
        """Raise P until the axis oscillates, and reduce it by a tenth (step 3)."""
        p = values["P"]
        while p > 1 and not self._calm({**values, "P": p}):
            p = int(p * _LOWER)
        higher = math.ceil(p * _RAISE)
        while higher <= _WORD and self._calm({**values, "P": higher}):
            p, higher = higher, math.ceil(higher * _RAISE)
        return {**values, "P": max(round(_BACK_OFF * p), 1)}

    def _compensated(self, values: Values, letter: str) -> Values:
        """Raise a compensating gain, and P to its limit each time, until that falls; return the best (step 3)."""
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
        """Raise I until the axis oscillates and reduce it by a tenth (step 4); a smaller I is returned if better."""
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
        """Change every value a little and keep the better ones: the fine tuning after the recipe."""
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
    """Return values with V for the output at constant speed without friction: half of forward minus backward."""
    operator.enter(values)
    there, speed = operator.output_at_speed(1)
    back, _ = operator.output_at_speed(-1)
    return {**values, "V": max(round((there - back) / 2 / speed * _FULL), 0)}


STEP_COUNTS = 50  # step of the measurement (ours), within the range of the UHU's stream
_MEASURED_S, _DRAWN_MS = 0.4, 120.0  # recorded time of a response, and drawn time of a step (ours)
_REST_BY_S = 0.95 * _MEASURED_S  # an axis that moves later has not settled (ours)
_TRIP = 4  # error limit over the move's largest following error; at least twice the step (ours)
_OPERATORS: dict[str, type[Operator]] = {kind.chip: kind for kind in (UhuOperator, ModuleOperator)}


@dataclass(frozen=True)
class AxisResponse:
    """Responses of an axis with a drive to a step up, a step down and a move, at every sample."""

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

    lines: tuple[str, ...]  # lines to type: values, restart, saving
    values: dict[str, int]  # letters and values
    # the drive as delivered, but with an error limit that is never reached; and tuned
    before: AxisResponse
    after: AxisResponse


def autotune(name: str, motor: NDArray[np.void], say: Callable[[str], None]) -> Tuning:
    """Tune a drive (``uhu`` or ``servo-module``) for an axis of `axis_row`; `say` receives every result."""
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
    return Tuning((*lines, "R", *kind.saving), values, before, after)


def measured(operator: Operator, values: dict[str, int]) -> AxisResponse:
    """Enter values, and measure two steps and a move on the bench."""
    operator.enter(values)
    up, down = _answer_to_step(operator, 1), _answer_to_step(operator, -1)
    rows, start_s = _traced(operator, lambda: operator.send_steps(1))
    error = rows["setpoint"] - rows["count"]
    return AxisResponse(up, down, AxisTrace(rows["time_ns"] * 1e-9 - start_s, error - error[0]))


def _answer_to_step(operator: Operator, direction: int) -> AxisTrace:
    start_count = int(operator.bench.axis()["count"])
    rows, start_s = _traced(operator, lambda: operator.send_step(direction * STEP_COUNTS))
    return AxisTrace(rows["time_ns"] * 1e-9 - start_s, STEP_COUNTS - direction * (rows["count"] - start_count))


def _traced(operator: Operator, begin: Callable[[], float]) -> tuple[NDArray[np.void], float]:
    """Restart the loop, call `begin`, and return the samples from its start on, and its time in s."""
    bench = operator.bench
    operator.restart()
    bench.trace = True
    bench.samples()
    start_s = begin()
    bench.run(_MEASURED_S)
    rows = bench.samples()
    bench.trace = False
    return rows[rows["time_ns"] * 1e-9 >= start_s], start_s


@in_style
def draw(tuning: Tuning) -> Figure:
    """Draw the responses to a step and the following error of a move, before and after tuning."""
    figure = column_figure(3.9, left_in=0.52, top_in=0.28)
    step, move = figure.subplots(2, 1)
    figure.subplots_adjust(hspace=0.35)
    draw_step(step, tuning)
    draw_move(move, tuning)
    legend(step, above=True, columns=2)
    return figure


def draw_step(axes: Axes, tuning: Tuning) -> None:
    """Draw the responses to a step before and after tuning."""
    axes.axhline(STEP_COUNTS, color=MUTED, lw=0.7, ls="--")
    for answer, name, colour in _before_and_after(tuning.before.up, tuning.after.up):
        axes.step(answer.time_s * 1e3, STEP_COUNTS - answer.error, where="post", color=colour, lw=1.0, label=name)
    dress(axes, "time, ms", "place after a step, counts")
    axes.set(xlim=(0, _DRAWN_MS), ylim=(-0.6 * STEP_COUNTS, 2.2 * STEP_COUNTS))


def draw_move(axes: Axes, tuning: Tuning) -> None:
    """Draw the following error of a move before and after tuning."""
    for answer, name, colour in _before_and_after(tuning.before.move, tuning.after.move):
        axes.plot(answer.time_s * 1e3, answer.error, color=colour, lw=0.8, label=name)
    dress(axes, "time, ms", "following error, counts")
    most = 1.2 * max(float(np.abs(tuning.after.move.error).max()), 1.5 * STEP_COUNTS)
    axes.set(xlim=(0, 1e3 * _MEASURED_S), ylim=(-most, most))


def _before_and_after(before: AxisTrace, after: AxisTrace) -> tuple[tuple[AxisTrace, str, str], ...]:
    return (before, "as delivered", VERMILION), (after, "tuned", BLUE)


def tune(name: str, axis: str, out: Path | None, say: Callable[[str], None]) -> tuple[str, ...]:
    """Tune a drive for an axis (see `bench_for`); return the lines to type. With `out`, draw before and after."""
    if out is not None:
        check_figure(out)
        make_writable(out.parent)
    motor = np.array([bench_for(name, axis, tuned=False).motor()])  # for x and y with the machine's screw and table
    tuning = autotune(name, motor, say)
    for title, one in (("as delivered", tuning.before.figures), ("tuned", tuning.after.figures)):
        rests = f"settled after {1e3 * one.settling_s:.0f} ms" if one.settling_s < _REST_BY_S else "not settled"
        say(
            f"{title}: overshoot {100 * one.overshoot:.0f} %, {rests}, "
            f"following error of a move {one.rms:.1f} counts rms"
        )
    if out is not None:
        write_figure(draw(tuning), out)
    if tuning.after.figures.settling_s >= _REST_BY_S:
        raise InputError(f"{name} cannot be tuned for the axis {axis}: no values were found with which it settles")
    return tuning.lines
