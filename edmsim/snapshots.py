"""Saving and loading of state: a class declares its state, and gets `snapshot` and `restore`.

>>> class Counter(Snapshots):
...     STATE = ("count",)
...     def __init__(self, step):
...         self.step, self.count = step, 0
>>> counter, again = Counter(3), Counter(3)
>>> counter.count = 6
>>> again.restore(counter.snapshot())
>>> again.count
6
"""

from collections import abc, deque
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from typing import Any, ClassVar, get_args, get_origin, get_type_hints

import numpy as np


class Snapshots:
    """Saves and loads its state: dataclass fields that are not arguments, and the attributes named in `STATE`."""

    # Other attributes are not saved: the arguments or `set_up` determine them. Values with a `snapshot` of their own
    # are restored in place. Types that the present value does not show, such as those of a list's entries or of a
    # value that may be None, are read from the annotations of the class.

    STATE: ClassVar[tuple[str, ...]] = ()

    def snapshot(self) -> dict[str, Any]:
        """Return the state as JSON values."""
        return state_of(self)

    def restore(self, state: abc.Mapping[str, Any]) -> None:
        """Load a snapshot into an object that was made and set up in the same way."""
        take_state(self, state)


class ArraySnapshots(Snapshots):
    """Saves and loads its state as arrays; those of a part are named ``part.array``.

    Arrays are written in place and keep shape and type; properties are set.
    """

    def snapshot(self) -> dict[str, np.typing.NDArray[Any]]:
        """Return a copy of the state as arrays."""
        found: dict[str, np.typing.NDArray[Any]] = {}
        for key, name in _names_of(self).items():
            value = getattr(self, name)
            parts = _parts(key, value)
            if parts is None:
                found[key] = np.array(value)
                continue
            for prefix, part in parts.items():
                found.update({f"{prefix}.{inner}": array for inner, array in part.snapshot().items()})
        return found

    def restore(self, state: abc.Mapping[str, np.typing.NDArray[Any]]) -> None:
        """Load a snapshot; raises `ValueError` for an array of another shape or type."""
        for key, name in _names_of(self).items():
            value = getattr(self, name)
            parts = _parts(key, value)
            if parts is None:
                self._take(name, value, state[key])
                continue
            for prefix, part in parts.items():
                part.restore(with_prefix(state, f"{prefix}."))

    def _take(self, name: str, value: Any, array: np.typing.NDArray[Any]) -> None:
        if not isinstance(value, np.ndarray):
            setattr(self, name, array.tolist())
        elif isinstance(getattr(type(self), name, None), property):
            setattr(self, name, array)
        elif (array.shape, array.dtype) != (value.shape, value.dtype):
            raise ValueError(
                f"a snapshot's {name.strip('_')}, {array.shape} of type {array.dtype}, does not fit {value.shape} of "
                f"type {value.dtype}"
            )
        else:
            value[...] = array


def with_prefix(state: abc.Mapping[str, np.typing.NDArray[Any]], prefix: str) -> dict[str, np.typing.NDArray[Any]]:
    """Return the arrays whose names begin with a prefix, by the rest of their names."""
    return {name.removeprefix(prefix): array for name, array in state.items() if name.startswith(prefix)}


def state_of(thing: Any) -> dict[str, Any]:
    """Return an object's declared state as JSON values: see `Snapshots`."""
    return {key: plain(getattr(thing, name)) for key, name in _names_of(thing).items()}


def take_state(thing: Any, state: abc.Mapping[str, Any]) -> None:
    """Load the `state_of` an object into another one that was made in the same way."""
    kind: Any = type(thing)
    hints = _hints(kind)
    for key, name in _names_of(thing).items():
        now = getattr(thing, name)
        value = like(now, state[key], hints.get(name))
        if value is not now:
            setattr(thing, name, value)


def plain(value: Any) -> Any:
    """Return a value as JSON: records as mappings, sequences as lists, bytes and arrays as hex digits."""
    if value is None or (isinstance(value, str | int | float) and not isinstance(value, Enum)):
        return value
    if hasattr(value, "snapshot"):
        return value.snapshot()
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, np.ndarray):
        return value.tobytes().hex()
    if isinstance(value, bytes | bytearray):
        return value.hex()
    if isinstance(value, abc.Mapping):
        return [[plain(key), plain(entry)] for key, entry in value.items()]
    if isinstance(value, abc.Set):
        return sorted(plain(entry) for entry in value)
    if isinstance(value, tuple | list | deque):
        return [plain(entry) for entry in value]
    return value.value if isinstance(value, Enum) else value.item()


def like(now: Any, saved: Any, kind: Any = None) -> Any:
    """Undo `plain`; the type of the result is the annotated one, or else that of the present value."""
    if saved is None:
        return None
    if hasattr(now, "restore"):
        now.restore(saved)
        return now
    if isinstance(now, np.ndarray):
        now[...] = np.frombuffer(bytes.fromhex(saved), now.dtype).reshape(now.shape)
        return now
    if isinstance(now, bytearray):
        now[:] = bytes.fromhex(saved)
        return now
    if type(None) in get_args(kind):
        (kind,) = (each for each in get_args(kind) if each is not type(None))
    made: Any = get_origin(kind) or kind or type(now)
    if isinstance(saved, dict):
        hints = _hints(made)
        return made(**{name: like(getattr(now, name, None), entry, hints[name]) for name, entry in saved.items()})
    if isinstance(saved, list) and made not in (Any, type(None)):
        return _sequence_like(now, saved, made, get_args(kind))
    return made(saved) if isinstance(made, type) and issubclass(made, Enum) else saved


def _sequence_like(now: Any, saved: Any, made: Any, inner: tuple[Any, ...]) -> Any:
    """Return a sequence or set; without an annotation its entries have the type of the present ones."""
    if issubclass(made, abc.Mapping):
        return made((key, like(None, entry, *inner[1:])) for key, entry in saved)
    if hasattr(made, "_fields"):
        before = now or (None,) * len(saved)
        return made(*map(like, before, saved, _hints(made).values()))
    if issubclass(made, tuple) and inner and inner[-1] is not Ellipsis:
        return made(like(None, entry, kind) for entry, kind in zip(saved, inner, strict=True))
    if inner:
        return made(like(None, entry, inner[0]) for entry in saved)
    if issubclass(made, tuple) and now and len(now) == len(saved):
        return made(map(like, now, saved))
    return made(saved)


def _parts(key: str, value: Any) -> dict[str, Any] | None:
    """Return the parts of a value that have a `snapshot`, by their prefixes; None if the value is an array."""
    if hasattr(value, "snapshot"):
        return {key: value}
    if isinstance(value, abc.Mapping):
        return {f"{key}.{entry}": part for entry, part in value.items()}
    return None


def _names_of(thing: Any) -> dict[str, str]:
    """Return the names of an object's state by the names in its snapshot, which have no leading underscore."""
    kind: Any = type(thing)  # mypy does not accept a class as hashable
    return _state_names(kind)


@cache
def _state_names(kind: Any) -> dict[str, str]:
    own = [field.name for field in fields(kind) if not field.init] if is_dataclass(kind) else []
    named = [name for base in reversed(kind.__mro__) for name in vars(base).get("STATE", ())]
    return {name.strip("_"): name for name in (*own, *named)}


@cache
def _hints(kind: Any) -> dict[str, Any]:
    return get_type_hints(kind)
