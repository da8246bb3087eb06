"""The wire: the loads on it, its temperature, and when it breaks.

Loads: the gas bubble of a discharge pushes the wire away from the place (an impulse); the open voltage pulls
it towards the metal (electrostatic pressure on every ray). Heat: a share of the discharge energy enters the
wire at the discharge, the current heats it, water cools it, and the running wire carries heat downwards.
Structure of the heat balance after the ETH model (SPARC, MIT licence) and Schacht (KU Leuven 2004).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.elementary import power
from edmsim.compiled.jit import compiled

VACUUM_PERMITTIVITY_F_M = 8.8541878128e-12
"""CODATA 2018."""


class HeatLaw(NamedTuple):
    """Rates of the wire's heat balance in one slice.

    Attributes
    ----------
    kelvin_per_J : float
        Temperature rise of a slice's wire per joule.
    cooling_per_us : float
        Convection to the water.
    conduction_per_us : float
        Exchange with each neighbour.
    run_per_us : float
        Share of a slice's wire replaced by the next one's per us (wire running speed over slice height).
    joule_K_per_A2_us : float
        Rise per ampere squared and us at the water's temperature.
    resistance_per_K : float
        Relative rise of the wire's resistivity per kelvin.
    water_K : float
    """

    kelvin_per_J: float
    cooling_per_us: float
    conduction_per_us: float
    run_per_us: float
    joule_K_per_A2_us: float
    resistance_per_K: float
    water_K: float


@compiled
def heat_step(temperature: NDArray[np.float64], law: HeatLaw, dt_us: float, current2_us: float) -> None:
    """Advance the slices' temperatures (K) by `dt_us`; `current2_us` is the integral of current squared.

    Exact for convection, explicit for conduction, implicit upwind for the running wire, which enters the
    top slice (the last one) at the water's temperature.
    """
    n = temperature.shape[0]
    keep = math.exp(-law.cooling_per_us * dt_us)
    run = law.run_per_us * dt_us
    exchange = min(law.conduction_per_us * dt_us, 0.25)
    above = law.water_K
    above_before = temperature[n - 1]
    for s in range(n - 1, -1, -1):
        here = temperature[s]
        below = temperature[s - 1] if s > 0 else here
        warm = here + exchange * (above_before + below - 2.0 * here)
        joule = law.joule_K_per_A2_us * current2_us * (1.0 + law.resistance_per_K * (here - law.water_K))
        warm = (warm + joule + run * above) / (1.0 + run)
        temperature[s] = law.water_K + (warm - law.water_K) * keep
        above = temperature[s]
        above_before = here


@compiled
def strength_share(temperature_K: float, half_strength_K: float, cold_K: float) -> float:
    """Tensile strength over its cold value: linear, one half at `half_strength_K`, never below zero."""
    return max(0.0, 1.0 - 0.5 * (temperature_K - cold_K) / (half_strength_K - cold_K))


def area_m2(diameter_um: float) -> float:
    """Cross-section of the wire."""
    return math.pi / 4 * (diameter_um * 1e-6) ** 2


def electrostatic_pull_N_m(voltage_V: float, gap_um: float, radius_um: float, permittivity: float) -> float:
    """Attraction per metre of a straight cylinder towards a plane (closed form).

    ``F' = pi eps V^2 / (r acosh(1 + g/r)^2 sqrt((1 + g/r)^2 - 1))``; `permittivity` is relative.
    """
    ratio = 1 + gap_um / radius_um
    eps = permittivity * VACUUM_PERMITTIVITY_F_M
    return (
        math.pi * eps * voltage_V**2
        / (radius_um * 1e-6 * math.acosh(ratio) ** 2 * math.sqrt(ratio**2 - 1))
    )


@compiled
def discharge_impulse(energy_J: float, at_10mJ_Ns: float, exponent: float) -> float:
    """Impulse in N s that one discharge's gas bubble gives the wire: ``J10 (E / 10 mJ)^n``."""
    return at_10mJ_Ns * power(energy_J / 0.01, exponent)
