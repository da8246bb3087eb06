"""The manual's application example runs: its misprints are found, and each of its lines does what it should."""

from pathlib import Path

import pytest

from edmsim.consoles.positioner import Station
from edmsim.controllers.qcl import QclError, read_configuration, read_program

FOLDER = Path(__file__).parent / "manual"
"""Texts of the manual (1.9) as wiki.qem.it prints them, to the character; the program's two halves are one file."""
CONFIGURATION = (FOLDER / "ex_eanpos.cnf").read_text(encoding="utf-8")
PROGRAM = (FOLDER / "task_00.mod").read_text(encoding="utf-8")
SECOND_HALF = 45
"""Line of the program at which its second half begins."""


def in_second_half(line):
    """Line of the whole program of a line of its second half."""
    return SECOND_HALF - 1 + line


def _comment_stars(text):
    return "\n".join(f";{line}" if line.startswith("*") else line for line in text.splitlines())


def readable():
    """Configuration and program with nothing repaired but what cannot be read: comments, and two names."""
    named = CONFIGURATION.replace("slVelAsse", "slVelAxis").replace("ofAxeFermo", "ofAxeStopped")
    return _comment_stars(named), _comment_stars(PROGRAM)


def repaired():
    """Besides that the enabling input has an address of its own, and the missing RESUME stands before its WAIT."""
    configuration, program = readable()
    configuration = configuration.replace("1       2.INP01    2.AN01", "1       2.INP05    2.AN01")
    lines = program.splitlines()
    lines.insert(in_second_half(3) - 1, "RESUME Axis")
    return configuration, "\n".join(lines)


def problems(read):
    with pytest.raises(QclError) as refused:
        read()
    return {problem.line: problem.what for problem in refused.value.problems}


def test_the_printed_texts_are_refused_by_line_and_name():  # Q-82, 4.6
    found = problems(lambda: read_configuration(CONFIGURATION))
    assert {*found} == {1, 8}
    assert all("'*****'" in what for what in found.values())
    stars = "\n".join(f";{line}" if line.startswith("*") else line for line in CONFIGURATION.splitlines())
    found = problems(lambda: read_program(PROGRAM, read_configuration(stars)))
    names = {1: "***", 5: "***", in_second_half(42): "ofAxeStopped"}
    names |= {in_second_half(line): "slVelAxis" for line in (9, 12, 51, 77, 87)}
    assert {*found} == {*names}
    assert all(names[line] in found[line] for line in names)


def test_what_the_configuration_declares():  # Q-A11
    found = read_configuration(repaired()[0])
    device = found.devices["axis"]
    assert device == ("axis", 4, "2.CNT01", 1, "2.INP05", "2.AN01")
    assert found.cards == {1: "1CPUD", 2: "1MIXA", 3: None, 4: None}
    assert {name: one.retained for name, one in found.variables.items()} == {
        "slquotapos": True, "slvelaxis": True, "gfmovman": False, "gfmovauto": False,
    }  # fmt: skip
    assert (found.inputs["ifstop"], found.outputs["ofaxestopped"]) == ("2.INP04", "2.OUT02")
    verbs = [statement.verb for statement in read_program(repaired()[1], found)]
    assert verbs.count("if") == 17
    assert len(verbs) == len(read_program(readable()[1], found)) + 1


class Example:
    """The example on its axis, its program at the main loop."""

    def __init__(self, texts=None, until_s=0.1, **variables):
        self.station = Station(*(texts or repaired()))
        self.device = self.station.device("Axis")
        self.control = self.station.control
        self.control.variables.update(variables)
        self.run(until_s)

    def run(self, seconds):
        self.station.run(seconds)

    def press(self, name, seconds=0.0):
        self.station.press(name)
        if seconds:
            self.run(seconds)
            self.station.press(name, False)

    def __getitem__(self, name):
        if name.startswith("st_"):
            return self.device.states[name]
        if name in self.device.parameters:
            return self.device.parameters[name]
        return self.control.variables[name.lower()]

    @property
    def outputs(self):
        return [name for name in ("2.OUT01", "2.OUT02") if self.control.outputs[name]]


def test_it_loads_and_starts_the_device():  # Q-55, lines A9 to B20
    e = Example()
    want = {
        "measure": 10000, "pulse": 40000, "maxvel": 100000, "maxpos": 999999, "minpos": -999999, "maxfollerr": 10000,
        "unitvel": 0, "decpt": 0, "rampmode": 0, "taccdec": 100, "tacc": 0, "tdec": 0, "tinvt": 0, "toll": 5,
        "toldly": 10, "prsmode": 0, "prspos": 0, "prmdir": 0, "prsvel": 20000, "sprsvel": 10000, "offset": 0,
        "pgain": 10, "feedfw": 1000, "integt": 0, "derivt": 0, "ramptype": 0, "rtype": 0, "stopt": 0, "setpos": 0,
        "setvel": 0,
    }  # fmt: skip
    assert {name: e[name] for name in want} == want
    assert {name for name, on in e.device.states.items() if on} == {"st_init", "st_loopon", "st_still", "st_warning"}
    assert (e["wrncode"], e["wrnvalue"]) == (1, 3)  # RESUME without need, after REGON (Q-A20)
    assert (e["slVelAxis"], e["slQuotaPos"]) == (50, 2000)
    assert e.outputs == ["2.OUT02"]


def test_values_that_outlasted_the_power_stay():  # B9 to B20, Q-82
    e = Example(slquotapos=700)
    assert (e["slQuotaPos"], e["slVelAxis"]) == (700, 50)
    e.control.variables["gfmovman"] = 1
    e.control.restart()
    assert (e["slQuotaPos"], e["gfMovMan"]) == (700, 0)


def test_start_positions():  # B40 to B68
    e = Example()
    e.press("ifStart", 0.1)
    assert (e["setvel"], e["setpos"], e["gfMovAuto"]) == (50000, 2000, 1)
    assert e.outputs == []
    began = e.station.bench.time_s - 0.1
    while e["gfMovAuto"]:
        e.run(0.001)
    assert e.station.bench.time_s - began == pytest.approx(2.9, abs=0.012)
    e.run(1.0)
    assert e["posit"] == pytest.approx(2000, abs=5)
    assert e.outputs == ["2.OUT01", "2.OUT02"]


@pytest.mark.parametrize(("button", "sign"), [("ifAvMan", 1), ("ifInMan", -1)])
def test_jog_while_a_button_is_pressed(button, sign):  # B73 to B100
    e = Example()
    e.device.command("RSWRN")
    e.press(button, 1.0)
    e.run(0.01)
    assert (e["gfMovMan"], e["st_still"]) == (0, False)
    at = e["posit"]
    e.run(1.0)
    assert e["st_still"]
    assert sign * (e["posit"] - at) == pytest.approx(208, abs=12)
    assert not e["st_warning"]


def test_printed_without_resume_it_runs_all_the_same():  # Q-55, 4.6 item 4
    e = Example(readable())
    assert (e["wrncode"], e["wrnvalue"]) == (1, 18)  # REGON
    e.press("ifStart", 0.1)
    e.run(4.0)
    assert e["posit"] == pytest.approx(2000, abs=5)


def test_printed_with_one_input_for_two_every_jog_would_load_the_count():  # 4.6 item 3
    for texts, loads in [(readable(), True), (repaired(), False)]:
        configuration, program = texts
        e = Example((configuration, program.replace("Axis:prsmode = 0", "Axis:prsmode = 2")))
        e.press("ifAvMan", 0.5)
        assert (e["st_prsok"], e["posit"] == 0) == (loads, loads)
