"""The EANPOS' output: feed-forward, PID, offset, converter, speed, following error, on drives that are not ideal."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.controllers.axis.eanpos_bench import TOP, Positioner, moving

NO_FRICTION = {"friction_Nm": 0.0, "stiction_Nm": 0.0, "way_friction_N": 0.0, "way_stiction_N": 0.0}


def bits(share):
    return math.floor(share * 32768 + 0.5)


@pytest.mark.parametrize("tcamp_ms", [1, 2, 4, 8, 255])
def test_proportional_part_by_sample_time(tcamp_ms):  # 4.3
    p = Positioner(tcamp_ms=tcamp_ms)
    edges = TOP * tcamp_ms * 1e-3 / 0.25
    p.bench.hold("x", True)
    p.slip(-4)
    assert p["follerr"] == 4
    assert p["propreg"] == bits(0.01 * 4 / edges)
    assert p.device.output_V == pytest.approx(60e-3 / tcamp_ms, abs=2e-4)
    assert tcamp_ms != 4 or p["propreg"] == pytest.approx(4 * 12.3, abs=0.5)


@pytest.mark.parametrize(
    ("speed", "feed", "volts", "register"),
    [(50000, 1000, 5.0, 16384), (100000, 985, 9.85, 32276), (10000, 0, 0.0, 0)],
)
def test_feed_forward_is_a_share_of_the_speed(speed, feed, volts, register):
    p = Positioner(setpos=9000, setvel=speed, feedfw=feed, taccdec=10)
    p.do("START", "LOOPOFF", run_s=0.5)
    assert (p["ffwdreg"], p.device.output_V) == (register, pytest.approx(volts, abs=2e-4))


def test_the_converter_has_16_bits():
    p = Positioner()
    p.do("CALON")
    codes = {}
    for tenths in (5, 10, 50, 100, -100):
        p["vout"] = tenths
        p.sample()
        codes[tenths] = round(p.device.output_V * 3276.8)
    assert codes == {5: 1638, 10: 3277, 50: 16384, 100: 32767, -100: -32768}


def test_integral_and_derivative():  # 4.3
    p = Positioner(pgain=0, integt=1000)
    p.bench.hold("x", True)
    p.slip(-4)
    first = p["integ"]
    p.sample(250)
    assert (p["integ"] - first) / 3276.8 == pytest.approx(1.5, abs=0.01)
    p = Positioner(pgain=0, derivt=10)
    p.bench.hold("x", True)
    p.slip(-4)
    assert p["derreg"] / 3276.8 == pytest.approx(3.75, abs=0.01)
    p.sample()
    assert p["derreg"] == 0


def test_the_ideal_form_multiplies_all_parts():  # Q-A7
    def registers(ideal):
        p = Positioner(pgain=500, integt=1000, derivt=10, settings={"ideal_pid": ideal})
        p.bench.hold("x", True)
        p.slip(-4)
        return np.array([p["propreg"], p["integ"], p["derreg"]])

    assert registers(1) == pytest.approx(registers(0) * [1, 0.5, 0.5], abs=1)


def test_the_integral_stops_in_saturation_and_ends_with_the_loop():
    p = Positioner(pgain=1000, integt=10)
    p.bench.hold("x", True)
    p.slip(-400)
    p.sample(100)
    assert p.device.output_V == pytest.approx(10.0, abs=1e-3)
    assert p["integ"] < 5000
    for command in ("LOOPOFF", "EMRG", "CALON"):
        q = Positioner(pgain=10, integt=1000)
        q.bench.hold("x", True)
        q.slip(-40)
        q.sample(10)
        assert q["integ"] > 0
        q.do(command)
        q.sample()
        assert q["integ"] == 0


def test_without_feed_forward_the_axis_lags_by_v_over_kv():
    p = moving(6.0, feedfw=0, setpos=9000, maxfollerr=10000)
    assert (p["follerr"], p["st_foller"]) == (pytest.approx(1333, abs=15), False)
    p = moving(4.0, feedfw=985, setpos=9000, setvel=100000)
    assert p["follerr"] == pytest.approx(40, abs=8)


def test_a_move_with_the_loop_open_misses_and_the_loop_closes_in():
    p = Positioner(ready=False, gain_error=-0.03, maxpos=9999, minpos=0)
    p["posit"] = 0
    p.do("INIT")
    p.move(run_s=1.0)
    assert (p["posit"], p["st_toll"]) == (pytest.approx(1940, abs=2), False)
    p.do("EMRG")
    p.do("RESUME", "LOOPON")
    p["setpos"] = 0
    p.move(run_s=2.0)
    assert abs(p["posit"]) <= 5
    assert p["st_toll"]


def test_an_asymmetric_drive_errs_by_direction():
    def reached(loop):
        p = Positioner(asymmetry=0.02, **NO_FRICTION)
        if not loop:
            p.do("LOOPOFF")
        p.move(run_s=3.0)
        there = p.true_um
        p["setpos"] = p["posit"] - 2000
        p.move(run_s=3.0)
        return there, there - p.true_um

    there, back = reached(loop=False)
    assert (there, back) == (pytest.approx(2020, abs=2), pytest.approx(1980, abs=2))
    there, back = reached(loop=True)
    assert (there, back) == (pytest.approx(2000, abs=2), pytest.approx(2000, abs=2))


def test_drift_of_the_drive_and_its_remedies():  # 4.3
    def rest(**changes):
        p = Positioner(offset_V=0.024, **changes)
        p.run(8.0)
        return float(p.bench.axis()["rotor_um"])  # the table lags behind it by its friction

    assert rest() == pytest.approx(1.6, abs=0.15)
    assert rest(offset=-79) == pytest.approx(0.0, abs=0.15)
    assert rest(integt=32767) == pytest.approx(0.0, abs=0.3)
    p = Positioner(offset_V=0.024, offset=-79)
    p.do("CALON")
    p.sample()
    assert p.device.output_V == pytest.approx(-0.0241, abs=1e-4)
    assert p.device.output_V + 0.024 == pytest.approx(-0.0001, abs=1e-4)


@pytest.mark.slow
def test_a_drive_warms_up():
    p = Positioner(drift_V=0.048, warm_s=10.0)
    p.run(1.0)
    cold = float(p.bench.axis()["rotor_um"])
    p.run(60.0)
    assert cold < 0.5
    assert p.bench.axis()["rotor_um"] == pytest.approx(3.2, abs=0.2)


def test_maxvel_from_a_known_voltage():
    p = Positioner()
    p.do("CALON")
    p["vout"] = 20
    p.run(1.5)
    assert p["vel"] == pytest.approx(20000, abs=60)
    assert p["vel"] * 100 / p["vout"] == pytest.approx(100000, abs=300)


def test_speed_and_frequency_every_250_ms():  # Q-A34
    p = moving(2.0, setpos=-9000)
    assert (p["frq"], p["vel"]) == (pytest.approx(833, abs=2), pytest.approx(-49980, abs=120))
    values, times = [], []
    for _ in range(250):
        p["vel"] = 7
        p.sample()
        if p["vel"] != 7 and (not values or values[-1] != p["vel"]):
            values.append(p["vel"])
            times.append(p.bench.time_s)
    assert np.diff(times).min(initial=1.0) > 0.24


def test_a_rotary_table_in_tenths_of_a_degree():  # Q-A9
    p = Positioner(
        measure=3600, pulse=4096, decpt=1, unitvel=1, setvel=10, setpos=46, maxvel=100, taccdec=10,
        prsvel=0, sprsvel=0,
        amplifier_rad_s_V=1137.78 / 63.66197723675814 / 10, index_width_um=0.0,
    )  # fmt: skip
    p.move(run_s=1.0)
    assert p["posit"] == pytest.approx(46, abs=1)
    assert p["encoder"] == pytest.approx(46 * 4096 / 3600, abs=2)
    p["setpos"] = 1000
    p.do("START", run_s=2.0)
    assert (p["frq"], p["vel"]) == (pytest.approx(28, abs=1), pytest.approx(10, abs=1))


@pytest.mark.parametrize(("digits", "per_s"), [(0, 10.0), (1, 100.0), (2, 1000.0), (3, 10000.0)])
def test_decpt_is_for_speeds(digits, per_s):
    p = Positioner(decpt=digits, unitvel=1, setvel=10, maxvel=20, measure=50, pulse=1000, setpos=900000, taccdec=1)
    p.do("START", "LOOPOFF", run_s=0.1)
    assert (p.theory[1], p.device.output_V) == (pytest.approx(per_s), pytest.approx(5.0, abs=1e-3))


def test_following_error_is_reported_and_held():  # Q-28, Q-A26
    p = Positioner(maxfollerr=400, pgain=100)
    p.slip(-401)
    assert p["st_foller"]
    assert p["follerr"] > 390
    p.run(0.4)
    assert p["follerr"] < 400
    assert p["st_foller"]
    p.run(0.6)
    assert not p["st_foller"]
    least = Positioner(maxfollerr=0)
    assert not least["st_foller"]
    least.slip(-1)
    assert least["st_foller"]
    late = Positioner(maxfollerr=400, settings={"delays_following": 1})
    late.bench.hold("x", True)
    late.slip(-401)
    late.run(0.4)
    assert not late["st_foller"]
    late.run(0.2)
    assert late["st_foller"]


def test_a_stalled_axis_is_in_following_error_and_goes_on():
    p = Positioner(maxfollerr=800)
    p.bench.hold("x", True)
    p.do("START", run_s=1.0)
    assert (p["st_foller"], p["st_still"], p.error) == (True, False, 0)
    p.bench.hold("x", False)
    p.until("st_still", run_s=4.0)
    assert (p["posit"], p["st_foller"]) == (pytest.approx(2000, abs=5), False)


def test_tolerance_after_its_delay():  # Q-27, Q-A32
    p = Positioner(tcamp_ms=1, toll=-5, pgain=50)
    p.do("START")
    assert not p["st_toll"]
    p.until("st_toll")
    assert p.since_s == pytest.approx(2.9225, abs=0.012)
    p.do("START")  # no way to go: neither motion nor a flicker
    assert (p["st_toll"], p["st_still"]) == (True, True)
    p.bench.hold("x", True)
    p.slip(40)
    assert not p["st_toll"]
    p.slip(-40)
    assert not p["st_toll"]
    p.run(0.11)
    assert p["st_toll"]
    p.bench.hold("x", False)
    p["setpos"] = 2010
    p.do("START")
    assert not p["st_toll"]


def test_samples_are_exact():
    p = Positioner(tcamp_ms=255)
    p.bench.samples()
    p.bench.trace = True
    p.run(10.0)
    assert set(np.diff(p.bench.samples()["time_ns"])) == {255_000_000}


def test_an_output_without_a_scale_is_nought():  # Q-A31
    p = Positioner(maxvel=0)
    p.slip(-400)
    assert p.device.output_V == 0.0
    p.do("START", run_s=0.5)
    assert p.device.output_V == 0.0


def test_a_sample_may_be_shorter_than_an_edge_at_full_speed():  # 1.7.2: no condition of START
    amplifier = 10.471975511965978 * 600 / 100000  # rad/s at 1 V: 10 um/s at 10 V, 0.04 edges a ms
    p = moving(2.0, tcamp_ms=1, maxvel=600, setvel=300, setpos=20, amplifier_rad_s_V=amplifier)
    assert 2 < p["posit"] < 18
    p.run(6.0)
    assert (p.warning, p["posit"]) == (0, pytest.approx(20, abs=2))


def test_without_counter_or_output():  # Q-A21
    p = Positioner(resources=(False, False, False, True))
    p.move()
    assert (p["posit"], p["follerr"], p.true_um) == (2000, 0, pytest.approx(2000, abs=5))
    p = Positioner(resources=(True, False, False, False))
    p.move()
    assert (p.true_um, p.device.output_V) == (0.0, 0.0)
