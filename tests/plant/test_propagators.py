"""Exact propagators of the modes, and the tables of their powers that the pulse loop reads."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.linalg import expm

from edmsim.plant.mechanics.modal import fill_table, fill_wire
from edmsim.plant.mechanics.model import WireSetup, build_model, reduce_model
from tests.plant.oscillators import propagator_table


@pytest.fixture(scope="module")
def modal():
    heights = 0.010 + 0.020 * (np.arange(9) + 0.5) / 9
    return reduce_model(build_model(WireSetup(0.25e-3, 8500.0, 10.0, 0.040, 0.2)), 31, heights)


@pytest.mark.slow
@example(omega=1e3, zeta=0.2, phase=0.0)
@example(omega=1e3, zeta=40.0, phase=1e6)
@given(
    omega=st.floats(1.0, 3e5),
    zeta=st.one_of(st.floats(0.0, 30.0), st.just(1.0), st.floats(1 - 1e-9, 1 + 1e-9)),
    phase=st.floats(0.0, 20.0),
)
def test_propagator_is_the_matrix_exponential(omega, zeta, phase):
    dt = phase / omega
    p11, p12, p21, p22 = (p[0, 0] for p in propagator_table([omega], [zeta], [dt]))
    scaled = np.array([[p11, p12 * omega], [p21 / omega, p22]])  # in radians of the mode
    exact = expm(phase * np.array([[0.0, 1.0], [-1.0, -2 * zeta]]))
    np.testing.assert_allclose(scaled, exact, rtol=0, atol=1e-9)


def test_tables_of_powers_hold_the_closed_forms(modal):
    rows, n_modes, dt = 1001, len(modal.wire_omega), 0.4e-6
    wire, yielding, compliance = np.zeros((rows, 4, n_modes)), np.zeros((rows, 9, 2)), np.zeros(n_modes)
    fill_wire(wire, yielding, compliance, modal.wire_omega, modal.wire_zeta, modal.wire_shape, dt)
    table = np.zeros((4, rows, 2, 2))
    fill_table(*table, modal.table_omega, modal.table_zeta, dt)
    p11, p12, p21, p22 = propagator_table(modal.wire_omega, modal.wire_zeta, dt * np.arange(rows))
    for k, (closed, unit) in enumerate(zip((p11, p12, p21, p22), (0, -1, 1, 0), strict=True)):
        scale = modal.wire_omega ** float(unit)
        np.testing.assert_allclose(wire[:, k] / scale, closed / scale, rtol=0, atol=1e-11)
    own = modal.wire_shape.T**2
    np.testing.assert_allclose(yielding[..., 0], (1 - p11) * modal.wire_omega**-2.0 @ own, rtol=1e-9, atol=1e-20)
    np.testing.assert_allclose(yielding[..., 1], p12 @ own, rtol=1e-9, atol=1e-9 * np.abs(p12 @ own).max())
    closed = propagator_table(modal.table_omega[1], modal.table_zeta[1], dt * np.arange(rows))
    np.testing.assert_allclose(table[:, :, 1], closed, rtol=1e-9, atol=1e-14)
