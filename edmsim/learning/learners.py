"""Learners of stable-baselines3 and sb3-contrib with the sub-environments they learn on (extra ``rl``)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from edmsim.controllers.user_controllers import rehearsed
from edmsim.envs.environment import check_acts
from edmsim.envs.registry import arguments_with
from edmsim.envs.task import Family
from edmsim.errors import InputError, located
from edmsim.evaluation.episode import is_part
from edmsim.learning.hyperparameters import REPLAYS, Hyperparameters
from edmsim.learning.policy_file import Residual

try:
    import torch
    from sb3_contrib import TQC, RecurrentPPO
    from stable_baselines3 import PPO, SAC
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.vec_env import VecNormalize

    from edmsim.envs.sb3 import make_sb3_vec_env
    from edmsim.learning import kinds
    from edmsim.learning.sb3_policy import ACTIVATIONS
except ImportError as error:
    raise InputError(f"training needs {error.name}: pip install 'edmsim[rl]'") from error

KINDS: dict[str, Any] = {
    "ppo": PPO, "ppo-lag": PPO, "recurrent-ppo": RecurrentPPO, "sac": SAC, "tqc": TQC, "imitation": kinds.Imitation,
}
CRITICS = ("ppo", "ppo-lag")  # algorithms whose critic may be privileged
_DEVICE = "cpu"  # a network this small waits for a GPU more than it gains; and the same seed gives the same policy


@dataclass(frozen=True)
class TrainingEnvs:
    """The environments of a training."""

    edm: Any  # the sub-environments themselves
    costs: kinds.CostVecEnv | None  # with Lagrangian PPO
    learned_on: Any  # with all wrappers but the normalisation


def check(env_id: str, algo: str, parameters: Hyperparameters) -> None:
    """Raise `InputError` if the algorithm cannot use these hyperparameters."""
    if parameters.privileged_critic and algo not in CRITICS:
        raise InputError(f"{algo} has no critic of its own to be privileged; choose one of {', '.join(CRITICS)}")
    if (parameters.teacher is not None) != (algo == "imitation"):
        raise InputError(f"a teacher is for imitation, and needed there; the algorithm is {algo}")
    of_windows = parameters.privileged_critic, parameters.teacher is not None, parameters.residual is not None
    if is_part(env_id) and any(of_windows):
        raise InputError(f"{env_id} is decided on pass by pass: it has no teacher, residual or privileged critic")
    if parameters.teacher is not None and parameters.residual is not None:
        raise InputError("imitation learns the teacher's own actions: leave the residual law out")
    family = arguments_with(env_id, **parameters.environment)
    if not isinstance(family, Family):
        return
    if parameters.teacher is not None:
        with located(name="teacher"):
            check_acts(family, parameters.teacher)
    residual = residual_of(parameters)
    if residual is not None:
        commands = rehearsed(residual.make, family.greatest_feed_um_s)
        if any((command.t_on_us, command.t_period_us) != (None, None) for command in commands):
            raise InputError(f"'{residual.law}' turns the generator's knobs: a policy adds to a law that only feeds")
        if family.action != "speed" or family.decision_s is not None:
            raise InputError("a residual policy commands a speed every window: the environment has another action")


def residual_of(parameters: Hyperparameters) -> Residual | None:
    """Return the law that a policy adds to, checked."""
    if parameters.residual is None:
        return None
    residual = Residual(law=parameters.residual, range_um_s=parameters.residual_um_s)
    residual.make()
    return residual


def vec_env_of(env_id: str, parameters: Hyperparameters, seed: int, multiplier: float | None = None) -> TrainingEnvs:
    """Make the environments of a training; `seed` is of the first reset, `multiplier` a checkpoint's."""
    edm = make_sb3_vec_env(env_id, parameters.num_envs, seed=seed, **parameters.environment)
    vec_env: Any = edm
    residual, costs = residual_of(parameters), None
    if residual is not None:
        vec_env = kinds.ResidualVecEnv(edm, residual)
    if parameters.teacher is not None:
        vec_env = kinds.TaughtVecEnv(edm, parameters.teacher)
    if parameters.privileged_critic:
        vec_env = kinds.PrivilegedVecEnv(vec_env)
    if parameters.lagrangian is not None:
        multiplier = parameters.lagrangian.multiplier if multiplier is None else multiplier
        vec_env = costs = kinds.CostVecEnv(vec_env, multiplier)
    return TrainingEnvs(edm, costs, vec_env)


def new(algo: str, vec_env: TrainingEnvs, parameters: Hyperparameters, seed: int) -> tuple[Any, VecNormalize]:
    """Return a learner that knows nothing yet, and its normalised sub-environments."""
    normalise = VecNormalize(vec_env.learned_on, gamma=parameters.algorithm["gamma"])
    network = parameters.network
    policy: Any = "MlpLstmPolicy" if network.lstm else "MlpPolicy"
    options: dict[str, Any] = {"net_arch": network.widths, "activation_fn": ACTIVATIONS[network.activation]}
    if network.log_std_init is not None:
        options["log_std_init"] = network.log_std_init
    if network.lstm is not None:
        options["lstm_hidden_size"] = network.lstm
    if parameters.privileged_critic:
        policy = kinds.AsymmetricPolicy
        options["shown_entries"] = int(np.prod(vec_env.edm.observation_space.shape))
    kind = _kind(algo, parameters)
    model = kind(policy, normalise, policy_kwargs=options, seed=seed, device=_DEVICE, **parameters.algorithm)
    if network.first_action is not None:
        model.policy.action_net.bias.data = torch.tensor(network.first_action)
    return model, normalise


def _kind(algo: str, parameters: Hyperparameters) -> Any:
    """Return the learner's class."""
    return kinds.RecurrentImitation if algo == "imitation" and parameters.network.lstm else KINDS[algo]


def load(
    algo: str, vec_env: TrainingEnvs, parameters: Hyperparameters, seed: int, checkpoint: Path
) -> tuple[Any, VecNormalize]:
    """Return a checkpoint's learner, which resumes with `parameters`, and its normalised environments."""
    kind = _kind(algo, parameters)
    try:
        normalise = VecNormalize.load(str(checkpoint / "normalise.pkl"), vec_env.learned_on)
        normalise.gamma = parameters.algorithm["gamma"]
        model = kind.load(checkpoint / "model.zip", env=normalise, device=_DEVICE, seed=seed, **parameters.algorithm)
        if algo in REPLAYS:
            with (checkpoint / "replay.pkl").open("rb") as replay:
                model.load_replay_buffer(replay)
    except Exception as error:  # of pickle, zipfile, torch and stable-baselines3, whatever it is
        raise damaged(error, checkpoint) from None
    return model, normalise


def damaged(error: object, checkpoint: Path) -> InputError:
    """Return what to raise for a checkpoint that cannot be read."""
    return InputError(f"the checkpoint is damaged ({error}); train again in another folder", checkpoint)


def callbacks(vec_env: TrainingEnvs, parameters: Hyperparameters) -> list[BaseCallback]:
    """Return the callbacks of the algorithm."""
    if vec_env.costs is None or parameters.lagrangian is None:
        return []
    return [kinds.Multiplier(vec_env.costs, vec_env.edm.env.family.cost_limit, parameters.lagrangian.rate)]
