"""Direct-current motors: the current of the winding under amplifier, bridge and supply, its torque and heat.

``L di/dt = V - R i - k w``. The bridge is a locked antiphase one: over a period of its pulses the winding has the
mean ``(2 duty - 1)`` of the voltage at the bridge, in either direction of the current, so that a duty of one half
brakes. Off, its diodes lead a current that still flows back to the supply until it is gone, and the motor
freewheels.

A velocity amplifier drives the bridge by a reference voltage: 10 V asks for the rotor's speed
``10 * amplifier_rad_s_V``. It compares that with its tachometer and asks for a limited current of the winding,
proportional and integral to the error of speed; the bridge gives the voltage that this current needs at this speed.
At 0 V it brakes with that current, so that the axis coasts to a stop. Gain, symmetry and offset are adjusted by hand.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.axis_rows import BRIDGE_DAMAGED, FREEWHEEL, MAGNETS_DAMAGED, MOTOR, REFERENCE_V, WINDING_DAMAGED
from edmsim.compiled.jit import compiled
from edmsim.errors import InputError

_POSITIVE = frozenset(
    (
        "supply_ohm", "supply_A", "link_F", "bridge_A", "resistance_ohm", "inductance_H", "torque_Nm_A", "peak_A",
        "rated_K", "winding_J_K", "winding_K_W", "inertia_kg_m2", "um_per_rad", "screw_N_m", "table_kg",
        "counts_per_rad", "index_um", "edge_rate_Hz",
    )
)
_EITHER = frozenset(
    (
        "load_N", "phase_error", "index_phase_um", "gain_error", "asymmetry", "offset_V", "drift_V", "cam_low_um",
        "cam_high_um",
    )
)


def check_motor(motor: NDArray[np.void]) -> None:
    """Raise `InputError` for a row of `MOTOR` with a value that no motor can have."""
    if motor.dtype != MOTOR or motor.shape != (1,):
        raise InputError("a drive's motor is one row of edmsim.compiled.axis_rows.MOTOR")
    for name in MOTOR.names or ():
        value = float(motor[name][0])
        fine = math.isfinite(value) and (value > 0 if name in _POSITIVE else value >= 0 or name in _EITHER)
        if not fine:
            least = "" if name in _EITHER else " and above 0" if name in _POSITIVE else " and 0 or more"
            raise InputError(f"the motor's {name} is {value:g}; it must be finite{least}")
    if not abs(float(motor["phase_error"][0])) < 1.0:
        raise InputError(f"the encoder's phase_error is {motor['phase_error'][0]:g}; it must be -1 to 1 count")


@compiled
def _settle(current: float, voltage: float, emf: float, motor: Any, dt: float) -> float:
    """Current after a time at constant voltage and speed: exact."""
    settled = (voltage - emf) / motor.resistance_ohm
    left = math.exp(-dt * motor.resistance_ohm / motor.inductance_H)
    return float(settled + (current - settled) * left)


@compiled
def _freewheel(row: Any, motor: Any, emf: float, dt: float) -> float:
    """Current of a motor whose bridge is off: through the diodes against the supply, until there is none."""
    drop = row.link_V + 2.0 * motor.diode_V
    if row.current_A == 0.0:
        return _settle(0.0, math.copysign(drop, emf), emf, motor, dt) if abs(emf) > drop else 0.0
    after = _settle(row.current_A, -math.copysign(drop, row.current_A), emf, motor, dt)
    return after if after * row.current_A > 0.0 else 0.0


@compiled
def _feed(row: Any, motor: Any, drawn_A: float, dt: float) -> None:
    """Voltage at the bridge: a capacitor behind a supply with a resistance, a limit of current, and no way back."""
    charge = dt / motor.link_F
    fed = row.link_V + charge * (motor.supply_V / motor.supply_ohm - drawn_A)
    link_V = fed / (1.0 + charge / motor.supply_ohm)
    supplied_A = (motor.supply_V - link_V) / motor.supply_ohm
    if supplied_A < 0.0:
        link_V = row.link_V - charge * drawn_A
    elif supplied_A > motor.supply_A:
        link_V = row.link_V + charge * (motor.supply_A - drawn_A)
    row.link_V = max(link_V, 0.0)


@compiled
def energise(row: Any, motor: Any, dt: float) -> float:
    """Carry current, supply and the winding's heat on over a time (s); return the mean torque (Nm)."""
    emf, before = motor.torque_Nm_A * row.speed_rad_s, row.current_A
    if row.pins & FREEWHEEL:
        row.integral_A = 0.0
        row.current_A = _freewheel(row, motor, emf, dt)
        mean = 0.5 * (before + row.current_A)
        drawn_A = -abs(mean)
    else:
        duty = row.duty if motor.amplifier_rad_s_V == 0.0 else share_of_supply(row, motor, dt)
        row.current_A = _settle(before, duty * row.link_V, emf, motor, dt)
        mean = 0.5 * (before + row.current_A)
        drawn_A = duty * mean
    _feed(row, motor, drawn_A, dt)
    current = abs(row.current_A)
    row.peak_A = max(row.peak_A, current)
    heat_W = motor.resistance_ohm * mean * mean
    row.winding_K += dt * (heat_W - row.winding_K / motor.winding_K_W) / motor.winding_J_K
    if current > motor.bridge_A:
        row.damage |= BRIDGE_DAMAGED
    if current > motor.peak_A:
        row.damage |= MAGNETS_DAMAGED
    if row.winding_K > motor.rated_K:
        row.damage |= WINDING_DAMAGED
    return float(motor.torque_Nm_A * mean)


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
