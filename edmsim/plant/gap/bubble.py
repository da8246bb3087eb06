"""How hard the gas bubble of a discharge pushes the wire, by the energy it gets before its gas escapes.

The bubble is confined in the slit between the wire's front half and the metal. Its gas reaches the slit's open edges
after one to three us and escapes; what the discharge delivers later hardly pushes. Derivation, figure and
uncertainty: ``docs/theory/gas.md``.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from edmsim.compiled.elementary import cube_root
from edmsim.compiled.jit import compiled

REFERENCE_GAP_UM, REFERENCE_J, REFERENCE_DIAMETER_UM = 20.0, 0.01, 250.0
"""Gap, energy and wire diameter at which the impulse constant of a machine file holds."""
LEAST_GAP_UM = 5.0
"""Nearer metal does not raise the impulse (ours: the gas is then as thick as the craters are deep)."""
WATER_KG_M3 = 998.0
"""Density of water at 20 C."""
SLIT_LOGARITHM = 0.6
"""Mean of ln(slit / bubble) while the bubble crosses the slit (ours, derived: `docs/theory/gas.md`)."""


class BubbleLaw(NamedTuple):
    """Constants of the push for one wire.

    Attributes
    ----------
    impulse_Ns : float
        Impulse of 10 mJ delivered before the gas escapes, at a gap of 20 um.
    vent_us : float
        Time in us after which the gas of a discharge of 1 W escapes at a gap of 20 um.
    """

    impulse_Ns: float
    vent_us: float


def bubble_law(diameter_um: float, impulse_10mJ_Ns: float, bubble_share: float) -> BubbleLaw:
    """Return the constants of the push for a wire.

    Parameters
    ----------
    diameter_um : float
        Diameter of the wire in um.
    impulse_10mJ_Ns : float
        Impulse of 10 mJ on a wire of 250 um at a gap of 20 um; it grows with the square of the diameter, as the
        gas acts on the slit's area.
    bubble_share : float
        Share of the discharge's energy that goes into the gas, above 0 and up to 1.
    """
    slit_m = math.pi / 4 * diameter_um * 1e-6
    inertia = 2 * math.pi * WATER_KG_M3 * REFERENCE_GAP_UM * 1e-6 * SLIT_LOGARITHM
    return BubbleLaw(
        impulse_Ns=impulse_10mJ_Ns * (diameter_um / REFERENCE_DIAMETER_UM) ** 2,
        vent_us=1e6 * (0.75 * slit_m**2 * math.sqrt(inertia / bubble_share)) ** (2 / 3),
    )


@compiled
def vent_time_us(power_W: float, gap_um: float, law: BubbleLaw) -> float:
    """Time after ignition at which the gas of a discharge of constant power (above 0) escapes from the slit."""
    return law.vent_us * cube_root(max(gap_um, LEAST_GAP_UM) / (REFERENCE_GAP_UM * power_W))


@compiled
def bubble_impulse_Ns(power_W: float, burn_us: float, gap_um: float, law: BubbleLaw) -> float:
    """Impulse that the bubble of a discharge gives the wire where liquid fills the slit.

    ``J0 (d / 250 um)^2 (E_v / 10 mJ)^(1/2) (20 um / g)^(1/2)``, where ``E_v`` is the energy delivered before the gas
    escapes; the gap is taken as 5 um where it is less. Gas that covers the slit already is the caller's affair.

    Parameters
    ----------
    power_W : float
        Mean power of the discharge, 0 or more.
    burn_us : float
        Time for which it burns.
    gap_um : float
        Gap at its place.
    law : BubbleLaw
    """
    if power_W <= 0.0:
        return 0.0
    energy_J = power_W * min(burn_us, vent_time_us(power_W, gap_um, law)) * 1e-6
    return law.impulse_Ns * math.sqrt(energy_J / REFERENCE_J * REFERENCE_GAP_UM / max(gap_um, LEAST_GAP_UM))
