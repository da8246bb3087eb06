"""Training with stable-baselines3 (extra ``rl``): from nothing, or on from a folder's last checkpoint."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from edmsim.envs.registry import env_id_of, find, stand_in
from edmsim.errors import InputError
from edmsim.files import make_writable
from edmsim.learning import hyperparameters
from edmsim.learning.hyperparameters import Hyperparameters

try:
    import tensorboard  # noqa: F401 - stable-baselines3 writes its logs with it
    import torch
    from stable_baselines3 import PPO, SAC
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.logger import configure
    from stable_baselines3.common.vec_env import VecMonitor, VecNormalize
except ImportError as error:
    raise InputError(f"training needs {error.name}: pip install 'edmsim[rl]'") from error

KINDS: dict[str, Any] = {"ppo": PPO, "sac": SAC}
ACTIVATIONS = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}
CHECKPOINTS = 20
"""Checkpoints over a whole training (ours: at most a twentieth of it is lost)."""
_DEVICE = "cpu"  # a network this small waits for a GPU more than it gains; and the same seed gives the same policy


class TrainingProgress(NamedTuple):
    """How far a training is.

    Attributes
    ----------
    steps, total : int
        Windows so far, and in all.
    mean_return : float
        Of the last hundred episodes; NaN before the first has ended.
    """

    steps: int
    total: int
    mean_return: float


@dataclass(frozen=True)
class TrainingRun:
    """What a training is of; a checkpoint goes on only with the same.

    Attributes
    ----------
    env_id, algo : str
    steps, seed : int
    """

    env_id: str
    algo: str
    steps: int
    seed: int


class Trained(NamedTuple):
    """What a training leaves.

    Attributes
    ----------
    run : TrainingRun
    hyperparameters : Hyperparameters
    model : stable_baselines3 PPO or SAC
    normalise : stable_baselines3 VecNormalize
        With the statistics the policy's observations are normalised with.
    """

    run: TrainingRun
    hyperparameters: Hyperparameters
    model: Any
    normalise: Any


def train(
    env_id: str, algo: str, out: Path, *, steps: int | None = None, seed: int = 0, resume: bool = False,
    watch: Callable[[TrainingProgress], None] | None = None, given: Hyperparameters | None = None,
) -> Trained:
    """Train a policy.

    Parameters
    ----------
    env_id : str
        ``"edmsim/GapFeed-v1"`` and so on, or of an own environment (see `edmsim.envs.register`).
    algo : {"ppo", "sac"}
    out : Path
        Folder for ``tensorboard/`` and the checkpoint. Checkpoints are stable-baselines3's own, pickles among them:
        resume only folders you trust.
    steps : int, optional
        Windows in all; those of the hyperparameters if not given.
    seed : int
        Same seed, same policy on the same kind of processor, if the training was not interrupted: where it was,
        the lanes begin new episodes.
    resume : bool
        Go on from the folder's last checkpoint.
    watch : callable, optional
        Called with a `TrainingProgress` after every step of all lanes.
    given : Hyperparameters, optional
        What to train with; that of ``models/training`` by default.

    Raises
    ------
    InputError
        An argument that cannot be used, or no checkpoint to go on from.
    KeyboardInterrupt
        After a checkpoint was written.
    """
    given = given or hyperparameters.load(env_id, algo)
    stand_in(*find(env_id))  # refuses an environment of which no policy file could be written
    total = given.steps if steps is None else steps
    if total < 1:
        raise InputError(f"steps is {total}: give 1 or more")
    if not 0 <= seed < 2**32:
        raise InputError(f"the seed {seed} must be from 0 to {2**32 - 1}")
    run = TrainingRun(env_id_of(env_id), algo, total, seed)
    last = _checkpoint_of(run, out) if resume else None
    make_writable(out)
    if last is None:
        for old in out.glob("checkpoint-*"):
            shutil.rmtree(old)
    trained = _begin(run, given, last)
    keeper = _Keeper(trained, out, watch)
    trained.model.set_logger(configure(str(out / "tensorboard"), ["tensorboard"]))
    torch.set_num_threads(1)  # more only wait for each other
    left = total - trained.model.num_timesteps
    try:
        if left > 0:
            trained.model.learn(left, callback=keeper, reset_num_timesteps=last is None)
    finally:
        keeper.save()
        trained.normalise.close()
    return trained


def _begin(run: TrainingRun, given: Hyperparameters, last: Path | None) -> Trained:
    """Make environment and learner, as new or as a checkpoint has them."""
    from edmsim.envs import make_sb3_vec_env

    kind = KINDS[run.algo]
    done = 0 if last is None else json.loads((last / "run.json").read_text(encoding="utf-8"))["done"]
    first = int(np.random.SeedSequence((run.seed, done)).generate_state(1)[0])  # other episodes after a break
    lanes = VecMonitor(make_sb3_vec_env(run.env_id, given.num_envs, seed=first, **given.environment))
    if last is not None:
        normalise = VecNormalize.load(str(last / "normalise.pkl"), lanes)
        model = kind.load(last / "model.zip", env=normalise, device=_DEVICE)
        if (last / "replay.pkl").exists():
            model.load_replay_buffer(last / "replay.pkl")
    else:
        normalise = VecNormalize(lanes, gamma=given.algorithm["gamma"])
        network = given.network
        policy: dict[str, Any] = {"net_arch": network.widths, "activation_fn": ACTIVATIONS[network.activation]}
        if network.log_std_init is not None:
            policy["log_std_init"] = network.log_std_init
        model = kind(
            "MlpPolicy", normalise, policy_kwargs=policy, seed=run.seed, device=_DEVICE, **given.algorithm
        )
        if network.first_action is not None:
            model.policy.action_net.bias.data = torch.tensor(network.first_action)
    lanes.seed(first)  # the learner seeds them with its own seed, that a break would repeat
    return Trained(run, given, model, normalise)


# untyped where the extra is missing
class _Keeper(BaseCallback):  # type: ignore[misc, unused-ignore]
    """Tells how far a training is, and keeps its last checkpoint, whole."""

    def __init__(self, trained: Trained, out: Path, watch: Callable[[TrainingProgress], None] | None) -> None:
        super().__init__()
        self._trained, self._out, self._watch = trained, out, watch
        self._every = max(trained.run.steps // CHECKPOINTS, 1)
        self._saved = trained.model.num_timesteps

    def _on_step(self) -> bool:
        if self._watch is not None:
            returns = [episode["r"] for episode in self.model.ep_info_buffer or ()]
            mean = float(np.mean(returns)) if returns else float("nan")
            self._watch(TrainingProgress(self.model.num_timesteps, self._trained.run.steps, mean))
        if self.model.num_timesteps - self._saved >= self._every:
            self.save()
        return True

    def save(self) -> None:
        """Write a checkpoint beside the last one, then remove that."""
        model, done = self._trained.model, self._trained.model.num_timesteps
        partial, folder = self._out / "partial", self._out / f"checkpoint-{done:012d}"
        if folder.exists():
            return
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir()
        model.save(partial / "model.zip")
        self._trained.normalise.save(str(partial / "normalise.pkl"))
        if self._trained.run.algo == "sac":
            model.save_replay_buffer(partial / "replay.pkl")
        (partial / "run.json").write_text(json.dumps({**asdict(self._trained.run), "done": done}), encoding="utf-8")
        partial.rename(folder)
        for old in self._out.glob("checkpoint-*"):
            if old != folder:
                shutil.rmtree(old)
        self._saved = done


def _checkpoint_of(run: TrainingRun, out: Path) -> Path:
    """Return the folder's last checkpoint, of a training of the same; `steps` may be another."""
    found = sorted(out.glob("checkpoint-*/run.json"))
    if not found:
        raise InputError("there is no training to resume in this folder", out)
    try:
        told = json.loads(found[-1].read_text(encoding="utf-8"))
        kept = TrainingRun(*(told[name] for name in ("env_id", "algo", "steps", "seed")))
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise InputError(f"the checkpoint is damaged ({error}); train again without --resume", found[-1]) from None
    for name in ("env_id", "algo", "seed"):
        if getattr(kept, name) != getattr(run, name):
            raise InputError(
                f"the training there was made with {name} {getattr(kept, name)}, not {getattr(run, name)}", out
            )
    return found[-1].parent
