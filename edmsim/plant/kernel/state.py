"""What the pulse loop works on: constants, arrays, and the numbers that change from pulse to pulse."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.axis_rows import AXIS, DRIVE, MOTOR, N_AXES
from edmsim.plant.axes.ways import WAY
from edmsim.plant.kernel.declare import CHANGING, WALL, Stored

Array = NDArray[np.float64]

TILE = 32
"""Cells along the side of a tile of the kerf field."""
GRID = 1000
"""Steps of the propagators' time grid over the longest period."""
OPEN, SPARK, ARC, SHORT = 0, 1, 2, 3
"""Classes of a pulse."""
ISO_PULSE, ISO_ENERGETIC, IGNITION_PULSE = 0, 1, 2
"""Modes of the pulse generator."""

STATE = np.dtype(
    [
        ("time_ns", "i8"),
        ("pulses", "i8"),
        ("key", "u8"),
        ("draws", "u8"),
        ("commanded_um", "f8", N_AXES),
        ("axis_um", "f8", N_AXES),
        ("indicated_um", "f8", 2),
        ("slack_um", "f8", 2),
        ("since_discharge_us", "f8"),
        ("last_slice", "i8"),
        ("last_ray", "i8"),
        ("spot", "f8"),
        ("chain_J", "f8"),
        ("chain_us", "f8"),
        ("heat_wait_us", "f8"),
        ("wear_wait_um3", "f8"),
        ("worn_share", "f8"),
        ("broken", "i8"),
        ("broken_slice", "i8"),
        ("crater_um3", "f8"),
        ("missed_um3", "f8"),
        ("deflection_um", "f8", 2),
        ("tiled_um", "f8", N_AXES),
        ("traced_um", "f8", N_AXES),
        ("traced_pulses", "i8"),
        ("carved_pulses", "i8"),
        ("traces", "i8"),
        ("film_kg_um2_s", "f8"),
    ]
)
"""Scalars of a plant's state. ``commanded_um`` are the axes' setpoints, their steps added up; ``axis_um`` is where
the axes are, less the ringing of those under a stepper, for which both are equal. Where screws and ways have errors,
``indicated_um`` is where x and y would be without them, less than the setpoint of a stepper by ``slack_um`` in its
nut, and ``axis_um`` is where they truly are. ``crater_um3`` sums the craters
drawn, ``missed_um3`` what found no metal; ``deflection_um`` is the last window's mean, ``tiled_um`` the places (x, y)
of the wire at the lower and the upper guide around which the field has tiles; ``traced_um`` and ``traced_pulses`` are
the axes' places and the pulses fired when the rays were last traced, ``traces`` how often that was with this wire,
``chain_J`` is the heat that the last discharge and the arcs before it have brought into one place of the wire, over
``chain_us``; ``film_kg_um2_s`` the films' resistance over the pull then, ``carved_pulses`` the pulses whose craters
are carved."""

WINDOW = np.dtype(
    [
        ("start_ns", "i8"),
        ("duration_ns", "i8"),
        ("counts", "i8", 4),
        ("voltage_us", "f8"),
        ("charge_A_us", "f8"),
        ("energy_J", "f8"),
        ("delay_us", "f8"),
        ("ignitions", "i8"),
        ("gap_um", "f8"),
        ("crater_um3", "f8"),
        ("deflection_um", "f8", 2),
        ("deflection2_um2", "f8", 2),
        ("temperature_max_K", "f8"),
        ("debris", "f8"),
        ("coverage", "f8"),
        ("broken", "i8"),
        ("fifths", "i8", 5),
    ]
)
"""Sums over one window of pulses; debris and coverage are means over the slices at its end. ``fifths`` are the
ignitions by where the currents of the two contacts put them (see `discharge.locate`)."""

PULSE = np.dtype(
    [
        ("start_us", "f4"),
        ("delay_us", "f4"),
        ("conducting_us", "f4"),
        ("open_V", "f4"),
        ("gap_um", "f4"),
        ("x_um", "f4"),
        ("y_um", "f4"),
        ("kind", "i2"),
        ("slice", "i2"),
        ("ray", "i2"),
        ("unused", "i2"),
    ]
)
"""One pulse: its begin since the window's; how long the open voltage stood and current flowed; that voltage; gap, the
wire's place and ray where it discharged or touched; its class; its slice, -1 where it has no place."""

NO_METAL_UM = 1.0e6
"""Distance of a ray that meets no metal: so far that it takes no part in anything."""
BARE = 2
"""What `broken` is (1 if the wire broke) once the machine goes on without it."""
FINE, NO_TILES, STEP_WRONG, STEP_EARLY, BROKEN, NOT_FINITE, OUTSIDE, INSIDE = range(8)
"""How a window ended: as it should; not started: tiles of the field missing, an invalid step event, a step out of
order, or the wire broken before; stopped: NaN or infinite state, the wire beyond its guides, the wire deeper in the
metal than its rays reach."""
TILED_UM = 64.0
"""The field has all the tiles a window may need as long as the wire is within this of where they were made."""


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
    crater_flatness: float
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
    """One setting of the pulse generator.

    Attributes
    ----------
    mode : int
        `ISO_PULSE`, `ISO_ENERGETIC` or `IGNITION_PULSE`.
    open_V, burning_V : float
        Voltage until ignition and while burning.
    removal_um3_J : float
        Metal removed per joule by discharges of this length.
    current_A, short_A : float
        Mean current of a discharge and of a short circuit.
    current_form : float
        Mean of their current's square over the square of that mean: 1 for a rectangle, 4/3 for a triangle.
    on_us : float
        t(i): on-time for iso-pulse, duration of the discharge otherwise.
    wait_us : float
        Longest time to ignition.
    arc_share : float
        Duration of a discharge that ignites at once, over that of any other.
    pause_us : float
        t(0) after a stretched pulse.
    period_ns : int
        t(p) of a fixed period; 0 if it varies.
    grid_us : float
        Step of the propagators' grid; a whole number of ns if the period varies.
    """

    mode: int
    open_V: float
    burning_V: float
    removal_um3_J: float
    current_A: float
    short_A: float
    current_form: float
    on_us: float
    wait_us: float
    arc_share: float
    pause_us: float
    period_ns: int
    grid_us: float


class Propagators(NamedTuple):
    """Exact 2x2 propagators of every mode over ``k * grid_us``.

    Attributes
    ----------
    wire : (GRID + 1, 4, modes filled)
        Elements 11, 12, 21, 22; one row of the table lies together in memory.
    wire_compliance : (modes filled,)
        1/omega^2 of the wire's modes.
    yielding : (GRID + 1, slices, 2)
        What a force on a slice that stands all the time has done to the slice's own place (um per um kg/s2), and to
        its speed.
    """

    wire: Annotated[Array, Stored(GRID + 1, 4, "modes")]
    wire_compliance: Annotated[Array, Stored("modes")]
    yielding: Annotated[Array, Stored(GRID + 1, "slices", 2)]
    table11: Annotated[Array, Stored(GRID + 1, 2, 2)]
    table12: Annotated[Array, Stored(GRID + 1, 2, 2)]
    table21: Annotated[Array, Stored(GRID + 1, 2, 2)]
    table22: Annotated[Array, Stored(GRID + 1, 2, 2)]


class Axes(NamedTuple):
    """The machine's axes with the drives that have a loop.

    Attributes
    ----------
    rows, drives, motors
        See `edmsim.compiled.axis_rows`; without meaning for an axis under a stepper.
    ways : record (2,)
        Errors of screws and ways of x and y, see `edmsim.plant.axes.ways`.
    step_ns : int64 (axes,)
        Longest time step of an axis.
    loops : int
        How many drives have a loop.
    errs : int
        Whether ``ways`` has any.
    """

    rows: Annotated[NDArray[np.void], Stored(N_AXES, life=CHANGING, record=AXIS)]
    drives: Annotated[NDArray[np.void], Stored(N_AXES, life=CHANGING, record=DRIVE)]
    motors: Annotated[NDArray[np.void], Stored(N_AXES, record=MOTOR)]
    ways: Annotated[NDArray[np.void], Stored(2, record=WAY)]
    step_ns: Annotated[NDArray[np.int64], Stored(N_AXES)]
    loops: int
    errs: int


class Arrays(NamedTuple):
    """Arrays of one plant.

    Slices and coordinates are filled up to whole vectors (`vectors.COORDINATES`) where it says *filled*: with slices
    that lie nowhere, with nodes that do not move.

    Attributes
    ----------
    edge_um : float32 (slices, rays)
        Gap of every ray, traced from the reference position.
    reference_um : (2, slices filled)
        Place it was traced from: where the wire was at that moment. The wire swings, so that in time its
        rays look everywhere, also between the lines they look along now.
    pending_um2 : (slices, places)
        Volume of craters that fell on a ray since, over the slice's height; carved from the field before the rays are
        traced again.
    ray_metal : float32 (slices, rays)
        Height of the metal that a ray meets over the slice's: 1 but for the topmost slice of a lower place.
    metal : (slices,)
        Its mean over a slice's rays that meet metal, the nearer the more, and 1 if none does.
    wire_q, wire_v : (2, modes filled)
        Modal deflection (um sqrt(kg)) and velocity (um sqrt(kg)/s), along x and y.
    table_q, table_v : (2, 2)
        Ringing of x and y around ``axis_um``.
    steady : (2, modes filled)
        Load on the modal coordinates that stands for many pulses (um kg/s2): the magnetic force.
    temperature_K, debris, carry_um2 : (slices,)
        Wire temperature, debris share, and crater volume over the slice's height that is too small for a part of a
        cell, kept for the next.
    current2_us : (2, slices)
        Integrals of current squared (A2 us) since heat was propagated last, of the discharges in each slice: what
        flowed in the wire below it, and above it.
    steam, gas, covered : (slices filled,)
        Shares of the front that steam, permanent gas and either cover.
    wake_debris, wake_gas : (slices), (slices filled)
        Shares of debris and of permanent gas in the water of the kerf behind the wire.
    distance, cosine, sine, first, blocks, unbroken
        What the loop sees of the rays, see `rays.Rays`: ``edge_um`` without that craters took since.
    ray_cosine, ray_sine : float64 (rays,)
        Directions of the rays square to the wire.
    reach_x, reach_y : float64 (rays,)
        Way in a slice's plane to a point 1 um along a ray of a wire that leans as when they were traced: the wire's
        section there is an ellipse.
    across_x, across_y : float64 (rays,)
        By how much a ray's gap narrows where the wire moves along x and y, which is also the share of a force along
        the ray that acts in the slice's plane.
    upright : (1,)
        Cosine of the angle between that wire and the vertical.
    shape : (slices, modes filled)
        Displacement of a slice per unit of modal coordinate.
    sway : (modes filled, slices filled)
        The same, transposed.
    mean_shape : (modes filled,)
        Its mean over the slices.
    slice_mass_kg : (slices,)
        Mass that an impulse on a slice moves there.
    mobility : (modes filled,)
        Rate at which 1 kg/s of resistance on every slice damps a coordinate, 1/s.
    inertia : (modes filled,)
        Mean square of the slices' speed per square of a coordinate's.
    height_share : (slices filled,)
        Height of a slice above the lower guide, as a share of the distance of the guides.
    lean_share : (slices filled,)
        Share of the upper guide's lead by which a slice is led: the same but for where the wire bends.
    carried_per_us : (slices,)
        Way of the water past a slice in 1 us, over that after which nothing is left of what prepares a breakdown.
    convection_W_m2K, critical_W_m2 : (slices,)
        Heat transfer without boiling, and largest heat flux by boiling.
    jet_um_kg_s2 : (slices,)
        Force of the jets that turn into the kerf behind the wire.
    flow_share : (2, slices)
        Water that enters a slice from the lower and the upper nozzle, of what leaves that nozzle.
    entering : (2, slices)
        The same over the height of a slice's metal: the less of it, the sooner the water beside it has changed.
    """

    edge_um: Annotated[NDArray[np.float32], Stored("slices", "rays", life=WALL)]
    reference_um: Annotated[Array, Stored(2, "slices_filled", life=WALL)]
    pending_um2: Annotated[Array, Stored("slices", "places", life=WALL)]
    wire_q: Annotated[Array, Stored(2, "modes", life=CHANGING)]
    wire_v: Annotated[Array, Stored(2, "modes", life=CHANGING)]
    table_q: Annotated[Array, Stored(2, 2, life=CHANGING)]
    table_v: Annotated[Array, Stored(2, 2, life=CHANGING)]
    steady: Annotated[Array, Stored(2, "modes", life=CHANGING)]
    temperature_K: Annotated[Array, Stored("slices", life=CHANGING)]
    debris: Annotated[Array, Stored("slices", life=CHANGING)]
    carry_um2: Annotated[Array, Stored("slices", life=WALL)]
    current2_us: Annotated[Array, Stored(2, "slices", life=CHANGING)]
    steam: Annotated[Array, Stored("slices_filled", life=CHANGING)]
    gas: Annotated[Array, Stored("slices_filled", life=CHANGING)]
    covered: Annotated[Array, Stored("slices_filled", life=CHANGING)]
    wake_debris: Annotated[Array, Stored("slices", life=CHANGING)]
    wake_gas: Annotated[Array, Stored("slices_filled", life=CHANGING)]
    distance: Annotated[NDArray[np.float32], Stored("slices", "places", life=WALL)]
    cosine: Annotated[NDArray[np.float32], Stored("slices", "places", life=WALL)]
    sine: Annotated[NDArray[np.float32], Stored("slices", "places", life=WALL)]
    first: Annotated[NDArray[np.int64], Stored("slices", life=WALL)]
    blocks: Annotated[NDArray[np.int64], Stored("slices", life=WALL)]
    unbroken: Annotated[NDArray[np.int64], Stored("slices", life=WALL)]
    ray_cosine: Annotated[Array, Stored("rays")]
    ray_sine: Annotated[Array, Stored("rays")]
    reach_x: Annotated[Array, Stored("rays", life=WALL)]
    reach_y: Annotated[Array, Stored("rays", life=WALL)]
    across_x: Annotated[Array, Stored("rays", life=WALL)]
    across_y: Annotated[Array, Stored("rays", life=WALL)]
    upright: Annotated[Array, Stored(1, life=WALL)]
    shape: Annotated[Array, Stored("slices", "modes")]
    sway: Annotated[Array, Stored("modes", "slices_filled")]
    mean_shape: Annotated[Array, Stored("modes")]
    slice_mass_kg: Annotated[Array, Stored("slices")]
    mobility: Annotated[Array, Stored("modes")]
    inertia: Annotated[Array, Stored("modes")]
    lean_share: Annotated[Array, Stored("slices_filled", life=WALL)]
    height_share: Annotated[Array, Stored("slices_filled")]
    carried_per_us: Annotated[Array, Stored("slices")]
    convection_W_m2K: Annotated[Array, Stored("slices")]
    critical_W_m2: Annotated[Array, Stored("slices")]
    jet_um_kg_s2: Annotated[Array, Stored("slices")]
    flow_share: Annotated[Array, Stored(2, "slices")]
    table_shape: Annotated[Array, Stored(2, 2)]
    table_participation: Annotated[Array, Stored(2, 2)]
    ray_metal: Annotated[NDArray[np.float32], Stored("slices", "rays", life=WALL)]
    metal: Annotated[Array, Stored("slices", life=WALL)]
    entering: Annotated[Array, Stored(2, "slices", life=WALL)]


class Scratch(NamedTuple):
    """Room for what the loop computes again every pulse; it allocates nothing itself.

    Attributes
    ----------
    sums : (slices, 4)
        See `breakdown.slice_sums`.
    films : (slices, 6)
        See `film.find_films`.
    """

    position: Annotated[Array, Stored(2, "slices_filled")]
    load: Annotated[Array, Stored(2, "modes")]
    held: Annotated[Array, Stored(2, "modes")]
    sums: Annotated[Array, Stored("slices", 4)]
    contact: Annotated[Array, Stored("slices")]
    films: Annotated[Array, Stored("slices", 6)]


class Own(NamedTuple):
    """Rows of one plant's scalars, its kerf field, and the log of a window's pulses, empty if none is wanted.

    ``levels``, the heights of the blank over a slice's, is empty where the blank is as high everywhere.
    """

    state: Annotated[NDArray[np.void], Stored(1, record=STATE)]
    window: Annotated[NDArray[np.void], Stored(1, record=WINDOW)]
    tiles: Annotated[NDArray[np.uint16], Stored("tiles", "slices", TILE, TILE)]
    tile_index: Annotated[NDArray[np.int32], Stored("index_side", "index_side")]
    levels: Annotated[NDArray[np.float32], Stored("levels", TILE, TILE)]
    pulses: Annotated[NDArray[np.void], Stored("pulses", record=PULSE)]
