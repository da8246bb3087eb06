"""The full model under MuJoCo: against closed forms, against the modal plant, and its stepper motors."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numba
import numpy as np
import pytest

from edmsim.errors import InputError
from edmsim.plant.constants import arrays
from edmsim.plant.kernel.declare import allocate, sizes_of
from edmsim.plant.kernel.state import ISO_PULSE, STATE, Axes, Constants, Propagators, Timing
from edmsim.plant.mechanics.modal import project
from edmsim.plant.mechanics.model import WireSetup, build_model, reduce_model
from edmsim.plant.mechanics.mujoco_loop import LOST, move_full
from edmsim.plant.mechanics.mujoco_model import N_NODES, FullMechanics
from edmsim.plant.mechanics.mujoco_table import DriveSetup
from tests.plant.oscillators import propagator_table

BRASS = WireSetup(0.25e-3, 8400.0, 10.0, 0.040, 0.2)
WIRES = [
    BRASS,
    WireSetup(0.10e-3, 8960.0, 4.0, 0.030, 0.2),  # copper
    WireSetup(0.18e-3, 10_220.0, 14.0, 0.100, 0.2),  # molybdenum, 80 mm workpiece
    WireSetup(0.02e-3, 19_300.0, 0.5, 0.025, 0.2),  # the thinnest of T-13, tungsten
]
SMOOTH = DriveSetup(step_m=2e-6, friction_N=0.0, presliding_m=5e-6, backlash_m=0.0)  # T-16
ALL_MODES = 31  # nodes of the machine's file
PERIOD_NS = 100_000  # 10 kHz
DRY = Constants(*(0.0 for _ in Constants._fields))
"""No water, so no film; its constants are all that the motion asks for."""
START_UM = 32_500.0


def slice_heights(wire, height_m=0.020, n=9):
    return (wire.guide_distance_m - height_m) / 2 + height_m * (np.arange(n) + 0.5) / n


@numba.njit
def _pulses(
    state, a, c, axes, link, p, t, load, films, scales, ignite_us, period_ns, kicks, kick_slice, end_us, steps,
    wire, table,
):
    """Move over many pulses; note every pulse's nodes, and place, rotor and command of the axes."""
    following = 0
    for i in range(kicks.shape[0]):
        following = move_full(
            state, a, c, axes, link, p, t, load, films, 0.0, 0.0, scales[0], scales[1], ignite_us, end_us[i],
            period_ns, kick_slice[i], kicks[i, 0], kicks[i, 1], steps, following,
        )
        if following == LOST:
            return i
        state[0].time_ns += period_ns
        for axis in range(2):
            for m in range(wire.shape[2]):
                wire[i, axis, m] = a.wire_q[axis, m]
            table[i, axis, 0] = state[0].commanded_um[axis] + a.table_q[axis, 0]
            table[i, axis, 1] = state[0].commanded_um[axis] + a.table_q[axis, 1]
            table[i, axis, 2] = state[0].commanded_um[axis]
    return kicks.shape[0]


class Rig:
    """Wire and table alone, at rest."""

    def __init__(self, wire=BRASS, drive=SMOOTH, heights=None, start_um=START_UM):
        self.full = FullMechanics(wire, drive, slice_heights(wire) if heights is None else heights)
        n_slices, n_nodes = self.full.wire_shape.shape
        sizes = sizes_of(n_slices, 32, n_nodes)
        self.arrays = arrays(self.full, sizes, 300.0, {"height_share": np.full(n_slices, 0.5)})
        self.axes = allocate(Axes, sizes, loops=0, errs=0)
        self.propagators = allocate(Propagators, sizes)  # the full model does not use them
        self.timing = Timing(
            mode=ISO_PULSE, open_V=80.0, burning_V=20.0, removal_um3_J=1.0, current_A=1.0, short_A=1.0,
            current_form=1.0, on_us=1.0, wait_us=1.0, pause_us=1.0, period_ns=PERIOD_NS, grid_us=0.1,
        )  # fmt: skip
        self.state = np.zeros(1, STATE)
        self.state["commanded_um"][0, :2] = self.state["axis_um"][0, :2] = start_um

    def run(
        self, n, *, kicks=None, at=None, end_us=None, pull=None, scales=(1.0, 1.0), ignite_us=1e9, steps=(),
        period_ns=PERIOD_NS,
    ):
        """Move on over `n` pulses; `steps` count their time from now."""
        a = self.arrays
        sums, load = np.zeros((len(a.shape), 4)), np.zeros_like(a.wire_q)
        if pull is not None:
            sums[:, 2:] = pull
        project(a, sums, load)
        due = [(time + int(self.state["time_ns"][0]), axis, way) for time, axis, way in steps]
        wire, table = np.zeros((n, 2, N_NODES)), np.zeros((n, 2, 3))
        done = _pulses(
            self.state, a, DRY, self.axes, self.full.link, self.propagators, self.timing, load,
            np.zeros((len(a.shape), 6)), scales, ignite_us, period_ns,
            np.zeros((n, 2)) if kicks is None else kicks,
            np.zeros(n, np.int64) if at is None else at,
            np.full(n, period_ns * 1e-3) if end_us is None else end_us,
            np.array(due, np.int64).reshape(-1, 3), wire, table,
        )
        place, rotor, commanded = np.moveaxis(table, 2, 0)
        return SimpleNamespace(done=done, nodes=wire, place=place, rotor=rotor, commanded=commanded)


def stepping(rate_hz, n, axis=0, way=1):
    """`n` motor steps at a rate per second."""
    return [(round((i + 1) / rate_hz * 1e9), axis, way) for i in range(n)]


def frequency(signal, dt):
    """Frequency from the first to the last rise through zero."""
    k = np.flatnonzero((signal[:-1] < 0) & (signal[1:] >= 0))
    crossing = k - signal[k] / (signal[k + 1] - signal[k])
    return (len(k) - 1) / ((crossing[-1] - crossing[0]) * dt)


@pytest.mark.parametrize("wire", WIRES)
@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_the_wire_rings_at_the_string_s_frequencies(wire, n):
    free = WireSetup(**{**vars(wire), "damping_ratio": 1e-4})
    rig = Rig(free)
    z = rig.full.modes.node_heights_m
    rig.arrays.wire_q[0, : len(z)] = np.sin(n * np.pi * z / wire.guide_distance_m)  # 1 um
    period_ns = int(2e3 * rig.full.link.longest_us)
    ring = rig.run(800, period_ns=period_ns).nodes[:, 0] @ np.sin(n * np.pi * z / wire.guide_distance_m)
    found = frequency(ring, period_ns * 1e-9)
    modal = reduce_model(build_model(wire), ALL_MODES, [0.01]).wire_omega[n - 1] / (2 * np.pi)
    assert found == pytest.approx(modal, rel=0.01)
    assert found == pytest.approx(n / (2 * wire.guide_distance_m) * wire.wave_speed, rel=0.01)  # physics 2.3


@pytest.mark.parametrize("height_m", [0.005, 0.020, 0.030])
def test_static_lag_is_the_string_s_and_the_modes(height_m):
    length, tension = BRASS.guide_distance_m, BRASS.tension
    damped = WireSetup(**{**vars(BRASS), "damping_ratio": 1.0})
    heights = slice_heights(BRASS, height_m)
    rig = Rig(damped, heights=heights)
    force = np.full((9, 2), height_m / 9) * [1.0, -0.5]  # 1 N/m and -0.5 N/m
    nodes = rig.run(200, pull=force * 1e6).nodes[-1]
    lag = nodes @ rig.full.wire_shape.T
    modes = reduce_model(build_model(BRASS), ALL_MODES, heights)
    modal = modes.wire_shape @ (modes.wire_shape.T @ force / modes.wire_omega[:, None] ** 2) * 1e6
    np.testing.assert_allclose(lag, modal.T, rtol=0.01)
    closed_form = height_m * (2 * length - height_m) / (8 * tension) * 1e6  # physics 2.1
    np.testing.assert_allclose(lag[:, 4], [closed_form, -0.5 * closed_form], rtol=0.01)


def sparks(n):
    """A recorded train: kick (N s) on both axes, slice, moment in the pulse (us)."""
    draw = np.random.default_rng(11)
    size, angle = 3e-7 * draw.uniform(0.5, 1.5, n), draw.normal(0.0, 0.5, n)  # physics 10
    kicks = -size[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return kicks, draw.integers(0, 9, n), draw.uniform(0.0, 75.0, n)


def modal_answer(modes, kicks, at, end_us):
    """What modes make of the train: deflection (pulses, axes, slices) in um at every pulse's end."""
    whole = [p[0] for p in propagator_table(modes.wire_omega, modes.wire_zeta, [PERIOD_NS * 1e-9])]
    rests = propagator_table(modes.wire_omega, modes.wire_zeta, (PERIOD_NS * 1e-3 - end_us) * 1e-6)
    q, v = np.zeros((2, 2, len(modes.wire_omega)))
    out = []
    for i, (kick, s) in enumerate(zip(kicks, at, strict=True)):
        jump = kick[:, None] * modes.wire_shape[s] * 1e6
        q, v = whole[0] * q + whole[1] * v, whole[2] * q + whole[3] * v
        q, v = q + rests[1][i] * jump, v + rests[3][i] * jump
        out.append(q @ modes.wire_shape.T)
    return np.array(out)


def string(wire, n_modes):
    """Modes of the continuous string: sines, drag per metre the same for all."""
    n = np.arange(1, n_modes + 1)
    omega = n * np.pi / wire.guide_distance_m * wire.wave_speed
    amplitude = math.sqrt(2 / (wire.line_density * wire.guide_distance_m))
    shape = amplitude * np.sin(n * np.pi * slice_heights(wire)[:, None] / wire.guide_distance_m)
    return SimpleNamespace(wire_omega=omega, wire_zeta=wire.damping_ratio / n, wire_shape=shape)


def differ(one, other):
    """Root mean square of a difference as a share of the other's."""
    return math.sqrt(np.mean((one - other) ** 2) / np.mean(other**2))


@pytest.fixture(scope="module")
def train():
    return sparks(400)


@pytest.fixture(scope="module")
def full_answer(train):
    def at_step(longest_us=None):
        rig = Rig()
        if longest_us is not None:
            rig.full.link = rig.full.link._replace(longest_us=longest_us)
        kicks, at, end_us = train
        return rig.run(len(at), kicks=kicks, at=at, end_us=end_us).nodes @ rig.full.wire_shape.T

    return at_step


def test_in_short_steps_impulses_move_every_slice_as_the_modes_do(train, full_answer):
    modal = modal_answer(Rig().full.modes, *train)
    assert differ(full_answer(1.0), modal) < 0.05  # 1.4 %
    assert differ(full_answer(0.25), modal) < 0.01  # 0.3 %: what is left is the time step's


def test_at_the_plant_s_step_the_mean_deflection_moves_as_the_modes_do(train, full_answer):
    full = full_answer().mean(axis=2)
    for n_modes in (ALL_MODES, 8):  # 4.3 %, 4.1 %
        modes = reduce_model(build_model(BRASS), n_modes, slice_heights(BRASS))
        assert differ(full, modal_answer(modes, *train).mean(axis=2)) < 0.05


def test_at_the_plant_s_step_waves_run_more_like_the_string_s_than_the_modes(train, full_answer):
    # slice by slice, kicks without duration send fronts shorter than nodes or modes can carry
    exact = modal_answer(string(BRASS, 400), *train)
    modes = reduce_model(build_model(BRASS), ALL_MODES, slice_heights(BRASS))
    assert differ(full_answer(), exact) < differ(modal_answer(modes, *train), exact) < 0.25  # 18 %, 23 %


@pytest.mark.parametrize(
    ("ignite_us", "end_us"), [(30.0, 60.0), (12.5, 12.5), (100.0, 100.0), (0.0, 0.0), (3.0, 95.0)]
)
def test_the_pull_acts_until_ignition_and_weaker_until_the_end(ignite_us, end_us):
    rig = Rig()
    rig.full.link = rig.full.link._replace(longest_us=0.25)
    pull = np.random.default_rng(5).uniform(0.5, 1.5, (9, 2)) * [1.0, -1.0]
    found = rig.run(
        1, pull=pull, scales=(2e3, 5e2), ignite_us=ignite_us, end_us=np.array([end_us])
    ).nodes[0] @ rig.full.wire_shape.T
    modes = rig.full.modes
    left = (np.array([100.0, 100.0 - ignite_us, 100.0 - end_us])) * 1e-6
    p11 = propagator_table(modes.wire_omega, modes.wire_zeta, left)[0]
    push = 2e3 * (p11[1] - p11[0]) + 5e2 * (p11[2] - p11[1])  # a force from t on acts as (1 - p11) / omega^2
    exact = (pull.T @ modes.wire_shape * push / modes.wire_omega**2) @ modes.wire_shape.T
    np.testing.assert_allclose(found, exact, atol=0.01 * max(np.abs(exact).max(), 1e-9))


@pytest.mark.parametrize("damping_ratio", [0.0, 0.2, 5.0])
@pytest.mark.parametrize("wire", WIRES)
def test_the_time_step_is_stable_for_every_wire(wire, damping_ratio, train):
    rig = Rig(WireSetup(**{**vars(wire), "damping_ratio": damping_ratio}))
    kicks, at, end_us = train
    weak = kicks * (wire.line_density / BRASS.line_density)
    ran = rig.run(400, kicks=weak, at=at, end_us=end_us)
    assert ran.done == 400
    assert 0 < np.abs(ran.nodes).max() < 200


@pytest.mark.parametrize(("axis", "way"), [(0, 1), (0, -1), (1, 1), (1, -1)])
def test_a_motor_step_moves_its_axis_two_micrometres_and_rings(axis, way):
    ran = Rig().run(2000, steps=[(1_000_000, axis, way)])
    moved = (ran.place[:, axis] - START_UM) * way
    assert moved[-1] == pytest.approx(2.0, abs=1e-6)  # T-16, T-17
    assert 2.5 < moved.max() < 3.5  # rings over, and stays the motor's own step
    np.testing.assert_array_equal(ran.place[:, 1 - axis], START_UM)
    np.testing.assert_array_equal(ran.commanded[-1, axis], START_UM + 2.0 * way)


def test_after_a_step_the_rotor_swings_at_its_frequency():
    rig = Rig()
    ran = rig.run(600, steps=[(1_000_000, 0, 1)])
    late = (ran.rotor[:, 0] - START_UM - 2.0)[100:]  # the first swings are large, and slower
    omega, zeta = rig.full.modes.table_omega[0, 0], rig.full.modes.table_zeta[0, 0]
    assert omega / (2 * math.pi) == pytest.approx(103, abs=1)  # what the file says
    damped = omega * math.sqrt(1 - zeta**2) / (2 * math.pi)
    assert frequency(late, PERIOD_NS * 1e-9) == pytest.approx(damped, rel=0.02)


def test_rubbing_ways_keep_the_table_within_half_a_step():
    ran = Rig(drive=DriveSetup(2e-6, 30.0, 5e-6, 0.0)).run(3000, steps=stepping(100, 20))
    assert abs(ran.place[-1, 0] - ran.commanded[-1, 0]) < 1.0  # T-18


def ramp(rate_hz, n):
    """Motor steps whose rate rises over `n` of them to a final one, and `n` more at that rate."""
    rising = rate_hz * np.sqrt((np.arange(n) + 1) / n)
    times = np.cumsum(1 / np.concatenate([rising, np.full(n, rate_hz)]))
    return [(round(t * 1e9), 0, 1) for t in times]


def pull_out_hz(rig):
    """Closed form: a rotor driven in full steps lags by 90 electrical degrees more after one than before it; the
    mean of its torque is at most 2 sqrt(2) / pi of the holding torque, and balances the rotor's damping.
    """
    model = rig.full.model
    damping = float(model.dof_damping[rig.full.link.rotor[0]])
    per_second = 2 * math.sqrt(2) / math.pi * rig.full.link.holding_Nm[0] / damping
    return per_second / (2 * math.pi) * model.numeric("rotor_teeth").data[0] * 4


def test_steps_faster_than_pull_out_are_lost_by_fours_and_the_counter_does_not_know():
    rig = Rig()
    limit = pull_out_hz(rig)
    assert limit == pytest.approx(620, rel=0.01)
    steps = ramp(0.95 * limit, 200)
    ran = rig.run(steps[-1][0] // PERIOD_NS + 2000, steps=steps)
    np.testing.assert_allclose(ran.place[-1, 0], START_UM + 2.0 * 400, atol=1e-3)

    rig = Rig()
    steps = ramp(1.1 * limit, 200)
    ran = rig.run(steps[-1][0] // PERIOD_NS + 2000, steps=steps)
    assert ran.commanded[-1, 0] == START_UM + 2.0 * 400  # T-19
    lost = (ran.commanded[-1, 0] - ran.place[-1, 0]) / 2.0
    assert lost > 50
    assert lost / 4 == pytest.approx(round(lost / 4), abs=1e-3)


def loaded(share):
    """A rig whose x carriage is pushed back by a share of what its motor can hold."""
    rig = Rig()
    thrust = rig.full.link.holding_Nm[0] * rig.full.link.rad_per_um[0] * 1e6  # N m times rad per m
    for part in np.linspace(0.1, 1.0, 10):  # suddenly, it would swing to twice the lag
        rig.full.data.body("x_carriage").xfrc_applied[0] = part * share * thrust  # axis -1: against the motor
        ran = rig.run(300)
    return rig, ran


def test_a_resting_motor_holds_its_holding_torque_and_no_more():
    thrust_um = loaded(0.95)[1].place[-1, 0] - START_UM
    assert -100 < thrust_um < -50  # the screw gives way, 78 um at 7.9 kN
    slipping = loaded(1.05)[0].run(3000)
    assert slipping.place[-1, 0] - START_UM < -500


@pytest.mark.parametrize(("share", "holds"), [(0.6, True), (0.8, False)])
def test_a_motor_steps_against_seven_tenths_of_its_holding_torque(share, holds):
    # a quarter turn of the field leaves cos(lag) of a torque of which sin(lag) is load: equal at 0.71
    rig, before = loaded(share)
    after = rig.run(3000, steps=stepping(20, 4))
    gone = after.rotor[-1, 0] - before.rotor[-1, 0]
    if holds:
        assert gone == pytest.approx(8.0, abs=1e-3)
    else:
        assert gone < 0
        assert gone / 8 == pytest.approx(round(gone / 8), abs=1e-3)


def test_the_end_stop_holds_the_table_and_the_counter_runs_on():
    rig = Rig(start_um=65_990.0)
    ran = rig.run(6000, steps=stepping(200, 100))
    assert ran.commanded[-1, 0] == 65_990.0 + 200.0  # T-19
    assert 66_000 < ran.place[-1, 0] < 66_020
    assert ran.rotor[-1, 0] < ran.commanded[-1, 0] - 8


def screw_N_um(rig):
    return float(rig.full.model.tendon_stiffness[rig.full.model.tendon("x_screw").id]) * 1e-6


@pytest.mark.parametrize("backlash_um", [0.0, 2.0, 6.0])
def test_a_reversal_loses_the_backlash(backlash_um):
    rig = Rig(drive=DriveSetup(2e-6, 30.0, 5e-6, backlash_um * 1e-6))
    forth, back = (rig.run(3000, steps=stepping(100, 20, way=way)).place[-1, 0] for way in (1, -1))
    rubbing = 2 * rig.full.link.friction_N / screw_N_um(rig)
    assert 40.0 - backlash_um - rubbing < forth - back < 40.0 - backlash_um


@pytest.mark.parametrize("friction_N", [0.0, 100.0])
def test_rubbing_ways_hold_the_table_back_on_either_way(friction_N):
    rig = Rig(drive=DriveSetup(2e-6, friction_N, 1e-6, 0.0))
    for way in (1, -1):
        ran = rig.run(3000, steps=stepping(400, 80, way=way))
        running = (ran.rotor - ran.place)[1000:2000, 0].mean() * way
        damping_N = 800e-6 * float(rig.full.model.dof_damping[rig.full.link.carriage[0]])
        assert running == pytest.approx((friction_N + damping_N) / screw_N_um(rig), rel=0.02)
        held = friction_N * rig.full.link.friction_share[0]  # what the last swing has left of it
        resting = ran.rotor[-1, 0] - ran.place[-1, 0]
        assert resting == pytest.approx(held / screw_N_um(rig), abs=1e-6 * max(1.0, friction_N))
    assert (friction_N > 0) == (abs(resting) > 0.01)


def battle(rig, n, train):
    kicks, at, end_us = (part[:n] for part in train)
    pull = np.full((9, 2), 1e4)  # 10 mN on every slice
    return rig.run(n, kicks=kicks, at=at, end_us=end_us, pull=pull, steps=stepping(300, n // 40, axis=1))


def test_the_same_train_gives_the_same_bits(train):
    one, two = (battle(Rig(drive=DriveSetup(2e-6, 30.0, 5e-6, 2e-6)), 400, train) for _ in range(2))
    for name in ("nodes", "place", "rotor", "commanded"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


def test_arrays_and_snapshot_continue_bit_for_bit(train):
    rig, other = (Rig(drive=DriveSetup(2e-6, 30.0, 5e-6, 2e-6)) for _ in range(2))
    battle(rig, 200, train)
    battle(other, 37, train)  # what MuJoCo keeps of another past must not count
    for name in ("wire_q", "wire_v", "table_q", "table_v"):
        getattr(other.arrays, name)[:] = getattr(rig.arrays, name)
    other.state[:] = rig.state
    other.full.restore(rig.full.snapshot())
    assert rig.full.snapshot()["friction_share"].any()
    on, again = battle(rig, 200, train), battle(other, 200, train)
    for name in ("nodes", "place", "rotor", "commanded"):
        np.testing.assert_array_equal(getattr(on, name), getattr(again, name))
    rig.full.reset()
    assert not rig.full.snapshot()["friction_share"].any()


@pytest.mark.parametrize("kick", [math.nan, math.inf, 1.0, -1e300])
def test_a_wild_wire_is_told_and_nothing_is_written(kick, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    kicks = np.zeros((20, 2))
    kicks[7, 1] = kick
    rig = Rig()
    assert rig.run(20, kicks=kicks, end_us=np.full(20, 30.0)).done == 7
    assert rig.full.data.warning.number.sum() == 0
    assert not list(Path(tmp_path).iterdir())


def test_the_period_is_cut_into_equal_steps_no_longer_than_stable():
    rig = Rig()
    for period_ns, steps in ((100_000, 11), (9_000, 1), (33_333, 4)):
        before = rig.full.data.time
        assert rig.run(1, period_ns=period_ns).done == 1
        assert rig.full.model.opt.timestep == pytest.approx(period_ns * 1e-9 / steps)
        assert rig.full.data.time - before == pytest.approx(period_ns * 1e-9)


def test_the_full_model_has_the_machine_s_motors_and_screws():
    rig, whole = Rig(drive=DriveSetup(2e-6, 30.0, 5e-6, 6e-6)), build_model(BRASS)
    link = rig.full.link
    slope = link.holding_Nm * link.teeth  # of the sine at rest
    np.testing.assert_allclose(slope, [whole.actuator(f"{axis}_stepper").gainprm[0] for axis in "xy"])
    assert link.teeth * 4 == whole.numeric("steps_per_revolution").data[0]
    np.testing.assert_allclose(rig.full.model.tendon_lengthspring[:2], [[-3e-6, 3e-6]] * 2)
    assert rig.full.model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_ACTUATION
    np.testing.assert_allclose(rig.full.wire_shape.sum(axis=1), 1.0)
    assert all(low < high for low, high in pairwise(rig.full.modes.node_heights_m))


@pytest.mark.parametrize(
    ("name", "value"),
    [("step_m", 2.0), ("friction_N", -1.0), ("presliding_m", 0.0), ("backlash_m", 3.0), ("backlash_m", math.nan)],
)
def test_impossible_drives_are_refused(name, value):
    with pytest.raises(InputError, match=rf"drive {name} is {value!r}; it must be"):
        DriveSetup(**{**vars(SMOOTH), name: value})
