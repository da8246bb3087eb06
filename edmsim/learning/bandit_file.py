"""A policy that tries settings of a law and prefers what cuts fastest: a Bayesian bandit with a learned prior.

Each setting has three unknown quantities on a machine (`QUANTITIES`). The file has their mean and covariance over
training machines, so the measurement of one setting also says something about the others. Settings are compared, and
not machines: the rate has an offset that is the same for all settings, unknown and drifting, as workpieces and the
law's own adaptation change it.

The file is one ``.json`` without code.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Final, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError, model_validator

from edmsim import models
from edmsim.controllers import from_text
from edmsim.controllers.feed.law import ServoLaw, TruthLaw
from edmsim.errors import InputError, invalid_entry, located
from edmsim.files import replacing
from edmsim.snapshots import Snapshots
from edmsim.user_code import policy_of

FORMAT: Final = "edmsim-bandit-1"
QUANTITIES = "logarithm of the rate", "share of open pulses", "share of short pulses"
OFFSET = 25.0
"""Variance of the rate's offset at the beginning: large, as no machine's rate is known (ours)."""
LEAST_FIFTH = 0.1
"""Share of the fullest fifth's ignitions from which on a fifth counts (ours: the edge of the metal may cut it)."""
Floats = NDArray[np.float64]
_Positive = Annotated[FiniteFloat, Field(gt=0)]
_Share = Annotated[FiniteFloat, Field(ge=0)]


class Choices(BaseModel):
    """What a bandit chooses among, and when."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    law: str  # see `edmsim.controllers.from_text`
    # parameters of the law by name, 2 settings or more. A new wire begins with the first.
    settings: Annotated[list[dict[str, FiniteFloat]], Field(min_length=2)]
    segment_s: _Positive  # cutting time between two decisions
    settle_s: _Share  # its beginning, which is not measured
    # cutting time with the first setting of the first wire, in which the law may ramp up, and of every later one
    first_s: _Share
    start_s: _Share
    # cutting time at the beginning in which a setting is tried once that would be the best with a rate `trial_bonus`
    # standard deviations above the expected one, the most promising first
    trial_s: _Share
    trial_bonus: _Share
    bonus: _Share  # later, a setting is chosen by its expected rate plus this many standard deviations

    @model_validator(mode="after")
    def _measures(self) -> Self:
        """Refuse segments without a measurement."""
        if self.settle_s >= self.segment_s:
            raise ValueError(f"settle_s ({self.settle_s:g}) must be below segment_s ({self.segment_s:g})")
        return self


class BanditCard(Choices):
    """Contents of the file: choices, and a prior."""

    format: Literal["edmsim-bandit-1"]  # `FORMAT`
    env_id: str  # environment of the training
    environment: dict[str, Any]  # and its arguments
    mean: list[FiniteFloat]  # of the quantities, each for all settings: (3 n)
    covariance: list[list[FiniteFloat]]  # of the same: (3 n, 3 n)
    # standard deviations of a segment's measurement of each quantity
    noise: Annotated[list[_Positive], Field(min_length=3, max_length=3)]
    offset_drift: _Share  # standard deviation of the change of the offset per segment
    drift: _Share  # and of the change of each setting's logarithm of the rate
    breaks: list[_Share]  # of training machines: lost wires per second of cutting with each setting
    breaks_s: _Positive  # cutting time with a setting after which its own lost wires count as much as `breaks`
    # algorithm, command, seed, steps, versions, scores: see `edmsim.learning.policy_file.Card`; a step is a segment
    algorithm: str
    command: str
    seed: int | None
    steps: int
    versions: dict[str, str]
    scores: list[dict[str, Any]] = []

    @model_validator(mode="after")
    def _fits(self) -> Self:
        """Refuse arrays of another size."""
        size = len(QUANTITIES) * len(self.settings)
        if len(self.mean) != size or [len(row) for row in self.covariance] != [size] * size:
            raise ValueError(f"mean and covariance must have {size} entries, {len(QUANTITIES)} for each setting")
        if len(self.breaks) != len(self.settings):
            raise ValueError(f"breaks must have {len(self.settings)} entries, one for each setting")
        return self


class Segment(NamedTuple):
    """Measurement of a segment: see `QUANTITIES`."""

    log_rate: float
    open: float
    short: float


@dataclass
class Belief(Snapshots):
    """Mean and covariance of what the settings do on the present machine."""

    STATE = ("mean", "covariance", "lost", "cut_s")

    card: BanditCard

    mean: Floats = field(default_factory=lambda: np.zeros(0), init=False)
    covariance: Floats = field(default_factory=lambda: np.zeros((0, 0)), init=False)
    lost: Floats = field(default_factory=lambda: np.zeros(0), init=False)  # wires with each setting
    cut_s: Floats = field(default_factory=lambda: np.zeros(0), init=False)  # time with each setting

    def __post_init__(self) -> None:
        self.begin()

    def begin(self) -> None:
        """Begin with what was learned of other machines."""
        self.mean = np.array(self.card.mean)
        self.covariance = np.array(self.card.covariance)
        self.covariance[self._rates, self._rates] += OFFSET
        self.lost, self.cut_s = np.zeros((2, len(self.card.settings)))

    @property
    def _rates(self) -> slice:
        return slice(0, len(self.card.settings))

    def learn(self, setting: int, measured: Segment) -> None:
        """Take in a segment with a setting (Kalman filter), then the drift until the next."""
        count = len(self.card.settings)
        for k, (value, noise) in enumerate(zip(measured, self.card.noise, strict=True)):
            row = self.covariance[k * count + setting].copy()
            gain = row / (row[k * count + setting] + noise**2)
            self.mean = self.mean + gain * (value - self.mean[k * count + setting])
            self.covariance = self.covariance - gain[:, None] * row
        self.covariance[self._rates, self._rates] += self.card.offset_drift**2
        self.covariance[range(count), range(count)] += self.card.drift**2

    def net(self, lost_s: float) -> Floats:
        """Return the logarithm of each setting's rate, less what wires will take that are lost at `lost_s` each."""
        # the mean of the gamma distribution that these wires in this time leave
        per_s = (np.array(self.card.breaks) * self.card.breaks_s + self.lost) / (self.card.breaks_s + self.cut_s)
        return np.asarray(self.mean[self._rates] - np.log1p(per_s * lost_s))

    def at_best(self, bonus: float, lost_s: float) -> Floats:
        """Return the net rates, each plus this many standard deviations of its lead over the greatest of them."""
        rates, covariance = self.net(lost_s), self.covariance[self._rates, self._rates]
        first = int(np.argmax(rates))
        variance = np.diag(covariance)
        lead = variance + variance[first] - 2.0 * covariance[first]
        return np.asarray(rates + bonus * np.sqrt(np.maximum(lead, 0.0)))


def law_of(choices: Choices) -> ServoLaw:
    """Make the law below a bandit, which must be edmsim's and have the settings' parameters."""
    law = None if ".py:" in choices.law else from_text(choices.law)
    if not isinstance(law, ServoLaw) or isinstance(law, TruthLaw):
        raise InputError(f"a bandit sets a law of edmsim that a machine could have, not '{choices.law}'")
    for setting in choices.settings:
        for name in setting:
            if not any(hasattr(part, name) for part in law.parts):
                raise InputError(f"the law '{choices.law}' has no parameter '{name}' that could be set")
    return law


def height_share(fifths: Sequence[int]) -> float:
    """Return the local height over the greatest one, by the ignitions in each fifth of the latter."""
    # ignitions are spread about evenly over the height, so that all of them over those of a full fifth, the median
    # of the fifths with ignitions, is the number of fifths in the metal; on training machines within some 3 %
    counts = np.asarray(fifths, np.float64)
    full = np.median(counts[counts > LEAST_FIFTH * counts.max()]) if counts.any() else math.nan
    return float(counts.sum() / full / len(counts))


def find(name: str) -> Path | None:
    """Return the file of a bandit by its path or its name under ``models/policies``; None for other policies."""
    name = policy_of(name)
    shipped = name in models.policies()
    file = models.path(f"policies/{name}.json") if shipped else Path(name)
    if file.suffix != ".json" or not file.is_file():
        return None
    try:
        stored = json.loads(file.read_bytes())
    except (OSError, ValueError, RecursionError):
        return None
    return file if isinstance(stored, dict) and stored.get("format") == FORMAT else None


def load(file: Path) -> BanditCard:
    """Read a file that `find` has found; raises `InputError` if it is damaged, or its law cannot be made."""
    try:
        card = BanditCard.model_validate_json(file.read_bytes())
    except ValidationError as error:
        raise InputError(f"this is a damaged policy: {invalid_entry(error)}", file) from None
    with located(file):
        law_of(card)
    return card


def write(card: BanditCard, file: Path) -> None:
    """Write the file."""
    with replacing(file) as partial:
        partial.write_text(card.model_dump_json(indent=1) + "\n", encoding="utf-8")
