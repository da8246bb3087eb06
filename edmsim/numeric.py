"""Numbers that users give: Python's own, numpy's, fractions, arrays without a dimension; no truth values.

>>> import numpy as np
>>> plain(np.float32(0.5)), plain((np.int64(3), True))
(0.5, (3, True))
"""

import math
import sys
from dataclasses import fields
from numbers import Integral, Real
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator

from edmsim.errors import InputError

_MOST = sys.float_info.max  # a whole number may be greater


def _scalar(value: object) -> object:
    """Return what an array without a dimension holds."""
    return value[()] if isinstance(value, np.ndarray) and value.ndim == 0 else value


def real(value: object) -> float | None:
    """Return a number as Python's own; None for anything else."""
    value = _scalar(value)
    if isinstance(value, bool) or not isinstance(value, Real):
        return None
    try:
        return int(value) if isinstance(value, Integral) else float(value)
    except OverflowError:
        size: Any = math.trunc(value)
        return math.inf if size > 0 else -math.inf


def whole(value: object) -> int | None:
    """Return a whole number as Python's own; None for anything else, 3.0 included."""
    number = real(value)
    return number if isinstance(number, int) else None


def plain(value: Any) -> Any:
    """Return a number as Python's own, also within tuples and lists; anything else as it is."""
    if isinstance(value, tuple | list):
        inner = [plain(entry) for entry in value]
        return type(value)(*inner) if hasattr(value, "_fields") else type(value)(inner)
    number = real(value)
    return value if number is None else number


def keep_plain(record: Any) -> None:
    """Make the numbers among the fields of a dataclass Python's own, also of a frozen one."""
    for field in fields(record):
        object.__setattr__(record, field.name, plain(getattr(record, field.name)))


def finite(name: str, value: object, least: float = -math.inf) -> float:
    """Return an argument as a number; refuse anything else, infinity, NaN, or less than `least`."""
    number = real(value)
    if number is None or not least <= number <= _MOST or number < -_MOST:
        from_least = f" of {least:g} or more" if least > -math.inf else ""
        raise InputError(f"{name} is {value!r}: give a finite number{from_least}")
    return number


def whole_from(name: str, value: object, least: int | None = None) -> int:
    """Return an argument as a whole number; refuse anything else, or less than `least`."""
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
    """Return an argument as a whole number; refuse anything else, or one that is not from `low` to `high`."""
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
"""A number among a pydantic model's fields."""
WholeNumber = Annotated[int, BeforeValidator(_for_pydantic)]


def named_numbers(text: str, what: str) -> dict[str, float]:
    """Read ``name=number,...``, empty for none; `what` says in a message whose numbers they are."""
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
