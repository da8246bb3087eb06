"""The reward: unit-free terms of one window, each with a weight."""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import exactly_compiled
from edmsim.envs.path_follower import DONE, RUNNING
from edmsim.numeric import to_plain_numbers, within
from edmsim.plant.kernel.state import ARC, OPEN, SHORT, SPARK

REFERENCE_MM2_MIN = 30.0  # cutting rate that earns 1 per reference window (ours)
REFERENCE_S = 0.0255  # the reference window: 255 pulses of 100 us, the standard setting
REFERENCE_MM2 = REFERENCE_MM2_MIN / 60 * REFERENCE_S  # area cut in a reference window at the reference rate
MOST_WEIGHT = 1e9  # greatest weight of a term (ours: beyond all use; rewards stay finite)
ERROR_UM = 10.0
"""Profile error whose cost equals the gain of the progress made with it, at equal weights (ours: the rounding of a
sharp corner at the standard setting)."""

@dataclass(frozen=True, kw_only=True)
class WeightsOfTerms:
    """Weights of a reward's terms, each a number from 0 to `MOST_WEIGHT`."""

    def __post_init__(self) -> None:
        """Raise `InputError` for any other weight."""
        for f in fields(self):
            within(f"the weight {f.name}", getattr(self, f.name), 0.0, MOST_WEIGHT)
        to_plain_numbers(self)


@dataclass(frozen=True, kw_only=True)
class Weights(WeightsOfTerms):
    """Weights of the reward's terms, 0 or more. The reward is gains minus costs."""

    # gain per reference area (`REFERENCE_MM2`) cut. The cut length follows the wire by the share of pulses that
    # ignite (see `path_follower.SUB_ENV`): pushing against metal gains nothing, nor does moving back and forth.
    progress: float = 1.0
    # cost of a reference window (`REFERENCE_S`) full of shorts; in proportion for a smaller share. It is per machine
    # time, independent of the pulse period.
    short: float = 0.5
    open: float = 0.1  # the same for open pulses
    # cost per reference area cut with the wire `ERROR_UM` from the path, independent of the time it takes
    profile: float = 0.0
    # cost per reference area cut with discharges of twice the energy bound (`Family.energy_bound_mJ`), in proportion
    # to the excess over the bound
    roughness: float = 0.0
    time: float = 0.0  # cost per reference window (`REFERENCE_S`) of machine time
    # wire_break, limit: cost of a broken wire, and of an episode's end by a limit: the area that the machine cuts at
    # the reference rate (`REFERENCE_MM2_MIN`) in the time of threading. Use 1 for machines that cut at that rate, 2
    # for twice the rate.
    wire_break: float = 1.0
    limit: float = 1.0
    done: float = 0.0  # gain for reaching the path's end


TERMS = tuple(f.name for f in fields(Weights))  # names of the reward's terms, in the order of their weights
_ACCOUNT = np.dtype(
    [(name, "f8") for name in TERMS]
    + [
        ("total", "f8"),  # sum of the terms
        ("cost", "f8"),  # 1 for a lost wire, 1 for an end by a limit, and 1 for every second beyond a bound
        ("area_mm2", "f8"),
    ]
)
"""Terms of the reward, and cost, of a step of a sub-environment."""
_WEIGHTS = np.dtype([(name, "f8") for name in TERMS] + [("error_um", "f8"), ("energy_mJ", "f8")])
"""Weights of the terms, and bounds beyond which time costs."""


class StepRewards:
    """Rewards and costs of the sub-environments' steps; time beyond a bound of path error or energy costs."""

    def __init__(self, count: int) -> None:
        self._weights: NDArray[np.void] = np.zeros(count, _WEIGHTS)
        self.rows: NDArray[np.void] = np.zeros(count, _ACCOUNT)  # (n,) `_ACCOUNT` of the last step

    def weigh(
        self, index: int, weights: Weights, error_bound_um: float | None, energy_bound_mJ: float | None
    ) -> None:
        """Set weights and bounds for the next episode of a sub-environment."""
        bounds = (np.inf if bound is None else bound for bound in (error_bound_um, energy_bound_mJ))
        self._weights[index] = (*(getattr(weights, name) for name in TERMS), *bounds)

    @property
    def terms(self) -> dict[str, NDArray[np.float64]]:
        """Terms (n,) of the step's rewards by name."""
        return {name: self.rows[name] for name in TERMS}

    def begin(self) -> None:
        """Begin a step of all sub-environments in new records, because callers may hold those of the last step."""
        self.rows = np.zeros(len(self.rows), _ACCOUNT)

    def add(self, indices: NDArray[np.int64], rows: NDArray[np.void], windows: NDArray[np.void]) -> None:
        """Add a window of some sub-environments (m,); `rows` are all `path_follower.SUB_ENV`."""
        _add(indices, rows, windows, self._weights, self.rows)


@exactly_compiled
def _add(
    indices: NDArray[np.int64], rows: NDArray[np.void], windows: NDArray[np.void], weights: NDArray[np.void],
    accounts: NDArray[np.void],
) -> None:
    """Add a window's terms, their sum, its cost and its area."""
    for j in range(indices.shape[0]):
        i = indices[j]
        row, window, account, weight = rows[i], windows[i], accounts[i], weights[i]
        error = row.error_um if row.near else 0.0
        counts, cause, energy_mJ, spent_ns = window.counts, row.cause, row.energy_mJ, window.duration_ns
        shorts, opens = counts[SHORT], counts[OPEN]
        pulses = opens + counts[SPARK] + counts[ARC] + shorts
        passed = row.area_mm2 / REFERENCE_MM2
        spent = spent_ns / (REFERENCE_S * 1e9)
        short, open_ = weight.short * shorts / pulses, weight.open * opens / pulses
        profile = weight.profile * (error / ERROR_UM) * passed
        excess = energy_mJ / weight.energy_mJ - 1.0
        roughness = weight.roughness * (excess if excess > 0.0 else 0.0) * passed
        progress, time = weight.progress * passed, weight.time * spent
        account.progress += progress
        account.short -= short * spent
        account.open -= open_ * spent
        account.profile -= profile
        account.roughness -= roughness
        account.time -= time
        total = account.total + (progress - (short + open_) * spent - profile - time)
        total -= roughness
        beyond = (1.0 if error > weight.error_um else 0.0) + (1.0 if energy_mJ > weight.energy_mJ else 0.0)
        cost = account.cost + beyond * spent_ns * 1e-9
        lost = row.threading_s / REFERENCE_S
        if row.broke:
            account.wire_break -= weight.wire_break * lost
            total -= weight.wire_break * lost
            cost += 1.0
        elif cause == DONE:
            account.done += weight.done
            total += weight.done
        elif cause != RUNNING:
            account.limit -= weight.limit * lost
            total -= weight.limit * lost
            cost += 1.0
        account.total, account.cost = total, cost
        account.area_mm2 += row.area_mm2
