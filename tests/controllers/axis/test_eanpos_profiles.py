"""The EANPOS' ramps: times and ways of the worked examples, reductions, stops, and changes in motion."""

import math

import numpy as np
import pytest

from tests.controllers.axis.eanpos_bench import TOP, Positioner, moving


def seconds(positioner, value):
    """A time to within the sample at which it shows, and the one at which a command is taken."""
    return pytest.approx(value, abs=1.01 * positioner.tcamp_s)


@pytest.mark.parametrize(("changes", "time_s", "peak"), [
    ({}, 2.900, 0.5 * TOP),
    ({"setpos": 1000, "setvel": 100000}, 1.54919, 1290.99),
    ({"rampmode": 1, "tacc": 50, "tdec": 200}, 3.025, 0.5 * TOP),
    ({"rampmode": 1, "tacc": 50, "tdec": 200, "setpos": 1000, "setvel": 100000}, 1.73205, 1154.70),
    ({"ramptype": 1}, 2.900, 0.5 * TOP),
    ({"ramptype": 2}, 2.900, 0.5 * TOP), ({"ramptype": 3}, 2.900, 0.5 * TOP),
    # time kept, slope reduced; slope kept, time reduced
    ({"ramptype": 1, "setpos": 1000, "setvel": 100000}, 2.000, 1000.0),
    ({"ramptype": 1, "rtype": 1, "setpos": 1000, "setvel": 100000}, 1.54919, 1290.99),
    ({"ramptype": 1, "setpos": 200}, 1.000, 400.0),
    ({"ramptype": 1, "rtype": 1, "setpos": 200}, 0.69282, 577.35),
    ({"ramptype": 1, "rampmode": 1, "tacc": 50, "tdec": 200, "setpos": 1000, "setvel": 100000}, 2.5, 800.0),
    # Q-A30: of two kinds of ramp the slope is kept
    ({"ramptype": 2, "setpos": 200}, 0.69282, 577.35),
    ({"taccdec": 0}, 2.400, 0.5 * TOP),  # Q-A31: a ramp of no time is a step
])  # fmt: skip
def test_a_placement_takes_the_time_of_its_profile(changes, time_s, peak):
    p = Positioner(tcamp_ms=1, pgain=3, **changes)
    p.bench.trace = True
    assert p.move() == seconds(p, time_s)
    assert p.theory == (p["setpos"], 0.0)
    forward = p.bench.samples()["command"].max() * TOP
    assert forward == pytest.approx(peak, rel=0.02)


def test_by_gradient_an_epicycloid_takes_twice_the_time():  # Q-40, Q-A15
    p = Positioner(ramptype=1, settings={"gradient": 1})
    assert p.move() == seconds(p, 3.400)


def test_an_epicycloid_has_the_speeds_of_its_law():  # Q-40, vectors of 4.4
    p = Positioner(tcamp_ms=1, ramptype=1, setvel=100000, setpos=9000)
    p.do("START")
    at = {}
    for k in range(1, 1000):
        p.sample()
        at[k] = p.theory
    for share, speed, way in [
        (0.1, 10.752, 0.27057), (0.25, 151.408, 9.86617), (0.5, 833.333, 123.899), (0.75, 1515.258, 426.533),
        (0.9, 1655.915, 666.937),
    ]:  # fmt: skip
        assert at[round(share * 1000)] == (pytest.approx(way, abs=1e-3), pytest.approx(speed, abs=1e-3))


def test_ramptype_1_reduces_jerk_at_the_table():
    def jolts(kind):
        p = Positioner(ramptype=kind, tcamp_ms=1, setpos=400, friction_Nm=0.0, stiction_Nm=0.0)
        p.bench.trace = True
        p.do("START", run_s=2.0)
        return np.abs(np.diff(p.bench.samples()["speed_rad_s"], 2)).max()

    assert jolts(1) < 0.5 * jolts(0)


def at_1_s(name, value, **changes):
    """A placement by 2000 Um at 50 %, one second old, when a parameter is written."""
    p = moving(0.996, **changes)
    p[name] = value
    p.sample()
    return p


@pytest.mark.parametrize(("speed", "total_s"), [(100000, 2.44936), (10000, 8.500)])
def test_a_new_speed_is_taken_in_motion(speed, total_s):
    p = at_1_s("setvel", speed)
    assert p["st_acc"] == (speed > 50000)
    assert p["st_dec"] == (speed < 50000)
    p.until("st_still")
    assert p.since_s == seconds(p, total_s)
    assert (p.theory[0], p.warning) == (2000.0, 0)


def test_no_new_speed_is_taken_while_it_slows_down():  # Q-42, Q-A22
    p = moving(2.6)
    assert p["st_dec"]
    p["setvel"] = 100000
    p.sample()
    assert (p["setvel"], p.warning) == (50000, 2)
    p.until("st_still")
    assert p.since_s == seconds(p, 2.9)


def test_a_new_target_is_taken_if_the_axis_can_stop_there():  # Q-42, Q-A23
    p = at_1_s("setpos", 1000)
    assert p.theory == (pytest.approx(625.0), pytest.approx(0.5 * TOP))
    p.until("st_still")
    assert p.since_s == seconds(p, 1.7)
    assert p.theory[0] == 1000.0
    p = at_1_s("setpos", 800)
    assert (p["setpos"], p.warning) == (2000, 2)
    p.until("st_still")
    assert p.theory[0] == 2000.0


@pytest.mark.parametrize("kind", [1, 2])
def test_an_epicycloidal_stop_takes_no_new_target(kind):  # Q-42, Q-A30
    p = moving(2.6, ramptype=kind)
    p["setpos"] = 4000
    p.sample()
    assert p.warning == 2
    straight = moving(2.6, ramptype=0)
    straight["setpos"] = 4000
    straight.until("st_still")
    assert straight.theory[0] == 4000.0


def test_an_epicycloidal_start_is_not_broken_off():
    p = moving(0.25, ramptype=1)
    p["setvel"], p["setpos"] = 100000, 3000
    p.run(0.24)
    assert p.theory[1] < 0.5 * TOP
    assert p["st_acc"]
    p.run(0.8)
    assert p.theory[1] > 0.5 * TOP
    p.until("st_still")
    assert p.theory[0] == 3000.0


@pytest.mark.parametrize(("at_s", "changes", "place", "total_s"), [
    (1.0, {}, 833.33, 1.5),
    (0.25, {}, 104.167, 0.5),
    (0.25, {"ramptype": 1}, 416.67, 1.0),  # the ramp is finished
    (0.25, {"ramptype": 1, "stopt": 1}, 83.058, 0.5),  # it is broken off
    (1.0, {"rampmode": 1, "tacc": 100, "tdec": 200}, 1041.67, 2.0),
])  # fmt: skip
def test_stop_takes_the_ramp_in_use(at_s, changes, place, total_s):
    p = moving(at_s - 0.001, tcamp_ms=1, **changes)
    p.do("STOP")
    p.until("st_still")
    assert p.since_s == seconds(p, total_s)
    assert (p.theory[0], p["st_loopon"], p["st_toll"]) == (pytest.approx(place, abs=1.0), True, False)


def test_stopt_is_for_placements_only():
    p = Positioner(tcamp_ms=1, ramptype=1)
    p.do("MANFW", run_s=0.249)
    p.do("STOP")
    began = p.bench.time_s
    p.until("st_still")
    assert p.bench.time_s - began == seconds(p, 0.25)


def test_ramp_times_change_in_motion():
    p = moving(0.25, tcamp_ms=1, setpos=9000)
    p["taccdec"] = 400  # at once with straight ramps
    p.run(0.25)
    assert p.theory[1] == pytest.approx(0.25 * TOP + 0.25 * TOP / 4, abs=4.0)
    late = moving(2.2, tcamp_ms=1)
    late["taccdec"] = 999  # no longer possible: stored, not executed
    late.until("st_still")
    assert late.since_s == seconds(late, 2.9)
    assert (late["taccdec"], late.theory[0]) == (999, 2000.0)


def test_posit_rewritten_in_motion_lengthens_the_way():
    p = at_1_s("posit", -380)
    p.until("st_still", run_s=5.0)
    assert (p["posit"], p.true_um) == (pytest.approx(2000, abs=1), pytest.approx(3000, abs=6))
    p = at_1_s("posit", 1900)  # the axis could not stop at 2000 any more (Q-A24)
    assert p.warning == 2
    assert p["posit"] < 700


def test_the_way_back_waits_for_tinvt():
    p = Positioner(tinvt=50, setpos=200)
    p.move()
    p["setpos"] = 0
    p.do("START")
    began = p.bench.time_s
    for _ in range(123):
        p.sample()
        assert (p.theory[1], p["st_still"]) == (0.0, False)
        assert not p.on & {"st_acc", "st_dec", "st_vconst"}
    p.until("st_still")
    assert p.bench.time_s - began == seconds(p, 0.5 + 2 * math.sqrt(200 / TOP))


@pytest.mark.parametrize("command", ["STOP", "PRESET"])
def test_a_stop_in_the_pause_before_the_way_back_ends_the_way(command):
    p = Positioner(ramptype=1, stopt=0, tinvt=50, setpos=200)
    p.move()
    p["setpos"] = 0
    p.do("START", run_s=0.1)
    p.do(command)
    p.run(1.0)
    way = p.theory[0] - 200.0
    assert way > 0.0 if command == "PRESET" else way == 0.0  # the search begins upwards


def test_tinvt_parts_braking_from_setting_out():
    def speed_change(tinvt):
        """Largest change of the rotor's speed (rad/s) within 60 ms as the axis turns about."""
        p = Positioner(tinvt=tinvt, taccdec=5, setpos=60, tcamp_ms=1)
        p.bench.trace = True
        p.move()
        p["setpos"] = 0
        p.move()
        speed = p.bench.samples()["speed_rad_s"]
        return np.abs(speed[60:] - speed[:-60]).max()

    assert speed_change(10) < 0.6 * speed_change(0)


def test_states_say_what_the_axis_does():
    p = Positioner()
    phases = []
    p.do("START")
    while not p["st_still"]:
        now = p.on & {"st_acc", "st_vconst", "st_dec"}
        assert len(now) == 1
        assert not p["st_movdir"]
        phases += [] if phases and now == phases[-1] else [now]
        p.sample()
    assert phases == [{"st_acc"}, {"st_vconst"}, {"st_dec"}]
    assert not p.on & {"st_acc", "st_vconst", "st_dec"}
    p["setpos"] = 0
    p.do("START")
    assert p["st_movdir"]


def optimal(way, speed, acceleration, jerk):
    """Ruckig's motion over a way: no intermediate places, which that library would send over the network."""
    ruckig = pytest.importorskip("ruckig", reason="an extra of the tests")
    limits, found = ruckig.InputParameter(1), ruckig.Trajectory(1)
    limits.current_position, limits.target_position = [0.0], [way]
    limits.max_velocity, limits.max_acceleration, limits.max_jerk = [speed], [acceleration], [jerk]
    ruckig.Ruckig(1).calculate(limits, found)
    return found


@pytest.mark.parametrize(("way", "speed", "ramp", "jerk"), [
    (2000, 50000, 100, 10000),  # the acceleration is reached, and the speed
    (2000, 50000, 100, 2000),  # the acceleration is not
    (300, 100000, 100, 20000),  # the speed is not
    (40, 100000, 50, 3000),  # neither
    (-1500, 80000, 30, 90000),
])  # fmt: skip
def test_a_placement_is_time_optimal_under_its_limits(way, speed, ramp, jerk):
    p = Positioner(tcamp_ms=1, setpos=way, setvel=speed, taccdec=ramp, settings={"jerk_limit": jerk})
    best = optimal(way, speed / 60, TOP / (ramp * 0.01), jerk)
    p.do("START")
    gaps = []
    while not p["st_still"]:
        place, velocity, _ = (value[0] for value in best.at_time(p.since_s))
        gaps.append((p.theory[0] - place, p.theory[1] - abs(velocity)))
        p.sample()
    assert p.since_s == pytest.approx(best.duration, abs=1.1e-3)
    assert np.abs(gaps).max(axis=0) == pytest.approx([0.0, 0.0], abs=1e-6)


def test_a_speed_change_in_motion_keeps_the_jerk():
    p = moving(1.5, tcamp_ms=1, setpos=9000, settings={"jerk_limit": 5000})
    p["setvel"] = 100000
    speeds = []
    for _ in range(1500):
        p.sample()
        speeds.append(p.theory[1])
    assert max(speeds) == pytest.approx(TOP)
    assert np.abs(np.diff(speeds, 2)).max() * 1e6 == pytest.approx(5000, rel=0.01)
