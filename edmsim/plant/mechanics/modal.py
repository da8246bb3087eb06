"""Motion of wire and table: exact propagators of the modes, their tables, motor steps, contact."""

import math

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import compiled, exactly_compiled
from edmsim.compiled.vectors import COORDINATES, load, spread, store, total
from edmsim.plant.kernel.state import Array, Arrays, Constants, Propagators


@compiled
def copy(to: Array, of: Array) -> None:
    """Copy a modal state."""
    for axis in range(2):
        for m in range(0, of.shape[1], COORDINATES):
            store(to, (axis, m), load(of, (axis, m)))


BENDS = 3
"""Iterations of the wire's angle and the places where it bends (ours): each reduces the error by a factor of 100."""


@compiled
def lean(a: Arrays, c: Constants, u_um: float, v_um: float) -> tuple[float, float]:
    """Place a wire between guides with a lead of the upper one; return its slope in x and y.

    It bends inside the guides: by its stiffness, and further inside by the radius of their edges and the angle.
    """
    lead = math.hypot(u_um, v_um)
    lower, upper = c.lower_bend_um, c.upper_bend_um
    for _ in range(BENDS):
        rise = lead / (c.guides_um - lower - upper)
        round_um = c.guide_radius_um * rise / (1.0 + math.sqrt(1.0 + rise * rise))  # tan of half the angle
        lower, upper = c.lower_bend_um + round_um, c.upper_bend_um + round_um
    between = c.guides_um - lower - upper
    for s in range(a.shape.shape[0]):
        a.lean_share[s] = (a.height_share[s] * c.guides_um - lower) / between
    return u_um / between, v_um / between


@compiled
def place_wire(state: NDArray[np.void], a: Arrays, position: Array) -> None:
    """Compute the wire's position in every slice: line between the guides, ringing of the table, deflection."""
    # the axes x and y move both guides, u and v the upper one in addition
    n_modes, filled = a.sway.shape
    for axis in range(2):
        start, lead = state[0].axis_um[axis] + ringing(a, axis), state[0].axis_um[2 + axis]
        for s in range(0, filled, COORDINATES):
            place, odd = spread(start), spread(0.0)  # two independent sums, which the processor computes in parallel
            for m in range(0, n_modes, 2):
                place += load(a.sway, (m, s)) * a.wire_q[axis, m]
                odd += load(a.sway, (m + 1, s)) * a.wire_q[axis, m + 1]
            store(position, (axis, s), place + odd)
        if lead != 0.0:
            for s in range(0, filled, COORDINATES):
                store(position, (axis, s), load(position, (axis, s)) + load(a.lean_share, (s,)) * lead)


@compiled
def place_slice(state: NDArray[np.void], a: Arrays, position: Array, s: int) -> None:
    """Do the same as `place_wire` for one slice."""
    for axis in range(2):
        deflection = spread(0.0)
        for m in range(0, a.shape.shape[1], COORDINATES):
            deflection += load(a.shape, (s, m)) * load(a.wire_q, (axis, m))
        led = a.lean_share[s] * state[0].axis_um[2 + axis]
        position[axis, s] = state[0].axis_um[axis] + ringing(a, axis) + led + total(deflection)


@compiled
def mean_deflection(a: Arrays, axis: int) -> float:
    """Return the mean of the wire's deflection over the height."""
    mean = spread(0.0)
    for m in range(0, a.mean_shape.shape[0], COORDINATES):
        mean += load(a.mean_shape, (m,)) * load(a.wire_q, (axis, m))
    return float(total(mean))


@compiled
def ringing(a: Arrays, axis: int) -> float:
    """Return the deviation of x or y from its `axis_um`: the table rings after every motor step."""
    return np.float64(a.table_shape[axis, 0] * a.table_q[axis, 0] + a.table_shape[axis, 1] * a.table_q[axis, 1])


@compiled
def push_out(a: Arrays, s: int, cosine: float, sine: float, depth: float) -> None:
    """Move the wire out of the metal against a direction, and stop its motion into the metal."""
    # the smallest correction in modal coordinates, like that of an impulse: inelastic for this slice only
    n_modes = a.shape.shape[1]
    norm = speed = 0.0
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
    """Compute the loads on the modal coordinates (2, modes) of the slices' pull (see `breakdown.slice_sums`)."""
    n_slices, n_modes = a.shape.shape
    for axis in range(2):
        for m in range(0, n_modes, COORDINATES):
            sum_ = spread(0.0)
            for s in range(n_slices):
                sum_ += load(a.shape, (s, m)) * sums[s, 2 + axis]
            store(onto, (axis, m), sum_)


@compiled
def move(a: Arrays, p: Propagators, loads: Array, scale: float, k: int, braking: float) -> None:
    """Propagate every mode over `k` grid steps under constant loads."""
    # A force f adds ``f (1 - p11) / omega^2`` to the deflection and ``f p12`` to the speed, exactly. `braking` is the
    # mean resistance times the span, in kg. With its ratio B to a mode's mass, a free mass would keep ``exp(-B)`` of
    # its speed; the Pade approximation used here is stable for any film.
    for m in range(0, a.shape.shape[1], COORDINATES):
        c, s = load(p.wire, (k, 0, m)), load(p.wire, (k, 1, m))
        back, damped = load(p.wire, (k, 2, m)), load(p.wire, (k, 3, m))
        stays = (spread(1.0) - c) * load(p.wire_compliance, (m,))
        brake = load(a.mobility, (m,)) * (braking / 3.0)  # B / 3
        per = spread(1.0) / (brake * (brake * 1.5 + 2.0) + 1.0)
        goes, yields, keeps = (brake * 0.5 + 1.0) * per, (brake + 1.0) * per, (damped - brake) * per
        for axis in range(2):
            q, v = load(a.wire_q, (axis, m)), load(a.wire_v, (axis, m))
            force = load(loads, (axis, m)) * scale + load(a.steady, (axis, m))
            store(a.wire_q, (axis, m), q + (force * stays + c * q - q) * yields + s * v * goes)
            store(a.wire_v, (axis, m), (force * s + back * q) * goes + v * keeps)


@compiled
def kick(a: Arrays, s: int, kick_x: float, kick_y: float) -> None:
    """Apply an impulse (N s) to a slice."""
    for m in range(0, a.shape.shape[1], COORDINATES):
        jump = load(a.shape, (s, m)) * 1e6
        store(a.wire_v, (0, m), load(a.wire_v, (0, m)) + jump * kick_x)
        store(a.wire_v, (1, m), load(a.wire_v, (1, m)) + jump * kick_y)


@compiled
def ring(a: Arrays, p: Propagators, k: int) -> None:
    """Propagate the table's ringing over `k` grid steps."""
    q, v = load(a.table_q, (0, 0)), load(a.table_v, (0, 0))
    at = (k, 0, 0)
    store(a.table_q, (0, 0), load(p.table11, at) * q + load(p.table12, at) * v)
    store(a.table_v, (0, 0), load(p.table21, at) * q + load(p.table22, at) * v)


@compiled
def step_table(state: NDArray[np.void], a: Arrays, p: Propagators, axis: int, travel_um: float, k_since: int) -> None:
    """Apply a motor step, `k_since` grid steps ago: x or y rings around its new position."""
    state[0].axis_um[axis] += travel_um
    for m in range(2):
        jump = -a.table_participation[axis, m] * travel_um
        a.table_q[axis, m] += jump * p.table11[k_since, axis, m]
        a.table_v[axis, m] += jump * p.table21[k_since, axis, m]


@exactly_compiled
def one_step(omega: float, zeta: float, dt: float) -> tuple[float, float, float, float]:
    """Return the propagators of ``q'' + 2 zeta omega q' + omega^2 q = 0`` over a time, q relative to equilibrium."""
    # ``q(t+dt) = p11 q + p12 v`` and ``v(t+dt) = p21 q + p22 v``: the 2x2 matrix exponential
    s = omega * math.sqrt(abs(1.0 - zeta * zeta))
    if s == 0.0:
        cosine = math.exp(-omega * dt)
        sine = cosine * dt
    elif zeta < 1.0:
        decay = math.exp(-zeta * omega * dt)
        cosine, sine = decay * math.cos(s * dt), decay * math.sin(s * dt) / s
    else:  # as a sum of two decaying exponentials, because cosh would overflow
        slow = math.exp(-omega * omega / (zeta * omega + s) * dt)  # e^(-(z w - s) t) without cancellation
        cosine = slow * (1.0 + math.exp(-2.0 * s * dt)) / 2.0
        sine = slow * -math.expm1(-2.0 * s * dt) / (2.0 * s)
    return cosine + zeta * omega * sine, sine, -omega * omega * sine, cosine - zeta * omega * sine


@exactly_compiled
def fill_wire(
    wire: Array, yielding: Array, compliance: Array, omega: Array, zeta: Array, shape: Array, dt: float
) -> None:
    """Fill the tables of the wire's modes (see `state.Propagators`); the padding stays 0."""
    n_slices, n_modes = shape.shape
    yielding[:] = 0.0
    for m in range(n_modes):
        soft = compliance[m] = 1.0 / (omega[m] * omega[m])
        wire[0, 0, m] = wire[0, 3, m] = 1.0
        wire[0, 1, m] = wire[0, 2, m] = 0.0
        a, b, c, d = one_step(omega[m], zeta[m], dt)
        p11, p12, p21, p22 = a, b, c, d
        # each row is the row before times one step: ten times faster than exponentials, with an error of some 1e-13
        for k in range(1, wire.shape[0]):
            wire[k, 0, m], wire[k, 1, m], wire[k, 2, m], wire[k, 3, m] = p11, p12, p21, p22
            rests = (1.0 - p11) * soft
            for s in range(n_slices):
                own = shape[s, m] * shape[s, m]
                yielding[k, s, 0] += rests * own
                yielding[k, s, 1] += p12 * own
            p11, p12, p21, p22 = a * p11 + b * p21, a * p12 + b * p22, c * p11 + d * p21, c * p12 + d * p22


@exactly_compiled
def fill_table(t11: Array, t12: Array, t21: Array, t22: Array, omega: Array, zeta: Array, dt: float) -> None:
    """Fill the tables of the two modes of each table axis, like those of the wire."""
    t11[0], t12[0], t21[0], t22[0] = 1.0, 0.0, 0.0, 1.0
    for axis in range(2):
        for m in range(2):
            a, b, c, d = one_step(omega[axis, m], zeta[axis, m], dt)
            p11, p12, p21, p22 = a, b, c, d
            for k in range(1, t11.shape[0]):
                t11[k, axis, m], t12[k, axis, m], t21[k, axis, m], t22[k, axis, m] = p11, p12, p21, p22
                p11, p12, p21, p22 = a * p11 + b * p21, a * p12 + b * p22, c * p11 + d * p21, c * p12 + d * p22
