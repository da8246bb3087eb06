"""Families by name: ours, and what users registered."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import gymnasium as gym

from edmsim.envs.registration import EPISODE_STEPS
from edmsim.envs.scenarios import Contour, Corner, Family, GapFeed, HeightStep
from edmsim.errors import InputError

FAMILIES: dict[str, type[Family]] = {
    "GapFeed": GapFeed, "HeightStep": HeightStep, "Corner": Corner, "Contour": Contour,
}
"""Ours, by the names of their environments."""


def find(name: str | type[Family]) -> tuple[type[Family], dict[str, Any]]:
    """Return a family and the arguments it was registered with.

    Parameters
    ----------
    name : str or type
        ``"GapFeed"``; the id of an environment, ours or registered by a user; or a family itself.

    Raises
    ------
    InputError
        There is none.
    """
    if isinstance(name, type) and issubclass(name, Family):
        return name, {}
    short = str(name).removeprefix("edmsim/").removesuffix("-v0")
    if short in FAMILIES:
        return FAMILIES[short], {}
    spec = gym.registry.get(str(name))
    if spec is None or "task" not in spec.kwargs:
        raise InputError(f"there is no environment {name!r}; choose one of {', '.join(map(env_id_of, FAMILIES))}")
    arguments = dict(spec.kwargs)
    family, more = find(arguments.pop("task"))
    return family, {**more, **arguments}


def make_family(name: str | type[Family], **options: Any) -> Family:
    """Return a family with the given arguments, which come before those it was registered with.

    Parameters
    ----------
    name : str or type
        See `find`.
    **options
        Its fields.

    Raises
    ------
    InputError
        An unknown name, or a value that cannot be used.
    TypeError
        An unknown argument.
    """
    family, arguments = find(name)
    known = [f.name for f in fields(family)]
    for option in options:
        if option not in known:
            raise TypeError(f"{family.__name__} has no argument {option!r}; it has {', '.join(known)}")
    return family(**{**arguments, **options})


def base_of(family: type[Family]) -> str:
    """Return the name of the family of ours that another derives from: its own, if it is ours.

    Raises
    ------
    InputError
        It derives from none of ours, or has other observations or actions than that one.
    """
    ours: dict[type, type[Family]] = {kind: kind for kind in FAMILIES.values()}
    base = next((ours[kind] for kind in family.__mro__ if kind in ours), None)
    if base is None:
        raise InputError(f"the family {family.__name__} must derive from one of {', '.join(FAMILIES)}")
    if (family.knows_corners, family.sets_generator) != (base.knows_corners, base.sets_generator):
        raise InputError(
            f"the family {family.__name__} has other observations or actions than {base.__name__}, from which it "
            "derives: leave knows_corners and sets_generator as they are, or derive it from another"
        )
    return base.__name__


def env_id_of(name: str) -> str:
    """Return the whole id of an environment: ``"edmsim/GapFeed-v0"`` of ``"GapFeed"``."""
    return f"edmsim/{name}-v0" if name in FAMILIES else name


def episode_steps(name: str | type[Family]) -> int:
    """Return after how many windows an episode is truncated; as that of ours, where a registration does not say."""
    spec = gym.registry.get(env_id_of(name)) if isinstance(name, str) else None
    told = None if spec is None else spec.max_episode_steps
    return EPISODE_STEPS[base_of(find(name)[0])] if told is None else told
