"""The full model in MuJoCo, compared with closed forms and with the modal plant."""

import math
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from edmsim.errors import InputError
from edmsim.plant.mechanics.full_model import DriveSetup
from edmsim.plant.mechanics.model import WireSetup, build_model, reduce_model
from tests.plant.full_rig import ALL_MODES, BRASS, PERIOD_NS, SMOOTH, Rig, frequency, slice_heights
from tests.plant.oscillators import propagator_table

WIRES = [
    BRASS,
    WireSetup(0.10e-3, 8960.0, 4.0, 0.030, 0.2),  # copper
    WireSetup(0.18e-3, 10_220.0, 14.0, 0.100, 0.2),  # molybdenum, 80 mm workpiece
    WireSetup(0.02e-3, 19_300.0, 0.5, 0.025, 0.2),  # the thinnest of T-13, tungsten
]


@pytest.mark.slow
@pytest.mark.parametrize("wire", WIRES)
def test_the_wire_rings_at_the_string_s_frequencies(wire):
    free = WireSetup(**{**vars(wire), "damping_ratio": 1e-4})
    rig, n = Rig(free), np.arange(1, 5)
    sines = np.sin(n * np.pi * rig.full.modes.node_heights_m[:, None] / wire.guide_distance_m)
    rig.arrays.wire_q[0, : len(sines)] = sines.sum(axis=1)  # 1 um of each
    period_ns = int(2e3 * rig.full.link.longest_us)
    rings = rig.run(800, period_ns=period_ns).nodes[:, 0] @ sines
    found = np.array([frequency(ring, period_ns * 1e-9) for ring in rings.T])
    modal = reduce_model(build_model(wire), ALL_MODES, [0.01]).wire_omega[:4] / (2 * np.pi)
    assert found == pytest.approx(modal, rel=0.01)
    assert found == pytest.approx(n / (2 * wire.guide_distance_m) * wire.wave_speed, rel=0.01)  # physics 2.3


@pytest.mark.slow
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
    """A sequence of sparks: impulse (N s) on both axes, slice, time in the pulse (us)."""
    draw = np.random.default_rng(11)
    size, angle = 3e-7 * draw.uniform(0.5, 1.5, n), draw.normal(0.0, 0.5, n)  # physics 10
    kicks = -size[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return kicks, draw.integers(0, 9, n), draw.uniform(0.0, 75.0, n)


def modal_answer(modes, kicks, at, end_us):
    """The modes' response to the sparks: deflection (pulses, axes, slices) in um at every pulse's end."""
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
    """Modes of the continuous string: sines, all with the same drag per metre."""
    n = np.arange(1, n_modes + 1)
    omega = n * np.pi / wire.guide_distance_m * wire.wave_speed
    amplitude = math.sqrt(2 / (wire.line_density * wire.guide_distance_m))
    shape = amplitude * np.sin(n * np.pi * slice_heights(wire)[:, None] / wire.guide_distance_m)
    return SimpleNamespace(wire_omega=omega, wire_zeta=wire.damping_ratio / n, wire_shape=shape)


def differ(one, other):
    """Root mean square of the difference, relative to that of `other`."""
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


@pytest.mark.slow
def test_in_short_steps_impulses_move_every_slice_as_the_modes_do(train, full_answer):
    modal = modal_answer(Rig().full.modes, *train)
    assert differ(full_answer(1.0), modal) < 0.05  # 1.4 %
    assert differ(full_answer(0.25), modal) < 0.01  # 0.3 %: the rest is due to the time step


@pytest.mark.slow
def test_at_the_plant_s_step_the_mean_deflection_moves_as_the_modes_do(train, full_answer):
    full = full_answer().mean(axis=2)
    for n_modes in (ALL_MODES, 8):  # 4.3 %, 4.1 %
        modes = reduce_model(build_model(BRASS), n_modes, slice_heights(BRASS))
        assert differ(full, modal_answer(modes, *train).mean(axis=2)) < 0.05


@pytest.mark.slow
def test_at_the_plant_s_step_waves_run_more_like_the_string_s_than_the_modes(train, full_answer):
    # in single slices, kicks without duration make waves shorter than nodes or modes can represent
    exact = modal_answer(string(BRASS, 400), *train)
    modes = reduce_model(build_model(BRASS), ALL_MODES, slice_heights(BRASS))
    assert differ(full_answer(), exact) < differ(modal_answer(modes, *train), exact) < 0.25  # 18 %, 23 %


@pytest.mark.slow
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
    push = 2e3 * (p11[1] - p11[0]) + 5e2 * (p11[2] - p11[1])  # response to a force from t on: (1 - p11) / omega^2
    exact = (pull.T @ modes.wire_shape * push / modes.wire_omega**2) @ modes.wire_shape.T
    np.testing.assert_allclose(found, exact, atol=0.01 * max(np.abs(exact).max(), 1e-9))


@pytest.mark.slow
@pytest.mark.parametrize("damping_ratio", [0.0, 0.2, 5.0])
@pytest.mark.parametrize("wire", WIRES)
def test_the_time_step_is_stable_for_every_wire(wire, damping_ratio, train):
    rig = Rig(WireSetup(**{**vars(wire), "damping_ratio": damping_ratio}))
    kicks, at, end_us = train
    weak = kicks * (wire.line_density / BRASS.line_density)
    ran = rig.run(400, kicks=weak, at=at, end_us=end_us)
    assert ran.done == 400
    assert 0 < np.abs(ran.nodes).max() < 200


@pytest.mark.slow
@pytest.mark.parametrize("kick", [math.nan, math.inf, 1.0, -1e300])
def test_a_wild_wire_is_reported_and_nothing_is_written(kick, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    kicks = np.zeros((20, 2))
    kicks[7, 1] = kick
    rig = Rig()
    assert rig.run(20, kicks=kicks, end_us=np.full(20, 30.0)).done == 7
    assert rig.full.data.warning.number.sum() == 0
    assert not list(Path(tmp_path).iterdir())


@pytest.mark.slow
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
    slope = link.holding_Nm * link.teeth  # slope of the sine at rest
    np.testing.assert_allclose(slope, [whole.actuator(f"{axis}_stepper").gainprm[0] for axis in "xy"])
    assert link.teeth * 4 == whole.numeric("steps_per_revolution").data[0]
    np.testing.assert_allclose(rig.full.model.tendon_lengthspring[:2], [[-3e-6, 3e-6]] * 2)
    assert rig.full.model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_ACTUATION
    np.testing.assert_allclose(rig.full.wire_shape.sum(axis=1), 1.0)
    assert all(low < high for low, high in pairwise(rig.full.modes.node_heights_m))


@pytest.mark.parametrize(("name", "value"), [
    ("step_m", 2.0), ("friction_N", -1.0), ("presliding_m", 0.0), ("backlash_m", 3.0), ("backlash_m", math.nan),
])  # fmt: skip
def test_impossible_drives_are_refused(name, value):
    with pytest.raises(InputError, match=rf"drive {name} is {value!r}; it must be"):
        DriveSetup(**{**vars(SMOOTH), name: value})
