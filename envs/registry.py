"""Environments by name, edmsim's and the user's; each is imported at its first use."""

from __future__ import annotations

from dataclasses import fields
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

import gymnasium as gym

from edmsim import user_code
from edmsim.errors import InputError, one_of, refuses_wrong_types

if TYPE_CHECKING:
    from edmsim.envs.task import EnvArguments, Family


class _Registered(NamedTuple):
    version: int  # returns of earlier versions cannot be compared with those of this one
    reference: float  # mean return of the reference over the held-back seeds (docs/benchmark.md): `reward_threshold`
    file: str = "families"  # module of this folder with its arguments and its class


_REGISTERED = {
    "GapFeed": _Registered(2, 1828.0), "HeightStep": _Registered(2, 1555.0), "Corner": _Registered(3, 950.0),
    "Contour": _Registered(2, 2424.0), "MaxRate": _Registered(1, 4210.0), "ThinWire": _Registered(1, 5960.0),
    "Trim": _Registered(1, 912.0), "Part": _Registered(0, -16.0, "part"),
    "MaxRateShift": _Registered(0, 276105.0), "ThinWireShift": _Registered(0, 62871.0),
}  # fmt: skip
_OWN: dict[str, type[EnvArguments]] = {}  # users' families, by the ids they are registered under


def register_all() -> None:
    """Register ``edmsim/GapFeed-v2`` and the others."""
    for name, one in _REGISTERED.items():
        gym.register(
            id=env_id_of(name), entry_point=_class_of(name), vector_entry_point=f"edmsim.envs:{name}VectorEnv",
            reward_threshold=one.reference,
        )


@refuses_wrong_types
def register(env_id: str, family: type[EnvArguments], **arguments: Any) -> None:
    """Register an own environment, single and vector, with Gymnasium.

    Parameters
    ----------
    env_id : str
        ``"lab/Bend-v0"``; an own environment with this id is replaced.
    family : type
        `GapFeed`, `HeightStep`, `Corner`, `Contour` or another of edmsim's, or a subclass of one.
    **arguments
        Arguments of the family that differ from its own.

    Raises
    ------
    InputError
        If another environment has the id, the family derives from none of edmsim's, or an argument is unknown or
        cannot be used.
    """
    short, there = env_id.removeprefix("edmsim/").partition("-v")[0], gym.registry.get(env_id)
    if short in _REGISTERED or (there is not None and "task" not in there.kwargs):
        raise InputError(f"{env_id} names an environment that is not your own: choose another, as 'lab/{short}-v0'")
    base = base_of(family)
    family.of(**arguments)
    gym.registry.pop(env_id, None)
    single, task = _class_of(base), base
    if family is not family_of(base):
        _OWN[env_id], single, task = family, "edmsim.envs.environment:EdmEnv", env_id
    vector = "edmsim.envs.environment:EdmVectorEnv"
    gym.register(id=env_id, entry_point=single, vector_entry_point=vector, kwargs={**arguments, "task": task})


def resolve(text: str) -> str:
    """Return the id of an environment named on the command line; ``FILE.py:ID`` runs the file that registers it."""
    own = user_code.named(text)
    if own is None:
        return text
    module = user_code.run(own.file)
    spec = gym.registry.get(own.name)
    if spec is None or "task" not in spec.kwargs:
        registered = ", ".join(name for name, family in _OWN.items() if family.__module__ == module.__name__)
        others = f": write {own.file}:ID with one of {registered}" if registered else " (edmsim.envs.register)"
        raise InputError(f"this file registers no environment {own.name!r}{others}", own.file)
    if family := _OWN.get(own.name):
        theirs = [name for kind in family.__mro__ if kind.__module__ == module.__name__ for name in vars(kind)]
        _OWN[own.name] = user_code.naming_failures(family, own.file, ("draw", *theirs))
    return own.name


def family_of(name: str) -> type[EnvArguments]:
    """Return the arguments of an environment of edmsim, by its short name."""
    found: type[EnvArguments] = getattr(import_module(f"edmsim.envs.{_REGISTERED[name].file}"), name)
    return found


def find(name: str | type[EnvArguments]) -> tuple[type[EnvArguments], dict[str, Any]]:
    """Return the class of an environment's arguments, by name, id or class, and those it was registered with."""
    if isinstance(name, type):
        from edmsim.envs.task import EnvArguments

        if not issubclass(name, EnvArguments):
            raise InputError(f"the family {name.__name__} must derive from one of {', '.join(_REGISTERED)}")
        return name, {}
    short, _, version = str(name).removeprefix("edmsim/").partition("-v")
    if short in _REGISTERED and version in ("", str(_REGISTERED[short].version)):
        return family_of(short), {}
    spec = gym.registry.get(str(name))
    if spec is None or "task" not in spec.kwargs:
        raise InputError(f"there is no environment {name!r}; choose one of {one_of(str(name), registered_ids())}")
    arguments = dict(spec.kwargs)
    task = arguments.pop("task")
    family, more = (_OWN[task], {}) if task in _OWN else find(task)
    return family, {**more, **arguments}


def arguments_with(name: str | type[EnvArguments], **options: Any) -> EnvArguments:
    """Return the arguments of an environment (see `find`); `options` override those it was registered with."""
    family, arguments = find(name)
    return family.of(**{**arguments, **options})


def of_policy(env_id: str, environment: dict[str, Any]) -> EnvArguments:
    """Return the arguments of a policy's environment, with defaults for all but its `policy_arguments`.

    The others may need the machine, which the policy's file does not have, or a file that is missing.
    """
    family, _ = find(env_id)
    known = {field.name for field in fields(family)}  # type: ignore[arg-type]
    unused = known.difference(family.policy_arguments)
    return arguments_with(env_id, **{name: value for name, value in environment.items() if name not in unused})


def make_family(name: str | type[EnvArguments], **options: Any) -> Family:
    """Return `arguments_with`; raises `InputError` for Part, which is not decided on window by window."""
    return of_windows(name, arguments_with(name, **options))


def of_windows(name: str | type[EnvArguments], made: EnvArguments) -> Family:
    """Return an environment's arguments; raises `InputError` for those of Part."""
    from edmsim.envs.task import Family

    if not isinstance(made, Family):
        raise InputError(f"{name} is decided on pass by pass: no feed controller or study of windows fits it")
    return made


def base_of(family: type[EnvArguments]) -> str:
    """Return the name of the family of edmsim that another derives from: its own, if it is one of them."""
    names = {family_of(name): name for name in _REGISTERED}
    base = next((names[kind] for kind in family.__mro__ if kind in names), None)
    if base is None:
        raise InputError(f"the family {family.__name__} must derive from one of {', '.join(_REGISTERED)}")
    return base


def stand_in(family: type[EnvArguments], arguments: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """Return the environment of edmsim, and arguments, with the same observations and actions as a family.

    The file of a policy that was trained in a user's environment names this one, so the policy can be used without
    the user's file. Arguments unknown to it are left out, as are weights and machine, which do not affect a policy.
    """
    base = base_of(family)
    known = family_of(base)
    names = {field.name for field in fields(known)} - {"weights", "machine"}  # type: ignore[arg-type]
    own_arguments = {name: value for name, value in arguments.items() if name in names}
    if "knobs" in names and tuple(family.knobs) != known.knobs:  # type: ignore[attr-defined]
        own_arguments.setdefault("knobs", family.knobs)  # type: ignore[attr-defined]
    meaning = (
        "knows_corners", "knows_wires", "locates_discharges", "counts_threading", "step_entries", "known_entries",
        "entries", "action_names", "first_feed_um_s", "next_feed_um_s", "setting_us", "to_detents",
        "least_setting_us",
    )  # fmt: skip
    if any(getattr(family, name, None) != getattr(known, name, None) for name in meaning):
        raise InputError(
            f"the family {family.__name__} has other observations or actions than {base}, from which it derives: no "
            "policy file can describe them; train in it with a learner of your own (edmsim.envs.make_sb3_vec_env)"
        )
    return env_id_of(base), own_arguments


def registered_ids() -> tuple[str, ...]:
    """Return the ids of edmsim's own environments."""
    return tuple(map(env_id_of, _REGISTERED))


def env_id_of(name: str) -> str:
    """Return the whole id of an environment: ``"edmsim/GapFeed-v2"`` for ``"GapFeed"``."""
    return f"edmsim/{name}-v{_REGISTERED[name].version}" if name in _REGISTERED else name


def _class_of(name: str) -> str:
    """Return the entry point of a single environment of edmsim."""
    return f"edmsim.envs.{_REGISTERED[name].file}:{name}Env"
