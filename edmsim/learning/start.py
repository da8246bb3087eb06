"""Learning on from a policy file, whose network and normalisation a learner takes (extra ``rl``)."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from edmsim.errors import InputError
from edmsim.learning.policy_file import Policy, load, meanings
from edmsim.learning.sb3_parts import Around, PolicyNetwork, around, network_of, shape_in_words

SCALES = (
    "max_feed_um_s", "max_change_um_s", "setting_octaves", "offset_um", "servo_target_share", "set_point_octaves",
    "pause_octaves", "on_time_octaves",
)  # fmt: skip
"""Arguments of an environment that say how much an action of 1 is."""


def start_sb3(model: Any, vec_env: Any, policy: str | Policy) -> None:
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
    policy_file = load(policy.removeprefix("policy:")) if isinstance(policy, str) else policy
    network, wrapped = network_of(model), around(vec_env)
    _check(policy_file, network, wrapped)
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
    """Refuse a policy that the learner cannot begin with."""
    card, family, theirs = policy.card, wrapped.family, policy.family()
    if card.hold is not None:
        raise InputError(f"the policy says what flux '{card.hold.law}' holds; no environment has that action")
    if network.shown is not None:
        raise InputError("a policy file has no statistics of what only a privileged critic sees: start without one")
    if wrapped.normalise is None:
        raise InputError("a policy brings the statistics of its observation: wrap the environment in VecNormalize")
    if card.residual != wrapped.residual:
        both = card.residual, wrapped.residual
        laws = [f"to {each.law} by {each.range_um_s:g} um/s" if each else "to no law" for each in both]
        raise InputError(f"the policy adds {laws[0]}, the training {laws[1]}: begin with the same residual")
    shape, own = shape_in_words(card.widths, card.activation, card.lstm, card.output), network.words()
    if shape != own:
        raise InputError(f"the policy has {shape}; the learner has {own}: choose its algorithm and network so")
    sees = [[entry.name for entry in each.entries()] for each in (theirs, family)]
    if sees[0] != sees[1] or meanings(theirs) != meanings(family):
        raise InputError(f"the policy, of {card.env_id}, sees or does something else than the training's environment")
    for name in SCALES:
        here, there = getattr(family, name, None), getattr(theirs, name, None)
        if here != there:
            raise InputError(f"the policy learnt with {name} {there}, the training has {here}: give it the same")
