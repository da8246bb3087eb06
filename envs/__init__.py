"""Gymnasium environments: cuts to be controlled window by window, alone or many at once.

``import edmsim`` registers ``edmsim/GapFeed-v2``, ``edmsim/HeightStep-v2``, ``edmsim/Corner-v3``,
``edmsim/Contour-v2``, ``edmsim/MaxRate-v1``, ``edmsim/ThinWire-v1``, ``edmsim/Trim-v1``, ``edmsim/MaxRateShift-v0``,
``edmsim/ThinWireShift-v0`` and ``edmsim/Part-v0``, whose actions decide on passes; the environment class of each
describes action, observation and reward.
"""

from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from edmsim.envs.environment import EdmEnv, EdmVectorEnv, RecordRerun
    from edmsim.envs.episode import StepResult, Task
    from edmsim.envs.families import (
        Contour,
        Corner,
        GapFeed,
        HeightStep,
        MaxRate,
        MaxRateShift,
        ThinWire,
        ThinWireShift,
        Trim,
    )
    from edmsim.envs.observation import Sensors
    from edmsim.envs.part_task import Part, PartWeights
    from edmsim.envs.registry import register
    from edmsim.envs.reward import Weights
    from edmsim.envs.sb3 import RecordEpisodes, make_sb3_vec_env
    from edmsim.envs.task import Family, Scenario

_HOMES = {
    "Contour": "families", "Corner": "families", "EdmEnv": "environment", "EdmVectorEnv": "environment",
    "Family": "task", "GapFeed": "families", "HeightStep": "families", "MaxRate": "families",
    "MaxRateShift": "families", "Part": "part_task", "PartWeights": "part_task", "RecordEpisodes": "sb3",
    "RecordRerun": "environment", "Scenario": "task", "Sensors": "observation", "StepResult": "episode",
    "Task": "episode", "ThinWire": "families", "ThinWireShift": "families", "Trim": "families", "Weights": "reward",
    "make_sb3_vec_env": "sb3", "register": "registry",
}  # fmt: skip
__all__ = [
    "Contour", "Corner", "EdmEnv", "EdmVectorEnv", "Family", "GapFeed", "HeightStep", "MaxRate", "MaxRateShift",
    "Part", "PartWeights", "RecordEpisodes", "RecordRerun", "Scenario", "Sensors", "StepResult", "Task", "ThinWire",
    "ThinWireShift", "Trim", "Weights", "make_sb3_vec_env", "register",
]


def __getattr__(name: str) -> Any:
    """Import a public name at its first use, because registering the environments needs none of them."""
    task, is_vector, _ = name.partition("VectorEnv")
    if is_vector and task in _HOMES:  # the vector entry point of a registered id
        return partial(__getattr__("EdmVectorEnv"), task)
    if name not in _HOMES:
        raise AttributeError(f"module 'edmsim.envs' has no attribute '{name}'")
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value
