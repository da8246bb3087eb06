"""Environments by name, edmsim's and those users register; none of them is loaded before it is asked for."""

from __future__ import annotations

from dataclasses import fields
from importlib import import_module
from typing import TYPE_CHECKING, Any

from gymnasium.envs.registration import register as _register
from gymnasium.envs.registration import registry

from edmsim import user_code
from edmsim.errors import InputError

if TYPE_CHECKING:
    from edmsim.envs.task import Family

EPISODE_STEPS = {"GapFeed": 1000, "HeightStep": 1000, "Corner": 3000, "Contour": 20_000}
"""Windows after which an episode is truncated: 25 s of machine time, where time is to end it; else about twice what a
cut takes at the reference rate (ours)."""
_FILES = {"GapFeed": "gap_feed", "HeightStep": "height_step", "Corner": "corner", "Contour": "contour"}
_GENERAL = "edmsim.envs.single:EdmEnv", "edmsim.envs.vector:EdmVectorEnv"
_OWN: dict[str, type[Family]] = {}  # users' families, by the ids they are registered under


def register_all() -> None:
    """Register ``edmsim/GapFeed-v0`` and the others."""
    for name, steps in EPISODE_STEPS.items():
        _register_classes(env_id_of(name), _classes_of(name), steps, {})


def register(env_id: str, family: type[Family], *, max_episode_steps: int | None = None, **arguments: Any) -> None:
    """Register an own environment, single and vector, with Gymnasium.

    Parameters
    ----------
    env_id : str
        ``"lab/Bend-v0"``; what is there under this id is replaced.
    family : type
        `GapFeed`, `HeightStep`, `Corner` or `Contour`, or a subclass of one.
    max_episode_steps : int, optional
        Windows after which an episode is truncated; those of the family it derives from if not given.
    **arguments
        Arguments of the family that differ from its own.

    Raises
    ------
    InputError
        The family derives from none of edmsim, or an argument cannot be used.
    TypeError
        An unknown argument.
    """
    base = base_of(family)
    family.of(**arguments)
    steps = EPISODE_STEPS[base] if max_episode_steps is None else max_episode_steps
    registry.pop(env_id, None)
    if family is family_of(base):
        _register_classes(env_id, _classes_of(base), steps, {**arguments, "task": base})
    else:
        _OWN[env_id] = family
        _register_classes(env_id, _GENERAL, steps, {**arguments, "task": env_id})


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


def family_of(name: str) -> type[Family]:
    """Return the family of an environment of edmsim, by its short name."""
    found: type[Family] = getattr(import_module(f"edmsim.envs.{_FILES[name]}"), name)
    return found


def find(name: str | type[Family]) -> tuple[type[Family], dict[str, Any]]:
    """Return a family and the arguments it was registered with.

    Parameters
    ----------
    name : str or type
        ``"GapFeed"``; the id of an environment, of edmsim or registered by a user; or a family itself.

    Raises
    ------
    InputError
        There is none.
    """
    if isinstance(name, type):
        return name, {}
    short = str(name).removeprefix("edmsim/").removesuffix("-v0")
    if short in _FILES:
        return family_of(short), {}
    spec = registry.get(str(name))
    if spec is None or "task" not in spec.kwargs:
        raise InputError(f"there is no environment {name!r}; choose one of {', '.join(map(env_id_of, _FILES))}")
    arguments = dict(spec.kwargs)
    task = arguments.pop("task")
    family, more = (_OWN[task], {}) if task in _OWN else find(task)
    return family, {**more, **arguments}


def make_family(name: str | type[Family], **options: Any) -> Family:
    """Return a family with the given arguments, which come before those it was registered with.

    Parameters
    ----------
    name : str or type
        See `find`.
    **options
        See `Family.of`.

    Raises
    ------
    InputError
        An unknown name, or a value that cannot be used.
    TypeError
        An unknown argument.
    """
    family, arguments = find(name)
    return family.of(**{**arguments, **options})


def base_of(family: type[Family]) -> str:
    """Return the name of the family of edmsim that another derives from: its own, if it is one of them.

    Raises
    ------
    InputError
        It derives from none.
    """
    names = {family_of(name): name for name in _FILES}
    base = next((names[kind] for kind in family.__mro__ if kind in names), None)
    if base is None:
        raise InputError(f"the family {family.__name__} must derive from one of {', '.join(_FILES)}")
    return base


def stand_in(family: type[Family], arguments: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """Return the id and arguments of the environment of edmsim with the same observations and actions as a family.

    A policy trained in a user's environment is described by it, so that the policy can be used without the user's
    file. Arguments are kept as far as that environment knows them; weights and machine have no effect on a policy.

    Raises
    ------
    InputError
        The family has other observations or actions than the one of edmsim it derives from.
    """
    base = base_of(family)
    known = family_of(base)
    if (family.knows_corners, family.action_names) != (known.knows_corners, known.action_names):
        raise InputError(
            f"the family {family.__name__} has other observations or actions than {base}, from which it derives: no "
            "policy file can describe them; train in it with a learner of your own (edmsim.envs.make_sb3_vec_env)"
        )
    names = {field.name for field in fields(known)} - {"weights", "machine"}
    return env_id_of(base), {name: value for name, value in arguments.items() if name in names}


def env_id_of(name: str) -> str:
    """Return the whole id of an environment: ``"edmsim/GapFeed-v0"`` of ``"GapFeed"``."""
    return f"edmsim/{name}-v0" if name in _FILES else name


def episode_steps(name: str | type[Family]) -> int:
    """Return after how many windows an episode is truncated; edmsim's number where a registration has none."""
    spec = registry.get(env_id_of(name)) if isinstance(name, str) else None
    steps = None if spec is None else spec.max_episode_steps
    return EPISODE_STEPS[base_of(find(name)[0])] if steps is None else steps


def _classes_of(name: str) -> tuple[str, str]:
    """Return where the single and the vector class of an environment of edmsim are."""
    place = f"edmsim.envs.{_FILES[name]}:{name}"
    return f"{place}Env", f"{place}VectorEnv"


def _register_classes(env_id: str, classes: tuple[str, str], steps: int, kwargs: dict[str, Any]) -> None:
    _register(
        id=env_id, entry_point=classes[0], vector_entry_point=classes[1], max_episode_steps=steps, kwargs=kwargs
    )
