"""Constants that a user gives other values, by name: what the option ``constants`` of a cut does."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from pydantic import BaseModel, ValidationError

from edmsim.errors import InputError
from edmsim.machine.machine import Machine
from edmsim.machine.parts import Constant
from edmsim.machine.ranges import with_constants

OPTIONS = {"wire.stress_MPa": "tension", "wire.default_diameter_um": "wire, as brass-200"}
"""Constants that only say what an option is by default, and that option."""


def checked_constants(given: Mapping[str, float] | Iterable[tuple[str, float]]) -> tuple[tuple[str, float], ...]:
    """Return values of constants as pairs, by name; raises `InputError` where they are none.

    Parameters
    ----------
    given : mapping of str to float, or pairs
        ``{"gap.critical_um": 5.0}``: section, or wire or material, and key; in the unit that the key ends in.
    """
    try:
        pairs = sorted((str(name), float(value)) for name, value in dict(given).items())
    except (TypeError, ValueError):
        raise InputError(f"constants are names with numbers, as {{'gap.critical_um': 5.0}}, not {given!r}") from None
    for name, _ in pairs:
        if name in OPTIONS:
            raise InputError(f"the constant {name} is a default: give the option {OPTIONS[name]}, instead")
    return tuple(pairs)


def parse_constant(text: str) -> tuple[str, float]:
    """Take ``gap.critical_um=5`` apart."""
    name, _, value = text.partition("=")
    try:
        return name.strip(), float(value)
    except ValueError:
        raise InputError(f"a constant is given as NAME=NUMBER, as gap.critical_um=5, not '{text}'") from None


def with_given(machine: Machine, constants: Iterable[tuple[str, float]]) -> Machine:
    """Return the set-up with other values of some constants, checked as those of a file are.

    A constant that was given has no range: it is not drawn, and may lie beyond what was published.

    Raises
    ------
    InputError
        A name that is no constant, or a value that it cannot have.
    """
    parts: dict[str, BaseModel] = {name: part for name, part in machine.base if isinstance(part, BaseModel)}
    parts |= {"wire": machine.wire, "material": machine.material}
    known = {
        f"{section}.{key}": type(constant)
        for section, part in parts.items() for key, constant in part if isinstance(constant, Constant)
    }  # fmt: skip
    changed: dict[str, Constant] = {}
    for name, value in constants:
        if name not in known:
            section = name.partition(".")[0]
            near = [other for other in known if other.startswith(f"{section}.")] or sorted(parts)
            raise InputError(f"there is no constant '{name}'; there are: {', '.join(near)}")
        try:
            changed[name] = known[name](value=value, source="given as an option")
        except ValidationError as error:
            reason = error.errors()[0]["msg"].lower()
            raise InputError(f"the constant {name} cannot be {value:g}: {reason}") from None
    given = with_constants(machine, changed)
    given.check()
    return given
