"""Motion of wire and table by MuJoCo: a pulse is a few calls of ``mj_step`` from compiled code.

A plant's modal arrays hold coordinates of the full model here, so that whatever else moves the wire works on
them unchanged: ``wire_q`` and ``wire_v`` are deflections of the wire's nodes in um and um/s, ``shape`` runs
straight from node to node, and ``table_q[axis]`` is where carriage and rotor are less where the motor's steps
say, both in um of travel, ``table_v[axis]`` in um/s.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.calls import call_with_two
from edmsim.compiled.jit import compiled
from edmsim.plant.axes.advance import LOST, advance_axes
from edmsim.plant.axes.encoder import position, see_edges
from edmsim.plant.axes.marks import watch_cam
from edmsim.plant.axes.motor import energise
from edmsim.plant.axes.shaft import rubbed_rotor, rubbed_table, screw_damping
from edmsim.plant.kernel.declare import CHANGING, Kept
from edmsim.plant.kernel.state import Array, Arrays, Axes, Constants, Propagators, Timing
from edmsim.plant.mechanics.film import film_now, suction_limited


class FullLink(NamedTuple):
    """What compiled code needs of a MuJoCo model: addresses, views into MuJoCo's memory, and constants.

    Valid as long as the model and data it was made from;
    `edmsim.plant.mechanics.mujoco_model.FullMechanics` keeps them.

    Attributes
    ----------
    mj_step, model, data : int
        Addresses of the function and of its two arguments.
    timestep : (1,)
        The model's time step in s.
    qpos, qvel, force : (degrees of freedom,)
        Positions, velocities and applied forces, SI.
    wire : int64 (2, nodes)
        Degree of freedom of every node along x and y, from the lower guide up.
    carriage, rotor : int64 (2,)
        Degrees of freedom of the axes' carriages and rotors.
    longest_us : float
        Longest time step.
    reach_m : float
        A node further from the line between the guides is lost.
    node_kg : (nodes,)
        Mass of every node.
    most_force_N : float
        A node pulled harder is lost.
    rad_per_um : (2,)
        Rotor angle per um of travel.
    step_um : float
        Travel of a full step of a motor.
    holding_Nm : (2,)
        Largest torque of a motor.
    teeth : float
        Periods of that torque in a turn.
    friction_N : float
        Coulomb friction of an axis' ways.
    presliding_m : float
        Travel over which friction builds up.
    friction_share : (2,)
        Friction on each axis as a share of `friction_N`, -1 to 1: the only state besides the plant's arrays.
    """

    mj_step: int
    model: int
    data: int
    timestep: Annotated[Array, Kept(1)]
    qpos: Annotated[Array, Kept("dofs")]
    qvel: Annotated[Array, Kept("dofs")]
    force: Annotated[Array, Kept("dofs")]
    wire: Annotated[NDArray[np.int64], Kept(2, "nodes")]
    carriage: Annotated[NDArray[np.int64], Kept(2)]
    rotor: Annotated[NDArray[np.int64], Kept(2)]
    longest_us: float
    reach_m: float
    node_kg: Annotated[Array, Kept("nodes")]
    most_force_N: float
    rad_per_um: Annotated[Array, Kept(2)]
    step_um: float
    holding_Nm: Annotated[Array, Kept(2)]
    teeth: float
    friction_N: float
    presliding_m: float
    friction_share: Annotated[Array, Kept(2, life=CHANGING)]


@compiled
def _lay_out(state: NDArray[np.void], a: Arrays, link: FullLink) -> None:
    """Give MuJoCo the positions and velocities of the plant's arrays."""
    for axis in range(2):
        for m in range(link.wire.shape[1]):
            dof = link.wire[axis, m]
            link.qpos[dof] = a.wire_q[axis, m] * 1e-6
            link.qvel[dof] = a.wire_v[axis, m] * 1e-6
        carriage, rotor, turn = link.carriage[axis], link.rotor[axis], link.rad_per_um[axis]
        link.qpos[carriage] = (state[0].axis_um[axis] + a.table_q[axis, 0]) * 1e-6
        link.qvel[carriage] = a.table_v[axis, 0] * 1e-6
        link.qpos[rotor] = (state[0].axis_um[axis] + a.table_q[axis, 1]) * turn
        link.qvel[rotor] = a.table_v[axis, 1] * turn


@compiled
def _take_back(state: NDArray[np.void], a: Arrays, axes: Axes, link: FullLink) -> None:
    """Take positions and velocities from MuJoCo into the plant's arrays."""
    for axis in range(2):
        for m in range(link.wire.shape[1]):
            dof = link.wire[axis, m]
            a.wire_q[axis, m] = link.qpos[dof] * 1e6
            a.wire_v[axis, m] = link.qvel[dof] * 1e6
        carriage, rotor, turn = link.carriage[axis], link.rotor[axis], link.rad_per_um[axis]
        if axes.drives[axis].sample != 0:
            state[0].axis_um[axis] = link.qpos[carriage] * 1e6
        a.table_q[axis, 0] = link.qpos[carriage] * 1e6 - state[0].axis_um[axis]
        a.table_v[axis, 0] = link.qvel[carriage] * 1e6
        a.table_q[axis, 1] = link.qpos[rotor] / turn - state[0].axis_um[axis]
        a.table_v[axis, 1] = link.qvel[rotor] / turn


@compiled
def _sound(link: FullLink) -> bool:
    """Whether every number MuJoCo is about to step from is finite and has a meaning.

    MuJoCo itself would write a warning into a file for what is refused here.
    """
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
    """Apply the motors' torques and the friction of the ways.

    The torque of a direct-current motor follows its current. Its screw's damper stands here, as it does nothing
    within the backlash. A hybrid stepper holds its rotor by a torque that is sinusoidal over the angle and repeats
    with every tooth: an angle of a tooth and it rests, four full steps off, without anyone noticing.
    """
    for axis in range(2):
        rotor = link.rotor[axis]
        if axes.drives[axis].sample != 0:
            row, motor = axes.rows[axis], axes.motors[axis]
            damping = screw_damping(row, motor)
            link.force[link.carriage[axis]] = damping + motor.load_N + row.hand_N
            torque = energise(row, motor, link.timestep[0])
            link.force[rotor] = torque + row.hand_Nm - damping * motor.um_per_rad * 1e-6
            continue
        link.force[link.carriage[axis]] = -link.friction_N * link.friction_share[axis]
        lead = link.qpos[rotor] - state[0].commanded_um[axis] * link.rad_per_um[axis]
        link.force[rotor] = -link.holding_Nm[axis] * math.sin(link.teeth * lead)


@compiled
def _rub(link: FullLink, axis: int, travel_m: float) -> None:
    """Carry friction on over a travel: Dahl's law, exact for a travel in one direction.

    ``dz/dx = 1 - z sign(dx) / presliding`` for the bristles' bending z, here as a share of the largest.
    """
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
def _step(state: NDArray[np.void], axes: Axes, link: FullLink) -> bool:
    """One time step of MuJoCo under the forces on the wire; false if they or what they move have no meaning."""
    _drive(state, axes, link)
    if not _sound(link):
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
def _see_axes(state: NDArray[np.void], axes: Axes, link: FullLink, until_ns: int) -> None:
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
def _push(a: Arrays, link: FullLink, s: int, impulse_x: float, impulse_y: float) -> None:
    """Let an impulse (N s) on a slice act over the last time step: on the speeds, and on the places by them."""
    dt = link.timestep[0]
    for m in range(link.wire.shape[1]):
        share = a.shape[s, m] / link.node_kg[m]
        x, y = link.wire[0, m], link.wire[1, m]
        link.qvel[x] += share * impulse_x
        link.qvel[y] += share * impulse_y
        link.qpos[x] += share * impulse_x * dt
        link.qpos[y] += share * impulse_y * dt


@compiled
def _way(a: Arrays, link: FullLink, films: Array, s: int) -> float:
    """How far (um) a slice has come nearer since the pulse's begin, whose places `Arrays.wire_q` still has."""
    way = 0.0
    for m in range(link.wire.shape[1]):
        x, y = link.qpos[link.wire[0, m]] * 1e6, link.qpos[link.wire[1, m]] * 1e6
        way += a.shape[s, m] * ((x - a.wire_q[0, m]) * films[s, 0] + (y - a.wire_q[1, m]) * films[s, 1])
    return float(way)


@compiled
def _add_growth(a: Arrays, link: FullLink, films: Array, scale: float) -> None:
    """Add to the forces by what the pull on slices near the metal has grown since the pulse's begin."""
    for s in range(films.shape[0]):
        if films[s, 3] == 0.0:
            continue
        growth = film_now(films, s, 0.0, _way(a, link, films, s))[1] * scale * 1e-6
        for m in range(link.wire.shape[1]):
            link.force[link.wire[0, m]] += a.shape[s, m] * growth * films[s, 0]
            link.force[link.wire[1, m]] += a.shape[s, m] * growth * films[s, 1]


@compiled
def _brake(a: Arrays, c: Constants, link: FullLink, films: Array, mean: float, resistance: float) -> None:
    """Let mean film and films resist the speed after a time step, which the step has moved the wire with.

    With the mass m a slice moves, a speed v becomes ``v / (1 + c dt / m)``, slice by slice: no film is too stiff. A
    slice's film is that of its gap now.
    """
    dt = link.timestep[0]
    for m in range(link.wire.shape[1]):
        taken = 1.0 - 1.0 / (1.0 + a.mobility[m] * resistance * dt)
        for axis in range(2):
            dof = link.wire[axis, m]
            change = link.qvel[dof] * taken
            link.qvel[dof] -= change
            link.qpos[dof] -= change * dt
    for s in range(films.shape[0]):
        if films[s, 3] == 0.0:
            continue
        nx, ny, speed = films[s, 0], films[s, 1], 0.0
        for m in range(link.wire.shape[1]):
            x, y, shape = link.wire[0, m], link.wire[1, m], a.shape[s, m]
            speed += shape * (link.qvel[x] * nx + link.qvel[y] * ny)
        film = film_now(films, s, mean, _way(a, link, films, s))[0]
        drag = film / (1.0 + film * dt / a.slice_mass_kg[s])
        impulse = suction_limited(a, c, s, -drag * speed * 1e6) * 1e-6 * dt
        _push(a, link, s, impulse * nx, impulse * ny)


@compiled
def _overlap(begin: float, end: float, low: float, high: float) -> float:
    """Length of what two spans share."""
    return max(0.0, min(end, high) - max(begin, low))


@compiled
def move_full(
    state: NDArray[np.void],
    a: Arrays,
    c: Constants,
    axes: Axes,
    link: FullLink,
    p: Propagators,
    t: Timing,
    load: Array,
    films: Array,
    mean: float,
    resistance: float,
    open_scale: float,
    burn_scale: float,
    ignite_us: float,
    end_us: float,
    period_ns: int,
    s: int,
    kick_x: float,
    kick_y: float,
    events: NDArray[np.int64],
    next_event: int,
) -> int:
    """Step the full model over the period of a pulse that starts at the state's time, which is left as it is.

    As `edmsim.plant.mechanics.modal.move` and `advance_axes` together. The period is cut into equal time steps. The
    pull (um kg/s2 times the scales) acts with its mean over each. The kick (N s) at ``end_us`` on slice `s` is
    shared by the two time steps around it, so that its mean moment is right; in the last time step there is no
    other to share with, and it comes early by less than its length. A motor's step changes the commanded angle,
    and ``commanded_um`` with it, at the begin of the time step in which it falls.

    Parameters
    ----------
    load : (2, nodes)
        The pull on the nodes.
    films : (slices, 6)
        See `film.find_films`.
    mean, resistance : float
        See `film.mean_film` and `film.mean_resistance`.
    events : int64 (n, 3)
        Time in ns, channel and value, in order of time (see `edmsim.Plant.advance`).
    next_event : int
        First of them that has not happened.

    Returns
    -------
    int
        First event after this period, or `LOST` if a coordinate is not finite or beyond every reason;
        nothing is stepped any more then, and the arrays hold what was found.
    """
    period_us = period_ns * 1e-3
    n_steps = math.ceil(period_us / link.longest_us)
    dt_us = period_us / n_steps
    link.timestep[0] = dt_us * 1e-6
    _lay_out(state, a, link)
    kicked = min(int(end_us / dt_us), n_steps - 1)
    second = end_us / dt_us - kicked if kicked < n_steps - 1 else 0.0
    sound = True
    for k in range(n_steps):
        until_ns = state[0].time_ns + period_ns * (k + 1) // n_steps
        next_event = advance_axes(state, a, axes, p, t, 0, link.step_um, events, next_event, until_ns, True)
        if next_event == LOST:
            break
        begin, end = k * dt_us, (k + 1) * dt_us
        scale = (
            open_scale * _overlap(begin, end, 0.0, ignite_us) + burn_scale * _overlap(begin, end, ignite_us, end_us)
        ) / dt_us
        kick = 0.0
        if k == kicked:
            kick = (1.0 - second) / link.timestep[0]
        elif k == kicked + 1:
            kick = second / link.timestep[0]
        for m in range(link.wire.shape[1]):
            share = a.shape[s, m] * kick
            link.force[link.wire[0, m]] = (load[0, m] * scale + a.steady[0, m]) * 1e-6 + share * kick_x
            link.force[link.wire[1, m]] = (load[1, m] * scale + a.steady[1, m]) * 1e-6 + share * kick_y
        _add_growth(a, link, films, scale)
        sound = _step(state, axes, link)
        if not sound:
            break
        _brake(a, c, link, films, mean, resistance)
        if axes.loops != 0:
            _see_axes(state, axes, link, until_ns)
    _take_back(state, a, axes, link)
    return next_event if sound and _sound(link) else LOST
