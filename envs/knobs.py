"""Knobs of the pulse generator: the settings that further entries of an action change, and their steps."""

import math
from collections.abc import Sequence

from edmsim.errors import InputError, refuse_unknown
from edmsim.machine.machine import Machine
from edmsim.machine.setting import least_period_us

KNOBS = {
    "on_time": "on-time over the first one",
    "period": "pulse period over the first one",
    "duty_factor": "period per on-time over the first ratio",
}
"""Knobs there are, and what an action turns; each by a power of 2 within `Family.setting_octaves`. Of period and duty
factor there can be one: the other follows."""
MOST_OCTAVES = 4.0  # greatest reach of the knobs either way that may be asked for (ours)
DETENTS_US = 1e-3, 1000.0  # least and greatest step of a knob (ours: a nanosecond, and the longest on-time)
Detents = tuple[float, float]


def check_knobs(names: Sequence[str]) -> None:
    """Refuse knobs there are not, and two that turn the same."""
    for name in names:
        refuse_unknown("knob", name, KNOBS)
    if len(set(names)) != len(names) or {"period", "duty_factor"} <= set(names):
        raise InputError(f"knobs are {', '.join(names)}: name each once, and period or duty_factor, not both")


def to_detents(t_on_us: float, t_period_us: float, detents_us: Detents) -> tuple[float, float]:
    """Return the nearest setting that knobs with these steps have."""
    on_step, period_step = detents_us
    return _detent(round(t_on_us / on_step), on_step), _detent(round(t_period_us / period_step), period_step)


def least_setting_us(machine: Machine, t_on_us: float, detents_us: Detents) -> tuple[float, float]:
    """Return an on-time with the shortest period at which the supply gives it, both in detents."""
    on_step, period_step = detents_us
    on = _detent(round(t_on_us / on_step), on_step)
    return on, _detent(math.ceil(least_period_us(machine, on) / period_step - 1e-9), period_step)


def _detent(number: int, step_us: float) -> float:
    """Return a detent as one writes it: seven of 0.2 us are 1.4 us, which is not their product to the last bit."""
    return round(number * step_us, 9)
