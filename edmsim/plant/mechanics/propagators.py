"""Exact propagators of free damped oscillators, and tables of their powers on a time grid, compiled."""

from __future__ import annotations

import math

from edmsim.compiled.jit import exactly_compiled
from edmsim.plant.kernel.state import Array


@exactly_compiled
def one_step(omega: float, zeta: float, dt: float) -> tuple[float, float, float, float]:
    """Propagators of ``q'' + 2 zeta omega q' + omega^2 q = 0`` over a time, q counted from its equilibrium.

    ``q(t+dt) = p11 q + p12 v`` and ``v(t+dt) = p21 q + p22 v``: the 2x2 matrix exponential.
    """
    s = omega * math.sqrt(abs(1.0 - zeta * zeta))
    if s == 0.0:
        cosine = math.exp(-omega * dt)
        sine = cosine * dt
    elif zeta < 1.0:
        decay = math.exp(-zeta * omega * dt)
        cosine, sine = decay * math.cos(s * dt), decay * math.sin(s * dt) / s
    else:  # summed from the two decaying exponentials: cosh alone would overflow
        slow = math.exp(-omega * omega / (zeta * omega + s) * dt)  # e^(-(z w - s) t) without the cancellation
        cosine = slow * (1.0 + math.exp(-2.0 * s * dt)) / 2.0
        sine = slow * -math.expm1(-2.0 * s * dt) / (2.0 * s)
    return cosine + zeta * omega * sine, sine, -omega * omega * sine, cosine - zeta * omega * sine


@exactly_compiled
def fill_wire(
    wire: Array, yielding: Array, compliance: Array, omega: Array, zeta: Array, shape: Array, dt: float
) -> None:
    """Fill the tables of the wire's modes (see `state.Propagators`); what is filled up to whole vectors stays 0."""
    n_slices, n_modes = shape.shape
    yielding[:] = 0.0
    for m in range(n_modes):
        soft = compliance[m] = 1.0 / (omega[m] * omega[m])
        wire[0, 0, m] = wire[0, 3, m] = 1.0
        wire[0, 1, m] = wire[0, 2, m] = 0.0
        a, b, c, d = one_step(omega[m], zeta[m], dt)
        p11, p12, p21, p22 = a, b, c, d
        # every row is the one before over one more step: ten times faster than exponentials, and exact to some 1e-13
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
    """Fill the tables of the two modes of either axis of the table, as those of the wire."""
    t11[0], t12[0], t21[0], t22[0] = 1.0, 0.0, 0.0, 1.0
    for axis in range(2):
        for m in range(2):
            a, b, c, d = one_step(omega[axis, m], zeta[axis, m], dt)
            p11, p12, p21, p22 = a, b, c, d
            for k in range(1, t11.shape[0]):
                t11[k, axis, m], t12[k, axis, m], t21[k, axis, m], t22[k, axis, m] = p11, p12, p21, p22
                p11, p12, p21, p22 = a * p11 + b * p21, a * p12 + b * p22, c * p11 + d * p21, c * p12 + d * p22


@exactly_compiled
def fill_fading(fading: Array, life_us: float, filled_us: float, grid_us: float) -> None:
    """Fill `coverage.GasLaw.fading` for the lives of steam and of permanent gas."""
    steam, gas = math.exp(-grid_us / life_us), math.exp(-grid_us / filled_us)
    fading[0, 0] = fading[0, 1] = 1.0
    for k in range(1, fading.shape[0]):
        fading[k, 0], fading[k, 1] = fading[k - 1, 0] * steam, fading[k - 1, 1] * gas
