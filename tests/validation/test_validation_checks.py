"""Checks that can fail: what they measure responds to the physics they are about."""

import csv
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from edmsim import models
from edmsim.errors import InputError
from edmsim.machine.machine import Machine
from edmsim.metrology.profile import PROFILE_STEP_MM
from edmsim.plant.constants import gap_law
from edmsim.plant.gap.generator import timing
from edmsim.plant.gap.water import flow_speed_m_s
from edmsim.plant.resolution import resolution
from edmsim.validation import closed_forms, cuts, discharges, lag, passes, setups, spread, stable_rate
from edmsim.validation.breakage import rough_rig
from edmsim.validation.rows import extended
from edmsim.validation.setups import FRAIL, STILL, altered, in_a_hole, single_discharges

SHARED = Path(__file__).parents[3] / "shared" / "data"
TABLES = sorted((models.path("agiecut_dem15.xml").parent / "published").glob("*.csv"))


QUICK = {
    closed_forms.check_electrostatic_pull, closed_forms.check_joule_heat, closed_forms.check_joule_shares,
    closed_forms.check_cooling, closed_forms.check_spark_heat, closed_forms.check_boiling,
}  # fmt: skip


def failing(rows):
    return [row.name for row in rows if not row.passed]


@pytest.mark.parametrize("name", [path.stem for path in TABLES])
def test_published_tables_have_their_source_and_are_copies(name):
    file = models.path(f"published/{name}.csv")
    text = file.read_text(encoding="utf-8")
    assert text.startswith("# source: ")
    rows = models.published(name)
    assert len(rows) == sum(not line.startswith("#") for line in text.splitlines()) - 1
    if SHARED.is_dir():
        assert text == (SHARED / file.name).read_text(encoding="utf-8")
    assert rows == list(csv.DictReader([line for line in text.splitlines() if not line.startswith("#")]))


def test_a_table_that_is_none_is_reported():
    with pytest.raises(InputError, match=r"no data file 'published/none\.csv'"):
        models.published("none")


# --- ignition ---


def test_a_window_of_a_frail_wire_ends_with_its_first_discharge():
    machine = altered(Machine.load(height_mm=5.0, t_on_us=20.0), {**STILL, **FRAIL})
    windows = single_discharges(in_a_hole(machine, 12.0, seed=3), 100)
    for window in windows:
        assert window.spark + window.arc <= 1
        assert window.spark == window.broken == (window.pulses < 255 or window.broken)
    assert sum(window.spark for window in windows) > 90


def test_the_mean_gap_that_rays_see_is_the_one_requested():
    machine = altered(Machine.load(height_mm=5.0), STILL)
    for gap in (8.0, 12.5, 30.0):
        plant = discharges.isolated_gap(machine, gap, seed=1)
        plant.advance()
        assert discharges.ray_gaps_um(plant).mean() == pytest.approx(gap, abs=0.1)


def test_the_claimed_mixture_is_a_distribution_with_the_published_median():
    gap = Machine.load().base.gap
    times = np.linspace(0.0, 3_000.0, 30_001)
    share = discharges.mixture(times, np.full(10, 20.0), gap)
    assert share[0] < 1e-6
    assert (np.diff(share) >= 0).all()
    assert share[-1] > 0.9999
    assert times[np.searchsorted(share, 0.5)] == pytest.approx(132.25 + gap.formative_us.value, abs=0.2)


def test_the_share_of_short_delays_is_that_of_the_mixture():
    draw = np.random.default_rng(4)
    long = draw.exponential(66.7 / math.log(2), 40_000)
    mixed = np.where(draw.random(40_000) < 0.3, draw.exponential(1.5, 40_000), long)
    share, half = discharges.short_share(15.0, mixed)
    assert share == pytest.approx(0.3, abs=half + 0.001)
    assert discharges.short_share(15.0, long)[0] == pytest.approx(0.0, abs=0.01)


def test_the_median_s_interval_holds_it_19_times_in_20():
    draw = np.random.default_rng(5)
    found = [discharges.median_and_interval(draw.exponential(1.0, 400)) for _ in range(2_000)]
    assert 0.93 < np.mean([abs(median - math.log(2)) <= half for median, half in found]) < 0.97


def test_delays_longer_than_claimed_are_observed():
    delays = np.random.default_rng(6).exponential(1.1 * 132.25 / math.log(2), 8_000)
    row = discharges._mixture_row(20.0, delays + 0.2, np.full(10, 20.0))
    assert not row.passed
    fitting = np.random.default_rng(6).exponential(132.25 / math.log(2), 8_000)
    assert discharges._mixture_row(20.0, fitting + 0.2, np.full(10, 20.0)).passed


def test_the_flow_s_pressure_gives_its_mean_speed():
    machine = Machine.load(height_mm=30.0)
    water_ = machine.base.dielectric
    nozzle = flow_speed_m_s(
        discharges.pressure_Pa(machine, 3.0), water_.viscosity_Pa_s.value, water_.side_gap_um.value, 15.0
    )
    assert nozzle / 2 == pytest.approx(3.0)  # linear from the nozzle to nothing at mid-height


def test_the_flow_carries_off_the_debris_that_discharges_leave():
    still, slow, quick = (cuts.in_debris(speed, 1)[-1] for speed in cuts.SPEEDS_M_S)
    assert still.debris > 5 * slow.debris > 5 * quick.debris > 0.0
    for window in (still, slow, quick):
        assert abs(window.gap_um - cuts.HOLE_UM) < 2.0


def test_shorts_have_no_delay_and_an_open_pulse_has_the_on_time():
    window = cuts.in_debris(2.0, 2)[-1]
    assert window.short == 0
    pulses = window.spark + window.arc
    mean = (pulses * window.mean_delay_us + discharges.THESIS_ON_US * window.open) / (pulses + window.open)
    assert discharges.mean_delay_us([window]) == pytest.approx(mean)
    assert discharges.mean_delay_us([window._replace(short=45)]) == pytest.approx(mean)
    nothing = window._replace(short=255, open=0, spark=0, arc=0, mean_delay_us=math.nan)
    assert math.isnan(discharges.mean_delay_us([nothing]))


def test_the_jets_flush_out_half_of_a_thin_loading_and_less_of_a_thick_one():
    thin, some, much = (cuts.flushed_share(loading) for loading in (1e-4, *cuts.LOADINGS))
    assert thin == pytest.approx(0.5, abs=0.02)
    assert thin > some > much
    at_first = (1 + 2.5 * cuts.LOADINGS[0]) / (1 + 2.5 * cuts.LOADINGS[1])  # Einstein's viscosities
    assert at_first < much / some < 1.0


def test_a_loaded_hole_has_the_debris_of_the_default_cut_and_keeps_it():
    machine = cuts.loaded_machine()
    size_um = gap_law(machine, resolution("fast"), cuts.HOLE_V).particle_um
    assert size_um == pytest.approx(cuts.mean_size_um(altered(Machine.load(), {"generator.open_voltage_V": 80.0})))
    plant = in_a_hole(machine, 20.0, 1)
    state = plant.snapshot()
    state["debris"][: plant.resolution.slices] = 1e-3
    plant.restore(state)
    window = plant.advance()
    assert window.spark > 100
    assert window.debris == pytest.approx(1e-3, rel=1e-6)


def test_particles_that_ignite_are_counted_by_the_pulses_that_find_none():
    few, many = (cuts.counted(cuts.NEAR_UM, factor * cuts.NEAR_SHARE, 1) for factor in (0.5, 2.0))
    assert few == pytest.approx(many, rel=0.1)  # over the law's, whatever the debris


# --- set-ups of rows on debris, rates and resolutions ---


@pytest.mark.parametrize(
    ("energy_mJ", "t_on_us"),
    [(cuts.FINE_MJ, cuts.FINE_ON_US), (cuts.COARSE_MJ, cuts.COARSE_ON_US)],
)
def test_slots_are_cut_with_the_pulses_that_are_said(energy_mJ, t_on_us):
    machine = cuts.slot_rig(energy_mJ, t_on_us)
    assert timing(machine).open_V == cuts.SIDE_V
    sparks = altered(machine, {"material.removal_mm3_J": 1e-15, "base.gap.deionisation_us": 1e-3})  # arcs are shorter
    window = in_a_hole(sparks, 10.0, seed=1).advance()
    assert window.spark > 20 > window.arc == 0
    assert window.energy_J / window.spark == pytest.approx(energy_mJ * 1e-3, rel=0.05)


def test_a_slot_that_is_not_cut_in_time_has_no_side_gap(monkeypatch):
    monkeypatch.setattr(cuts, "LONGEST_S", 0.05)
    assert math.isnan(cuts.side_gap_um(cuts.slot_rig(cuts.COARSE_MJ, cuts.COARSE_ON_US), 1))


def test_a_longer_on_time_keeps_peak_and_pause():
    brief, long = (setups.with_on_time(rough_rig(30.0), on) for on in (cuts.BRIEF_US, cuts.LONG_US))
    assert brief.t_period_us - brief.t_on_us == pytest.approx(long.t_period_us - long.t_on_us)
    assert brief.resistance_ohm == long.resistance_ohm


def test_a_wire_of_a_tenth_gets_weaker_pulses_and_holds_its_tension():
    machine = stable_rate.thin_rig(10.0, stable_rate.THIN_PEAKS_A[-1])
    area_mm2 = math.pi / 4 * 0.1**2
    assert machine.wire_diameter_um == 100.0
    assert 0.4 < stable_rate.THIN_N / area_mm2 / machine.wire.strength_MPa.value < 0.6
    assert machine.t_on_us == stable_rate.THIN_ON_US


def test_rates_are_found_for_every_seed_by_itself(monkeypatch):
    requests = []

    def search(machine, *, seeds, **_):
        requests.append(seeds)
        return SimpleNamespace(rate_mm2_min=seeds[0])

    monkeypatch.setattr(stable_rate, "highest_stable_rate", search)
    assert stable_rate.rates_mm2_min(stable_rate.preset(40.0), (3, 5)) == [3, 5]
    assert requests == [(3,), (5,)]


@pytest.mark.parametrize(
    ("fine", "coarse", "passed"),
    [((0.03, 0.032), (0.039, 0.041), True), ((0.03, 0.032), (0.044, 0.046), False), ((0.3, 0.31), (0.32, 0.33), True),
     ((0.3, 0.31), (0.36, 0.37), False), ((0.3, 0.3), (0.2, 0.4), False)],
)  # fmt: skip
def test_shorts_of_two_resolutions_agree_within_a_tenth_or_a_hundredth(fine, coarse, passed):
    figure = spread.FIGURES[0]._replace(of=lambda share: share)
    assert spread._against_fine(figure, "fast", coarse, fine).passed is passed


# --- the other checks: all rows that are exact pass, and those that cannot are named ---


@pytest.mark.parametrize("check", [
    pytest.param(check, id=check.__name__, marks=() if check in QUICK else pytest.mark.slow)
    for check in closed_forms.CHECKS
])  # fmt: skip
def test_closed_forms_hold(check):
    assert failing(check((1, 2, 3))) == []


@pytest.mark.parametrize(("wave_mm", "left"), [(0.2, 0.0), (passes.CUTOFF_MM, 0.5), (8.0, 0.993)])
def test_an_edge_without_roughness_has_half_of_a_wave_of_the_cut_off(wave_mm, left):
    along_mm = np.arange(0.0, 24.0, PROFILE_STEP_MM)
    wave = np.sin(2 * np.pi * along_mm / wave_mm)
    found = passes.without_roughness(np.stack([wave, wave + 3.0]))[:, 400:800]
    assert found.max(axis=1) == pytest.approx([left, left + 3.0], abs=0.002)


def test_a_row_with_more_seeds_begins_with_those_of_all():
    assert list(extended((3, 4), 4)) == [3, 4, 5, 6]
    assert list(extended((), 4)) == []


def test_a_heavier_wire_has_another_frequency():
    assert closed_forms.frequencies_Hz(80.0)[0] < closed_forms.frequencies_Hz(40.0)[0] / 1.9


def test_a_fixed_feed_above_the_capacity_is_lowered_by_one_rule(monkeypatch):
    monkeypatch.setattr(setups, "capacity_um_s", lambda machine: 1.5 * machine.height_mm)
    low, high = Machine.load(height_mm=10.0), Machine.load(height_mm=20.0)
    assert setups.feed_within(20.0, high) == 20.0
    assert setups.feed_within(30.0, high) == pytest.approx(0.85 * 30.0)
    assert setups.feed_within(30.0, high, low) == pytest.approx(0.85 * 15.0)


def test_the_crossing_lies_where_the_deflection_turns():
    assert lag.crossing_mJ([2.0, 1.0, -1.0, -2.0, -3.0]) == pytest.approx(math.sqrt(0.1 * 0.3))
    assert math.isinf(lag.crossing_mJ([2.0, 1.0, 0.5, 0.2, 0.1]))


def test_the_duration_fitted_to_a_crater_gives_its_volume():
    duration = discharges.fitted_duration_us()
    machine = Machine.load(generator="iso-energetic", t_on_us=1.0).model_copy(update={"t_on_us": duration})
    energy_J = machine.material.burning_voltage_V.value * 110.0 * duration * 1e-6
    assert timing(machine).removal_um3_J * energy_J == pytest.approx(6219.27, rel=1e-3)


def test_crater_shapes_agree():
    rows = discharges.check_shape(())
    assert len(rows) == 18
    assert failing(rows) == []
    assert [row.name for row in rows if "misprints 8.265" in row.source] == ["depth of a crater of 59550 um3 (425 A)"]


def test_one_printed_depth_contradicts_its_area_its_volume_and_all_others():
    printed = np.array([float(row["depth_um"]) for row in models.published("crater_single_discharge_eth")])
    area, depth = np.array([(one.area, one.depth) for one in discharges.published_craters()]).T
    assert printed[:-1] == pytest.approx(depth[:-1], abs=1e-6)
    assert printed[-1] == pytest.approx(depth[-1] - 2.0, abs=1e-4)
    line = np.polyfit(area[:-1], printed[:-1], 1)
    assert np.polyval(line, area) == pytest.approx(depth, abs=1e-4)


def test_single_craters_follow_energy_and_scatter_as_drawn():
    found = discharges.craters_um3(110.0, discharges.fitted_duration_us(), (1, 2))
    volumes = np.concatenate(found)
    assert len(volumes) > 1.9 * discharges.DISCHARGES
    assert volumes.mean() == pytest.approx(6219.27, rel=0.05)
    assert volumes.std() / volumes.mean() == pytest.approx(0.21, abs=0.03)
