"""Layers of the cut face that the process has changed: the one its heat reached, and the one the water dissolved.

The thesis names both (2.6). Neither is measured on the kerf field: they are far thinner than its cells, and are
computed from what the cut has summed up.
"""

from __future__ import annotations

import math

from edmsim.errors import InputError
from edmsim.machine.machine import Machine

CONDUCTIVITY_PER_K = 0.02
"""Rise of the conductivity of water per kelvin above 298 K (handbook: some 2 % for all dilute solutions)."""
STANDARD_K = 298.0
"""Temperature at which a conductivity is stated."""


def heat_affected_um(machine: Machine, discharge_us: float) -> float:
    """Depth below a crater to which a discharge heats the metal beyond its `affected_K`, in um.

    The crater's floor is as hot as melting metal for as long as the discharge lasts, and heat flows into the depth:
    ``T(z) = T0 + (Tm - T0) erfc(z / (2 sqrt(a t)))``. How much energy there is beyond that changes the crater, not
    this depth, which grows with the square root of the duration.

    Parameters
    ----------
    machine : Machine
    discharge_us : float
        Mean duration of the discharges, 0 or more.

    Returns
    -------
    float
        NaN for a material whose file has no section ``[surface]``.
    """
    from scipy.special import erfcinv

    if not discharge_us >= 0:
        raise InputError(f"a discharge of {discharge_us:g} us cannot be: it lasts 0 us or more")
    surface, water_K = machine.material.surface, machine.base.dielectric.temperature_K.value
    if surface is None:
        return math.nan
    share = (surface.affected_K.value - water_K) / (surface.melting_K.value - water_K)
    return 2.0 * math.sqrt(surface.diffusivity_mm2_s.value * discharge_us) * float(erfcinv(share))


def electrolysed_um(machine: Machine, voltage_s_mm: float, gap_um: float) -> float:
    """Depth of metal that the mean voltage dissolves from the walls while the wire passes, in um.

    The wire is a cylinder beside a plane in water of conductivity ``k``. A place of the wall sees half of its field
    pass, as it is a wall only once the front has gone by: ``pi k U / (v arcosh(1 + g/r))`` of charge per area, for
    the mean voltage ``U`` and the speed ``v``. Every charge dissolves metal (Faraday): this is what there is at most.
    Charge that equalising pulses drive back counts against it.

    Parameters
    ----------
    machine : Machine
    voltage_s_mm : float
        Gap voltage with its sign, summed over time, per length of path, in V s/mm.
    gap_um : float
        Gap between wire and wall, above 0.

    Returns
    -------
    float
        NaN for a material whose file has no section ``[surface]``, or an unknown gap.
    """
    surface, water = machine.material.surface, machine.base.dielectric
    if surface is None or not gap_um > 0:
        return math.nan
    warmer_K = water.gap_temperature_K.value - STANDARD_K
    conductivity_S_mm = water.conductivity_uS_cm.value * 1e-7 * (1.0 + CONDUCTIVITY_PER_K * warmer_K)
    spread = math.acosh(1.0 + gap_um / (machine.wire_diameter_um / 2))
    charge_C_mm2 = math.pi * conductivity_S_mm * voltage_s_mm / spread
    return charge_C_mm2 * surface.dissolved_mm3_C.value * 1e3
