"""Overrides of constants by name: the option ``constants`` of a cut."""

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, get_args

from pydantic import TypeAdapter, ValidationError
from pydantic.fields import FieldInfo

from edmsim.errors import InputError, one_of, refused_entry
from edmsim.machine.components import Base, Component, Constant, Material, Wire
from edmsim.machine.machine import Machine
from edmsim.machine.ranges import with_constants
from edmsim.numeric import finite

OPTIONS = {"wire.stress_MPa": "tension", "wire.default_diameter_um": "wire, as brass-200"}
"""Constants that are only defaults of an option, with that option."""


def _fields() -> dict[str, FieldInfo]:
    """Return the declarations of all constants of machine, wire and material, also of optional ones."""
    tables = {name: field.annotation for name, field in Base.model_fields.items()}
    components = {**tables, "wire": Wire, "material": Material}
    return {
        f"{section}.{key}": field
        for section, kind in components.items() if isinstance(kind, type) and issubclass(kind, Component)
        for key, field in kind.model_fields.items() if _kind(field.annotation) is not None
    }  # fmt: skip


def _kind(annotation: Any) -> type[Constant] | None:
    """Return the type of constant in an annotation, which may be optional or have bounds; None for others."""
    if isinstance(annotation, type) and issubclass(annotation, Constant):
        return annotation
    return next((kind for part in get_args(annotation) if (kind := _kind(part)) is not None), None)


_FIELDS = _fields()
KINDS = {name: kind for name, field in _FIELDS.items() if (kind := _kind(field.annotation)) is not None}


def checked_constants(constants: Mapping[str, float] | Iterable[tuple[str, float]]) -> tuple[tuple[str, float], ...]:
    """Return constants as pairs by name: ``{"gap.critical_um": 5.0}``, section (or wire or material) and key."""
    try:
        items = constants.items() if isinstance(constants, Mapping) else constants
        pairs = sorted((str(name), finite(str(name), value)) for name, value in items)
    except (TypeError, ValueError):
        example = "{'gap.critical_um': 5.0}"
        raise InputError(f"constants are names with numbers, as {example}, not {constants!r}") from None
    names = [name for name, _ in pairs]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"the constant {name} is given twice: which value is meant?")
        if name in OPTIONS:
            raise InputError(f"the constant {name} is a default: give the option {OPTIONS[name]}, instead")
    return tuple(pairs)


def parse_constant(text: str) -> tuple[str, float]:
    """Parse ``gap.critical_um=5``."""
    name, _, value = text.partition("=")
    try:
        return name.strip(), float(value)
    except ValueError:
        raise InputError(f"an override is NAME=NUMBER, like gap.critical_um=5, not '{text}'") from None


def check_names(names: Iterable[str]) -> None:
    """Raise `InputError` for an unknown constant, listing those of its section."""
    for name in names:
        if name not in KINDS:
            section = name.partition(".")[0]
            near = [other for other in KINDS if other.startswith(f"{section}.")]
            there = near or dict.fromkeys(other.partition(".")[0] + ".*" for other in KINDS)
            raise InputError(f"there is no constant '{name}'; there are: {one_of(name, KINDS, there)}")


def with_overrides(machine: Machine, constants: Iterable[tuple[str, float]]) -> Machine:
    """Return the set-up with other values of constants, checked like those of a file; they have no range."""
    changed: dict[str, Constant] = {}
    for name, value in constants:
        check_names([name])
        changed[name] = _checked(name, value)
    changed_machine = with_constants(machine, changed)
    for name, component in (("machine", changed_machine.base), ("wire", changed_machine.wire)):
        try:
            type(component).model_validate(component.model_dump())
        except ValidationError as error:
            section, reason = refused_entry(error)
            raise InputError(f"constants of {section or name} do not go together: {reason}") from None
    changed_machine.check()
    return changed_machine


def _checked(name: str, value: float) -> Constant:
    """Return a constant with a value within its bounds."""
    field = _FIELDS[name]
    kind: Any = Annotated[(field.annotation, *field.metadata)] if field.metadata else field.annotation
    try:
        constant: Constant = TypeAdapter(kind).validate_python({"value": value, "source": "given as an option"})
    except ValidationError as error:
        raise InputError(f"the constant {name} cannot be {value:g}: {refused_entry(error)[1]}") from None
    return constant
