"""The plant from outside: windows of 255 pulses while the wire is fed, forced into metal, withdrawn or stepped."""

import math

import numpy as np
import pytest

import edmsim
from edmsim.machine.setting import discharge_current_A
from edmsim.plant.constants import modal_model, push_law
from edmsim.plant.gap.gas import bubble_impulse_Ns
from edmsim.plant.resolution import resolution
from edmsim.plant.window import NotFiniteError, PlantError, WireInMetalError, WireLostError
from tests.plant.oscillators import propagator_table

FEEDS_UM_S = (10.0, 20.0, 28.0, 34.0)


@pytest.fixture(scope="module")
def settled(machine, drive):
    """Last two seconds of twelve, for each fixed feed on 20 mm of tool steel."""
    last = {}
    for feed in FEEDS_UM_S:
        windows = drive(edmsim.Plant(machine, seed=1, resolution="fast"), feed, 12.0)
        last[feed] = windows[-80:]
    return last


def test_faster_feed_closes_the_gap(settled, share):
    opens = [share(settled[feed], "open") for feed in FEEDS_UM_S]
    shorts = [share(settled[feed], "short") for feed in FEEDS_UM_S]
    gaps = [np.nanmean([w.gap_um for w in settled[feed]]) for feed in FEEDS_UM_S]
    volts = [np.mean([w.mean_voltage_V for w in settled[feed]]) for feed in FEEDS_UM_S]
    delays = [np.nanmean([w.mean_delay_us for w in settled[feed]]) for feed in FEEDS_UM_S]
    for falling in (opens, gaps, volts, delays):
        assert sorted(falling, reverse=True) == falling
    assert sorted(shorts) == shorts
    assert shorts[0] < 0.02 < shorts[-1]
    assert opens[-1] < 0.5 < opens[0]
    assert 5.0 < gaps[-1] < gaps[0] < 40.0


def test_what_is_removed_follows_the_feed(machine, settled):
    """In a steady cut the volume per second is feed times height times kerf width."""
    for feed in FEEDS_UM_S[1:3]:
        windows = settled[feed]
        seconds = sum(w.duration_ns for w in windows) * 1e-9
        width_um = sum(w.crater_um3 for w in windows) / seconds / feed / 20_000.0
        assert 250.0 < width_um < 250.0 + 2 * 60.0


def test_means_of_a_window_lie_between_their_bounds(settled):
    for windows in settled.values():
        for w in windows:
            assert w.pulses == 255
            assert 0.0 <= w.mean_voltage_V <= 100.0 * 0.3
            assert 0.0 <= w.mean_current_A <= 100.0 / 11.8 * 0.3 + 1e-9
            assert 293.0 <= w.wire_temperature_K < 450.0
            assert not w.broken
            assert w.vibration2_um2 >= 0.0
            assert 0.0 <= w.debris < 1.0
            assert 0.0 <= w.coverage < 1.0
            assert w.crater_um3 >= 0.0
            assert (w.spark + w.arc == 0) == math.isnan(w.mean_delay_us) == math.isnan(w.gap_um)


def test_discharges_are_located_in_every_fifth_of_the_height(settled):
    windows = [w for of_a_feed in settled.values() for w in of_a_feed]
    located = np.sum([w.fifths for w in windows], axis=0)
    assert located.sum() == sum(w.spark + w.arc for w in windows)
    assert (located > 0.1 * located.sum()).all()


def test_sparks_push_the_wire_back_as_a_string_under_their_impulses(machine, altered, drive):
    """Without electrostatic pull the wire lags: impulses per second over tension, ``F/T (c/2 + h/12)``.

    The impulse is the bubble's where liquid fills the slit, times the share of the front that is wet. Its value
    at the mean gap is a little below its mean, and sparks off the middle also push sideways.
    """
    neutral = altered(machine, {"base.dielectric.permittivity": 1e-6})
    windows = drive(edmsim.Plant(neutral, seed=1, resolution="fast"), 20.0, 8.0)[-100:]
    seconds = sum(w.duration_ns for w in windows) * 1e-9
    sparks = sum(w.spark for w in windows)
    power_W = 22.0 * discharge_current_A(neutral)
    burn_us = sum(w.energy_J for w in windows) / sparks / power_W * 1e6
    gap_um, covered = (np.nanmean([getattr(w, name) for w in windows]) for name in ("gap_um", "coverage"))
    impulse_Ns = bubble_impulse_Ns(power_W, burn_us, gap_um, push_law(neutral)) * (1 - covered)
    force_N = sparks / seconds * impulse_Ns
    straight_on_um = force_N / machine.tension * (10e-3 / 2 + 20e-3 / 12) * 1e6
    lag_um = -np.mean([w.deflection_um[0] for w in windows])
    assert lag_um == pytest.approx(straight_on_um, rel=0.15)
    assert abs(np.mean([w.deflection_um[1] for w in windows])) < 0.5 * lag_um


def test_a_short_that_melts_metal_pushes_the_wire_off(in_a_hole, machine):
    """By a share of the push of a bubble of that energy at 20 um; there is no film to slow the wire here."""
    speeds = []
    for share in (0.0, 0.3, 0.6):
        pushed = {"base.discharge.impulse_10mJ_Ns": 4.3e-6, "base.discharge.bubble_share": 0.04,
                  "base.dielectric.viscosity_Pa_s": 1e-12, "base.dielectric.edge_loss": 0.0,
                  "base.gap.contact_um": 8.0}  # fmt: skip
        plant = in_a_hole(machine, 5.0, **pushed, **{"base.discharge.short_push_share": share})
        assert plant.advance_pulse().short == 1
        speeds.append(float(np.abs(plant.snapshot()["wire_v"]).max()))
    assert speeds[0] < 1e-3 * speeds[1]
    assert speeds[2] == pytest.approx(2 * speeds[1], rel=0.05)


# --- no metal, only metal, and water between ---


def test_without_metal_every_pulse_is_open(in_a_hole, machine):  # T-7
    plant = in_a_hole(machine, 300.0, still=False)
    for _ in range(3):
        window = plant.advance()
        assert (window.open, window.short, window.spark, window.arc) == (255, 0, 0, 0)
        assert window.mean_voltage_V == pytest.approx(100.0 * 30.0 / 100.0)
        assert window.mean_current_A == window.energy_J == window.crater_um3 == 0.0
        assert np.abs(window.deflection_um).max() < 1e-9
        assert window.wire_temperature_K == 293.0
    assert plant.removed_mm3 == 0.0


def test_a_wire_forced_into_the_metal_shorts_until_it_is_withdrawn(machine, drive, share):  # T-7
    plant = edmsim.Plant(machine, seed=1, resolution="fast")
    pressed = drive(plant, 300.0, 1.0)[-10:]
    assert share(pressed, "short") > 0.98  # the push of melting metal may lift it off for a pulse
    for w in pressed:
        assert w.mean_voltage_V < 0.2
        assert w.mean_current_A == pytest.approx(100.0 / 11.8 * 0.3, rel=0.02)
        assert w.deflection_um[0] < -50.0  # the wire lags behind the table
    assert sum(w.crater_um3 for w in pressed) > 0.0  # the current melts metal at the contact
    clear = drive(plant, -300.0, 1.2)[-5:]
    assert share(clear, "short") == 0.0
    assert share(clear, "open") > 0.9
    assert plant.removed_mm3 == pytest.approx(plant.craters_mm3, rel=1e-9)


@pytest.mark.parametrize(("gap", "conductivity"), [(20.0, 10.0), (20.0, 100.0), (40.0, 100.0)])
def test_conducting_water_takes_voltage_from_an_open_gap(gap, conductivity, in_a_hole, machine):
    """Voltage divider of the series resistor and the water: G = sigma x girth x height / gap."""
    plant = in_a_hole(
        machine.with_(t_on_us=1.0, t_period_us=100.0), gap, resolution="default",
        **{"base.dielectric.conductivity_uS_cm": conductivity},
    )
    siemens = conductivity * 1e-4 * math.pi * 250e-6 * 20e-3 / (gap * 1e-6)
    for _ in range(5):
        w = plant.advance()
        delays_us = w.mean_delay_us * w.spark if w.spark else 0.0
        burning = 22.0 * (w.spark - delays_us)  # volt times us, of on-times of 1 us
        open_V = (w.mean_voltage_V * w.duration_ns * 1e-3 - burning) / (w.open + delays_us)
        assert open_V == pytest.approx(100.0 / (1 + 11.8 * siemens), rel=0.01)


# --- the table ---


def far(machine):
    """Return a plant without metal near its wire."""
    stock = edmsim.plant.workpiece.kerf_field.Stock((60_000.0, 60_000.0, 61_000.0, 61_000.0))
    return edmsim.Plant(machine, 1, stock=stock, position_um=(10_000.0, 20_000.0), resolution="fast")


def test_steps_move_the_commanded_position_by_two_um(machine):  # T-16
    plant = far(machine)
    plant.advance([(1_000_000, 0, 1), (2_000_000, 0, 1), (3_000_000, 1, -1)])
    assert plant.commanded_um == (10_004.0, 19_998.0)
    plant.advance(np.array([(plant.time_ns + 1_000_000, 0, 1)], np.int32))
    assert plant.commanded_um == (10_006.0, 19_998.0)


def test_a_step_at_the_end_of_a_window_belongs_to_the_next(machine):
    plant = far(machine)
    end = plant.window_ns
    plant.advance([(end - 1, 0, 1), (end, 0, 1)])
    assert plant.commanded_um[0] == 10_002.0
    plant.advance([(end, 0, 1)])
    assert plant.commanded_um[0] == 10_004.0


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("at_us", [0, 3_000, 12_345, 25_100, 25_499])
def test_the_table_rings_from_the_step_on_as_its_modes_do(at_us, axis, machine):
    plant = far(machine)
    plant.advance([(at_us * 1_000, axis, 1)])
    modes = modal_model(machine, resolution("fast"))
    ringing_s = np.array([25_500 - at_us]) * 1e-6
    p11, _, p21, _ = propagator_table(modes.table_omega[axis], modes.table_zeta[axis], ringing_s)
    start = -2.0 * modes.table_participation[axis]
    after = plant.snapshot()
    np.testing.assert_allclose(after["table_q"][axis], start * p11[0], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(after["table_v"][axis], start * p21[0], rtol=1e-6, atol=1e-6)
    assert (after["table_q"][1 - axis] == 0.0).all()


def test_the_bare_wire_hangs_straight_and_leans_to_metal_nearby(machine, altered):
    """The open voltage pulls the wire towards the metal in front of it."""
    quiet = altered(machine, {"base.discharge.impulse_10mJ_Ns": 0.0, "base.discharge.bubble_share": 1e-12})
    plant = edmsim.Plant(quiet.with_(t_on_us=20.0, t_period_us=100.0), 1, resolution="fast")
    windows = [plant.advance() for _ in range(10)]
    lean = np.mean([w.deflection_um[0] for w in windows])
    assert 0.0 < lean < 5.0
    assert np.abs(plant.deflections_um()[:, 1]).max() < 0.1 * lean


def message_of(machine, change, kind):
    """Advance a plant whose state is modified by `change`; return the error's message."""
    plant = far(machine)
    plant.advance()
    state = plant.snapshot()
    change(state)
    plant.restore(state)
    with pytest.raises(kind) as caught:
        plant.advance()
    assert 0.0255 < caught.value.time_s <= 0.0511
    assert caught.value.place_um == (10_000.0, 20_000.0)
    assert 0 < caught.value.window.pulses <= 255
    assert f"{caught.value.time_s:.4f} s of machine time, x 10.000 y 20.000 mm" in str(caught.value)
    return caught.value


def test_a_wire_that_leaves_its_guides_is_reported(machine):
    """A wire bent by metres is an error, which says when, where, and describes the window."""

    def bend(state):
        state["wire_q"][0, 0] = 1e9

    error = message_of(machine, bend, WireLostError)
    assert "the wire left its guides" in str(error)
    assert error.window.deflection_um[0] > 1e6
    assert isinstance(error, PlantError)


@pytest.mark.parametrize("name", ["wire_q", "wire_v", "debris", "table_q", "steam", "gas", "wake_gas"])
def test_a_number_that_becomes_none_is_reported(machine, name):
    def spoil(state):
        state[name].flat[0] = 1e300

    assert "not finite" in str(message_of(machine, spoil, NotFiniteError))


def test_a_wire_inside_the_metal_is_reported(machine):
    """A wire surrounded by metal cannot move out of it."""
    plant = edmsim.Plant(machine, 1, resolution="fast")
    state = plant.snapshot()
    state["state"]["axis_um"][0, 0] += 1_000.0
    plant.restore(state)
    with pytest.raises(WireInMetalError, match="deeper into the metal"):
        plant.advance()


def test_a_plant_without_a_window_yet_says_so(machine):
    plant = edmsim.Plant(machine, resolution="fast")
    with pytest.raises(edmsim.InputError, match="no window yet: advance it first"):
        plant.window()
    for steps, pulses, said in ((None, 255, "steps cannot be None"), ((), 2.5, "pulses is 2.5: give a whole number")):
        with pytest.raises(edmsim.InputError, match=said):
            plant.advance(steps, pulses)
    assert plant.advance() == plant.window()
    plant.reset(2)
    with pytest.raises(edmsim.InputError, match="no window yet: advance it first"):
        plant.window()
