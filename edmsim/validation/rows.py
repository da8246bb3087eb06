"""A row of the validation table: published fact, simulated value, and whether they agree."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from edmsim.evaluation.compare import students_t

Simulated = float | Sequence[float] | NDArray[np.float64]
"""A number, or values of independent seeds, of which a row shows mean and interval."""
Kind = Literal["judged", "calibration", "context"]
"""Kinds of rows; only judged ones count. See `Row.calibration` and `Row.context`."""


@dataclass(frozen=True)
class Row:
    """A fact, published or in closed form, and its simulated counterpart.

    Build it with `Row.value`, `Row.band` or `Row.sign`, which set `passed`, or with `Row.report`.
    """

    topic: str  # "ignition", "crater", "wire", "pulse ratios", ...
    name: str  # name of the compared quantity: "median delay at 20 um"
    source: str  # citation of the published fact
    published: str  # published value, band or sign as text with unit: "132 us", "10..60 mm2/min", "falls"
    simulated: float  # central value; for a sign the difference (changed minus base)
    uncertainty: float  # half width of the 95 % interval over seeds or draws; 0 if exact
    unit: str  # unit of `simulated` and `uncertainty`
    tolerance: str  # criterion of agreement, as text
    passed: bool
    # page that explains a failure: "docs/theory/breakdown.md#two-regimes". A row that fails without a note is
    # unexpected.
    note: str = ""
    kind: Kind = "judged"  # only a judged row counts as agreement or failure: judged, calibration, context
    reason: str = ""  # reason why a row of another kind does not count

    @property
    def unexpected(self) -> bool:
        """Whether the row is judged, fails, and has no note."""
        return self.kind == "judged" and not self.passed and not self.note

    def calibration(self, constant: str) -> Self:
        """Return the row as one that does not count, because a constant was chosen to match its fact."""
        return replace(self, kind="calibration", reason=constant)

    def context(self, reason: str) -> Self:
        """Return the row as one that does not count, for a reason in its source."""
        return replace(self, kind="context", reason=reason)

    @classmethod
    def report(cls, topic: str, name: str, reason: str, *, simulated: Simulated, unit: str = "") -> Self:
        """Return a simulated figure without a published one, as context; `reason` says why there is none."""
        mean, half = _central(simulated)
        return cls(
            topic, name, "", "nothing found in print", mean, half, unit, "none asked for", True, kind="context",
            reason=reason,
        )

    @classmethod
    def value(
        cls, topic: str, name: str, source: str, *, published: float, simulated: Simulated, within: float,
        uncertainty: float = 0.0, unit: str = "", note: str = "",
    ) -> Self:
        """Compare with a published value, not 0; passes within a share of it, if the interval is not wider."""
        mean, half = _central(simulated, uncertainty)
        tolerance = within * abs(published)
        passed = abs(mean - published) <= tolerance and half <= tolerance
        return cls(
            topic, name, source, _text(published, unit), mean, half, unit,
            f"within {100 * within:g} %, and known to it", bool(passed), note,
        )

    @classmethod
    def band(
        cls, topic: str, name: str, source: str, *, simulated: Simulated, low: float = -math.inf,
        high: float = math.inf, published: str = "", uncertainty: float = 0.0, unit: str = "", note: str = "",
    ) -> Self:
        """Compare with a published band; passes if the central value is in it. `published` replaces its text."""
        if math.isinf(low):
            words, allowed = f"at most {_text(high, unit)}", f"<= {_text(high, unit)}"
        elif math.isinf(high):
            words, allowed = f"at least {_text(low, unit)}", f">= {_text(low, unit)}"
        else:
            words, allowed = f"{low:.4g}..{_text(high, unit)}", f"{low:.4g}..{_text(high, unit)}"
        mean, half = _central(simulated, uncertainty)
        return cls(
            topic, name, source, published or words, mean, half, unit, f"central value {allowed}",
            bool(low <= mean <= high), note,
        )

    @classmethod
    def sign(
        cls, topic: str, name: str, source: str, *, rises: bool, simulated: Simulated,
        uncertainty: float = 0.0, published: str = "", unit: str = "", note: str = "",
    ) -> Self:
        """Compare with the published sign of a difference, changed minus base; the whole interval must have it."""
        mean, half = _central(simulated, uncertainty)
        passed = mean - half > 0 if rises else mean + half < 0
        return cls(
            topic, name, source, published or ("rises" if rises else "falls"), mean, half, unit,
            f"{'above' if rises else 'below'} 0 with its whole 95 % interval", bool(passed), note,
        )


Seeds = Sequence[int]
Check = Callable[[Seeds], list[Row]]
"""Simulates with seeds and returns rows; the same seeds give the same rows."""
Checks = Mapping[Check, tuple[str, ...]]
"""Checks, each with the topics of its rows."""


def mean_and_interval(values: Sequence[float] | NDArray[np.float64]) -> tuple[float, float]:
    """Return the mean of values and half the width of its 95 % interval (Student's t), infinite for one value."""
    data = np.asarray(values, float)
    n = data.size
    if n < 2:
        return float(data.mean()), math.inf
    return float(data.mean()), float(students_t(n - 1) * data.std(ddof=1) / math.sqrt(n))


def _central(simulated: Simulated, uncertainty: float = 0.0) -> tuple[float, float]:
    if isinstance(simulated, float | int):
        return float(simulated), float(uncertainty)
    return mean_and_interval(simulated)


def differences(
    before: Iterable[Any], after: Iterable[Any], of: Callable[[Any], float] = lambda value: value
) -> list[float]:
    """Return the change of a figure, after minus before, for every seed."""
    return [of(b) - of(a) for a, b in zip(before, after, strict=True)]


def ratios(
    before: Iterable[Any], after: Iterable[Any], of: Callable[[Any], float] = lambda value: value
) -> list[float]:
    """Return the ratio of a figure, after over before, for every seed."""
    return [of(b) / of(a) for a, b in zip(before, after, strict=True)]


def extended(seeds: Seeds, count: int) -> Seeds:
    """Return `count` seeds from the first one on, for a row that needs more seeds; none if there are none."""
    return range(seeds[0], seeds[0] + count) if seeds else ()


def worst(compared: Iterable[tuple[float, float, str]]) -> tuple[float, float, str]:
    """Return the (published, simulated, name) with the greatest relative difference."""
    return max(compared, key=lambda item: abs(item[1] / item[0] - 1))


def _text(value: float, unit: str) -> str:
    return f"{value:.4g} {unit}".strip()
