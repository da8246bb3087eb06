"""Learners of stable-baselines3, the sub-environments they learn on, and their policies as files (extra ``rl``).

Kinds of learning besides plain PPO and SAC:

- Imitation of a teacher, which may know the true state, in the states that the learner visits: in every state the
  teacher gives the action it would take, and the policy's mean is fitted to it (DAgger, Ross et al., AISTATS 2011).
  If the teacher knows more than the policy, the policy learns the mean of its actions (Chen et al., CoRL 2019). With
  an LSTM it can identify from its history what the teacher knows (Kumar et al., RSS 2021, adapt a policy so).
- Lagrangian PPO: the reward minus a multiple of ``info["cost"]``. The multiplier grows while the mean cost is above a
  limit, and shrinks below it (Tessler, Mankowitz and Mannor, ICLR 2019, arXiv:1805.11074).
- Privileged critic: it observes gap, wire temperature, debris and drawn constants, which no machine measures. In the
  policy's features they are 0, so its actions do not depend on them, and the exported policy has no weights for them
  (Pinto et al., RSS 2018).
- Residual policies: a classic law sets the feed, and the policy adds a correction (Johannink et al., ICRA 2019).
"""

from __future__ import annotations

import platform
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import fields
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import PPO, SAC
from stable_baselines3.common import base_class, callbacks, monitor, policies, torch_layers
from stable_baselines3.common.vec_env import DummyVecEnv, VecCheckNan, VecMonitor, VecNormalize, VecVideoRecorder
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvWrapper

from edmsim.controllers import FeedController, from_text
from edmsim.controllers.user_controllers import rehearsed
from edmsim.envs import arguments, environment, episode, registry
from edmsim.envs.sb3 import EdmVecEnv, make_sb3_vec_env
from edmsim.envs.task import EnvArguments, Family
from edmsim.errors import InputError, located, refuses_wrong_types
from edmsim.evaluation.episode import is_part
from edmsim.files import make_writable
from edmsim.learning.hyperparameters import Hyperparameters
from edmsim.learning.policy_file import Card, Lstm, Policy, Residual, card_of, load, meanings, pack, write

LEAST_VARIANCE = 1e-4
"""Least variance by which an action's loss is divided (ours: that of an action that varies by 0.01)."""
LEAST_RATE = 0.02
"""Least factor on the learning rate (ours); the factor falls with the remaining steps, to average out noise."""
PACKAGES = ("edmsim", "stable-baselines3", "sb3-contrib", "torch", "gymnasium", "numpy")


class _WithLawsVecEnv(VecEnvWrapper):
    """Sub-environments, each with a law that observes every window."""

    def __init__(self, venv: EdmVecEnv, make: Callable[[], FeedController]) -> None:
        super().__init__(venv)
        self._laws = [venv.env.attach_controller(index, make()) for index in range(self.num_envs)]

    def reset(self) -> Any:
        """Begin an episode, and the law, in every sub-environment."""
        observations = self.venv.reset()
        for law in self._laws:
            law.begin()
        return observations

    def step_wait(self) -> Any:
        """Run a step, which the laws observe."""
        observations, rewards, done, infos = self.venv.step_wait()
        for index in np.flatnonzero(done):
            self._laws[index].begin()
        return observations, rewards, done, infos


class TaughtVecEnv(_WithLawsVecEnv):
    """Sub-environments, each with a teacher; they record observations and its actions."""

    def __init__(self, venv: EdmVecEnv, teacher: str) -> None:
        super().__init__(venv, partial(from_text, teacher))
        self._observations: Any = None
        self._states: list[NDArray[np.float32]] = []
        self._teacher_actions: list[NDArray[np.float32]] = []

    def reset(self) -> Any:
        """Begin an episode, and the teacher, in every sub-environment."""
        self._observations = super().reset()
        return self._observations

    def step_async(self, actions: NDArray[Any]) -> None:
        """Record the observations and the teachers' actions for them, and run the learner's actions."""
        self._states.append(np.array(self._observations, np.float32))
        self._teacher_actions.append(np.array([law.action() for law in self._laws]))
        self.venv.step_async(actions)

    def step_wait(self) -> Any:
        """Run a step."""
        self._observations, *rest = super().step_wait()
        return self._observations, *rest

    def taken(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return observations (n, entries) and the teacher's actions (n, k) since the last call, and clear them."""
        states, teacher_actions = np.concatenate(self._states), np.concatenate(self._teacher_actions)
        self._states.clear()
        self._teacher_actions.clear()
        return states, teacher_actions


class _Follows(ABC):
    """Mixin for PPO: learns a teacher's actions instead of the reward, in a `VecNormalize` of a `TaughtVecEnv`."""

    # all decisions so far are stored, also in checkpoints, a quarter of a kilobyte each

    STORED: tuple[str, ...] = ()
    """Names of further stored lists, with an entry for each rollout."""

    def _setup_model(self) -> None:
        super()._setup_model()  # type: ignore[misc]
        for name in ("states", "teacher_actions", *self.STORED):
            setattr(self, name, getattr(self, name, []))  # a checkpoint restores them

    def train(self) -> None:
        """Fit the policy's mean to the teacher's actions so far, each action in units of its own variance."""
        learner: Any = self
        learner.policy.set_training_mode(True)
        left = learner._current_progress_remaining
        for group in learner.policy.optimizer.param_groups:
            group["lr"] = learner.lr_schedule(left) * max(left, LEAST_RATE)
        normalise = learner.env
        for stored, new in zip((learner.states, learner.teacher_actions), normalise.venv.taken(), strict=True):
            stored.append(new)
        self.store()
        observations = torch.as_tensor(normalise.normalize_obs(np.concatenate(learner.states)))
        teacher_actions = torch.as_tensor(np.concatenate(learner.teacher_actions))
        variance = teacher_actions.var(0).clamp(min=LEAST_VARIANCE)
        losses = []
        for _ in range(max(learner.n_epochs * len(learner.teacher_actions[-1]) // learner.batch_size, 1)):
            rows, mean = self.drawn(observations)
            loss = ((mean - teacher_actions[rows]) ** 2 / variance).mean()
            learner.policy.optimizer.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(learner.policy.parameters(), learner.max_grad_norm)
            learner.policy.optimizer.step()
            losses.append(float(loss.detach()))
        learner.logger.record("train/unexplained_share", float(np.mean(losses)))

    def store(self) -> None:  # noqa: B027 - optional: a policy without memory has no further data
        """Store further data of the last rollout."""

    @abstractmethod
    def drawn(self, observations: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Draw decisions, and return their rows and the policy's means."""


class Imitation(_Follows, PPO):
    """A learner that acts as PPO does, and learns a teacher's actions instead of the reward."""

    def drawn(self, observations: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Draw single decisions."""
        rows = torch.randint(len(observations), (self.batch_size,))
        gaussian: Any = self.policy.get_distribution(observations[rows]).distribution
        return rows, gaussian.mean


class RecurrentImitation(_Follows, RecurrentPPO):
    """The same with an LSTM, which learns from whole rollouts, each starting with its stored memory.

    The memory of an old rollout is from the network at that time (Kapturowski et al., ICLR 2019, measure the effect).
    """

    STORED = ("memories", "starts")
    memories: list[tuple[NDArray[np.float32], NDArray[np.float32]]]  # LSTM's output and cells, (layers, envs, cells)
    starts: list[NDArray[np.float32]]  # (steps, envs)

    def store(self) -> None:
        """Store the memory at the rollout's beginning, and the starts of episodes."""
        buffer: Any = self.rollout_buffer
        self.memories.append((buffer.hidden_states_pi[0].copy(), buffer.cell_states_pi[0].copy()))
        self.starts.append(buffer.episode_starts.copy())

    def drawn(self, observations: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Draw rollouts of single sub-environments that fill a batch."""
        policy: Any = self.policy
        count = max(int(self.batch_size or 1) // self.n_steps, 1)
        rollouts = torch.randint(len(self.starts), (count,))
        envs = torch.randint(self.n_envs, (count,))
        steps = torch.arange(self.n_steps)
        rows = ((rollouts[:, None] * self.n_steps + steps) * self.n_envs + envs[:, None]).flatten()
        starts = torch.as_tensor(np.concatenate(self.starts)).flatten()[rows]
        pairs = list(zip(rollouts.tolist(), envs.tolist(), strict=True))
        memory = tuple(
            torch.as_tensor(np.stack([self.memories[rollout][part][:, env] for rollout, env in pairs], axis=1))
            for part in (0, 1)
        )
        gaussian = policy.get_distribution(observations[rows], memory, starts)[0].distribution
        return rows, gaussian.mean


class CostVecEnv(VecEnvWrapper):
    """Sub-environments whose rewards are reduced by `multiplier` times their costs."""

    def __init__(self, venv: VecEnv, multiplier: float) -> None:
        super().__init__(venv)
        self.multiplier = multiplier
        self.ended: list[float] = []  # costs of the episodes that ended since the last update of `Multiplier`
        self._cost = np.zeros(self.num_envs)

    def reset(self) -> Any:
        """Begin episodes with a cost of 0."""
        self._cost[:] = 0.0
        return self.venv.reset()

    def step_wait(self) -> Any:
        """Run a step."""
        observations, rewards, done, infos = self.venv.step_wait()
        cost = np.array([info["cost"] for info in infos])
        self._cost += cost
        self.ended += self._cost[done].tolist()
        self._cost[done] = 0.0
        return observations, (rewards - self.multiplier * cost).astype(np.float32), done, infos


class Multiplier(callbacks.BaseCallback):
    """Raises the multiplier by `rate` times the mean cost of a rollout's episodes above the limit, or lowers it."""

    def __init__(self, vec_env: CostVecEnv, limit: float, rate: float) -> None:
        super().__init__()
        self._vec_env, self._limit, self._rate = vec_env, limit, rate

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        if self._vec_env.ended:
            beyond = float(np.mean(self._vec_env.ended)) - self._limit
            self._vec_env.multiplier = max(0.0, self._vec_env.multiplier + self._rate * beyond)
            self.logger.record("cost/mean_of_episodes", beyond + self._limit)
            self.logger.record("cost/multiplier", self._vec_env.multiplier)
            self._vec_env.ended = []


TRUTHS = ("gap_um", "wire_temperature_K", "debris", "error_um")
"""Entries of the last window's ``info`` that the critic observes; the episode's drawn constants follow."""


class PrivilegedVecEnv(VecEnvWrapper):
    """Sub-environments that append the true state to the observations."""

    def __init__(self, venv: VecEnv) -> None:
        vec_env: Any = venv.unwrapped
        self._names = tuple(vec_env.env.family.drawn_constants)
        shown = venv.observation_space
        assert isinstance(shown, gym.spaces.Box)
        more = np.full(len(TRUTHS) + len(self._names), np.inf, np.float32)
        space = gym.spaces.Box(np.append(shown.low, -more), np.append(shown.high, more), dtype=np.float32)
        super().__init__(venv, observation_space=space)
        self._constants = np.zeros((self.num_envs, len(self._names)), np.float32)

    def reset(self) -> Any:
        """Begin episodes; the state of the gap, still unknown, is 0."""
        observations = self.venv.reset()
        self._draw(range(self.num_envs))
        return self._with(observations, np.zeros((self.num_envs, len(TRUTHS)), np.float32))

    def step_wait(self) -> Any:
        """Run a step."""
        observations, rewards, done, infos = self.venv.step_wait()
        truths = np.array([[info[name] for name in TRUTHS] for info in infos], np.float32)
        ended = np.flatnonzero(done)
        for index in ended:
            last = infos[index]["terminal_observation"]
            infos[index]["terminal_observation"] = np.concatenate([last, truths[index], self._constants[index]])
        truths[ended] = 0.0
        self._draw(ended)
        return self._with(observations, truths), rewards, done, infos

    def _draw(self, indices: Iterable[int]) -> None:
        infos = self.unwrapped.reset_infos
        for index in indices:
            self._constants[index] = [infos[index]["drawn"][name] for name in self._names]

    def _with(self, observations: Any, truths: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.concatenate([observations, truths, self._constants], axis=1)


class VisibleEntries(torch_layers.BaseFeaturesExtractor):
    """Features: the first entries of an observation unchanged, 0 for the others."""

    def __init__(self, observation_space: gym.spaces.Box[Any], entries: int) -> None:
        width = int(np.prod(observation_space.shape))
        super().__init__(observation_space, width)
        self.shown: torch.Tensor
        self.register_buffer("shown", (torch.arange(width) < entries).float())

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Return features as wide as the observations."""
        return observations * self.shown


class AsymmetricPolicy(policies.ActorCriticPolicy):
    """An actor-critic whose actor observes only the first `shown_entries` of an observation."""

    def __init__(self, *args: Any, shown_entries: int, **kwargs: Any) -> None:
        self._shown_entries = shown_entries
        super().__init__(*args, **{**kwargs, "share_features_extractor": False})
        space = self.observation_space
        assert isinstance(space, gym.spaces.Box)
        self.pi_features_extractor = VisibleEntries(space, shown_entries)
        self.features_extractor = self.pi_features_extractor

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {**super()._get_constructor_parameters(), "shown_entries": self._shown_entries}


class ResidualVecEnv(_WithLawsVecEnv):
    """Sub-environments whose first action is added to the feed of a law (Johannink et al., ICRA 2019)."""

    def __init__(self, venv: EdmVecEnv, residual: Residual) -> None:
        super().__init__(venv, residual.make)
        self.residual = residual
        assert isinstance(venv.env.family, Family)
        self._family = venv.env.family

    def step_async(self, actions: NDArray[Any]) -> None:
        """Add the actions to the laws' commands."""
        total = np.array(actions, np.float32)
        for index, law in enumerate(self._laws):
            total[index, 0] = self.residual.action(self._family, law.command().feed_um_s, total[index, 0])
        self.venv.step_async(total)


KINDS: dict[str, Any] = {
    "ppo": PPO, "ppo-lag": PPO, "recurrent-ppo": RecurrentPPO, "sac": SAC, "tqc": TQC, "imitation": Imitation,
}
CRITICS = ("ppo", "ppo-lag")  # algorithms whose critic may be privileged
DEVICE = "cpu"  # a GPU is slower for a network this small, and on a CPU the same seed gives the same policy


class TrainingEnvs(NamedTuple):
    """The environments of a training."""

    edm: Any  # the sub-environments themselves
    costs: CostVecEnv | None  # with Lagrangian PPO
    learned_on: Any  # with all wrappers except the normalisation


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
    family = registry.arguments_with(env_id, **parameters.environment)
    if not isinstance(family, Family):
        return
    if parameters.teacher is not None:
        with located(name="teacher"):
            episode.check_acts(family, parameters.teacher)
    residual = residual_of(parameters)
    if residual is not None:
        commands = rehearsed(residual.make, family.greatest_feed_um_s)
        if any((command.t_on_us, command.t_period_us) != (None, None) for command in commands):
            raise InputError(f"'{residual.law}' turns the generator's knobs: a policy adds to a law that only feeds")
        residual.check(family)


def residual_of(parameters: Hyperparameters) -> Residual | None:
    """Return the law that a policy adds to."""
    law = parameters.residual
    return None if law is None else Residual(law=law, range_um_s=parameters.residual_um_s)


def vec_env_of(env_id: str, parameters: Hyperparameters, seed: int, multiplier: float | None = None) -> TrainingEnvs:
    """Make the environments of a training; `seed` is that of the first reset, `multiplier` that of a checkpoint."""
    edm = make_sb3_vec_env(env_id, parameters.num_envs, seed=seed, **parameters.environment)
    vec_env: Any = edm
    residual, costs = residual_of(parameters), None
    if residual is not None:
        vec_env = ResidualVecEnv(edm, residual)
    if parameters.teacher is not None:
        vec_env = TaughtVecEnv(edm, parameters.teacher)
    if parameters.privileged_critic:
        vec_env = PrivilegedVecEnv(vec_env)
    if parameters.lagrangian is not None:
        multiplier = parameters.lagrangian.multiplier if multiplier is None else multiplier
        vec_env = costs = CostVecEnv(vec_env, multiplier)
    return TrainingEnvs(edm, costs, vec_env)


def new_learner(algo: str, vec_env: TrainingEnvs, parameters: Hyperparameters, seed: int) -> tuple[Any, VecNormalize]:
    """Return an untrained learner and its normalised sub-environments."""
    normalise = VecNormalize(vec_env.learned_on, gamma=parameters.algorithm["gamma"])
    network = parameters.network
    policy: Any = "MlpLstmPolicy" if network.lstm else "MlpPolicy"
    options: dict[str, Any] = {"net_arch": network.widths, "activation_fn": ACTIVATIONS[network.activation]}
    if network.log_std_init is not None:
        options["log_std_init"] = network.log_std_init
    if network.lstm is not None:
        options["lstm_hidden_size"] = network.lstm
    if parameters.privileged_critic:
        policy = AsymmetricPolicy
        options["shown_entries"] = int(np.prod(vec_env.edm.observation_space.shape))
    kind = kind_of(algo, parameters)
    model = kind(policy, normalise, policy_kwargs=options, seed=seed, device=DEVICE, **parameters.algorithm)
    if network.first_action is not None:
        model.policy.action_net.bias.data = torch.tensor(network.first_action)
    return model, normalise


def kind_of(algo: str, parameters: Hyperparameters) -> Any:
    """Return the learner's class."""
    return RecurrentImitation if algo == "imitation" and parameters.network.lstm else KINDS[algo]


def callbacks_of(vec_env: TrainingEnvs, parameters: Hyperparameters) -> list[callbacks.BaseCallback]:
    """Return the callbacks of the algorithm."""
    if vec_env.costs is None or parameters.lagrangian is None:
        return []
    return [Multiplier(vec_env.costs, vec_env.edm.env.family.cost_limit, parameters.lagrangian.rate)]


@refuses_wrong_types
def export_sb3(model: base_class.BaseAlgorithm, vec_env: VecEnv, file: str | Path) -> Policy:
    """Write your learner's policy and its observation normalisation as files for ``--controller policy:FILE``.

    Parameters
    ----------
    model : learner of stable_baselines3 or sb3_contrib
        PPO, SAC, TQC, recurrent PPO, A2C, TRPO, TD3 or DDPG, with ``MlpPolicy`` (``MlpLstmPolicy``) and Tanh or ReLU.
    vec_env : VecEnv
        Its environments: `edmsim.envs.make_sb3_vec_env`, or a `DummyVecEnv` of edmsim's environments, with or
        without `VecNormalize`.
    file : path
        ``NAME.json``; ``NAME.npz`` goes into the same folder.

    Returns
    -------
    Policy
        The policy, read from the new files.

    Raises
    ------
    InputError
        If a policy file cannot describe the environment, wrapper or network.

    Examples
    --------
    >>> from edmsim.learning import export_sb3
    >>> export_sb3(model, vec_env, "policy.json")  # doctest: +SKIP
    """
    target = Path(file)
    if target.suffix != ".json":
        raise InputError("name the policy's file NAME.json; its arrays go into NAME.npz next to it", target)
    algorithm = re.sub(r"(?<=[a-z])(?=[A-Z])", "-", type(model).__name__).lower()
    made = exported(model, vec_env, algorithm, "edmsim.learning.export_sb3", model.seed)
    make_writable(target.parent)
    write(*made, target)
    return load(str(target))


def exported(model: Any, vec_env: Any, algorithm: str, command: str, seed: int | None) -> tuple[Card, bytes]:
    """Return a learner's policy for `policy_file.write`; `command` is the command or function that made it."""
    network, wrapped = network_of(model), around(vec_env)
    env_id, options = wrapped.environment()
    entry_count = len(wrapped.family.entries())
    if vec_env.observation_space != model.observation_space or vec_env.action_space != model.action_space:
        raise InputError("the learner has other observations or actions than this environment: give its own")
    trained_in = model.get_vec_normalize_env()
    if trained_in is not None and trained_in.norm_obs:
        if wrapped.normalise is None:
            raise InputError(
                "the learner has learned from normalised observations: give its environment in VecNormalize"
            )
        both: Any = trained_in.obs_rms, wrapped.normalise.obs_rms
        if not all(np.array_equal(*(getattr(each, name) for each in both)) for name in ("mean", "var")):
            raise InputError(
                "this VecNormalize has other means and variances than the learner's: give its own, or load its file"
            )
    packed = pack(*_arrays(network, entry_count))
    mean, variance, epsilon, clip = _normalisation(wrapped.normalise, entry_count)
    return card_of(
        env_id, options, packed, mean, variance, epsilon=epsilon, clip=clip, **network.shape,
        residual=wrapped.residual, algorithm=algorithm, command=command, seed=seed, steps=int(model.num_timesteps),
        versions={"python": platform.python_version(), **{name: version(name) for name in PACKAGES}},
    ), packed


def _arrays(network: PolicyNetwork, entry_count: int) -> tuple[list[Any], list[Any], Lstm | None]:
    """Return weights, biases and LSTM, without the last inputs if only the critic observes them."""
    first = network.lstm or network.layers[0]
    inputs = network.shown or (first.input_size if network.lstm else first.in_features)
    if inputs != entry_count:
        raise InputError(f"the learner's network sees {inputs} entries, its environment shows {entry_count}")
    weights, lstm = [_array(layer.weight).T for layer in network.layers], None
    biases = [_array(layer.bias) for layer in network.layers]
    if network.lstm is None:
        weights[0] = weights[0][:entry_count]
    else:
        names = "weight_ih_l0", "weight_hh_l0", "bias_ih_l0", "bias_hh_l0"
        ih, hh, *two = (_array(getattr(network.lstm, name)) for name in names)
        lstm = Lstm(ih.T, hh.T, two[0] + two[1])  # torch's gates have the same order as ours
    if not all(np.isfinite(array).all() for array in [*weights, *biases, *(lstm or ())]):
        raise InputError("the learner's network holds numbers that are not finite: its training has diverged")
    return weights, biases, lstm


def _normalisation(normalise: Any, count: int) -> tuple[list[float], list[float], float, float]:
    """Return mean, variance, epsilon and clip of the observation; without normalisation, those of the identity."""
    if normalise is None:
        epsilon = float(np.finfo(np.float64).eps)
        return [0.0] * count, [1.0 - epsilon] * count, epsilon, float(np.finfo(np.float32).max)
    statistics = normalise.obs_rms
    return statistics.mean[:count].tolist(), statistics.var[:count].tolist(), normalise.epsilon, normalise.clip_obs


def _array(tensor: Any) -> Any:
    return tensor.detach().cpu().numpy().astype(np.float64)


SCALES = (
    "action", "max_feed_um_s", "max_change_um_s", "setting_octaves", "offset_um", "servo_target_share",
    "set_point_octaves", "pause_octaves", "on_time_octaves",
)  # fmt: skip
"""Arguments of an environment that give the meaning and the size of an action of 1."""


@refuses_wrong_types
def start_sb3(model: base_class.BaseAlgorithm, vec_env: VecEnv, policy: str | Policy) -> None:
    """Set a learner's policy to one from a file; its critics and noise do not change.

    Parameters
    ----------
    model : learner of stable_baselines3 or sb3_contrib
        A class that `export_sb3` accepts.
    vec_env : VecEnv
        Its environments in a `VecNormalize`, which starts from the policy's statistics and updates them.
    policy : str or Policy
        Either of its files, or a name under ``models/policies``; the prefix ``policy:`` is optional.

    Raises
    ------
    InputError
        If the policy's observations, actions or network differ from the learner's.

    Examples
    --------
    >>> from edmsim.learning import start_sb3
    >>> start_sb3(model, vec_env, "policy:GapFeed-ppo")  # doctest: +SKIP
    """
    policy_file = load(policy) if isinstance(policy, str) else policy
    network, wrapped = network_of(model), around(vec_env)
    _check(policy_file, network, wrapped)
    its_env = model.get_env()
    if its_env is not None and around(its_env).normalise is not wrapped.normalise:
        raise InputError("the learner acts in another environment, which would keep its statistics: give that one")
    with torch.no_grad():
        for layer, weight, bias in zip(network.layers, policy_file.weights, policy_file.biases, strict=True):
            _put(layer.weight, weight.T)
            _put(layer.bias, bias)
        if policy_file.lstm is not None:
            lstm = network.lstm
            _put(lstm.weight_ih_l0, policy_file.lstm.input_weights.T)
            _put(lstm.weight_hh_l0, policy_file.lstm.memory_weights.T)
            _put(lstm.bias_ih_l0, policy_file.lstm.bias)
            _put(lstm.bias_hh_l0, np.zeros_like(policy_file.lstm.bias))
        acts: Any = model.policy
        if hasattr(acts, "actor_target"):  # TD3 and DDPG, whose critics learn what its actions earn
            acts.actor_target.load_state_dict(acts.actor.state_dict())
    normalise, card = wrapped.normalise, policy_file.card
    assert normalise is not None
    normalise.epsilon, normalise.clip_obs = card.epsilon, card.clip
    statistics: Any = normalise.obs_rms
    statistics.mean = np.array([entry.mean for entry in card.observation])
    statistics.var = np.array([entry.variance for entry in card.observation])
    statistics.count = max(float(card.steps), 1.0)


def _put(parameter: Any, values: Any) -> None:
    parameter.copy_(torch.as_tensor(np.ascontiguousarray(values), dtype=parameter.dtype))


def _check(policy: Policy, network: PolicyNetwork, wrapped: Around) -> None:
    """Raise `InputError` if the learner cannot begin with the policy."""
    card, family, theirs = policy.card, wrapped.family, policy.arguments()
    if network.shown is not None:
        raise InputError("a policy file has no statistics for a privileged critic: leave the critic or the start out")
    if wrapped.normalise is None:
        raise InputError("a policy brings the statistics of its observation: wrap the environment in VecNormalize")
    if card.residual != wrapped.residual:
        both = card.residual, wrapped.residual
        laws = [f"to {each.law} by {each.range_um_s:g} um/s" if each else "to no law" for each in both]
        raise InputError(f"the policy adds {laws[0]}, the training {laws[1]}: begin with the same residual")
    sees = [[entry.name for entry in each.entries()] for each in (theirs, family)]
    if sees[0] != sees[1] or meanings(theirs) != meanings(family):
        has, expected = (
            f"{len(each.entries())} entries and sets {', '.join(each.action_names)}" for each in (theirs, family)
        )
        raise InputError(f"the policy, of {card.env_id}, sees {has}; in the training a policy sees {expected}")
    shape = {name: getattr(card, name) for name in network.shape}
    if shape != network.shape:
        has, needed = shape_in_words(**network.shape), shape_in_words(**shape)
        raise InputError(f"the policy has {needed}; the learner has {has}: choose its algorithm and network so")
    for name in SCALES:
        here, there = getattr(family, name, None), getattr(theirs, name, None)
        if here != there:
            raise InputError(f"the policy learnt with {name} {there}, the training has {here}: give it the same")


ACTIVATIONS = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}
_AROUND = (
    VecMonitor, VecCheckNan, VecVideoRecorder, VecNormalize, CostVecEnv, TaughtVecEnv, PrivilegedVecEnv,
    ResidualVecEnv,
)  # fmt: skip
_AROUND_ONE = (
    monitor.Monitor, environment.RecordRerun, gym.RewardWrapper, gym.wrappers.OrderEnforcing,
    gym.wrappers.PassiveEnvChecker, gym.wrappers.TimeLimit, gym.wrappers.RecordEpisodeStatistics,
    gym.wrappers.RecordVideo, gym.wrappers.NormalizeReward,
)
"""Wrappers that do not change observations and actions, or whose change a policy's card describes."""


class PolicyNetwork(NamedTuple):
    """Part of a learner that turns an observation into an action."""

    layers: list[Any]
    activation: str  # between them
    lstm: Any  # before them
    output: str  # function that limits the last layer's outputs to -1..1
    shown: int | None  # number of entries that the actor observes; None for all

    @property
    def shape(self) -> dict[str, Any]:
        """Entries of a card that describe the network's shape."""
        widths, cells = [int(layer.out_features) for layer in self.layers[:-1]], self.lstm and self.lstm.hidden_size
        return {"widths": widths, "activation": self.activation, "lstm": cells, "output": self.output}


def shape_in_words(widths: list[int], activation: str, lstm: int | None, output: str) -> str:
    """Return a network's shape, for a message."""
    before = f"an LSTM of {lstm} cells and " if lstm else ""
    return f"{before}hidden layers {widths} with {activation}, output by {output}"


def network_of(model: Any) -> PolicyNetwork:
    """Return a learner's network; raise `InputError` if a policy file cannot store it."""
    policy, what = model.policy, type(model).__name__
    if not isinstance(model.action_space, gym.spaces.Box):
        raise InputError(f"{what} chooses among {model.action_space}: a policy file holds continuous actions")
    actor = getattr(policy, "actor", None)
    if isinstance(policy, policies.ActorCriticPolicy):
        features = policy.pi_features_extractor
        layers = [*policy.mlp_extractor.policy_net, policy.action_net]
        output = "tanh" if policy.squash_output else "clip"
    elif actor is not None and hasattr(actor, "mu"):
        features, output = actor.features_extractor, "tanh"
        layers = [*_flat(getattr(actor, "latent_pi", ())), *_flat(actor.mu)]
        if not hasattr(actor, "latent_pi"):
            layers.pop()  # TD3's and DDPG's tanh
    else:
        raise InputError(f"{what} has no actor with a mean: use PPO, SAC, TQC, recurrent PPO, A2C or TD3")
    if type(features) not in (torch_layers.FlattenExtractor, VisibleEntries):
        raise InputError(f"{what} uses the observations that {type(features).__name__} returns: use MlpPolicy")
    shown = int(features.shown.sum()) if isinstance(features, VisibleEntries) else None
    return PolicyNetwork(layers[::2], _activation(layers, what), _lstm(policy, what), output, shown)


def _flat(layers: Any) -> list[Any]:
    return [layers] if isinstance(layers, torch.nn.Linear) else list(layers)


def _activation(layers: list[Any], what: str) -> str:
    """Return the activation between layers; raise `InputError` unless they are linear with equal activations."""
    between = {type(layer) for layer in layers[1::2]} or {torch.nn.Tanh}
    names = [name for name, kind in ACTIVATIONS.items() if between == {kind}]
    whole = [*layers[::2], layers[-1]]
    wrong = next((layer for layer in whole if type(layer) is not torch.nn.Linear or layer.bias is None), None)
    if wrong is not None or not names:
        named = type(wrong).__name__ if wrong is not None else ", ".join(sorted(kind.__name__ for kind in between))
        raise InputError(f"{what}'s network has {named}: a policy file holds linear layers with Tanh or ReLU between")
    return names[0]


def _lstm(policy: Any, what: str) -> Any:
    lstm = getattr(policy, "lstm_actor", None)
    if lstm is None:
        return None
    if lstm.num_layers != 1 or lstm.bidirectional or lstm.proj_size or not lstm.bias:
        raise InputError(f"{what}'s {lstm} is more than a policy file holds: one layer, forward, with its bias")
    return lstm


class Around(NamedTuple):
    """Arguments, normalisation and residual of a learner's sub-environments."""

    family: EnvArguments  # their arguments
    normalise: VecNormalize | None
    residual: Residual | None  # the law that actions are added to

    def environment(self) -> tuple[str, dict[str, Any]]:
        """Return id and arguments of the environment of edmsim that a card names."""
        own = {f.name: arguments.plain(getattr(self.family, f.name)) for f in fields(self.family)}  # type: ignore[arg-type]
        env_id, found = registry.stand_in(type(self.family), own)
        usual = registry.arguments_with(env_id)
        return env_id, {n: value for n, value in found.items() if arguments.plain(getattr(usual, n)) != value}


def around(vec_env: Any) -> Around:
    """Check a learner's environment; raise `InputError` if a wrapper may change observations or actions."""
    normalise = residual = None
    while isinstance(vec_env, VecEnvWrapper):
        if not isinstance(vec_env, _AROUND):
            raise _unknown(vec_env)
        if isinstance(vec_env, VecNormalize) and vec_env.norm_obs:
            if normalise is not None:
                raise InputError("the environment is normalised twice: a policy file holds one VecNormalize")
            normalise = vec_env
        if isinstance(vec_env, ResidualVecEnv):
            residual = vec_env.residual
        vec_env = vec_env.venv
    if isinstance(vec_env, EdmVecEnv):
        return Around(vec_env.env.family, normalise, residual)
    env = vec_env.envs[0] if isinstance(vec_env, DummyVecEnv) else vec_env
    while isinstance(env, gym.Wrapper):
        if not isinstance(env, _AROUND_ONE):
            raise _unknown(env)
        env = env.env
    if not isinstance(env, environment.EdmEnv):
        raise InputError(
            f"{type(env).__name__} is not an environment of edmsim, or in other processes: give one of "
            "make_sb3_vec_env with the same arguments"
        )
    return Around(env.family, normalise, residual)


def _unknown(wrapper: Any) -> InputError:
    return InputError(
        f"{type(wrapper).__name__} around the environment may change observations or actions, which a policy file "
        "cannot describe: leave it out; to normalise, use VecNormalize"
    )
