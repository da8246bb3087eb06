"""Export of a policy of stable-baselines3 to plain arrays and a card (extra ``rl``)."""

from __future__ import annotations

import platform
import re
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from edmsim.envs.registry import arguments_with
from edmsim.errors import InputError
from edmsim.files import make_writable
from edmsim.learning.policy_file import FORMAT, Card, Lstm, Policy, digest, load, meanings, pack, write
from edmsim.learning.sb3_parts import PolicyNetwork, around, network_of

if TYPE_CHECKING:
    from edmsim.learning.train import Trained

PACKAGES = ("edmsim", "stable-baselines3", "sb3-contrib", "torch", "gymnasium", "numpy")


def export_sb3(model: Any, vec_env: Any, file: str | Path) -> Policy:
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
        raise InputError("name the policy's file NAME.json; its arrays come into NAME.npz beside it", target)
    algorithm = re.sub(r"(?<=[a-z])(?=[A-Z])", "-", type(model).__name__).lower()
    made = _exported(model, vec_env, algorithm, "edmsim.learning.export_sb3", model.seed)
    make_writable(target.parent)
    write(*made, target)
    return load(str(target))


def export(trained: Trained, command: str) -> tuple[Card, bytes]:
    """Return a trained policy as `policy_file.write` wants it; `command` is what made it."""
    return _exported(trained.model, trained.normalise, trained.run.algo, command, trained.run.seed)


def _exported(model: Any, vec_env: Any, algorithm: str, command: str, seed: int | None) -> tuple[Card, bytes]:
    network, wrapped = network_of(model), around(vec_env)
    env_id, environment = wrapped.environment()
    family = arguments_with(env_id, **environment)
    entries = family.entries()
    if vec_env.observation_space != model.observation_space or vec_env.action_space != model.action_space:
        raise InputError("the learner has other observations or actions than this environment: give its own")
    weights, biases, lstm = _arrays(network, len(entries))
    packed = pack(weights, biases, lstm)
    mean, variance, epsilon, clip = _normalisation(wrapped.normalise, len(entries))
    observation = [
        {"name": entry.name, "meaning": entry.meaning, "mean": m, "variance": v}
        for entry, m, v in zip(entries, mean, variance, strict=True)
    ]
    card = Card.model_validate({
        "format": FORMAT, "env_id": env_id, "environment": environment, "observation": observation,
        "epsilon": epsilon, "clip": clip, "action": meanings(family), "widths": network.widths,
        "lstm": network.lstm and network.lstm.hidden_size, "residual": wrapped.residual,
        "activation": network.activation, "output": network.output, "arrays_sha256": digest(packed),
        "algorithm": algorithm, "command": command, "seed": seed, "steps": int(model.num_timesteps),
        "versions": {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}},
    })
    return card, packed


def _arrays(network: PolicyNetwork, entry_count: int) -> tuple[list[Any], list[Any], Lstm | None]:
    """Return weights, biases and LSTM; what only the critic sees comes behind, and is left away."""
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
        lstm = Lstm(ih.T, hh.T, two[0] + two[1])  # torch's gates come in the order of ours
    if not all(np.isfinite(array).all() for array in [*weights, *biases, *(lstm or ())]):
        raise InputError("the learner's network holds numbers that are not finite: its training has diverged")
    return weights, biases, lstm


def _normalisation(normalise: Any, count: int) -> tuple[list[float], list[float], float, float]:
    """Return mean, variance, epsilon and clip of the observation; those that change nothing without normalisation."""
    if normalise is None:
        epsilon = float(np.finfo(np.float64).eps)
        return [0.0] * count, [1.0 - epsilon] * count, epsilon, float(np.finfo(np.float32).max)
    statistics = normalise.obs_rms
    return statistics.mean[:count].tolist(), statistics.var[:count].tolist(), normalise.epsilon, normalise.clip_obs


def _array(tensor: Any) -> Any:
    return tensor.detach().cpu().numpy().astype(np.float64)
