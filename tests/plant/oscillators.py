"""Closed forms of free damped oscillators, for many modes and times."""

import numpy as np

from edmsim.plant.mechanics.modal import one_step


def propagator_table(omega, zeta, spans):
    """p11, p12, p21, p22, each (times, modes)."""
    rows = [[one_step(w, z, dt) for w, z in zip(omega, zeta, strict=True)] for dt in spans]
    return tuple(np.moveaxis(np.array(rows, float), -1, 0))
