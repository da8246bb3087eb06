"""Motion of wire and table: exact propagation of the modes over a pulse, steps of the table, contact."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import compiled
from edmsim.compiled.vectors import COORDINATES, highest, load, spread, store, total
from edmsim.plant.kernel.state import Array, Arrays, Propagators


@compiled
def copy(to: Array, of: Array) -> None:
    """Copy a modal state."""
    for axis in range(2):
        for m in range(0, of.shape[1], COORDINATES):
            store(to, (axis, m), load(of, (axis, m)))


@compiled
def place_wire(state: NDArray[np.void], a: Arrays, position: Array) -> None:
    """Wire position on the workpiece, per slice: the line between the guides, ringing of the table, deflection.

    The axes x and y move both guides, u and v the upper one further.
    """
    n_modes, filled = a.sway.shape
    for axis in range(2):
        start, lean = state[0].axis_um[axis] + ringing(a, axis), state[0].axis_um[2 + axis]
        for s in range(0, filled, COORDINATES):
            place = spread(start)
            for m in range(n_modes):
                place += load(a.sway, (m, s)) * a.wire_q[axis, m]
            store(position, (axis, s), place)
        if lean != 0.0:
            for s in range(0, filled, COORDINATES):
                store(position, (axis, s), load(position, (axis, s)) + load(a.height_share, (s,)) * lean)


@compiled
def place_slice(state: NDArray[np.void], a: Arrays, position: Array, s: int) -> None:
    """As `place_wire`, for one slice."""
    for axis in range(2):
        deflection = spread(0.0)
        for m in range(0, a.shape.shape[1], COORDINATES):
            deflection += load(a.shape, (s, m)) * load(a.wire_q, (axis, m))
        lean = a.height_share[s] * state[0].axis_um[2 + axis]
        position[axis, s] = state[0].axis_um[axis] + ringing(a, axis) + lean + total(deflection)


@compiled
def mean_deflection(a: Arrays, axis: int) -> float:
    """Mean over the height of the wire's deflection."""
    mean = spread(0.0)
    for m in range(0, a.mean_shape.shape[0], COORDINATES):
        mean += load(a.mean_shape, (m,)) * load(a.wire_q, (axis, m))
    return float(total(mean))


@compiled
def ringing(a: Arrays, axis: int) -> float:
    """Where x or y is, less its `axis_um`: the table rings after every motor step."""
    return np.float64(a.table_shape[axis, 0] * a.table_q[axis, 0] + a.table_shape[axis, 1] * a.table_q[axis, 1])


@compiled
def push_out(a: Arrays, s: int, cosine: float, sine: float, depth: float) -> None:
    """Take the wire out of the metal against a direction and stop its motion into it.

    The correction is the smallest one in modal coordinates: what an impulse at that slice would do. The impact is
    plastic for the slice; the rest of the wire swings on.
    """
    n_modes = a.shape.shape[1]
    norm = 0.0
    speed = 0.0
    for m in range(n_modes):
        norm += a.shape[s, m] ** 2
        speed += a.shape[s, m] * (a.wire_v[0, m] * cosine + a.wire_v[1, m] * sine)
    back = -depth / norm
    stop = -max(speed, 0.0) / norm
    for m in range(n_modes):
        a.wire_q[0, m] += a.shape[s, m] * back * cosine
        a.wire_q[1, m] += a.shape[s, m] * back * sine
        a.wire_v[0, m] += a.shape[s, m] * stop * cosine
        a.wire_v[1, m] += a.shape[s, m] * stop * sine


@compiled
def project(a: Arrays, sums: Array, onto: Array) -> None:
    """Loads on the modal coordinates (2, modes) of the pull on the slices (see `breakdown.slice_sums`)."""
    n_slices, n_modes = a.shape.shape
    for axis in range(2):
        for m in range(0, n_modes, COORDINATES):
            sum_ = spread(0.0)
            for s in range(n_slices):
                sum_ += load(a.shape, (s, m)) * sums[s, 2 + axis]
            store(onto, (axis, m), sum_)


@compiled
def move(
    a: Arrays,
    p: Propagators,
    forces: Array,
    sums: Array,
    open_scale: float,
    burn_scale: float,
    k_ignite: int,
    k_end: int,
    k_period: int,
    s: int,
    kick_x: float,
    kick_y: float,
    braking: float,
) -> None:
    """Propagate every mode over a period of ``k_period`` grid steps.

    The pull acts until ignition, weaker while burning; the kick (N s) falls at the discharge's end on slice
    `s`. A constant force f switched on at t acts at the end T as ``f (1 - p11(T - t)) / omega^2`` on the
    deflection and as ``f p12(T - t)`` on the velocity, so no time step enters, only the grid of the tables.

    `braking` is the mean resistance times the period, in kg. Half acts before, explicitly, half after, implicitly: a
    creeping mode has then both the way and the speed of its load, however stiff the film, and no mode grows. Kick and
    pull, which act in a part of the period, are braked from their moment on, that of the pull being the middle of the
    delay: in the mean they then bend the wire as a load of their mean force does.
    """
    since_ignite, since_end = k_period - k_ignite, k_period - k_end
    after_kick, after_pull = since_end / k_period, 1.0 - 0.5 * k_ignite / k_period
    project(a, sums, forces)
    for m in range(0, a.shape.shape[1], COORDINATES):
        c0, s0 = load(p.wire, (k_period, 0, m)), load(p.wire, (k_period, 1, m))
        c1, s1 = load(p.wire, (since_ignite, 0, m)), load(p.wire, (since_ignite, 1, m))
        c2, s2 = load(p.wire, (since_end, 0, m)), load(p.wire, (since_end, 1, m))
        # response of deflection and velocity to the pull, and to a kick of 1 N s (in um)
        settled = ((c1 - c0) * open_scale + (c2 - c1) * burn_scale) * load(p.wire_compliance, (m,))
        moving = (s0 - s1) * open_scale + (s1 - s2) * burn_scale
        stays = (spread(1.0) - c0) * load(p.wire_compliance, (m,))
        jump = load(a.shape, (s, m)) * 1e6
        kicked, thrown = s2 * jump, load(p.wire, (since_end, 3, m)) * jump
        back, damped = load(p.wire, (k_period, 2, m)), load(p.wire, (k_period, 3, m))
        brake = load(a.mobility, (m,)) * braking
        early = highest(spread(1.0) - brake * 0.5, spread(0.0))
        late, slow = spread(1.0) / (early + brake), spread(1.0) / (early + brake * 0.5)
        again = highest(early * (brake * 0.5 + 1.0), spread(0.5))  # what the next period's begin takes of the speed
        kick_way = spread(1.0) / (brake * (0.5 * after_kick) + 1.0)
        kick_speed = spread(1.0) / ((brake * after_kick + 1.0) * again)
        pull_way = spread(1.0) / (brake * (0.5 * after_pull) + 1.0)
        pull_speed = spread(1.0) / ((brake * after_pull + 1.0) * again)
        for axis in range(2):
            kick = kick_x if axis == 0 else kick_y
            q, v, force = load(a.wire_q, (axis, m)), load(a.wire_v, (axis, m)) * early, load(forces, (axis, m))
            steady = load(a.steady, (axis, m))
            way = c0 * q + s0 * v + steady * stays - q
            came = kicked * kick * kick_way + force * settled * pull_way
            store(a.wire_q, (axis, m), q + way * slow + came)
            speed = back * q + damped * v + steady * s0
            gained = thrown * kick * kick_speed + force * moving * pull_speed
            store(a.wire_v, (axis, m), speed * late + gained)
    q, v = load(a.table_q, (0, 0)), load(a.table_v, (0, 0))
    at = (k_period, 0, 0)
    store(a.table_q, (0, 0), load(p.table11, at) * q + load(p.table12, at) * v)
    store(a.table_v, (0, 0), load(p.table21, at) * q + load(p.table22, at) * v)


@compiled
def step_table(
    state: NDArray[np.void], a: Arrays, p: Propagators, axis: int, travel_um: float, k_since: int
) -> None:
    """One motor step, `k_since` grid steps before now: x or y rings around its new place."""
    state[0].commanded_um[axis] += travel_um
    state[0].axis_um[axis] += travel_um
    for m in range(2):
        jump = -a.table_participation[axis, m] * travel_um
        a.table_q[axis, m] += jump * p.table11[k_since, axis, m]
        a.table_v[axis, m] += jump * p.table21[k_since, axis, m]
