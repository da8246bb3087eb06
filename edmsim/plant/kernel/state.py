"""The data of the pulse loop: constants, arrays, and numbers that change from pulse to pulse.

A group is a named tuple whose fields are numbers or arrays. The type of an array's field declares its elements, shape
and lifetime:

>>> class Group(NamedTuple):
...     count: int
...     wire_q: Annotated[NDArray[np.float64], Stored(2, "modes", life=CHANGING)]

Memory, addresses and snapshots use these names, so fields cannot be confused.
"""

import functools
import math
from typing import Annotated, Any, NamedTuple, TypeVar, cast, get_args, get_type_hints

import numpy as np
from numpy.typing import DTypeLike, NDArray

from edmsim.compiled.axis_rows import AXIS, DRIVE, MOTOR, N_AXES
from edmsim.compiled.jit import compiled
from edmsim.compiled.vectors import GAPS, filled, filled_packs, packed_lanes, packs
from edmsim.plant.axes.geometric_errors import AXIS_ERRORS

Array = NDArray[np.float64]

FIXED, WALL, CHANGING = range(3)
"""Lifetimes of an array's content: that of the set-up; that of the workpiece (metal and craters, which outlast the
wire); that of the wire. A snapshot contains arrays of the last two."""

_LINE = 64  # bytes of a cache line of the processor
FREE = "free"  # field that pads a record to whole cache lines
_Group = TypeVar("_Group", bound=NamedTuple)


def on_lines(*fields: tuple[Any, ...]) -> np.dtype[np.void]:
    """Return a record padded to whole cache lines, so that threads do not write to the same line."""
    free = -np.dtype(list(fields)).itemsize % _LINE
    return np.dtype([*fields, (FREE, "u1", (free,))] if free else list(fields))


class ArraySizes(NamedTuple):
    """Lengths that shapes use by name; ``modes`` is the number of modes or nodes of the wire, in whole vectors."""

    slices: int
    slices_filled: int
    packs: int
    rays: int
    places: int
    packed_lanes: int
    modes: int
    nodes: int
    dofs: int
    tiles: int
    index_side: int
    pulses: int
    levels: int


class Stored:
    """Shape of a declared array as numbers or names of `ArraySizes`; its lifetime; its record type, if any."""

    def __init__(self, *shape: int | str, life: int = FIXED, record: np.dtype[np.void] | None = None) -> None:
        self.shape, self.life, self.record = shape, life, record

    def lengths(self, sizes: ArraySizes) -> tuple[int, ...]:
        """Return the shape in numbers."""
        return tuple([getattr(sizes, n) if isinstance(n, str) else n for n in self.shape])


class Field(NamedTuple):
    """One declared field; ``stored`` is None for a number."""

    name: str
    dtype: np.dtype[Any]
    stored: Stored | None


@compiled
def sizes_of(
    slices: int, rays: int, coordinates: int, tiles: int = 0, index_side: int = 0, pulses: int = 0, levels: int = 0
) -> ArraySizes:
    """Return all lengths for a number of slices, rays, and modes or nodes of the wire."""
    return ArraySizes(
        slices, filled_packs(slices), packs(slices), rays, filled(rays, GAPS), packed_lanes(rays),
        filled(coordinates), coordinates, 2 * coordinates + 4, tiles, index_side, pulses, levels,
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
        last = get_args(array)[-1]  # the dtype, or from numpy 2.5 on its scalar
        element = get_args(last)[0] if get_args(last) else last
        found.append(Field(name, np.dtype(element) if stored.record is None else stored.record, stored))
    return tuple(found)


@functools.cache
def numbers_of(group: type) -> np.dtype[np.void]:
    """Return the record type of a group of numbers; compiled code reads it by the same names."""
    return np.dtype([(name, dtype) for name, dtype, _ in fields_of(group)])


@functools.cache
def entries_of(group: type) -> np.dtype[np.void]:
    """Return the record type of a group in the loop's table: its numbers, and the addresses of its arrays."""
    return np.dtype([(name, dtype if stored is None else np.dtype("i8")) for name, dtype, stored in fields_of(group)])


def lasting(group: type, *lives: int) -> tuple[str, ...]:
    """Return the names of a group's arrays with a lifetime."""
    return tuple(name for name, _, stored in fields_of(group) if stored is not None and stored.life in lives)


def allocate(group: type[_Group], sizes: ArraySizes, **numbers: float) -> _Group:
    """Return a group with its numbers and with arrays of zeros, each aligned to a cache line."""
    # an unaligned vector of 16 gaps takes two reads
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
    """Refuse an array that differs from its declaration; compiled code would read beyond its end."""
    assert field.stored is not None
    declared: tuple[DTypeLike, tuple[int, ...]] = field.dtype, field.stored.lengths(sizes)
    if (array.dtype, array.shape) != declared or not array.flags.c_contiguous:
        raise TypeError(f"{field.name} is {array.dtype} {array.shape}, declared as {declared[0]} {declared[1]}")


MOST_ROWS = 256  # rows of cells across the metal of one ray (ours: more than 200 um at cells of 1 um)
TILE = 32  # cells along the side of a tile of the kerf field
GRID = 1000  # steps of the propagators' time grid over the longest period
OPEN, SPARK, ARC, SHORT = 0, 1, 2, 3  # outcomes of a pulse
ISO_PULSE, ISO_ENERGETIC, IGNITION_PULSE = 0, 1, 2  # modes of the pulse generator

STATE = on_lines(
    ("time_ns", "i8"),
    ("pulses", "i8"),  # pulses fired so far
    ("key", "u8"),  # key of the random draws
    ("draws", "u8"),  # number of draws so far
    ("commanded_um", "f8", N_AXES),  # setpoints: sums of the axes' steps
    ("axis_um", "f8", N_AXES),  # true positions of the axes, without the ringing of stepper axes
    ("indicated_um", "f8", 2),  # positions of x and y without the errors of screws and ways
    ("slack_um", "f8", 2),  # backlash by which they are behind a stepper's setpoint
    ("since_discharge_us", "f8"),
    ("last_slice", "i8"),  # slice of the last discharge
    ("last_ray", "i8"),
    ("spot", "f8"),  # heat of the present hot spot
    ("chain_J", "f8"),  # heat of the last discharge and its chain of arcs in one spot of the wire
    ("chain_us", "f8"),  # duration of this chain
    ("heat_wait_us", "f8"),  # time since heat and debris were propagated
    ("wear_wait_um3", "f8"),  # volume removed since the wire's wear was updated
    ("worn_share", "f8"),
    ("broken", "i8"),  # 1 if the wire broke, `BARE` without a wire
    ("broken_slice", "i8"),
    ("crater_um3", "f8"),  # sum of the craters drawn
    ("missed_um3", "f8"),  # part of them that found no metal
    ("deflection_um", "f8", 2),  # mean of the last window
    ("tiled_um", "f8", N_AXES),  # positions (x, y) of lower and upper guide around which the field has tiles
    ("traced_um", "f8", N_AXES),  # positions of the axes when the rays were last traced
    ("traced_pulses", "i8"),  # pulses fired until then
    ("carved_pulses", "i8"),  # pulses whose craters have been carved
    ("traces", "i8"),  # number of tracings with this wire
    ("film_kg_um2_s", "f8"),  # resistance of the films over the pull at the last tracing
)
"""Numbers of a plant that change from pulse to pulse."""

WINDOW = on_lines(
    ("start_ns", "i8"),
    ("duration_ns", "i8"),
    ("counts", "i8", 4),  # number of pulses by outcome
    ("voltage_us", "f8"),  # integral of the gap voltage, V us
    ("charge_A_us", "f8"),
    ("energy_J", "f8"),
    ("delay_us", "f8"),  # sum of the ignition delays
    ("ignitions", "i8"),
    ("gap_um", "f8"),
    ("crater_um3", "f8"),
    ("deflection_um", "f8", 2),
    ("deflection2_um2", "f8", 2),  # sum of the squares
    ("temperature_max_K", "f8"),
    ("debris", "f8"),  # mean over the slices at the window's end
    ("coverage", "f8"),  # mean over the slices at the window's end
    ("broken", "i8"),
    ("fifths", "i8", 5),  # ignitions by the height that the currents of both contacts indicate (`discharge.locate`)
)
"""Sums over one window of pulses."""

PULSE = np.dtype(
    [
        ("start_us", "f4"),  # since the beginning of the window
        ("delay_us", "f4"),  # duration of the open voltage
        ("conducting_us", "f4"),  # duration of the current
        ("open_V", "f4"),
        ("gap_um", "f4"),  # at the place of discharge or contact, like the fields below
        ("x_um", "f4"),  # position of the wire
        ("y_um", "f4"),
        ("kind", "i2"),  # outcome
        ("slice", "i2"),  # -1 for a pulse without a place
        ("ray", "i2"),
        ("unused", "i2"),
    ]
)
"""One pulse of the log."""

NO_METAL_UM = 1.0e6  # distance of a ray without metal: so large that it has no effect
BARE = 2  # value of `broken` (1 if the wire broke) while the machine continues without a wire
FINE, NO_TILES, STEP_WRONG, STEP_EARLY, BROKEN, NOT_FINITE, OUTSIDE, INSIDE = range(8)
"""How a window ended: normally; not started, because tiles of the field are missing, an event is invalid, events are
out of order, or the wire is broken; stopped, because a value is not finite, the wire is out of range, or it is deeper
in the metal than its rays reach."""
TILED_UM = 64.0  # distance from the centre of the tiles within which the wire has all tiles of a window


class Constants(NamedTuple):
    """Constants of a set-up that the loop needs; lengths in um and times in us unless the name says otherwise."""

    radius_um: float
    slice_um: float
    cell_um: float
    range_um: float
    trace_pulses: int
    carve_before_um: float
    patch_m2: float
    permittivity_F_m: float
    leak_S_um: float
    supply_ohm: float
    formative_us: float
    formative_sd_us: float
    primed_scale_us: float
    primed_shape: float
    deionisation_us: float
    chaining: float
    bridge_base: float
    bridge_per_um: float
    bridge_ceiling: float
    bridge_steepness: float
    crater_cv: float
    crater_cube: float  # cube of a crater's diameter over its volume
    short_removal_share: float
    short_push_share: float
    shielding: float
    dryness: float
    pumping: float
    ejection: float
    film_um3_kg_s: float
    film_from_um: float
    film_spans: int
    film_pull_um2: float
    jet_kg_um: float
    suction_N: float
    magnetic_N_A2: float
    spot_gain: float
    spot_us: float
    wire_heat_share: float
    lower_flow_us: float
    upper_flow_us: float
    lower_wake_us: float
    upper_wake_us: float
    cavity_um3: float
    wake_um3: float
    gas_um3_J: float
    tension_N: float
    strength_N: float
    half_strength_K: float
    water_K: float
    worn_share_per_um3_us: float
    step_um: float
    guides_um: float
    lower_bend_um: float
    upper_bend_um: float
    guide_radius_um: float


class Timing(NamedTuple):
    """One setting of the pulse generator."""

    mode: int  # `ISO_PULSE`, `ISO_ENERGETIC` or `IGNITION_PULSE`
    open_V: float
    burning_V: float
    removal_um3_J: float  # metal removed per joule by discharges of this length
    current_A: float  # mean current of a discharge
    short_A: float  # mean current of a short circuit
    current_form: float  # mean square over squared mean of the current: 1 for a rectangle, 4/3 for a triangle
    on_us: float  # t(i): on-time for iso-pulse, duration of the discharge otherwise
    wait_us: float  # longest time to ignition
    arc_share: float  # duration of an arc over that of a spark
    pause_us: float  # t(0) after a stretched pulse
    period_ns: int  # t(p) of a fixed period; 0 if it varies
    grid_us: float  # step of the propagators' time grid; a whole number of ns if the period varies


class Propagators(NamedTuple):
    """Exact 2x2 propagators of every mode over ``k * grid_us``: elements 11, 12, 21, 22."""

    wire: Annotated[Array, Stored(GRID + 1, 4, "modes")]  # each row of the table is contiguous in memory
    wire_compliance: Annotated[Array, Stored("modes")]  # 1/omega^2
    # response of a slice's position (um per um kg/s2) and speed to a constant force on it
    yielding: Annotated[Array, Stored(GRID + 1, "slices", 2)]
    table11: Annotated[Array, Stored(GRID + 1, 2, 2)]
    table12: Annotated[Array, Stored(GRID + 1, 2, 2)]
    table21: Annotated[Array, Stored(GRID + 1, 2, 2)]
    table22: Annotated[Array, Stored(GRID + 1, 2, 2)]


class Axes(NamedTuple):
    """The machine's axes and servo drives; rows of stepper axes are not used."""

    rows: Annotated[NDArray[np.void], Stored(N_AXES, life=CHANGING, record=AXIS)]
    drives: Annotated[NDArray[np.void], Stored(N_AXES, life=CHANGING, record=DRIVE)]
    motors: Annotated[NDArray[np.void], Stored(N_AXES, record=MOTOR)]
    geometric_errors: Annotated[NDArray[np.void], Stored(2, record=AXIS_ERRORS)]  # of screws and ways of x and y
    step_ns: Annotated[NDArray[np.int64], Stored(N_AXES)]  # longest time step
    loops: int  # number of servo drives
    errs: int  # whether `geometric_errors` has any


class Arrays(NamedTuple):
    """Arrays of one plant."""

    # Slices and coordinates are padded to whole vectors (`vectors.COORDINATES`), with slices without effect and nodes
    # that do not move. Shares of the front or of water are between 0 and 1.
    edge_um: Annotated[NDArray[np.float32], Stored("slices", "rays", life=WALL)]  # gap of a ray from `reference_um`
    # Position of the wire when the rays were traced. As the wire vibrates, its rays cover over time also the places
    # between their present lines.
    reference_um: Annotated[Array, Stored(2, "slices_filled", life=WALL)]
    # volume over the slice's height of the craters of a ray that are not carved yet
    pending_um2: Annotated[Array, Stored("slices", "places", life=WALL)]
    wire_q: Annotated[Array, Stored(2, "modes", life=CHANGING)]  # modal deflection in x and y, um sqrt(kg)
    wire_v: Annotated[Array, Stored(2, "modes", life=CHANGING)]  # its velocity, um sqrt(kg)/s
    table_q: Annotated[Array, Stored(2, 2, life=CHANGING)]  # ringing of x and y around `axis_um`
    table_v: Annotated[Array, Stored(2, 2, life=CHANGING)]
    # load on the modal coordinates that is constant for many pulses, um kg/s2: magnetic force and jets
    steady: Annotated[Array, Stored(2, "modes", life=CHANGING)]
    temperature_K: Annotated[Array, Stored("slices", life=CHANGING)]  # of the wire
    debris: Annotated[Array, Stored("slices_filled", life=CHANGING)]  # share of the water
    carry_um2: Annotated[Array, Stored("slices", life=WALL)]  # volume to carve that is smaller than a part of a cell
    # integrals of the squared current (A2 us) since heat was propagated, from the discharges of each slice: in the
    # wire below it and above it
    current2_us: Annotated[Array, Stored(2, "slices", life=CHANGING)]
    steam: Annotated[Array, Stored("slices_filled", life=CHANGING)]  # share of the front that it covers
    gas: Annotated[Array, Stored("slices_filled", life=CHANGING)]  # permanent gas
    covered: Annotated[Array, Stored("slices_filled", life=CHANGING)]  # share covered by steam or gas
    wake_debris: Annotated[Array, Stored("slices_filled", life=CHANGING)]  # debris in the kerf behind the wire
    wake_gas: Annotated[Array, Stored("slices_filled", life=CHANGING)]
    # rays in the order of the loop, see `rays.Rays`: `edge_um` without the craters since
    distance: Annotated[NDArray[np.float32], Stored("slices", "places", life=WALL)]
    cosine: Annotated[NDArray[np.float32], Stored("slices", "places", life=WALL)]
    sine: Annotated[NDArray[np.float32], Stored("slices", "places", life=WALL)]
    first: Annotated[NDArray[np.int64], Stored("slices", life=WALL)]
    blocks: Annotated[NDArray[np.int64], Stored("slices", life=WALL)]
    unbroken: Annotated[NDArray[np.int64], Stored("slices", life=WALL)]
    # copies for the sums of every pulse: see `rays.pack_rays`
    packed_gap: Annotated[NDArray[np.float32], Stored("packs", "packed_lanes")]
    packed_cosine: Annotated[NDArray[np.float32], Stored("packs", "packed_lanes")]
    packed_sine: Annotated[NDArray[np.float32], Stored("packs", "packed_lanes")]
    packed_blocks: Annotated[NDArray[np.int64], Stored("packs")]
    ray_cosine: Annotated[Array, Stored("rays")]  # directions perpendicular to the wire
    ray_sine: Annotated[Array, Stored("rays")]
    # components in the slice's plane of 1 um along a ray of a tilted wire, whose section there is an ellipse
    reach_x: Annotated[Array, Stored("rays", life=WALL)]
    reach_y: Annotated[Array, Stored("rays", life=WALL)]
    # change of a ray's gap per motion of the wire in x and y; also the components in the slice's plane of a force
    # along the ray
    across_x: Annotated[Array, Stored("rays", life=WALL)]
    across_y: Annotated[Array, Stored("rays", life=WALL)]
    upright: Annotated[Array, Stored(1, life=WALL)]  # cosine of the angle between the wire and the vertical
    shape: Annotated[Array, Stored("slices", "modes")]  # displacement of a slice per unit of modal coordinate
    sway: Annotated[Array, Stored("modes", "slices_filled")]  # the same, transposed
    mean_shape: Annotated[Array, Stored("modes")]  # its mean over the slices
    slice_mass_kg: Annotated[Array, Stored("slices")]  # effective mass for an impulse on the slice
    mobility: Annotated[Array, Stored("modes")]  # damping rate of a coordinate by 1 kg/s on every slice, 1/s
    inertia: Annotated[Array, Stored("modes")]  # mean square speed of the slices per squared speed of a coordinate
    # share of the upper guide's lead in a slice: its height share, apart from the bends at the guides
    lean_share: Annotated[Array, Stored("slices_filled", life=WALL)]
    height_share: Annotated[Array, Stored("slices_filled")]  # height above the lower guide over the guides' distance
    # distance that the water moves past a slice in 1 us, over the length that ends the preparation of a breakdown
    carried_per_us: Annotated[Array, Stored("slices")]
    convection_W_m2K: Annotated[Array, Stored("slices")]  # heat transfer coefficient without boiling
    critical_W_m2: Annotated[Array, Stored("slices")]  # critical heat flux of boiling
    jet_um_kg_s2: Annotated[Array, Stored("slices")]  # force of the jets that turn into the kerf behind the wire
    # share of the lower and the upper nozzle's water that enters a slice
    flow_share: Annotated[Array, Stored(2, "slices")]
    table_shape: Annotated[Array, Stored(2, 2)]
    table_participation: Annotated[Array, Stored(2, 2)]
    # height of a ray's metal over that of the slice: 1 except in the topmost slice of a lower place
    ray_metal: Annotated[NDArray[np.float32], Stored("slices", "rays", life=WALL)]
    # its mean over a slice's rays with metal, weighted by nearness; 1 if there are none
    metal: Annotated[Array, Stored("slices_filled", life=WALL)]
    # `flow_share` over the height of a slice's metal: water next to less metal is replaced sooner
    entering: Annotated[Array, Stored(2, "slices", life=WALL)]


class Scratch(NamedTuple):
    """Buffers for results of a pulse, because the loop must not allocate."""

    position: Annotated[Array, Stored(2, "slices_filled")]
    load: Annotated[Array, Stored(2, "modes")]
    held: Annotated[Array, Stored(2, "modes")]
    sums: Annotated[Array, Stored("slices", 4)]  # see `breakdown.slice_sums`
    contact: Annotated[Array, Stored("slices")]
    films: Annotated[Array, Stored("slices", 6)]  # see `squeeze_film.find_films`
    rows: Annotated[Array, Stored(2, MOST_ROWS)]  # see `kerf_field.carve_wall`


class Own(NamedTuple):
    """Records of one plant's scalars, its kerf field, and the log of a window's pulses, which may be empty."""

    # ``levels``, heights of the blank over that of a slice, is empty if the blank has the same height everywhere
    state: Annotated[NDArray[np.void], Stored(1, record=STATE)]
    window: Annotated[NDArray[np.void], Stored(1, record=WINDOW)]
    tiles: Annotated[NDArray[np.uint16], Stored("tiles", "slices", TILE, TILE)]
    tile_index: Annotated[NDArray[np.int32], Stored("index_side", "index_side")]
    levels: Annotated[NDArray[np.float32], Stored("levels", TILE, TILE)]
    pulses: Annotated[NDArray[np.void], Stored("pulses", record=PULSE)]
