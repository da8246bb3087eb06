"""Search of gains and training settings with Optuna (extra ``tune``) on an engine: what ``edmsim tune`` does.

The driver asks a study for values, the engine makes the trials, the driver tells what they are worth. So one search
runs on the processors of a computer as on a cluster, and its nodes need neither Optuna nor a file in common.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from edmsim.controllers import make
from edmsim.envs.registry import resolve
from edmsim.errors import InputError, one_of
from edmsim.evaluation.search import BOUNDS, training_seeds
from edmsim.files import make_writable, replacing
from edmsim.learning.hyperparameters import ALGORITHMS, load
from edmsim.sweep.engine import Engine, Lost, Processes
from edmsim.sweep.trial import Bound, Trial, Worth, bounds, judge_trial

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
    folder = Path(out)
    make_writable(folder)
    study = _study(folder, f"{name} {algo}" if kind == "training" else name, seed)
    if not study.trials:
        study.enqueue_trial(usual)
    under_way: dict[int, Any] = {}

    def asked() -> Iterator[Trial]:
        while _made(study) + len(under_way) < trials:
            trial = study.ask()
            under_way[trial.number] = trial
            values = {key: _suggested(trial, key, bound) for key, bound in space.items()}
            yield Trial(trial.number, kind, env_id, values, judged_by, algo if kind == "training" else "", windows)

    try:
        for trial, answer in (engine or Processes()).done(judge_trial, asked()):
            worth = Worth(math.nan, answer.why) if isinstance(answer, Lost) else answer
            _tell(study, under_way.pop(trial.number), worth)
            if worth.error is None and study.best_trial.number == trial.number:
                _write_best(folder, trial, worth)
            if watch is not None and _made(study, "COMPLETE"):
                watch(_found(study))
    finally:
        for left in under_way.values():
            study.tell(left, state=_states().FAIL)
    if not _made(study, "COMPLETE"):
        failed = study.trials[-1].user_attrs.get("error", "")
        raise InputError(f"no trial could be made: {failed}")
    return _found(study)


def _space(name: str, algo: str) -> tuple[Any, dict[str, Bound]]:
    if name in BOUNDS:
        return "gains", bounds("gains", name)
    if "/" not in name and ".py:" not in name:
        raise InputError(f"nothing of '{name}' is searched; choose one of {', '.join(BOUNDS)}, or an environment")
    if algo not in ALGORITHMS:
        raise InputError(f"unknown algorithm '{algo}'; there are: {one_of(algo, ALGORITHMS)}")
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


def _study(folder: Path, name: str, seed: int) -> Any:
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


def _made(study: Any, *states: str) -> int:
    """Return how many trials have ended, or ended so."""
    return sum(trial.state.name in (states or ("COMPLETE", "FAIL")) for trial in study.get_trials(deepcopy=False))


def _tell(study: Any, trial: Any, worth: Worth) -> None:
    if worth.error is None:
        study.tell(trial, worth.value)
    else:
        trial.set_user_attr("error", worth.error)
        study.tell(trial, state=_states().FAIL)


def _found(study: Any) -> Tuned:
    best, first = study.best_trial, study.trials[0]
    values = {key: float(f"{value:.3g}") for key, value in best.params.items()}
    first_value = math.nan if first.value is None else float(first.value)
    return Tuned(values, float(best.value), first_value, _made(study), _made(study, "FAIL"))


def _write_best(folder: Path, trial: Trial, worth: Worth) -> None:
    """Write the best values, and of a training the policy."""
    what = f"{trial.algo} on {trial.name}, {trial.steps} windows" if trial.kind == "training" else trial.name
    table = "algorithm" if trial.kind == "training" else "gains"
    write_found(folder, f"{what}; trial {trial.number}", worth.value, trial.seeds, table, trial.values, worth.files)


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
