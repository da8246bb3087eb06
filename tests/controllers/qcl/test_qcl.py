"""QCL texts that cannot be read, expressions, statements, and what a program does at run time."""

import pytest

from edmsim.controllers.qcl import Control, QclError, read_configuration, read_program
from edmsim.errors import InputError

HEAD = "BUS\n1 1CPUD 01\n2 1MIXA 00\n3 2MIXA 01\n"


def declared(line):
    return read_configuration(f"{HEAD}INTDEVICE\n{line}\nEND")


def test_the_second_declaration_of_the_manual():
    device = declared("Axis_X EANPOS 2 2.CNT02 3 3.INP01 3.AN01").devices["axis_x"]
    assert device == ("axis_x", 2, "2.CNT02", 3, "3.INP01", "3.AN01")
    assert device.resources == (True, True, True, True)
    bare = declared("A EANPOS 0255 X.X X X.X X.X").devices["a"]
    assert bare.tcamp_ms == 255
    assert bare.resources == (False, False, False, False)


@pytest.mark.parametrize(("line", "reason"), [
    ("A EANPOS 0 2.CNT02 3 3.INP01 3.AN01", "TCamp of A is '0'; it must be 1 to 255 ms"),
    ("A EANPOS 256 2.CNT02 3 3.INP01 3.AN01", "TCamp of A is '256'"),
    ("A EANPOS 2 2.CNT02 0 3.INP01 3.AN01", "IntL of A is '0'; it must be 1 to 8, or X"),
    ("A EANPOS 2 2.CNT02 9 3.INP01 3.AN01", "IntL of A is '9'"),
    ("A EANPOS 2 2.CNT02 3\n3.INP01 3.AN01", "all on one line"),
    ("A EANPOS 2 2.INP02 3 3.INP01 3.AN01", "'2.INP02' is not an address; it must be SLOT.CNTNN"),
    ("A EANPOS 2 4.CNT02 3 3.INP01 3.AN01", "slot 4, which has no card"),
    ("A CAMMING 2 2.CNT02 3 3.INP01 3.AN01", "A is a CAMMING"),
    ("2A EANPOS 2 2.CNT02 3 3.INP01 3.AN01", "'2A' is not a name"),
])  # fmt: skip
def test_a_wrong_declaration_is_refused(line, reason):
    with pytest.raises(QclError, match=r"QCL:\d+: .*") as refused:
        declared(line)
    assert reason in str(refused.value)


@pytest.mark.parametrize(("text", "reason"), [
    ("GLOBAL\na L\nA F", "A is declared twice"), ("SYSTEM\na X", "a has size 'X'; it must be F, B, W, L or S"),
    ("CONST\na 1.5", "it must be a whole number"), ("TIMER\nt 10", "'t 10' must be NAME, all on one line"),
    ("TIMER\nt\nt", "t is declared twice"), ("GLOBAL\nnot L", "'not' is a word of the language"),
    ("DATAGROUP\nSTEP", "STEP comes before the name of its data group"),
    ("DATAGROUP\ng\nplace L", "'place L' comes before DATAPROGRAM"),
    ("DATAGROUP\ng\nSTEP\n4\nplace L", "STEP comes before DATAPROGRAM"),
    ("DATAGROUP\ng\nDATAPROGRAM\nspeed L", "DATAPROGRAM is followed by 'speed L'; it must be how many there are"),
    ("DATAGROUP\ng\nDATAPROGRAM\n0", "DATAPROGRAM is followed by '0'; it must be how many there are, 1 to 65534"),
    ("DATAGROUP\ng\nDATAPROGRAM\n2\nSTEP\n65535", "STEP is followed by '65535'"),
    ("GLOBAL\nspeed L\nDATAGROUP\ng\nDATAPROGRAM\n2\nspeed L", "speed is declared twice"),
    ("BUS\n1 card", "must be SLOT CARD VERSION"), ("BUS\n1 a 0\n1 b 0", "slot 1 is declared twice"),
    ("BUS\n1 a 0\nINPUT\ni L 1.INP01", "is a flag, F"), ("stray", "comes before the first section"),
])  # fmt: skip
def test_a_wrong_configuration_is_refused(text, reason):
    with pytest.raises(QclError) as refused:
        read_configuration(text)
    assert reason in str(refused.value)


def test_sections_and_sizes_may_be_written_small():
    small, great = (read_configuration(text) for text in ("global\na l\nsystem\nb f", "GLOBAL\na L\nSYSTEM\nb F"))
    assert small.variables == great.variables
    assert [small.variables[name].size for name in "ab"] == ["L", "F"]


DECLARED = read_configuration(
    f"CONST\nseven 7\nGLOBAL\na L\nb L\nf F\nw B\n{HEAD}INTDEVICE\nAxis EANPOS 4 2.CNT01 1 2.INP01 2.AN01\nEND"
)


def run(*lines, passes=1):
    control = Control(DECLARED, read_program("\n".join(lines), DECLARED))
    for _ in range(passes):
        control.run_pass()
    return control


@pytest.mark.parametrize(("text", "value"), [
    ("(10*99999)/100", 9999), ("-(7)/2", -3), ("7/-2", -3), ("2+3*4-6/3", 12), ("-5+seven", 2),
    ("1 EQ 1", 1), ("2 NE 2", 0), ("3 GT 2 AND 2 GE 2", 1), ("1 LT 1 OR 1 LE 1", 1), ("NOT 0", 1),
    ("NOT (1 OR 0)", 0), ("NOT NOT 5", 1), ("NOT 1 EQ 2", 1), ("1 or 0 And 0", 1), ("((4))", 4),
])  # fmt: skip
def test_expressions(text, value):
    assert run(f"a = {text}").variables["a"] == value


def test_if_else_and_jump():
    lines = ["a = 0", "AGAIN:", "IF a LT 3 ;nested", " IF b EQ 2", "  b = 0", " ELSE", "  b = b + 1", " ENDIF",
             " a = a + 1", " JUMP AGAIN", "ELSE", " f = 1", "ENDIF", "END", "a = 99"]  # fmt: skip
    control = run(*lines)
    assert (control.variables, control.line) == ({"a": 3, "b": 0, "f": 1, "w": 0}, 0)


TIMED = read_configuration(
    "CONST\nmany 3\nSYSTEM\nkept L\nGLOBAL\na L\nb L\nTIMER\ntmPause\ntmOther\nDATAGROUP\ndgParts\n"
    "DATAPROGRAM\nMany\nspeed B\ngood F\nSTEP\n4\nplace L\ndgOthers\nDATAPROGRAM\n2\nother W\nEND"
)


def timed(*lines):
    return Control(TIMED, read_program("\n".join(lines), TIMED))


def test_a_timer_runs_for_its_time_and_reports_when_it_is_over():
    control = timed("a = tmPause", "tmPause = 250", "b = tmPause", "WAIT tmPause", "a = 2", "WAIT 0")
    control.now_ms = 1000
    control.run_pass()
    assert (control.variables["a"], control.variables["b"]) == (1, 0)  # over before it was given a time, then not
    for now_ms, a in ((1249, 1), (1250, 1), (1251, 2)):  # the pass that finds it over ends there
        control.now_ms = now_ms
        control.run_pass()
        assert control.variables["a"] == a
    again = timed("tmPause = 100", "tmOther = 20", "tmPause = 10", "WAIT NOT tmOther AND tmPause", "a = 1")
    for again.now_ms in (0, 9, 10, 11):
        again.run_pass()
    assert again.variables["a"] == 1  # a time that is given again counts from then, and timers do not disturb others
    with pytest.raises(InputError, match="line 1: the timer tmpause cannot run for -1 ms; it must be 0 to"):
        timed("tmPause = -1").run_pass()


def test_a_data_group_keeps_values_by_recipe_and_step():
    control = timed(
        "a = 2", "speed[1] = 10", "speed[a] = speed[a - 1] + 5", "place[a, many] = 70 * speed[a]", "good[3] = 1",
        "b = place[2, 3] + place[2, 4]", "a = (speed[1] + speed[2]) * good[1 + 2]", "other[2] = -5",
        "kept = other[2]",
    )  # fmt: skip
    control.run_pass()
    assert (control.variables["a"], control.variables["b"], control.variables["kept"]) == (25, 1050, -5)
    assert control.data["place", 2, 3] == 1050
    control.restart()  # data groups outlast the power
    assert control.data["speed", 2, 0] == 15
    assert control.variables == {"kept": -5, "a": 0, "b": 0}


@pytest.mark.parametrize(("line", "reason"), [
    ("speed[4] = 1", "speed has no recipe 4; it must be 1 to 3"), ("a = speed[0]", "speed has no recipe 0"),
    ("a = place[3, 5]", "place has no step 5; it must be 1 to 4"), ("speed[1] = 128", "speed cannot hold 128"),
    ("good[1] = 2", "good cannot hold 2; it must be 0 to 1"), ("kept = 2147483648", "kept cannot hold 2147483648"),
    ("a = place[1/0, 1]", "divided by zero"),
])  # fmt: skip
def test_a_data_groups_errors_name_their_line(line, reason):
    with pytest.raises(InputError, match=f"line 2: .*{reason}"):
        timed("a = 1", line).run_pass()


@pytest.mark.parametrize(("line", "reason"), [
    ("speed = 1", r"speed is a data group's variable; it is written speed\[recipe\]"),
    ("a = place[1]", r"it is written place\[recipe, step\]"), ("a = speed[1, 2]", r"written speed\[recipe\]"),
    ("a = speed[1", r"written speed\[recipe\]"), ("speed[1] 2 = 3", "'2' is left over before ="),
    ("dgParts = 1", "dgParts is not a variable"), ("a = dgParts", "dgParts is not a name"),
    ("a[1] = 2", "cannot be assigned to"), ("= a = 2", "cannot be assigned to"),
    ("a = b[1]", r"'\[ 1 \]' is left over"),
])  # fmt: skip
def test_a_data_groups_variable_needs_its_indices(line, reason):
    with pytest.raises(QclError, match=reason):
        timed(line)


def test_wait_gives_up_the_pass():
    control = run("a = 1", "WAIT 1", "a = 2", "WAIT b EQ 1", "a = 3", passes=2)
    assert (control.variables["a"], control.line) == (2, 4)
    control.run_pass()
    assert control.line == 4
    control.variables["b"] = 1
    control.run_pass()
    control.run_pass()
    assert (control.variables["a"], control.line) == (3, 0)


def test_a_loop_without_wait_ends_its_pass():
    control = run("ON:", "a = a + 1", "JUMP ON")
    assert 1000 < control.variables["a"] < 10_000


@pytest.mark.parametrize(("line", "reason"), [
    ("c = 1", "c is not a variable or output"), ("a = c", "c is not a name"), ("Axis = 1", "Axis is not a variable"),
    ("seven = 8", "seven is not a variable"), ("a = Axis", "Axis is not a name"), ("START a", "a is not a device"),
    ("GO Axis", "'GO Axis' is not a statement"), ("Axis:speed = 1", "no parameter 'speed'"),
    ("; nothing", "the program has no statements"), ("Axis:st_still = 1", "no parameter 'st_still'"),
    ("a = Axis:st_moving", "no state 'st_moving'"), ("Bxis:setpos = 1", "Bxis is not a device"),
    ("a = (1", "a bracket is not closed"), ("a = 1)", "')' is left over"), ("a = 1 +", "an expression ends early"),
    ("a = * 2", "'*' is not a value"), ("a = 1.5", "is not a word of QCL"), ("IF a", "IF without ENDIF"),
    ("ENDIF", "ENDIF without IF"), ("ELSE", "ELSE without IF"), ("IF a\nELSE\nELSE\nENDIF", "ELSE without IF"),
    ("JUMP AWAY", "no label 'away'"), ("M:\nM:", "is defined twice"), ("WAIT", "an expression ends early"),
])  # fmt: skip
def test_a_wrong_statement_is_refused(line, reason):
    with pytest.raises(QclError) as refused:
        read_program(line, DECLARED, "task.mod")
    assert reason in str(refused.value)
    assert str(refused.value).startswith("task.mod:")
