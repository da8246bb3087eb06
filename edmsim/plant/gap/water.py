"""Water: its properties at the temperature of the gap, and its pressure under a flushing nozzle."""

import math

REFERENCE_K = 293.15  # temperature for which a machine file gives permittivity and viscosity
DENSITY_KG_M3 = 998.0  # water at 20 C
AMBIENT_PA = 101_325.0  # pressure of the water around the kerf, and behind the wire, where the gas goes


def permittivity_ratio(temperature_K: float) -> float:
    """Permittivity of water over that at 20 C: 0.87 at 50 C, 0.69 at 100 C (Malmberg and Maryott, 1956)."""
    return _permittivity(temperature_K) / _permittivity(REFERENCE_K)


def _permittivity(temperature_K: float) -> float:
    t = temperature_K - 273.15
    return 87.740 - 0.40008 * t + 9.398e-4 * t**2 - 1.410e-6 * t**3


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
    # off the workpiece the water escapes through the curtain between the nozzle's rim and the face, without losses:
    # what drives the pump's flow through there is left, and the stagnation pressure of the free jet
    bore_m = bore_mm * 1e-3
    curtain_m2 = math.pi * bore_m * standoff_mm * 1e-3
    if curtain_m2 == 0.0:
        return set_Pa
    flow_m3_s = flow_l_min * M3_S_OF_L_MIN
    escapes_m_s, jet_m_s = flow_m3_s / curtain_m2, flow_m3_s / (math.pi / 4 * bore_m**2)
    return min(set_Pa, DENSITY_KG_M3 / 2 * (escapes_m_s * escapes_m_s + jet_m_s * jet_m_s))
