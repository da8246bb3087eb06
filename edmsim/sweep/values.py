"""Values as a person writes them: ``5,10,20``, ``10:40:5``, ``counts:open_target_share=0.1,voltage``."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

from edmsim.controllers.named_numbers import listed
from edmsim.errors import InputError

_NUMBER = r"[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_RANGE = re.compile(rf"({_NUMBER}):({_NUMBER}):({_NUMBER})")
MOST_OF_RANGE = 100_000
"""Values that a range may have (ours: a step mistyped by some powers of ten is refused, not computed)."""


def values_of(given: Any, name: str) -> list[Any]:
    """Return the values to try of a setting.

    Parameters
    ----------
    given : list, text, number or bool
        A list is taken as it is. A text is taken apart at its commas, but for those within the parameters of a
        controller; pieces ``FIRST:LAST:STEP`` are ranges that hold both ends.
    name : str
        Of the setting, for the error.

    Raises
    ------
    InputError
        No value, or a range that has none.
    """
    if isinstance(given, list):
        found = given
    elif isinstance(given, str):
        found = [value for piece in listed(given) for value in _values_of_piece(piece, name)]
    else:
        found = [given]
    if not found:
        raise InputError(f"{name} has no value to try: give some, as [5, 10, 20] or '5:20:5'")
    return found


def _values_of_piece(piece: str, name: str) -> list[Any]:
    spaced = _RANGE.fullmatch(piece)
    if spaced is None:
        return [number_or_text(piece)]
    first, last, step = (float(part) for part in spaced.groups())
    count = (last - first) / step if step else math.nan
    if not 0 <= count < MOST_OF_RANGE:
        raise InputError(f"{name} cannot go from {first:g} to {last:g} in steps of {step:g}: give FIRST:LAST:STEP")
    whole = all(float(part).is_integer() for part in (first, step))
    # counted up from the first, so that no sum of rounded steps misses the last; twelve digits are what was meant
    spread = [float(f"{first + k * step:.12g}") for k in range(math.floor(count + 1e-9) + 1)]
    return [int(value) for value in spread] if whole else spread


def number_or_text(text: str) -> Any:
    """Return a number where the text is one, whole where it is written so; true and false; else the text."""
    if text in ("true", "false"):
        return text == "true"
    if not re.fullmatch(_NUMBER, text):
        return text
    value = float(text)
    return int(text) if re.fullmatch(r"[-+]?[0-9]+", text) and math.isfinite(value) else value


def flattened(table: Mapping[str, Any]) -> dict[str, Any]:
    """Name constants as ``section.key``, whether their key was written in quotes or became a table of TOML."""
    flat: dict[str, Any] = {}
    for name, value in table.items():
        if isinstance(value, dict):
            flat |= {f"{name}.{key}": inner for key, inner in flattened(value).items()}
        else:
            flat[name] = value
    return flat
