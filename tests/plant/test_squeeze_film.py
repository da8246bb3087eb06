"""The film of water between wire and metal: its closed forms, and the motion they allow in a plant."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import expm
from scipy.optimize import curve_fit

import edmsim
from edmsim.closed_loop.straight import begin
from edmsim.plant.constants import (
    RAY_RANGE_UM,
    constants,
    fill_propagators,
    full_mechanics,
    gap_law,
    modal_model,
)
from edmsim.plant.gap.breakdown import slice_sums
from edmsim.plant.gap.generator import timing
from edmsim.plant.gap.rays import rays_with
from edmsim.plant.gap.water import DENSITY_KG_M3
from edmsim.plant.kernel.state import Arrays, Propagators, allocate, sizes_of
from edmsim.plant.mechanics.modal import kick, move, push_out
from edmsim.plant.mechanics.squeeze_film import (
    added_mass_kg_m,
    drag_N_s_m2,
    edge_loss_kg_m2,
    pull_sum_um2,
    suction_limited,
)
from edmsim.plant.resolution import resolution
from edmsim.plant.workpiece.blanks import SLOT_GAP_UM, started_slot
from edmsim.plant.workpiece.kerf_field import Stock
from tests.plant.arrays import arrays

FAST = resolution("fast")
CENTRE_UM = (32_500.0, 32_500.0)
R_UM, ETA = 125.0, 1e-3
BRASS_KG_M = 8400.0 * math.pi / 4 * 0.25e-3**2
SIDE_UM = 31.0
"""Side gap of the default machine."""


def beyond(gap_um, power):
    """Integral of the resistance over a quarter between a wire and straight walls, from 90 degrees on."""
    return quad(lambda psi: math.cos(psi) ** 2 / (gap_um + R_UM * (1 - math.cos(psi))) ** power, 0, math.pi / 2)[0]


# --- closed forms ---


@pytest.mark.parametrize("gap", [3.0, 8.0, 20.0, 30.0])
def test_a_uniform_gap_resists_as_reynolds_equation_says(gap):
    front = 6 * math.pi * ETA * (R_UM / gap) ** 3
    sides = 2 * 12 * ETA * R_UM**3 * beyond(gap, 3)
    assert drag_N_s_m2(R_UM, gap, gap, ETA) == pytest.approx(front + sides, rel=1e-4)


@pytest.mark.parametrize(("front", "side", "published"), [
    (20, 35, 1.78), (16, 32, 2.78), (14, 30, 3.71), (10, 26, 7.4), (8, 24, 11.4), (5, 21, 27.3),
])  # fmt: skip
def test_a_leading_wire_meets_the_derived_resistance_and_that_of_its_sides(front, side, published):
    sides = 2 * 12 * ETA * R_UM**3 * beyond(side, 3)
    assert drag_N_s_m2(R_UM, front, side, ETA) - sides == pytest.approx(published, rel=6e-3)


@pytest.mark.parametrize("gap", [8.0, 20.0, 31.0])
def test_the_water_of_a_uniform_gap_weighs_as_the_closed_form(gap):
    outer = gap + R_UM
    root = math.sqrt(outer**2 - R_UM**2)
    turn = 2 / root * math.atan(math.sqrt((outer + R_UM) / gap))
    behind = outer**2 / R_UM**2 * turn - 1 / R_UM - outer * math.pi / (2 * R_UM**2)
    expected = DENSITY_KG_M3 * (R_UM * 1e-6) ** 2 * R_UM * (math.pi / 2 / gap + 2 * behind)
    assert added_mass_kg_m(R_UM, gap, gap) == pytest.approx(expected, rel=1e-4)


def test_the_water_in_the_slot_weighs_about_half_of_the_wire():
    shares = [added_mass_kg_m(R_UM, front, side) / BRASS_KG_M for front, side in ((20, 35), (8, 24))]
    assert shares == pytest.approx([0.42, 0.67], abs=0.01)  # front 0.26 and 0.46, sides 0.16 and 0.21


def test_random_motion_meets_the_linearised_loss_at_the_film_s_edges():
    """<F v> of F = k rho r (r/g)^2 v |v| for normally distributed speeds equals that of the linear force."""
    spread, loss = 0.3, 1.5

    def density(v):
        return math.exp(-0.5 * (v / spread) ** 2) / (spread * math.sqrt(2 * math.pi))

    quadratic = loss * 998.0 * R_UM * 1e-6 * (R_UM / SIDE_UM) ** 2
    dissipated = 2 * quadratic * quad(lambda v: v**3 * density(v), 0, 10 * spread)[0]
    linear = edge_loss_kg_m2(R_UM, SIDE_UM, loss) * spread
    assert linear * spread**2 == pytest.approx(dissipated, rel=1e-6)


@pytest.mark.parametrize(("front", "side"), [(20.0, 35.0), (8.0, 24.0), (16.0, 31.0)])
def test_the_pull_that_stands_for_the_film_is_that_of_the_rays(front, side, machine):
    angle = 2 * math.pi * np.arange(64) / 64
    angle = angle[np.cos(angle) > -1e-9]
    gaps, row = side - (side - front) * np.cos(angle), np.zeros((1, 4))
    slice_sums(rays_with(gaps, angle), 0, 0.0, 0.0, gap_law(machine, FAST, 100.0), row)
    assert row[0, 2] == pytest.approx(pull_sum_um2(R_UM, front, side, 64), rel=2e-3)


@pytest.mark.parametrize(("front", "ratio"), [(3.0, 1.19), (6.0, 1.10), (14.0, 0.905), (20.0, 0.786)])
def test_in_a_kerf_the_film_follows_the_pull_within_a_quarter(front, ratio):
    """Around a wire 16 um ahead of its kerf's axis, as on the laboratory machine."""

    def over_pull(front_um):
        return drag_N_s_m2(R_UM, front_um, front_um + 16, ETA) / pull_sum_um2(R_UM, front_um, front_um + 16, 24)

    assert over_pull(front) / over_pull(10.0) == pytest.approx(ratio, abs=0.01)


@pytest.mark.parametrize("front", [3.0, 6.0, 14.0, 20.0])
def test_the_pull_tells_the_front_gap_by_its_root_of_the_third_power(front):
    """In a kerf the pull is proportional to ``g^(-3/2)``, within a tenth of the gap."""
    pulls = [pull_sum_um2(R_UM, gap, gap + 16.0, 24) for gap in (12.0, front)]
    assert 12.0 * (pulls[0] / pulls[1]) ** (2 / 3) == pytest.approx(front, rel=0.1)


# --- cavitation and contact ---


@pytest.mark.slow
def test_suction_is_limited_by_the_ambient_pressure_and_squeezing_is_not(machine):
    c = constants(machine, FAST)
    a = allocate(Arrays, sizes_of(5, 24, 4))
    a.metal.fill(1.0)
    a.covered[1] = 0.4
    most = 101_325.0 * 250e-6 * 20e-3 / 5 * 1e6  # on the wire's diameter, in um kg/s2
    assert suction_limited(a, c, 0, 0.5 * most) == 0.5 * most
    assert suction_limited(a, c, 0, 10 * most) == pytest.approx(most)
    assert suction_limited(a, c, 1, 10 * most) == pytest.approx(0.6 * most)
    assert suction_limited(a, c, 0, -10 * most) == -10 * most


@pytest.mark.slow
def test_a_contact_takes_only_the_speed_of_its_slice_along_its_direction(machine):
    """It is one impulse: the other axis keeps its speed, and the energy lost is that of the slice's own mass."""
    model = modal_model(machine, FAST)
    a = arrays(model, sizes_of(FAST.slices, FAST.rays, FAST.modes), 293.0, {})
    draw = np.random.default_rng(3)
    a.wire_v[:] = draw.normal(0.0, 1e5, a.wire_v.shape)
    into = math.copysign(1.0, float((a.shape @ a.wire_v[0])[2]))
    before_q, before_v = a.wire_q.copy(), a.wire_v.copy()
    push_out(a, 2, into, 0.0, 1.5)
    moved, speed = a.shape @ (a.wire_q - before_q).T, a.shape @ a.wire_v.T
    assert moved[2] == pytest.approx([-1.5 * into, 0.0])
    assert speed[2, 0] == pytest.approx(0.0, abs=1e-6)
    np.testing.assert_array_equal(a.wire_v[1], before_v[1])
    lost = 0.5 * ((before_v**2).sum() - (a.wire_v**2).sum())
    assert lost == pytest.approx(0.5 * model.slice_mass_kg[2] * float((a.shape @ before_v[0])[2]) ** 2)
    push_out(a, 2, into, 0.0, 1.0)  # it is already leaving, so its speed does not change
    np.testing.assert_allclose(a.shape @ a.wire_v[0], speed[:, 0], atol=1e-6)


# --- one mode in the mean film: its motion over a pulse against its exact propagator ---


def exact_period(omega, zeta, drag, spans_s, pull, jump):
    """Exact map of a mode's position and speed over a period, and what it adds: pull before the kick, none after."""
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
    """In the mean over equal pulses, and without load; the film's resistance is `braking` per period."""
    omega, zeta, shape, period = first_mode
    spans = np.array([k_first, 1_000 - k_first]) * 1e-7
    exact, added = exact_period(omega, zeta, braking / 100e-6, spans, pull, shape * impulse * 1e6)
    moved = np.column_stack([period(braking, k_first, start, 0.0, 0.0) for start in np.eye(2)])
    adds = period(braking, k_first, (0.0, 0.0), pull, impulse)
    bent = np.linalg.solve(np.eye(2) - moved, adds)[0]
    assert bent == pytest.approx(np.linalg.solve(np.eye(2) - exact, added)[0], rel=1.2e-2)
    assert np.log(np.linalg.det(moved)) == pytest.approx(np.log(np.linalg.det(exact)), rel=0.09)


@pytest.mark.parametrize("braking", [5.0, 100.0, 1e6])
def test_no_film_is_too_stiff_for_a_mode(first_mode, braking):
    *_, period = first_mode
    moved = np.column_stack([period(braking, 350, start, 0.0, 0.0) for start in np.eye(2)])
    assert np.abs(np.linalg.eigvals(moved)).max() < 1.0


# --- in a plant, the generator off ---

PURE = {
    "base.dielectric.gap_temperature_K": 293.15, "base.dielectric.edge_loss": 0.0, "base.guides.damping_ratio": 1e-6,
    "base.dielectric.film_stirring": 1.0, "base.dielectric.jet_drag": 0.0,
}  # fmt: skip
"""Only the film, at 1e-3 Pa s: laminar, and without the push of jets."""


@pytest.fixture(scope="module")
def pure(machine, altered):
    return altered(machine, PURE)


def off(plant):
    plant.switch_generator(False)
    plant.advance()
    return plant


def led(machine, front, side, *, mechanics="modal", **setting):
    """A plant without voltage whose wire is off the middle of a round hole, `front` um from the metal along +x."""
    stock = Stock((29_500.0, 29_500.0, 35_500.0, 35_500.0), ((*CENTRE_UM, R_UM + side),))
    place = CENTRE_UM[0] + side - front, CENTRE_UM[1]
    machine = machine.with_(**setting) if setting else machine
    return off(edmsim.Plant(machine, 1, stock=stock, position_um=place, resolution="fast", mechanics=mechanics))


def deflect(plant, **arrays):
    state = plant.snapshot()
    for name, values in arrays.items():
        state[name][0, : len(values)] = values
    plant.restore(state)


def linear(machine, drag, load_N, q0, times):
    """Wire in a film of constant resistance (N s/m2 of every slice): deflections (times, slices) in um."""
    model = modal_model(machine, FAST)
    shape, n = model.wire_shape, len(model.wire_omega)
    slice_m = machine.height_mm * 1e-3 / FAST.slices
    films = np.broadcast_to(drag, len(shape)) * slice_m
    damping = shape.T @ (films[:, None] * shape) + np.diag(2 * model.wire_zeta * model.wire_omega)
    system = np.block([[np.zeros((n, n)), np.eye(n)], [-np.diag(model.wire_omega**2), -damping]])
    rest = shape.T @ load_N * 1e6 / model.wire_omega**2
    start = np.concatenate([q0 - rest, np.zeros(n)])
    return np.array([shape @ ((expm(system * t) @ start)[:n] + rest) for t in times])


@pytest.mark.parametrize("period", [20.0, 100.0])
@pytest.mark.parametrize("gap", [20.0, 30.0])
def test_a_wire_in_a_slot_rings_with_the_damping_of_its_mean_film(gap, period, pure):
    on = min(10.0, period / 3.5)
    machine = pure.with_(t_on_us=on, t_period_us=period)
    plant = off(begin(machine, 0, gap_um=gap))
    model = modal_model(machine, FAST)
    per_um = float(model.wire_shape[2, 0])
    deflect(plant, wire_q=[0.5 / per_um], wire_v=[0.0])
    times, places = np.arange(round(2e3 / period)) * period * 1e-6, []
    for _ in times:
        places.append(plant.deflections_um()[2, 0])
        plant.advance_pulse()

    def ringing(t, zeta, omega):
        s = omega * math.sqrt(max(1 - zeta**2, 1e-6))
        return 0.5 * np.exp(-zeta * omega * t) * (np.cos(s * t) + zeta * omega / s * np.sin(s * t))

    omega = model.wire_omega[0]
    (zeta, _), _ = curve_fit(ringing, times, places, p0=(0.2, omega), bounds=([0, 0.5 * omega], [0.95, 1.5 * omega]))
    on_mode = float((model.wire_shape[:, 0] ** 2).sum()) * machine.height_mm * 1e-3 / FAST.slices
    assert zeta == pytest.approx(drag_N_s_m2(R_UM, gap, gap, ETA) * on_mode / (2 * omega), rel=0.07)


def film_of(plant, come_um):
    """Resistance (N s/m2) towards +x of the film in the plant's gaps after the wire has moved by `come_um`."""
    rays = plant.rays()
    gaps = rays.distance.astype(float) - come_um * rays.cosine
    return 12 * ETA * R_UM**3 * math.tau / FAST.rays * float((rays.sine**2 / gaps**3).sum(axis=1).mean())


@pytest.mark.parametrize("mechanics", ["modal", "mujoco"])
@pytest.mark.parametrize(
    ("front", "side", "period"), [(8.0, 24.0, 20.0), (8.0, 24.0, 100.0), (3.0, 19.0, 20.0), (3.0, 19.0, 100.0)]
)
def test_a_loaded_wire_creeps_through_a_narrow_film(front, side, period, mechanics, pure):
    """Far slower than a free wire: the speed is the load divided by the film's resistance."""
    plant = led(pure, front, side, mechanics=mechanics, t_on_us=period / 4, t_period_us=period)
    load_N = np.full(FAST.slices, 0.02 * 20e-3 / FAST.slices)  # 20 mN/m, which deflect it by 0.3 um at rest
    model = modal_model if mechanics == "modal" else full_mechanics
    shape, crept, pulses = model(pure, FAST).wire_shape, [], round(200.0 / period)
    for _ in range(pulses):
        deflect(plant, steady=shape.T @ load_N * 1e6)
        plant.advance_pulse()
        crept.append(plant.deflections_um()[:, 0].mean())
    film = film_of(plant, crept[-1] / 2)
    expected = linear(pure, film, load_N, np.zeros(FAST.modes), np.array([200e-6])).mean()
    assert 0.98 * expected < crept[-1] < 1.04 * expected
    assert expected < 0.02 / film * 200e-6 * 1e6


@pytest.mark.slow
@pytest.mark.parametrize("mechanics", ["modal", "mujoco"])
@pytest.mark.parametrize("period", [20.0, 1_000.0])
def test_no_period_is_too_long_and_no_gap_too_narrow_for_the_film(period, mechanics, pure):
    plant = led(pure, 3.0, 19.0, mechanics=mechanics, t_on_us=5.0, t_period_us=period)
    state = plant.snapshot()
    nodes = state["wire_v"].shape[1]
    state["wire_v"][0] = np.random.default_rng(2).normal(0.0, 2e5, nodes) * (1.0 if mechanics == "mujoco" else 0.01)
    plant.restore(state)
    furthest = 0.0
    for _ in range(4):
        plant.advance()
        furthest = max(furthest, float(np.abs(plant.deflections_um()).max()))
    assert furthest < 25.0
    assert np.abs(plant.deflections_um()).max() < 3.0


def test_a_wire_torn_off_the_metal_leaves_no_slower_than_suction_lets_it(pure):
    """The film alone would hold it longer, but cavitates at the ambient pressure on the wire's diameter.

    The wire oscillates in its second mode, so its halves are at opposite walls and there is no mean film.
    """
    plant = led(pure, 14.0, 14.0, t_on_us=1.0, t_period_us=5.0)
    plant.reset(1)  # traces the rays again, for the present position
    plant.switch_generator(False)
    shape = modal_model(pure, FAST).wire_shape
    bow = 11.0 / np.abs(shape[:, 1]).max() * np.eye(FAST.modes)[1]
    start = shape @ bow
    torn_N, suction_N = -np.sign(start.round(3)), 101_325.0 * 250e-6 * 20e-3 / FAST.slices
    deflect(plant, wire_q=bow, wire_v=np.zeros_like(bow), steady=shape.T @ torn_N * 1e6)
    plant.advance_pulse()
    left = (plant.deflections_um()[:, 0] - start) * torn_N
    films = np.array([drag_N_s_m2(R_UM, 14.0 - abs(come), 14.0, ETA) for come in start])
    capped, held = (
        (linear(pure, drag, torn_N * share, bow, [5e-6])[0] - start) * torn_N
        for drag, share in ((0.0, 1 - suction_N), (films, 1.0))
    )
    assert left[0] > capped[0] > held[0]


# --- jets that turn into the kerf ---


def string_um(machine, pressures_Pa, of_force):
    """Deflection at the middles of the slices of a string under loads that decay from the faces inwards."""
    n, height = 8_000, machine.height_mm * 1e-3
    clearance = machine.base.guides.clearance_mm.value * 1e-3
    z = (np.arange(n) + 0.5) / n * (height + 2 * clearance) - clearance
    lower, upper = (np.exp(-from_face / 3e-3) for from_face in (z, height - z))
    load, inside = np.zeros(n), (z > 0) & (z < height)
    fading = (pressures_Pa[0] * lower + pressures_Pa[1] * upper)[inside].reshape(FAST.slices, -1)
    load[inside] = fading.mean(axis=1).repeat(fading.shape[1])
    dz = (height + 2 * clearance) / n
    turned = np.cumsum(load) * dz * of_force * machine.wire_diameter_um * 1e-6 / machine.tension
    bent = np.cumsum(turned) * dz
    bent = (np.arange(n) + 1) / n * bent[-1] - bent
    return np.interp((np.arange(FAST.slices) + 0.5) / FAST.slices * height, z, bent) * 1e6


def pushed_um(machine, stock, place):
    """Deflections of the slices at rest under the jets alone, and the rays there."""
    plant = off(edmsim.Plant(machine, 1, stock=stock, position_um=place, resolution="fast"))
    for _ in range(12):
        plant.advance()
    return plant.deflections_um(), plant.rays()


@pytest.mark.slow
@pytest.mark.parametrize("pressures", [(2e5, 2e5), (2e5, 0.0)])
def test_jets_push_the_wire_to_the_open_side_of_a_kerf_as_end_loads_push_a_string(pressures, machine, altered):
    jets = altered(machine, {"base.guides.damping_ratio": 1.0})
    jets = jets.with_(flushing_lower_Pa=pressures[0], flushing_upper_Pa=pressures[1])
    bent, rays = pushed_um(jets, started_slot(jets, CENTRE_UM), CENTRE_UM)
    closed = math.pi / FAST.rays * float(rays.cosine[0].astype(float).sum())  # 1 for a half circle
    half_width = R_UM + SLOT_GAP_UM
    behind = math.asin(half_width / (R_UM + RAY_RANGE_UM))  # from this angle on the rays do not reach the sides
    assert closed == pytest.approx(math.sin(behind), abs=0.1)
    expected = string_um(jets, pressures, 0.05 * closed)
    assert 0.3 < expected.mean() < 10.0
    np.testing.assert_allclose(-bent[:, 0], expected, rtol=0.05)
    np.testing.assert_allclose(bent[:, 1], 0.0, atol=1e-6 * expected.mean())
    without = altered(jets, {"base.dielectric.jet_drag": 0.0})
    assert np.abs(pushed_um(without, started_slot(without, CENTRE_UM), CENTRE_UM)[0]).max() < 1e-9


def test_along_a_wall_and_in_a_hole_jets_push_nothing(machine):
    jets = machine.with_(flushing_lower_Pa=2e5, flushing_upper_Pa=2e5)
    x, y = CENTRE_UM
    wall = Stock((x + R_UM + 25.0, y - 3_000, x + 3_000, y + 3_000))
    hole = Stock((x - 3_000, y - 3_000, x + 3_000, y + 3_000), ((x, y, R_UM + 25.0),))
    for stock in (wall, hole):
        assert np.abs(pushed_um(jets, stock, CENTRE_UM)[0]).max() < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [90.0, 180.0, 225.0])
def test_jets_push_to_wherever_the_kerf_is_open(degrees, machine):
    """In a slot that was cut in another direction."""
    jets, angle = machine.with_(flushing_lower_Pa=2e5, flushing_upper_Pa=2e5), math.radians(degrees)
    x, y = CENTRE_UM
    along = np.arange(0.0, 600.0, 20.0)
    holes = tuple((x - s * math.cos(angle), y - s * math.sin(angle), R_UM + 30.0) for s in along)
    stock = Stock((x - 3_000, y - 3_000, x + 3_000, y + 3_000), holes)
    bent = pushed_um(jets, stock, CENTRE_UM)[0].mean(axis=0)
    assert math.hypot(*bent) > 0.3
    assert math.cos(math.atan2(-bent[1], -bent[0]) - angle) > 0.995


# --- pull-in ---


UNLIT = {
    "base.gap.median_c_us": 1e15, "base.gap.critical_um": 1e-3, "base.gap.critical_width_um": 1e-6,
    "base.dielectric.conductivity_uS_cm": 1e-9, "generator.resistance_ohm": 1e4, "base.guides.damping_ratio": 1.5,
}  # fmt: skip
"""Constants with which no pulse ignites and the wire does not overshoot."""


def equilibrium_um(compliance, pull_N_um2, gap_um):
    """Deflections of the slices under a pull of ``(1/g + 1/(2 r))^2``; None without equilibrium."""
    place = np.zeros(len(compliance))
    for _ in range(2_000):
        field = 1 / (gap_um - place) + 0.5 / R_UM
        new = compliance @ (pull_N_um2 * field**2) * 1e6
        if new.max() > gap_um - 1.0:
            return None
        if np.abs(new - place).max() < 1e-9:
            break
        place = new
    return place


@pytest.mark.slow
@pytest.mark.parametrize(("of_critical", "holds"), [(0.96, True), (1.04, False)])
def test_the_pull_takes_the_wire_from_a_third_of_the_free_gap_on(of_critical, holds, machine, altered):
    """At half of the remaining gap ``1/g^2`` grows as fast as the string's force. One ray faces the metal."""
    gap_um = 20.0
    quiet = altered(machine, UNLIT).with_(t_on_us=99.0, t_period_us=100.0)
    model = modal_model(quiet, FAST)
    compliance = model.wire_shape @ np.diag(model.wire_omega**-2.0) @ model.wire_shape.T
    low, high = 0.0, 1.0
    for _ in range(30):  # force of a slice's ray, in N um^2, above which there is no equilibrium
        middle = 0.5 * (low + high)
        low, high = (middle, high) if equilibrium_um(compliance, middle, gap_um) is not None else (low, middle)
    at_fold = equilibrium_um(compliance, 0.9999 * low, gap_um).mean()
    assert at_fold / (gap_um - at_fold) == pytest.approx(0.5, abs=0.03)
    c = constants(quiet, FAST)
    per_permittivity = 0.5 * c.permittivity_F_m * 100.0**2 * c.patch_m2 * 1e12 * 0.99
    permittivity = of_critical * low / per_permittivity * quiet.base.dielectric.permittivity.value
    plant = edmsim.Plant(altered(quiet, {"base.dielectric.permittivity": permittivity}), 1, resolution="fast")
    plant.advance_pulse()
    state = plant.snapshot()
    state["distance"][:] = 1e6
    state["cosine"][:] = state["sine"][:] = 0.0
    state["distance"][:, 0], state["cosine"][:, 0] = gap_um, 1.0
    state["reference_um"][0, :] = CENTRE_UM[0]
    state["reference_um"][1, :] = CENTRE_UM[1]
    state["first"][:], state["blocks"][:], state["unbroken"][:] = 0, 1, 0
    state["wire_q"][:] = state["wire_v"][:] = 0.0
    plant.restore(state)
    windows = [plant.advance() for _ in range(3)]
    assert (sum(w.short for w in windows) == 0) == holds
    if holds:
        expected = equilibrium_um(compliance, of_critical * low, gap_um)
        np.testing.assert_allclose(plant.deflections_um()[:, 0], expected, rtol=0.1)
