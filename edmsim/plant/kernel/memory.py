"""A plant's memory: its arrays, and one table of their addresses with which the compiled loop is called.

A call with some sixty arguments would cost a tenth of a window; a call with one address costs next to nothing. The
sizes are constants of the compiled code, one version per resolution, so that its short loops are unrolled.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple, get_type_hints

import numpy as np
from numba import from_dtype, types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array
from numpy.typing import NDArray

from edmsim.compiled.jit import compiled
from edmsim.compiled.vectors import filled
from edmsim.plant.gap.breakdown import GapLaw
from edmsim.plant.gap.rays import places
from edmsim.plant.kernel.fire import fire_window
from edmsim.plant.kernel.state import GRID, PULSE, STATE, WINDOW, Arrays, Constants, Propagators, Scratch, Timing
from edmsim.plant.mechanics.mujoco_loop import FullLink
from edmsim.plant.wire import HeatLaw
from edmsim.plant.workpiece.kerf_field import TILE

_RECORDS = {"constants": Constants, "law": GapLaw, "heat": HeatLaw, "timing": Timing}
_LINK_NUMBERS = {name: of for name, of in get_type_hints(FullLink).items() if of in (int, float)}
_LINK = np.dtype([(name, "i8" if of is int else "f8") for name, of in _LINK_NUMBERS.items()])
_LINK_ARRAYS = tuple(f"link_{name}" for name in FullLink._fields if name not in _LINK_NUMBERS)
_TABLE = np.dtype(
    [
        (name, "i8")
        for name in (
            "state", "window", *_RECORDS, *Arrays._fields, *Propagators._fields, *Scratch._fields,
            "tiles", "tile_count", "index", "index_side", "pulses", "pulse_count", "link",
            *_LINK_ARRAYS,
        )
    ]
)


@functools.cache
def _dtype_of(kind: type) -> np.dtype[np.void]:
    """Record with a named tuple's fields: compiled code reads either by the same names."""
    return np.dtype([(name, "i8" if of is int else "f8") for name, of in get_type_hints(kind).items()])


class Memory:
    """The arrays a plant's loop works on; they stay alive as long as their addresses are in the table.

    Attributes
    ----------
    address : int
        Address of the table.
    """

    def __init__(self) -> None:
        self._table = np.zeros(1, _TABLE)
        self.address: int = self._table.ctypes.data
        self._kept: dict[str, NDArray[Any]] = {}
        self.keep(link=np.zeros(1, _LINK))

    def keep(self, **arrays: NDArray[Any]) -> None:
        """Put C-contiguous arrays under their names."""
        for name, array in arrays.items():
            assert array.flags.c_contiguous, name
            self._table[name] = array.ctypes.data
            self._kept[name] = array

    def keep_tuple(self, arrays: NamedTuple) -> None:
        """Put the arrays of a named tuple under its field names."""
        self.keep(**arrays._asdict())

    def keep_record(self, name: str, values: NamedTuple) -> None:
        """Put the numbers of a named tuple as a record."""
        self.keep(**{name: np.array([tuple(values)], _dtype_of(_RECORDS[name]))})

    def keep_link(self, link: FullLink) -> None:
        """Put the full model's link: its numbers as a record, its arrays under names of their own."""
        values = link._asdict()
        self.keep(link=np.array([tuple(values[name] for name in _LINK_NUMBERS)], _LINK))
        self.keep(**{name: values[name.removeprefix("link_")] for name in _LINK_ARRAYS})

    def keep_field(self, tiles: NDArray[np.uint16], index: NDArray[np.int32]) -> None:
        """Put the kerf field, whose tiles move when they become more."""
        if self._kept.get("tiles") is not tiles or self._kept.get("index") is not index:
            self.keep(tiles=tiles, index=index)
            self._table["tile_count"], self._table["index_side"] = len(tiles), len(index)

    def keep_pulses(self, pulses: NDArray[np.void]) -> None:
        """Put the log of a window's pulses (`PULSE`): as long as a window, or empty if none is wanted."""
        self.keep(pulses=pulses)
        self._table["pulse_count"] = len(pulses)


def _array_of(of: Any) -> Any:
    """In compiled code, look at the memory at an address as an array of a type and shape."""
    unpack: Any = cgutils.unpack_tuple
    populate: Any = populate_array

    @intrinsic
    def array(_context: Any, address: Any, shape: Any) -> Any:
        kind = types.Array(of, len(shape), "C")

        def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            place, sizes = arguments
            view = context.make_array(kind)(context, builder)
            size = context.get_abi_sizeof(context.get_data_type(of))
            lengths = [
                context.cast(builder, value, from_, types.intp)
                for value, from_ in zip(unpack(builder, sizes), shape, strict=True)
            ]
            strides = [context.get_constant(types.intp, size)]
            for length in lengths[:0:-1]:
                strides.insert(0, builder.mul(strides[0], length))
            populate(
                view, data=builder.inttoptr(place, view.data.type), shape=lengths, strides=strides,
                itemsize=context.get_constant(types.intp, size), meminfo=None,
            )
            return view._getvalue()

        return kind(types.int64, shape), generate

    return array


_f8, _f4, _i8 = _array_of(types.float64), _array_of(types.float32), _array_of(types.int64)
_u2, _i4 = _array_of(types.uint16), _array_of(types.int32)
_at_table, _at_state, _at_window, _at_link, _at_pulses = (
    _array_of(from_dtype(dtype)) for dtype in (_TABLE, STATE, WINDOW, _LINK, PULSE)
)
_at_constants, _at_law, _at_heat, _at_timing = (_array_of(from_dtype(_dtype_of(kind))) for kind in _RECORDS.values())


@compiled
def _arrays(at: Any, slices: int, rays: int, modes: int) -> Arrays:
    per_ray, laid, per_mode = (slices, rays), (slices, places(rays)), (2, modes)
    return Arrays(
        _f4(at.edge_um, per_ray), _f8(at.reference_um, (2, filled(slices))),
        _f8(at.pending_um2, laid), _f8(at.wire_q, per_mode), _f8(at.wire_v, per_mode),
        _f8(at.table_q, (2, 2)), _f8(at.table_v, (2, 2)), _f8(at.temperature_K, (slices,)),
        _f8(at.debris, (slices,)), _f8(at.carry_um2, (slices,)), _f4(at.distance, laid),
        _f4(at.cosine, laid), _f4(at.sine, laid), _i8(at.first, (slices,)), _i8(at.blocks, (slices,)),
        _i8(at.unbroken, (slices,)),
        _f8(at.ray_cosine, (rays,)), _f8(at.ray_sine, (rays,)),
        _f8(at.shape, (slices, modes)), _f8(at.sway, (modes, filled(slices))),
        _f8(at.mean_shape, (modes,)), _f8(at.flow_factor, (slices,)),
        _f8(at.table_shape, (2, 2)), _f8(at.table_participation, (2, 2)),
    )


@compiled
def _law(at: Any) -> GapLaw:
    """Constants of the gap as values, that the loop over the rays keeps in registers."""
    law = _at_law(at.law, (1,))[0]
    return GapLaw(
        law.t50_a, law.t50_b, law.t50_c, law.gap_scale, law.scaled_gap_floor_um, law.primed_gap_um,
        law.primed_per_um2, law.contact_gap_um, law.wire_curvature,
    )


@compiled
def _propagators(at: Any, modes: int) -> Propagators:
    table = (GRID + 1, 2, 2)
    return Propagators(
        _f8(at.wire, (GRID + 1, 4, modes)), _f8(at.wire_compliance, (modes,)),
        _f8(at.table11, table), _f8(at.table12, table),
        _f8(at.table21, table), _f8(at.table22, table),
    )


@compiled
def _scratch(at: Any, slices: int, modes: int) -> Scratch:
    return Scratch(
        _f8(at.position, (2, filled(slices))), _f8(at.load, (2, modes)), _f8(at.held, (2, modes)),
        _f8(at.sums, (slices, 4)), _f8(at.contact, (slices,)),
    )


@compiled
def _link(at: Any, nodes: int) -> FullLink:
    n = _at_link(at.link, (1,))[0]
    dofs = 2 * nodes + 4
    return FullLink(
        n.mj_step, n.model, n.data, _f8(at.link_timestep, (1,)), _f8(at.link_qpos, (dofs,)),
        _f8(at.link_qvel, (dofs,)), _f8(at.link_force, (dofs,)), _i8(at.link_wire, (2, nodes)),
        _i8(at.link_carriage, (2,)), _i8(at.link_rotor, (2,)), n.longest_us, n.reach_m, n.most_force_N,
        _f8(at.link_rad_per_um, (2,)), n.step_um, _f8(at.link_holding_Nm, (2,)), n.teeth, n.friction_N,
        n.presliding_m, _f8(at.link_friction_share, (2,)),
    )


CALL = 4
"""Numbers of a call for one plant (int64): address of its `Memory`'s table, address of the window's steps (int64;
time, axis and direction in a row), number of steps, and, written by the call, how the window ended."""


@functools.cache
def window_function(slices: int, rays: int, coordinates: int, full: bool) -> Callable[[int, int], None]:
    """Return the compiled window of one resolution; with `full`, MuJoCo moves wire and table, the wire's nodes.

    It takes the address of rows of `CALL` numbers and how many rows there are: one window for one plant each. One
    plant and a thousand run the same machine code, so that a plant's bits do not depend on its company.
    """

    @compiled
    def advance(calls: int, count: int) -> None:
        rows = _i8(calls, (count, CALL))
        for k in range(count):
            at = _at_table(rows[k, 0], (1,))[0]
            modes = filled(coordinates)
            rows[k, 3] = fire_window(
                _at_state(at.state, (1,)), _at_window(at.window, (1,)),
                _arrays(at, slices, rays, modes),
                _u2(at.tiles, (at.tile_count, slices, TILE, TILE)),
                _i4(at.index, (at.index_side, at.index_side)),
                _at_constants(at.constants, (1,))[0], _law(at),
                _at_heat(at.heat, (1,))[0], _at_timing(at.timing, (1,))[0],
                _propagators(at, modes), _scratch(at, slices, modes), _link(at, coordinates), full,
                _i8(rows[k, 1], (rows[k, 2], 3)), _at_pulses(at.pulses, (at.pulse_count,)),
            )

    return advance
