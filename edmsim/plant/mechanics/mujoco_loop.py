"""Motion of wire and table by MuJoCo: a pulse is a few calls of ``mj_step`` from compiled code.

A plant's modal arrays hold coordinates of the full model here, so that whatever else moves the wire works on
them unchanged: ``wire_q`` and ``wire_v`` are deflections of the wire's nodes in um and um/s, ``shape`` runs
straight from node to node, and ``table_q[axis]`` is where carriage and rotor are less where the motor's steps
say, both in um of travel, ``table_v[axis]`` in um/s.
"""

import math

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import compiled
from edmsim.plant.axes.advance import LOST, advance_axes
from edmsim.plant.kernel.state import Array, Arrays, Axes, Constants, Propagators, Timing
from edmsim.plant.mechanics.film import film_now, suction_limited
from edmsim.plant.mechanics.mujoco_axes import FullLink, see_axes, sound, step


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
    """Let mean film and films resist the speed after a time step, which the step has moved the wire with."""
    # with the mass m a slice moves, a speed v becomes ``v / (1 + c dt / m)``: no film is too stiff
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
    state: NDArray[np.void], a: Arrays, c: Constants, axes: Axes, link: FullLink, p: Propagators, t: Timing,
    load: Array, films: Array, mean: float, resistance: float, open_scale: float, burn_scale: float,
    ignite_us: float, end_us: float, period_ns: int, s: int, kick_x: float, kick_y: float,
    events: NDArray[np.int64], next_event: int,
) -> int:
    """Step the full model over the period of a pulse that starts at the state's time, which is left as it is."""
    # as `modal.move` and `advance_axes` together, in equal time steps: the pull (um kg/s2 times the scales) acts with
    # its mean over each, the kick (N s) on slice `s` at `end_us`. Returns the first event after this period;
    # `TRIPPED` if an axis has to be stopped; `LOST` if a coordinate is out of range or not finite
    period_us = period_ns * 1e-3
    n_steps = math.ceil(period_us / link.longest_us)
    dt_us = period_us / n_steps
    link.timestep[0] = dt_us * 1e-6
    _lay_out(state, a, link)
    # the two time steps around the kick share it, so that its mean time is right; in the last one it comes early
    kicked = min(int(end_us / dt_us), n_steps - 1)
    second = end_us / dt_us - kicked if kicked < n_steps - 1 else 0.0
    fine = True
    for k in range(n_steps):
        until_ns = state[0].time_ns + period_ns * (k + 1) // n_steps
        next_event = advance_axes(state, a, axes, p, t, 0, link.step_um, events, next_event, until_ns, True)
        if next_event < 0:
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
        fine = step(state, axes, link)
        if not fine:
            break
        _brake(a, c, link, films, mean, resistance)
        if axes.loops != 0:
            see_axes(state, axes, link, until_ns)
    _take_back(state, a, axes, link)
    return next_event if fine and sound(link) else LOST
