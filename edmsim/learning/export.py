"""From a policy of stable-baselines3 to plain arrays and a card (extra ``rl``)."""

from __future__ import annotations

import platform
from importlib.metadata import version
from typing import Any

import numpy as np
import torch

from edmsim.envs.batch import entries_of
from edmsim.envs.registry import find, make_family, stand_in
from edmsim.learning import learners
from edmsim.learning.hyperparameters import ON_POLICY
from edmsim.learning.policy_file import FORMAT, Card, Lstm, digest, meanings, pack
from edmsim.learning.train import Trained

PACKAGES = ("edmsim", "stable-baselines3", "sb3-contrib", "torch", "gymnasium", "numpy")


def export(trained: Trained, command: str) -> tuple[Card, bytes]:
    """Return a trained policy as `policy_file.write` wants it.

    Parameters
    ----------
    trained : Trained
        Of `train.train`.
    command : str
        What made it.
    """
    model, normalise, run, given = trained.model, trained.normalise, trained.run, trained.hyperparameters
    if run.algo in ON_POLICY:
        layers = [*model.policy.mlp_extractor.policy_net, model.policy.action_net]
        output = "clip"
    else:
        layers = [*model.actor.latent_pi, model.actor.mu]
        output = "tanh"
    linear = [layer for layer in layers if isinstance(layer, torch.nn.Linear)]
    weights = [_array(layer.weight).T for layer in linear]
    lstm = _lstm(model.policy.lstm_actor) if given.network.lstm else None
    env_id, environment = _environment(trained)
    family = make_family(env_id, **environment)
    seen, statistics = entries_of(family), normalise.obs_rms
    if lstm is None:
        weights[0] = weights[0][: len(seen)]  # what only the critic sees comes behind
    packed = pack(weights, [_array(layer.bias) for layer in linear], lstm)
    observation = [
        {"name": entry.name, "meaning": entry.meaning, "mean": float(mean), "variance": float(variance)}
        for entry, mean, variance in zip(seen, statistics.mean, statistics.var, strict=not given.privileged_critic)
    ]
    card = Card.model_validate({
        "format": FORMAT, "env_id": env_id, "environment": environment, "observation": observation,
        "epsilon": normalise.epsilon, "clip": normalise.clip_obs,
        "action": meanings(family),
        "widths": [layer.out_features for layer in linear[:-1]], "lstm": given.network.lstm,
        "residual": learners.residual_of(given), "activation": given.network.activation, "output": output,
        "arrays_sha256": digest(packed), "algorithm": run.algo, "command": command, "seed": run.seed,
        "steps": int(model.num_timesteps),
        "versions": {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}},
    })
    return card, packed


def _environment(trained: Trained) -> tuple[str, dict[str, Any]]:
    """Return the environment a policy's card names, with its arguments: one that exists wherever it is used."""
    family, registered = find(trained.run.env_id)
    return stand_in(family, {**registered, **trained.hyperparameters.environment})


def _lstm(layer: torch.nn.LSTM) -> Lstm:
    """Return an LSTM's weights; torch's gates come in the order of ours."""
    seen, kept, *biases = (_array(getattr(layer, f"{name}_l0")) for name in (
        "weight_ih", "weight_hh", "bias_ih", "bias_hh"
    ))
    return Lstm(seen.T, kept.T, biases[0] + biases[1])


def _array(tensor: Any) -> Any:
    return tensor.detach().cpu().numpy().astype(np.float64)
