"""The reward: unit-free terms of one window, each with a weight."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import exactly_compiled
from edmsim.envs.path_follower import DONE, RUNNING, WIRE_BREAK
from edmsim.errors import InputError
from edmsim.plant.kernel.state import ARC, OPEN, SHORT, SPARK

REFERENCE_MM2_MIN = 30.0
"""Cutting rate that earns 1 per reference window (ours: about what the standard set-up cuts)."""
REFERENCE_S = 0.0255
"""The reference window: 255 pulses of 100 us, the standard setting."""
REFERENCE_MM2 = REFERENCE_MM2_MIN / 60 * REFERENCE_S
"""Area cut in a reference window at the reference rate."""
ERROR_UM = 10.0
"""Profile error that costs as much as the progress made with it earns, at equal weights (ours: what rounds a sharp
corner at the standard setting)."""

@dataclass(frozen=True, kw_only=True)
class Weights:
    """Weights of the reward's terms, 0 or more. The reward is gains less costs.

    Attributes
    ----------
    progress : float
        Gain per reference area (`REFERENCE_MM2`) that was cut. What is cut follows the wire by the share of pulses
        that ignite (see `path_follower.LANE`): pushing against metal gains nothing, nor does going back and forth.
    short : float
        Cost of a reference window (`REFERENCE_S`) of nothing but shorts; a share of them costs that share. It goes by
        machine time: a longer pulse period makes fewer windows, not cheaper ones.
    open : float
        The same of open pulses.
    profile : float
        Cost per reference area that was cut with the wire `ERROR_UM` from the path: it depends on the way, not on the
        time spent there.
    time : float
        Cost per reference window (`REFERENCE_S`) of machine time.
    wire_break, limit : float
        Cost of an episode's end by a broken wire, or by a limit.
    done : float
        Gain of reaching the path's end.
    """

    progress: float = 1.0
    short: float = 0.5
    open: float = 0.1
    profile: float = 0.0
    time: float = 0.0
    wire_break: float = 100.0
    limit: float = 100.0
    done: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a weight that is no finite number of 0 or more."""
        for f in fields(self):
            value = getattr(self, f.name)
            if not (isinstance(value, int | float) and 0 <= value < np.inf):
                raise InputError(f"the weight {f.name} is {value!r}: give a number of 0 or more")

    def array(self) -> NDArray[np.float64]:
        """Return the weights in the order of the attributes."""
        return np.array([getattr(self, f.name) for f in fields(self)], np.float64)


TERMS = tuple(f.name for f in fields(Weights))
"""Names of the reward's terms, in order: those of their weights."""
_PROGRESS, _SHORT, _OPEN, _PROFILE, _TIME, _WIRE_BREAK, _LIMIT, _DONE = range(len(TERMS))


def rewards(
    lanes: NDArray[np.int64], rows: NDArray[np.void], windows: NDArray[np.void], weights: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the reward of one window of every lane (n,) and its terms (len(TERMS), n), 0 in lanes that had none.

    Parameters
    ----------
    lanes : (m,)
        Lanes that had a window; of the other arguments, row i belongs to lane i.
    rows : (n,) `path_follower.LANE`
    windows : (n,) `edmsim.plant.kernel.state.WINDOW`
    weights : (len(TERMS),)
        `Weights.array`.
    """
    terms = np.zeros((len(TERMS), rows.shape[0]))
    total = np.zeros(rows.shape[0])
    _fill(lanes, rows, windows, weights, terms, total)
    return total, terms


@exactly_compiled
def _fill(
    lanes: NDArray[np.int64], rows: NDArray[np.void], windows: NDArray[np.void], weights: NDArray[np.float64],
    terms: NDArray[np.float64], total: NDArray[np.float64],
) -> None:
    """Work out terms and their sum, both given as zeros."""
    for j in range(lanes.shape[0]):
        i = lanes[j]
        counts, cause = windows[i].counts, rows[i].cause
        pulses = counts[OPEN] + counts[SPARK] + counts[ARC] + counts[SHORT]
        passed = rows[i].area_mm2 / REFERENCE_MM2
        spent = windows[i].duration_ns / (REFERENCE_S * 1e9)
        short, open_ = weights[_SHORT] * counts[SHORT] / pulses, weights[_OPEN] * counts[OPEN] / pulses
        terms[_PROGRESS, i] = weights[_PROGRESS] * passed
        terms[_SHORT, i] = -short * spent
        terms[_OPEN, i] = -open_ * spent
        terms[_PROFILE, i] = -weights[_PROFILE] * (rows[i].error_um / ERROR_UM) * passed
        terms[_TIME, i] = -weights[_TIME] * spent
        total[i] = terms[_PROGRESS, i] - (short + open_) * spent + terms[_PROFILE, i] + terms[_TIME, i]
        if cause == RUNNING:
            continue
        end = _DONE if cause == DONE else _WIRE_BREAK if cause == WIRE_BREAK else _LIMIT
        terms[end, i] = weights[end] if cause == DONE else -weights[end]
        total[i] += terms[end, i]
