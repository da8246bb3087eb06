"""Direct-current motors: current, speed and place of an axis under the voltage its drive commands.

``L di/dt = V - R i - k w``, ``J dw/dt = k i - b w``, ``dx/dt = g w``: winding, rotor with everything it moves, and
travel. Rigid: the screw's spring is not in it. In the modal model it is propagated exactly over the steps of the
pulse's grid; in the full model MuJoCo moves x and y, and here only the current is, and the axes u and v.
"""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.axis_rows import MOTOR, N_AXES
from edmsim.compiled.jit import compiled
from edmsim.errors import InputError
from edmsim.plant.kernel.state import GRID, Axes

Array = NDArray[np.float64]


def check_motor(motor: NDArray[np.void]) -> None:
    """Raise `InputError` for a row of `MOTOR` with a value that no motor can have."""
    if motor.dtype != MOTOR or motor.shape != (1,):
        raise InputError("a drive's motor is one row of edmsim.compiled.axis_rows.MOTOR")
    assert MOTOR.names is not None
    for name in MOTOR.names:
        value = float(motor[name][0])
        fine = math.isfinite(value) and (value >= 0 if name == "damping_Nm_s" else value > 0)
        if not fine:
            least = "0 or more" if name == "damping_Nm_s" else "above 0"
            raise InputError(f"the motor's {name} is {value:g}; it must be finite and {least}")


@functools.lru_cache(maxsize=64)
def transitions(motors: tuple[bytes | None, ...], grid_us: float) -> Array:
    """Return the transition tables of some motors on a time grid; plants of one machine share them.

    Parameters
    ----------
    motors : tuple of bytes or None
        Row of `MOTOR` of every axis, None for one under a stepper.
    grid_us : float
        Step of the grid.

    Returns
    -------
    (axes, GRID + 1, 3, 3)
        See `edmsim.plant.kernel.state.Axes`.
    """
    from scipy.linalg import expm

    tables = np.zeros((N_AXES, GRID + 1, 3, 3))
    spans = np.arange(GRID + 1) * grid_us * 1e-6
    for axis, row in enumerate(motors):
        if row is None:
            continue
        m = np.frombuffer(row, MOTOR)[0]
        inductance, inertia, constant = m["inductance_H"], m["inertia_kg_m2"], m["torque_Nm_A"]
        rates = np.zeros((4, 4))  # of current, speed, travel and voltage
        rates[0] = -m["resistance_ohm"] / inductance, -constant / inductance, 0.0, 1.0 / inductance
        rates[1] = constant / inertia, -m["damping_Nm_s"] / inertia, 0.0, 0.0
        rates[2, 1] = m["um_per_rad"]
        tables[axis] = expm(rates * spans[:, None, None])[:, :3, [0, 1, 3]]
    return tables


@compiled
def coast(state: NDArray[np.void], axes: Axes, k: int) -> None:
    """Move the axes whose drives have a loop over `k` steps of the pulse's grid, their voltages held."""
    for axis in range(N_AXES):
        if axes.drives[axis].sample == 0:
            continue
        row, by = axes.rows[axis], axes.transition[axis, k]
        current, speed, voltage = row.current_A, row.speed_rad_s, row.voltage_V
        row.current_A = by[0, 0] * current + by[0, 1] * speed + by[0, 2] * voltage
        row.speed_rad_s = by[1, 0] * current + by[1, 1] * speed + by[1, 2] * voltage
        row.place_um += by[2, 0] * current + by[2, 1] * speed + by[2, 2] * voltage
        state[0].axis_um[axis] = row.place_um


@compiled
def step_motors(state: NDArray[np.void], axes: Axes, dt_us: float) -> None:
    """Move the motors' currents over a time step of MuJoCo, and the axes u and v, of which it knows nothing."""
    dt = dt_us * 1e-6
    for axis in range(N_AXES):
        if axes.drives[axis].sample == 0:
            continue
        row, motor = axes.rows[axis], axes.motors[axis]
        settled = (row.voltage_V - motor.torque_Nm_A * row.speed_rad_s) / motor.resistance_ohm
        left = math.exp(-dt * motor.resistance_ohm / motor.inductance_H)
        row.current_A = settled + (row.current_A - settled) * left
        if axis >= 2:
            torque = motor.torque_Nm_A * row.current_A - motor.damping_Nm_s * row.speed_rad_s
            row.speed_rad_s += torque / motor.inertia_kg_m2 * dt
            row.place_um += motor.um_per_rad * row.speed_rad_s * dt
            state[0].axis_um[axis] = row.place_um
