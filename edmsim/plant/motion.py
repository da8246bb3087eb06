"""Motion of wire and table: exact propagation of the modes over a pulse, steps of the table, contact."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .compiled import compiled
from .state import Array, Arrays, Propagators


@compiled
def copy(to: Array, of: Array) -> None:
    """Copy a modal state."""
    for axis in range(2):
        for m in range(of.shape[1]):
            to[axis, m] = of[axis, m]


@compiled
def place_wire(state: NDArray[np.void], a: Arrays, position: Array) -> None:
    """Wire position on the workpiece, per slice: commanded, ringing of the table, deflection."""
    n_slices, n_modes = a.shape.shape
    x, y = state[0].commanded_um[0] + ringing(a, 0), state[0].commanded_um[1] + ringing(a, 1)
    for s in range(n_slices):
        deflection_x = deflection_y = 0.0
        for m in range(n_modes):
            deflection_x += a.shape[s, m] * a.wire_q[0, m]
            deflection_y += a.shape[s, m] * a.wire_q[1, m]
        position[0, s], position[1, s] = x + deflection_x, y + deflection_y


@compiled
def ringing(a: Arrays, axis: int) -> float:
    """Where an axis is, less where its motor steps say."""
    return np.float64(a.table_shape[axis, 0] * a.table_q[axis, 0] + a.table_shape[axis, 1] * a.table_q[axis, 1])


@compiled
def fall_back(a: Arrays, held: Array, s: int, cosine: float, sine: float, depth: float) -> None:
    """Take back the share of the wire's motion since `held` that carried a slice `depth` into the metal.

    The impact is plastic: the wire stays where it met the metal, at rest. Motion that did not lead into the
    metal is left alone.
    """
    n_modes = a.shape.shape[1]
    travel = 0.0
    for m in range(n_modes):
        travel += a.shape[s, m] * (
            (a.wire_q[0, m] - held[0, m]) * cosine + (a.wire_q[1, m] - held[1, m]) * sine
        )
    if travel <= 0.0:
        return
    share = min(1.0, depth / travel)
    for axis in range(2):
        for m in range(n_modes):
            a.wire_q[axis, m] -= share * (a.wire_q[axis, m] - held[axis, m])
            a.wire_v[axis, m] = 0.0


@compiled
def push_out(a: Arrays, s: int, cosine: float, sine: float, depth: float) -> None:
    """Take the wire out of the metal against a direction and stop its motion into it.

    The correction is the smallest one in modal coordinates: what an impulse at that slice would do.
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
def project(a: Arrays, pull: Array, load: Array) -> None:
    """Loads on the modal coordinates (2, modes) of forces on the slices (2, slices)."""
    n_slices, n_modes = a.shape.shape
    for m in range(n_modes):
        load[0, m] = load[1, m] = 0.0
    for k in range(n_slices):
        pull_x, pull_y = pull[0, k], pull[1, k]
        for m in range(n_modes):
            load[0, m] += a.shape[k, m] * pull_x
            load[1, m] += a.shape[k, m] * pull_y


@compiled
def move(
    a: Arrays,
    p: Propagators,
    load: Array,
    pull: Array,
    open_scale: float,
    burn_scale: float,
    k_ignite: int,
    k_end: int,
    k_period: int,
    s: int,
    kick_x: float,
    kick_y: float,
) -> None:
    """Propagate every mode over a period of ``k_period`` grid steps.

    The pull acts until ignition, weaker while burning; the kick (N s) falls at the discharge's end on slice
    `s`. A constant force f switched on at t acts at the end T as ``f (1 - p11(T - t)) / omega^2`` on the
    deflection and as ``f p12(T - t)`` on the velocity, so no time step enters, only the grid of the tables.
    """
    n_modes = a.shape.shape[1]
    since_ignite, since_end = k_period - k_ignite, k_period - k_end
    project(a, pull, load)
    for m in range(n_modes):
        c0, c1, c2 = p.wire[k_period, 0, m], p.wire[since_ignite, 0, m], p.wire[since_end, 0, m]
        s0, s1, s2 = p.wire[k_period, 1, m], p.wire[since_ignite, 1, m], p.wire[since_end, 1, m]
        # response of deflection and velocity to the pull, and to a kick of 1 N s (in um)
        settled = (open_scale * (c1 - c0) + burn_scale * (c2 - c1)) * p.wire_compliance[m]
        moving = open_scale * (s0 - s1) + burn_scale * (s1 - s2)
        jump = 1e6 * a.shape[s, m]
        kicked, thrown = s2 * jump, p.wire[since_end, 3, m] * jump
        back, damped = p.wire[k_period, 2, m], p.wire[k_period, 3, m]
        qx, vx, qy, vy = a.wire_q[0, m], a.wire_v[0, m], a.wire_q[1, m], a.wire_v[1, m]
        a.wire_q[0, m] = c0 * qx + s0 * vx + load[0, m] * settled + kicked * kick_x
        a.wire_q[1, m] = c0 * qy + s0 * vy + load[1, m] * settled + kicked * kick_y
        a.wire_v[0, m] = back * qx + damped * vx + load[0, m] * moving + thrown * kick_x
        a.wire_v[1, m] = back * qy + damped * vy + load[1, m] * moving + thrown * kick_y
    for axis in range(2):
        for m in range(2):
            q, v = a.table_q[axis, m], a.table_v[axis, m]
            a.table_q[axis, m] = p.table11[k_period, axis, m] * q + p.table12[k_period, axis, m] * v
            a.table_v[axis, m] = p.table21[k_period, axis, m] * q + p.table22[k_period, axis, m] * v


@compiled
def step_table(
    state: NDArray[np.void], a: Arrays, p: Propagators, axis: int, travel_um: float, k_since: int
) -> None:
    """One motor step, `k_since` grid steps before now: the axis rings around its new place."""
    state[0].commanded_um[axis] += travel_um
    for m in range(2):
        jump = -a.table_participation[axis, m] * travel_um
        a.table_q[axis, m] += jump * p.table11[k_since, axis, m]
        a.table_v[axis, m] += jump * p.table21[k_since, axis, m]
