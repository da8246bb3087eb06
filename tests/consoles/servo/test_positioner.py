"""``edmsim console positioner``: a QCL program on its axes, from files, inputs pressed by time."""

import math
from pathlib import Path

import pytest

from edmsim.consoles.positioner import Press, Station, press_of, run_and_report
from edmsim.errors import InputError

from ..conftest import recorded_curve

EXAMPLE = Path(__file__).parents[3] / "examples" / "positioner"
FILES = EXAMPLE / "table.cnf", EXAMPLE / "table.mod"


def station():
    return Station.of_files(*FILES, "analogue")


@pytest.mark.slow
def test_the_example_homes_and_places():
    one = station()
    one.bench.home_cam("x", 300.0, 2000.0)
    one.run(0.1)
    one.press("ifHome")
    one.run(0.05)
    one.press("ifHome", False)
    one.run(5.0)
    device = one.device("Axis")
    assert device.states["st_prsok"]
    assert float(one.bench.axis()["place_um"]) == pytest.approx(300, abs=2)
    one.press("ifStart")
    one.run(0.05)
    one.press("ifStart", False)
    one.run(4.0)
    assert float(one.bench.axis()["place_um"]) == pytest.approx(2300, abs=3)
    assert one.control.outputs["2.OUT01"]
    assert device.parameters["wrncode"] == 0


def test_files_of_another_editor_are_read(tmp_path):
    copies = [tmp_path / file.name for file in FILES]
    for file, copy in zip(FILES, copies, strict=True):
        copy.write_bytes(b"\xef\xbb\xbf" + file.read_bytes().replace(b"\n", b"\r\n"))
    assert Station.of_files(*copies, "analogue").control.line == station().control.line


@pytest.mark.slow
def test_it_tells_what_changes():
    said = []
    run_and_report(station(), 1.0, [Press("ifForward", 0.2, 0.3), Press("ifForward", 0.25, 0.4)], said.append)
    changes = [line.split(" s  ")[1] for line in said[:-1]]
    assert changes[:7] == [
        "axis:st_init 1", "axis:st_loopon 1", "ofstill 1", "ifForward on", "axis:st_still 0", "ofstill 0",
        "ifForward off",
    ]  # fmt: skip
    assert changes[-1].startswith("axis: posit 66, setpos 0")
    assert said[-1].startswith("the program is at line")


def test_two_devices_on_one_output_take_turns():
    text = FILES[0].read_text(encoding="utf-8").replace("END", "Other EANPOS 2 2.CNT02 X X.X 2.AN01\nEND")
    program = "\n".join(
        f"{name}:{key} = {value}" for name in ("Axis", "Other") for key, value in (
            ("measure", 10000), ("pulse", 40000), ("maxvel", 100000), ("taccdec", 50), ("setpos", 500),
            ("setvel", 50000), ("pgain", 20), ("feedfw", 1000),
        )
    )  # fmt: skip
    program += "\nINIT Axis\nREGOFF Axis\nWAIT Axis:st_init\nINIT Other\nLOOPON Other\nSTART Other\nEND"
    one = Station(text, program)
    assert one.axes == {"axis": "x", "other": "y"}
    one.bench.share_output("xy", "y")
    one.run(3.0)
    assert one.device("Other").parameters["posit"] == pytest.approx(500, abs=3)
    assert one.device("Axis").parameters["posit"] == 0
    assert not one.device("Axis").states["st_error"]


TWO = EXAMPLE / "two_axes.cnf", EXAMPLE / "two_axes.mod"
CONTACTORS = {"ofMotorX": "AxisX", "OFMOTORY": "axisy"}


@pytest.mark.slow
def test_a_program_leads_one_drive_to_two_motors():  # 1.4.1, Q-79; timers and a data group as well
    one = Station.of_files(*TWO, "analogue", CONTACTORS)
    ways, connected = {"x": [0.0], "y": [0.0]}, set()
    for _ in range(400):
        one.run(0.01)
        closed = one.control.outputs["2.OUT01"], one.control.outputs["2.OUT02"]
        moved = tuple(abs(float(one.bench.axis(name)["place_um"]) - way[-1]) > 0.5 for name, way in ways.items())
        assert not any(m and not c for m, c in zip(moved, closed, strict=True))  # a motor without contact stays
        connected.add(closed)
        for name, way in ways.items():
            way.append(float(one.bench.axis(name)["place_um"]))
    assert connected == {(False, False), (True, False), (False, True)}
    assert max(ways["x"]) == pytest.approx(600, abs=8)
    assert [way[-1] for way in ways.values()] == pytest.approx([200, 400], abs=3)
    assert one.control.line == 0
    for name in ("AxisX", "AxisY"):
        assert one.device(name).parameters["errcode"] == one.device(name).parameters["wrncode"] == 0


def test_a_contactor_that_the_program_leaves_open_leads_nowhere():
    program = TWO[1].read_text(encoding="utf-8")
    one = Station(TWO[0].read_text(encoding="utf-8"), program.replace("ofMotorX = 1", ""), contactors=CONTACTORS)
    one.run(1.0)
    assert one.device("AxisX").states["st_regoff"] is False  # it writes to the drive, but no motor hangs on it
    assert abs(float(one.bench.axis("x")["place_um"])) < 0.5
    both_on = program.replace("ofMotorX = 1", "ofMotorY = 1\nWAIT 1\nofMotorX = 1")
    both = Station(TWO[0].read_text(encoding="utf-8"), both_on, contactors=CONTACTORS)
    both.run(1.0)
    assert both.control.outputs == {"2.OUT01": True, "2.OUT02": True}  # the first one keeps the other open
    assert [abs(float(both.bench.axis(name)["place_um"])) > 100.0 for name in "xy"] == [False, True]


@pytest.mark.parametrize(("contactors", "reason"), [
    ({"ofMotor": "AxisX"}, "no output 'ofMotor' for a contactor; there are: ofmotorx, ofmotory"),
    ({"ofMotorX": "AxisZ"}, "no device 'AxisZ'; there are: axisx, axisy"),
    ({"ofMotorX": "AxisX"}, "axisy shares 2.AN01, whose other motors have contactors; it must have one"),
    ({"ofMotorX": "AxisX", "ofMotorY": "AxisX"}, "ofMotorY=AxisX is a second contactor"),
    ({"ofMotorX": "AxisX", "ofmotorx": "AxisY"}, "ofmotorx=AxisY is a second contactor"),
])  # fmt: skip
def test_wrong_contactors_are_refused(contactors, reason):
    with pytest.raises(InputError, match=reason):
        Station.of_files(*TWO, "analogue", contactors)


@pytest.mark.slow
@pytest.mark.parametrize(("more", "status", "said"), [
    (("--contactor", "ofMotorY=AxisY"), 0, "axisx:st_still 0"), ((), 2, "it must have one"),
    (("--contactor", "ofMotorY"), 2, "--contactor is OUTPUT=DEVICE, as ofMotorX=AxisX, not 'ofMotorY'"),
    (("--contactor", "ofMotorX=AxisY"), 2, "--contactor gives the output ofMotorX twice"),
])  # fmt: skip
def test_the_command_takes_contactors(more, status, said, piped):
    done = piped(b"", "console", "positioner", *TWO, "--contactor", "ofMotorX=AxisX", "--seconds", 0.2, *more)
    assert done.returncode == status
    assert said in "".join(done.text)


def test_the_command_presses_inputs(piped):
    presses = ("--press", "ifStart=0.1:0.2", "--press", "ifstart=0.15:0.3")
    done = piped(b"", "console", "positioner", *FILES, *presses, "--seconds", 0.5)
    assert done.returncode == 0
    assert "axis:st_still 0" in done.text[0]
    assert "0.300 s  ifstart off" in done.text[0]


def test_the_command_records_the_axes(piped, tmp_path):
    file = tmp_path / "run.rrd"
    done = piped(
        b"", "console", "positioner", *TWO, "--contactor", "ofMotorX=AxisX", "--contactor", "ofMotorY=AxisY",
        "--seconds", 1.0, "--record", file,
    )  # fmt: skip
    assert done.returncode == 0
    place_um, output = recorded_curve(file, "axisx/place_um"), recorded_curve(file, "axisx/command")
    assert len(place_um) == len(output) == pytest.approx(250, abs=2)  # samples of 4 ms
    assert max(place_um) > 100.0
    assert max(output) > 0.1
    assert not any(recorded_curve(file, "axisy/current_A")[:100])


def test_a_run_has_an_end(edmsim):
    shown = edmsim("console", "positioner", *FILES, "--seconds", "inf")
    assert (shown.status, shown.err) == (2, "edmsim: --seconds is above 0, not inf\n")


def test_the_command_lists_what_cannot_be_read(piped, tmp_path):
    (tmp_path / "a.mod").write_text("Axis:posit = 0\nspeed = 1\nGO Axis\n" + "END 1\n" * 10, encoding="utf-8")
    done = piped(b"", "console", "positioner", FILES[0], tmp_path / "a.mod")
    assert done.returncode == 2
    said = done.text[1].splitlines()
    assert "a.mod:2: speed is not a variable" in said[0]
    assert "a.mod:3: 'GO Axis' is not a statement" in said[1]
    assert said[10:] == ["edmsim: and 2 more"]


def test_bad_words_are_refused(tmp_path):
    assert press_of("ifStart=0.5:0.6") == ("ifStart", 0.5, 0.6)
    for text in ("ifStart", "=1:2", "ifStart=2:1", "ifStart=a:b", "ifStart=1:2:3"):
        with pytest.raises(InputError, match="--press is NAME=FROM:TO"):
            press_of(text)
    one = station()
    with pytest.raises(InputError, match="no input 'ifstrat'; there are: ifforward"):
        one.press("ifstrat")
    with pytest.raises(InputError, match="seconds is nan: give a finite number of 0 or more"):
        station().run(math.nan)
    with pytest.raises(InputError, match="no device 'Bxis'; there are: axis"):
        one.device("Bxis")
    with pytest.raises(InputError, match=r"a\.cnf: the section INTDEVICE declares 0 devices"):
        Station("END", "END", files=("a.cnf", "a.mod"))
    with pytest.raises(InputError, match=r"a\.mod: line 1: 1 is divided by zero"):
        Station(FILES[0].read_text(encoding="utf-8"), "slShare = 1/0", files=("a.cnf", "a.mod")).run(0.1)
    with pytest.raises(InputError, match="--press closes ifStart at 2 s, but the run ends at 1 s"):
        run_and_report(one, 1.0, [Press("ifStart", 2.0, 3.0)], print)
    with pytest.raises(InputError, match="no such file"):
        Station.of_files(tmp_path / "none.cnf", FILES[1], "analogue")
    with pytest.raises(InputError, match="no axis 'bench' with an amplifier; choose one of analogue, analogue-table"):
        Station.of_files(*FILES, "bench")
