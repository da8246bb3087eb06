"""Drives of the machine's axes, by name: what turns a planner's step edges into motion.

``edmsim.Plant(machine, drives={"x": axis.make("servo")})`` puts a drive on an axis; an axis that is not named has a
stepper. A drive of one's own is an object with what `edmsim.controllers.axis.drive.Drive` lists; `check_drive` tells
whether it can be used.
"""

from __future__ import annotations

from edmsim.controllers.axis.conformance import check_drive
from edmsim.controllers.axis.drive import Drive
from edmsim.controllers.axis.servo import PositionServo
from edmsim.controllers.axis.servo_module import ServoModule
from edmsim.controllers.axis.stepper import Stepper
from edmsim.controllers.axis.uhu import Uhu
from edmsim.errors import InputError

__all__ = ["Drive", "ServoModule", "Uhu", "check_drive", "make", "names"]

_DRIVES: dict[str, type[Drive]] = {kind.name: kind for kind in (Stepper, PositionServo, ServoModule, Uhu)}


def names() -> tuple[str, ...]:
    """Names of the drives."""
    return tuple(_DRIVES)


def make(name: str) -> Drive:
    """Make a drive.

    Parameters
    ----------
    name : str
        One of `names`.

    Raises
    ------
    InputError
        If there is no such drive.

    Examples
    --------
    >>> make("stepper").sample is None
    True
    """
    if name not in _DRIVES:
        raise InputError(f"there is no drive {name!r}; choose one of {', '.join(names())}")
    return _DRIVES[name]()
