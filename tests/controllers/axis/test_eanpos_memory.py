"""The EANPOS' parameters: the manual's table, limits and conditions of writes, and what outlasts the power."""

import math

import pytest

from edmsim.axis_bench import AxisBench
from edmsim.compiled.axis_rows import FAULT
from edmsim.controllers import axis
from edmsim.controllers.axis.eanpos import Eanpos
from edmsim.controllers.axis.eanpos import registers as at
from edmsim.errors import InputError
from tests.controllers.axis.eanpos_bench import Positioner

RETENTIVE = [
    "measure", "pulse", "maxpos", "minpos", "prspos", "maxvel", "prsvel", "sprsvel", "toll", "maxfollerr", "rampmode",
    "ramptype", "taccdec", "tacc", "tdec", "rtype", "stopt", "tinvt", "toldly", "pgain", "feedfw", "integt", "derivt",
    "prsmode", "prmdir", "unitvel", "decpt", "offset", "setpos", "setvel", "posit", "encoder",
]  # fmt: skip
ZERO_AT_INIT = [
    "vout", "vel", "frq", "follerr", "ffwdreg", "propreg", "integ", "derreg", "delta", "errcode", "errvalue",
    "wrncode", "wrnvalue",
]  # fmt: skip


def test_names_as_the_manual_prints_them_elsewhere():  # Q-A8, Q-A35
    p = Positioner()
    for printed, name in [("prsdir", "prmdir"), ("Stopt", "stopt"), ("FEEDFORWARD", "feedfw"), ("folterr", "follerr"),
                          ("prsvvel", "prsvel"), ("sprsvvel", "sprsvel")]:  # fmt: skip
        assert p.device.parameters[printed] == p[name]
    assert p.device.states["st_follower"] == p["st_foller"]
    for unknown in ("cntratio", "st_camex"):
        with pytest.raises(InputError, match=f"the device has no .* '{unknown}'"):
            p.device.parameters[unknown]


def test_what_outlasts_the_power():  # Q-A18
    p = Positioner(prspos=40, setpos=700, ramptype=1, rtype=1, offset=-5)
    p.do("CNTREV", "LOOPOFF")
    p.move()
    p.do("EMRG", "STOP", "MANFW")
    p["delta"] = 12
    assert {*at.PARAMETERS} == {*RETENTIVE, *ZERO_AT_INIT}
    before = {name: p[name] for name in RETENTIVE}
    assert before["encoder"] != 0
    p.bench.power_cycle("x", 0.1)
    p.sample()
    assert {name: p[name] for name in RETENTIVE} == before
    assert p.on == {"st_still", "st_cntrev"}
    p.do("INIT")
    assert all(p[name] == 0 for name in ZERO_AT_INIT)
    assert p.on == {"st_still", "st_cntrev", "st_init"}
    assert not p["st_foller"]  # Q-A6


def test_what_moves_while_the_power_is_off_is_lost():
    p = Positioner()
    p.move(run_s=1.0)
    place, count = p.true_um, p["posit"]
    p.bench.rail("x", 0.0)
    p.push()
    assert p.true_um > place + 100
    p.bench.rail("x", 5.0)
    p.sample()
    p.do("INIT")
    assert p["posit"] == count
    assert p.true_um > place + 100


@pytest.mark.parametrize(("name", "values"), [
    ("maxpos", (1000000, -1000000)), ("minpos", (1000000,)), ("maxvel", (-1, 1000000)), ("measure", (0, 1000000)),
    ("pulse", (0, 1000000)), ("toll", (1000000,)), ("toldly", (1000,)), ("maxfollerr", (-1,)), ("rampmode", (2,)),
    ("ramptype", (4,)), ("taccdec", (1000,)), ("tacc", (1000,)), ("tdec", (1000,)), ("tinvt", (1000,)),
    ("pgain", (32768,)), ("feedfw", (32768,)), ("integt", (-1,)), ("derivt", (32768,)), ("prsmode", (3,)),
    ("prmdir", (2,)), ("unitvel", (2,)), ("decpt", (4,)), ("offset", (32768,)), ("delta", (1000000,)),
    ("prspos", (5001,)), ("setpos", (-5001,)), ("setvel", (100001, -1)), ("prsvel", (100001,)),
    ("sprsvel", (100001,)), ("rtype", (2,)), ("stopt", (2,)),
])  # fmt: skip
def test_values_outside_their_limits_are_taken_with_a_warning(name, values):
    p = Positioner(ready=False, maxpos=5000, minpos=-5000, ramptype=1)
    for value in values:
        p.do("RSWRN")
        p[name] = value - 1 if value > 0 else value + 1  # the limit itself
        assert p.warning == 0
        p[name] = value
        assert p[name] == value
        assert (p.warning, p["wrnvalue"]) == (3, at.PARAMETERS.index(name))


def test_a_value_that_no_register_holds_is_refused():  # Q-7, Q-A5
    p = Positioner()
    for name, value in [("maxfollerr", 2147483648), ("taccdec", 70000), ("decpt", 300), ("setpos", 1.5),
                        ("posit", math.nan), ("posit", math.inf)]:  # fmt: skip
        with pytest.raises(InputError, match=f"{name} is .*; it must be a whole number"):
            p[name] = value
    p["maxfollerr"] = 2147483647
    assert p.warning == 0


def test_writes_have_conditions():  # Q-A19
    conditions = {
        "still": "maxpos minpos maxvel ramptype unitvel decpt", "both": "prspos prsvel sprsvel",
        "unhomed": "prsmode prmdir pulse", "epicycloid": "rtype stopt", "calibration": "vout",
        "free": "toll toldly maxfollerr tinvt pgain feedfw integt derivt offset delta measure",
        "never": "encoder follerr ffwdreg propreg integ derreg errcode errvalue wrncode wrnvalue",
    }  # fmt: skip

    def refused(p):
        found = set()
        for name in " ".join(conditions.values()).split():
            p.do("RSWRN")
            before = p[name]
            p[name] = before - 1
            if p.warning == 2:
                assert name.startswith("wrn") or p[name] == before
                assert p["wrnvalue"] == at.PARAMETERS.index(name)
                found.add(name)
            else:
                p[name] = before
        return found

    def named(*kinds):
        return {name for kind in kinds for name in conditions[kind].split()}

    p = Positioner(ramptype=1)
    assert refused(p) == named("never", "calibration")
    p.do("START")
    assert refused(p) == named("never", "calibration", "still", "both")
    p.do("STOP")
    p.until("st_still")
    p.bench.home_cam("x", 5000.0, 6000.0)
    p.do("PRESET")
    assert refused(p) == named("never", "calibration", "still", "both", "unhomed")
    p.do("CALON")
    assert refused(p) == named("never")
    assert "rtype" in refused(Positioner(ramptype=0))


def test_a_new_resolution_drops_the_fraction():
    p = Positioner()
    p.do("LOOPOFF")
    p.slip(10)
    assert (p["posit"], p["encoder"]) == (2, 10)
    p["measure"] = 20000
    p.slip(1)
    assert p["posit"] == 2
    p.slip(1)
    assert p["posit"] == 3


def test_a_new_resolution_leaves_the_axis_where_it_is():
    p = Positioner()
    p["posit"] = 2000
    p.sample()
    p["pulse"] = 20000
    p.run(0.5)
    assert (p["posit"], p["follerr"], p.device.theoretical[0]) == (2000, 0, 2000.0)
    assert p.bench.axis("x")["place_um"] == 0.0


@pytest.mark.parametrize(
    ("measure", "pulse", "fine"), [(935, 1000000, True), (934, 999999, False), (1, 1, True), (10001, 10000, False)]
)
def test_the_resolution_has_limits(measure, pulse, fine):  # Q-3, Q-A1
    p = Positioner(ready=False, measure=measure, pulse=pulse)
    p.do("INIT")
    assert (p.error == 4) == (not fine)


def test_without_a_resolution_the_count_stays():  # any value is accepted
    p = Positioner(ready=False, pulse=0)
    p["delta"] = 3
    p.do("INIT", "DELCNT")
    assert (p.error, p["wrncode"], p["wrnvalue"]) == (4, 1, 19)  # resolution; DELCNT was not executed
    p["pulse"] = 40000
    p.do("RSERR", "LOOPON")
    p.do("START")
    p.run(4.0)
    assert p["posit"] == 2000


def test_full_travel_at_the_finest_resolution():
    p = Positioner(measure=935, pulse=999999, maxpos=999999, minpos=-999999)
    p["posit"] = 999999
    p.do("LOOPOFF")
    edges = 2 * 999999 * 999999 // 935
    p.device.record["reg"][0, at.LAST_COUNT] += edges  # as if the counter had gone all that way
    p.sample()
    assert p["posit"] == pytest.approx(-999999, abs=1)
    assert abs(p["encoder"]) == edges < 2**31


def test_the_device_of_the_house():
    device = axis.make("eanpos")
    assert isinstance(device, Eanpos)
    assert device.line(b"?") == b""
    for tcamp_ms in (0, 256):
        with pytest.raises(InputError, match="it must be 1 to 255"):
            Eanpos(tcamp_ms=tcamp_ms)
    with pytest.raises(InputError, match="no EANPOS is tuned for an axis 'bench'"):
        Eanpos.tuned("bench")


def shared(connected="x"):
    p = Positioner(axes="xy", ready=False, pgain=50)
    p.bench.share_output("xy", connected)
    for name in "xy":
        p.do("INIT", axis=name)
        p.do("LOOPON", "REGOFF", axis=name)
    return p


def test_one_drive_for_two_axes():
    p = shared()
    y = p.bench.drive("y")
    p.do("REGON")
    p.move(run_s=1.0)
    assert p["posit"] == pytest.approx(2000, abs=2)
    assert y.parameters["posit"] == 0
    assert p.bench.axis("y")["place_um"] == 0.0
    p.do("REGOFF")
    p.bench.share_output("xy", "y")
    p.do("REGON", axis="y")
    p.do("START", axis="y", run_s=4.0)
    assert y.parameters["posit"] == pytest.approx(2000, abs=2)
    assert p.true_um == pytest.approx(2000, abs=2)
    p.bench.torque("x", 0.5)
    p.run(0.05)
    assert p["posit"] > 2010  # its transducer stays bound to it


def test_two_owners_of_an_output_are_an_error():  # Q-48, Q-A36
    p = shared()
    p.do("REGON")
    assert p.error == 0
    p.do("START")
    p.do("REGON", axis="y")
    p.sample()
    assert p.error == 3
    assert p.bench.drive("y").parameters["errcode"] == 3
    p.until("st_still")
    assert p.true_um < 100


def test_commissioned_it_follows_steps_and_stops_the_machine_when_it_is_lost():
    bench = AxisBench({"x": Eanpos.tuned()})
    bench.power_cycle("x")
    bench.run(0.01)
    device = bench.drive("x")
    assert device.states["st_loopon"]  # whenever it is switched on
    bench.steps("x", 50, rate_Hz=100.0)
    bench.steps("x", -20, rate_Hz=100.0)
    bench.run(1.0)
    assert bench.axis()["place_um"] == pytest.approx(60.0, abs=0.5)
    assert device.parameters["posit"] == device.parameters["setpos"] == 60
    assert not device.states["st_warning"]
    bench.hold("x", True)
    bench.steps("x", 500, rate_Hz=1000.0)
    bench.run(1.0)
    assert device.record["lines"][0] & FAULT
    assert (device.states["st_emrg"], device.output_V) == (True, 0.0)


def test_it_is_named_with_parameters_that_differ():
    device = axis.from_text("eanpos:pgain=60,taccdec=5")
    assert isinstance(device, Eanpos)
    assert (device.parameters["pgain"], device.parameters["taccdec"], device.parameters["maxvel"]) == (60, 5, 4000)
    with pytest.raises(InputError, match="no parameter 'gain'"):
        axis.from_text("eanpos:gain=60")
    with pytest.raises(InputError, match=r"pgain is 0\.5; it must be a whole number"):
        axis.from_text("eanpos:pgain=0.5")
