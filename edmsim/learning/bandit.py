"""A policy that tries settings of a law and prefers those that cut fastest: a Bayesian bandit with a learned prior.

Each setting has three unknown quantities on a machine (`QUANTITIES`). The file has their mean and covariance over
training machines, so the measurement of one setting also says something about the others. Settings are compared, and
not machines: the rate has an unknown, drifting offset that is the same for all settings, because workpieces and the
law's own adaptation change it. The file is one ``.json`` without code.

Training (`train`) needs no extra:

1. `record` cuts on a training machine with all settings in random order, and returns the measurements of segments.
2. `prior_of` fits what machines have in common: mean and covariance of the quantities over machines, the noise of a
   segment's measurement, and the drift.

Basu et al., "No Regrets for Learning the Prior in Bandits" (NeurIPS 2021), learn a bandit's prior in a similar way.
A machine does not know the area that it cuts; the histories have the true one, and `BanditSettings.meter` is the
error of the measured rate.
"""

import json
import math
from collections.abc import Callable, Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, FiniteFloat, ValidationError, model_validator

from edmsim import files, models, numeric, runs, screen, user_code
from edmsim.controllers import from_text
from edmsim.controllers.feed.law import ServoLaw, TruthLaw
from edmsim.controllers.protocols import FeedCommand, WindowObservation, set_up_controller
from edmsim.envs import episode, families, registry
from edmsim.errors import InputError, invalid_entry, located
from edmsim.evaluation.episode import HELD_BACK, Episode, engine_of
from edmsim.learning.hyperparameters import HISTORIES
from edmsim.machine.machine import Machine
from edmsim.machine.setting import WINDOW_PULSES
from edmsim.snapshots import Snapshots

FORMAT: Final = "edmsim-bandit-1"
QUANTITIES = "logarithm of the rate", "share of open pulses", "share of short pulses"
OFFSET = 25.0
"""Initial variance of the rate's offset (ours: large, because a machine's rate is unknown)."""
LEAST_FIFTH = 0.1
"""Least ignitions of a fifth that counts, as a share of the fullest (ours: the metal's edge may lie in a fifth)."""
FIRST_SEED = 21_000
"""Seed of the first training machine of a training with seed 0."""
LEAST_PASSES = 2  # with fewer, all differences between segments are due to settings, so the noise is unknown
LEAST_SPREAD = 0.1
"""Least variance of the factor on the rate of lost wires among settings, and among machines (ours: few are lost)."""
Floats = NDArray[np.float64]
_Positive = Annotated[FiniteFloat, Field(gt=0)]
_Share = Annotated[FiniteFloat, Field(ge=0)]


class BanditChoices(BaseModel, extra="forbid", frozen=True):
    """What a bandit chooses among, and when."""

    law: str  # see `edmsim.controllers.from_text`
    # parameters of the law by name, 2 settings or more. A new wire begins with the first.
    settings: Annotated[list[dict[str, FiniteFloat]], Field(min_length=2)]
    segment_s: _Positive  # cutting time between two decisions
    settle_s: _Share  # its beginning, which is not measured
    # first_s, start_s: cutting time with the first setting, in which the law may ramp up, of the first wire and of
    # every later one
    first_s: _Share
    start_s: _Share
    # cutting time at the beginning, in which each setting is tried once if it would be the best with a rate
    # `trial_bonus` standard deviations above the expected one; the most promising is tried first
    trial_s: _Share
    trial_bonus: _Share
    bonus: _Share  # later, a setting is chosen by its expected rate plus this many standard deviations

    @model_validator(mode="after")
    def _measures(self) -> Self:
        """Raise `ValueError` if a segment has no time for a measurement."""
        if self.settle_s >= self.segment_s:
            raise ValueError(f"settle_s ({self.settle_s:g}) must be below segment_s ({self.segment_s:g})")
        return self


class BanditCard(BanditChoices, frozen=True):
    """Contents of the file: choices, and a prior."""

    format: Literal["edmsim-bandit-1"]  # `FORMAT`
    env_id: str  # environment of the training
    environment: dict[str, Any]  # its arguments
    mean: list[FiniteFloat]  # of the quantities, each for all settings: (3 n)
    covariance: list[list[FiniteFloat]]  # of the same: (3 n, 3 n)
    # standard deviations of a segment's measurement of each quantity
    noise: Annotated[list[_Positive], Field(min_length=3, max_length=3)]
    offset_drift: _Share  # standard deviation of the change of the offset per segment
    drift: _Share  # the same for each setting's logarithm of the rate
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
        """Raise `ValueError` if an array has the wrong size."""
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


class Belief(Snapshots):
    """Estimate of the settings' `QUANTITIES` on the present machine: mean and covariance."""

    STATE = ("mean", "covariance", "lost", "cut_s")

    def __init__(self, card: BanditCard) -> None:
        self.card = card
        self._rates = slice(0, len(card.settings))
        self.begin()

    def begin(self) -> None:
        """Reset to the prior."""
        self.mean: Floats = np.array(self.card.mean)
        self.covariance: Floats = np.array(self.card.covariance)
        self.covariance[self._rates, self._rates] += OFFSET
        self.lost, self.cut_s = np.zeros((2, len(self.card.settings)))  # wires and cutting time by setting

    def learn(self, setting: int, measured: Segment) -> None:
        """Update with a segment of a setting (Kalman filter), then with the drift until the next segment."""
        count = len(self.card.settings)
        for k, (value, noise) in enumerate(zip(measured, self.card.noise, strict=True)):
            row = self.covariance[k * count + setting].copy()
            gain = row / (row[k * count + setting] + noise**2)
            self.mean = self.mean + gain * (value - self.mean[k * count + setting])
            self.covariance = self.covariance - gain[:, None] * row
        self.covariance[self._rates, self._rates] += self.card.offset_drift**2
        self.covariance[range(count), range(count)] += self.card.drift**2

    def net(self, lost_s: float) -> Floats:
        """Return the logarithm of each setting's rate, reduced by the time of lost wires, `lost_s` each."""
        # mean of the posterior gamma distribution of lost wires per second
        per_s = (np.array(self.card.breaks) * self.card.breaks_s + self.lost) / (self.card.breaks_s + self.cut_s)
        return np.asarray(self.mean[self._rates] - np.log1p(per_s * lost_s))

    def at_best(self, bonus: float, lost_s: float) -> Floats:
        """Return the net rates, each plus `bonus` standard deviations of its difference from the greatest."""
        rates, covariance = self.net(lost_s), self.covariance[self._rates, self._rates]
        first = int(np.argmax(rates))
        variance = np.diag(covariance)
        lead = variance + variance[first] - 2.0 * covariance[first]
        return np.asarray(rates + bonus * np.sqrt(np.maximum(lead, 0.0)))


def law_of(choices: BanditChoices) -> ServoLaw:
    """Make the law of a bandit; raise `InputError` if it is not edmsim's or lacks a parameter of the settings."""
    law = None if ".py:" in choices.law else from_text(choices.law)
    if not isinstance(law, ServoLaw) or isinstance(law, TruthLaw):
        raise InputError(f"a bandit sets a law of edmsim that a machine could have, not '{choices.law}'")
    for setting in choices.settings:
        for name in setting:
            if not any(hasattr(component, name) for component in law.components):
                raise InputError(f"the law '{choices.law}' has no parameter '{name}' that could be set")
    return law


def height_share(fifths: Sequence[int]) -> float:
    """Return the local height as a share of the greatest, from the ignitions in each fifth of the greatest."""
    # Ignitions are nearly uniform over the height. So their number, divided by that of a full fifth (the median of
    # those with ignitions), is the number of fifths in the metal; on training machines within some 3 %.
    counts = np.asarray(fifths, np.float64)
    full = np.median(counts[counts > LEAST_FIFTH * counts.max()]) if counts.any() else math.nan
    return float(counts.sum() / full / len(counts))


def find(name: str) -> Path | None:
    """Return the file of a bandit by its path or its name under ``models/policies``; None for other policies."""
    name = user_code.policy_of(name)
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
    """Read a file found by `find`; raise `InputError` if it is damaged, or its law cannot be made."""
    try:
        card = BanditCard.model_validate_json(file.read_bytes())
    except ValidationError as error:
        raise InputError(f"this is a damaged policy: {invalid_entry(error)}", file) from None
    with located(file):
        law_of(card)
    return card


def write(card: BanditCard, file: Path) -> None:
    """Write the file."""
    with files.replacing(file) as partial:
        partial.write_text(card.model_dump_json(indent=1) + "\n", encoding="utf-8")


class BanditController(Snapshots):
    """Cuts with a law, and learns which of its settings cuts fastest on this machine."""

    name: ClassVar[str] = "policy"
    STATE: ClassVar[tuple[str, ...]] = (
        "law", "belief", "setting", "clock_s", "spent_s", "path_um", "seconds", "way_um", "pulses", "open", "short",
        "fifths", "untried", "broken",
    )  # fmt: skip

    def __init__(self, card: BanditCard) -> None:
        self.card = card
        self.law = law_of(card)
        # the law's own values of parameters that only other settings name
        named = {name for setting in card.settings for name in setting}
        own = {name: getattr(one, name) for one in self.law.components for name in named if hasattr(one, name)}
        self._settings = [{**own, **setting} for setting in card.settings]
        self.belief = Belief(card)
        self.path_um = 0.0  # at the end of the last window
        self.lost_s = card.start_s  # time that a lost wire costs
        self._begin()

    def _begin(self) -> None:
        self.setting = 0
        self.untried = list(range(1, len(self.card.settings)))
        self.clock_s = -self.card.first_s  # since the setting was chosen; below 0 while a wire begins
        self.spent_s = 0.0  # cutting time
        self.broken = False  # whether a wire was lost
        self._clear()

    def _clear(self) -> None:
        """Begin a measurement."""
        self.seconds = self.way_um = 0.0
        self.pulses = self.open = self.short = 0
        self.fifths = np.zeros(5, np.int64)  # ignitions in each fifth of the height

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        """Set the machine and the path; called before every leg of the cut."""
        self.path_um = start_um
        self.lost_s = machine.base.table.threading_s.value + self.card.start_s
        self.law.override(self._settings[0])  # replaces the setting of the last leg
        set_up_controller(self.law, machine, points_um, start_um)

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a leg with the prior."""
        self.belief.begin()
        self._begin()
        return self.law.reset(max_feed_um_s)

    def wire_lost(self) -> FeedCommand:
        """Begin the next wire with the first setting; discard the unfinished segment."""
        if self.broken and self.clock_s >= 0.0:  # not the first, from which the law learns the wires' limit
            self.belief.lost[self.setting] += 1
        self.broken = True
        self.clock_s = -self.card.start_s
        self._clear()
        self.law.override(self._settings[0])
        return self.law.wire_lost()

    def update(self, window: WindowObservation) -> FeedCommand:
        """Measure, decide at the end of a segment, and return the law's command with the setting in force."""
        self.clock_s += window.duration_s
        self.spent_s += window.duration_s
        if self.clock_s >= 0.0:
            self.belief.cut_s[self.setting] += window.duration_s
        if self.clock_s > self.card.settle_s:
            self.seconds += window.duration_s
            self.way_um += window.path_um - self.path_um
            self.pulses += WINDOW_PULSES
            self.open += window.open
            self.short += window.short
            self.fifths += np.array(window.fifths)
        self.path_um = window.path_um
        if self.clock_s >= self.card.segment_s:
            self._end_segment()
        # set in every window, because the law's state does not include its arguments
        self.law.override(self._settings[self.setting if self.clock_s >= 0.0 else 0])
        return self.law.update(window)

    def _end_segment(self) -> None:
        """Learn from the segment's measurement, and choose the next segment's setting."""
        if self.way_um > 0.0 and self.fifths.any():
            log_rate = math.log(self.way_um / self.seconds * height_share(self.fifths.tolist()))
            self.learn(Segment(log_rate, self.open / self.pulses, self.short / self.pulses))
        self.setting = self.choose()
        self.clock_s = 0.0
        self._clear()

    def learn(self, measured: Segment) -> None:
        """Update the belief with a segment."""
        self.belief.learn(self.setting, measured)

    def choose(self) -> int:
        """Return the setting of the next segment."""
        if self.spent_s < self.card.trial_s:
            at_best = self.belief.at_best(self.card.trial_bonus, self.lost_s)
            promising = [k for k in self.untried if at_best[k] > self.belief.net(self.lost_s).max()]
            if promising:
                setting = max(promising, key=lambda k: float(at_best[k]))
                self.untried.remove(setting)
                return setting
        return int(np.argmax(self.belief.at_best(self.card.bonus, self.lost_s)))


class BanditSettings(BanditChoices, frozen=True):
    """Settings of a training: those of the policy (see `BanditChoices`), and of its prior."""

    machines: Annotated[int, Field(ge=2)]  # training machines, 2 or more
    # segments with each setting on every training machine; the first segment has the first setting, so one setting,
    # the last of its random order, has a segment less
    passes: Annotated[int, Field(ge=LEAST_PASSES + 1)]
    # share by which the covariance over machines is moved towards its diagonal, because machines are few
    shrink: Annotated[FiniteFloat, Field(ge=0, le=1)]
    meter: _Positive  # standard deviation of the measured rate's logarithm from the true one's
    # standard deviation of the change of a setting's logarithm of the rate per segment, relative to the others
    drift: Annotated[FiniteFloat, Field(ge=0)]

    @property
    def segments(self) -> int:
        """Segments on every training machine."""
        return self.passes * len(self.settings)


class History(NamedTuple):
    """Record of a training machine."""

    rows: list[list[float]]  # (n, 5): setting, shares of opens and shorts, seconds and area in mm2 of each segment
    lost: list[float]  # lost wires with each setting
    cut_s: list[float]  # cutting time with each setting


def settings_of(env_id: str, file: Path | None = None) -> BanditSettings:
    """Return the settings of a shift from ``models/training/NAME-bandit.toml``, with overrides from a file of yours.

    Raises `InputError` if a setting is invalid.
    """
    family, _ = registry.find(env_id)
    if not issubclass(family, families.Shift):
        raise InputError(
            f"{env_id} is no shift: a bandit needs one to adapt in, edmsim/MaxRateShift-v0 or edmsim/ThinWireShift-v0"
        )
    usual = files.read_toml(models.path(f"training/{registry.base_of(family)}-bandit.toml"))
    try:
        settings = BanditSettings.model_validate(usual if file is None else usual | files.read_toml(file))
    except ValidationError as error:
        raise InputError(invalid_entry(error), file) from None
    with located(file):
        law_of(settings)
    return settings


class Prior(NamedTuple):
    """What machines have in common; see `BanditCard`."""

    mean: Sequence[float]
    covariance: Sequence[Sequence[float]]
    noise: Sequence[float]
    offset_drift: float
    breaks: Sequence[float]
    breaks_s: float


def card_of(env_id: str, settings: BanditSettings, prior: Prior, command: str, seed: int, steps: int) -> BanditCard:
    """Return a policy with these settings and this prior; `steps` is the number of segments of its training."""
    choices = {name: getattr(settings, name) for name in BanditChoices.model_fields}
    versions = {name: version(name) for name in ("edmsim", "numpy")}
    return BanditCard(
        format=FORMAT, env_id=env_id, environment={}, **choices, **prior._asdict(), drift=settings.drift,
        algorithm="bandit", command=command, seed=seed, steps=steps, versions=versions,
    )  # fmt: skip


# 1. histories of training machines


class Trier(BanditController):
    """Tries all settings in random order, and records the measurement of each segment."""

    def __init__(self, env_id: str, settings: BanditSettings, seed: int) -> None:
        count = len(settings.settings)
        unknown = Prior([0.0] * 3 * count, np.eye(3 * count).tolist(), [1.0] * 3, 0.0, [0.0] * count, 1.0)
        super().__init__(card_of(env_id, settings, unknown, "", seed, 0))
        self.rows: list[tuple[int, float, float]] = []  # setting, shares of opens and shorts
        self._random = np.random.default_rng(seed)
        self._order: list[int] = []

    def learn(self, measured: Segment) -> None:
        """Record a segment."""
        self.rows.append((self.setting, measured.open, measured.short))

    def choose(self) -> int:
        """Return the next setting; all are tried once before any is repeated."""
        self._order = self._order or list(self._random.permutation(len(self.card.settings)))
        return int(self._order.pop())


def record(env_id: str, settings: BanditSettings, seed: int) -> dict[str, Any]:
    """Return a training machine's `History`: `BanditSettings.segments` segments, or up to the end of the shift."""
    trier = Trier(env_id, settings, seed)
    cut = Episode(episode.Task(env_id, test_s=0.0), trier, seed, "trier")
    rows: list[list[float]] = []
    seconds, area, measured = 0.0, 0.0, False
    for window in cut.windows():
        if measured or trier.seconds > 0.0:  # the segment's measurement has begun
            seconds += window.observation.duration_s
            area += window.area_mm2
        if len(trier.rows) > len(rows):
            rows.append([*trier.rows[-1], seconds, area])
        measured = trier.seconds > 0.0
        if not measured:  # a segment or a wire has ended
            seconds = area = 0.0
        if len(rows) == settings.segments:
            break
    return History(rows, trier.belief.lost.tolist(), trier.belief.cut_s.tolist())._asdict()


# 2. what machines have in common


def effects(values: Floats, setting: NDArray[np.int64], count: int) -> tuple[Floats, Floats, Floats]:
    """Return the effects of settings (count,) and of passes (p,) on values (n,), and the residuals (n,)."""
    passes = np.arange(len(values)) // count
    design = np.concatenate([np.eye(count)[setting], np.eye(passes[-1] + 1)[passes]], axis=1)
    found = np.linalg.lstsq(design, values, rcond=None)[0]
    offset = found[count:].mean()
    return found[:count] + offset, found[count:] - offset, values - design @ found


def prior_of(histories: Sequence[History], settings: BanditSettings) -> Prior:
    """Return the prior that fits these machines; those that tried a setting less than twice are left out."""
    count = len(settings.settings)
    machines, left, moved = [], [], []
    for history in histories:
        rows = np.array(history.rows, float).reshape(-1, 5)
        rows = rows[(rows[:, 3] > 0) & (rows[:, 4] > 0)]
        setting = rows[:, 0].astype(np.int64)
        if np.bincount(setting, minlength=count).min() < LEAST_PASSES:
            continue
        log_rate = np.log(rows[:, 4] / rows[:, 3])
        found = [effects(values, setting, count) for values in (log_rate, rows[:, 1], rows[:, 2])]
        rates = found[0][0] - found[0][0].mean()  # relative to the machine's mean
        machines.append(np.concatenate([rates, found[1][0], found[2][0]]))
        freedom = len(rows) - len(found[0][0]) - len(found[0][1]) + 1
        left.append([(each[2] ** 2).sum() / freedom for each in found])
        moved.append(np.diff(found[0][1]))
    if len(machines) < 2:
        raise InputError(
            f"only {len(machines)} of {len(histories)} training machines cut with every setting {LEAST_PASSES} "
            "times: give shorter segments or settings that lose fewer wires"
        )
    noise = np.sqrt(np.mean(left, axis=0) + np.array([settings.meter**2, 0.0, 0.0]))
    covariance = np.cov(np.array(machines).T)
    covariance = (1.0 - settings.shrink) * covariance + settings.shrink * np.diag(np.diag(covariance))
    offset_drift = math.sqrt(float(np.mean(np.concatenate(moved) ** 2)) / count)
    lost, cut_s = (np.array(each) for each in zip(*((one.lost, one.cut_s) for one in histories), strict=True))
    return Prior(
        np.mean(machines, axis=0).tolist(), covariance.tolist(), noise.tolist(), offset_drift, *breaks_of(lost, cut_s)
    )


def breaks_of(lost: Floats, cut_s: Floats) -> tuple[list[float], float]:
    """Return lost wires per second by setting, and the cutting time whose own lost wires have the same weight."""
    # Numbers of lost wires (machines, settings) in times of the same shape are Poisson. A setting's rate is the mean
    # rate times a factor of a gamma distribution; a machine's rate is that of the setting times another. A factor's
    # variance follows from that of the numbers, so a setting with few lost wires is moved towards the others.
    total, time_s = lost.sum(axis=0), cut_s.sum(axis=0)
    # one more wire than was lost, because no rate may be 0
    mean_per_s = (total.sum() + 1.0) / time_s.sum()
    alike = _shape(total, time_s * mean_per_s)
    per_s = (total + alike) / (time_s + alike / mean_per_s)
    if not total.any():
        return per_s.tolist(), float(cut_s.sum())
    return per_s.tolist(), _shape(lost, cut_s * per_s) / float(mean_per_s)


def _shape(lost: Floats, expected: Floats) -> float:
    """Return the shape of the gamma distribution of factors on expected numbers of lost wires."""
    beyond = float(((lost - expected) ** 2 - expected).sum() / (expected**2).sum())  # variance of the factor
    return 1.0 / max(beyond, LEAST_SPREAD)


def described(card: BanditCard) -> screen.ScreenTable:
    """Return a table of the differences between settings on training machines."""
    deviations, count = np.sqrt(np.diag(np.array(card.covariance))), len(card.settings)
    heads = "rate relative to the others, %", "opens, %", "shorts, %", "wires lost per hour"
    table = screen.ScreenTable("setting", numbers=heads)
    for k, setting in enumerate(card.settings):
        rate = f"{100 * card.mean[k]:+.1f} ± {100 * deviations[k]:.1f}"
        shares = (f"{100 * card.mean[k + part * count]:.0f}" for part in (1, 2))
        as_parameters = ",".join(f"{name}={value:g}" for name, value in setting.items())
        table.add_row(as_parameters, rate, *shares, f"{3600 * card.breaks[k]:.1f}")
    return table


# 3. the whole training, which can be resumed


def train(
    env_id: str, out: Path, *, steps: int | None = None, seed: int = 0, resume: bool = False,
    settings: BanditSettings | None = None, command: str = "", options: str = "",
    watch: Callable[[int, int], None] | None = None,
) -> BanditCard:
    """Record training machines of a shift into `HISTORIES`, and return the policy whose prior fits them.

    `steps` is the number of segments on all machines, rounded up to whole machines. With `resume` the settings and
    options of the histories apply. Without `steps` the policy learns from the number of machines in its settings, or
    from all machines of the histories if they have more.
    """
    file = out / HISTORIES
    if resume:
        settings, options = _before(file)
    settings = settings or settings_of(env_id)
    machines = settings.machines
    if steps is not None:
        machines = max(math.ceil(numeric.whole_from("steps", steps, 1) / settings.segments), 2)
    if not resume:
        settings = settings.model_copy(update={"machines": machines})
    first = FIRST_SEED + seed
    numeric.whole_within("seed", seed, 0, HELD_BACK - FIRST_SEED - machines)
    _check_time(env_id, settings)
    known_as, _ = registry.stand_in(*registry.find(env_id))  # raises `InputError` if no policy file can describe it
    with files.locked(out, "edmsim train"):
        of = {"env_id": env_id, "seed": seed, "settings": settings.model_dump(), "options": options}
        table = runs.RunTable(file, of)
        if steps is not None and machines < len(table.rows):
            done = len(table.rows) * settings.segments
            raise InputError(f"the training there has {done} steps: give as many or more, not {steps}", out)
        machines = max(machines, len(table.rows))
        seeds = range(first, first + machines)
        rows = runs.perform(
            partial(record, env_id, settings), seeds, watch, table=table, ids=[str(number) for number in seeds],
            engine=engine_of(env_id, machines, settings.segments * settings.segment_s),
        )  # fmt: skip
    histories = _histories(rows, len(settings.settings), file)
    command += f" --steps {machines * settings.segments} --seed {seed}{options}"
    segments = sum(len(history.rows) for history in histories)
    return card_of(known_as, settings, prior_of(histories, settings), command, seed, segments)


def _histories(rows: Sequence[dict[str, Any]], count: int, file: Path) -> list[History]:
    """Return the histories of a table's rows, with `count` settings."""
    try:
        for row in rows:
            segments = np.array(row["rows"], float).reshape(-1, 5)
            totals = np.array([row["lost"], row["cut_s"]], float).reshape(2, count)
            if not (np.isfinite(segments).all() and np.isfinite(totals).all()):
                raise ValueError("numbers that are not finite")
            if not np.isin(segments[:, 0], np.arange(count)).all():
                raise ValueError("an unknown setting")
        return [History(row["rows"], row["lost"], row["cut_s"]) for row in rows]
    except (ValueError, LookupError, TypeError) as error:
        raise _damaged(error, file) from None


def _damaged(error: Exception, file: Path) -> InputError:
    return InputError(f"the histories are damaged ({error}); train again in another folder", file)


def _check_time(env_id: str, settings: BanditSettings) -> None:
    """Raise `InputError` if a shift has no time for the segments."""
    family = registry.make_family(env_id)
    needed_s = settings.segments * settings.segment_s
    if family.episode_s is not None and needed_s > family.episode_s:
        raise InputError(
            f"{settings.segments} segments of {settings.segment_s:g} s are {needed_s:g} s of cutting; a shift has "
            f"{family.episode_s:g} s: fewer passes or shorter segments"
        )


def _before(file: Path) -> tuple[BanditSettings, str]:
    """Return the settings and options with which a training began."""
    if not file.exists():
        raise InputError("there is no training to resume in this folder", file.parent)
    try:
        of = runs.read_of(file)
        return BanditSettings.model_validate(of["settings"]), str(of["options"])
    except (ValueError, LookupError, TypeError) as error:
        raise _damaged(error, file) from None
