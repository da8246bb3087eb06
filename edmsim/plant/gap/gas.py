"""The gas of discharges: its push on the wire, and the share of the wire's front that it covers.

The bubble first drives the water out of the slit between the wire's front half and the metal. This push grows with
the square root of the energy delivered until the gas reaches the slit's open edges, after one to three us. Then the
gas escapes through the edges, and pushes with the pressure that the discharge still maintains.
Derivation, figure and uncertainty: ``docs/theory/gas.md``.

A discharge boils water, and splits some of it into hydrogen and oxygen. The pocket of steam spans the kerf and covers
the front over a length of some mm until it has condensed. The permanent gas covers less, until the water has flowed
back into the gap. Where gas bridges the gap there is no water: no pull, no push, no ignition and no cooling.

The kerf behind the wire is a reservoir. The pockets exchange the gap's water and debris with it, and the permanent
gas collects there until the jets flush it out. The water that flows back into the gap contains its share of gas.
"""

import math
from typing import Annotated, Any, NamedTuple

import numpy as np

from edmsim.compiled.elementary import cube_root, inverse_cube_root
from edmsim.compiled.jit import compiled, exactly_compiled
from edmsim.compiled.vectors import COORDINATES, counted, highest, load, lowest, spread, store
from edmsim.plant.gap.water import AMBIENT_PA, DENSITY_KG_M3, surface_tension_N_m
from edmsim.plant.kernel.state import GRID, Array, Arrays, Constants, Stored

REFERENCE_GAP_UM, REFERENCE_J, REFERENCE_DIAMETER_UM = 20.0, 0.01, 250.0
"""Gap, energy and wire diameter for which the impulse constant of a machine file applies."""
LEAST_GAP_UM = 5.0  # below this gap the impulse is constant (ours: craters and asperities are as large)
SLIT_LOGARITHM = 0.6  # mean of ln(slit / bubble) while the bubble crosses the slit (ours: by integration, 0.5 to 1)
LATE_SHARE = 0.7
"""Rise of the energy that drives the water if the discharge ends at once, so the gas has all the time until the vent
to deliver its energy. Of a discharge that burns until then, half drives the water (ours: by integration, 0.6 to
0.8)."""
HEAT_RATIO = 1.3  # of the specific heats of steam (tables, 100 to 1000 C; down to 1.15 if it dissociates)
ESCAPE_M_S = 270.0
"""Volume flow of gas per area of the edges at choked flow: 0.585 of its speed of sound, here of dry steam at 100 C
(ours: 150 with spray, 480 at 850 C)."""
ESCAPE_AREA, ESCAPE_EDGE = 2.267, 4.0
"""Projected area of the gas that has reached both edges, and length of edge through which it leaves, in half widths
of the slit (ours, derived: a circle between the edges, projected by the cosine of the angle on the wire)."""


class BubbleLaw(NamedTuple):
    """Constants of the push on one wire; those of the escaping gas are for a gap of 20 um."""

    impulse_Ns: float  # impulse of the water driven out by 10 mJ, delivered until the gas escapes, at a gap of 20 um
    vent_us: float  # time in us after which the gas of a discharge of 1 W escapes
    escape_Ns_J: float  # impulse of the escaping gas per energy of the discharge
    ambient_N: float  # force of the ambient pressure against it


def bubble_law(diameter_um: float, impulse_10mJ_Ns: float, bubble_share: float) -> BubbleLaw:
    """Return the push for a wire from the impulse of 10 mJ at 250 um; it is proportional to the squared diameter."""
    half_m, gap_m = math.pi / 4 * diameter_um * 1e-6, REFERENCE_GAP_UM * 1e-6
    inertia = 2 * math.pi * DENSITY_KG_M3 * gap_m * SLIT_LOGARITHM
    area_m2 = ESCAPE_AREA * half_m**2
    enthalpy_per_pressure = HEAT_RATIO / (HEAT_RATIO - 1.0)
    return BubbleLaw(
        impulse_Ns=impulse_10mJ_Ns * (diameter_um / REFERENCE_DIAMETER_UM) ** 2,
        vent_us=1e6 * (0.75 * half_m**2 * math.sqrt(inertia / bubble_share)) ** (2 / 3),
        escape_Ns_J=bubble_share * area_m2 / (enthalpy_per_pressure * ESCAPE_EDGE * half_m * gap_m * ESCAPE_M_S),
        ambient_N=AMBIENT_PA * area_m2,
    )


@compiled
def vent_time_us(power_W: float, gap_um: float, law: BubbleLaw) -> float:
    """Return the time after ignition at which the gas of a discharge of constant power reaches the slit's edges."""
    return law.vent_us * cube_root(max(gap_um, LEAST_GAP_UM) * (1.0 / power_W / REFERENCE_GAP_UM))


@compiled
def bubble_impulse_Ns(power_W: float, burn_us: float, gap_um: float, law: BubbleLaw) -> float:
    """Return the impulse of a discharge's bubble on the wire, in a slit full of liquid."""
    # The water driven out gives ``J0 (d / 250 um)^2 (E_w / 10 mJ)^(1/2) (20 um / g)^(1/2)``. The escaping gas adds
    # ``k (20 um / g)`` times half of its energy at the vent, and ``k (20 um / g) P - F0`` while the discharge burns.
    if power_W <= 0.0:
        return 0.0
    # one root, and no division that depends on the gap
    per_W = 1.0 / power_W
    per_vent = inverse_cube_root(max(gap_um, LEAST_GAP_UM) * (per_W / REFERENCE_GAP_UM))
    narrow = per_vent * per_vent * per_vent * per_W  # 20 um over the gap
    escape = law.escape_Ns_J * narrow
    until_vent = min(burn_us * (1.0 / law.vent_us) * per_vent, 1.0)
    confined_us = vent_time_us(power_W, gap_um, law) * until_vent
    energy_J = power_W * confined_us * 1e-6
    # if a discharge ends before its gas escapes, the gas has time to deliver more of its energy
    driving_J = energy_J * (1.0 + LATE_SHARE * (1.0 - until_vent))
    water_Ns = law.impulse_Ns * math.sqrt(driving_J * (1.0 / REFERENCE_J) * narrow)
    escape_N = max(0.0, escape * power_W - law.ambient_N)
    return water_Ns + 0.5 * escape * energy_J + escape_N * (burn_us - confined_us) * 1e-6


LEAST_POCKET = 1e-6
"""Half the least length over which debris spreads, in heights of a slice (ours): without steam it does not spread."""


class GasLaw(NamedTuple):
    """Amount and lifetime of the gas of discharges."""

    # half the length of front covered by a discharge's steam and permanent gas, over the root of its energy
    steam_um_J: float
    gas_um_J: float
    # speed of a wire that drives the water through its edges as fast as pockets of steam all over the front do
    refill_um_s: float
    # (GRID + 1, 2): remaining share of steam and of permanent gas on the setting's time grid
    fading: Annotated[Array, Stored(GRID + 1, 2)]


def cover_um2_J(pressure_energy_share: float, kerf_um: float) -> float:
    """Return the square of half the length that a discharge's gas covers, in um2 per joule."""
    # gas of volume ``share E / p0`` in the kerf is a flat disc: ``R^2 = share E / (pi p0 w)``
    return pressure_energy_share / (math.pi * AMBIENT_PA * kerf_um * 1e-6) * 1e12


def steam_life_us(half_length_um: float, periods: float) -> float:
    """Return the lifetime of a steam pocket: `periods` times Rayleigh's collapse time ``0.915 R sqrt(rho / p0)``."""
    return periods * 0.915 * half_length_um * math.sqrt(DENSITY_KG_M3 / AMBIENT_PA)


def refill_um_s(gap_um: float, life_us: float) -> float:
    """Return the speed at which a wire drives the water through its edges as fast as pockets of steam do."""
    # Pockets of lifetime T over a share a of the front move the edges' water at ``u = pi r a / T``. Its loss resists
    # the wire by ``loss rho u (r / g) d``, as `squeeze_film.edge_loss_kg_m2` does at
    # ``2 pi g a / (T sqrt(8 / pi))``. Here a is 1.
    return 2 * math.pi * gap_um / (max(life_us, 1.0) * 1e-6) / math.sqrt(8 / math.pi)


def refill_us(
    length_um: float, gap_um: float, viscosity_Pa_s: float, temperature_K: float, wetting: float
) -> float:
    """Return the time in which capillarity draws water over a length into a gap."""
    # the pressure ``2 sigma cos(angle) / g`` acts against friction (Washburn) and inertia, whose times are added
    length, gap, driving = length_um * 1e-6, gap_um * 1e-6, surface_tension_N_m(temperature_K) * wetting
    friction = 3 * viscosity_Pa_s * length**2 / (driving * gap)
    inertia = length * math.sqrt(DENSITY_KG_M3 * gap / (4 * driving))
    return (friction + inertia) * 1e6


@exactly_compiled
def fill_fading(fading: Array, life_us: float, filled_us: float, grid_us: float) -> None:
    """Fill `GasLaw.fading` for the lifetimes of steam and permanent gas."""
    steam, gas = math.exp(-grid_us / life_us), math.exp(-grid_us / filled_us)
    fading[0, 0] = fading[0, 1] = 1.0
    for k in range(1, fading.shape[0]):
        fading[k, 0], fading[k, 1] = fading[k - 1, 0] * steam, fading[k - 1, 1] * gas


@compiled
def _gas_cover(steam: Any, gas: Any) -> Any:
    """Return the share of the front covered by steam or gas, which overlap at random; for a slice or a vector."""
    return steam + gas - steam * gas


@compiled
def fade(a: Arrays, law: GasLaw, k_period: int) -> None:
    """Let gas fade over a period: steam to 0, permanent gas to its share in the kerf behind the wire."""
    steam_left, gas_left = law.fading[k_period, 0], law.fading[k_period, 1]
    for s in range(0, a.steam.shape[0], COORDINATES):
        behind = load(a.wake_gas, (s,))
        steam = load(a.steam, (s,)) * steam_left
        gas = behind + (load(a.gas, (s,)) - behind) * gas_left
        store(a.steam, (s,), steam)
        store(a.gas, (s,), gas)
        store(a.covered, (s,), _gas_cover(steam, gas))


@compiled
def _overlap(place: float, reach: float, first: int, top: float) -> Any:
    """Return the share of each of four slices, from `first` on, within a distance of a height, in slice heights."""
    low = counted(float(first))
    return highest(lowest(low + 1.0, min(place + reach, top)) - highest(low, place - reach), 0.0)


@compiled
def blow(
    a: Arrays, c: Constants, law: GasLaw, s: int, within: float, energy_J: float, k_left: int, debris_um3: float
) -> None:
    """Add a discharge's gas at the height `within` its slice, `k_left` grid steps before the period's end."""
    # New gas replaces that of former discharges where both cover the front. The steam spreads the discharge's debris
    # over its pocket, also beyond the workpiece, and exchanges debris between the gap and the kerf behind. Lengths
    # are in units of the height of the metal in the discharge's slice.
    root, place = math.sqrt(energy_J) / (c.slice_um * a.metal[s]), s + within
    steam, gas = law.steam_um_J * root, law.gas_um_J * root
    pocket = max(steam, LEAST_POCKET)
    steam_left, gas_left = law.fading[k_left, 0], law.fading[k_left, 1]
    # computed once for all slices
    debris, thinner = debris_um3 / (2.0 * pocket * c.cavity_um3), c.cavity_um3 / c.wake_um3
    a.wake_gas[s] += (1.0 - a.wake_gas[s]) * min(c.gas_um3_J * energy_J / (c.wake_um3 * a.metal[s]), 1.0)
    top = np.float64(a.shape.shape[0])
    for k in range(0, a.steam.shape[0], COORDINATES):
        under = _overlap(place, steam, k, top)
        steamy = load(a.steam, (k,))
        steamy += (spread(1.0) - steamy) * steam_left * under
        dirty, behind = load(a.debris, (k,)), load(a.wake_debris, (k,))
        dirty += _overlap(place, pocket, k, top) * debris / load(a.metal, (k,))
        exchanged = under * c.pumping * (dirty - behind)
        gassy = load(a.gas, (k,))
        gassy += (spread(1.0) - gassy) * gas_left * _overlap(place, gas, k, top)
        store(a.steam, (k,), steamy)
        store(a.debris, (k,), dirty - exchanged)
        store(a.wake_debris, (k,), behind + exchanged * thinner)
        store(a.gas, (k,), gassy)
        store(a.covered, (k,), _gas_cover(steamy, gassy))
