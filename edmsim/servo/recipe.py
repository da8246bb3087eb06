"""The tuning recipe of the UHU's manual (rows U-25, U-58), step by step, for either drive at its serial line.

The module's guide has no recipe but a recorder to "evaluate different tuning settings" with (4.20), and a
feed-forward of velocity, which is measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

from edmsim.errors import InputError
from edmsim.servo.operator import ModuleOperator, Operator
from edmsim.servo.relay import Swing

_STEPS = 10, -10, 50, -50
"""Steps of a trial in counts (ours): within friction's reach, and as many as the UHU's stream shows."""
_OVERSHOOT, _I_ADDS = 0.15, 0.15
"""Overshoots that are no oscillation (ours): while P is raised, and what I may add."""
_SHARE_OF_ULTIMATE, _LEAD = 0.3, 0.125
"""First gains as shares of the ultimate gain and of its period: Ziegler and Nichols 1942 have 0.6 and 1/8; half of
their gain, as what follows raises it."""
_RAISE, _LOWER, _BACK_OFF = 1.12, 0.8, 0.9
"""A gain over that of the trial before (ours); the manual's "about 10 % to give a safety margin"."""
_MORE, _FIRST, _STOPPED, _IN_VAIN, _SWEEPS = 1.4, 50, 0.8, 3, 2
"""Factor between two values of what compensates, the first value, the share of the highest P below which it stops no
oscillation any more, how many such values end it, and how often each letter is gone through (ours)."""
_MARGIN = 1.25
"""All gains may be so many times larger without oscillation (ours): motors warm up and tables are loaded."""
_FINE = 1.6, 0.6, 1.3, 0.75, 1.3, 0.75, 1.1, 0.9, 1.1, 0.9
"""Factors of the fine tuning (ours)."""
_LARGEST = {"H": 20_000}
"""Manual of the UHU: the largest useful value; other gains go up to a word's."""
_WORD = 65_535
_FULL = 256
"""Gains of both drives are in 1/256."""
_BETTER, _WORSE = 0.8, 3.0
"""Every figure shall be so much of that upon delivery; power of the ratio by which one is not (ours)."""

Values = Mapping[str, int]


class Figures(NamedTuple):
    """What a trial shows: overshoot as a share, settling time in s, and rms following error of a move in counts."""

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
    """Trials of one operator.

    Parameters
    ----------
    operator : Operator
    say : callable
        Told of every step in a line.
    """

    def __init__(self, operator: Operator, say: Callable[[str], None]) -> None:
        self._operator, self._say = operator, say
        self._kept = {**operator.kept, "E": operator.no_trip}
        delivered = {letter: operator.delivered[letter] for letter in operator.gains}
        self._before = self.tried({**self._kept, **delivered}, math.inf)

    def run(self, swing: Swing) -> dict[str, int]:
        """Tune.

        Parameters
        ----------
        swing : Swing
            What the relay has told.

        Returns
        -------
        dict of str to int
            Letters and values, those included that stay.

        Raises
        ------
        InputError
            No values bring the axis to rest.
        """
        values = self._raised_p(self._first(swing))
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

    def _first(self, swing: Swing) -> Values:
        """Return values to begin with: those of delivery without I, or the relay's if they oscillate (step 2)."""
        operator = self._operator
        values = {**self._kept, **{letter: operator.delivered[letter] for letter in operator.gains}, "I": 0}
        if not self._calm(values, math.inf):
            gain = _SHARE_OF_ULTIMATE * swing.gain * _FULL
            values |= dict.fromkeys(operator.gains, 0)
            values["P"] = max(round(gain), 1)
            values["D"] = max(round(gain * swing.period_s * _LEAD / operator.interval_s), 1)
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
