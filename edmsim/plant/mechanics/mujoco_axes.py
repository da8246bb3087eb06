"""Rotors and carriages of x and y under MuJoCo: one time step from compiled code, with the drives' inputs.

`edmsim.plant.mechanics.mujoco_loop` steps the machine with its wire, pulse by pulse; the drives' bench its table.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import compiled
from edmsim.compiled.memory_views import call_with_two
from edmsim.plant.axes.encoder import position, see_edges, watch_cam
from edmsim.plant.axes.shaft import energise, rubbed_rotor, rubbed_table, screw_damping
from edmsim.plant.kernel.state import CHANGING, Array, Axes, Stored


class FullLink(NamedTuple):
    """What compiled code needs of a MuJoCo model: addresses, views into MuJoCo's memory, and constants."""

    # valid as long as the model and data it was made from; `edmsim.plant.mechanics.mujoco_table.FullMechanics` keeps
    # them
    # addresses of the function and of its two arguments
    mj_step: int
    model: int
    data: int
    timestep: Annotated[Array, Stored(1)]  # (1,): the model's time step in s
    # (degrees of freedom,): positions, velocities and applied forces, SI
    qpos: Annotated[Array, Stored("dofs")]
    qvel: Annotated[Array, Stored("dofs")]
    force: Annotated[Array, Stored("dofs")]
    # (2, nodes): degree of freedom of every node along x and y, from the lower guide up
    wire: Annotated[NDArray[np.int64], Stored(2, "nodes")]
    # (2,): degrees of freedom of the axes' carriages and rotors
    carriage: Annotated[NDArray[np.int64], Stored(2)]
    rotor: Annotated[NDArray[np.int64], Stored(2)]
    longest_us: float  # longest time step
    reach_m: float  # a node further from the line between the guides is lost
    node_kg: Annotated[Array, Stored("nodes")]  # (nodes,): mass of every node
    most_force_N: float  # a node pulled harder is lost
    rad_per_um: Annotated[Array, Stored(2)]  # (2,): rotor angle per um of travel
    step_um: float  # travel of a full step of a motor
    holding_Nm: Annotated[Array, Stored(2)]  # (2,): largest torque of a motor
    teeth: float  # periods of that torque in a turn
    friction_N: float  # Coulomb friction of an axis' ways
    presliding_m: float  # travel over which friction builds up
    # (2,): friction on each axis as a share of `friction_N`, -1 to 1: the only state besides the plant's arrays
    friction_share: Annotated[Array, Stored(2, life=CHANGING)]


@compiled
def sound(link: FullLink) -> bool:
    """Whether every number MuJoCo is about to step from is finite and has a meaning."""
    # MuJoCo itself would write a warning into a file for what is refused here
    for axis in range(2):
        for m in range(link.wire.shape[1]):
            dof = link.wire[axis, m]
            if not (
                abs(link.qpos[dof]) < link.reach_m
                and abs(link.qvel[dof]) * link.timestep[0] < link.reach_m
                and abs(link.force[dof]) < link.most_force_N
            ):
                return False
        for dof in (link.carriage[axis], link.rotor[axis]):
            if not (abs(link.qpos[dof]) < 1e6 and abs(link.qvel[dof]) < 1e6 and abs(link.force[dof]) < 1e6):
                return False
    return True


@compiled
def _drive(state: NDArray[np.void], axes: Axes, link: FullLink) -> None:
    """Apply the motors' torques and the friction of the ways."""
    for axis in range(2):
        rotor = link.rotor[axis]
        if axes.drives[axis].sample != 0:
            row, motor = axes.rows[axis], axes.motors[axis]
            damping = screw_damping(row, motor)  # not in MuJoCo: it does nothing within the backlash
            link.force[link.carriage[axis]] = damping + motor.load_N + row.hand_N
            torque = energise(row, motor, link.timestep[0])
            link.force[rotor] = torque + row.hand_Nm - damping * motor.um_per_rad * 1e-6
            continue
        link.force[link.carriage[axis]] = -link.friction_N * link.friction_share[axis]
        # a tooth away the torque is the same: the rotor may rest four full steps off, without anyone noticing
        lead = link.qpos[rotor] - state[0].commanded_um[axis] * link.rad_per_um[axis]
        link.force[rotor] = -link.holding_Nm[axis] * math.sin(link.teeth * lead)


@compiled
def _rub(link: FullLink, axis: int, travel_m: float) -> None:
    """Carry friction on over a travel: Dahl's law, exact for a travel in one direction."""
    # ``dz/dx = 1 - z sign(dx) / presliding`` for the bristles' bending z, here as a share of the largest
    left = math.exp(-abs(travel_m) / link.presliding_m)
    toward = 1.0 if travel_m > 0.0 else -1.0
    link.friction_share[axis] = toward + (link.friction_share[axis] - toward) * left


@compiled
def _brake_axis(axes: Axes, link: FullLink, axis: int, rotor_rad_s: float, carriage_m_s: float) -> None:
    """Let dry friction take its share of the speeds that a time step has given rotor and carriage."""
    motor, dt = axes.motors[axis], link.timestep[0]
    rotor, carriage = link.rotor[axis], link.carriage[axis]
    change = rubbed_rotor(axes.rows[axis], motor, rotor_rad_s, link.qvel[rotor], dt) - link.qvel[rotor]
    link.qvel[rotor] += change
    link.qpos[rotor] += change * dt
    change = rubbed_table(motor, carriage_m_s * 1e6, link.qvel[carriage] * 1e6, dt) * 1e-6 - link.qvel[carriage]
    link.qvel[carriage] += change
    link.qpos[carriage] += change * dt


@compiled
def step(state: NDArray[np.void], axes: Axes, link: FullLink) -> bool:
    """One time step of MuJoCo under the forces on the wire; false if they or what they move have no meaning."""
    _drive(state, axes, link)
    if not sound(link):
        return False
    x, y = link.qpos[link.carriage[0]], link.qpos[link.carriage[1]]
    x_speed, y_speed = link.qvel[link.carriage[0]], link.qvel[link.carriage[1]]
    x_rotor, y_rotor = link.qvel[link.rotor[0]], link.qvel[link.rotor[1]]
    call_with_two(link.mj_step, link.model, link.data)
    if axes.drives[0].sample != 0:
        _brake_axis(axes, link, 0, x_rotor, x_speed)
    else:
        _rub(link, 0, link.qpos[link.carriage[0]] - x)
    if axes.drives[1].sample != 0:
        _brake_axis(axes, link, 1, y_rotor, y_speed)
    else:
        _rub(link, 1, link.qpos[link.carriage[1]] - y)
    return True


@compiled
def see_axes(state: NDArray[np.void], axes: Axes, link: FullLink, until_ns: int) -> None:
    """Tell the axes whose drives have a loop where MuJoCo has moved them, and their encoders."""
    for axis in range(2):
        if axes.drives[axis].sample == 0:
            continue
        drive, row, motor = axes.drives[axis], axes.rows[axis], axes.motors[axis]
        before = position(row, motor)
        row.place_um = state[0].axis_um[axis] = link.qpos[link.carriage[axis]] * 1e6
        row.speed_um_s = link.qvel[link.carriage[axis]] * 1e6
        row.rotor_um = link.qpos[link.rotor[axis]] * motor.um_per_rad
        row.speed_rad_s = link.qvel[link.rotor[axis]]
        see_edges(drive, row, motor, before, float(row.moved_ns), float(until_ns))
        watch_cam(row, motor, float(until_ns))
        row.moved_ns = until_ns


@compiled
def lay_out_axes(axes: Axes, link: FullLink) -> None:
    """Give MuJoCo the places and speeds of the axes whose drives have a loop."""
    for axis in range(2):
        if axes.drives[axis].sample != 0:
            row, motor = axes.rows[axis], axes.motors[axis]
            link.qpos[link.carriage[axis]] = row.place_um * 1e-6
            link.qvel[link.carriage[axis]] = row.speed_um_s * 1e-6
            link.qpos[link.rotor[axis]] = row.rotor_um / motor.um_per_rad
            link.qvel[link.rotor[axis]] = row.speed_rad_s


@compiled
def coast_table(state: NDArray[np.void], axes: Axes, link: FullLink, until_ns: int) -> bool:
    """Step a table without a wire to a time, the drives' outputs held; False once its state is out of range."""
    start_ns = state[0].time_ns
    span_ns = until_ns - start_ns
    if span_ns <= 0:
        return True
    steps = math.ceil(span_ns * 1e-3 / link.longest_us)
    link.timestep[0] = span_ns * 1e-9 / steps
    for k in range(steps):
        if not step(state, axes, link):
            return False
        see_axes(state, axes, link, start_ns + span_ns * (k + 1) // steps)
    state[0].time_ns = until_ns
    return True
