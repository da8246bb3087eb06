"""Gas on the wire's front: the share of a slice that steam and permanent gas cover, and its effect.

A discharge boils some water, and splits some into hydrogen and oxygen. The pocket of steam spans the kerf and covers
the front over a length of some mm until it has condensed; the permanent gas covers less, until the water has crept
back into the gap. Where gas bridges the gap there is no water to pull, to be pushed, to ignite in or to cool.

The kerf behind the wire is a reservoir: the pockets exchange the gap's water with it, debris and all, and the
permanent gas collects there until the jets have flushed it out. The water that creeps back brings that share of gas
with it.
"""

import math
from typing import Annotated, Any, NamedTuple

import numpy as np

from edmsim.compiled.jit import compiled
from edmsim.compiled.vectors import COORDINATES, counted, highest, load, lowest, spread, store
from edmsim.plant.gap.water import AMBIENT_PA
from edmsim.plant.kernel.state import GRID, Array, Arrays, Constants, Stored

LEAST_POCKET = 1e-6
"""Half the least length that debris is spread over, in heights of a slice (ours): without steam it stays there."""


class GasLaw(NamedTuple):
    """Gas of discharges: how much, and how long it lives."""

    # half the length of front that steam and permanent gas of a discharge cover, over the root of its energy
    steam_um_J: float
    gas_um_J: float
    # speed of the wire at whose edges the water would go as fast as that which pockets of steam all over the front
    # drive out of the gap and let back in
    refill_um_s: float
    # (GRID + 1, 2): share of steam and of permanent gas that is left over the time grid of the setting
    fading: Annotated[Array, Stored(GRID + 1, 2)]


def cover_um2_J(pressure_energy_share: float, kerf_um: float) -> float:
    """Square of half the length that the gas of a discharge covers, in um2 per joule."""
    # gas of the volume ``share E / p0`` that spans the kerf is a flat disc: ``R^2 = share E / (pi p0 w)``
    return pressure_energy_share / (math.pi * AMBIENT_PA * kerf_um * 1e-6) * 1e12


def steam_life_us(half_length_um: float, periods: float, density_kg_m3: float) -> float:
    """Lifetime of a pocket of steam: `periods` times Rayleigh's time of collapse, ``0.915 R sqrt(rho / p0)``."""
    return periods * 0.915 * half_length_um * math.sqrt(density_kg_m3 / AMBIENT_PA)


def refill_um_s(gap_um: float, life_us: float) -> float:
    """Speed of a wire that drives the water through its edges as fast as pockets of steam do."""
    # pockets of the life T over a share a of the front give the edges' water ``u = pi r a / T``, whose loss resists a
    # wire as ``loss rho u (r / g) d``: as `film.edge_loss_kg_m2` does at ``2 pi g a / (T sqrt(8 / pi))``; here a is 1
    return 2 * math.pi * gap_um / (max(life_us, 1.0) * 1e-6) / math.sqrt(8 / math.pi)


def refill_us(
    length_um: float, gap_um: float, viscosity_Pa_s: float, density_kg_m3: float, tension_N_m: float, wetting: float
) -> float:
    """Time in which capillarity draws water over a length into a gap."""
    # the pressure ``2 sigma cos(angle) / g`` works against friction (Washburn) and inertia, whose times are added
    length, gap, driving = length_um * 1e-6, gap_um * 1e-6, tension_N_m * wetting
    friction = 3 * viscosity_Pa_s * length**2 / (driving * gap)
    inertia = length * math.sqrt(density_kg_m3 * gap / (4 * driving))
    return (friction + inertia) * 1e6


@compiled
def _either(steam: Any, gas: Any) -> Any:
    """Share of a front that gas covers, of a slice or of a vector of them: both kinds lie anywhere on it."""
    return steam + gas - steam * gas


@compiled
def fade(a: Arrays, law: GasLaw, k_period: int) -> None:
    """Let gas vanish over a period: steam for good, permanent gas to what the kerf behind the wire has of it."""
    steam_left, gas_left = law.fading[k_period, 0], law.fading[k_period, 1]
    for s in range(0, a.steam.shape[0], COORDINATES):
        behind = load(a.wake_gas, (s,))
        steam = load(a.steam, (s,)) * steam_left
        gas = behind + (load(a.gas, (s,)) - behind) * gas_left
        store(a.steam, (s,), steam)
        store(a.gas, (s,), gas)
        store(a.covered, (s,), _either(steam, gas))


@compiled
def _overlap(place: float, reach: float, first: int, top: float) -> Any:
    """How much of each of four slices from one on lies within a reach of a place, in heights of a slice."""
    low = counted(float(first))
    return highest(lowest(low + 1.0, min(place + reach, top)) - highest(low, place - reach), 0.0)


@compiled
def blow(
    a: Arrays, c: Constants, law: GasLaw, s: int, within: float, energy_J: float, k_left: int, debris_um3: float
) -> None:
    """Let a discharge blow gas at a share of the height of its slice, so long before the period's end."""
    # gas of former discharges ends where it covers the front again. The steam spreads the discharge's debris over its
    # pocket, beyond the workpiece as well, and exchanges the gap's debris with the kerf's. Lengths count as shares of
    # the height of the metal in the discharge's slice
    root, place = math.sqrt(energy_J) / (c.slice_um * a.metal[s]), s + within
    steam, gas = law.steam_um_J * root, law.gas_um_J * root
    pocket = max(steam, LEAST_POCKET)
    steam_left, gas_left = law.fading[k_left, 0], law.fading[k_left, 1]
    # once, and not for each slice
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
        store(a.covered, (k,), _either(steamy, gassy))
