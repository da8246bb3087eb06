"""One mode of the wire in the mean film: its motion over a pulse against its exact propagator."""

import numpy as np
import pytest
from scipy.linalg import expm

from edmsim.plant.constants import fill_propagators, modal_model
from edmsim.plant.gap.generator import timing
from edmsim.plant.kernel.declare import allocate, sizes_of
from edmsim.plant.kernel.state import Propagators
from edmsim.plant.mechanics.modal import kick, move
from edmsim.plant.resolution import resolution
from tests.plant.arrays import arrays

FAST = resolution("fast")


def exact_period(omega, zeta, drag, spans_s, pull, jump):
    """Exact map of a mode's place and speed over a pulse and what a period adds: pull before the kick, none after."""
    system = np.array([[0.0, 1.0, 0.0], [-(omega**2), -2 * zeta * omega - drag, pull], [0.0, 0.0, 0.0]])
    first = expm(system * spans_s[0])
    second = expm(system[:2, :2] * spans_s[1])
    return second @ first[:2, :2], second @ (first[:2, 2] + [0.0, jump])


@pytest.fixture(scope="module")
def first_mode(machine):
    """Frequency and damping of the first mode, and its map over a pulse as the loop moves it."""
    machine = machine.with_(t_period_us=100.0)
    model = modal_model(machine, FAST)
    sizes = sizes_of(FAST.slices, FAST.rays, FAST.modes)
    p = allocate(Propagators, sizes)
    fill_propagators(p, model, timing(machine))
    a = arrays(model, sizes, 293.0, {})
    a.mobility[:] = 1.0
    loads = np.zeros_like(a.wire_q)

    def period(braking, k_first, start, pull, impulse):
        a.wire_q[:], a.wire_v[:] = 0.0, 0.0
        (a.wire_q[0, 0], a.wire_v[0, 0]), loads[0, 0] = start, pull
        move(a, p, loads, 1.0, k_first, braking * k_first * 1e-3)
        kick(a, 2, impulse, 0.0)
        move(a, p, loads, 0.0, 1_000 - k_first, braking * (1_000 - k_first) * 1e-3)
        return np.array([a.wire_q[0, 0], a.wire_v[0, 0]])

    return model.wire_omega[0], model.wire_zeta[0], float(a.shape[2, 0]), period


@pytest.mark.slow
@pytest.mark.parametrize("braking", [0.05, 0.4, 0.8])
@pytest.mark.parametrize("k_first", [50, 350, 800])
@pytest.mark.parametrize(("pull", "impulse"), [(1e7, 0.0), (0.0, 1e-6)])
def test_a_mode_in_a_film_bends_and_decays_as_its_exact_propagator(first_mode, pull, impulse, k_first, braking):
    """In the mean over pulses that are all alike, and left alone; the film's resistance is `braking` per period."""
    omega, zeta, shape, period = first_mode
    spans = np.array([k_first, 1_000 - k_first]) * 1e-7
    exact, added = exact_period(omega, zeta, braking / 100e-6, spans, pull, shape * impulse * 1e6)
    moved = np.column_stack([period(braking, k_first, start, 0.0, 0.0) for start in np.eye(2)])
    adds = period(braking, k_first, (0.0, 0.0), pull, impulse)
    bent = np.linalg.solve(np.eye(2) - moved, adds)[0]
    assert bent == pytest.approx(np.linalg.solve(np.eye(2) - exact, added)[0], rel=1.2e-2)
    assert np.log(np.linalg.det(moved)) == pytest.approx(np.log(np.linalg.det(exact)), rel=0.1)


@pytest.mark.parametrize("braking", [5.0, 100.0, 1e6])
def test_no_film_is_too_stiff_for_a_mode(first_mode, braking):
    *_, period = first_mode
    moved = np.column_stack([period(braking, 350, start, 0.0, 0.0) for start in np.eye(2)])
    assert np.abs(np.linalg.eigvals(moved)).max() < 1.0
