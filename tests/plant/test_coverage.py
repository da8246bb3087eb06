"""Gas on the wire's front: closed forms, shielding, and energy balance."""

import math

import numpy as np
import pytest

import edmsim
from edmsim.plant.constants import constants, gap_law, gas_law
from edmsim.plant.gap.gas import (
    GasLaw,
    blow,
    cover_um2_J,
    fade,
    refill_um_s,
    refill_us,
    steam_life_us,
)
from edmsim.plant.gap.generator import timing
from edmsim.plant.gap.pulse_outcome import sum_rays
from edmsim.plant.gap.rays import pack_rays, rays_of
from edmsim.plant.gap.water import AMBIENT_PA, kerf_jets, mean_of_slices, viscosity_ratio
from edmsim.plant.kernel.state import GRID, Arrays, allocate, sizes_of
from edmsim.plant.mechanics.squeeze_film import edge_loss_kg_m2, mean_resistance
from edmsim.plant.resolution import resolution

from .conftest import fill

FAST = resolution("fast")


def lasting(steam, gas):
    """Fading by e over a number of grid steps."""
    steps = np.arange(GRID + 1)[:, None]
    return np.exp(-steps / np.array([steam, gas]))


def front(slices):
    a = allocate(Arrays, sizes_of(slices, 24, 4))
    a.metal.fill(1.0)
    return a


@pytest.fixture(scope="module")
def slab(machine):
    """Constants of slices 1000 um high."""
    return constants(machine, FAST)._replace(slice_um=1_000.0)


# --- closed forms ---


@pytest.mark.parametrize(
    ("share", "kerf_um", "joule"), [(0.02, 312.0, 3e-3), (8e-4, 330.0, 1e-2), (0.03, 162.0, 1e-4)]
)
def test_gas_of_a_discharge_is_a_disc_across_the_kerf(share, kerf_um, joule):
    radius2_m2 = cover_um2_J(share, kerf_um) * joule * 1e-12
    volume_m3 = math.pi * radius2_m2 * kerf_um * 1e-6
    assert AMBIENT_PA * volume_m3 == pytest.approx(share * joule)


def test_steam_lives_so_many_collapses():
    rayleigh_us = 0.915 * 1e-3 * math.sqrt(998.0 / AMBIENT_PA) * 1e6
    assert rayleigh_us == pytest.approx(90.8, abs=0.1)
    assert steam_life_us(1_000.0, 2.0) == pytest.approx(2 * rayleigh_us)


@pytest.mark.parametrize(("gap", "life"), [(31.0, 400.0), (45.0, 90.0)])
def test_pockets_damp_as_a_wire_that_drives_the_same_water_through_its_edges(gap, life, machine):
    """A flow ``u = pi r a / T`` through each edge adds ``loss rho u (r / g) d`` per speed of the wire."""
    radius, loss, density = 125e-6, 1.5, 998.0
    through_m_s = math.pi * radius / (life * 1e-6)
    per_speed = loss * density * through_m_s * (radius / (gap * 1e-6)) * 2 * radius
    speed_m_s = refill_um_s(gap, life) * 1e-6
    assert edge_loss_kg_m2(125.0, gap, loss) * speed_m_s == pytest.approx(per_speed)
    assert refill_um_s(gap, 0.0) == refill_um_s(gap, 1.0)  # the least lifetime is 1 us


@pytest.mark.slow
def test_steam_damps_the_wire_by_its_mean_share(machine):
    a, c, law = front(4), constants(machine, FAST), GasLaw(0.0, 0.0, 2e5, lasting(1.0, 1.0))
    assert mean_resistance(a, c, law, 3.0) == 3.0
    a.steam[:4] = 0.0, 0.1, 0.3, 0.4
    assert mean_of_slices(a.steam, 4) == pytest.approx(0.2)
    assert mean_resistance(a, c, law, 3.0) == pytest.approx(3.0 + c.jet_kg_um * 2e5 * 0.2)


def test_water_creeps_back_against_friction_and_its_own_mass():
    """Over a quarter of the circumference at 20 um and 20 C: 0.08 ms by Washburn's law, and 0.05 ms by inertia."""
    filled = refill_us(200.0, 20.0, 1e-3, 293.15, 1.0)
    assert filled == pytest.approx(82.4 + 52.4, abs=0.5)
    slow = refill_us(200.0, 20.0, 1e-3, 293.15, 0.3) / filled
    assert 1 / 0.3 > slow > 1 / math.sqrt(0.3)  # friction depends on the driving pressure, inertia on its root
    assert refill_us(200.0, 5.0, 1e-3, 293.15, 1.0) > 2 * filled


def test_the_law_of_a_setting_has_the_lives_of_its_longest_discharge(machine):
    setting = timing(machine)
    law = gas_law(machine, setting)
    gas, kerf_um = machine.base.gas, 250.0 + 2 * 39.0
    assert law.steam_um_J == pytest.approx(math.sqrt(cover_um2_J(gas.steam_share.value, kerf_um)))
    assert law.gas_um_J == pytest.approx(math.sqrt(cover_um2_J(gas.permanent_share.value, kerf_um)))
    half_um = law.steam_um_J * math.sqrt(22.0 * setting.current_A * 30e-6)
    life_us = steam_life_us(half_um, gas.steam_periods.value)
    np.testing.assert_array_equal(law.fading[0], 1.0)
    assert law.fading[GRID, 0] == pytest.approx(math.exp(-machine.t_period_us / life_us))
    assert law.refill_um_s == pytest.approx(refill_um_s(39.0, life_us))
    eta_Pa_s = 1e-3 * viscosity_ratio(323.0)
    filled_us = refill_us(math.pi / 4 * 250.0, 20.0, eta_Pa_s, 323.0, gas.wetting.value)
    assert law.fading[GRID, 1] == pytest.approx(math.exp(-machine.t_period_us / filled_us))


# --- one front ---


@pytest.mark.slow
def test_a_discharge_covers_its_length_of_every_slice_it_reaches(slab):
    a, law = front(4), GasLaw(300.0, 100.0, 0.0, lasting(1e9, 1e9))
    blow(a, slab, law, 1, 0.9, 1.0, 0, 0.0)
    np.testing.assert_allclose(a.steam[:4], [0.0, 0.4, 0.2, 0.0], atol=1e-12)
    np.testing.assert_allclose(a.gas[:4], [0.0, 0.2, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(a.covered[:4], [0.0, 0.4 + 0.2 - 0.4 * 0.2, 0.2, 0.0], atol=1e-12)  # by steam or gas
    low = front(4)
    blow(low, slab, law, 0, 0.1, 4.0, 0, 0.0)  # four times the energy reaches twice as far, partly outside
    np.testing.assert_allclose(low.steam[:4], [0.7, 0.0, 0.0, 0.0], atol=1e-12)


def test_gas_of_a_discharge_takes_the_place_of_what_was_there(slab):
    a, law = front(1), GasLaw(250.0, 0.0, 0.0, lasting(1e9, 1e9))
    shares = []
    for _ in range(3):
        blow(a, slab, law, 0, 0.5, 1.0, 0, 0.0)
        shares.append(a.steam[0])
    np.testing.assert_allclose(shares, [0.5, 0.75, 0.875])


def test_gas_fades_from_the_end_of_its_discharge_on(slab):
    law = GasLaw(250.0, 250.0, 0.0, lasting(200.0, 800.0))
    a = front(1)
    blow(a, slab, law, 0, 0.5, 1.0, 100, 0.0)
    np.testing.assert_allclose([a.steam[0], a.gas[0]], 0.5 * np.exp([-100 / 200, -100 / 800]))
    a.wake_gas.fill(0.0)
    fade(a, law, 300)
    np.testing.assert_allclose([a.steam[0], a.gas[0]], 0.5 * np.exp([-400 / 200, -400 / 800]))


def test_the_water_that_creeps_back_brings_the_kerf_s_gas():
    a, law = front(2), GasLaw(250.0, 250.0, 0.0, lasting(200.0, 800.0))
    a.gas[:2], a.wake_gas[:2], a.steam[:2] = (0.5, 0.1), (0.2, 0.3), 0.4
    fade(a, law, 400)
    left = math.exp(-400 / 800)
    np.testing.assert_allclose(a.gas[:2], [0.2 + 0.3 * left, 0.3 - 0.2 * left])
    np.testing.assert_allclose(a.steam[:2], 0.4 * math.exp(-2))  # steam leaves nothing


def test_a_discharge_spreads_its_debris_over_its_pocket(slab):
    """In proportion to length; debris beyond the workpiece is lost; without steam all debris is in its slice."""
    still, law = slab._replace(pumping=0.0), GasLaw(300.0, 0.0, 0.0, lasting(1e9, 1e9))
    for s, spread in ((1, [1 / 3, 2 / 3, 0.0]), (0, [2 / 3, 0.0, 0.0])):
        a = front(3)
        blow(a, still, law, s, 0.1, 1.0, 0, 0.01 * slab.cavity_um3)
        np.testing.assert_allclose(a.debris[:3], 0.01 * np.array(spread), atol=1e-12)
    a = front(3)
    blow(a, still, law._replace(steam_um_J=0.0), 1, 0.1, 1.0, 0, 0.01 * slab.cavity_um3)
    np.testing.assert_allclose(a.debris[:3], [0.0, 0.01, 0.0], atol=1e-12)


# --- the kerf behind the wire ---


def test_what_leaves_the_gap_is_in_the_kerf_and_comes_back_with_its_water(slab):
    """In proportion to volume; nothing changes if gap and kerf have the same share."""
    a, law = front(3), GasLaw(300.0, 0.0, 0.0, lasting(1e9, 1e9))
    a.debris[:3], a.wake_debris[:3] = 0.2, (0.0, 0.3, 0.2)
    before = slab.cavity_um3 * a.debris + slab.wake_um3 * a.wake_debris
    blow(a, slab, law, 1, 0.5, 4.0, 0, 0.0)
    under = slab.pumping * np.array([0.1, 1.0, 0.1])
    np.testing.assert_allclose(a.debris[:3], 0.2 - under * [0.2, -0.1, 0.0])
    np.testing.assert_allclose(slab.cavity_um3 * a.debris + slab.wake_um3 * a.wake_debris, before)


def test_permanent_gas_gathers_in_the_kerf_at_ambient_pressure(machine, slab):
    """In the slice of the discharge, a share of the energy divided by the pressure displaces the remaining water."""
    a, law = front(3), GasLaw(0.0, 0.0, 0.0, lasting(1e9, 1e9))
    for _ in range(2):
        blow(a, slab, law, 1, 0.5, 0.01, 0, 0.0)
    gas_m3 = machine.base.gas.permanent_share.value * 0.01 / AMBIENT_PA
    kerf_m3 = 328e-6 * 3e-3 * constants(machine, FAST).slice_um * 1e-6
    share = gas_m3 / kerf_m3
    np.testing.assert_allclose(a.wake_gas[:3], [0.0, 1 - (1 - share) ** 2, 0.0])


def test_the_kerf_of_a_plant_keeps_its_craters_where_no_jet_flushes_it(in_a_hole, machine):
    """Balance of debris over gap and kerf while bubbles pump between them; pockets of half length R throw a share
    R / (2 h) of it out of the faces, averaged over discharges on the height h."""
    still = machine.with_(flushing_lower_Pa=0.0, flushing_upper_Pa=0.0)
    gas = machine.base.gas
    plant = in_a_hole(still, 10.0, **{
        "material.removal_mm3_J": 1e-3, "base.gas.steam_share": gas.steam_share.value,
        "base.gas.permanent_share": gas.permanent_share.value,
    })  # fmt: skip
    windows, c = [plant.advance() for _ in range(20)], constants(still, FAST)
    state = plant.snapshot()
    held = c.cavity_um3 * state["debris"].sum() + c.wake_um3 * state["wake_debris"].sum()
    energy_J = sum(w.energy_J for w in windows) / sum(w.spark + w.arc for w in windows)
    reach_um = gas_law(still, timing(still)).steam_um_J * math.sqrt(energy_J)
    remaining = 1.0 - reach_um / (2 * still.height_mm * 1e3)
    assert 0.97 < remaining < 0.99
    assert held == pytest.approx(remaining * sum(w.crater_um3 for w in windows), rel=0.005)
    assert 0 < state["debris"].mean() < 3 * state["wake_debris"].mean()
    made = c.gas_um3_J * sum(w.energy_J for w in windows)
    logarithms = np.log1p(-state["wake_gas"][: FAST.slices])  # each discharge fills a share of the remaining water
    assert -c.wake_um3 * logarithms.sum() == pytest.approx(made, rel=1e-2)


def loaded_kerf(plant, share=0.2):
    fill(plant, wake_debris=share, wake_gas=share)
    while (state := plant.snapshot())["wake_gas"][0] == share:
        plant.advance_pulse()
    return state["wake_debris"][: FAST.slices], state["wake_gas"][: FAST.slices]


def test_jets_flush_the_kerf_slice_by_slice(in_a_hole, machine):
    """In one heat step of 1.5 ms clean water enters the lowest slice, and others get that of the slice below."""
    jet = machine.with_(flushing_lower_Pa=100.0, flushing_upper_Pa=0.0)
    speed = kerf_jets(100.0, 0.0, 328.0, 20.0).lower_m_s
    debris, gas = loaded_kerf(in_a_hole(jet, 80.0))
    changed = speed * 1500e-6 / 4e-3
    lost = changed / (1 + changed)  # a backward step in time
    assert 0.05 < lost < 0.2
    assert 1 - debris[0] / 0.2 == pytest.approx(lost, rel=1e-5)
    assert (np.diff(debris) > 0).all()
    np.testing.assert_allclose(gas, debris)


@pytest.mark.parametrize(("gap", "held"), [(20.0, True), (None, False)])
def test_along_a_wall_the_kerf_s_water_is_the_bath_s(gap, held, in_a_hole, machine):
    still = machine.with_(flushing_lower_Pa=0.0, flushing_upper_Pa=0.0)
    # not held, the wire is in front of a block
    plant = in_a_hole(still, gap) if held else edmsim.Plant(still, 1, resolution="fast")
    fill(plant, wake_debris=0.2, wake_gas=0.2)
    plant.advance()
    state = plant.snapshot()
    if held:
        np.testing.assert_array_equal(state["wake_debris"][: FAST.slices], 0.2)
        np.testing.assert_array_equal(state["wake_gas"][: FAST.slices], 0.2)
    else:  # only from the last pulses
        assert state["wake_debris"].max() < 0.01
        assert state["wake_gas"].max() < 0.01


# --- shielding ---


def covered_sums(machine, share):
    """Return rate, primed weight and pull of a slice at 9 um whose front is covered by gas to this share."""
    a, c = front(1), constants(machine, FAST)
    a.distance[0, :8], a.cosine[0, :8] = 9.0, 1.0
    a.blocks[0], a.unbroken[0], a.covered[0] = 1, 8, share
    pack_rays(rays_of(a))
    sums = np.zeros((1, 4))
    return np.array(sum_rays(a, c, gap_law(machine, FAST, 100.0), np.zeros((2, 8)), sums, np.zeros(1)))[[0, 1, 3]]


@pytest.mark.slow
def test_gas_takes_the_pull_and_a_part_of_the_ignition_from_the_share_it_covers(machine):
    gas, bare = machine.base.gas, covered_sums(machine, 0.0)
    assert (bare > 0).all()
    for share in (0.4, 1.0):
        lit, pulled = 1 - gas.dryness.value * share, 1 - gas.shielding.value * share
        np.testing.assert_allclose(covered_sums(machine, share) / bare, [lit, lit, pulled], rtol=1e-6)


def test_where_edges_of_bubbles_ignite_gas_hastens(machine, altered):
    helped = altered(machine, {"base.gas.dryness": -1.0})
    assert covered_sums(helped, 0.5)[0] == pytest.approx(1.5 * covered_sums(helped, 0.0)[0])


def one_discharge(in_a_hole, machine, share, dryness=0.0):
    """Return speed by the push (which is small), crater and energy of a pulse with this share of gas on the front."""
    plant = in_a_hole(machine.with_(t_on_us=400.0, t_period_us=2_000.0), 14.0, **{
        "base.discharge.impulse_10mJ_Ns": 1e-9, "base.gas.dryness": dryness, "material.removal_mm3_J": 9.3e-3,
        "base.discharge.crater_cv": 0.0, "base.dielectric.viscosity_Pa_s": 1e-9, "base.dielectric.edge_loss": 0.0,
    })  # fmt: skip
    plant.advance_pulse()
    fill(plant, covered=share, wire_q=0.0, wire_v=0.0)
    window = plant.advance_pulse()
    assert window.spark == 1
    after = plant.snapshot()
    return math.hypot(*np.linalg.norm(after["wire_v"], axis=1)), window.crater_um3, window.energy_J


def test_a_discharge_in_gas_pushes_and_ejects_less(in_a_hole, machine):
    speeds, craters, energies = np.array([one_discharge(in_a_hole, machine, share) for share in (0.0, 0.5, 1.0)]).T
    np.testing.assert_allclose(energies, energies[0])  # equal draws give equal pulses
    assert speeds[0] > 0
    np.testing.assert_allclose(speeds / speeds[0], [1.0, 0.5, 0.0], atol=0.03)
    np.testing.assert_allclose(craters / craters[0], [1.0, 0.75, 0.5], rtol=1e-6)


def test_sparks_strike_in_water_more_often_than_its_share(in_a_hole, machine):
    """Gas ignites less often: if half of the front is dry, ``0.5 / (1 - 0.5 x 0.7)`` of the sparks are in water."""
    sparks = [one_discharge(in_a_hole, machine, share, 0.7) for share in (0.0, 0.5)]
    ejected = [crater / energy for _, crater, energy in sparks]  # the second spark ignites later and is weaker
    wet = 0.5 / (1 - 0.5 * 0.7)
    assert ejected[1] / ejected[0] == pytest.approx(1 - 0.5 * (1 - wet), rel=1e-6)


def one_arc(in_a_hole, machine, arc_share=0.45):
    """A spark and the arc after it, as in `one_discharge`."""
    generator = machine.generator.model_copy(update={"arc_share": machine.base.gas.dryness})
    plant = in_a_hole(machine.model_copy(update={"generator": generator}), 6.0, **{
        "base.discharge.impulse_10mJ_Ns": 1e-9, "material.removal_mm3_J": 9.3e-4, "generator.arc_share": arc_share,
        "base.discharge.crater_cv": 0.0, "base.dielectric.viscosity_Pa_s": 1e-9, "base.dielectric.edge_loss": 0.0,
        "base.gap.deionisation_us": 1e7,
    })  # fmt: skip
    spark = plant.advance_pulse()
    pushed = math.hypot(*np.linalg.norm(plant.snapshot()["wire_v"], axis=1))
    fill(plant, wire_q=0.0, wire_v=0.0)
    arc = plant.advance_pulse()
    assert (spark.spark, arc.arc) == (1, 1)
    return spark, arc, pushed, math.hypot(*np.linalg.norm(plant.snapshot()["wire_v"], axis=1))


@pytest.mark.parametrize("share", [0.45, 1.0])
def test_an_arc_burns_in_the_gas_of_the_discharge_before(share, in_a_hole, machine):
    """It does not push, ejects half as much per joule, and lasts the generator's share of the on-time for arcs."""
    spark, arc, pushed, later = one_arc(in_a_hole, machine, share)
    assert later < 1e-3 * pushed
    assert arc.crater_um3 / arc.energy_J == pytest.approx(0.5 * spark.crater_um3 / spark.energy_J, rel=1e-6)
    power_W = 22.0 * timing(machine).current_A
    assert arc.energy_J == pytest.approx(share * power_W * 30e-6, rel=1e-6)


# --- energy of the gas ---


def test_what_boils_and_what_heats_the_wire_is_never_more_than_the_discharge(machine):
    """Steam at 100 C: 0.598 kg/m3, 2.257 MJ/kg. Water split at 25 C: 286 kJ and 1.5 mol of gas per mol."""
    steam, permanent, wire = (
        machine.base.gas.steam_share, machine.base.gas.permanent_share, machine.base.cooling.wire_heat_share,
    )  # fmt: skip
    boiling, splitting = 0.598 * 2.257e6 / AMBIENT_PA, 286e3 / (1.5 * 8.314 * 298.0)
    assert boiling == pytest.approx(13.6, rel=0.03)
    assert max(steam.range) * boiling + max(wire.range) < 1.0
    assert permanent.value * splitting == pytest.approx(0.06, abs=0.005)  # as in the source of the constant
    assert steam.value * boiling + permanent.value * splitting + wire.value < 1.0


# --- in the plant ---


def test_without_gas_shares_there_is_no_gas(machine, altered, drive):
    without = altered(machine, {"base.gas.steam_share": 0.0, "base.gas.permanent_share": 0.0})
    windows = drive(edmsim.Plant(without, 1, resolution="fast"), 20.0, 2.0)
    assert sum(w.spark for w in windows) > 100
    assert all(w.coverage == 0.0 for w in windows)


def test_denser_discharges_cover_more(machine, drive):
    means = []
    for feed in (10.0, 15.0, 20.0):
        windows = drive(edmsim.Plant(machine, 1, resolution="fast"), feed, 10.0)
        assert all(0.0 <= w.coverage < 1.0 for w in windows)
        means.append(np.mean([w.coverage for w in windows[-200:]]))
    assert 0.0 < means[0] < means[1] < means[2] < 0.7
