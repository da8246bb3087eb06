"""A trained policy as who decides on the passes of a part."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edmsim.envs.part_task import Part
from edmsim.errors import InputError
from edmsim.learning.policy_file import Policy, load


class PassPolicy:
    """Decides as a policy trained in Part does; see `edmsim.envs.pass_laws.PassLaw`."""

    def __init__(self, policy: Policy) -> None:
        self.policy = policy
        self._memory = policy.fresh_memory()

    def begin(self) -> None:
        """Begin a part."""
        self._memory = self.policy.fresh_memory()

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return the policy's action for an observation."""
        action, self._memory = self.policy.act(observation, self._memory)
        return action


def from_name(name: str) -> PassPolicy:
    """Make it of a policy's file, or of a name under ``models/policies``."""
    policy = load(name)
    if not isinstance(policy.arguments(), Part):
        raise InputError(f"the policy {name} was trained in {policy.card.env_id}: it decides on windows, not passes")
    return PassPolicy(policy)
