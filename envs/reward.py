"""The reward: unit-free terms of one window, each with a weight."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import exactly_compiled
from edmsim.envs.path_follower import DONE, RUNNING
from edmsim.numeric import finite, keep_plain
from edmsim.plant.kernel.state import ARC, OPEN, SHORT, SPARK

REFERENCE_MM2_MIN = 30.0  # cutting rate that earns 1 per reference window (ours: about what the standard set-up cuts)
REFERENCE_S = 0.0255  # the reference window: 255 pulses of 100 us, the standard setting
REFERENCE_MM2 = REFERENCE_MM2_MIN / 60 * REFERENCE_S  # area cut in a reference window at the reference rate
ERROR_UM = 10.0
"""Profile error that costs as much as the progress made with it earns, at equal weights (ours: what rounds a sharp
corner at the standard setting)."""

@dataclass(frozen=True, kw_only=True)
class Weights:
    """Weights of the reward's terms, 0 or more. The reward is gains minus costs.

    Attributes
    ----------
    progress : float
        Gain per reference area (`REFERENCE_MM2`) cut. The cut length follows the wire by the share of pulses that
        ignite (see `path_follower.SUB_ENV`): pushing against metal gains nothing, nor does moving back and forth.
    short : float
        Cost of a reference window (`REFERENCE_S`) full of shorts; in proportion for a smaller share. It is per
        machine time, independent of the pulse period.
    open : float
        The same for open pulses.
    profile : float
        Cost per reference area cut with the wire `ERROR_UM` from the path, independent of the time it takes.
    roughness : float
        Cost per reference area cut with discharges of twice the energy bound (`Family.energy_bound_mJ`), in
        proportion to the excess over the bound.
    time : float
        Cost per reference window (`REFERENCE_S`) of machine time.
    wire_break, limit : float
        Cost of a broken wire, and of an episode's end by a limit: the area that the machine cuts at the reference
        rate (`REFERENCE_MM2_MIN`) in the time of threading. Use 1 for machines that cut at that rate, 2 for twice the
        rate.
    done : float
        Gain for reaching the path's end.
    """

    progress: float = 1.0
    short: float = 0.5
    open: float = 0.1
    profile: float = 0.0
    roughness: float = 0.0
    time: float = 0.0
    wire_break: float = 1.0
    limit: float = 1.0
    done: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a weight that is not a finite number of 0 or more."""
        for f in fields(self):
            finite(f"the weight {f.name}", getattr(self, f.name), 0.0)
        keep_plain(self)

    def array(self) -> NDArray[np.float64]:
        """Return the weights in the order of the attributes."""
        return np.array([getattr(self, f.name) for f in fields(self)], np.float64)


TERMS = tuple(f.name for f in fields(Weights))  # names of the reward's terms, in order: those of their weights
_PROGRESS, _SHORT, _OPEN, _PROFILE, _ROUGHNESS, _TIME, _WIRE_BREAK, _LIMIT, _DONE = range(len(TERMS))


class StepRewards:
    """Rewards and costs of the sub-environments' steps; time beyond a bound of path error or energy costs."""

    def __init__(
        self, weights: Weights, error_bound_um: float | None, energy_bound_mJ: float | None, count: int
    ) -> None:
        self._weights = weights.array()
        self._bounds = np.array([np.inf if b is None else b for b in (error_bound_um, energy_bound_mJ)])
        self.total = np.zeros(count)
        self.terms = np.zeros((len(TERMS), count))  # (len(TERMS), n)
        # (n,): a lost wire and an end by a limit count 1 each, and so does every second beyond a bound
        self.cost = np.zeros(count)
        self.area_mm2 = np.zeros(count)

    def begin(self) -> None:
        """Begin a step of all sub-environments."""
        self.total[:] = 0.0
        self.terms[:] = 0.0
        self.cost[:] = 0.0
        self.area_mm2[:] = 0.0

    def add(
        self, indices: NDArray[np.int64], rows: NDArray[np.void], error_um: NDArray[np.float64],
        windows: NDArray[np.void],
    ) -> None:
        """Add a window of some sub-environments (m,), with the path errors (n,) that count."""
        self.area_mm2[indices] += rows["area_mm2"][indices]
        _add(indices, rows, error_um, windows, self._weights, self._bounds, self.terms, self.total, self.cost)


@exactly_compiled
def _add(
    indices: NDArray[np.int64], rows: NDArray[np.void], error_um: NDArray[np.float64], windows: NDArray[np.void],
    weights: NDArray[np.float64], bounds: NDArray[np.float64], terms: NDArray[np.float64],
    total: NDArray[np.float64], cost: NDArray[np.float64],
) -> None:
    """Add a window's terms, their sum and its cost."""
    for j in range(indices.shape[0]):
        i = indices[j]
        counts, cause = windows[i].counts, rows[i].cause
        pulses = counts[OPEN] + counts[SPARK] + counts[ARC] + counts[SHORT]
        passed = rows[i].area_mm2 / REFERENCE_MM2
        spent = windows[i].duration_ns / (REFERENCE_S * 1e9)
        short, open_ = weights[_SHORT] * counts[SHORT] / pulses, weights[_OPEN] * counts[OPEN] / pulses
        profile = weights[_PROFILE] * (error_um[i] / ERROR_UM) * passed
        roughness = weights[_ROUGHNESS] * max(rows[i].energy_mJ / bounds[1] - 1.0, 0.0) * passed
        terms[_PROGRESS, i] += weights[_PROGRESS] * passed
        terms[_SHORT, i] -= short * spent
        terms[_OPEN, i] -= open_ * spent
        terms[_PROFILE, i] -= profile
        terms[_ROUGHNESS, i] -= roughness
        terms[_TIME, i] -= weights[_TIME] * spent
        total[i] += weights[_PROGRESS] * passed - (short + open_) * spent - profile - weights[_TIME] * spent
        total[i] -= roughness
        beyond = (1.0 if error_um[i] > bounds[0] else 0.0) + (1.0 if rows[i].energy_mJ > bounds[1] else 0.0)
        cost[i] += beyond * windows[i].duration_ns * 1e-9
        lost = rows[i].threading_s / REFERENCE_S
        if rows[i].broke:
            terms[_WIRE_BREAK, i] -= weights[_WIRE_BREAK] * lost
            total[i] -= weights[_WIRE_BREAK] * lost
            cost[i] += 1.0
        elif cause == DONE:
            terms[_DONE, i] += weights[_DONE]
            total[i] += weights[_DONE]
        elif cause != RUNNING:
            terms[_LIMIT, i] -= weights[_LIMIT] * lost
            total[i] -= weights[_LIMIT] * lost
            cost[i] += 1.0
