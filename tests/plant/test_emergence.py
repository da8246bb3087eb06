"""Results of the pulse loop that are not inputs: gaps, kerf, shapes, shorts, lag, corners, rupture."""

import math

import numpy as np
import pytest

from edmsim.closed_loop.straight import Cut, Traverse, begin, cut_straight
from edmsim.controllers import from_text, make
from edmsim.evaluation.stable_rate import quick_counts, shorten_pauses
from edmsim.machine.components import BOILING_K
from edmsim.machine.machine import Machine
from edmsim.validation.breakage import APPROACH_S, HELD_SHARE, HOLD_S, break_limit_A, sato_rig
from edmsim.validation.cuts import drum_um
from edmsim.validation.lag import AFTER_UM, BEFORE_UM, corner_rig, cut_corner
from edmsim.validation.setups import UNBREAKABLE, altered

PULL = "base.dielectric.permittivity"
PARTICLES = "base.gap.particle_share"
IMPULSE = "base.discharge.impulse_10mJ_Ns"
UNBRIDGED = {"base.gap.chaining": 0.0}
LOADED = {"base.dielectric.flushing_pressure_Pa": 15_000.0, "base.gas.pumping": 0.0}
NO_JETS = {"base.dielectric.jet_drag": 0.0}
NO_PUSH = {IMPULSE: 0.0, "base.discharge.bubble_share": 1e-12}

SIZES = 0.001, 0.04, 0.1
CENTRE_X_UM = 32_500.0


@pytest.fixture(scope="module")
def usual(machine):
    """The default set-up at 20 um/s."""
    return cut_straight(machine, 20.0, 1, settle_s=6.0, seconds=15.0)


@pytest.fixture(scope="module")
def without_pull(machine):
    """The same without electrostatic pull."""
    return cut_straight(altered(machine, {PULL: 1e-6}), 20.0, 1, settle_s=6.0, seconds=15.0)


@pytest.fixture(scope="module")
def tall():
    """Cuts of 40 mm by the size of debris, from almost none to coarse, which only weak jets carry off.

    Particles ignite the gap, but do not bridge it.
    """
    thick = altered(Machine.load(height_mm=40.0), LOADED | UNBRIDGED)
    return {
        size: cut_straight(altered(thick, {PARTICLES: size}), 12.0, 1, settle_s=8.0, seconds=20.0)
        for size in SIZES
    }


# --- the set-up of the measurements ---


@pytest.mark.parametrize("gap", [20.0, 35.0])
def test_the_kerf_of_an_untouched_slot_is_wire_and_two_gaps(gap, machine):  # T-14
    plant = begin(altered(machine, {"material.removal_mm3_J": 1e-15}), 1, gap_um=gap)
    window = plant.advance()
    slot = Cut(plant, [window], CENTRE_X_UM - 250.0, 250.0)
    np.testing.assert_allclose(slot.kerf_um, 250.0 + 2 * gap, atol=1.0)


@pytest.mark.parametrize("generator", ["iso-pulse", "iso-energetic"])
def test_a_traverse_travels_at_its_feed_whatever_the_period(generator):
    plant = begin(Machine.load(generator=generator), 1, gap_um=200.0)
    traverse = Traverse(plant, 37.0)
    windows = traverse.run(2.0)
    seconds = sum(w.duration_ns for w in windows) * 1e-9
    assert plant.commanded_um[0] - CENTRE_X_UM == pytest.approx(37.0 * seconds, abs=2.0)


@pytest.mark.slow
def test_the_fast_resolution_tells_the_same(usual, without_pull, machine):
    """Results at `fast` equal those at `default`; the lag agrees within a tenth of the effects of pull and push."""
    fine = cut_straight(machine, 20.0, 1, settle_s=6.0, seconds=15.0, resolution="default")
    assert fine.kerf_um.mean() == pytest.approx(usual.kerf_um.mean(), rel=0.01)
    fast_us, fine_us = (  # the delay of one seed is known only to 1 %
        np.mean([one.mean_delay_us] + [
            cut_straight(machine, 20.0, seed, settle_s=6.0, seconds=15.0, resolution=name).mean_delay_us
            for seed in (2, 3, 4)
        ])
        for one, name in ((usual, "fast"), (fine, "default"))
    )  # fmt: skip
    assert fine_us == pytest.approx(fast_us, rel=0.03)
    assert fine.share("open") == pytest.approx(usual.share("open"), abs=0.02)
    assert fine.share("short") == pytest.approx(usual.share("short"), abs=0.02)
    assert fine.lag_um == pytest.approx(usual.lag_um, abs=0.1 * (without_pull.lag_um - usual.lag_um))
    assert fine.vibration_um == pytest.approx(usual.vibration_um, rel=0.1)


# --- where discharges fall ---


@pytest.mark.slow
def test_discharges_fade_out_round_the_wire(machine):
    """Many in front, few at the sides, almost none behind: from ignition rates alone, without a set side gap."""
    plant = begin(machine, 1)
    traverse = Traverse(plant, 20.0)
    traverse.run(8.0)
    rays = plant.resolution.rays
    eighths = np.zeros(8)
    for _ in range(2500):
        window = traverse.window()
        if window.spark + window.arc:
            ray = int(plant.snapshot()["state"]["last_ray"][0])
            eighths[int(8 * min(ray, rays - ray) / (rays // 2 + 1))] += 1
    ahead, aslant, lateral, behind = eighths.reshape(4, 2).sum(axis=1)
    assert ahead > aslant > 5 * lateral > 0
    assert behind < 0.005 * eighths.sum()
    assert eighths[4] > eighths[5]


# --- the kerf ---


def test_a_slow_cut_is_wider(machine, usual):
    slow = cut_straight(machine, 10.0, 1, settle_s=12.0, seconds=25.0)
    assert slow.kerf_um.mean() > usual.kerf_um.mean() + 10.0


def test_secondary_discharges_on_debris_widen_the_kerf(tall):
    widths = [tall[size].kerf_um.mean() for size in SIZES]
    assert widths[0] + 3.0 < widths[1] < widths[2] - 3.0


def test_the_kerf_bulges_where_debris_gathers(tall):
    """Drum shape: the middle is widest, because both jets come to rest there; without debris the kerf is straight."""
    bulge = [drum_um(tall[size]) for size in SIZES]
    assert abs(bulge[0]) < 4.0
    assert bulge[1] > 3.0
    assert bulge[2] > 2 * bulge[1]


def test_the_kerf_does_not_taper(tall):
    """The model's two jets are equal, and heat carried down by the running wire does not change the gap."""
    for cut in tall.values():
        assert abs(cut.kerf_um[-1] - cut.kerf_um[0]) < 4.0


# --- shorts and lag ---


@pytest.fixture(scope="module")
def still(machine):
    """The same without pull and push: only jets deflect the wire, and their load is constant."""
    return cut_straight(altered(machine, {PULL: 1e-6, **NO_PUSH}), 20.0, 1, settle_s=6.0, seconds=15.0)


def test_pull_and_push_shake_the_wire(usual, without_pull, still):
    """The pull draws the wire to the wall between discharges, which push it back."""
    assert usual.vibration_um > without_pull.vibration_um > 5 * still.vibration_um


def test_shorts_at_a_moderate_feed_are_particles_that_find_others(machine, usual, still):
    """A wire that does not vibrate has as many shorts; without chains of particles there are almost none."""
    unbridged = cut_straight(altered(machine, UNBRIDGED), 20.0, 1, settle_s=6.0, seconds=15.0)
    assert unbridged.share("short") < 0.05 * usual.share("short")
    assert usual.share("short") > 0.01
    assert still.share("short") == pytest.approx(usual.share("short"), rel=0.15)


def test_where_debris_gathers_chains_of_particles_short_a_cut_out():
    """The same cut of 40 mm continues if particles do not bridge the gap."""
    thick = altered(Machine.load(height_mm=40.0), LOADED)
    jammed, free = (cut_straight(m, 12.0, 1, settle_s=8.0, seconds=5.0) for m in (thick, altered(thick, UNBRIDGED)))
    assert jammed.share("short") > 0.5
    assert free.share("short") < 0.01


@pytest.mark.slow
def test_the_wire_leads_by_its_pull_and_lags_by_its_discharges_and_jets(machine, usual, without_pull, still):  # T-14
    """At the default setting both effects are similar, so the sign depends on the impulse within its range."""
    low, high = machine.base.discharge.impulse_10mJ_Ns.range
    lags = [
        cut_straight(altered(machine, push), 20.0, 1, settle_s=6.0, seconds=15.0).lag_um
        for push in (NO_PUSH, {IMPULSE: low}, {IMPULSE: high}, {**NO_PUSH, **NO_JETS})
    ]
    assert lags[0] < lags[1] < 0.0 < usual.lag_um < lags[2] < without_pull.lag_um
    assert without_pull.lag_um > still.lag_um > 0.5  # by jets alone
    assert lags[3] < -1.0
    assert lags[0] - lags[3] == pytest.approx(still.lag_um, rel=0.1)


@pytest.mark.slow
def test_the_wire_lags_the_more_the_faster_it_is_fed(machine, usual):
    """More discharges push the wire, and harder, because the metal is nearer."""
    lags = [cut_straight(machine, feed, 1, settle_s=8.0, seconds=15.0).lag_um for feed in (10.0, 28.0)]
    assert lags[0] < usual.lag_um < lags[1]


# --- the corner ---


@pytest.mark.slow
def test_the_force_turns_with_the_place_of_the_discharges():
    """After a corner the deflection turns from the old direction to the new one while the new front is cut."""
    observed = []
    corner = cut_corner(corner_rig(8.0), 1, lambda deflection, past: observed.append((past, *deflection)))
    past, x, y = np.array(observed).T
    before, after = past == 0, past == 1
    straight = slice(-200, None)
    lag = corner.lag_um
    assert np.mean(x[before][straight]) == pytest.approx(-lag, rel=0.05)
    assert abs(np.mean(y[before][straight])) < 0.05 * lag
    turned = x[after], y[after]
    fifths = [[float(part.mean()) for part in np.array_split(column, 5)] for column in turned]
    assert sorted(fifths[0]) == fifths[0]  # the deflection in the old direction decays
    assert sorted(fifths[1], reverse=True) == fifths[1]  # and that in the new direction grows
    assert fifths[1][-1] == pytest.approx(-lag, rel=0.15)
    assert abs(fifths[0][-1]) < 0.25 * lag
    assert 5 * lag < min(BEFORE_UM, AFTER_UM)
    assert 0.48 * lag < corner.farthest_um < corner.nearest_um  # inside the corner; 0.482 of the lag by pursuit


@pytest.mark.slow
def test_a_wire_that_leads_runs_on_beyond_the_corner():
    """Discharges and jets do not push it back, and particles do not keep it away from the metal that attracts it."""
    machine = altered(Machine.load(height_mm=15.0), {**NO_PUSH, **NO_JETS, PARTICLES: 0.001}).with_(tension=5.0)
    corners = [cut_corner(machine, seed, feed=make("counts")) for seed in (1, 2, 3)]
    lag, farthest, nearest = np.mean([(c.lag_um, c.farthest_um, c.nearest_um) for c in corners], axis=0)
    assert lag < -3.0
    assert farthest == pytest.approx(-lag, rel=0.2)
    assert nearest < 1.0  # it passes through the corner


# --- rupture ---


def test_the_wire_breaks_where_steam_keeps_the_water_off():
    """Boiling keeps a slice near the boiling point until the critical flux is exceeded and it runs away."""
    broken = 0
    for seed in (1, 2, 3):
        plant = begin(sato_rig(60.0).with_(flushing_lower_Pa=2e4, flushing_upper_Pa=2e4), seed)
        plant.set_generator(1.4, 9.0)
        last = Traverse(plant, make("counts")).run(2.0)[-1]
        if last.broken:
            broken += 1
            temperature = plant.snapshot()["temperature_K"]
            hottest = int(plant.broken_height_mm / 60.0 * len(temperature))
            assert temperature[hottest] > BOILING_K + 30.0
            assert temperature.max() - temperature[hottest] < 30.0  # the heat of a spot may add the difference
    assert broken


@pytest.mark.slow
def test_favourable_constants_within_their_ranges_hold_all_that_the_gap_takes():
    """With the usual constants the wire breaks; with these it holds at the shortest pauses, as if unbreakable."""
    favourable = {
        "base.cooling.critical_W_m2": 1e7, "base.cooling.critical_stream": 9e4, "base.cooling.convection_W_m2K": 3e4,
        "base.dielectric.wake_mm": 6.0,
    }  # fmt: skip
    ends, currents = [], []
    for changes in ({}, favourable, UNBREAKABLE):
        servo = from_text(quick_counts(HELD_SHARE))
        held, end = shorten_pauses(sato_rig(80.0, changes), 1, servo, hold_s=HOLD_S, approach_s=APPROACH_S)
        ends.append(end)
        currents.append(max(step.current_A for step in held))
    assert ends == ["break", "generator", "generator"]
    assert currents[0] < currents[1]
    assert currents[1] == pytest.approx(currents[2], rel=0.05)


@pytest.mark.slow
def test_a_hotter_wire_breaks_at_less_current():
    limits = [
        break_limit_A(sato_rig(40.0, {"base.cooling.wire_heat_share": share}), 1) for share in (0.1, 0.2, 0.3)
    ]
    assert sorted(limits, reverse=True) == limits
    assert all(math.isfinite(limit) and limit > 0 for limit in limits)
