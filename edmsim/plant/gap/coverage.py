"""Gas on the wire's front: which share of a slice steam and permanent gas cover, and what that shields.

A discharge boils some water, and splits some into hydrogen and oxygen. The pocket of steam spans the kerf and covers
the front over a length of some mm until it has condensed; the permanent gas covers less, until the water has crept
back into the gap. Where gas bridges the gap there is no water to pull, to be pushed, to ignite in or to cool.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from edmsim.compiled.elementary import exponential
from edmsim.compiled.jit import compiled
from edmsim.compiled.vectors import COORDINATES, load, store
from edmsim.plant.kernel.state import Array, Arrays, Constants

AMBIENT_PA = 101_325.0
"""Pressure of the water around the kerf."""


class GasLaw(NamedTuple):
    """What the discharges of one setting make of gas.

    Attributes
    ----------
    steam_um2_J, gas_um2_J : float
        Square of half the length of front that steam and permanent gas of a discharge cover, per joule.
    steam_per_us, gas_per_us : float
        One over the lifetimes of both.
    """

    steam_um2_J: float
    gas_um2_J: float
    steam_per_us: float
    gas_per_us: float


def cover_um2_J(pressure_energy_share: float, kerf_um: float) -> float:
    """Square of half the length that the gas of a discharge covers, in um2 per joule.

    Gas of the volume ``share E / p0`` that spans the kerf is a flat disc: ``R^2 = share E / (pi p0 w)``.

    Parameters
    ----------
    pressure_energy_share : float
        Volume of the gas times the ambient pressure, as a share of the discharge's energy.
    kerf_um : float
        Width of the kerf.
    """
    return pressure_energy_share / (math.pi * AMBIENT_PA * kerf_um * 1e-6) * 1e12


def steam_life_us(half_length_um: float, periods: float, density_kg_m3: float) -> float:
    """Lifetime of a pocket of steam: so many times Rayleigh's time of collapse, ``0.915 R sqrt(rho / p0)``."""
    return periods * 0.915 * half_length_um * math.sqrt(density_kg_m3 / AMBIENT_PA)


def refill_us(
    length_um: float, gap_um: float, viscosity_Pa_s: float, density_kg_m3: float, tension_N_m: float, wetting: float
) -> float:
    """Time in which capillarity draws water over a length into a gap.

    The pressure ``2 sigma cos(angle) / g`` works against friction (Washburn) and inertia, whose times are added:
    ``3 eta l^2 / (sigma cos g) + l sqrt(rho g / (4 sigma cos))``.

    Parameters
    ----------
    length_um, gap_um : float
    viscosity_Pa_s, density_kg_m3 : float
    tension_N_m : float
        Surface tension of water.
    wetting : float
        Cosine of the contact angle, above 0.
    """
    length, gap, driving = length_um * 1e-6, gap_um * 1e-6, tension_N_m * wetting
    friction = 3 * viscosity_Pa_s * length**2 / (driving * gap)
    inertia = length * math.sqrt(density_kg_m3 * gap / (4 * driving))
    return (friction + inertia) * 1e6


@compiled
def covered(a: Arrays, s: int) -> float:
    """Share of a slice's front that gas covers, steam and permanent gas lying anywhere."""
    return float(1.0 - (1.0 - a.steam[s]) * (1.0 - a.gas[s]))


@compiled
def mean_covered(a: Arrays) -> float:
    """Mean of `covered` over the height."""
    sum_ = 0.0
    for s in range(a.debris.shape[0]):
        sum_ += covered(a, s)
    return sum_ / a.debris.shape[0]


@compiled
def fade(a: Arrays, law: GasLaw, period_us: float) -> None:
    """Let gas vanish over a span of time."""
    steam, gas = exponential(-period_us * law.steam_per_us), exponential(-period_us * law.gas_per_us)
    for s in range(0, a.steam.shape[0], COORDINATES):
        store(a.steam, (s,), load(a.steam, (s,)) * steam)
        store(a.gas, (s,), load(a.gas, (s,)) * gas)


@compiled
def _cover(share: Array, slices: int, slice_um: float, place_um: float, half_um: float, kept: float) -> None:
    """Cover the front half a length above and below a place, of which `kept` is left at the pulse's end."""
    low, high = place_um - half_um, place_um + half_um
    first, last = max(0, int(low / slice_um)), min(slices - 1, int(high / slice_um))
    for s in range(first, last + 1):
        overlap = min(high, (s + 1) * slice_um) - max(low, s * slice_um)
        share[s] += (1.0 - share[s]) * kept * overlap / slice_um


@compiled
def blow(a: Arrays, c: Constants, law: GasLaw, place_um: float, energy_J: float, left_us: float) -> None:
    """Let a discharge blow gas around a height above the lower face, so long before the period's end.

    It covers the front anew where gas of former discharges lies, whose life ends with it: at one slice and a steady
    rate f the mean share is ``x / (1 + x)``, x = f times the life times the share of the slice one discharge covers.
    """
    slices = a.debris.shape[0]
    steam_um = math.sqrt(law.steam_um2_J * energy_J)
    _cover(a.steam, slices, c.slice_um, place_um, steam_um, exponential(-left_us * law.steam_per_us))
    gas_um = math.sqrt(law.gas_um2_J * energy_J)
    _cover(a.gas, slices, c.slice_um, place_um, gas_um, exponential(-left_us * law.gas_per_us))
    _sweep(a, c, place_um - steam_um, place_um + steam_um)


@compiled
def _sweep(a: Arrays, c: Constants, low_um: float, high_um: float) -> None:
    """Drive debris out of the gap between two heights."""
    first, last = max(0, int(low_um / c.slice_um)), min(a.debris.shape[0] - 1, int(high_um / c.slice_um))
    for s in range(first, last + 1):
        overlap = min(high_um, (s + 1) * c.slice_um) - max(low_um, s * c.slice_um)
        a.debris[s] *= 1.0 - c.pumping * overlap / c.slice_um
