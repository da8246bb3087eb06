"""Machines drawn within the ranges of their constants: `Machine.sample` and `Machine.uncertain`.

A range in a machine, wire or material file is the uncertainty of a constant. Ranges in a generator file are limits of
the operator's settings, and are not drawn from.
"""

import math
from collections.abc import Iterable, Mapping
from typing import TypeVar

import numpy as np

from edmsim.errors import InputError
from edmsim.machine.components import Component, Constant, SetUp
from edmsim.machine.setting import check

_SetUp = TypeVar("_SetUp", bound=SetUp)
LOG_FROM_RATIO = 3.0  # ratio of the ends from which a positive range is drawn log-uniformly (ours)
MOST_DRAWS = 100  # greatest number of draws (ours: if 5 % of set-ups can run, 99 of 100 calls succeed)


def uncertain(machine: SetUp) -> dict[str, Constant]:
    """Return the constants that have a range, by section and name; see `Machine.uncertain`."""
    return {
        f"{section}.{name}": value
        for section, component in _sections(machine).items()
        for name, value in vars(component).items()
        if isinstance(value, Constant) and value.range is not None
    }


def sample(machine: _SetUp, rng: np.random.Generator, only: Iterable[str] | None) -> _SetUp:
    """Draw a machine; see `Machine.sample`."""
    known = uncertain(machine)
    chosen = set(known) if only is None else _chosen(known, only)
    for _ in range(MOST_DRAWS):
        shares = rng.random(len(known))
        drawn = with_values(
            machine,
            {
                name: value_at(constant.range, float(share))
                for (name, constant), share in zip(known.items(), shares, strict=True)
                if name in chosen and constant.range is not None
            },
        )
        try:
            check(drawn)
        except InputError as error:
            refused = error
        else:
            return drawn
    raise InputError(f"none of {MOST_DRAWS} machines drawn within the ranges can run, the last because "
                     f"{refused.reason}; choose another setting, or draw fewer constants")


def value_at(bounds: tuple[float, float], share: float) -> float:
    """Return the quantile `share` (0..1) of the draws from a range."""
    # uniform; log-uniform if the range is positive and spans a factor of `LOG_FROM_RATIO`
    low, high = bounds
    is_order = low > 0 and high / low >= LOG_FROM_RATIO
    value = low * (high / low) ** share if is_order else low + (high - low) * share
    return min(max(value, low), high)  # rounding may exceed the ends


def share_of(bounds: tuple[float, float], value: float) -> float:
    """Return the share (0..1) of the draws from a range below `value`: the inverse of `value_at`."""
    low, high = bounds
    is_order = low > 0 and high / low >= LOG_FROM_RATIO
    return math.log(value / low) / math.log(high / low) if is_order else (value - low) / (high - low)


def choose(machine: SetUp, only: Iterable[str]) -> dict[str, Constant]:
    """Return the constants with a range that are selected by sections and names, in the order of the files."""
    known = uncertain(machine)
    names = _chosen(known, only)
    return {name: constant for name, constant in known.items() if name in names}


def _sections(machine: SetUp) -> dict[str, Component]:
    """Parts of a machine whose ranges are uncertainty, by the name of their table or kind of file."""
    tables = {name: component for name, component in vars(machine.base).items() if isinstance(component, Component)}
    return {**tables, "wire": machine.wire, "material": machine.material}


def _chosen(known: dict[str, Constant], only: Iterable[str]) -> set[str]:
    """Return the names of the constants that `only` selects, by section or one by one."""
    sections: dict[str, set[str]] = {}
    for key in known:
        sections.setdefault(key.partition(".")[0], set()).add(key)
    chosen: set[str] = set()
    for name in only:
        if name not in known and name not in sections:
            raise InputError(f"'{name}' is not a section or constant with a range to draw from; there are the "
                             f"sections {', '.join(sections)} and the constants {', '.join(known)}")
        chosen |= sections.get(name, {name})
    return chosen


def values_of(machine: SetUp, names: Iterable[str]) -> dict[str, float]:
    """Return the values of constants, named by section and key."""
    return {name: constant.value for name, constant in _named(machine, names).items()}


def _named(machine: SetUp, names: Iterable[str]) -> dict[str, Constant]:
    sections = {name: vars(component) for name, component in _sections(machine).items()}
    parted = {name: name.partition(".") for name in names}
    return {name: sections[section][key] for name, (section, _, key) in parted.items()}


def with_values(machine: _SetUp, values: Mapping[str, float]) -> _SetUp:
    """Return the machine with other values of constants, unchecked; sources and ranges stay."""
    known = _named(machine, values)
    return with_constants(machine, {name: known[name].changed({"value": value}) for name, value in values.items()})


def with_constants(machine: _SetUp, constants: Mapping[str, Constant]) -> _SetUp:
    """Return the machine with constants replaced, unchecked."""
    changed: dict[str, dict[str, Constant]] = {}
    for name, constant in constants.items():
        section, _, key = name.partition(".")
        changed.setdefault(section, {})[key] = constant
    sections = _sections(machine)
    components = {section: sections[section].changed(new) for section, new in changed.items()}
    base = machine.base.changed({k: v for k, v in components.items() if k not in ("wire", "material")})
    outside = {k: v for k, v in components.items() if k in ("wire", "material")}
    return machine.model_copy(update={"base": base, **outside})
