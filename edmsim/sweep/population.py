"""Population-based training on a Ray cluster (extras ``cluster``, ``rl``, ``tune``): ``edmsim tune population``.

Learners train in parallel, generation by generation. After each generation, the worst learners resume from the
checkpoint of one of the best (exploit), with its settings changed a little or drawn again (explore): Jaderberg et al.
2017, arXiv:1711.09846, by Ray Tune's `PopulationBasedTraining`. The result is a policy and a schedule of settings.
"""

import json
import logging
import math
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq

from edmsim import files, numeric, runs
from edmsim.envs.registry import resolve
from edmsim.errors import InputError, refuses_wrong_types
from edmsim.learning import hyperparameters
from edmsim.sweep.specification import Bound
from edmsim.sweep.tune import anywhere, judge_policy, training_seeds, training_space, within, write_found

try:
    from ray import tune
except ImportError as error:
    raise InputError(f"a population needs {error.name}: pip install 'edmsim[cluster]'") from None

TABLE = "population.parquet"
"""A row per learner and generation: score, windows, settings, and the learner whose checkpoint it resumed."""
JOURNAL = "population.jsonl"  # `RunTable` of the generations, from which `TABLE` is written
RUN = "ray"  # folder of Ray Tune's files and the learners' checkpoints
LEAST_POPULATION = 4  # a quarter of the population must be at least one learner
_OF_LEARNER = ("learner", "parent", "score", "windows")
_CHECKPOINTS = 3
"""Number of stored checkpoints per learner (as Ray Tune advises: another learner may still read an older one)."""


@dataclass(frozen=True)
class Plan:
    """Arguments that identify a population; a folder resumes only a population with the same ones."""

    env_id: str  # or ``FILE.py:ID`` with a path that is valid on every computer
    files: tuple[str, ...]  # digest of that file
    algo: str
    population: int
    generations: int
    windows: int  # per learner and generation
    seed: int  # seed of learner 0; learner n has ``seed + n``
    seeds: tuple[int, ...]  # training seeds on which a learner's policy is scored after every generation
    # all hyperparameters, because the files of other computers may differ; the population changes some of them
    parameters: dict[str, Any]


class PopulationResult(NamedTuple):
    """State of a population."""

    values: dict[str, float]  # settings of the best learner in its last generation
    value: float  # mean return of its policy on the training seeds
    generation: int  # number of its last finished generation


@refuses_wrong_types
def train_population(
    name: str, out: str | Path, *, address: str = "auto", population: int = 8, generations: int = 10,
    steps: int | None = None, algo: str = "ppo", seed: int = 0, seeds: int = 5,
    watch: Callable[[PopulationResult], None] | None = None,
) -> PopulationResult:
    """Train a population on a Ray cluster, one processor per learner; on fewer processors learners take turns.

    The folder must be at the same path on every computer of the cluster; an interrupted training in it is resumed.
    `steps` is the number of windows of a learner over all generations, each rounded up to whole updates.
    """
    if " " in sys.executable:
        raise InputError(
            f"Ray Tune cannot start learners with '{sys.executable}', as the path has a space: "
            "install edmsim in a folder without one"
        )
    plan = _plan(name, algo, population, generations, steps, seed, seeds)
    runs.Cluster(address)
    folder = files.make_writable(out).absolute()
    with files.locked(folder, "edmsim tune population"):
        journal = runs.RunTable(folder / JOURNAL, asdict(plan))
        best = _run(folder, plan, journal, watch)
        _write(folder, plan, best, journal)
    return _result_of(best.metrics)


def _plan(name: str, algo: str, population: int, generations: int, steps: int | None, seed: int, seeds: int) -> Plan:
    numeric.whole_from("population", population, LEAST_POPULATION)
    numeric.whole_from("generations", generations, 1)
    judged_by = tuple(training_seeds(seed, seeds))
    env_id = resolve(name)
    training_space(algo)  # raises `InputError` if no settings of the algorithm are searched
    parameters = hyperparameters.load(env_id, algo)
    total = hyperparameters.steps_of(parameters, algo, steps)
    if total < generations:
        raise InputError(f"{total} windows are fewer than {generations} generations: give more steps")
    windows = math.ceil(total / generations)
    digests = tuple(sorted(runs.digests_of([name]).values()))
    return Plan(
        anywhere(name), digests, algo, population, generations, windows, seed, judged_by,
        parameters.model_dump(mode="json"),
    )  # fmt: skip


def _run(folder: Path, plan: Plan, journal: runs.RunTable, watch: Callable[[PopulationResult], None] | None) -> Any:
    """Train or resume the population with Ray Tune, and return its best result."""
    os.environ.setdefault("RAY_AIR_NEW_OUTPUT", "0")
    os.environ.setdefault("TUNE_WARN_EXCESSIVE_EXPERIMENT_CHECKPOINT_SYNC_THRESHOLD_S", "0")
    logging.getLogger("ray.tune").setLevel(logging.ERROR)
    trainable = tune.with_resources(Learner, {"cpu": 1})
    path = folder / RUN
    if tune.Tuner.can_restore(str(path)):
        tuner = tune.Tuner.restore(str(path), trainable=trainable, restart_errored=True)
    else:
        tuner = _tuner(trainable, folder, plan)
    Watching.watch = staticmethod(_noting(journal, watch))
    results = tuner.fit()
    ended = [results[number] for number in range(len(results))]
    done = [result.metrics or {} for result in ended if result.error is None]
    if not any("score" in metrics for metrics in done):
        failed = next((str(error).strip().splitlines()[-1] for error in results.errors), "none ended")
        raise InputError(f"no learner could be trained: {failed}")
    if any(metrics.get("training_iteration", 0) < plan.generations for metrics in done):
        raise KeyboardInterrupt  # Ray Tune caught it, saved its state and ended as if all were done
    return results.get_best_result("score", "max")


def _tuner(trainable: Any, folder: Path, plan: Plan) -> Any:
    space = training_space(plan.algo)
    drawn = {
        key: (tune.loguniform if bound.scale == "log" else tune.uniform)(bound.low, bound.high)
        for key, bound in space.items()
    }
    scheduler = tune.schedulers.PopulationBasedTraining(
        time_attr="training_iteration", metric="score", mode="max", perturbation_interval=1, synch=True,
        hyperparam_mutations=drawn, custom_explore_fn=partial(_clamped, space), log_config=False,
    )  # fmt: skip
    first = within(space, plan.parameters["algorithm"])
    return tune.Tuner(
        trainable, param_space={"plan": asdict(plan), **drawn},
        tune_config=tune.TuneConfig(
            num_samples=plan.population, scheduler=scheduler, reuse_actors=True,
            search_alg=tune.search.BasicVariantGenerator(points_to_evaluate=[first], random_state=plan.seed),
        ),
        run_config=tune.RunConfig(
            name=RUN, storage_path=str(folder), stop={"training_iteration": plan.generations}, verbose=0,
            failure_config=tune.FailureConfig(max_failures=runs.ATTEMPTS - 1),
            checkpoint_config=tune.CheckpointConfig(num_to_keep=_CHECKPOINTS), callbacks=[Watching()],
        ),
    )  # fmt: skip


def _clamped(space: Mapping[str, Bound], config: dict[str, Any]) -> dict[str, Any]:
    """Return the configuration with explored values clamped to the bounds of the search."""
    return {**config, **{key: min(max(config[key], bound.low), bound.high) for key, bound in space.items()}}


def _result_of(metrics: Mapping[str, Any]) -> PopulationResult:
    values = {key: metrics["config"][key] for key in metrics["config"] if key != "plan"}
    return PopulationResult(values, float(metrics["score"]), int(metrics["training_iteration"]))


def _write(folder: Path, plan: Plan, best: Any, journal: runs.RunTable) -> None:
    """Write the best learner's policy and last settings, and the table of all learners."""
    found = _result_of(best.metrics)
    with best.checkpoint.as_directory() as name:
        policy = {file.name: file.read_bytes() for file in sorted(Path(name).glob("policy.*"))}
    text = (
        f"population: {plan.algo} on {plan.env_id}, {plan.population} learners, {plan.generations} generations of "
        f"{plan.windows} windows; the best one's last settings"
    )
    write_found(folder, text, found.value, plan.seeds, "algorithm", found.values, policy)
    rows = sorted(journal.rows.values(), key=lambda row: (row["generation"], row["learner"]))
    with files.replacing(folder / TABLE) as partial:
        pq.write_table(pa.Table.from_pylist(rows).drop_columns("id"), partial)


def _noting(
    journal: runs.RunTable, watch: Callable[[PopulationResult], None] | None
) -> Callable[[Mapping[str, Any]], None]:
    """Return a function that saves a learner's generation in the journal; if it is repeated, its row is replaced."""

    def note(metrics: Mapping[str, Any]) -> None:
        result = _result_of(metrics)
        row = {"generation": result.generation, **{key: metrics[key] for key in _OF_LEARNER}, **result.values}
        journal.add({"id": f"{result.generation} {metrics['learner']}", **row})
        if watch is not None:
            watch(result)

    return note


WHOSE = "learner.json"  # file in a checkpoint with the number of its learner


class Learner(tune.Trainable):  # type: ignore[misc]
    """Continues training from its own or another learner's checkpoint, with its present settings."""

    def setup(self, config: dict[str, Any]) -> None:
        """Start without a checkpoint."""
        self._folder = tempfile.TemporaryDirectory()
        self.reset_config(config)

    def reset_config(self, new_config: dict[str, Any]) -> bool:
        """Reset this actor to another learner; `load_checkpoint` may follow."""
        self.config = new_config
        self._last: Path | None = None
        self._parent = self._number
        return True

    @property
    def _number(self) -> int:
        return int(self.trial_id.rpartition("_")[2])

    def step(self) -> dict[str, Any]:
        """Train for a generation, and score the policy."""
        from edmsim.learning.train import train  # raises `InputError` if the extra is missing

        plan = self.config["plan"]
        usual = hyperparameters.Hyperparameters.model_validate(plan["parameters"])
        values = {key: value for key, value in self.config.items() if key != "plan"}
        parameters = usual.model_copy(update={"algorithm": {**usual.algorithm, **values}})
        out = Path(tempfile.mkdtemp(dir=self._folder.name))
        done = 0 if self._last is None else json.loads((self._last / "run.json").read_text(encoding="utf-8"))["done"]
        trained = train(
            resolve(plan["env_id"]), plan["algo"], out, steps=done + plan["windows"],
            seed=plan["seed"] + self._number, parameters=parameters, begin_from=self._last,
        )  # fmt: skip
        command = f"edmsim tune population {plan['env_id']} --algo {plan['algo']} --learners {plan['population']}"
        score = judge_policy(trained, command, out, plan["seeds"])
        (self._last,) = out.glob("checkpoint-*")
        (out / WHOSE).write_text(json.dumps(self._number), encoding="utf-8")
        for file in (*out.glob("policy.*"), out / WHOSE):
            shutil.move(file, self._last / file.name)
        parent, self._parent = self._parent, self._number
        return {"score": score, "windows": trained.model.num_timesteps, "learner": self._number, "parent": parent}

    def save_checkpoint(self, checkpoint_dir: str) -> None:
        """Copy the last checkpoint, including the policy, to Ray Tune's folder."""
        assert self._last is not None
        shutil.copytree(self._last, checkpoint_dir, dirs_exist_ok=True)

    def load_checkpoint(self, checkpoint: Any) -> None:
        """Copy a checkpoint of any learner; that learner becomes the parent."""
        self._last = Path(tempfile.mkdtemp(dir=self._folder.name)) / "checkpoint"
        shutil.copytree(checkpoint, self._last)
        self._parent = int(json.loads((self._last / WHOSE).read_text(encoding="utf-8")))

    def cleanup(self) -> None:
        """Delete all temporary files."""
        self._folder.cleanup()


class Watching(tune.Callback):  # type: ignore[misc]
    """Reports every finished generation of a learner to the driver."""

    watch: Callable[[dict[str, Any]], object] = staticmethod(lambda _: None)

    def on_trial_result(
        self, iteration: int, trials: list[Any], trial: Any, result: dict[str, Any], **info: Any
    ) -> None:
        """Pass a result to `watch`."""
        Watching.watch(result)
