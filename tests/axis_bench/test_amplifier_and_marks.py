"""A velocity amplifier, index marks, a home cam and a shared output on the bench: each alone, and what it changes."""

import numpy as np
import pytest

from edmsim.axis_bench import AxisBench
from edmsim.compiled.axis_rows import HOLDS_OUTPUT
from edmsim.controllers.axis.drive import axis_row
from edmsim.errors import InputError
from edmsim.plant.axes.drives import Drives
from edmsim.plant.axes.encoder import BOUNCES
from edmsim.plant.kernel.state import sizes_of
from tests.axis_bench.puppet import Puppet, command, put_out

VOLT = 2 * np.pi * 1000 / 60 / 10
"""Speed of the rotor for a volt, rad/s."""


def bench_of(axes="x", **changes):
    return AxisBench({name: Puppet(axis_row("analogue", **changes)) for name in axes})


def speed_at(volts, **changes):
    bench = bench_of(**changes)
    command(bench, volts / 10, run_s=0.5)
    return float(bench.axis()["speed_rad_s"])


@pytest.mark.parametrize(("volts", "changes", "found"), [
    (-10.0, {}, -10.0), (-3.0, {}, -3.0), (0.5, {}, 0.5), (10.0, {}, 10.0),
    (5.0, {"gain_error": 0.03}, 5.15), (-5.0, {"gain_error": 0.03}, -5.15),  # what a screwdriver has left
    (5.0, {"asymmetry": 0.02}, 5.05), (-5.0, {"asymmetry": 0.02}, -4.95),
    (5.0, {"offset_V": 0.1}, 5.1), (-5.0, {"offset_V": 0.1}, -4.9),
    (9.0, {"offset_V": 0.5}, 9.5), (10.0, {"offset_V": 0.5}, 10.0),  # the input saturates
])  # fmt: skip
def test_speed_follows_the_reference(volts, changes, found):
    assert speed_at(volts, **changes) == pytest.approx(found * VOLT, rel=2e-3)


def test_the_offset_drifts_as_it_warms_up():
    bench = bench_of(drift_V=0.2, warm_s=2.0)
    bench.run(2.0)
    assert bench.axis()["speed_rad_s"] == pytest.approx(0.2 * VOLT * (1 - np.exp(-1)), rel=0.02)


def test_at_0_V_the_axis_coasts_as_its_current_allows():
    def way(limit_A):
        bench = bench_of(limit_A=limit_A)
        command(bench, 1.0, run_s=0.5)
        command(bench, 0.0)
        begin = float(bench.axis()["place_um"])
        bench.run(0.5)
        assert abs(bench.axis()["speed_rad_s"]) < 0.01
        return float(bench.axis()["place_um"]) - begin

    assert way(1.0) > 2 * way(10.0) > 5.0


def test_a_stalled_motor_takes_the_limit_and_grows_warm():
    bench = bench_of()
    bench.hold("x", True)
    command(bench, 0.5, run_s=1.0)
    assert bench.axis()["current_A"] == pytest.approx(10.0, rel=0.02)
    assert bench.axis()["winding_K"] > 1.0
    bench.hold("x", False)
    bench.run(0.5)
    assert bench.axis()["speed_rad_s"] == pytest.approx(5.0 * VOLT, rel=1e-3)


def indexes(least_ns=0, **changes):
    bench = bench_of(index_um=100.0, index_phase_um=30.0, **changes)
    bench.drive().record["index_ns"] = least_ns
    command(bench, 1.0, run_s=0.5)
    return bench


def test_index_marks_have_place_and_width():
    bench = indexes(index_width_um=5.0)
    row, place_um = bench.axis(), float(bench.axis()["rotor_um"])
    assert row["indexes"] == (place_um - 30) // 100 + 1
    mark_um = place_um - (place_um - 30) % 100
    assert row["index_at"] == pytest.approx(mark_um * 4, abs=1)
    command(bench, 0.01)
    on = []
    for _ in range(4000):
        bench.run(0.002)
        on.append((bool(bench.axis()["index_on"]), (float(bench.axis()["rotor_um"]) - 30) % 100 < 5.0))
    levels = np.array(on)
    assert levels[:, 0].any()
    assert (levels[:, 0] == levels[:, 1]).mean() > 0.99


def test_a_mark_too_short_for_the_input_is_missed():
    assert indexes(2_000_000, index_width_um=5.0).axis()["indexes"] > 5  # 3 ms at this speed
    assert indexes(4_000_000, index_width_um=5.0).axis()["indexes"] <= 1
    bench = bench_of(index_um=100.0, index_phase_um=0.0, index_width_um=5.0)
    bench.run(0.01)
    assert bench.axis()["index_on"] == 1  # it stands on one
    bench.unplug("x", "index")
    bench.run(0.01)
    assert bench.axis()["index_on"] == 0
    command(bench, 1.0, run_s=0.5)
    assert bench.axis()["indexes"] <= 1


def edges_of(way=1.0, seconds=1.0, **cam):
    """Times (s) and levels at which the home input changes as the table passes a cam (50 to 100 um) at 167 um/s."""
    bench = bench_of()
    bench.home_cam("x", 50.0, 100.0, **cam)
    command(bench, 0.1 * way)
    found, before = [], 0
    for _ in range(round(seconds * 2000)):
        bench.run(0.0005)
        now = int(bench.axis()["home"])
        if now != before:
            found.append((float(bench.axis()["place_um"]), now))
        before = now
    return found


@pytest.mark.parametrize(
    ("cam", "on", "off"),
    [({}, 50.0, 100.0), ({"hysteresis_um": 8.0}, 50.0, 108.0), ({"filter_s": 0.03}, 55.0, 105.0)],
)
def test_a_cam_closes_and_opens_at_its_ends(cam, on, off):
    (closes, up), (opens, down) = edges_of(**cam)
    assert (up, down) == (1, 0)
    assert (closes, opens) == (pytest.approx(on, abs=0.4), pytest.approx(off, abs=0.4))


def test_a_contact_bounces_and_what_is_shorter_than_the_filter_is_missed():
    assert len(edges_of(bounce_s=0.04)) == 2 * (BOUNCES + 1)
    assert len(edges_of(bounce_s=0.04, filter_s=0.01)) == 2
    assert edges_of(filter_s=0.5) == []


def test_without_a_cam_the_input_stays_open_until_it_is_pressed():
    bench = bench_of()
    command(bench, 1.0, run_s=0.2)
    assert bench.axis()["home"] == 0
    bench.press_home("x", True)
    bench.run(0.01)
    assert bench.axis()["home"] == 1


def test_a_shared_output_moves_who_is_connected():
    bench = bench_of("xy")
    bench.share_output("xy", "y")
    command(bench, 1.0, "x")
    put_out(bench, HOLDS_OUTPUT, "y", run_s=0.3)
    assert bench.axis("x")["place_um"] == 0.0
    assert bench.axis("y")["place_um"] > 100.0
    alone = bench_of("xy")
    command(alone, 1.0, "x", run_s=0.3)
    assert alone.axis("x")["place_um"] > 100.0
    assert alone.axis("y")["place_um"] == 0.0


def test_what_no_amplifier_can_be_is_refused():
    for name, value in (("limit_A", -1.0), ("warm_s", -1.0), ("cam_filter_ns", -1.0), ("offset_V", np.nan)):
        with pytest.raises(InputError, match=f"the motor's {name} is"):
            Drives({"x": Puppet(axis_row("analogue", **{name: value}))}, np.inf, sizes_of(1, 8, 1))
