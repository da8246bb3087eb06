"""Push of a discharge's gas bubble on the wire.

The bubble is confined in the slit between the wire's front half and the metal. First it drives the water out: that
push grows with the square root of the energy delivered until the gas reaches the slit's open edges, after one to
three us. Then the gas escapes through the edges, and pushes with what pressure the discharge keeps up against that.
Derivation, figure and uncertainty: ``docs/theory/gas.md``.
"""

import math
from typing import NamedTuple

from edmsim.compiled.elementary import cube_root, inverse_cube_root
from edmsim.compiled.jit import compiled
from edmsim.plant.gap.water import AMBIENT_PA, DENSITY_KG_M3

REFERENCE_GAP_UM, REFERENCE_J, REFERENCE_DIAMETER_UM = 20.0, 0.01, 250.0
"""Gap, energy and wire diameter at which the impulse constant of a machine file holds."""
LEAST_GAP_UM = 5.0  # nearer metal does not raise the impulse (ours: craters and asperities are as large)
SLIT_LOGARITHM = 0.6  # mean of ln(slit / bubble) while the bubble crosses the slit (ours: the integration, 0.5 to 1)
LATE_SHARE = 0.7
"""Rise of the energy that drives the water, half of the gas's while the discharge burns, if that ends at once and the
gas has all the time until the vent to give the rest (ours: the integration, 0.6 to 0.8)."""
HEAT_RATIO = 1.3  # of specific heats of steam (tables, 100 to 1000 C; less where it dissociates, down to 1.15)
ESCAPE_M_S = 270.0
"""Volume of gas per area of the edges and time at choked flow: 0.585 of its speed of sound, here that of dry steam at
100 C (ours: 150 if it carries spray to 480 at 850 C)."""
ESCAPE_AREA, ESCAPE_EDGE = 2.267, 4.0
"""Projected area of gas that has reached both edges, and length of edge that it leaves through, in half widths of the
slit (ours, derived: a circle between the edges, by the cosine of the place on the wire)."""


class BubbleLaw(NamedTuple):
    """Constants of the push for one wire; those of the gas that escapes hold at a gap of 20 um."""

    impulse_Ns: float  # impulse of the water driven out by 10 mJ, delivered until the gas escapes, at a gap of 20 um
    vent_us: float  # time in us after which the gas of a discharge of 1 W escapes
    escape_Ns_J: float  # impulse of the escaping gas per energy of the discharge
    ambient_N: float  # force of the ambient pressure against it


def bubble_law(diameter_um: float, impulse_10mJ_Ns: float, bubble_share: float) -> BubbleLaw:
    """Return the push for a wire from the impulse of 10 mJ on one of 250 um; it grows with the diameter's square."""
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
    """Time after ignition at which the gas of a discharge of constant power (above 0) reaches the slit's edges."""
    return law.vent_us * cube_root(max(gap_um, LEAST_GAP_UM) * (1.0 / power_W / REFERENCE_GAP_UM))


@compiled
def bubble_impulse_Ns(power_W: float, burn_us: float, gap_um: float, law: BubbleLaw) -> float:
    """Impulse that the bubble of a discharge gives the wire where liquid fills the slit."""
    # the water driven out gives ``J0 (d / 250 um)^2 (E_w / 10 mJ)^(1/2) (20 um / g)^(1/2)``; what escapes adds ``k
    # (20 um / g)`` times half of the energy that the gas holds then, and ``k (20 um / g) P - F0`` as long as the
    # discharge burns on
    if power_W <= 0.0:
        return 0.0
    # one root, and no division that waits for the gap
    per_W = 1.0 / power_W
    per_vent = inverse_cube_root(max(gap_um, LEAST_GAP_UM) * (per_W / REFERENCE_GAP_UM))
    narrow = per_vent * per_vent * per_vent * per_W  # 20 um over the gap
    escape = law.escape_Ns_J * narrow
    until_vent = min(burn_us * (1.0 / law.vent_us) * per_vent, 1.0)
    confined_us = vent_time_us(power_W, gap_um, law) * until_vent
    energy_J = power_W * confined_us * 1e-6
    # a discharge that ends before its gas escapes leaves it the time to give more of its energy
    driving_J = energy_J * (1.0 + LATE_SHARE * (1.0 - until_vent))
    water_Ns = law.impulse_Ns * math.sqrt(driving_J * (1.0 / REFERENCE_J) * narrow)
    escape_N = max(0.0, escape * power_W - law.ambient_N)
    return water_Ns + 0.5 * escape * energy_J + escape_N * (burn_us - confined_us) * 1e-6
