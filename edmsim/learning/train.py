"""Training with stable-baselines3 (extra ``rl``): from an untrained learner, a policy, or a checkpoint."""

import io
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import BaseModel, ValidationError

from edmsim import files, numeric, signals
from edmsim.envs.registry import env_id_of, find, stand_in
from edmsim.errors import EdmsimError, InputError, invalid_entry, refuses_wrong_types
from edmsim.learning import hyperparameters
from edmsim.learning.policy_file import Card, Policy

try:
    import tensorboard  # noqa: F401 - stable-baselines3 writes its logs with it
    import torch
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.logger import configure
    from stable_baselines3.common.vec_env import VecNormalize

    from edmsim.learning import sb3
except ImportError as error:
    raise InputError(f"training needs {error.name}: pip install 'edmsim[rl]'") from error

CHECKPOINTS = 20  # checkpoints over a whole training (ours: at most a twentieth of it is lost)
CURVE_POINTS = 200  # points of the learning curve (ours)


class TrainingProgress(NamedTuple):
    """Progress of a training."""

    # steps, total: number of finished steps, and of all
    steps: int
    total: int
    mean_return: float  # mean of the last hundred episodes; NaN before the first ends


class TrainingRun(BaseModel, frozen=True):
    """Identity of a training; to resume a checkpoint, only `steps` may differ."""

    env_id: str
    algo: str
    steps: int
    seed: int
    options: dict[str, Any] = {}  # further options of the command with which it began


class _Saved(TrainingRun, frozen=True):
    """State of the training in a checkpoint's ``run.json``."""

    done: int
    multiplier: float | None
    hyperparameters: hyperparameters.Hyperparameters
    curve: list[tuple[int, float]] = []  # see `Trained`


class Trained(NamedTuple):
    """Result of a training."""

    run: TrainingRun
    hyperparameters: hyperparameters.Hyperparameters
    model: Any
    normalise: Any  # environments with the statistics of the policy's observations
    vec_env: sb3.TrainingEnvs
    curve: list[tuple[int, float]]  # steps, mean return of the last hundred episodes; also before a resume

    def export(self, command: str) -> tuple[Card, bytes]:
        """Return the policy for `policy_file.write`; `command` is the command of the training."""
        return sb3.exported(self.model, self.normalise, self.run.algo, command, self.run.seed)


@refuses_wrong_types
def train(
    env_id: str, algo: str, out: str | Path, *, steps: int | None = None, seed: int = 0, resume: bool = False,
    watch: Callable[[TrainingProgress], None] | None = None,
    parameters: hyperparameters.Hyperparameters | None = None, callbacks: Sequence[BaseCallback] = (),
    begin_from: str | Path | Policy | None = None, options: Mapping[str, Any] | None = None,
) -> Trained:
    """Train a policy.

    Parameters
    ----------
    env_id : str
        ``"edmsim/GapFeed-v2"`` and so on, or your own environment (see `edmsim.envs.register`).
    algo : {"ppo", "sac", "tqc", "ppo-lag", "recurrent-ppo", "imitation"}
    out : path
        Folder for ``tensorboard/`` and the checkpoint. Checkpoints of stable-baselines3 contain pickles: resume
        only folders that you trust.
    steps : int, optional
        Total number of steps; by default that of the hyperparameters. SAC and TQC only act at random in the first
        ``learning_starts`` of them: with no more, the policy is untrained.
    seed : int
        The same seed gives the same policy on the same kind of processor if the training was not interrupted; a
        resumed training starts new episodes.
    resume : bool
        Whether to resume the folder's last checkpoint, with its hyperparameters.
    watch : callable, optional
        Called with a `TrainingProgress` at the start and after every step of all sub-environments.
    parameters : Hyperparameters, optional
        By default those of ``models/training``.
    callbacks : sequence of BaseCallback
        Further callbacks of stable-baselines3, for example `edmsim.envs.RecordEpisodes`.
    begin_from : path or Policy, optional
        Start of the training in place of an untrained learner: a policy, for its network and normalisation (see
        `edmsim.learning.start_sb3`), or the folder of a trusted checkpoint, also of another seed or with other
        settings. `steps` includes the checkpoint's steps; the training continues with `parameters`.
    options : mapping, optional
        Data of the caller that a resumed training returns as ``run.options``, for JSON.

    Raises
    ------
    InputError
        If an argument is invalid, there is no checkpoint to resume, or one without `resume`.
    EdmsimError
        If the training diverges; its last checkpoint stays.
    KeyboardInterrupt
        If interrupted, after saving a checkpoint.
    """
    parameters = parameters or hyperparameters.load(env_id, algo)
    stand_in(*find(env_id))  # raises `InputError` if no policy file can describe it
    out, total = files.folder_of(out), parameters.steps if steps is None else numeric.whole_from("steps", steps, 1)
    numeric.whole_within("seed", seed, 0, 2**32 - 1)
    run = TrainingRun(env_id=env_id_of(env_id), algo=algo, steps=total, seed=seed, options=dict(options or {}))
    last = begin_from if begin_from is None or isinstance(begin_from, Policy) else Path(begin_from)
    before = None
    if resume:
        last, before = _to_resume(run, out, steps)
        parameters = before.hyperparameters
        run = run.model_copy(update={"steps": steps or before.steps, "options": before.options})
    else:
        hyperparameters.refuse_training(out)
        before = _saved(last) if isinstance(last, Path) else None
    sb3.check(run.env_id, algo, parameters)
    with files.locked(out, "edmsim train"), signals.noted() as interrupts:
        interrupts.at_once()
        torch.set_num_threads(1)  # more threads would wait for each other, and change the initial weights
        trained = _begin(run, parameters, last, before)
        _learn(trained, out, watch, callbacks, interrupts, reset=before is None)
    return trained


def _learn(
    trained: Trained, out: Path, watch: Callable[[TrainingProgress], None] | None, callbacks: Sequence[Any],
    interrupts: signals.NotedSignals, *, reset: bool,
) -> None:
    """Learn up to the run's steps; save checkpoints meanwhile and at the end, also after an error or a signal."""
    keeper = _Keeper(trained, out, watch)
    left = trained.run.steps - trained.model.num_timesteps
    try:
        with _room(out):
            trained.model.set_logger(configure(str(out / "tensorboard"), ["tensorboard"]))
            if left > 0:
                more = [*sb3.callbacks_of(trained.vec_env, trained.hyperparameters), *callbacks]
                trained.model.learn(left, callback=[keeper, *more], reset_num_timesteps=reset)
    finally:
        interrupts.only_note()
        trained.normalise.close()
        with _room(out):
            keeper.save()


@contextmanager
def _room(out: Path) -> Iterator[None]:
    """If a training cannot be written, for example on a full disk, raise `EdmsimError` and say what stays of it."""
    try:
        yield
    except OSError as error:
        rest = "make room, and continue its last checkpoint with --resume"
        raise EdmsimError(
            f"{out}: the training could not be written: {error.strerror or error}; "
            f"{rest if hyperparameters.has_training(out) else 'there is no checkpoint yet, so it is lost'}"
        ) from None


def _begin(
    run: TrainingRun, parameters: hyperparameters.Hyperparameters, last: Path | Policy | None, before: _Saved | None
) -> Trained:
    """Make environment and learner: new, from a policy, or from a checkpoint."""
    # `done` is in the seed, so a resumed training has other episodes
    done, multiplier = (0, None) if before is None else (before.done, before.multiplier)
    first = int(np.random.SeedSequence((run.seed, done)).generate_state(1)[0])
    vec_env = sb3.vec_env_of(run.env_id, parameters, first, multiplier)
    if isinstance(last, Path):
        made = _saved_learner(run.algo, vec_env, parameters, run.seed, last)
    else:
        made = sb3.new_learner(run.algo, vec_env, parameters, run.seed)
    if isinstance(last, Policy):
        sb3.start_sb3(*made, last)
    vec_env.edm.seed(first)  # the learner has set its own seed, which would repeat episodes after a resume
    return Trained(run, parameters, *made, vec_env, [] if before is None else before.curve)


def _saved_learner(
    algo: str, vec_env: sb3.TrainingEnvs, parameters: hyperparameters.Hyperparameters, seed: int, checkpoint: Path
) -> tuple[Any, VecNormalize]:
    """Return a checkpoint's learner, which resumes with `parameters`, and its normalised environments."""
    try:
        normalise = VecNormalize.load(str(checkpoint / "normalise.pkl"), vec_env.learned_on)
        normalise.gamma = parameters.algorithm["gamma"]
        model = sb3.kind_of(algo, parameters).load(
            checkpoint / "model.zip", env=normalise, device=sb3.DEVICE, seed=seed, **parameters.algorithm
        )
        if algo in hyperparameters.REPLAYS:
            with (checkpoint / "replay.pkl").open("rb") as replay:
                model.load_replay_buffer(replay)
    except Exception as error:  # any of pickle, zipfile, torch and stable-baselines3
        raise _damaged(error, checkpoint) from None
    return model, normalise


class _Keeper(BaseCallback):
    """Reports the progress of a training, and saves its last checkpoint atomically."""

    def __init__(self, trained: Trained, out: Path, watch: Callable[[TrainingProgress], None] | None) -> None:
        super().__init__()
        self._trained, self._out, self._watch = trained, out, watch
        self._saved = self._learned = trained.model.num_timesteps

    def _report(self) -> None:
        returns = [episode["r"] for episode in self.model.ep_info_buffer or ()]
        mean = float(np.mean(returns)) if returns else float("nan")
        steps, total, curve = self.model.num_timesteps, self._trained.run.steps, self._trained.curve
        if returns and (not curve or steps >= curve[-1][0] + total / CURVE_POINTS):
            curve.append((steps, mean))
        if self._watch is not None:
            self._watch(TrainingProgress(steps, total, mean))

    _on_training_start = _report  # because the first step of a part takes a minute

    def _on_step(self) -> bool:
        self._report()
        return True

    def _on_rollout_start(self) -> None:
        self._learned = self.model.num_timesteps
        if self._learned - self._saved >= max(self._trained.run.steps // CHECKPOINTS, 1):
            self.save()
    _on_training_end = _on_rollout_start

    def save(self) -> None:
        """Write a new checkpoint, then remove the old one; a resumed training repeats an unfinished rollout."""
        model, done = self._trained.model, self._learned
        if not all(torch.isfinite(each).all() for each in model.policy.parameters()):
            raise EdmsimError(
                f"the training has diverged: after {done} steps its network has numbers that are not finite; a "
                "smaller learning_rate may help. Its last checkpoint, if it has one, stays"
            )
        partial, folder = self._out / "partial", self._out / f"checkpoint-{done:012d}"
        if folder.exists() or not done:
            return
        model.num_timesteps = done
        shutil.rmtree(partial, ignore_errors=True)
        try:
            self._write(partial)
            partial.rename(folder)
        finally:
            shutil.rmtree(partial, ignore_errors=True)  # an incomplete one, of a full disk for example
        for old in self._out.glob("checkpoint-*"):
            if old != folder:
                old.rename(partial)  # so a kill leaves no incomplete checkpoint
                shutil.rmtree(partial)
        self._saved = done

    def _write(self, folder: Path) -> None:
        """Write the files of a checkpoint."""
        trained = self._trained
        folder.mkdir()
        packed = io.BytesIO()  # in memory, because torch raises other errors if it cannot write a file
        trained.model.save(packed)
        (folder / "model.zip").write_bytes(packed.getvalue())
        trained.normalise.save(str(folder / "normalise.pkl"))
        if trained.run.algo in hyperparameters.REPLAYS:
            trained.model.save_replay_buffer(folder / "replay.pkl")
        saved = _Saved(
            **dict(trained.run), done=trained.model.num_timesteps,
            multiplier=None if trained.vec_env.costs is None else trained.vec_env.costs.multiplier,
            hyperparameters=trained.hyperparameters, curve=trained.curve,
        )
        (folder / "run.json").write_text(saved.model_dump_json(), encoding="utf-8")


def _to_resume(run: TrainingRun, out: Path, steps: int | None) -> tuple[Path, _Saved]:
    """Return the folder's last checkpoint and its state; raise `InputError` if it is of another training."""
    found = sorted(out.glob(hyperparameters.CHECKPOINT))
    if not found:
        raise InputError("there is no training to resume in this folder", out)
    last = found[-1].parent
    saved = _saved(last)
    for name in ("env_id", "algo", "seed"):
        if getattr(saved, name) != getattr(run, name):
            raise InputError(
                f"the training there was made with {name} {getattr(saved, name)}, not {getattr(run, name)}", out
            )
    if steps is not None and steps < min(saved.done, saved.steps):
        raise InputError(f"the training there has {saved.done} steps: give as many or more, not {steps}", out)
    return last, saved


def _saved(checkpoint: Path) -> _Saved:
    """Return the state of the training in a checkpoint."""
    try:
        return _Saved.model_validate_json((checkpoint / "run.json").read_bytes())
    except ValidationError as error:
        raise _damaged(invalid_entry(error), checkpoint) from None
    except OSError as error:
        raise _damaged(error.strerror, checkpoint) from None


def _damaged(error: object, checkpoint: Path) -> InputError:
    """Return the error for a checkpoint that cannot be read."""
    return InputError(f"the checkpoint is damaged ({error}); train again in another folder", checkpoint)
