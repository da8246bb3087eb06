"""Arguments of the environments: their declaration, their form in JSON, and their checks."""

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from enum import Enum
from inspect import cleandoc, signature
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, NamedTuple, TypeVar, dataclass_transform, get_args, get_origin, get_type_hints

import numpy as np
from gymnasium.error import InvalidAction
from numpy.typing import NDArray
from pydantic import ValidationError

from edmsim import numeric
from edmsim.errors import InputError, invalid_entry, one_of, refuse_unknown
from edmsim.machine.machine import Machine

Range = float | tuple[float, float]
_Record = TypeVar("_Record")
_Value = TypeVar("_Value")
_Kind = TypeVar("_Kind", bound=type)


def argument(default: _Value, unit: str, meaning: str) -> _Value:
    """Return a dataclass field with a unit and a meaning; a subclass may override only its default."""
    return field(default=default, metadata={"unit": unit, "meaning": meaning})


class Argument(NamedTuple):
    """An argument of an environment, as its page lists it."""

    name: str
    default: Any
    unit: str
    meaning: str


def arguments_of(kind: type) -> list[Argument]:
    """Return the fields of a dataclass, with the unit and meaning that the class or its nearest base declares."""
    said = {
        f.name: f.metadata
        for base in reversed(kind.__mro__) if is_dataclass(base) for f in fields(base) if f.metadata
    }  # fmt: skip
    return [Argument(f.name, f.default, **said[f.name]) for f in fields(kind)]


@dataclass_transform(frozen_default=True, kw_only_default=True)
def record_of_arguments(kind: _Kind) -> _Kind:
    """Make a frozen dataclass whose docstring lists its own arguments, at ``{parameters}`` or at the end."""
    dataclass(frozen=True, kw_only=True)(kind)  # modifies the class in place
    inherited = {f.name for base in kind.__bases__ if is_dataclass(base) for f in fields(base)}
    own = [one for one in arguments_of(kind) if one.name not in inherited]
    if kind.__doc__ is not None and own:  # it is None with python -OO
        listed = [f"{name}\n    {meaning}{unit and f' ({unit})'}." for name, _, unit, meaning in own]
        text = cleandoc(kind.__doc__)
        text = text if "{parameters}" in text else f"{text}\n\n{{parameters}}"
        kind.__doc__ = text.replace("{parameters}", "\n".join(["Parameters", "----------", *listed]))
    return kind


_SAID = {
    float: "a number", int: "a whole number", tuple[float, float]: "two numbers", Sequence[str]: "a list of texts",
    str: "a text", Path: "a path", NoneType: "None",
}  # fmt: skip
"""Names of declared types in error messages; other types have their own names."""


def _fits(value: Any, kind: Any) -> bool:
    if kind in (float, int):
        return (numeric.real if kind is float else numeric.whole)(value) is not None
    if kind not in (tuple[float, float], Sequence[str]):
        return isinstance(value, kind)
    if not isinstance(value, tuple | list):
        return False
    if kind == Sequence[str]:
        return all(isinstance(one, str) for one in value)
    return len(value) == 2 and None not in map(numeric.real, value)


@functools.cache
def _declared(kind: type) -> list[tuple[Argument, Any]]:
    """Return the arguments that edmsim declares, with their types; those that a user's class adds are not checked."""
    base = next(one for one in kind.__mro__ if one.__module__.startswith(f"{__package__}."))
    hints = get_type_hints(base)
    return [(one, hints[one.name]) for one in arguments_of(base)]


def check_kinds(record: object) -> None:
    """Convert numbers to Python's own, and raise `InputError` if an argument does not have its declared type."""
    numeric.to_plain_numbers(record)
    for (name, _, _, meaning), hint in _declared(type(record)):  # type: ignore[arg-type]
        value = getattr(record, name)
        if get_origin(hint) is Literal:
            refuse_unknown(name, value, get_args(hint))
            continue
        kinds = get_args(hint) if isinstance(hint, UnionType) else (hint,)
        if not any(_fits(value, kind) for kind in kinds):
            *first, last = (_SAID.get(kind) or kind.__name__ for kind in kinds)
            said = f"{', '.join(first)} or {last}" if first else last
            raise InputError(f"{name} is {value!r}: give {said} ({meaning})")


def ends_of(name: str, value: Range) -> tuple[float, float]:
    """Return both ends of an argument that is a range, or twice the value of a number."""
    low, high = map(numeric.real, value if isinstance(value, Sequence) and len(value) == 2 else (value, value))
    if low is None or high is None or not 0 < low <= high < math.inf:
        raise InputError(f"{name} is {value!r}: give a number above 0, or the ends of a range, the lower first")
    return float(low), float(high)


def machine_of(value: Any) -> Any:
    """Return a machine from a name, a file, a mapping of arguments of `Machine.load`, or the result of `plain`."""
    if isinstance(value, str | Path):
        return Machine.load(str(value))
    if not isinstance(value, Mapping):
        return value
    if "base" in value:
        try:
            machine = Machine.model_validate(value)
        except ValidationError as error:
            raise InputError(f"machine: {invalid_entry(error)}") from None
        machine.check()
        return machine
    _only_known("machine has no entry", value, list(signature(Machine.load).parameters))
    return Machine.load(**value)


def record_of(name: str, value: Any, own: _Record) -> Any:
    """Return a copy of `own` with the values of a mapping; return any other value unchanged."""
    if not isinstance(value, Mapping):
        return value
    values = {f.name: getattr(own, f.name) for f in fields(own)}  # type: ignore[arg-type]
    _only_known(f"{name} has no entry", value, list(values))
    return type(own)(**{**values, **value})


def plain(item: Any) -> Any:
    """Return an argument as JSON writes it: machines and records as mappings, tuples as lists, paths as text."""
    if isinstance(item, Enum):
        return item.value
    if isinstance(item, Machine):
        return item.model_dump(mode="json")
    if hasattr(item, "__dataclass_fields__") and not isinstance(item, type):
        return {f.name: plain(getattr(item, f.name)) for f in fields(item)}
    if isinstance(item, Mapping):
        return {name: plain(value) for name, value in item.items()}
    if isinstance(item, tuple | list):
        return [plain(value) for value in item]
    return str(item) if isinstance(item, Path) else numeric.plain(item)


def _only_known(refusal: str, value: Mapping[str, Any], known: Sequence[str]) -> None:
    for key in value:
        if key not in known:
            raise InputError(f"{refusal} {key!r}; it has {one_of(key, known)}")


def _array(values: Any) -> NDArray[Any]:
    try:
        return np.asarray(values)
    except ValueError:  # lists of different lengths
        return np.array(None)


def checked_actions(actions: Any, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return actions as an array with the shape of their space, all finite; the caller clips them to -1..1."""
    array = _array(actions)
    if array.dtype.kind not in "fiu":
        raise InvalidAction(f"an action is numbers of shape {shape}, not {actions!r}")
    if array.shape != shape:
        raise InvalidAction(f"an action has the shape {shape}, not {array.shape}")
    taken = array
    if taken.dtype != np.float32:
        with np.errstate(over="ignore"):  # float64 above float32's range becomes infinite
            taken = array.astype(np.float32)
    if not np.isfinite(taken).all():
        raise InvalidAction(f"an action is finite numbers from -1 to 1, not {array.tolist()}")
    return taken


def checked_mask(mask: Any, count: int) -> NDArray[np.bool_]:
    """Return the mask of the sub-environments to reset: all for None."""
    array = np.ones(count, np.bool_) if mask is None else _array(mask)
    if array.shape != (count,) or array.dtype != np.bool_ or not array.any():
        raise InputError(f"reset_mask must be {count} truth values, at least one of them true")
    return array


def one_each(what: str, values: Any, count: int) -> list[Any]:
    """Return a list of values for `count` environments: those of a list or tuple, or the same one for all."""
    each = list(values) if isinstance(values, list | tuple) else [values] * count
    if len(each) != count:
        raise InputError(f"{len(each)} {what} were given for {count} environments: give one each")
    return each


def checked_options(options: Mapping[str, Any] | None, known: tuple[str, ...]) -> dict[str, Any]:
    """Return the options of a reset; raises `InputError` for an unknown one."""
    if not isinstance(options, Mapping | None):
        raise InputError(f"the options of a reset are {options!r}: give a mapping, as {{'{known[0]}': ...}}")
    found = dict(options or {})
    _only_known("reset has no option", found, known)
    machine = found.get("machine")
    if machine is not None and not isinstance(machine, Machine):
        raise InputError(f"the option machine is {machine!r}: give an edmsim.Machine")
    return found
