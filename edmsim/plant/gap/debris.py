"""Debris in the gap, and how the flushing carries it off.

Two jets push fresh water in from above and below. It travels towards mid-height, leaving backwards through
the kerf on its way, so the flow past a slice falls linearly from the nozzle to the middle. Debris is a volume
share of the gap's water, one number per slice.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import compiled


def flow_speed_m_s(pressure_Pa: float, viscosity_Pa_s: float, side_gap_um: float, height_mm: float) -> float:
    """Mean axial speed of the water at a nozzle.

    Slot Poiseuille flow over half the height: ``dp g^2 / (12 eta (h/2))``.

    Parameters
    ----------
    pressure_Pa : float
        Pressure of the flushing jets over the surroundings.
    viscosity_Pa_s : float
    side_gap_um : float
        Gap of the slot the water is pushed through.
    height_mm : float
        Workpiece height.
    """
    return pressure_Pa * (side_gap_um * 1e-6) ** 2 / (12 * viscosity_Pa_s * height_mm * 1e-3 / 2)


def nozzle_flow_per_slice_us(
    pressure_Pa: float, viscosity_Pa_s: float, side_gap_um: float, height_mm: float, n_slices: int
) -> float:
    """Water changes per us of the slice next to a nozzle, one of `n_slices`; see `flow_speed_m_s`."""
    speed = flow_speed_m_s(pressure_Pa, viscosity_Pa_s, side_gap_um, height_mm)
    return speed / (height_mm * 1e-3 / n_slices) * 1e-6


@compiled
def flush(debris: NDArray[np.float64], changes: float) -> None:
    """Carry debris towards mid-height and out, for `changes` water changes of the slice at the nozzle.

    Implicit upwind, so that no interval is too long. The middle slice of an odd number takes from both sides.
    """
    n = debris.shape[0]
    half = n / 2.0
    for side in range(2):
        upstream = 0.0
        for k in range((n + 1) // 2):
            s = k if side == 0 else n - 1 - k
            flow = changes * (1.0 - k / half)
            if 2 * k + 1 == n:
                flow *= 0.5
            debris[s] = (debris[s] + flow * upstream) / (1.0 + flow)
            upstream = debris[s]


@compiled
def bridged_probability(
    debris: float, gap_um: float, base: float, per_um: float, ceiling: float, steepness: float
) -> float:
    """Probability that debris bridges a gap: a sigmoid around the critical share (form and values: SPARC)."""
    critical = min(ceiling, base + per_um * gap_um)
    x = steepness * (debris - critical)
    if x > 30.0:
        return 1.0
    if x < -30.0:
        return 0.0
    return 1.0 / (1.0 + math.exp(-x))
