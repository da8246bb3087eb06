"""Checks of numbers from users: Python's, numpy's, fractions, 0-dimensional arrays; booleans are not numbers.

>>> import numpy as np
>>> plain(np.float32(0.5)), plain((np.int64(3), True))
(0.5, (3, True))
"""

import math
from dataclasses import fields
from numbers import Integral, Real
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator

from edmsim.errors import InputError

_MOST = float(np.finfo(float).max)  # an int may exceed the range of float


def _scalar(value: object) -> object:
    """Return the value of a 0-dimensional array; anything else unchanged."""
    return value[()] if isinstance(value, np.ndarray) and value.ndim == 0 else value


def real(value: object) -> float | None:
    """Return a number as a Python number; None for anything else."""
    if type(value) is float or type(value) is int:  # the usual case; a window checks a dozen numbers
        return value
    value = _scalar(value)
    if isinstance(value, bool) or not isinstance(value, Real):
        return None
    try:
        return int(value) if isinstance(value, Integral) else float(value)
    except OverflowError:
        size: Any = math.trunc(value)
        return math.inf if size > 0 else -math.inf


def whole(value: object) -> int | None:
    """Return an integer as a Python int; None for anything else, also for 3.0."""
    number = real(value)
    return number if isinstance(number, int) else None


def plain(value: Any) -> Any:
    """Return a number as a Python number, also within tuples and lists; anything else unchanged."""
    if isinstance(value, tuple | list):
        inner = [plain(entry) for entry in value]
        return type(value)(*inner) if hasattr(value, "_fields") else type(value)(inner)
    number = real(value)
    return value if number is None else number


def to_plain_numbers(record: Any) -> None:
    """Convert the numbers in a dataclass's fields to Python numbers, even if it is frozen."""
    for field in fields(record):
        object.__setattr__(record, field.name, plain(getattr(record, field.name)))


def finite(name: str, value: object, least: float = -math.inf) -> float:
    """Return an argument as a number; refuse other types, infinity, NaN and values below `least`."""
    number = real(value)
    if number is None or not least <= number <= _MOST or number < -_MOST:
        from_least = f" of {least:g} or more" if least > -math.inf else ""
        raise InputError(f"{name} is {value!r}: give a finite number{from_least}")
    return number


def whole_from(name: str, value: object, least: int | None = None) -> int:
    """Return an argument as an integer; refuse other types and values below `least`."""
    number = whole(value)
    if number is None or (least is not None and number < least):
        raise InputError(f"{name} is {value!r}: give a whole number{'' if least is None else f', {least} or more'}")
    return number


def above_zero(name: str, value: float, most: float = math.inf) -> None:
    """Refuse an argument that is not a number above 0 and at most `most`."""
    number = real(value)
    if number is None or not 0 < number <= min(most, _MOST):
        up_to = f" and at most {most:g}" if math.isfinite(most) else ""
        raise InputError(f"{name} is {value!r}: give a number above 0{up_to}")


def within(name: str, value: float, low: float, high: float) -> None:
    """Refuse an argument that is not a number from `low` to `high`."""
    number = real(value)
    if number is None or not low <= number <= high:
        raise InputError(f"{name} is {value!r}: give a number from {low:g} to {high:g}")


def whole_within(name: str, value: object, low: int, high: int) -> int:
    """Return an argument as an integer; refuse other types and values outside `low` to `high`."""
    number = whole_from(name, value)
    if not low <= number <= high:
        raise InputError(f"{name} is {value!r}: give a whole number from {low} to {high}")
    return number


def _for_pydantic(value: object) -> object:
    if isinstance(_scalar(value), bool | np.bool_):
        raise ValueError("must be a number, not a truth value")
    if isinstance(value, str):
        raise ValueError("must be a number, not a text")
    return plain(value)


Number = Annotated[float, BeforeValidator(_for_pydantic)]
"""A number in a pydantic model's field."""
WholeNumber = Annotated[int, BeforeValidator(_for_pydantic)]


def named_numbers(text: str, what: str) -> dict[str, float]:
    """Read ``name=number,...``, or an empty text; `what` names the owner of the numbers in messages."""
    found = {}
    for pair in filter(None, text.split(",")):
        key, equals, value = pair.partition("=")
        if key.strip() in found:
            raise InputError(f"{what} parameter '{key.strip()}' is given twice")
        try:
            found[key.strip()] = float(value)
        except ValueError:
            equals = ""
        if not equals:
            raise InputError(f"{what} parameter '{pair}' must read name=number")
    return found
