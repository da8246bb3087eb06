"""Search of gains and training settings with Optuna (extra ``tune``) on an engine: what ``edmsim tune`` does.

The driver asks a study for values, the engine makes the trials, the driver tells what they are worth. So one search
runs on the processors of a computer as on a cluster, and its nodes need neither Optuna nor a file in common.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from edmsim.controllers import make
from edmsim.controllers.own import from_file
from edmsim.envs.episode import Task
from edmsim.envs.registry import resolve
from edmsim.errors import InputError
from edmsim.evaluation.episode import Episode
from edmsim.evaluation.search import BOUNDS, run_all, score, training_seeds
from edmsim.files import make_writable, replacing
from edmsim.learning.hyperparameters import load
from edmsim.sweep.engine import Engine, LostJob, Processes
from edmsim.sweep.perform import said
from edmsim.user_code import named

if TYPE_CHECKING:
    from edmsim.learning.train import Trained


Scale = Literal["linear", "log"]


class Bound(NamedTuple):
    """Where a value is searched."""

    low: float
    high: float
    scale: Scale = "linear"


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
"""What is searched of a training, and where (ours: a factor of ten to both sides of what stable-baselines3 gives)."""


@dataclass(frozen=True)
class Trial:
    """A trial as plain data.

    Attributes
    ----------
    number : int
        In the study.
    kind : {"gains", "training", "own"}
    name : str
        Controller, environment, or ``FILE.py:CLASS`` of a user's own controller.
    values : dict
    seeds : tuple of int
        Training seeds that it is judged by.
    algo : str
        Of a training.
    steps : int
        Windows of a training.
    options : mapping
        Arguments of the environment in which a user's own controller cuts.
    """

    number: int
    kind: Literal["gains", "training", "own"]
    name: str
    values: Mapping[str, float]
    seeds: tuple[int, ...]
    algo: str = ""
    steps: int = 0
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class TrialResult:
    """What a trial is worth, more is better, NaN with an error; the policy it made; what its cuts returned."""

    value: float
    error: str | None = None
    files: Mapping[str, bytes] = field(default_factory=dict)
    returns: tuple[float, ...] = ()


def bounds(kind: str, name: str) -> dict[str, Bound]:
    """Return what is searched of a controller, or of an algorithm.

    Raises
    ------
    InputError
        Nothing of this algorithm is searched.
    """
    if kind == "training":
        if name not in TRAINING:
            raise InputError(f"no settings of the algorithm '{name}' are searched; choose {', '.join(TRAINING)}")
        return TRAINING[name]
    return {key: Bound(*ends) for key, ends in BOUNDS[name].items()}


def judge_trial(trial: Trial) -> TrialResult:
    """Make a trial; a failure is returned, not raised."""
    try:
        return {"gains": _gains, "training": _training, "own": _own}[trial.kind](trial)
    except Exception as error:  # whatever it is: the search goes on without this trial
        return TrialResult(math.nan, said(error))


def _gains(trial: Trial) -> TrialResult:
    return TrialResult(score(run_all(trial.seeds, partial(make, trial.name, **trial.values), 1)))


def _own(trial: Trial) -> TrialResult:
    """Cut straight on as many drawn machines as there are seeds, with a user's own controller."""
    own = named(trial.name)
    assert own is not None
    returns = []
    for seed in trial.seeds:
        law = from_file(own, dict(trial.values))
        returns.append(Episode(Task(OWN_ENV, **trial.options), law, seed, law.name).run().total_return)
    return TrialResult(worst_share_mean(returns), None, {}, tuple(returns))


OWN_ENV = "edmsim/GapFeed-v2"
"""What a user's own controller cuts: straight on, on machines drawn within the ranges of their constants."""
WORST_SHARE = 0.25
"""The mean over the worst of the cuts is what a robust choice makes large (ours: a firmware meets one machine, and it
may be a bad one)."""


def worst_share_mean(returns: Sequence[float]) -> float:
    """Return the mean of the worst quarter of some returns, of one at the least."""
    ordered = np.sort(np.asarray(returns, float))
    return float(ordered[: max(1, round(WORST_SHARE * len(ordered)))].mean())


def _training(trial: Trial) -> TrialResult:
    from edmsim.learning import hyperparameters
    from edmsim.learning.train import train

    usual = hyperparameters.load(trial.name, trial.algo)
    changed = usual.model_copy(update={"algorithm": {**usual.algorithm, **trial.values}})
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        trained = train(
            trial.name, trial.algo, folder / "run", steps=trial.steps, seed=trial.seeds[0], parameters=changed
        )
        command = f"edmsim tune {trial.name} --algo {trial.algo}, trial {trial.number}"
        value = judge_policy(trained, command, folder, trial.seeds)
        files = {file.name: file.read_bytes() for file in sorted(folder.glob("policy.*"))}
    return TrialResult(value, None, files)


def judge_policy(trained: Trained, command: str, folder: Path, seeds: Sequence[int]) -> float:
    """Write a training's ``policy.json`` and ``policy.npz``; return the policy's mean return on training seeds."""
    from edmsim.evaluation.episode import cut
    from edmsim.learning import policy_file
    from edmsim.learning.export import export

    card, packed = export(trained, command)
    policy_file.write(card, packed, folder / "policy.json")
    results = [cut(trained.run.env_id, seed, f"policy:{folder / 'policy.json'}", "fast") for seed in seeds]
    return float(np.mean([result.total_return for result in results]))


JOURNAL = "study.journal"
"""File of the study, in Optuna's journal storage."""
BEST = "best.toml"


class Tuned(NamedTuple):
    """What a search has found.

    Attributes
    ----------
    values : dict
        The best.
    value, first_value : float
        What they are worth, and what the values in use were.
    trials, failed : int
        Made in all, by all processes; and those that failed.
    """

    values: dict[str, float]
    value: float
    first_value: float
    trials: int
    failed: int


def tune(
    name: str, out: str | Path, *, trials: int = 40, seed: int = 0, seeds: int = 5, algo: str = "ppo",
    steps: int | None = None, engine: Engine | None = None, watch: Callable[[Tuned], None] | None = None,
) -> Tuned:
    """Search a controller's gains, or the settings of a training.

    Parameters
    ----------
    name : str
        A controller of `edmsim.evaluation.search.BOUNDS`, or an environment.
    out : path
        Folder for the study and what is best; a study that is there goes on. Several processes, started with the
        same folder, work on one study; trials under way elsewhere are not counted, so some more may be made.
    trials : int
        In all. The first is of the values in use, so that what is found is never worse on these seeds.
    seed : int
        First training seed, and seed of the search: on one process the same search finds the same.
    seeds : int
        Training seeds a trial is judged by; those held back for comparisons are never used.
    algo, steps : str, int
        Of a training: algorithm, and windows of each trial; those of ``models/training`` by default.
    engine : Engine, optional
        All processors of this computer by default.
    watch : callable, optional
        Called with a `Tuned` after every trial.

    Raises
    ------
    InputError
        Nothing of this name is searched, Optuna is not installed, or an argument cannot be used.
    """
    kind, space = _space(name, algo)
    if trials < 1:
        raise InputError(f"{trials} trials find nothing: give 1 or more")
    judged_by = tuple(training_seeds(seed, seeds))
    env_id = resolve(name) if kind == "training" else name
    usual = _in_use(kind, env_id, algo, space)
    windows = (load(env_id, algo).steps if steps is None else steps) if kind == "training" else 0
    if kind == "training" and windows < 1:
        raise InputError(f"{windows} windows train nothing: give 1 or more steps")
    folder = Path(out)
    make_writable(folder)
    study = open_study(folder, f"{name} {algo}" if kind == "training" else name, seed)
    if not study.trials:
        study.enqueue_trial(usual)

    def made(number: int, values: dict[str, float]) -> Trial:
        return Trial(number, kind, env_id, values, judged_by, algo if kind == "training" else "", windows)

    def ended(trial: Trial, result: TrialResult) -> None:
        if result.error is None and study.best_trial.number == trial.number:
            _write_best(folder, trial, result)
        if watch is not None and made_in(study, "COMPLETE"):
            watch(_found(study))

    run_study(study, space, trials, engine or Processes(), made, ended)
    return _found(study)


def run_study(
    study: Any, space: Mapping[str, Bound], trials: int, engine: Engine,
    make_trial: Callable[[int, dict[str, float]], Trial], ended: Callable[[Trial, TrialResult], None],
) -> None:
    """Make the trials that a study lacks, and tell it what they are worth.

    Parameters
    ----------
    study : optuna.Study
    space : mapping of str to Bound
    trials : int
        In all, those of former runs counted.
    engine : Engine
    make_trial : callable
        Makes a trial of its number and values.
    ended : callable
        Called with every trial and its worth, once the study knows it.

    Raises
    ------
    InputError
        If no trial could be made.
    """
    under_way: dict[int, Any] = {}

    def new_trials() -> Iterator[Trial]:
        while made_in(study) + len(under_way) < trials:
            trial = study.ask()
            under_way[trial.number] = trial
            yield make_trial(trial.number, {key: _suggested(trial, key, bound) for key, bound in space.items()})

    try:
        for trial, answer in engine.done(judge_trial, new_trials()):
            result = TrialResult(math.nan, answer.why) if isinstance(answer, LostJob) else answer
            _tell(study, under_way.pop(trial.number), result)
            ended(trial, result)
    finally:
        for left in under_way.values():
            study.tell(left, state=_states().FAIL)
    if not made_in(study, "COMPLETE"):
        failed = study.trials[-1].user_attrs.get("error", "")
        raise InputError(f"no trial could be made: {failed}")


def _space(name: str, algo: str) -> tuple[Any, dict[str, Bound]]:
    if name in BOUNDS:
        return "gains", bounds("gains", name)
    if "/" not in name and ".py:" not in name:
        raise InputError(f"nothing of '{name}' is searched; choose one of {', '.join(BOUNDS)}, or an environment")
    return "training", bounds("training", algo)


def _in_use(kind: str, name: str, algo: str, space: dict[str, Bound]) -> dict[str, float]:
    """Return the values in use, where they lie in what is searched."""
    if kind == "gains":
        law = make(name)
        known = {key: getattr(law, key) for key in space}
    else:
        known = {key: value for key, value in load(name, algo).algorithm.items() if key in space}
    return {key: float(v) for key, v in known.items() if space[key].low <= v <= space[key].high}


def _suggested(trial: Any, key: str, bound: Bound) -> float:
    """Return a value to three digits: more no search of this size can tell."""
    return float(f"{trial.suggest_float(key, bound.low, bound.high, log=bound.scale == 'log'):.3g}")


def open_study(folder: Path, name: str, seed: int) -> Any:
    """Return the study in a folder, a new one if there is none; raises `InputError` if it is of something else."""
    try:
        import optuna
        from optuna.storages import JournalStorage
        from optuna.storages.journal import JournalFileBackend, JournalFileOpenLock
    except ImportError as error:
        raise InputError(f"a search needs {error.name}: pip install 'edmsim[tune]'") from None
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    file = str(folder / JOURNAL)
    storage = JournalStorage(JournalFileBackend(file, lock_obj=JournalFileOpenLock(file)))
    for other in optuna.get_all_study_names(storage):
        if other != name:
            raise InputError(f"the study in this folder is of {other}, not of {name}", folder)
    study = optuna.create_study(storage=storage, study_name=name, direction="maximize", load_if_exists=True)
    # processes that join must not suggest what another has; parallel trials are taken to be as bad as any
    first = (seed + len(study.trials)) % 2**32
    study.sampler = optuna.samplers.TPESampler(seed=first, constant_liar=True, n_startup_trials=8)
    return study


def _states() -> Any:
    from optuna.trial import TrialState

    return TrialState


def made_in(study: Any, *states: str) -> int:
    """Return how many trials have ended, or ended so."""
    return sum(trial.state.name in (states or ("COMPLETE", "FAIL")) for trial in study.get_trials(deepcopy=False))


def _tell(study: Any, trial: Any, result: TrialResult) -> None:
    if result.error is None:
        study.tell(trial, result.value)
    else:
        trial.set_user_attr("error", result.error)
        study.tell(trial, state=_states().FAIL)


def _found(study: Any) -> Tuned:
    best, first = study.best_trial, study.trials[0]
    values = {key: float(f"{value:.3g}") for key, value in best.params.items()}
    first_value = math.nan if first.value is None else float(first.value)
    return Tuned(values, float(best.value), first_value, made_in(study), made_in(study, "FAIL"))


def _write_best(folder: Path, trial: Trial, result: TrialResult) -> None:
    """Write the best values, and of a training the policy."""
    what = f"{trial.algo} on {trial.name}, {trial.steps} windows" if trial.kind == "training" else trial.name
    table = "algorithm" if trial.kind == "training" else "gains"
    write_found(folder, f"{what}; trial {trial.number}", result.value, trial.seeds, table, trial.values, result.files)


def write_found(
    folder: Path, what: str, value: float, seeds: Sequence[int], table: str, values: Mapping[str, float],
    files: Mapping[str, bytes],
) -> None:
    """Write ``best.toml``, which says what was found and how, and files that belong to it."""
    lines = [
        f"# Found by edmsim tune: {what}, worth {value:.4g} on training seeds",
        f"# {', '.join(map(str, seeds))}.", "", f"[{table}]",
        *(f"{key} = {value!r}" for key, value in values.items()), "",
    ]  # fmt: skip
    for name, content in {BEST: "\n".join(lines).encode(), **files}.items():
        with replacing(folder / name) as partial:
            partial.write_bytes(content)
