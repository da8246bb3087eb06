"""Searches of a controller's settings, ours or your own, and of a training's hyperparameters: ``edmsim tune``.

They use Optuna (extra ``tune``). The driver asks a study for values, the engine makes the trials, and the driver
reports their scores. So the same search runs on one computer or on a cluster, whose nodes need neither Optuna nor a
shared file.

Firmware has dozens of settings that users tune by trial on the machine. `tune_controller` tries them on machines
drawn within the ranges of the gap's uncertain constants, with training seeds, never those of comparisons. It chooses
settings that do well on the worst machines, and tests them once more on other machines.
"""

import inspect
import json
import math
import os
import secrets
import socket
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Self

import numpy as np

from edmsim import __version__, files, numeric, runs, user_code
from edmsim.controllers import FeedController, make
from edmsim.controllers.user_controllers import from_file
from edmsim.envs import episode, registry
from edmsim.errors import InputError, one_of, refuses_wrong_types
from edmsim.evaluation.episode import HELD_BACK, Episode, cut
from edmsim.learning import hyperparameters, policy_file
from edmsim.sweep.run import said
from edmsim.sweep.specification import Bound

if TYPE_CHECKING:
    from edmsim.learning.train import Trained

TRAINING: dict[str, dict[str, Bound]] = {
    "ppo": {
        "learning_rate": Bound(1e-5, 3e-3, "log"), "gamma": Bound(0.95, 0.9995), "gae_lambda": Bound(0.85, 0.99),
        "clip_range": Bound(0.1, 0.4),
    },
    "sac": {
        "learning_rate": Bound(1e-5, 3e-3, "log"), "gamma": Bound(0.95, 0.9995), "tau": Bound(0.002, 0.05, "log"),
    },
}
TRAINING |= {"tqc": TRAINING["sac"], "ppo-lag": TRAINING["ppo"], "recurrent-ppo": TRAINING["ppo"]}
"""Searched hyperparameters and their bounds by algorithm (ours: around the defaults of stable-baselines3)."""

BOUNDS = {
    "fixed": {"feed_um_s": (1.0, 60.0)},
    "counts": {
        "open_target_share": (0.0, 0.2), "short_weight": (0.25, 1.5), "proportional_um_s": (1.0, 15.0),
        "integral_um_s2": (5.0, 40.0),
    },
    "voltage": {
        "reference_V": (5.0, 20.0), "proportional_um_s_V": (0.1, 8.0), "integral_um_s2_V": (0.1, 20.0),
        "filter_s": (0.02, 0.3),
    },
    "delay": {
        "reference_us": (1.0, 10.0), "proportional_um_s_us": (0.1, 20.0), "integral_um_s2_us": (0.1, 60.0),
        "filter_s": (0.02, 0.3),
    },
    "fuzzy": {
        "open_target_share": (0.02, 0.3), "open_width_share": (0.02, 0.3), "short_high_share": (0.3, 0.9),
        "rate_um_s2": (3.0, 300.0),
    },
    "adaptive-off-time": {
        "open_target_share": (0.0, 0.2), "short_weight": (0.25, 1.5), "integral_um_s2": (5.0, 200.0),
        "normal_at_10mm": (300.0, 1000.0),
    },
    "oracle": {
        "gap_target_um": (5.0, 35.0), "proportional_um_s_um": (0.3, 12.0), "integral_um_s2_um": (0.5, 40.0),
        "short_um": (0.0, 30.0),
    },
}  # fmt: skip
"""Searched settings and their bounds by controller (ours: from timid to reckless). `short_weight` is above 0, because
otherwise a closing gap is not detected. Settings found for `counts` hunt at long periods and are not shipped."""


def training_seeds(seed: int, seeds: int) -> range:
    """Return the training seeds from `seed` on; raises `InputError` if they reach the held-back ones."""
    if not 0 <= numeric.whole_from("seed", seed) <= HELD_BACK - numeric.whole_from("seeds", seeds, 1):
        raise InputError(f"training seeds lie from 0 to {HELD_BACK - 1}: {seed} to {seed + seeds - 1} do not")
    return range(seed, seed + seeds)


@dataclass(frozen=True)
class Trial:
    """A trial as plain data."""

    number: int  # in the study
    kind: Literal["controller", "training"]
    name: str  # controller, ours or ``FILE.py:CLASS``, or environment
    values: Mapping[str, float]
    seeds: tuple[int, ...]  # training seeds on which it is scored
    algo: str = ""  # of a training
    steps: int = 0  # windows of a training
    # arguments of the environment in which a controller cuts
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class TrialResult:
    """Result of a trial: its score (more is better; NaN with an error), files of its policy, returns of its cuts."""

    value: float
    error: str | None = None
    policy: Mapping[str, bytes] = field(default_factory=dict)
    returns: tuple[float, ...] = ()


def judge_trial(trial: Trial) -> TrialResult:
    """Make a trial; a failure is returned, not raised."""
    try:
        return (_training if trial.kind == "training" else _controller)(trial)
    except Exception as error:  # any exception: the search continues without this trial
        return TrialResult(math.nan, said(error))


def _controller(trial: Trial) -> TrialResult:
    """Score a controller in straight cuts, on one drawn machine per seed."""
    returns = []
    for seed in trial.seeds:
        law = law_of(trial.name, trial.values)
        returns.append(Episode(episode.Task(CUTS_IN, **trial.options), law, seed, law.name).run().total_return)
    return TrialResult(worst_share_mean(returns), None, {}, tuple(returns))


def law_of(name: str, values: Mapping[str, float]) -> FeedController:
    """Return a controller, ours or the user's, with these values of its settings."""
    own = user_code.named(name)
    return make(name, **values) if own is None else from_file(own, dict(values))


CUTS_IN = "edmsim/GapFeed-v2"
"""Environment that scores controllers: a straight cut, on machines drawn within the ranges of their constants."""
WORST_SHARE = 0.25
"""A robust choice maximises the mean over this share of the worst cuts (ours: firmware runs on one machine, which may
be a bad one)."""


def anywhere(text: str) -> str:
    """Return the name of a controller or environment for other processes: a user's file with its absolute path."""
    own = user_code.named(text)
    return text if own is None else f"{Path(own.file).absolute()}:{own.name}"


def worst_share_mean(returns: Sequence[float]) -> float:
    """Return the mean of the worst quarter of some returns, of at least one."""
    ordered = np.sort(np.asarray(returns, float))
    return float(ordered[: max(1, round(WORST_SHARE * len(ordered)))].mean())


def _training(trial: Trial) -> TrialResult:
    from edmsim.learning.train import train

    env_id = registry.resolve(trial.name)
    usual = hyperparameters.load(env_id, trial.algo)
    changed = usual.model_copy(update={"algorithm": {**usual.algorithm, **trial.values}})
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        trained = train(
            env_id, trial.algo, folder / "run", steps=trial.steps, seed=trial.seeds[0], parameters=changed
        )
        command = f"edmsim tune training {env_id} --algo {trial.algo}, trial {trial.number}"
        value = judge_policy(trained, command, folder, trial.seeds)
        policy = {file.name: file.read_bytes() for file in sorted(folder.glob("policy.*"))}
    return TrialResult(value, None, policy)


def judge_policy(trained: "Trained", command: str, folder: Path, seeds: Sequence[int]) -> float:
    """Write the ``policy.json`` and ``policy.npz`` of a training; return its mean return on training seeds."""
    card, packed = trained.export(command)
    policy_file.write(card, packed, folder / "policy.json")
    results = [cut(trained.run.env_id, seed, f"policy:{folder / 'policy.json'}", "fast") for seed in seeds]
    return float(np.mean([result.total_return for result in results]))


JOURNAL = "study.journal"  # file of the study, in Optuna's journal storage
BEST = "best.toml"
FINAL = "finalists.jsonl"  # table of the trials that are scored once more


class Tuned(NamedTuple):
    """Result of `tune_training`."""

    values: dict[str, float]  # the best values
    value: float  # score of `values`, and of the values in use
    first_value: float
    trials: int  # of all processes
    failed: int


@refuses_wrong_types
def tune_training(
    env_id: str, out: str | Path, *, algo: str = "ppo", steps: int | None = None, trials: int = 40, seed: int = 0,
    seeds: int = 5, engine: runs.Engine | None = None, watch: Callable[[int, float], None] | None = None,
) -> Tuned:
    """Search the hyperparameters of a training, by default with the windows of ``models/training`` per trial.

    A search in the folder is resumed. Processes with the same folder share one study; they do not count trials in
    progress elsewhere, so they may make a few more. The first trial has the values in use, so the result is never
    worse on these seeds. With one process the search is reproducible. For `watch` see `tune_controller`.
    """
    space, judged_by, name = training_space(algo), tuple(training_seeds(seed, seeds)), registry.resolve(env_id)
    usual = hyperparameters.load(name, algo)
    windows = hyperparameters.steps_of(usual, algo, steps)
    folder = files.folder_of(out)
    of = {"seed": seed, "seeds": seeds, "steps": windows, "files": sorted(runs.digests_of([env_id]).values())}
    study = open_study(folder, f"{env_id} {algo}", of, trials, within(space, usual.algorithm))

    def made(number: int, values: dict[str, float]) -> Trial:
        return Trial(number, "training", anywhere(env_id), values, judged_by, algo, windows)

    def best(trial: Trial, result: TrialResult) -> None:
        what = f"training: {algo} on {name}, {windows} windows; trial {trial.number}"
        write_found(folder, what, result.value, judged_by, "algorithm", trial.values, result.policy)

    run_study(study, space, trials, engine or runs.Processes(), made, watch, best)
    in_use, values = study.trials[0].params, _tried(study.best_trial, space)
    first = next((float(t.value) for t in study.trials if t.params == in_use and t.value is not None), math.nan)
    return Tuned(values, float(study.best_value), first, made_in(study), made_in(study, "FAIL"))


def training_space(algo: str) -> dict[str, Bound]:
    """Return the bounds of the search for an algorithm."""
    if algo not in TRAINING:
        raise InputError(f"no settings of the algorithm '{algo}' are searched; choose {', '.join(TRAINING)}")
    return TRAINING[algo]


def within(space: Mapping[str, Bound], values: Mapping[str, Any]) -> dict[str, float]:
    """Return those values that are within the bounds of the search."""
    return {key: float(values[key]) for key, b in space.items() if key in values and b.low <= values[key] <= b.high}


_INTERRUPTED = "interrupted"  # error of a trial that Ctrl-C ended; if its driver was killed, it has no error
_DRIVER = "driver"  # attribute of a trial: host, process id and `_MARK` of its driver
_MARK = secrets.token_hex(4)  # of this process, because a later one may have the same process id


def run_study(
    study: Any, space: Mapping[str, Bound], trials: int, engine: runs.Engine,
    make_trial: Callable[[int, dict[str, float]], Trial], watch: Callable[[int, float], None] | None = None,
    best: Callable[[Trial, TrialResult], None] | None = None,
) -> None:
    """Make the missing trials of a study, report their scores to it, and call `best` with each new best trial."""
    under_way: dict[int, Any] = {}

    def new_trials() -> Iterator[Trial]:
        while made_in(study) + len(under_way) < trials:
            trial = study.ask()
            under_way[trial.number] = trial
            for key, bound in space.items():
                trial.suggest_float(key, bound.low, bound.high, log=bound.scale == "log")
            trial.set_user_attr(_DRIVER, [socket.gethostname(), os.getpid(), _MARK])
            yield make_trial(trial.number, _tried(trial, space))

    try:
        for trial, answer in engine.done(judge_trial, new_trials()):
            result = _result_of(answer)
            so_far = study.best_value if made_in(study, "COMPLETE") else -math.inf
            if best is not None and result.error is None and not result.value <= so_far:
                best(trial, result)  # before the study stores it, so a kill in between repeats the trial
            _tell(study, under_way.pop(trial.number), result)
            if watch is not None and (ended := made_in(study, "COMPLETE")):
                watch(ended, float(study.best_value))
    finally:
        for left in under_way.values():
            _tell(study, left, TrialResult(math.nan, _INTERRUPTED))
            study.enqueue_trial(left.params)
    if not made_in(study, "COMPLETE"):
        failed = study.trials[-1].user_attrs.get("error", "")
        raise InputError(f"no trial could be made: {failed}")


def _tried(trial: Any, space: Mapping[str, Bound]) -> dict[str, float]:
    """Return a trial's values as they are tried; three digits, because a search of this size is not more precise."""
    return {key: _rounded(trial.params[key], bound) for key, bound in space.items()}


def _rounded(value: float, bound: Bound) -> float:
    """Return a value with three digits, or more where these are coarse in a narrow range, and within the range."""
    narrow = max(abs(bound.low), abs(bound.high)) / (bound.high - bound.low)
    rounded = float(f"{value:.{3 + max(math.floor(math.log10(narrow)), 0)}g}")
    return min(max(rounded, bound.low), bound.high)


def open_study(folder: Path, name: str, of: Mapping[str, Any], trials: int, first: Mapping[str, float]) -> Any:
    """Return the study in a folder, or a new one that begins with `first`; raise `InputError` if it is another's."""
    numeric.whole_from("trials", trials, 1)
    files.make_writable(folder)
    try:
        import optuna
        from optuna.storages import JournalStorage, journal
    except ImportError as error:
        raise InputError(f"a search needs {error.name}: pip install 'edmsim[tune]'") from None
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    file = str(folder / JOURNAL)
    lock = journal.JournalFileOpenLock(file)
    lock.acquire()
    try:
        if Path(file).exists():  # a journal with lines after an unfinished one cannot be read
            files.remove_unfinished_line(Path(file))
    finally:
        lock.release()
    storage = JournalStorage(journal.JournalFileBackend(file, lock_obj=lock))
    for other in optuna.get_all_study_names(storage):
        if other != name:
            raise InputError(f"the study in this folder is of {other}, not of {name}", folder)
    study = optuna.create_study(storage=storage, study_name=name, direction="maximize", load_if_exists=True)
    judged_by = json.loads(json.dumps(of))
    runs.check_same(study.user_attrs.get("of", judged_by), judged_by, Path(file))
    study.set_user_attr("of", judged_by)
    _repeat_killed(study)
    # a process that joins has another seed, so its suggestions differ; `constant_liar`: running trials count as bad
    drawn_from = (of["seed"] + len(study.trials)) % 2**32
    study.sampler = optuna.samplers.TPESampler(seed=drawn_from, constant_liar=True, n_startup_trials=8)
    if not study.trials:
        study.enqueue_trial(dict(first))
    return study


def _repeat_killed(study: Any) -> None:
    """Mark the trials whose driver was killed on this computer as failed, and enqueue them again."""
    for trial in study.trials:
        host, process, mark = trial.user_attrs.get(_DRIVER, (None, 0, ""))
        if trial.state.name == "RUNNING" and host == socket.gethostname() and _has_ended(process, mark):
            study.tell(trial.number, state=type(trial.state).FAIL)
            study.enqueue_trial(trial.params)


def _has_ended(process: int, mark: str) -> bool:
    """Return whether a driver's process on this computer has ended."""
    if process == os.getpid():
        return mark != _MARK
    try:
        if os.name == "posix":
            os.kill(process, 0)
    except PermissionError:
        return False
    except ProcessLookupError:
        return True
    return False


def _result_of(answer: Any) -> TrialResult:
    return TrialResult(math.nan, answer.why) if isinstance(answer, runs.LostJob) else answer


def made_in(study: Any, *states: str) -> int:
    """Return the number of trials that ended, or ended in `states`, without interrupted ones, which are repeated."""
    return sum(
        trial.state.name in (states or ("COMPLETE", "FAIL"))
        and (trial.state.name == "COMPLETE" or trial.user_attrs.get("error", _INTERRUPTED) != _INTERRUPTED)
        for trial in study.get_trials(deepcopy=False)
    )


def _tell(study: Any, trial: Any, result: TrialResult) -> None:
    from optuna.trial import TrialState

    if result.error is None:
        study.tell(trial, result.value)
    else:
        trial.set_user_attr("error", result.error)
        study.tell(trial, state=TrialState.FAIL)


def write_found(
    folder: Path, what: str, value: float, seeds: Sequence[int], table: str, values: Mapping[str, float],
    policy: Mapping[str, bytes],
) -> None:
    """Write ``best.toml`` with the result and its search, and the files of its policy."""
    lines = [
        f"# Found by edmsim tune {what}, worth {value:.4g} on training seeds",
        f"# {', '.join(map(str, seeds))}.", "", f"[{table}]",
        *(f"{key} = {value!r}" for key, value in values.items()), "",
    ]  # fmt: skip
    for name, content in {BEST: "\n".join(lines).encode(), **policy}.items():
        with files.replacing(folder / name) as partial:
            partial.write_bytes(content)


FINALISTS = 8  # trials scored once more, next to the settings in use (ours, because the best score is partly luck)
FRESH = 2  # their machines as a multiple of a trial's; the same for all finalists (ours)
_RULE = 'BOUNDS = {"gain": (0.1, 10.0), "window_s": (0.01, 1.0, "log")}'


class Spread(NamedTuple):
    """Returns of settings on drawn machines: mean of the worst quarter, mean, and the 10 and 90 % quantiles."""

    worst: float
    mean: float
    low: float
    high: float

    @classmethod
    def of(cls, worst: float, returns: Sequence[float]) -> Self:
        """Return the spread of the returns of a trial."""
        low, high = np.quantile(returns, (0.1, 0.9)).tolist()
        return cls(worst, float(np.mean(returns)), low, high)

    def __str__(self) -> str:
        return (
            f"worst {100 * WORST_SHARE:.0f} % {self.worst:.4g}, mean {self.mean:.4g}, "
            f"10 to 90 % {self.low:.4g} to {self.high:.4g}"
        )


class TunedController(NamedTuple):
    """Result of `tune_controller`: the best settings, and spreads on machines that no trial used."""

    values: dict[str, float]  # the most robust settings
    spread: Spread
    first_spread: Spread  # of the settings in use
    trials: int
    failed: int
    machines: int  # in the spreads
    # values and spread of each finalist by its trial; -1 is the settings in use
    tried_again: dict[int, tuple[dict[str, float], Spread]]


@refuses_wrong_types
def tune_controller(
    controller: str, out: str | Path, *, trials: int = 40, seed: int = 0, seeds: int = 8,
    engine: runs.Engine | None = None, watch: Callable[[int, float], None] | None = None, **options: Any,
) -> TunedController:
    """Search the settings of a controller on drawn machines.

    Parameters
    ----------
    controller : str
        A name of `BOUNDS`, or ``FILE.py:CLASS`` for your own. Your class names the settings and their bounds in
        `BOUNDS`.
    out : path
        Folder for ``best.toml`` and the study; an existing study with the same arguments is resumed.
    trials : int
        Number of all trials; the first uses the settings in use.
    seed : int
        First training seed, and seed of the search.
    seeds : int
        Number of drawn machines per trial; every trial draws others.
    engine : Engine, optional
        By default all processors of this computer.
    watch : callable, optional
        Called with the number of finished trials and the best score.
    **options
        Arguments of the environment GapFeed: ``machine``, ``height_mm``, ``randomise``.

    Raises
    ------
    InputError
        If there is no such controller, its class has no `BOUNDS`, or an argument is invalid.
    """
    own = user_code.named(controller)
    if own is not None and not own.name:
        raise InputError(f"'{controller}' names no controller of your own: give FILE.py:CLASS")
    title = controller if own is None else own.name
    name = anywhere(controller)
    law, space = law_of(controller, {}), bounds_of(controller)
    fresh = tuple(training_seeds(seed, FRESH * seeds))
    first_of_trials = seed + FRESH * seeds
    training_seeds(first_of_trials, (trials + 1) * seeds)
    options = {"resolution": "fast", **options}
    episode.Task(CUTS_IN, **options)  # raises `InputError` here, before the first trial
    folder = files.folder_of(out)
    in_use = {key: _value_in_use(law, key) for key in space}
    first = {key: min(max(in_use[key], bound.low), bound.high) for key, bound in space.items()}
    digests = sorted(runs.digests_of([name, options]).values())
    of = {"seed": seed, "seeds": seeds, "options": options, "files": digests}
    study = open_study(folder, title, of, trials, first)
    machines = engine or runs.Processes()

    def made(number: int, values: dict[str, float]) -> Trial:
        # every trial has other machines, because the search would otherwise fit the settings to a few
        judged_by = training_seeds(first_of_trials + max(number, 0) * seeds, seeds)
        return Trial(number, "controller", name, values, tuple(judged_by), options=options)

    run_study(study, space, trials, machines, made, watch)
    whole = [trial for trial in study.trials if trial.state.name == "COMPLETE"]
    best = sorted(whole, key=lambda trial: -trial.value)[:FINALISTS]
    finalists = [made(-1, in_use), *(made(trial.number, _tried(trial, space)) for trial in best)]
    spreads = _judged_again(finalists, fresh, machines, runs.RunTable(folder / FINAL))
    chosen = max(spreads, key=lambda number: spreads[number][1].worst)
    values, spread = spreads[chosen]
    before, ended, failed = spreads[-1][1], made_in(study), made_in(study, "FAIL")
    what = f"controller: {title}, {spread} on {len(fresh)} drawn machines; in use before: {before}"
    write_found(folder, what, spread.worst, fresh, "parameters", values, {})
    return TunedController(values, spread, before, ended, failed, len(fresh), spreads)


def bounds_of(controller: str) -> dict[str, Bound]:
    """Return the bounds of a controller's settings, ours or the user's; raise `InputError` if they are invalid."""
    own_class = user_code.named(controller)
    if own_class is None:
        if controller not in BOUNDS:
            raise InputError(f"no gains of '{controller}' are searched; choose {one_of(controller, BOUNDS)}")
        return {name: Bound(*ends) for name, ends in BOUNDS[controller].items()}
    kind = vars(user_code.run(own_class.file))[own_class.name]
    declared = getattr(kind, "BOUNDS", None)
    if not isinstance(declared, Mapping) or not declared:
        raise InputError(f"{own_class.name} does not say what is searched: give it {_RULE}", own_class.file)
    known = inspect.signature(kind).parameters
    found = {}
    for name, ends in declared.items():
        if name not in known:
            has = ", ".join(known)
            raise InputError(f"BOUNDS of {own_class.name} name {name!r}; its parameters are {has}", own_class.file)
        if (bound := Bound.of(ends)) is None:
            what = f'{name} is searched from a number to a greater one, with "log" from above 0, not {ends!r}'
            raise InputError(f"{what}: {_RULE}", own_class.file)
        found[name] = bound
    return found


def _value_in_use(law: object, name: str) -> float:
    value = numeric.real(getattr(law, name, None))
    if value is None:
        raise InputError(f"{name} of your controller has no value to begin with: give the parameter a default")
    return value


def _judged_again(
    trials: list[Trial], fresh: tuple[int, ...], engine: runs.Engine, table: runs.RunTable
) -> dict[int, tuple[dict[str, float], Spread]]:
    """Return values and spread of trials by number, on machines on which they were not chosen."""
    again = {}
    for trial in (replace(trial, seeds=fresh) for trial in trials):
        digests = sorted(runs.digests_of([trial.name, trial.options]).values())
        again[runs.identity({"edmsim": __version__, "files": digests, **asdict(trial)})] = trial
    ids = {trial.number: name for name, trial in again.items()}
    missing = [trial for name, trial in again.items() if name not in table.rows]
    for trial, answer in engine.done(judge_trial, missing):
        result = _result_of(answer)
        if result.error is not None:
            raise InputError(f"the settings of trial {trial.number} could not be tried again: {result.error}")
        table.add({"id": ids[trial.number], "value": result.value, "returns": result.returns})
    return {
        trial.number: (dict(trial.values), Spread.of(table.rows[name]["value"], table.rows[name]["returns"]))
        for name, trial in again.items()
    }
