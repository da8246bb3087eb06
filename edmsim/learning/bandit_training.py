"""Training of a policy that chooses settings of a law: histories of training machines, and the prior that fits them.

1. `record` cuts on a training machine with all settings in random order, and returns what each segment measured.
2. `prior_of` fits what machines have in common: mean and covariance, over machines, of what each setting does; how
   exactly a segment measures it; and how fast it changes.

Basu et al., "No Regrets for Learning the Prior in Bandits" (NeurIPS 2021), learn a bandit's prior in a similar way.
A machine does not know the area that it cuts; the histories have the true one, and `BanditSettings.meter` is the
error of the measured rate. Needs no extra.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, FiniteFloat, ValidationError

from edmsim import models
from edmsim.envs.episode import Task
from edmsim.envs.families import Shift
from edmsim.envs.registry import base_of, find, make_family, stand_in
from edmsim.errors import InputError, invalid_entry, located
from edmsim.evaluation.episode import HELD_BACK, Episode, engine_of
from edmsim.files import locked, read_toml
from edmsim.learning import bandit_file
from edmsim.learning.bandit_controller import BanditController
from edmsim.learning.bandit_file import BanditCard, Choices, Segment
from edmsim.learning.hyperparameters import HISTORIES
from edmsim.numeric import whole_from, whole_within
from edmsim.runs import RunTable, perform, read_of
from edmsim.screen import ScreenTable

FIRST_SEED = 21_000
"""Seed of the first training machine of a training with seed 0."""
LEAST_PASSES = 2  # in fewer, all that a segment differs from another is its setting, and no noise is known
LEAST_SPREAD = 0.1
"""Least variance of the factor on the rate of lost wires among settings, and among machines (ours: few are seen)."""
Floats = NDArray[np.float64]
_Positive = Annotated[FiniteFloat, Field(gt=0)]


class BanditSettings(Choices):
    """Settings of a training: those of the policy (see `edmsim.learning.bandit_file.Choices`), and of its prior."""

    machines: Annotated[int, Field(ge=2)]  # training machines, 2 or more
    passes: Annotated[int, Field(ge=LEAST_PASSES)]  # segments with each setting on every training machine
    # share by which the covariance over machines is moved towards its diagonal, as machines are few
    shrink: Annotated[FiniteFloat, Field(ge=0, le=1)]
    meter: _Positive  # standard deviation of the measured rate's logarithm from the true one's
    # standard deviation of the change of a setting's logarithm of the rate per segment, relative to the others
    drift: Annotated[FiniteFloat, Field(ge=0)]

    @property
    def segments(self) -> int:
        """Segments on every training machine."""
        return self.passes * len(self.settings)


class History(NamedTuple):
    """What was recorded on a training machine."""

    rows: list[list[float]]  # (n, 5): setting, shares of opens and shorts, seconds and area in mm2 of each segment
    lost: list[float]  # wires with each setting
    cut_s: list[float]  # time with each setting


def load(env_id: str, file: Path | None = None) -> BanditSettings:
    """Return the settings of ``models/training/NAME-bandit.toml`` of a shift, with changes from a file of yours."""
    family, _ = find(env_id)
    if not issubclass(family, Shift):
        raise InputError(
            f"{env_id} is no shift: a bandit needs one to adapt in, edmsim/MaxRateShift-v0 or edmsim/ThinWireShift-v0"
        )
    usual = read_toml(models.path(f"training/{base_of(family)}-bandit.toml"))
    return checked(usual if file is None else usual | read_toml(file), file)


def checked(values: dict[str, Any], file: Path | None = None) -> BanditSettings:
    """Return settings; raises `InputError` in one line for one that cannot be used."""
    try:
        settings = BanditSettings.model_validate(values)
    except ValidationError as error:
        raise InputError(invalid_entry(error), file) from None
    with located(file):
        bandit_file.law_of(settings)
    return settings


class Prior(NamedTuple):
    """What machines have in common; see `edmsim.learning.bandit_file.BanditCard`."""

    mean: Sequence[float]
    covariance: Sequence[Sequence[float]]
    noise: Sequence[float]
    offset_drift: float
    breaks: Sequence[float]
    breaks_s: float


def card_of(env_id: str, settings: BanditSettings, prior: Prior, command: str, seed: int, steps: int) -> BanditCard:
    """Return a policy with these settings and this prior, and by which command and segments it was trained."""
    choices = {name: getattr(settings, name) for name in Choices.model_fields}
    versions = {name: version(name) for name in ("edmsim", "numpy")}
    return BanditCard(
        format=bandit_file.FORMAT, env_id=env_id, environment={}, **choices, **prior._asdict(), drift=settings.drift,
        algorithm="bandit", command=command, seed=seed, steps=steps, versions=versions,
    )  # fmt: skip


# 1. histories of training machines


class Trier(BanditController):
    """Tries all settings in random order, and notes what each segment measured."""

    def __init__(self, env_id: str, settings: BanditSettings, seed: int) -> None:
        count = len(settings.settings)
        unknown = Prior([0.0] * 3 * count, np.eye(3 * count).tolist(), [1.0] * 3, 0.0, [0.0] * count, 1.0)
        super().__init__(card_of(env_id, settings, unknown, "", seed, 0))
        self.rows: list[tuple[int, float, float]] = []  # setting, shares of opens and shorts
        self._random = np.random.default_rng(seed)
        self._order: list[int] = []

    @property
    def measures(self) -> bool:
        """Whether the present segment's measurement has begun."""
        return self.seconds > 0.0

    def learn(self, measured: Segment) -> None:
        """Note a segment."""
        self.rows.append((self.setting, measured.open, measured.short))

    def choose(self) -> int:
        """Return the next setting; each comes once before one comes again."""
        self._order = self._order or list(self._random.permutation(len(self.card.settings)))
        return int(self._order.pop())


def record(env_id: str, settings: BanditSettings, seed: int) -> History:
    """Cut on a training machine, with `BanditSettings.segments` segments or up to the end of the shift."""
    trier = Trier(env_id, settings, seed)
    episode = Episode(Task(env_id, test_s=0.0), trier, seed, "trier")
    rows: list[list[float]] = []
    seconds, area, measured = 0.0, 0.0, trier.measures
    for window in episode.windows():
        if measured or trier.measures:
            seconds += window.observation.duration_s
            area += window.area_mm2
        if len(trier.rows) > len(rows):
            rows.append([*trier.rows[-1], seconds, area])
        measured = trier.measures
        if not measured:  # a segment or a wire has ended
            seconds = area = 0.0
        if len(rows) == settings.segments:
            break
    return History(rows, trier.belief.lost.tolist(), trier.belief.cut_s.tolist())


# 2. what machines have in common


def effects(values: Floats, setting: NDArray[np.int64], count: int) -> tuple[Floats, Floats, Floats]:
    """Return what each setting (count,) and each pass (p,) adds to values (n,), and what is left (n,)."""
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
        rates = found[0][0] - found[0][0].mean()  # relative to the machine's others
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
    """Return lost wires per second with each setting, and how much of a machine's own time weighs as much."""
    # numbers of lost wires (machines, settings) in times of the same shape are Poisson. The rates of settings differ
    # from that of all, and those of machines from their settings', by factors of a gamma distribution, whose variance
    # follows from that of the numbers; so a setting with few lost wires is moved towards the others
    total, time_s = lost.sum(axis=0), cut_s.sum(axis=0)
    # as if one more wire were lost: no rate is 0
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


def described(card: BanditCard) -> ScreenTable:
    """Return how the settings differ on training machines."""
    deviations, count = np.sqrt(np.diag(np.array(card.covariance))), len(card.settings)
    heads = "rate beside the others, %", "opens, %", "shorts, %", "wires lost per hour"
    table = ScreenTable("setting", numbers=heads)
    for k, setting in enumerate(card.settings):
        rate = f"{100 * card.mean[k]:+.1f} ± {100 * deviations[k]:.1f}"
        shares = (f"{100 * card.mean[k + part * count]:.0f}" for part in (1, 2))
        table.add_row(shown(setting), rate, *shares, f"{3600 * card.breaks[k]:.1f}")
    return table


def shown(setting: dict[str, float]) -> str:
    """Return a setting as controllers' parameters are written."""
    return ",".join(f"{name}={value:g}" for name, value in setting.items())


# 3. both, so that they can be resumed


def train(
    env_id: str, out: Path, *, steps: int | None = None, seed: int = 0, resume: bool = False,
    settings: BanditSettings | None = None, command: str = "", options: str = "",
    watch: Callable[[int, int], None] | None = None,
) -> BanditCard:
    """Record training machines of a shift into `HISTORIES`, and return the policy whose prior fits them.

    `steps` are segments on all machines, rounded up to whole ones. With `resume` the settings of the histories apply,
    their number of machines unless there are `steps`, and the options that the command had.
    """
    file = out / HISTORIES
    if resume:
        settings, options = _before(file)
    settings = settings or load(env_id)
    machines = settings.machines if steps is None else max(-(-whole_from("steps", steps, 1) // settings.segments), 2)
    if not resume:
        settings = settings.model_copy(update={"machines": machines})
    first = FIRST_SEED + seed
    whole_within("seed", seed, 0, HELD_BACK - FIRST_SEED - machines)
    _check_time(env_id, settings)
    with locked(out, "edmsim train"):
        of = {"env_id": env_id, "seed": seed, "settings": settings.model_dump(), "options": options}
        table = RunTable(file, of)
        seeds = range(first, first + machines)
        rows = perform(
            partial(_recorded, env_id, settings), seeds, watch, table=table, ids=[str(number) for number in seeds],
            engine=engine_of(env_id, machines, settings.segments * settings.segment_s),
        )  # fmt: skip
    histories = _histories(rows, len(settings.settings), file)
    command += f" --steps {machines * settings.segments} --seed {seed}{options}"
    segments = sum(len(history.rows) for history in histories)
    known_as, _ = stand_in(*find(env_id))
    return card_of(known_as, settings, prior_of(histories, settings), command, seed, segments)


def _recorded(env_id: str, settings: BanditSettings, seed: int) -> dict[str, Any]:
    return record(env_id, settings, seed)._asdict()


def _histories(rows: Sequence[dict[str, Any]], count: int, file: Path) -> list[History]:
    """Return the histories of a table's rows, with `count` settings."""
    try:
        for row in rows:
            segments = np.array(row["rows"], float).reshape(-1, 5)
            totals = np.array([row["lost"], row["cut_s"]], float).reshape(2, count)
            if not (np.isfinite(segments).all() and np.isfinite(totals).all()):
                raise ValueError("numbers that are not finite")
            if not np.isin(segments[:, 0], np.arange(count)).all():
                raise ValueError("a setting that there is not")
        return [History(row["rows"], row["lost"], row["cut_s"]) for row in rows]
    except (ValueError, LookupError, TypeError) as error:
        raise _damaged(error, file) from None


def _damaged(error: Exception, file: Path) -> InputError:
    return InputError(f"the histories are damaged ({error}); train again in another folder", file)


def _check_time(env_id: str, settings: BanditSettings) -> None:
    """Refuse segments that no shift has time for."""
    family = make_family(env_id)
    needed_s = settings.segments * settings.segment_s
    if family.episode_s is not None and needed_s > family.episode_s:
        raise InputError(
            f"{settings.segments} segments of {settings.segment_s:g} s are {needed_s:g} s of cutting; a shift has "
            f"{family.episode_s:g} s: fewer passes or shorter segments"
        )


def _before(file: Path) -> tuple[BanditSettings, str]:
    """Return the settings and options that a training began with."""
    if not file.exists():
        raise InputError("there is no training to resume in this folder", file.parent)
    try:
        of = read_of(file)
        return BanditSettings.model_validate(of["settings"]), str(of["options"])
    except (ValueError, LookupError, TypeError) as error:
        raise _damaged(error, file) from None
