"""Everything that commands the machine; feed controllers by name.

A controller knows the process only through what a machine would let it see: counts, mean voltage, current and
ignition delay, and the position counters.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any, cast

from edmsim.controllers.feed.base import FeedCommand, FeedController, WindowObservation
from edmsim.controllers.feed.counts import CountsController
from edmsim.controllers.feed.fixed import FixedController
from edmsim.errors import InputError

__all__ = ["FeedCommand", "FeedController", "WindowObservation", "make", "names"]

_CONTROLLERS: dict[str, type[CountsController] | type[FixedController]] = {
    kind.name: kind for kind in (CountsController, FixedController)
}


def names() -> tuple[str, ...]:
    """Names of the feed controllers."""
    return tuple(_CONTROLLERS)


def make(name: str, **parameters: float) -> FeedController:
    """Make a feed controller.

    Parameters
    ----------
    name : str
        One of `names`.
    **parameters : float
        Its constants by name; those left out keep their defaults.

    Raises
    ------
    InputError
        If there is no such controller, it has no such parameter, or the value cannot be used.

    Examples
    --------
    >>> make("fixed", feed_um_s=20.0).name
    'fixed'
    """
    if name not in _CONTROLLERS:
        raise InputError(f"there is no feed controller {name!r}; choose one of {', '.join(names())}")
    kind = _CONTROLLERS[name]
    known = [field.name for field in fields(kind) if field.init]
    for parameter in parameters:
        if parameter not in known:
            raise InputError(
                f"the {name} controller has no parameter {parameter!r}; it has {', '.join(known)}"
            )
    return kind(**cast(dict[str, Any], parameters))
