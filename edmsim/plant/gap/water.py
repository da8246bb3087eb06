"""The water in the gap: its properties, its pressure under a flushing nozzle, and the debris that it carries.

Two jets drive fresh water in from below and above. It flows to the height where they meet, and leaves backwards
through the kerf on its way, so the flow falls linearly from the nozzle to that height, which is the middle if both
pressures are equal. Debris is a volume share of the gap's water in every slice.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import compiled
from edmsim.compiled.vectors import COORDINATES, load, spread, total

REFERENCE_K = 293.15  # temperature of a machine file's permittivity and viscosity
DENSITY_KG_M3 = 998.0  # water at 20 C
AMBIENT_PA = 101_325.0  # pressure around the kerf, and behind the wire, where the gas escapes to


def permittivity_ratio(temperature_K: float) -> float:
    """Permittivity of water over that at 20 C: 0.87 at 50 C, 0.69 at 100 C (Malmberg and Maryott, 1956)."""
    celsius = temperature_K - 273.15, REFERENCE_K - 273.15
    here, there = (87.740 - 0.40008 * t + 9.398e-4 * t**2 - 1.410e-6 * t**3 for t in celsius)
    return here / there


def viscosity_ratio(temperature_K: float) -> float:
    """Viscosity of water over that at 20 C: 0.54 at 50 C, 0.28 at 100 C (Vogel: eta ~ 10^(247.8 / (T - 140)))."""
    return float(10 ** (247.8 / (temperature_K - 140.0) - 247.8 / (REFERENCE_K - 140.0)))


def surface_tension_N_m(temperature_K: float) -> float:
    """Surface tension of water in N/m: 0.073 at 20 C, 0.059 at 100 C (IAPWS)."""
    tau = 1 - temperature_K / 647.096
    return float(0.2358 * tau**1.256 * (1 - 0.625 * tau))


M3_S_OF_L_MIN = 1e-3 / 60


def face_Pa(set_Pa: float, standoff_mm: float, bore_mm: float, flow_l_min: float) -> float:
    """Return the pressure at the workpiece's face over the surroundings."""
    # With a stand-off the water escapes without losses between the nozzle's rim and the face. The pressure that
    # drives the pump's flow through this opening remains, and the stagnation pressure of the free jet.
    bore_m = bore_mm * 1e-3
    curtain_m2 = math.pi * bore_m * standoff_mm * 1e-3
    if curtain_m2 == 0.0:
        return set_Pa
    flow_m3_s = flow_l_min * M3_S_OF_L_MIN
    escapes_m_s, jet_m_s = flow_m3_s / curtain_m2, flow_m3_s / (math.pi / 4 * bore_m**2)
    return min(set_Pa, DENSITY_KG_M3 / 2 * (escapes_m_s * escapes_m_s + jet_m_s * jet_m_s))


class Jets(NamedTuple):
    """Water of two nozzles in the gap."""

    # height at which the jets meet, as a share of the workpiece's: 0 if the lower one is off, 1 if the upper one is
    lower_share: float
    # mean axial speed of the water at each nozzle
    lower_m_s: float
    upper_m_s: float

    def past_m_s(self, height_share: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the speed at heights over the lower face, as shares of the workpiece's height."""
        above = height_share - self.lower_share
        below_slope = self.lower_m_s / self.lower_share if self.lower_share > 0.0 else 0.0
        above_slope = self.upper_m_s / (1.0 - self.lower_share) if self.lower_share < 1.0 else 0.0
        return below_slope * np.maximum(-above, 0.0) + above_slope * np.maximum(above, 0.0)

    def flow_share(self, slices: int) -> NDArray[np.float64]:
        """Return the share of the lower and the upper nozzle's water that enters each slice: (2, slices).

        The slice in which the jets meet receives water from both, up to the height where they meet.
        """
        share = np.zeros((2, slices))
        for side, reach in enumerate((self.lower_share * slices, (1.0 - self.lower_share) * slices)):
            k = np.arange(math.ceil(reach))
            entering = (1.0 - k / reach) * np.minimum(1.0, reach - k) if len(k) else k
            share[side, k if side == 0 else slices - 1 - k] = entering
        return share


def _meeting_share(lower_Pa: float, upper_Pa: float) -> float:
    """Return the height z at which two jets meet, over the workpiece's; the pressure ratio is ``(z / (h - z))^2``."""
    # the same amount of water leaves through the kerf at every height (ours), so both flows fall with one slope
    lower, upper = math.sqrt(lower_Pa), math.sqrt(upper_Pa)
    return lower / (lower + upper) if lower + upper > 0.0 else 0.5


def jets(lower_Pa: float, upper_Pa: float, viscosity_Pa_s: float, side_gap_um: float, height_mm: float) -> Jets:
    """Return the flow of two nozzles through the gap."""
    share = _meeting_share(lower_Pa, upper_Pa)
    return Jets(
        share,
        flow_speed_m_s(lower_Pa, viscosity_Pa_s, side_gap_um, share * height_mm),
        flow_speed_m_s(upper_Pa, viscosity_Pa_s, side_gap_um, (1.0 - share) * height_mm),
    )


def flow_speed_m_s(pressure_Pa: float, viscosity_Pa_s: float, side_gap_um: float, length_mm: float) -> float:
    """Return the mean axial speed of slot Poiseuille flow at a nozzle, ``dp g^2 / (12 eta z)``; 0 if z is 0."""
    if length_mm == 0.0:
        return 0.0
    return pressure_Pa * (side_gap_um * 1e-6) ** 2 / (12 * viscosity_Pa_s * length_mm * 1e-3)


KERF_LOSS, KERF_FRICTION = 1.5, 0.04
"""Velocity heads lost at a sharp entry and exit of the kerf, and friction factor of a turbulent flow in a slot at
Reynolds numbers of some 10 000 (handbook)."""


def kerf_jets(lower_Pa: float, upper_Pa: float, kerf_um: float, height_mm: float) -> Jets:
    """Return the turbulent flow of two nozzles through the kerf behind the wire."""
    # ``v = sqrt(2 dp / rho / (1.5 + 0.04 z / (2 w)))`` over the length z to where the jets meet, as in the gap
    share = _meeting_share(lower_Pa, upper_Pa)

    def speed_m_s(pressure_Pa: float, length_share: float) -> float:
        loss = KERF_LOSS + KERF_FRICTION * length_share * height_mm / (2 * kerf_um * 1e-3)
        return math.sqrt(2 * pressure_Pa / DENSITY_KG_M3 / loss)

    return Jets(share, speed_m_s(lower_Pa, share), speed_m_s(upper_Pa, 1.0 - share))


EINSTEIN = 2.5  # relative rise of a liquid's viscosity per volume share of particles (Einstein, 1906)


@compiled
def mean_of_slices(shares: NDArray[np.float64], slices: int) -> float:
    """Return the mean over the height of a share per slice, without the padding: of debris in the water, of gas."""
    sum_ = spread(0.0)
    for s in range(0, shares.shape[0], COORDINATES):
        sum_ += load(shares, (s,))
    return float(total(sum_) / slices)


@compiled
def flush(debris: NDArray[np.float64], lower: float, upper: float, share: NDArray[np.float64]) -> None:
    """Carry debris to where the jets meet, and out."""
    # implicit upwind scheme, stable for any interval; the slice in which the jets meet receives from both sides
    n = share.shape[1]
    for side in range(2):
        changes = lower if side == 0 else upper
        upstream = 0.0
        for k in range(n):
            s = k if side == 0 else n - 1 - k
            if share[side, s] == 0.0:
                break
            flow = changes * share[side, s]
            stays = 1.0 / (1.0 + flow)  # a division that does not depend on the upstream slice
            debris[s] = (debris[s] + flow * upstream) * stays
            upstream = debris[s]


@compiled
def bridged_probability(
    debris: float, gap_um: float, base: float, per_um: float, ceiling: float, steepness: float
) -> float:
    """Return the probability that debris bridges a gap: a sigmoid around a critical share (form, values: SPARC)."""
    critical = min(ceiling, base + per_um * gap_um)
    x = steepness * (debris - critical)
    if x > 30.0:
        return 1.0
    if x < -30.0:
        return 0.0
    return 1.0 / (1.0 + math.exp(-x))
