"""Pressure of a flushing nozzle at the workpiece, on which it lies or off which it stands."""

from __future__ import annotations

import math

from edmsim.plant.gap.water import DENSITY_KG_M3

M3_S_OF_L_MIN = 1e-3 / 60


def face_Pa(set_Pa: float, standoff_mm: float, bore_mm: float, flow_l_min: float) -> float:
    """Return the pressure at the workpiece's face over the surroundings.

    Off the workpiece the water escapes through the curtain between the nozzle's rim and the face, without losses:
    what drives the pump's flow through there is left, and the stagnation pressure of the free jet.
    """
    bore_m = bore_mm * 1e-3
    curtain_m2 = math.pi * bore_m * standoff_mm * 1e-3
    if curtain_m2 == 0.0:
        return set_Pa
    flow_m3_s = flow_l_min * M3_S_OF_L_MIN
    escapes_m_s, jet_m_s = flow_m3_s / curtain_m2, flow_m3_s / (math.pi / 4 * bore_m**2)
    return min(set_Pa, DENSITY_KG_M3 / 2 * (escapes_m_s * escapes_m_s + jet_m_s * jet_m_s))
