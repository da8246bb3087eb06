"""The optimising routine: from the counts of short and open pulses to the cutting speed, in 16-bit words.

The thesis states the aim, small percentages of both per 255 pulses by changes of the cutting speed (row T-15), but
has no routine. This one is ours, in the machine's arithmetic: 16-bit words, products in two words, quotients by shift
and subtract. A proportional-integral law for the speed holds the share of open pulses, minus a weighted share of
shorts, at a small target. If a short persists, the wire retracts along the path.

Scales: speeds are in units of 262.5 nm/s; times in ticks of 0.1 ms of a clock that wraps; places along the path in
um, which also wrap, so only differences count; shares in 1/256 pulse of 255 (`SHARE`), errors in 1/32 (`ERROR`).
"""

from dataclasses import dataclass
from typing import NamedTuple

from edmsim.controllers.mcu.firmware.poscal import WORD
from edmsim.controllers.mcu.firmware.timers import ADD_T, FRACTION_T, MULTIPLY_T, POSCAL_BOUND_T, READ_OUT_T

TICK_NS = 100_000  # system tick: 0.1 ms (ours), so that a word holds 6.5 s, more than twice the longest window
SHARE = 255 << 8  # a share of 1: all 255 pulses
ERROR = 255 << 5  # an error of 1 in share; a word has eight times this range
DOUBLE = 0xFFFF_FFFF  # largest number of two words
HALF = 0x8000  # half of a word: for rounding, and for signs of differences that wrap
CUT, RETRACT, DWELL, ALARM = range(4)  # phases
BASE_T = READ_OUT_T + POSCAL_BOUND_T + 12 * ADD_T
"""Cost common to all paths: reading the counts, phases and comparisons, and POSCAL with the new speed."""


class Settings(NamedTuple):
    """The routine's constants, all words."""

    target: int  # target of open pulses, in 1/32 pulse
    weight: int  # weight of a short pulse in open pulses, in 1/256
    proportional: int  # speed per error, in 2^-16 units per 1/32 pulse
    integral: int  # growth of the speed per error and tick, in 2^-32 units per 1/32 pulse
    filter_ticks: int  # time constant of the filter, 0..32767
    start: int  # speeds in units: initial
    limit: int  # greatest
    retract: int  # of a retract
    slow: int  # of the return to the place of a short
    air: int  # open pulses from which no metal is near, in 1/256 pulse
    shorted: int  # short pulses of 255 from which a window counts as shorted
    clear: int  # short pulses below which a short counts as cleared
    patience_ticks: int  # shorted time before a retract
    retract_ticks: int  # longest duration of a retract
    dwell_ticks: int  # wait after it
    progress_um: int  # distance along the path from which a short is a new one
    tries: int  # retracts and waits for one short before the alarm


@dataclass(slots=True)
class State:
    """The routine's variables, all words."""

    clock: int = 0  # tick at which the routine last ran
    phase: int = CUT  # `CUT`, `RETRACT`, `DWELL` or `ALARM`
    phase_ticks: int = 0  # time in this phase
    short: int = 0  # filtered counts in 1/256 pulse, as `open`
    open: int = 0
    shorted_ticks: int = 0  # time since which all windows were shorted
    speed: int = 0  # integral of the speed in units
    fraction: int = 0  # its fraction in 2^-16 units
    place: int = 0  # place along the path where the last short began, in um
    tries: int = 0  # retracts and waits for it; 0 without a short


def fraction(part: int, whole: int) -> int:
    """Return the quotient of two words, the first the smaller one, in 2^-16: sixteen rounds of shift and subtract."""
    return (part << 16) // whole


def optimise(settings: Settings, state: State, short: int, open: int, clock: int, path: int) -> tuple[int, int]:
    """Process a window's counts at a tick and a place in um (words that wrap); return speed and T-states."""
    ticks = (clock - state.clock) & WORD
    state.clock = clock
    cost = BASE_T + _look(settings, state, short, open, ticks)
    beyond = (path - state.place) & WORD
    if settings.progress_um < beyond < HALF:
        state.tries = 0  # a new place: the last short is over
    phase = state.phase
    if phase == CUT:
        if state.shorted_ticks and state.shorted_ticks >= settings.patience_ticks:
            if not state.tries:
                state.place = path
            _enter(state, RETRACT)
            _count_try(settings, state)
    elif phase in (RETRACT, DWELL):
        if short < settings.clear:
            _resume(settings, state, short, open)
        elif phase == RETRACT and state.phase_ticks >= settings.retract_ticks:
            _enter(state, DWELL)
        elif phase == DWELL and state.phase_ticks >= settings.dwell_ticks:
            _enter(state, DWELL)
            _count_try(settings, state)
    if state.phase == CUT:
        slow = state.tries > 0 and (path - state.place) & WORD >= HALF
        return _cut(settings, state, settings.slow if slow else settings.limit, ticks, cost)
    if state.phase == RETRACT:
        return _retract(settings, state, ticks, cost)
    return 0, cost


def _look(settings: Settings, state: State, short: int, open: int, ticks: int) -> int:
    """Filter both counts and add up the times; return the cost."""
    state.phase_ticks = min(state.phase_ticks + ticks, WORD)
    state.shorted_ticks = min(state.shorted_ticks + ticks, WORD) if short >= settings.shorted else 0
    divisor = settings.filter_ticks + (ticks >> 1)  # of second order, near the exponential
    if ticks >= divisor:
        state.short, state.open = short << 8, open << 8
        return 0
    share = (ticks << 16) // divisor
    state.short += _approach(state.short, short << 8, share)
    state.open += _approach(state.open, open << 8, share)
    return FRACTION_T + 2 * MULTIPLY_T


def _approach(old: int, new: int, share: int) -> int:
    """Interpolate between two words, rounded."""
    if new >= old:
        return ((new - old) * share + HALF) >> 16
    return -(((old - new) * share + HALF) >> 16)


def _enter(state: State, phase: int) -> None:
    state.phase, state.phase_ticks = phase, 0


def _count_try(settings: Settings, state: State) -> None:
    state.tries = min(state.tries + 1, WORD)
    if state.tries > settings.tries:
        _enter(state, ALARM)


def _resume(settings: Settings, state: State, short: int, open: int) -> None:
    """Cut again from the place where the short cleared, with a reset filter."""
    _enter(state, CUT)
    state.short, state.open = short << 8, open << 8
    if state.speed >= settings.start:
        state.speed, state.fraction = settings.start, 0


def _retract(settings: Settings, state: State, ticks: int, cost: int) -> tuple[int, int]:
    """Return the speed of the retract, slower in the last window, to stop at the allowed distance."""
    left = max(settings.retract_ticks - state.phase_ticks, 0)
    if left >= ticks:
        return -settings.retract, cost
    return -(settings.retract * fraction(left, ticks) >> 16), cost + FRACTION_T + MULTIPLY_T


def _cut(settings: Settings, state: State, limit: int, ticks: int, cost: int) -> tuple[int, int]:
    """Return the proportional-integral speed up to a limit; in air the limit itself."""
    if state.open >= settings.air:
        return limit, cost
    sought = settings.target + min((state.short >> 3) * settings.weight >> 8, WORD)
    present = state.open >> 3
    error = min(abs(present - sought), WORD)  # SUBSGN
    most = limit << 16
    total = state.speed << 16 | state.fraction
    change = error * settings.proportional
    cost += 2 * MULTIPLY_T
    if not state.shorted_ticks:
        growth = min(error * ticks * settings.integral >> 16, DOUBLE)
        total = min(max(total + growth if present >= sought else total - growth, 0), most)
        state.speed, state.fraction = total >> 16, total & WORD
        cost += 3 * MULTIPLY_T
    total = min(max(total + change if present >= sought else total - change, 0), most)
    return (total + HALF) >> 16, cost
