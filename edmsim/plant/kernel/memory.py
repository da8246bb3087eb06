"""A plant's memory: its arrays, and a table of their addresses, which is the argument of the compiled loop.

A call with some 60 arguments would take a tenth of a window; a call with one address takes almost no time. Array
sizes are constants of the compiled code, with one version per resolution, because its short loops are then unrolled.
The table, and the code that reads groups from it, follow from the declarations in `state`.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import compiled
from edmsim.compiled.memory_views import GroupField, group_of, rows_of
from edmsim.compiled.specialised import specialised
from edmsim.plant.gap.breakdown import GapLaw
from edmsim.plant.gap.gas import BubbleLaw, GasLaw
from edmsim.plant.kernel import state
from edmsim.plant.kernel.fire import fire_window
from edmsim.plant.mechanics.full_model import FullLink
from edmsim.plant.wire import HeatLaw

_GROUPS: dict[str, Any] = {
    "own": state.Own, "arrays": state.Arrays, "propagators": state.Propagators, "scratch": state.Scratch,
    "axes": state.Axes, "link": FullLink, "law": GapLaw, "gas": GasLaw,
}
_RECORDS: dict[str, Any] = {
    "constants": state.Constants, "heat": HeatLaw, "bubble": BubbleLaw, "timing": state.Timing,
}
_NAMES = {kind: name for name, kind in (*_GROUPS.items(), *_RECORDS.items())}
_COUNTED = {"tiles": "tiles", "index_side": "tile_index", "pulses": "pulses", "levels": "levels"}
"""Lengths in `ArraySizes` that change while a plant runs, with the array of `Own` that has each length."""
_TABLE = np.dtype(
    [(name, "i8") for name in _COUNTED]
    + [(name, state.entries_of(kind)) for name, kind in _GROUPS.items()]
    + [(name, "i8") for name in _RECORDS]
)


class Memory:
    """The arrays of a plant's loop; references are held as long as their addresses are in the table at `address`."""

    def __init__(self, sizes: state.ArraySizes) -> None:
        self._sizes = sizes
        self._table = np.zeros(1, _TABLE)
        self.address: int = self._table.ctypes.data
        self._alive: dict[tuple[str, str], NDArray[Any]] = {}

    def put(self, group: NamedTuple) -> None:
        """Store a group in the table: its numbers, and the addresses of its arrays, which must be as declared."""
        kind = type(group)
        name = _NAMES[kind]
        if name in _RECORDS:
            record = np.array([tuple(group)], state.numbers_of(kind))
            self._table[name], self._alive[name, ""] = record.ctypes.data, record
        else:
            fields = zip(state.fields_of(kind), group, strict=True)
            self._table[name] = tuple([self._entry(name, field, value) for field, value in fields])

    def put_own(self, **arrays: NDArray[Any]) -> None:
        """Store arrays of `Own`: records of scalars, the kerf field, whose tiles change, or the log of pulses."""
        lengths = {length: len(arrays[name]) for length, name in _COUNTED.items() if name in arrays}
        self._sizes = self._sizes._replace(**lengths)
        for length, count in lengths.items():
            self._table[length] = count
        entries = self._table["own"]
        for field in state.fields_of(state.Own):
            if field.name in arrays:
                entries[field.name] = self._entry("own", field, arrays[field.name])

    def _entry(self, name: str, field: state.Field, value: Any) -> Any:
        """Return a field's entry in the table: the number, or the address of the array, which is kept alive."""
        if field.stored is None:
            return value
        state.check(field, value, self._sizes)
        self._alive[name, field.name] = value
        return value.ctypes.data  # `__array_interface__` would describe the record type at every call


def _group_of(group: Any) -> Any:
    """Return a function of compiled code that reads a group from its record in the table and `ArraySizes`."""
    fields = {
        field.name: GroupField(field.dtype, None if field.stored is None else field.stored.shape)
        for field in state.fields_of(group)
    }  # fmt: skip
    return group_of(group.__name__, state.entries_of(group), fields, state.ArraySizes._fields)


_rows, _table = rows_of(np.dtype("i8")), rows_of(_TABLE)
_constants, _heat, _bubble, _timing = (rows_of(state.numbers_of(record)) for record in _RECORDS.values())
_own_of: Callable[..., state.Own]
_arrays_of: Callable[..., state.Arrays]
_propagators_of: Callable[..., state.Propagators]
_scratch_of: Callable[..., state.Scratch]
_axes_of: Callable[..., state.Axes]
_link_of: Callable[..., FullLink]
_law_of: Callable[..., GapLaw]
_gas_of: Callable[..., GasLaw]
_own_of, _arrays_of, _propagators_of, _scratch_of, _axes_of, _link_of, _law_of, _gas_of = (
    _group_of(group) for group in _GROUPS.values()
)


CALL = 5
"""Columns of a call for one plant (int64): address of its `Memory`'s table, address of the window's events (int64
rows of time, channel, value), number of events, pulses to fire, and the result: how the window ended."""


@functools.cache
def window_function(slices: int, rays: int, coordinates: int, full: bool) -> Callable[[int, int], None]:
    """Return the compiled window of a resolution; with `full`, MuJoCo moves the table and the wire's nodes."""
    # Its arguments are the address of rows of `CALL` numbers, one row for each plant, and the number of rows. One
    # plant and a thousand run the same machine code, so a plant's bits do not depend on the others.
    return specialised(fire_full_windows if full else fire_windows, slices, rays, coordinates)


@compiled
def _no_link(_at: Any, _lengths: tuple[int, ...]) -> None:
    """Return no link to MuJoCo; the modes move."""
    return


@compiled
def _full_link(at: Any, lengths: tuple[int, ...]) -> FullLink:
    """Return the link to MuJoCo from its record in the table."""
    return _link_of(at.link, lengths)


@compiled
def _fire(calls: int, count: int, slices: int, rays: int, coordinates: int, link: Callable[..., Any]) -> None:
    """Fire a window for each plant; `link` returns a plant's link to MuJoCo."""
    rows = _rows(calls, (count, CALL))
    for k in range(count):
        at = _table(rows[k, 0], (1,))[0]
        lengths = state.sizes_of(slices, rays, coordinates, at.tiles, at.index_side, at.pulses, at.levels)
        own = _own_of(at.own, lengths)
        rows[k, 4] = fire_window(
            own.state, own.window, _arrays_of(at.arrays, lengths), own.tiles, own.tile_index, own.levels,
            _constants(at.constants, (1,))[0], _law_of(at.law, lengths), _heat(at.heat, (1,))[0],
            _bubble(at.bubble, (1,))[0], _gas_of(at.gas, lengths), _timing(at.timing, (1,))[0],
            _propagators_of(at.propagators, lengths), _scratch_of(at.scratch, lengths),
            _axes_of(at.axes, lengths), link(at, lengths), _rows(rows[k, 1], (rows[k, 2], 3)), own.pulses, rows[k, 3],
        )  # fmt: skip


def fire_windows(calls: int, count: int, slices: int, rays: int, coordinates: int) -> None:
    """Fire a window for each plant, moved by modes; only called compiled (see `window_function`)."""
    _fire(calls, count, slices, rays, coordinates, _no_link)


def fire_full_windows(calls: int, count: int, slices: int, rays: int, coordinates: int) -> None:
    """Fire a window for each plant, moved by MuJoCo; compiled separately because other cuts do not need it."""
    _fire(calls, count, slices, rays, coordinates, _full_link)
