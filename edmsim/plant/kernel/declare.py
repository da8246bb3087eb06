"""Declarations of the pulse loop's arrays and numbers, from which memory, addresses and snapshots follow.

A group is a named tuple whose fields are plain numbers or arrays. An array's field says in its type what its elements
are, how long it is along every direction, and how long it lasts:

>>> class Group(NamedTuple):
...     count: int
...     wire_q: Annotated[NDArray[np.float64], Kept(2, "modes", life=CHANGING)]

Everything else is made from this by name, so that fields cannot be mistaken for each other.
"""

import functools
import math
from typing import Any, NamedTuple, TypeVar, cast, get_args, get_type_hints

import numpy as np
from numpy.typing import DTypeLike, NDArray

from edmsim.compiled.vectors import GAPS, filled, filled_packs, packed_lanes, packs

FIXED, WALL, CHANGING = range(3)
"""How long the content of an array lasts: as long as the set-up; with the workpiece (where the metal is and what
craters took of it, which outlasts the wire); or as long as the wire. A snapshot has the last two."""

_LINE = 64  # bytes of a line of the processor's cache
FREE = "free"  # field that fills a record up to a whole line
_Group = TypeVar("_Group", bound=NamedTuple)


def on_lines(*fields: tuple[Any, ...]) -> np.dtype[np.void]:
    """Return a record filled up to whole lines of the cache, so that threads do not write to the same one."""
    free = -np.dtype(list(fields)).itemsize % _LINE
    return np.dtype([*fields, (FREE, "u1", (free,))] if free else list(fields))


class ArraySizes(NamedTuple):
    """Lengths that shapes name: ``modes`` counts modes or nodes of the wire, filled up to whole vectors."""

    slices: int
    slices_filled: int
    packs: int
    rays: int
    places: int
    packed_lanes: int
    modes: int
    nodes: int
    dofs: int
    tiles: int = 0
    index_side: int = 0
    pulses: int = 0
    levels: int = 0


class Stored:
    """Shape and lifetime of a declared array: numbers or names of `ArraySizes`; elements that its type cannot say."""

    def __init__(self, *shape: int | str, life: int = FIXED, record: np.dtype[np.void] | None = None) -> None:
        self.shape, self.life, self.record = shape, life, record

    def lengths(self, sizes: ArraySizes) -> tuple[int, ...]:
        """Return the shape in numbers."""
        return tuple([getattr(sizes, n) if isinstance(n, str) else n for n in self.shape])


class Field(NamedTuple):
    """One declared field: ``stored`` is None for a plain number."""

    name: str
    dtype: np.dtype[Any]
    stored: Stored | None


def sizes_of(slices: int, rays: int, coordinates: int) -> ArraySizes:
    """Return the lengths by the numbers of slices, rays, and modes or nodes of the wire."""
    return ArraySizes(
        slices=slices, slices_filled=filled_packs(slices), packs=packs(slices), rays=rays,
        places=filled(rays, GAPS), packed_lanes=packed_lanes(rays), modes=filled(coordinates), nodes=coordinates,
        dofs=2 * coordinates + 4,
    )  # fmt: skip


@functools.cache
def fields_of(group: type) -> tuple[Field, ...]:
    """Return the declared fields of a group, in their order."""
    found = []
    for name, hint in get_type_hints(group, include_extras=True).items():
        if hint in (int, float):
            found.append(Field(name, np.dtype("i8" if hint is int else "f8"), None))
            continue
        array, stored = get_args(hint)
        element = get_args(get_args(array)[1])[0]
        found.append(Field(name, np.dtype(element) if stored.record is None else stored.record, stored))
    return tuple(found)


@functools.cache
def numbers_of(group: type) -> np.dtype[np.void]:
    """Return the record of a group of numbers only: compiled code reads it by the same names."""
    return np.dtype([(name, dtype) for name, dtype, _ in fields_of(group)])


@functools.cache
def entries_of(group: type) -> np.dtype[np.void]:
    """Return the record with which the loop finds a group: its numbers themselves, and its arrays' addresses."""
    return np.dtype([(name, dtype if stored is None else np.dtype("i8")) for name, dtype, stored in fields_of(group)])


def lasting(group: type, *lives: int) -> tuple[str, ...]:
    """Return the names of a group's arrays that last so long."""
    return tuple(name for name, _, stored in fields_of(group) if stored is not None and stored.life in lives)


def allocate(group: type[_Group], sizes: ArraySizes, **numbers: float) -> _Group:
    """Return a group with its plain numbers, its arrays full of zeros, each from the beginning of a cache line on."""
    # a vector of sixteen gaps that is not on a line of its own takes two reads
    stored_at, end = [], 0
    for name, dtype, stored in fields_of(group):
        if stored is not None:
            shape = stored.lengths(sizes)
            stored_at.append((name, dtype, shape, end))
            end += -(-dtype.itemsize * math.prod(shape) // _LINE) * _LINE
    room = np.zeros(end + _LINE, np.uint8)
    room = room[-room.ctypes.data % _LINE:]
    made: dict[str, Any] = {name: np.ndarray(shape, dtype, room, start) for name, dtype, shape, start in stored_at}
    return cast("_Group", cast(Any, group)(**made, **numbers))


def check(field: Field, array: NDArray[Any], sizes: ArraySizes) -> None:
    """Refuse an array that is not what was declared: compiled code would read beyond it."""
    assert field.stored is not None
    declared: tuple[DTypeLike, tuple[int, ...]] = field.dtype, field.stored.lengths(sizes)
    if (array.dtype, array.shape) != declared or not array.flags.c_contiguous:
        raise TypeError(f"{field.name} is {array.dtype} {array.shape}, declared as {declared[0]} {declared[1]}")
