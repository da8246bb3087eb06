"""Rotor, screw and table of an axis: two masses on a spring with backlash and friction.

``J dw/dt = k i - b w - g F``, ``m dv/dt = F + load - c v``, ``F`` of the screw's spring and damper by which the rotor
is ahead of the table, less the backlash. Time steps are semi-implicit, 20 us or a fifth of a radian of the swing of
table and rotor. MuJoCo moves the two masses in the full model; forces and friction are the same functions there.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.axis_rows import N_AXES
from edmsim.compiled.jit import compiled
from edmsim.plant.axes.encoder import position, see_edges, watch_cam
from edmsim.plant.axes.motor import energise
from edmsim.plant.kernel.state import Axes

_LONGEST_NS = 20_000
"""Time step (ours): a hundredth of the electrical time constant of small motors, as long as half a bridge's pulse."""
_FURTHEST_UM = 1e9  # travel of rotor or table beyond which an axis has run away (ours: a kilometre)
_STEP_RAD = 0.2  # time step as a share of the radian of the fastest swing (ours)


def longest_step_ns(motor: NDArray[np.void]) -> int:
    """Return the time step for a motor, a row of `MOTOR`."""
    m = motor[0]
    omega2 = m["screw_N_m"] * (1 / m["table_kg"] + (m["um_per_rad"] * 1e-6) ** 2 / m["inertia_kg_m2"])
    return max(int(min(_LONGEST_NS, _STEP_RAD / math.sqrt(omega2) * 1e9)), 1)


@compiled
def screw_damping(row: Any, motor: Any) -> float:
    """Force (N) of the screw's damper on the table; none within the backlash."""
    if abs(row.rotor_um - row.place_um) < 0.5 * motor.backlash_um:
        return 0.0
    return float(motor.screw_N_s_m * (row.speed_rad_s * motor.um_per_rad - row.speed_um_s) * 1e-6)


@compiled
def _screw_spring(row: Any, motor: Any) -> float:
    """Force (N) of the screw's spring on the table."""
    ahead_um, play_um = row.rotor_um - row.place_um, 0.5 * motor.backlash_um
    if abs(ahead_um) <= play_um:
        return 0.0
    return float(motor.screw_N_m * (ahead_um - math.copysign(play_um, ahead_um)) * 1e-6)


@compiled
def rubbed(before: float, after: float, friction: float, stiction: float) -> float:
    """Speed after a time step with dry friction that can change it by so much while sliding and while sticking."""
    if abs(after) <= (stiction if before == 0.0 else friction):
        return 0.0
    return after - math.copysign(friction, after)


@compiled
def rubbed_rotor(row: Any, motor: Any, before: float, after: float, dt: float) -> float:
    """Speed of a rotor (rad/s) after a time step with its friction; nil where it is held."""
    if row.locked != 0:
        return 0.0
    per_Nm = dt / motor.inertia_kg_m2
    return rubbed(before, after, per_Nm * motor.friction_Nm, per_Nm * motor.stiction_Nm)


@compiled
def rubbed_table(motor: Any, before: float, after: float, dt: float) -> float:
    """Speed of a table (um/s) after a time step with the friction of its ways."""
    per_N = dt * 1e6 / motor.table_kg
    return rubbed(before, after, per_N * motor.way_friction_N, per_N * motor.way_stiction_N)


@compiled
def _turn(row: Any, motor: Any, dt: float) -> None:
    """Carry an axis on over a time step (s)."""
    torque = energise(row, motor, dt)
    force = _screw_spring(row, motor) + screw_damping(row, motor)
    speed, inertia = row.speed_rad_s, motor.inertia_kg_m2
    free = speed + dt * (torque + row.hand_Nm - force * motor.um_per_rad * 1e-6) / inertia
    row.speed_rad_s = rubbed_rotor(row, motor, speed, free / (1.0 + dt * motor.damping_Nm_s / inertia), dt)
    table = row.speed_um_s
    free = table + dt * 1e6 * (force + motor.load_N + row.hand_N) / motor.table_kg
    row.speed_um_s = rubbed_table(motor, table, free / (1.0 + dt * motor.way_N_s_m / motor.table_kg), dt)
    row.rotor_um += row.speed_rad_s * motor.um_per_rad * dt
    row.place_um += row.speed_um_s * dt


@compiled
def coast(axes: Axes, axis: int, until_ns: int) -> bool:
    """Move an axis whose drive has a loop to a time, its outputs held, in equal time steps; see `coast_all`."""
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
            return False  # its encoder would count edges without end
        see_edges(drive, row, motor, before, start_ns + k * dt * 1e9, start_ns + (k + 1) * dt * 1e9)
        watch_cam(row, motor, start_ns + (k + 1) * dt * 1e9)
    row.moved_ns = until_ns
    return True


@compiled
def coast_all(axes: Axes, first: int, until_ns: int) -> bool:
    """Move the axes from `first` on whose drives have a loop; false if a place is out of range or not finite."""
    for axis in range(first, N_AXES):
        if axes.drives[axis].sample != 0 and not coast(axes, axis, until_ns):
            return False
    return True
