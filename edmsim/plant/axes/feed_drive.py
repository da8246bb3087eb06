"""Motor, rotor, screw and table of an axis: two masses on a spring with backlash and friction.

``J dw/dt = k i - b w - g F``, ``m dv/dt = F + load - c v``, where ``F`` is the force of the screw's spring and damper
from the distance by which the rotor leads the table, without the backlash. Time steps are semi-implicit, 20 us or a
fifth of a radian of the oscillation of table and rotor. In the full model MuJoCo moves the two masses, with the same
functions for forces and friction.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled import axis_rows
from edmsim.compiled.jit import compiled
from edmsim.errors import InputError
from edmsim.plant.axes.encoder import position, see_edges, watch_cam
from edmsim.plant.kernel.state import Axes

# DC motors: current of the winding under amplifier, bridge and supply; torque and heat.
#
# ``L di/dt = V - R i - k w``. The bridge runs in locked antiphase: the mean voltage of the winding over a PWM period
# is ``(2 duty - 1)`` times that of the bridge, in both directions of the current, so a duty of one half brakes. If
# the bridge is off, its diodes feed the remaining current back to the supply, and then the motor freewheels.
#
# A velocity amplifier has a reference voltage as input: 10 V commands the rotor speed ``10 * amplifier_rad_s_V``.
# From the difference to its tachometer a PI controller computes a limited current, and the bridge supplies the
# voltage for this current at the present speed. At 0 V it brakes with this current. Gain, symmetry and offset are
# adjusted by hand.

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
    """Raise `InputError` for a record of `MOTOR` with an impossible value."""
    for name in axis_rows.MOTOR.names or ():
        value = float(motor[name][0])
        fine = math.isfinite(value) and (value > 0 if name in _POSITIVE else value >= 0 or name in _EITHER)
        if not fine:
            least = "" if name in _EITHER else " and above 0" if name in _POSITIVE else " and 0 or more"
            raise InputError(f"the motor's {name} is {value:g}; it must be finite{least}")
    if not abs(float(motor["phase_error"][0])) < 1.0:
        raise InputError(f"the encoder's phase_error is {motor['phase_error'][0]:g}; it must be -1 to 1 count")


@compiled
def _settle(current: float, voltage: float, emf: float, motor: Any, dt: float) -> float:
    """Return the current after a time at constant voltage and speed; exact."""
    settled = (voltage - emf) / motor.resistance_ohm
    left = math.exp(-dt * motor.resistance_ohm / motor.inductance_H)
    return float(settled + (current - settled) * left)


@compiled
def _freewheel(row: Any, motor: Any, emf: float, dt: float) -> float:
    """Return the current of a motor whose bridge is off: it flows through the diodes to the supply until it is 0."""
    drop = row.link_V + 2.0 * motor.diode_V
    if row.current_A == 0.0:
        return _settle(0.0, math.copysign(drop, emf), emf, motor, dt) if abs(emf) > drop else 0.0
    after = _settle(row.current_A, -math.copysign(drop, row.current_A), emf, motor, dt)
    return after if after * row.current_A > 0.0 else 0.0


@compiled
def _feed(row: Any, motor: Any, drawn_A: float, dt: float) -> None:
    """Update the bridge voltage: a capacitor charged by a supply with resistance, current limit and no feedback."""
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
    """Advance current, supply and the winding's heat by a time (s); return the mean torque (Nm)."""
    emf, before = motor.torque_Nm_A * row.speed_rad_s, row.current_A
    if row.pins & axis_rows.FREEWHEEL:
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
        row.damage |= axis_rows.BRIDGE_DAMAGED
    if current > motor.peak_A:
        row.damage |= axis_rows.MAGNETS_DAMAGED
    if row.winding_K > motor.rated_K:
        row.damage |= axis_rows.WINDING_DAMAGED
    return float(motor.torque_Nm_A * mean)


@compiled
def _target_rad_s(row: Any, motor: Any) -> float:
    """Return the speed that the amplifier commands for its input voltage."""
    warmth = 1.0 - math.exp(-row.moved_ns * 1e-9 / motor.warm_s) if motor.warm_s > 0.0 else 1.0
    volts = row.duty * axis_rows.REFERENCE_V + motor.offset_V + motor.drift_V * warmth
    volts = min(max(volts, -axis_rows.REFERENCE_V), axis_rows.REFERENCE_V)
    gain = 1.0 + motor.gain_error + math.copysign(0.5 * motor.asymmetry, volts)
    return float(volts * gain * motor.amplifier_rad_s_V)


@compiled
def share_of_supply(row: Any, motor: Any, dt: float) -> float:
    """Return the share of the bridge voltage (-1 to 1) for the commanded current; advance the integral by `dt`."""
    error = _target_rad_s(row, motor) - row.speed_rad_s
    target_A = motor.amplifier_A_s * error + row.integral_A
    held_A = min(max(target_A, -motor.limit_A), motor.limit_A)
    if held_A == target_A:
        row.integral_A += motor.amplifier_A * error * dt
    volts = held_A * motor.resistance_ohm + motor.torque_Nm_A * row.speed_rad_s
    return float(min(max(volts / max(row.link_V, 1.0), -1.0), 1.0))


_LONGEST_NS = 20_000
"""Time step (ours): a hundredth of the electrical time constant of small motors, half a PWM period."""
_FURTHEST_UM = 1e9  # travel of rotor or table beyond which an axis has run away (ours: a kilometre)
_STEP_RAD = 0.2  # time step times the angular frequency of the fastest oscillation (ours)


def longest_step_ns(motor: NDArray[np.void]) -> int:
    """Return the time step for a motor, a record of `MOTOR`."""
    m = motor[0]
    omega2 = m["screw_N_m"] * (1 / m["table_kg"] + (m["um_per_rad"] * 1e-6) ** 2 / m["inertia_kg_m2"])
    return max(int(min(_LONGEST_NS, _STEP_RAD / math.sqrt(omega2) * 1e9)), 1)


@compiled
def screw_damping(row: Any, motor: Any) -> float:
    """Return the force (N) of the screw's damper on the table; 0 within the backlash."""
    if abs(row.rotor_um - row.place_um) < 0.5 * motor.backlash_um:
        return 0.0
    return float(motor.screw_N_s_m * (row.speed_rad_s * motor.um_per_rad - row.speed_um_s) * 1e-6)


@compiled
def _screw_spring(row: Any, motor: Any) -> float:
    """Return the force (N) of the screw's spring on the table."""
    ahead_um, play_um = row.rotor_um - row.place_um, 0.5 * motor.backlash_um
    if abs(ahead_um) <= play_um:
        return 0.0
    return float(motor.screw_N_m * (ahead_um - math.copysign(play_um, ahead_um)) * 1e-6)


@compiled
def speed_after_friction(before: float, after: float, friction: float, stiction: float) -> float:
    """Return the speed after a time step with dry friction; the arguments are its speed changes in slip and stick."""
    if abs(after) <= (stiction if before == 0.0 else friction):
        return 0.0
    return after - math.copysign(friction, after)


@compiled
def rotor_after_friction(row: Any, motor: Any, before: float, after: float, dt: float) -> float:
    """Return a rotor's speed (rad/s) after a time step with its friction; 0 if it is blocked."""
    if row.locked != 0:
        return 0.0
    per_Nm = dt / motor.inertia_kg_m2
    return speed_after_friction(before, after, per_Nm * motor.friction_Nm, per_Nm * motor.stiction_Nm)


@compiled
def table_after_friction(motor: Any, before: float, after: float, dt: float) -> float:
    """Return a table's speed (um/s) after a time step with the friction of its ways."""
    per_N = dt * 1e6 / motor.table_kg
    return speed_after_friction(before, after, per_N * motor.way_friction_N, per_N * motor.way_stiction_N)


@compiled
def _turn(row: Any, motor: Any, dt: float) -> None:
    """Advance an axis by a time step (s)."""
    torque = energise(row, motor, dt)
    force = _screw_spring(row, motor) + screw_damping(row, motor)
    speed, inertia = row.speed_rad_s, motor.inertia_kg_m2
    free = speed + dt * (torque + row.hand_Nm - force * motor.um_per_rad * 1e-6) / inertia
    row.speed_rad_s = rotor_after_friction(row, motor, speed, free / (1.0 + dt * motor.damping_Nm_s / inertia), dt)
    table = row.speed_um_s
    free = table + dt * 1e6 * (force + motor.load_N + row.hand_N) / motor.table_kg
    row.speed_um_s = table_after_friction(motor, table, free / (1.0 + dt * motor.way_N_s_m / motor.table_kg), dt)
    row.rotor_um += row.speed_rad_s * motor.um_per_rad * dt
    row.place_um += row.speed_um_s * dt


@compiled
def coast(axes: Axes, axis: int, until_ns: int) -> bool:
    """Advance a servo axis to a time with constant outputs, in equal time steps; see `coast_all`."""
    drive, row, motor = axes.drives[axis], axes.rows[axis], axes.motors[axis]
    span_ns = until_ns - row.moved_ns
    if span_ns <= 0:
        return True
    steps = -(-span_ns // axes.step_ns[axis])
    dt, start_ns = span_ns * 1e-9 / steps, row.moved_ns
    for k in range(steps):
        before = position(row, motor)
        _turn(row, motor, dt)
        if not (abs(row.place_um) < _FURTHEST_UM and abs(row.rotor_um) < _FURTHEST_UM):
            return False  # otherwise its encoder would count edges endlessly
        see_edges(drive, row, motor, before, start_ns + k * dt * 1e9, start_ns + (k + 1) * dt * 1e9)
        watch_cam(row, motor, start_ns + (k + 1) * dt * 1e9)
    row.moved_ns = until_ns
    return True


@compiled
def coast_all(axes: Axes, first: int, until_ns: int) -> bool:
    """Advance the servo axes from `first` on; return False if a position is out of range or not finite."""
    for axis in range(first, axis_rows.N_AXES):
        if axes.drives[axis].sample != 0 and not coast(axes, axis, until_ns):
            return False
    return True
