"""Drives of the machine's axes, by name. A drive turns a planner's step edges into motion.

``edmsim.Plant(machine, drives={"x": axis.make("servo")})`` puts a drive on an axis; an axis without an entry has a
stepper. Your own drive is an object with the members of `edmsim.controllers.axis.drive.Drive`; test it with
`check_drive`.
"""

from collections.abc import Mapping
from types import MappingProxyType

from edmsim.controllers.axis.drive import Drive, PositionServo, Screw, Stepper, axis_row, check_drive
from edmsim.controllers.axis.eanpos import Eanpos
from edmsim.controllers.axis.servo_module import ServoModule
from edmsim.controllers.axis.uhu import Uhu
from edmsim.errors import InputError, one_of, refuses_wrong_types
from edmsim.numeric import named_numbers

__all__ = [
    "CHIPS", "COMMISSIONED", "Drive", "Eanpos", "Screw", "ServoModule", "Uhu", "check_drive", "from_text", "make",
    "names", "tuned",
]  # fmt: skip

CHIPS: dict[str, type[Uhu] | type[ServoModule]] = {kind.name: kind for kind in (Uhu, ServoModule)}
"""Drives with a serial line, by name."""
COMMISSIONED = (*CHIPS, Eanpos.name)  # drives that `tuned` can tune for an axis

_DRIVES: dict[str, type[Drive]] = {kind.name: kind for kind in (Stepper, PositionServo, ServoModule, Uhu, Eanpos)}


def names() -> tuple[str, ...]:
    """Return the drives' names."""
    return tuple(_DRIVES)


@refuses_wrong_types
def make(name: str) -> Drive:
    """Make a drive.

    Parameters
    ----------
    name : str
        One of `names`.

    Raises
    ------
    InputError
        The name is unknown.

    Examples
    --------
    >>> make("stepper").sample is None
    True
    """
    if name not in _DRIVES:
        raise InputError(f"there is no drive {name!r}; choose one of {one_of(name, names())}")
    return _DRIVES[name]()


def from_text(text: str, screw: Screw | None = None) -> Drive:
    """Make an axis' drive from text, ``uhu:proportional_gain=600,E=400``, tuned for the steps of `screw` if set."""
    name, _, rest = text.partition(":")
    if name == Stepper.name and not rest:
        return Stepper()
    if name not in COMMISSIONED:
        raise InputError(f"there is no drive {text!r}; choose one of {one_of(name, (Stepper.name, *COMMISSIONED))}")
    return tuned(name, changes=named_numbers(rest, name), screw=screw)


def tuned(
    name: str, axis: str = "table", changes: Mapping[str, float] = MappingProxyType({}), screw: Screw | None = None
) -> Uhu | ServoModule | Eanpos:
    """Make a drive of `COMMISSIONED` tuned for an axis of `axis_row`; `changes` are by parameter's name or letter."""
    if name == Eanpos.name:
        return Eanpos.tuned("analogue-table" if axis == "table" else axis, changes, screw)
    if name not in CHIPS:
        raise InputError(f"there is no drive {name!r} to tune; choose one of {one_of(name, COMMISSIONED)}")
    axis_row(axis)
    return CHIPS[name].tuned(axis, changes, screw)
