"""Gymnasium environments: cuts to be controlled window by window, alone or many at once.

``import edmsim`` registers ``edmsim/GapFeed-v0``, ``edmsim/HeightStep-v0``, ``edmsim/Corner-v0`` and
``edmsim/Contour-v0``; ``docs/environments.md`` describes every entry of action, observation and reward.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from edmsim.envs.discrete import DiscreteFeed, DiscreteFeedVector
    from edmsim.envs.registration import register
    from edmsim.envs.reward import Weights
    from edmsim.envs.sb3 import make_sb3_vec_env
    from edmsim.envs.single import EdmEnv
    from edmsim.envs.tasks import StepResult, Task
    from edmsim.envs.vector import EdmVectorEnv

_HOMES = {
    "DiscreteFeed": "discrete",
    "DiscreteFeedVector": "discrete",
    "EdmEnv": "single",
    "EdmVectorEnv": "vector",
    "StepResult": "tasks",
    "Task": "tasks",
    "Weights": "reward",
    "make_sb3_vec_env": "sb3",
    "register": "registration",
}
__all__ = [
    "DiscreteFeed", "DiscreteFeedVector", "EdmEnv", "EdmVectorEnv", "StepResult", "Task", "Weights",
    "make_sb3_vec_env", "register",
]


def __getattr__(name: str) -> Any:
    """Load a public name when it is first used: registering the environments loads none of them."""
    if name not in _HOMES:
        raise AttributeError(f"module 'edmsim.envs' has no attribute '{name}'")
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value
