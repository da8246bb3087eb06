"""Powers of the modes' propagators over one grid step, compiled: the rows of a plant's tables."""

from __future__ import annotations

from edmsim.compiled.jit import exactly_compiled
from edmsim.plant.kernel.state import GRID, Array


@exactly_compiled
def fill_wire(wire: Array, step: Array) -> None:
    """Powers of every mode's propagator over one step."""
    n_modes = step.shape[1]
    for m in range(n_modes):
        wire[0, 0, m] = wire[0, 3, m] = 1.0
        wire[0, 1, m] = wire[0, 2, m] = 0.0
    for k in range(GRID):
        for m in range(n_modes):
            p11, p12, p21, p22 = wire[k, 0, m], wire[k, 1, m], wire[k, 2, m], wire[k, 3, m]
            wire[k + 1, 0, m] = step[0, m] * p11 + step[1, m] * p21
            wire[k + 1, 1, m] = step[0, m] * p12 + step[1, m] * p22
            wire[k + 1, 2, m] = step[2, m] * p11 + step[3, m] * p21
            wire[k + 1, 3, m] = step[2, m] * p12 + step[3, m] * p22


@exactly_compiled
def fill_yielding(yielding: Array, wire: Array, compliance: Array, shape: Array) -> None:
    """What a force on a slice does to that slice, summed over the modes."""
    n_slices, n_modes = shape.shape
    yielding[:] = 0.0
    for k in range(GRID + 1):
        for m in range(n_modes):
            stays, moves = (1.0 - wire[k, 0, m]) * compliance[m], wire[k, 1, m]
            for s in range(n_slices):
                own = shape[s, m] * shape[s, m]
                yielding[k, s, 0] += stays * own
                yielding[k, s, 1] += moves * own


@exactly_compiled
def fill_table(t11: Array, t12: Array, t21: Array, t22: Array, step: Array) -> None:
    """Powers for the two modes of either axis of the table."""
    t11[0], t12[0], t21[0], t22[0] = 1.0, 0.0, 0.0, 1.0
    for axis in range(2):
        for m in range(2):
            a, b, c, d = step[0, axis, m], step[1, axis, m], step[2, axis, m], step[3, axis, m]
            for k in range(GRID):
                p11, p12, p21, p22 = t11[k, axis, m], t12[k, axis, m], t21[k, axis, m], t22[k, axis, m]
                t11[k + 1, axis, m], t12[k + 1, axis, m] = a * p11 + b * p21, a * p12 + b * p22
                t21[k + 1, axis, m], t22[k + 1, axis, m] = c * p11 + d * p21, c * p12 + d * p22
