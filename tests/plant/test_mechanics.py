import dataclasses
import math
import pickle
import subprocess
import sys
import tomllib

import mujoco
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.linalg import expm

from edmsim import models
from edmsim.compiled import cache
from edmsim.errors import InputError
from edmsim.plant.mechanics.modal import fill_table, fill_wire
from edmsim.plant.mechanics.model import (
    MODEL_FILE,
    ModalModel,
    WireSetup,
    build_model,
    linearise,
    modes_with,
    reduce_model,
)
from edmsim.plant.mechanics.model import _reference as reference
from tests.plant.oscillators import propagator_table

BRASS = WireSetup(0.25e-3, 8500.0, 10.0, 0.040, 0.2)
WIRES = [
    BRASS,
    WireSetup(0.25e-3, 8500.0, 10.0, 0.025, 0.05),  # 5 mm workpiece
    WireSetup(0.10e-3, 8960.0, 4.0, 0.030, 0.2),  # copper
    WireSetup(0.18e-3, 10_220.0, 14.0, 0.100, 0.5),  # molybdenum, 80 mm workpiece
    WireSetup(0.02e-3, 19_300.0, 0.5, 0.025, 0.3),  # the thinnest of T-13, tungsten
]
N_NODES = 31
def slice_heights(height, guide_distance, n_slices):
    return (guide_distance - height) / 2 + height * (np.arange(n_slices) + 0.5) / n_slices


def wire_dofs(model, axis):
    return [int(model.joint(f"wire_{axis}{i:02d}").dofadr[0]) for i in range(N_NODES)]


@pytest.fixture(scope="module")
def machine():
    return build_model(BRASS)


@pytest.fixture(scope="module")
def modal(machine):
    return reduce_model(machine, N_NODES, slice_heights(0.020, 0.040, 9))


@pytest.mark.parametrize("wire", WIRES)
def test_frequencies_are_those_of_the_chain_and_of_the_string(wire):
    modes = reduce_model(build_model(wire), N_NODES, [wire.guide_distance_m / 2])
    n = np.arange(1, N_NODES + 1)
    spacing = wire.guide_distance_m / (N_NODES + 1)
    speed = math.sqrt(wire.tension / (wire.density_kg_m3 * math.pi / 4 * wire.diameter_m**2))
    chain = 2 / spacing * speed * np.sin(n * math.pi / (2 * (N_NODES + 1)))
    string = 2 * math.pi * n / (2 * wire.guide_distance_m) * speed  # physics: f_n = n/(2L) sqrt(T/mu)
    np.testing.assert_allclose(modes.wire_omega, chain, rtol=1e-6)
    np.testing.assert_allclose(modes.wire_omega[:4], string[:4], rtol=0.01)


@pytest.mark.parametrize("wire", WIRES)
def test_mode_shapes_are_the_string_s_sines(wire):
    modes = reduce_model(build_model(wire), 8, [wire.guide_distance_m / 3])
    n = np.arange(1, 9)
    length = wire.guide_distance_m
    line_density = wire.density_kg_m3 * math.pi / 4 * wire.diameter_m**2
    sines = np.sin(n * math.pi * modes.node_heights_m[:, None] / length)
    amplitude = math.sqrt(2 / (line_density * length))
    np.testing.assert_allclose(modes.node_shape, amplitude * sines, atol=1e-6 * amplitude)


def test_slices_move_with_the_straight_wire_between_nodes(modal, machine):
    low, high = modal.node_heights_m[:2]
    between = reduce_model(machine, 5, [low / 2, low, 0.75 * low + 0.25 * high])
    first, second = modal.node_shape[0, :5], modal.node_shape[1, :5]
    expected = [first / 2, first, 0.75 * first + 0.25 * second]
    np.testing.assert_allclose(between.wire_shape, expected, rtol=1e-9)


@pytest.mark.parametrize("wire", WIRES)
def test_first_mode_has_the_requested_damping_and_none_is_neglected(wire):
    modes = reduce_model(build_model(wire), 6, [wire.guide_distance_m / 2])
    # the same drag per metre on every mode: zeta falls as the frequency rises
    np.testing.assert_allclose(
        modes.wire_zeta, wire.damping_ratio * modes.wire_omega[0] / modes.wire_omega, rtol=1e-6
    )
    system = linearise(build_model(wire))
    dofs = wire_dofs(build_model(wire), "x")
    drag = system.damping[np.ix_(dofs, dofs)]
    mass = system.mass[np.ix_(dofs, dofs)]
    np.testing.assert_allclose(drag, drag[0, 0] / mass[0, 0] * mass, atol=1e-9 * drag[0, 0])


@pytest.mark.parametrize("wire", [*WIRES, dataclasses.replace(BRASS, slot_m=0.02, slot_mass_kg_m=1e-3)])
def test_a_wire_modelled_by_formula_has_the_modes_of_its_own_model(wire):
    heights = slice_heights(wire.guide_distance_m / 2, wire.guide_distance_m, 9)
    built, by_formula = reduce_model(build_model(wire), 8, heights), modes_with(wire, MODEL_FILE, 8, tuple(heights))
    for field in dataclasses.fields(ModalModel):
        expected = np.asarray(getattr(built, field.name))
        scale = np.abs(expected).max()
        np.testing.assert_allclose(
            getattr(by_formula, field.name), expected, rtol=1e-6, atol=1e-6 * scale, err_msg=field.name
        )


def test_our_machine_is_cached_and_read_without_mujoco_the_next_time(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "folder", tmp_path)
    reference.__wrapped__(MODEL_FILE, 0)
    (stored,) = tmp_path.iterdir()
    first = pickle.dumps(reference.__wrapped__(MODEL_FILE, 0))
    monkeypatch.setitem(sys.modules, "mujoco", None)
    assert pickle.dumps(reference.__wrapped__(MODEL_FILE, 0)) == first
    stored.write_bytes(b"damaged")
    monkeypatch.undo()
    monkeypatch.setattr(cache, "folder", tmp_path)
    assert pickle.dumps(reference.__wrapped__(MODEL_FILE, 0)) == first


def test_eight_modes_keep_the_mean_lag_under_a_train_of_sparks():
    model = build_model(BRASS)
    many = reduce_model(model, N_NODES, slice_heights(0.020, 0.040, 9))
    few = reduce_model(model, 8, slice_heights(0.020, 0.040, 9))
    order = np.random.default_rng(3).integers(0, 9, 1000)

    def lag(modes):
        p11, p12, p21, p22 = propagator_table(modes.wire_omega, modes.wire_zeta, [20e-6])
        q, v, out = np.zeros_like(modes.wire_omega), np.zeros_like(modes.wire_omega), []
        for place in order:
            v = v + modes.wire_shape[place] * 3e-7
            q, v = p11[0] * q + p12[0] * v, p21[0] * q + p22[0] * v
            out.append(modes.wire_shape @ q)
        return np.array(out[200:])

    np.testing.assert_allclose(lag(few).mean(0), lag(many).mean(0), rtol=0.01)
    assert np.sqrt(np.mean((lag(few) - lag(many)) ** 2)) < 0.2 * np.sqrt(np.mean(lag(many) ** 2))


def test_one_motor_step_moves_the_table_two_micrometres(machine, modal):
    # T-16; T-17: positive rotation is positive travel
    step_angle = 2 * math.pi / machine.numeric("steps_per_revolution").data[0]
    np.testing.assert_allclose(step_angle / modal.rotor_rad_per_m, 2e-6, rtol=1e-9)
    at_rest = np.sum(modal.table_slide_shape * modal.table_participation, axis=1)
    np.testing.assert_allclose(at_rest, 1.0, rtol=1e-9)


@pytest.mark.slow
def test_table_settles_on_a_step_and_the_modes_follow_the_full_model(machine, modal):
    data = mujoco.MjData(machine)
    data.ctrl[:] = 2 * math.pi / 200  # T-16
    axes = [int(machine.joint(axis).qposadr[0]) for axis in "xy"]
    n_steps = 10_000
    full = np.empty((n_steps, 2))
    for step in range(n_steps):
        mujoco.mj_step(machine, data)
        full[step] = data.qpos[axes]
    times = machine.opt.timestep * np.arange(1, n_steps + 1)
    for axis in range(2):
        p11, *_ = propagator_table(modal.table_omega[axis], modal.table_zeta[axis], times)
        rest = modal.table_participation[axis] * 2e-6
        reduced = (rest - p11 * rest) @ modal.table_slide_shape[axis]
        assert np.abs(full[:, axis] - reduced).max() < 0.05 * 2e-6
        assert full[-1, axis] == pytest.approx(2e-6, rel=1e-3)
        assert 2e-6 < full[:, axis].max() < 4e-6  # a stepper oscillates by less than a step


def test_table_frequencies_are_those_of_rotor_and_carriage(modal):
    # XML: holding torque 25 N m/rad on 6e-5 kg m2; screw 100e6 N/m on 45 kg and 20 kg. The reflected
    # rotor has 300 times the mass of a carriage, so they hardly affect each other.
    rotor = math.sqrt(25 / 6e-5)
    carriages = np.sqrt(100e6 / np.array([45.3, 20.0]))
    np.testing.assert_allclose(modal.table_omega[:, 0], rotor, rtol=0.01)
    np.testing.assert_allclose(modal.table_omega[:, 1], carriages, rtol=0.01)
    assert modal.neglected_damping < 0.03


def test_travel_covers_the_work_area_and_stops_behind_it(machine):
    for axis in "xy":  # T-61
        low, high = machine.joint(axis).range
        assert machine.joint(axis).limited
        assert -0.002 <= low < 0 and 0.065 < high <= 0.067  # noqa: PT018


def test_the_file_alone_holds_the_brass_of_the_wire_table():
    brass = tomllib.loads(models.path("wires/brass.toml").read_text())
    machine = build_model(WireSetup(0.25e-3, brass["density_kg_m3"]["value"], 10.0, 0.040, 0.2))
    alone = mujoco.MjModel.from_xml_path(str(models.path(MODEL_FILE)))
    bodies = ("body_pos", "body_mass", "body_inertia", "dof_damping", "geom_size", "geom_pos", "site_pos")
    for name in (*bodies, "tendon_stiffness", "tendon_lengthspring", "tendon_width"):
        np.testing.assert_allclose(getattr(alone, name), getattr(machine, name), rtol=1e-5, atol=1e-15)
    assert alone.opt.timestep == pytest.approx(machine.opt.timestep, rel=1e-5)


def test_upper_arm_and_workpiece_stand_where_the_guides_are():
    tall = build_model(WireSetup(0.25e-3, 8500.0, 10.0, 0.100, 0.2))
    data = mujoco.MjData(tall)
    mujoco.mj_forward(tall, data)
    assert data.site("upper_guide").xpos[2] == pytest.approx(0.100)
    workpiece = tall.geom("workpiece")
    middle = data.geom("workpiece").xpos[2]
    assert middle - workpiece.size[2] == pytest.approx(0.010)
    assert middle + workpiece.size[2] == pytest.approx(0.090)
    heights = [data.body(f"wire_{i:02d}").xpos[2] for i in range(N_NODES)]
    np.testing.assert_allclose(np.diff([0.0, *heights, 0.100]), 0.100 / 32)


@pytest.mark.parametrize(("name", "value"), [
    ("diameter_m", 0.25),  # mm taken for m
    ("diameter_m", -1e-4), ("density_kg_m3", 8.5), ("tension", 0.0), ("tension", -10.0), ("tension", math.inf),
    ("guide_distance_m", 40.0), ("guide_distance_m", 0.0), ("damping_ratio", -0.1), ("damping_ratio", math.nan),
])  # fmt: skip
def test_impossible_wires_are_refused(name, value):
    with pytest.raises(InputError, match=rf"wire {name} is {value!r}; it must be"):
        WireSetup(**{**vars(BRASS), name: value})


@pytest.mark.parametrize("n_modes", [0, 32])
def test_modes_the_wire_does_not_have_are_refused(machine, n_modes):
    with pytest.raises(InputError, match=rf"n_modes is {n_modes}; this wire has 1 to 31"):
        reduce_model(machine, n_modes, [0.02])


@pytest.mark.parametrize("heights", [[0.0], [0.04], [0.02, math.nan], [[0.02]]])
def test_slices_outside_the_guides_are_refused(machine, heights):
    with pytest.raises(InputError, match=r"between the guides, above 0 and below 0\.04 m"):
        reduce_model(machine, 8, heights)


def test_machines_that_are_not_four_free_blocks_are_refused():
    held, tilted, skewed, slack, flat = (build_model(BRASS) for _ in range(5))
    held.jnt_range[held.joint("x").id] = 0.001, 0.066
    with pytest.raises(InputError, match="touches 1 limits or contacts"):
        reduce_model(held, 8, [0.02])
    tilted.opt.gravity[:] = 0.1, 0.0, -9.8
    with pytest.raises(InputError, match="must be in equilibrium"):
        reduce_model(tilted, 8, [0.02])
    skewed.jnt_axis[skewed.joint("y").id] = -0.1, -1.0, 0.0
    with pytest.raises(InputError, match="mass couples"):
        reduce_model(skewed, 8, [0.02])
    slack.tendon_stiffness[:] = 0.0
    with pytest.raises(InputError, match="not stable"):
        reduce_model(slack, 8, [0.02])
    slack.tendon_stiffness[:], slack.dof_damping[:] = 1.0, -1.0
    with pytest.raises(InputError, match="damping below 0"):
        reduce_model(slack, 8, [0.02])
    flat.dof_damping[:] = 0.0
    flat.jnt_stiffness[flat.joint("wire_x03").id] = 100.0
    with pytest.raises(InputError, match="differs between x and y"):
        reduce_model(flat, 8, [0.02])


def test_an_unknown_data_file_is_named():
    with pytest.raises(InputError, match=r"no data file 'agie\.xml'"):
        models.path("agie.xml")


@pytest.mark.slow
def test_the_model_loads_no_mujoco_and_a_plant_neither_scipy_linalg_nor_asyncio():
    """Each would delay every start; scipy.linalg, if loaded later, shares the routine."""
    code = """
import sys, edmsim.plant.mechanics.model
print('mujoco' in sys.modules, 'scipy.linalg' in sys.modules)
import edmsim
from edmsim.plant.mechanics.model import _dsygvd
edmsim.Plant(edmsim.Machine.load(), resolution="fast").advance()
print('scipy.linalg' in sys.modules, 'asyncio' in sys.modules)
from scipy.linalg.lapack import dsygvd
print(dsygvd is _dsygvd())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False"] * 4 + ["True"]


# --- exact propagators, and the tables of their powers that the pulse loop reads ---


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
