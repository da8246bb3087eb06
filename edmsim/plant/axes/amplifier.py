"""Velocity amplifiers: analogue drives from their reference voltage to the motor's current.

A reference of 10 V asks for the rotor's speed ``10 * amplifier_rad_s_V``. The amplifier compares that with its
tachometer and asks a current of the winding, proportional and integral to the error of speed and limited; the bridge
gives the voltage that this current needs at this speed. A reference of 0 V brakes with that current, so that the axis
coasts to a stop. Gain, symmetry and offset are as good as somebody's screwdriver.
"""

from __future__ import annotations

import math
from typing import Any

from edmsim.compiled.axis_rows import REFERENCE_V
from edmsim.compiled.jit import compiled


@compiled
def _target_rad_s(row: Any, motor: Any) -> float:
    """Speed that the amplifier makes of the voltage at its input."""
    warmth = 1.0 - math.exp(-row.moved_ns * 1e-9 / motor.warm_s) if motor.warm_s > 0.0 else 1.0
    volts = row.duty * REFERENCE_V + motor.offset_V + motor.drift_V * warmth
    volts = min(max(volts, -REFERENCE_V), REFERENCE_V)
    gain = 1.0 + motor.gain_error + math.copysign(0.5 * motor.asymmetry, volts)
    return float(volts * gain * motor.amplifier_rad_s_V)


@compiled
def share_of_supply(row: Any, motor: Any, dt: float) -> float:
    """Share of the bridge's voltage (-1 to 1) for the current asked for; carry the integral on over a time (s)."""
    error = _target_rad_s(row, motor) - row.speed_rad_s
    target_A = motor.amplifier_A_s * error + row.integral_A
    held_A = min(max(target_A, -motor.limit_A), motor.limit_A)
    if held_A == target_A:
        row.integral_A += motor.amplifier_A * error * dt
    volts = held_A * motor.resistance_ohm + motor.torque_Nm_A * row.speed_rad_s
    return float(min(max(volts / max(row.link_V, 1.0), -1.0), 1.0))
