"""Exact propagators of free damped oscillators, and a plant's tables of them on the time grid of its generator."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from edmsim.errors import InputError
from edmsim.plant.kernel.state import Array, Propagators
from edmsim.plant.mechanics.model import ModalModel
from edmsim.plant.mechanics.powers import fill_table, fill_wire, fill_yielding


def fill_propagators(p: Propagators, modes: ModalModel, grid_us: float) -> None:
    """Fill a plant's tables for a time grid: every row follows from the one before by one more step.

    Rounding errors add up over the rows, to some 1e-14. In return a knob of the generator that turns costs tens of
    us, where a table of exponentials would cost hundreds.

    Parameters
    ----------
    p : Propagators
        The tables to fill.
    modes : ModalModel
    grid_us : float
        Step of the grid.
    """
    n = len(modes.wire_omega)
    omega = np.concatenate([modes.wire_omega, modes.table_omega.ravel()])
    zeta = np.concatenate([modes.wire_zeta, modes.table_zeta.ravel()])
    step = np.concatenate(propagator_table(omega, zeta, [grid_us * 1e-6]))
    compliance = modes.wire_omega**-2.0
    p.wire_compliance[:n] = compliance
    fill_wire(p.wire, step[:, :n])
    fill_yielding(p.yielding, p.wire, compliance, modes.wire_shape)
    fill_table(p.table11, p.table12, p.table21, p.table22, step[:, n:].reshape(4, 2, 2))


def propagator_table(
    omega: ArrayLike, zeta: ArrayLike, dt_grid: ArrayLike
) -> tuple[Array, Array, Array, Array]:
    """Return the exact propagators of free damped oscillators over given times.

    ``q(t+dt) = p11 q + p12 v`` and ``v(t+dt) = p21 q + p22 v`` for ``q'' + 2 zeta omega q' + omega^2 q = 0``,
    q counted from its equilibrium: the 2x2 matrix exponential, for under-, critically and overdamped modes.

    Parameters
    ----------
    omega : array (n_modes,)
        Undamped angular frequencies in rad/s, above 0.
    zeta : array (n_modes,)
        Damping ratios, 0 or more.
    dt_grid : array (n_grid,)
        Time spans in s, 0 or more.

    Returns
    -------
    p11, p12, p21, p22 : float64 arrays (n_grid, n_modes)

    Raises
    ------
    InputError
        If a value is out of range or the modes' shapes differ.
    """
    w, z = np.asarray(omega, float), np.asarray(zeta, float)
    spans = np.asarray(dt_grid, float)
    if w.ndim != 1 or w.shape != z.shape or not (np.all(w > 0) and np.all(z >= 0)):
        raise InputError(
            f"modes have omega {w.tolist()} and zeta {z.tolist()}; "
            "there must be equally many, omega above 0 and zeta 0 or more"
        )
    if spans.ndim != 1 or not np.all(spans >= 0):
        raise InputError(f"time spans are {spans.tolist()} s; they must be a list of times of 0 or more")
    cosine, sine = _damped_pair(w, z, spans[:, None])
    return cosine + z * w * sine, sine, -(w**2) * sine, cosine - z * w * sine


def _damped_pair(w: Array, z: Array, t: Array) -> tuple[Array, Array]:
    """Return ``e^(-z w t) cos(s t)`` and ``e^(-z w t) sin(s t) / s`` with s = w sqrt(1 - z^2), real or not."""
    under = z <= 1
    if under.all():  # the usual case, met at every change of the generator's period
        return _underdamped(w, z, t)
    if not under.any():
        return _overdamped(w, z, t)
    pairs = zip(_underdamped(w, z, t), _overdamped(w, z, t), strict=True)
    cosine, sine = (np.where(under, below, above) for below, above in pairs)
    return cosine, sine


def _underdamped(w: Array, z: Array, t: Array) -> tuple[Array, Array]:
    st = w * np.sqrt(np.abs(1 - z**2)) * t
    decay = np.exp(-z * w * t)
    return decay * np.cos(st), decay * t * np.sinc(st / np.pi)


def _overdamped(w: Array, z: Array, t: Array) -> tuple[Array, Array]:
    """Summed from the two decaying exponentials: cosh alone would overflow."""
    s = w * np.sqrt(np.abs(1 - z**2))
    slow = np.exp(-(w**2) / (z * w + s) * t)  # e^(-(z w - s) t) without the cancellation
    safe = np.where(s > 0, s, 1.0)
    spread = np.where(s > 0, -np.expm1(-2 * s * t) / (2 * safe), t)
    return slow * (1 + np.exp(-2 * s * t)) / 2, slow * spread
