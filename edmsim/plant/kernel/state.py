"""The data of the pulse loop: constants, arrays, and the numbers that change from pulse to pulse.

A group is a named tuple whose fields are plain numbers or arrays. An array's field says in its type what its elements
are, how long it is along every direction, and how long it lasts:

>>> class Group(NamedTuple):
...     count: int
...     wire_q: Annotated[NDArray[np.float64], Stored(2, "modes", life=CHANGING)]

Memory, addresses and snapshots follow from that by name, so that fields cannot be mistaken for each other.
"""

import functools
import math
from typing import Annotated, Any, NamedTuple, TypeVar, cast, get_args, get_type_hints

import numpy as np
from numpy.typing import DTypeLike, NDArray

from edmsim.compiled.axis_rows import AXIS, DRIVE, MOTOR, N_AXES
from edmsim.compiled.jit import compiled
from edmsim.compiled.vectors import GAPS, filled, filled_packs, packed_lanes, packs
from edmsim.plant.axes.ways import WAY

Array = NDArray[np.float64]

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
    tiles: int
    index_side: int
    pulses: int
    levels: int


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


@compiled
def sizes_of(
    slices: int, rays: int, coordinates: int, tiles: int = 0, index_side: int = 0, pulses: int = 0, levels: int = 0
) -> ArraySizes:
    """Return the lengths by the numbers of slices, rays, and modes or nodes of the wire."""
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


MOST_ROWS = 256  # rows of cells across the metal that one ray stands for (ours: more than 200 um of it at 1 um)
TILE = 32  # cells along the side of a tile of the kerf field
GRID = 1000  # steps of the propagators' time grid over the longest period
OPEN, SPARK, ARC, SHORT = 0, 1, 2, 3  # classes of a pulse
ISO_PULSE, ISO_ENERGETIC, IGNITION_PULSE = 0, 1, 2  # modes of the pulse generator

STATE = on_lines(
    ("time_ns", "i8"),
    ("pulses", "i8"),  # fired so far
    ("key", "u8"),  # of the random draws
    ("draws", "u8"),  # how many there were
    ("commanded_um", "f8", N_AXES),  # setpoints: the steps of the axes added up
    ("axis_um", "f8", N_AXES),  # where the axes truly are, less the ringing of those under a stepper
    ("indicated_um", "f8", 2),  # where x and y would be without the errors of screws and ways
    ("slack_um", "f8", 2),  # by which that is behind a stepper's setpoint, in its nut
    ("since_discharge_us", "f8"),
    ("last_slice", "i8"),  # of the last discharge
    ("last_ray", "i8"),
    ("spot", "f8"),  # heat of the last hot spot
    ("chain_J", "f8"),  # heat that the last discharge and the arcs before it brought into one place of the wire
    ("chain_us", "f8"),  # over this time
    ("heat_wait_us", "f8"),  # time since heat and debris travelled last
    ("wear_wait_um3", "f8"),  # removed since the wire's wear was worked out last
    ("worn_share", "f8"),
    ("broken", "i8"),  # 1 if the wire broke, `BARE` without a wire
    ("broken_slice", "i8"),
    ("crater_um3", "f8"),  # sum of the craters drawn
    ("missed_um3", "f8"),  # what of them found no metal
    ("deflection_um", "f8", 2),  # mean of the last window
    ("tiled_um", "f8", N_AXES),  # places (x, y) of lower and upper guide around which the field has tiles
    ("traced_um", "f8", N_AXES),  # the axes' places when the rays were last traced
    ("traced_pulses", "i8"),  # pulses fired by then
    ("carved_pulses", "i8"),  # pulses whose craters are carved
    ("traces", "i8"),  # how often rays were traced with this wire
    ("film_kg_um2_s", "f8"),  # the films' resistance over the pull then
)
"""Numbers of a plant that change from pulse to pulse."""

WINDOW = on_lines(
    ("start_ns", "i8"),
    ("duration_ns", "i8"),
    ("counts", "i8", 4),  # by class of pulse
    ("voltage_us", "f8"),  # gap voltage over time, V us
    ("charge_A_us", "f8"),
    ("energy_J", "f8"),
    ("delay_us", "f8"),  # of all ignitions
    ("ignitions", "i8"),
    ("gap_um", "f8"),
    ("crater_um3", "f8"),
    ("deflection_um", "f8", 2),
    ("deflection2_um2", "f8", 2),  # of its square
    ("temperature_max_K", "f8"),
    ("debris", "f8"),  # mean over the slices at the window's end
    ("coverage", "f8"),  # the same
    ("broken", "i8"),
    ("fifths", "i8", 5),  # ignitions by where the currents of both contacts put them (`discharge.locate`)
)
"""Sums over one window of pulses."""

PULSE = np.dtype(
    [
        ("start_us", "f4"),  # since the window's start
        ("delay_us", "f4"),  # how long the open voltage stood
        ("conducting_us", "f4"),  # how long current flowed
        ("open_V", "f4"),
        ("gap_um", "f4"),  # where it discharged or touched, as the four below
        ("x_um", "f4"),  # the wire's place
        ("y_um", "f4"),
        ("kind", "i2"),  # class
        ("slice", "i2"),  # -1 where it has no place
        ("ray", "i2"),
        ("unused", "i2"),
    ]
)
"""One pulse of the log."""

NO_METAL_UM = 1.0e6  # distance of a ray that meets no metal: so far that it takes no part in anything
BARE = 2  # what `broken` is (1 if the wire broke) once the machine goes on without it
FINE, NO_TILES, STEP_WRONG, STEP_EARLY, BROKEN, NOT_FINITE, OUTSIDE, INSIDE = range(8)
"""How a window ended: as it should; not started: tiles of the field missing, an invalid step event, a step out of
order, or the wire broken before; stopped: NaN or infinite state, the wire beyond its guides, the wire deeper in the
metal than its rays reach."""
TILED_UM = 64.0  # the field has the tiles of a window while the wire is within this of where they were made


class Constants(NamedTuple):
    """Numbers of one set-up that the loop needs; um and us unless said otherwise."""

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
    current_A: float  # mean of a discharge
    short_A: float  # mean of a short circuit
    current_form: float  # mean square over squared mean: 1 for a rectangle, 4/3 for a triangle
    on_us: float  # t(i): on-time for iso-pulse, duration of the discharge otherwise
    wait_us: float  # longest time to ignition
    arc_share: float  # duration of a discharge that ignites at once, over that of any other
    pause_us: float  # t(0) after a stretched pulse
    period_ns: int  # t(p) of a fixed period; 0 if it varies
    grid_us: float  # step of the propagators' grid; a whole number of ns if the period varies


class Propagators(NamedTuple):
    """Exact 2x2 propagators of every mode over ``k * grid_us``: elements 11, 12, 21, 22."""

    wire: Annotated[Array, Stored(GRID + 1, 4, "modes")]  # one row of the table lies together in memory
    wire_compliance: Annotated[Array, Stored("modes")]  # 1/omega^2
    # what a force on a slice that stands all the time has done to the slice's own place (um per um kg/s2), and speed
    yielding: Annotated[Array, Stored(GRID + 1, "slices", 2)]
    table11: Annotated[Array, Stored(GRID + 1, 2, 2)]
    table12: Annotated[Array, Stored(GRID + 1, 2, 2)]
    table21: Annotated[Array, Stored(GRID + 1, 2, 2)]
    table22: Annotated[Array, Stored(GRID + 1, 2, 2)]


class Axes(NamedTuple):
    """The machine's axes with the drives that have a loop; their rows mean nothing for an axis under a stepper."""

    rows: Annotated[NDArray[np.void], Stored(N_AXES, life=CHANGING, record=AXIS)]
    drives: Annotated[NDArray[np.void], Stored(N_AXES, life=CHANGING, record=DRIVE)]
    motors: Annotated[NDArray[np.void], Stored(N_AXES, record=MOTOR)]
    ways: Annotated[NDArray[np.void], Stored(2, record=WAY)]  # errors of screws and ways of x and y
    step_ns: Annotated[NDArray[np.int64], Stored(N_AXES)]  # longest time step
    loops: int  # how many drives have a loop
    errs: int  # whether `ways` has any error


class Arrays(NamedTuple):
    """Arrays of one plant."""

    # slices and coordinates are filled up to whole vectors (`vectors.COORDINATES`): with slices that lie nowhere,
    # with nodes that do not move. Shares of a front or of water are between 0 and 1
    edge_um: Annotated[NDArray[np.float32], Stored("slices", "rays", life=WALL)]  # gap of a ray from `reference_um`
    # where the wire was when the rays were traced: as it swings, its rays look everywhere in time, also between the
    # lines they look along now
    reference_um: Annotated[Array, Stored(2, "slices_filled", life=WALL)]
    # volume over the slice's height of craters that fell on a ray and are not carved yet
    pending_um2: Annotated[Array, Stored("slices", "places", life=WALL)]
    wire_q: Annotated[Array, Stored(2, "modes", life=CHANGING)]  # modal deflection along x and y, um sqrt(kg)
    wire_v: Annotated[Array, Stored(2, "modes", life=CHANGING)]  # its velocity, um sqrt(kg)/s
    table_q: Annotated[Array, Stored(2, 2, life=CHANGING)]  # ringing of x and y around `axis_um`
    table_v: Annotated[Array, Stored(2, 2, life=CHANGING)]
    # load on the modal coordinates that stands for many pulses, um kg/s2: magnetic force and jets
    steady: Annotated[Array, Stored(2, "modes", life=CHANGING)]
    temperature_K: Annotated[Array, Stored("slices", life=CHANGING)]  # of the wire
    debris: Annotated[Array, Stored("slices_filled", life=CHANGING)]  # share of the water
    carry_um2: Annotated[Array, Stored("slices", life=WALL)]  # carved volume too small for a part of a cell
    # integrals of current squared (A2 us) since heat was propagated last, of the discharges in each slice: below it
    # and above it in the wire
    current2_us: Annotated[Array, Stored(2, "slices", life=CHANGING)]
    steam: Annotated[Array, Stored("slices_filled", life=CHANGING)]  # share of the front it covers
    gas: Annotated[Array, Stored("slices_filled", life=CHANGING)]  # permanent gas
    covered: Annotated[Array, Stored("slices_filled", life=CHANGING)]  # either
    wake_debris: Annotated[Array, Stored("slices_filled", life=CHANGING)]  # in the water of the kerf behind the wire
    wake_gas: Annotated[Array, Stored("slices_filled", life=CHANGING)]
    # what the loop sees of the rays, see `rays.Rays`: `edge_um` less what craters took since
    distance: Annotated[NDArray[np.float32], Stored("slices", "places", life=WALL)]
    cosine: Annotated[NDArray[np.float32], Stored("slices", "places", life=WALL)]
    sine: Annotated[NDArray[np.float32], Stored("slices", "places", life=WALL)]
    first: Annotated[NDArray[np.int64], Stored("slices", life=WALL)]
    blocks: Annotated[NDArray[np.int64], Stored("slices", life=WALL)]
    unbroken: Annotated[NDArray[np.int64], Stored("slices", life=WALL)]
    # the same again for the sums of every pulse: see `rays.pack_rays`
    packed_gap: Annotated[NDArray[np.float32], Stored("packs", "packed_lanes")]
    packed_cosine: Annotated[NDArray[np.float32], Stored("packs", "packed_lanes")]
    packed_sine: Annotated[NDArray[np.float32], Stored("packs", "packed_lanes")]
    packed_blocks: Annotated[NDArray[np.int64], Stored("packs")]
    ray_cosine: Annotated[Array, Stored("rays")]  # directions square to the wire
    ray_sine: Annotated[Array, Stored("rays")]
    # way in a slice's plane to a point 1 um along a ray of a wire that leans: its section there is an ellipse
    reach_x: Annotated[Array, Stored("rays", life=WALL)]
    reach_y: Annotated[Array, Stored("rays", life=WALL)]
    # by how much a ray's gap narrows where the wire moves along x and y: also the share of a force along the ray that
    # acts in the slice's plane
    across_x: Annotated[Array, Stored("rays", life=WALL)]
    across_y: Annotated[Array, Stored("rays", life=WALL)]
    upright: Annotated[Array, Stored(1, life=WALL)]  # cosine of the angle between that wire and the vertical
    shape: Annotated[Array, Stored("slices", "modes")]  # displacement of a slice per unit of modal coordinate
    sway: Annotated[Array, Stored("modes", "slices_filled")]  # the same, transposed
    mean_shape: Annotated[Array, Stored("modes")]  # its mean over the slices
    slice_mass_kg: Annotated[Array, Stored("slices")]  # that an impulse on a slice moves there
    mobility: Annotated[Array, Stored("modes")]  # rate at which 1 kg/s on every slice damps a coordinate, 1/s
    inertia: Annotated[Array, Stored("modes")]  # mean square of the slices' speed per square of a coordinate's
    # share of the upper guide's lead by which a slice is led: its height's, but for where the wire bends
    lean_share: Annotated[Array, Stored("slices_filled", life=WALL)]
    height_share: Annotated[Array, Stored("slices_filled")]  # height above the lower guide over the guides' distance
    # way of the water past a slice in 1 us, over that after which nothing is left of what prepares a breakdown
    carried_per_us: Annotated[Array, Stored("slices")]
    convection_W_m2K: Annotated[Array, Stored("slices")]  # heat transfer without boiling
    critical_W_m2: Annotated[Array, Stored("slices")]  # largest heat flux by boiling
    jet_um_kg_s2: Annotated[Array, Stored("slices")]  # force of the jets that turn into the kerf behind the wire
    # water that enters a slice from the lower and the upper nozzle, of what leaves that nozzle
    flow_share: Annotated[Array, Stored(2, "slices")]
    table_shape: Annotated[Array, Stored(2, 2)]
    table_participation: Annotated[Array, Stored(2, 2)]
    # height of the metal that a ray meets over the slice's: 1 but for the topmost slice of a lower place
    ray_metal: Annotated[NDArray[np.float32], Stored("slices", "rays", life=WALL)]
    # its mean over a slice's rays that meet metal, the nearer the more, and 1 if none does
    metal: Annotated[Array, Stored("slices_filled", life=WALL)]
    # `flow_share` over the height of a slice's metal: the less of it, the sooner the water beside it has changed
    entering: Annotated[Array, Stored(2, "slices", life=WALL)]


class Scratch(NamedTuple):
    """Room for what the loop computes again every pulse; it allocates nothing itself."""

    position: Annotated[Array, Stored(2, "slices_filled")]
    load: Annotated[Array, Stored(2, "modes")]
    held: Annotated[Array, Stored(2, "modes")]
    sums: Annotated[Array, Stored("slices", 4)]  # see `breakdown.slice_sums`
    contact: Annotated[Array, Stored("slices")]
    films: Annotated[Array, Stored("slices", 6)]  # see `film.find_films`
    rows: Annotated[Array, Stored(2, MOST_ROWS)]  # see `kerf_field.carve_wall`


class Own(NamedTuple):
    """Rows of one plant's scalars, its kerf field, and the log of a window's pulses, empty if none is wanted."""

    # ``levels``, the heights of the blank over a slice's, is empty where the blank is as high everywhere
    state: Annotated[NDArray[np.void], Stored(1, record=STATE)]
    window: Annotated[NDArray[np.void], Stored(1, record=WINDOW)]
    tiles: Annotated[NDArray[np.uint16], Stored("tiles", "slices", TILE, TILE)]
    tile_index: Annotated[NDArray[np.int32], Stored("index_side", "index_side")]
    levels: Annotated[NDArray[np.float32], Stored("levels", TILE, TILE)]
    pulses: Annotated[NDArray[np.void], Stored("pulses", record=PULSE)]
