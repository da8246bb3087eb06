"""The wire: its loads, temperature and strength.

Loads: the gas bubble of a discharge pushes the wire away (an impulse), and the open voltage pulls it towards the
metal (electrostatic pressure on every ray). Heat: a share of the discharge's energy enters the wire, the current
heats it, water cools it, and the running wire carries heat downwards. The heat balance has the structure of the ETH
model (SPARC, MIT licence) and of Schacht (KU Leuven 2004).
"""

import math
from typing import NamedTuple

from edmsim.compiled.elementary import exponential
from edmsim.compiled.jit import compiled
from edmsim.plant.kernel.state import Array, Arrays

VACUUM_PERMITTIVITY_F_M = 8.8541878128e-12  # CODATA 2018
VACUUM_PERMEABILITY_N_A2 = 1.25663706212e-6  # CODATA 2018
MOST_EXCHANGE = 0.25  # share of the difference per explicit step of conduction (ours: stable up to 0.5)


class HeatLaw(NamedTuple):
    """Rates of the wire's heat balance in one slice."""

    kelvin_per_J: float  # temperature rise of a slice's wire per joule
    # cooling per us of a slice's wire per W/(m2 K): its surface over its heat capacity, times 1e-6
    cooling_m2K_J: float
    conduction_per_us: float  # exchange with each neighbour
    # share of a slice's wire that is replaced per us (running speed over slice height)
    run_per_us: float
    joule_K_per_A2_us: float  # temperature rise per A2 us of the current in the slice, at the water's temperature
    resistance_per_K: float  # relative rise of the wire's resistivity per kelvin
    water_K: float  # temperature of the bulk water, and of the wire that enters
    # boiling point of the water at the wire, and the boiling curve above it (see `heat_transfer_W_m2K`)
    boiling_K: float
    superheat_K: float
    film_W_m2K: float
    dry_share: float  # reduction of the heat transfer by gas over the whole front
    melting_K: float  # greatest temperature of the wire
    # a hot spot: temperature rise of a metre of wire per joule, square of the least length that can break, and growth
    # of the square of the length over which the heat has spread
    spot_K_m_J: float
    spot_m2: float
    spreading_m2_us: float


@compiled
def heat_transfer_W_m2K(
    temperature_K: float, law: HeatLaw, convection_W_m2K: float, critical_W_m2: float, dry: float
) -> float:
    """Return the heat flux from the wire over its temperature above the water's."""
    # Convection up to the boiling point; then nucleate boiling, whose flux rises with the cube of the superheat
    # (Rohsenow) up to the critical one; above that a film of steam. `dry` is the share of the wire under gas.
    wet = max(1.0 - law.dry_share * dry, 0.0)
    convection = convection_W_m2K * wet
    superheat = temperature_K - law.boiling_K
    if superheat <= 0.0:
        return convection
    if superheat >= law.superheat_K:
        return min(law.film_W_m2K, convection)
    above = temperature_K - law.water_K
    most = max(critical_W_m2 * wet - convection * (law.boiling_K + law.superheat_K - law.water_K), 0.0)
    return convection + most * (superheat / law.superheat_K) ** 3 / above


@compiled
def add_currents(a: Arrays, current2_us: Array) -> None:
    """Compute the integral of the squared current in every slice's wire (A2 us) since heat was propagated."""
    # A discharge's current comes from both contacts, and divides by the wire's resistances: the share below the
    # discharge equals the share of the height above it.
    n = a.temperature_K.shape[0]
    from_below = from_above = 0.0
    for s in range(n):
        current2_us[s] = from_below + 0.5 * (a.current2_us[0, s] + a.current2_us[1, s])
        from_below += a.current2_us[1, s]
    for s in range(n - 1, -1, -1):
        current2_us[s] += from_above
        from_above += a.current2_us[0, s]


@compiled
def spot_K(law: HeatLaw, heat_J: float, time_us: float) -> float:
    """Return the rise of a section that has received heat over a time, ``Q / (rho c A sqrt(pi a t + d^2))``."""
    # conduction spreads the heat over ``sqrt(pi a t)``; a disc thinner than the wire cannot break (ours)
    return heat_J * law.spot_K_m_J / math.sqrt(law.spot_m2 + law.spreading_m2_us * time_us)


@compiled
def _conduct(temperature: Array, exchange: float) -> None:
    """Exchange heat between neighbouring slices, by a share of their difference."""
    n = temperature.shape[0]
    above = temperature[n - 1]
    for s in range(n - 1, -1, -1):
        here = temperature[s]
        below = temperature[s - 1] if s > 0 else here
        temperature[s] = here + exchange * (above + below - 2.0 * here)
        above = here


@compiled
def heat_step(a: Arrays, law: HeatLaw, current2_us: Array, dt_us: float) -> None:
    """Advance the slices' temperatures by a span of time with currents (see `add_currents`)."""
    # exact for convection, explicit for conduction, implicit upwind for the wire, which enters cold at the top
    temperature = a.temperature_K
    n = temperature.shape[0]
    run = law.run_per_us * dt_us
    exchange = law.conduction_per_us * dt_us
    if exchange > MOST_EXCHANGE:  # thin slices need several steps; the last one is part of the balance below
        steps = math.ceil(exchange / MOST_EXCHANGE)
        exchange /= steps
        for _ in range(steps - 1):
            _conduct(temperature, exchange)
    above = law.water_K
    above_before = temperature[n - 1]
    for s in range(n - 1, -1, -1):
        here = temperature[s]
        below = temperature[s - 1] if s > 0 else here
        warm = here + exchange * (above_before + below - 2.0 * here)
        resistance = 1.0 + law.resistance_per_K * (here - law.water_K)
        warm = (warm + law.joule_K_per_A2_us * current2_us[s] * resistance + run * above) / (1.0 + run)
        transfer = heat_transfer_W_m2K(
            here, law, a.convection_W_m2K[s], a.critical_W_m2[s], a.covered[s] + a.wake_gas[s]
        )
        keep = exponential(-transfer * law.cooling_m2K_J * dt_us)
        temperature[s] = min(law.water_K + (warm - law.water_K) * keep, law.melting_K)
        above = temperature[s]
        above_before = here


@compiled
def strength_share(temperature_K: float, half_strength_K: float, cold_K: float) -> float:
    """Return the tensile strength over its cold value: linear, 0.5 at `half_strength_K`, at least 0."""
    return max(0.0, 1.0 - 0.5 * (temperature_K - cold_K) / (half_strength_K - cold_K))


def area_m2(diameter_um: float) -> float:
    """Return the cross-section of the wire."""
    return math.pi / 4 * (diameter_um * 1e-6) ** 2
