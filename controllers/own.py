"""Feed controllers of a user's own: from a Python file, or as an object."""

from __future__ import annotations

import inspect
from dataclasses import fields, is_dataclass
from typing import cast

from edmsim.controllers.protocols import FeedController
from edmsim.errors import InputError
from edmsim.numeric import real
from edmsim.user_code import UserObject, run

NEEDED = ("name", "reset", "update", "snapshot", "restore")  # what a feed controller must offer


def from_file(own: UserObject, parameters: dict[str, float]) -> FeedController:
    """Make a controller of a class in a user's file."""
    kinds = {
        name: kind for name, kind in vars(run(own.file)).items()
        if inspect.isclass(kind) and not lacking(kind) and not inspect.isabstract(kind)
    }  # fmt: skip
    if own.name not in kinds:
        raise InputError(_why_not(own, sorted(kinds)), own.file)
    kind = kinds[own.name]
    known = list(inspect.signature(kind).parameters)
    for parameter in parameters:
        if parameter not in known:
            has = f"it has {', '.join(known)}" if known else "it has none"
            raise InputError(f"{own.name} has no parameter {parameter!r}; {has}", own.file)
    try:
        return cast(FeedController, kind(**parameters))
    except TypeError as error:
        raise InputError(f"{own.name} cannot be made: {error}", own.file) from None


def check_is_controller(candidate: object) -> FeedController:
    """Return what was given if it can be a feed controller; `InputError` for a class, or what lacks something."""
    if inspect.isclass(candidate):
        raise InputError(f"{candidate.__name__} is a class: give an object of it, {candidate.__name__}()")
    missing = lacking(candidate)
    if missing:
        raise InputError(f"{candidate!r} is not a feed controller: it has no {', '.join(missing)}")
    return cast(FeedController, candidate)


def lacking(candidate: object) -> list[str]:
    """Return what an object or class lacks to be a feed controller."""
    return [name for name in NEEDED if not hasattr(candidate, name)]


def text_of(controller: FeedController) -> str:
    """Return a controller's name with its numbers, as the command line would have it."""
    if not is_dataclass(controller):
        return controller.name
    values = [(field.name, getattr(controller, field.name)) for field in fields(controller) if field.init]
    numbers = [f"{name}={real(value)!r}" for name, value in values if real(value) is not None]
    return f"{controller.name}:{','.join(numbers)}" if numbers else controller.name


def _why_not(own: UserObject, kinds: list[str]) -> str:
    there = f"there are: {', '.join(kinds)}" if kinds else "the file has no class"
    if not own.name:
        return f"name the feed controller in this file, {own.file}:CLASS; {there}"
    found = vars(run(own.file)).get(own.name)
    if inspect.isclass(found):
        missing = lacking(found) or sorted(getattr(found, "__abstractmethods__", ()))
        return f"{own.name} is not a feed controller: it has no {', '.join(missing)}"
    return f"this file has no feed controller {own.name!r}; {there}"
