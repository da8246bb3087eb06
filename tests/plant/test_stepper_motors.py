"""The full model's stepper motors, screws, ways and end stops under MuJoCo, against closed forms."""

import math

import numpy as np
import pytest

from edmsim.plant.mechanics.full_model import DriveSetup
from tests.plant.full_rig import PERIOD_NS, START_UM, Rig, frequency, stepping


@pytest.mark.slow
@pytest.mark.parametrize(("axis", "way"), [(0, 1), (0, -1), (1, 1), (1, -1)])
def test_a_motor_step_moves_its_axis_two_micrometres_and_rings(axis, way):
    ran = Rig().run(2000, steps=[(1_000_000, axis, way)])
    moved = (ran.place[:, axis] - START_UM) * way
    assert moved[-1] == pytest.approx(2.0, abs=1e-6)  # T-16, T-17
    assert 2.5 < moved.max() < 3.5  # overshoots by less than a step
    np.testing.assert_array_equal(ran.place[:, 1 - axis], START_UM)
    np.testing.assert_array_equal(ran.commanded[-1, axis], START_UM + 2.0 * way)


@pytest.mark.slow
def test_after_a_step_the_rotor_swings_at_its_frequency():
    rig = Rig()
    ran = rig.run(600, steps=[(1_000_000, 0, 1)])
    late = (ran.rotor[:, 0] - START_UM - 2.0)[100:]  # the first swings are large, and slower
    omega, zeta = rig.full.modes.table_omega[0, 0], rig.full.modes.table_zeta[0, 0]
    assert omega / (2 * math.pi) == pytest.approx(103, abs=1)  # the value in the file
    damped = omega * math.sqrt(1 - zeta**2) / (2 * math.pi)
    assert frequency(late, PERIOD_NS * 1e-9) == pytest.approx(damped, rel=0.02)


@pytest.mark.slow
def test_rubbing_ways_keep_the_table_within_half_a_step():
    ran = Rig(drive=DriveSetup(2e-6, 30.0, 5e-6, 0.0)).run(3000, steps=stepping(100, 20))
    assert abs(ran.place[-1, 0] - ran.commanded[-1, 0]) < 1.0  # T-18


def ramp(rate_hz, n):
    """Motor steps whose rate rises over `n` steps to `rate_hz`, and `n` more at that rate."""
    rising = rate_hz * np.sqrt((np.arange(n) + 1) / n)
    times = np.cumsum(1 / np.concatenate([rising, np.full(n, rate_hz)]))
    return [(round(t * 1e9), 0, 1) for t in times]


def pull_out_hz(rig):
    """Closed form: a rotor driven in full steps lags by 90 electrical degrees more after a step than before it; its
    mean torque is at most 2 sqrt(2) / pi of the holding torque, and equals the rotor's damping.
    """
    model = rig.full.model
    damping = float(model.dof_damping[rig.full.link.rotor[0]])
    per_second = 2 * math.sqrt(2) / math.pi * rig.full.link.holding_Nm[0] / damping
    return per_second / (2 * math.pi) * model.numeric("rotor_teeth").data[0] * 4


@pytest.mark.slow
def test_steps_faster_than_pull_out_are_lost_by_fours_and_the_counter_does_not_know():
    rig = Rig()
    limit = pull_out_hz(rig)
    assert limit == pytest.approx(620, rel=0.01)
    steps = ramp(0.95 * limit, 100)
    ran = rig.run(steps[-1][0] // PERIOD_NS + 2000, steps=steps)
    np.testing.assert_allclose(ran.place[-1, 0], START_UM + 2.0 * 200, atol=1e-3)

    rig = Rig()
    steps = ramp(1.1 * limit, 100)
    ran = rig.run(steps[-1][0] // PERIOD_NS + 2000, steps=steps)
    assert ran.commanded[-1, 0] == START_UM + 2.0 * 200  # T-19
    lost = (ran.commanded[-1, 0] - ran.place[-1, 0]) / 2.0
    assert lost > 25
    assert lost / 4 == pytest.approx(round(lost / 4), abs=1e-3)


def loaded(share):
    """A rig whose x carriage is pushed back by a share of its motor's holding force."""
    rig = Rig()
    thrust = rig.full.link.holding_Nm[0] * rig.full.link.rad_per_um[0] * 1e6  # N m times rad per m
    for part in np.linspace(0.1, 1.0, 10):  # a sudden load would swing it to twice the lag
        rig.full.data.body("x_carriage").xfrc_applied[0] = part * share * thrust  # axis -1: against the motor
        ran = rig.run(300)
    return rig, ran


@pytest.mark.slow
def test_a_resting_motor_holds_its_holding_torque_and_no_more():
    thrust_um = loaded(0.95)[1].place[-1, 0] - START_UM
    assert -100 < thrust_um < -50  # compliance of the screw, 78 um at 7.9 kN
    slipping = loaded(1.05)[0].run(3000)
    assert slipping.place[-1, 0] - START_UM < -500


@pytest.mark.slow
@pytest.mark.parametrize(("share", "holds"), [(0.6, True), (0.8, False)])
def test_a_motor_steps_against_seven_tenths_of_its_holding_torque(share, holds):
    # after a quarter turn of the field the torque is cos(lag), and the load sin(lag): equal at 0.71
    rig, before = loaded(share)
    after = rig.run(3000, steps=stepping(20, 4))
    gone = after.rotor[-1, 0] - before.rotor[-1, 0]
    if holds:
        assert gone == pytest.approx(8.0, abs=1e-3)
    else:
        assert gone < 0
        assert gone / 8 == pytest.approx(round(gone / 8), abs=1e-3)


@pytest.mark.slow
def test_the_end_stop_holds_the_table_and_the_counter_runs_on():
    rig = Rig(start_um=65_990.0)
    ran = rig.run(6000, steps=stepping(200, 100))
    assert ran.commanded[-1, 0] == 65_990.0 + 200.0  # T-19
    assert 66_000 < ran.place[-1, 0] < 66_020
    assert ran.rotor[-1, 0] < ran.commanded[-1, 0] - 8


def screw_N_um(rig):
    return float(rig.full.model.tendon_stiffness[rig.full.model.tendon("x_screw").id]) * 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("backlash_um", [0.0, 2.0, 6.0])
def test_a_reversal_loses_the_backlash(backlash_um):
    rig = Rig(drive=DriveSetup(2e-6, 30.0, 5e-6, backlash_um * 1e-6))
    forth, back = (rig.run(3000, steps=stepping(100, 20, way=way)).place[-1, 0] for way in (1, -1))
    rubbing = 2 * rig.full.link.friction_N / screw_N_um(rig)
    assert 40.0 - backlash_um - rubbing < forth - back < 40.0 - backlash_um


@pytest.mark.slow
@pytest.mark.parametrize("friction_N", [0.0, 100.0])
def test_rubbing_ways_hold_the_table_back_on_either_way(friction_N):
    rig = Rig(drive=DriveSetup(2e-6, friction_N, 1e-6, 0.0))
    for way in (1, -1):
        ran = rig.run(3000, steps=stepping(400, 80, way=way))
        running = (ran.rotor - ran.place)[1000:2000, 0].mean() * way
        damping_N = 800e-6 * float(rig.full.model.dof_damping[rig.full.link.carriage[0]])
        assert running == pytest.approx((friction_N + damping_N) / screw_N_um(rig), rel=0.02)
        held = friction_N * rig.full.link.friction_share[0]  # remaining after the last oscillation
        resting = ran.rotor[-1, 0] - ran.place[-1, 0]
        assert resting == pytest.approx(held / screw_N_um(rig), abs=1e-6 * max(1.0, friction_N))
    assert (friction_N > 0) == (abs(resting) > 0.01)
