"""Registers the environments by name; nothing of them is loaded before one is made."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from gymnasium.envs.registration import register as _register
from gymnasium.envs.registration import registry

from edmsim import user_code
from edmsim.errors import InputError

if TYPE_CHECKING:
    from edmsim.envs.scenarios import Family

EPISODE_STEPS = {"GapFeed": 1000, "HeightStep": 1000, "Corner": 3000, "Contour": 20_000}
"""Windows after which an episode is truncated: 25 s of machine time, where time is to end it; else about twice what a
cut takes at the reference rate (ours)."""


def register_all() -> None:
    """Register ``edmsim/GapFeed-v0`` and the others."""
    for name, steps in EPISODE_STEPS.items():
        _register_task(f"edmsim/{name}-v0", steps, {"task": name})


def register(env_id: str, family: type[Family], *, max_episode_steps: int | None = None, **arguments: Any) -> None:
    """Register an own environment, single and vector, with Gymnasium.

    Parameters
    ----------
    env_id : str
        ``"lab/Bend-v0"``; what is there under this id is replaced.
    family : type
        One of `edmsim.envs.scenarios`, or a subclass of one.
    max_episode_steps : int, optional
        Windows after which an episode is truncated; those of the family it derives from if not given.
    **arguments
        Arguments of the family that differ from its own.

    Raises
    ------
    InputError
        It derives from no family of ours or has other observations or actions; or an argument cannot be used.
    TypeError
        An unknown argument.
    """
    from edmsim.envs.families import base_of, make_family

    make_family(family, **arguments)
    steps = EPISODE_STEPS[base_of(family)] if max_episode_steps is None else max_episode_steps
    registry.pop(env_id, None)
    _register_task(env_id, steps, {**arguments, "task": family})


def resolve(text: str) -> str:
    """Return the id of an environment named on the command line; ``FILE.py:ID`` runs the file that registers it.

    Raises
    ------
    InputError
        The file cannot be run, or registers no such environment of edmsim.
    """
    own = user_code.named(text)
    if own is None:
        return text
    user_code.run(own.file)
    spec = registry.get(own.name)
    if spec is None or "task" not in spec.kwargs:
        raise InputError(f"this file registers no environment {own.name!r} (edmsim.envs.register)", own.file)
    return own.name


def _register_task(env_id: str, steps: int, kwargs: dict[str, Any]) -> None:
    _register(
        id=env_id,
        entry_point="edmsim.envs.single:EdmEnv",
        vector_entry_point="edmsim.envs.vector:EdmVectorEnv",
        max_episode_steps=steps,
        kwargs=kwargs,
    )
