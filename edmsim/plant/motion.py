"""Motion of wire and table: exact propagation of the modes over a pulse, steps of the table, contact."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .compiled import compiled
from .state import Array, Arrays, Propagators


@compiled
def place_wire(state: NDArray[np.void], a: Arrays, position: Array) -> None:
    """Wire position on the workpiece, per slice: commanded, ringing of the table, deflection."""
    n_slices, n_modes = a.shape.shape
    for axis in range(2):
        table = state[0].commanded_um[axis] + ringing(a, axis)
        for s in range(n_slices):
            deflection = 0.0
            for m in range(n_modes):
                deflection += a.shape[s, m] * a.wire_q[axis, m]
            position[s, axis] = table + deflection


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
    n_slices, n_modes = a.shape.shape
    since_ignite, since_end = k_period - k_ignite, k_period - k_end
    load[:] = 0.0
    for k in range(n_slices):
        for m in range(n_modes):
            load[0, m] += a.shape[k, m] * pull[k, 0]
            load[1, m] += a.shape[k, m] * pull[k, 1]
    for axis in range(2):
        kick = 1e6 * (kick_x if axis == 0 else kick_y)
        for m in range(n_modes):
            opened, burning = load[axis, m] * open_scale, load[axis, m] * burn_scale
            q, v = a.wire_q[axis, m], a.wire_v[axis, m]
            c0, c1, c2 = p.wire11[k_period, m], p.wire11[since_ignite, m], p.wire11[since_end, m]
            s0, s1, s2 = p.wire12[k_period, m], p.wire12[since_ignite, m], p.wire12[since_end, m]
            jump = a.shape[s, m] * kick
            settled = (opened * (c1 - c0) + burning * (c2 - c1)) * p.wire_compliance[m]
            a.wire_q[axis, m] = c0 * q + s0 * v + settled + s2 * jump
            a.wire_v[axis, m] = (
                p.wire21[k_period, m] * q + p.wire22[k_period, m] * v
                + opened * (s0 - s1) + burning * (s1 - s2) + p.wire22[since_end, m] * jump
            )
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
