"""From a policy of stable-baselines3 to plain arrays and a card (extra ``rl``)."""

from __future__ import annotations

import platform
from dataclasses import fields
from importlib.metadata import version
from typing import Any

import numpy as np
import torch

from edmsim.envs.families import base_of, env_id_of, find, make_family
from edmsim.envs.observation import entries
from edmsim.learning.policy_file import ACTION_MEANINGS, FORMAT, Card, digest, pack
from edmsim.learning.train import Trained

PACKAGES = ("edmsim", "stable-baselines3", "torch", "gymnasium", "numpy")


def export(trained: Trained, command: str) -> tuple[Card, bytes]:
    """Return a trained policy as `policy_file.write` wants it.

    Parameters
    ----------
    trained : Trained
        Of `train.train`.
    command : str
        What made it.
    """
    model, normalise, run = trained.model, trained.normalise, trained.run
    if run.algo == "ppo":
        layers = [*model.policy.mlp_extractor.policy_net, model.policy.action_net]
        output = "clip"
    else:
        layers = [*model.actor.latent_pi, model.actor.mu]
        output = "tanh"
    linear = [layer for layer in layers if isinstance(layer, torch.nn.Linear)]
    weights = [_array(layer.weight).T for layer in linear]
    packed = pack(weights, [_array(layer.bias) for layer in linear])
    env_id, environment = _environment(trained)
    family = make_family(env_id, **environment)
    statistics = normalise.obs_rms
    observation = [
        {"name": entry.name, "meaning": entry.meaning, "mean": float(mean), "variance": float(variance)}
        for entry, mean, variance in zip(
            entries(family.history, family.knows_corners), statistics.mean, statistics.var, strict=True
        )
    ]
    card = Card.model_validate({
        "format": FORMAT, "env_id": env_id, "environment": environment, "observation": observation,
        "epsilon": normalise.epsilon, "clip": normalise.clip_obs,
        "action": list(ACTION_MEANINGS[: linear[-1].out_features]),
        "widths": [layer.out_features for layer in linear[:-1]],
        "activation": trained.hyperparameters.network.activation, "output": output,
        "arrays_sha256": digest(packed), "algorithm": run.algo, "command": command, "seed": run.seed,
        "steps": int(model.num_timesteps),
        "versions": {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}},
    })
    return card, packed


def _environment(trained: Trained) -> tuple[str, dict[str, Any]]:
    """Return the environment a policy is told to be of, with its arguments.

    Of a user's family that is the one of ours it derives from: it has the same observations and actions, and can be
    made wherever the policy is used. Its arguments are kept as far as that one knows them; weights do not matter to a
    cut.
    """
    given = dict(trained.hyperparameters.environment)
    family, registered = find(trained.run.env_id)
    base = base_of(family)
    if base == family.__name__ and not registered:
        return trained.run.env_id, given
    known = {field.name for field in fields(find(base)[0])} - {"weights", "machine"}
    return env_id_of(base), {name: value for name, value in {**registered, **given}.items() if name in known}


def _array(tensor: Any) -> Any:
    return tensor.detach().cpu().numpy().astype(np.float64)
