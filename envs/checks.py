"""What the environments refuse, in Gymnasium's own errors where it has one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.error import InvalidAction
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.machine.machine import Machine


def checked_actions(actions: Any, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return actions as an array of their space's shape, all numbers; beyond -1..1 they are clipped later."""
    try:
        array = np.asarray(actions, np.float32)
    except (TypeError, ValueError):
        raise InvalidAction(f"an action is numbers of shape {shape}, not {actions!r}") from None
    if array.shape != shape:
        raise InvalidAction(f"an action has the shape {shape}, not {array.shape}")
    if not np.isfinite(array).all():
        raise InvalidAction(f"an action is finite numbers from -1 to 1, not {array.tolist()}")
    return array


def checked_options(options: Mapping[str, Any] | None, known: tuple[str, ...]) -> dict[str, Any]:
    """Return the options of a reset, all of them known."""
    found = dict(options or {})
    for name in found:
        if name not in known:
            raise InputError(f"reset has no option {name!r}; it has {', '.join(known)}")
    machine = found.get("machine")
    if machine is not None and not isinstance(machine, Machine):
        raise InputError(f"the option machine is {machine!r}: give an edmsim.Machine")
    return found
