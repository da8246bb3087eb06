"""The example with the defaults of a preset, from the start hole on, and messages about denser pulses."""

from pathlib import Path

import pytest

import edmsim
from edmsim.job.options import CutSettings
from edmsim.job.plan import check
from edmsim.machine.setting import held_period_us

PUNCH = Path(__file__).parents[1] / "examples" / "punch.ngc"
PRODUCTION = {"machine": "production", "generator": "production"}


def cut(seconds, **options):
    return edmsim.cut(PUNCH, resolution="fast", seed=1, max_time_s=seconds, **options).report


@pytest.mark.slow
@pytest.mark.parametrize("pair", [{}, PRODUCTION], ids=["laboratory", "production"])
@pytest.mark.parametrize("height_mm", [20.0, 40.0, 80.0])
def test_the_defaults_of_a_preset_bring_the_wire_to_the_metal(pair, height_mm):
    """The first contact is over within 6 s; denser pulses than the preset's break the wire there."""
    report = cut(8.0, height_mm=height_mm, **pair)
    assert report["outcome"] == "time-limit"
    assert report["removed_mm3"] > 0
    assert report["wire"]["temperature_K_max"] < 500


@pytest.mark.slow
@pytest.mark.parametrize("height_mm", [20.0, 80.0])
def test_production_pulses_leave_the_start_hole(height_mm):
    report = cut(90.0, height_mm=height_mm, **PRODUCTION)
    assert report["outcome"] == "time-limit"
    assert report["path_length_mm"] > 1.0
    assert report["cutting_rate_mm2_min"] > 0


@pytest.mark.slow
@pytest.mark.parametrize("height_mm", [80.0, 100.0])  # it holds at 20 and 40 mm, and in the hole at 60 mm
def test_of_pulses_too_dense_the_report_says_which_period_holds(height_mm):
    report = cut(8.0, height_mm=height_mm, t_period_us=9.4, **PRODUCTION)
    assert report["outcome"] == "wire-break"
    assert report["cutting_rate_mm2_min"] is None  # the wire never left its start hole
    assert "a period of 9.4 us is too short for it; from 72 us on" in report["reason"]


def test_the_period_that_holds_goes_with_the_current_density():
    own = edmsim.Machine.load("production", generator="production")
    assert held_period_us(own) == own.t_period_us
    assert held_period_us(own.with_(t_period_us=20.0)) == pytest.approx(own.t_period_us)
    assert held_period_us(own.with_(t_on_us=0.7)) == pytest.approx(own.t_period_us / 2)
    assert held_period_us(own.with_(wire_diameter_um=200.0)) == pytest.approx(own.t_period_us * 1.25**2)
    assert held_period_us(own.with_(peak_current_A=70.0)) == pytest.approx(own.t_period_us / 10, rel=0.01)
    thin = edmsim.Machine.load("production", generator="production", wire="molybdenum")  # by default 0.1 mm
    assert held_period_us(thin) == pytest.approx(own.t_period_us * 2.5**2)


RISK = "a discharge of 10.8 mJ, followed by an arc, can break this wire at any period"


@pytest.mark.slow
def test_of_pulses_that_break_a_thin_wire_one_by_one_the_report_says_so():
    for period_us in (72.0, 1000.0):
        report = cut(20.0, height_mm=20.0, wire="brass-100", t_period_us=period_us, **PRODUCTION)
        assert report["outcome"] == "wire-break"
        assert f": {RISK}; choose a lower peak current" in report["reason"]
    weaker = cut(5.0, height_mm=20.0, wire="brass-100", peak_current_A=150.0, **PRODUCTION)
    assert weaker["outcome"] == "time-limit"


def test_a_check_foresees_pulses_that_break_a_thin_wire_one_by_one():
    for options, foreseen in (
        ({"wire": "brass-100"}, True), ({"wire": "brass-100", "peak_current_A": 150.0}, False), ({}, False),
        ({"passes": 2, "height_mm": 25.4}, False),
    ):
        notices = check(PUNCH, CutSettings(**PRODUCTION, planner="exact", **options)).path.notices
        assert any(RISK in notice for notice in notices) is foreseen
