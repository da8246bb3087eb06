"""Offsets by register, from the program or a file; subprograms in place of their calls."""


import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from edmsim.errors import InputError
from edmsim.program import load_program, plan_path
from edmsim.program.tables import read_offsets

SQUARE = "G21 G92 X5 Y-2.\n{}\nG41 {} G1 X5 Y0\nX0\nY8\nX10\nY0\nX5\nG40 Y-2\nM02\n"


def plan(folder, text, offset="auto", table=None):
    (folder / "a.ngc").write_text(text)
    if table is not None:
        (folder / "table.toml").write_text(table)
    program = load_program(folder / "a.ngc", offsets=None if table is None else folder / "table.toml")
    return plan_path(program, offset, auto_offset_mm=0.2)


@pytest.mark.parametrize(("define", "call", "table", "offset_um"), [
    ("D1=0.155", "D1", None, 155.0), ("H001 = +000000.1450 (as some controls write it)", "H1", None, 145.0),
    ("", "D01", "D1 = 0.16  # rough cut\nD2 = 0.13\n", 160.0), ("D1=0.15", "D1", "D1 = 0.16\n", 150.0),
    ("G20\nD1=0.01\nG21", "D1", None, 254.0), ("", "D1", None, 200.0), ("D1=0.155", "", None, 200.0),
    ("G10 L12 P1 R0.155", "D1", None, 155.0), ("G10 L10 P2 R0.145", "H02", None, 145.0),
    ("G10 P1 R.15", "D1", "D1 = 0.16\n", 150.0), ("G20 G10 P1 R0.01\nG21", "H1", None, 254.0),
])  # fmt: skip
def test_the_register_is_the_offset(tmp_path, define, call, table, offset_um):


    path = plan(tmp_path, SQUARE.format(define, call), table=table)
    assert path.offset_um == pytest.approx(offset_um)
    (contour,) = path.contours
    wire = shapely.LineString(contour.points_um[contour.lead_in_moves :])
    edge = shapely.LineString(contour.nominal_mm * 1e3)
    assert wire.distance(edge) == pytest.approx(offset_um, abs=1.0)


def test_whole_um_count_for_registers_as_well(tmp_path):
    text = SQUARE.replace("-2.", "-2000").replace("Y-2\n", "Y-2000\n").format("D1=155", "D1")
    for short, long in (("X5", "X5000"), ("Y8", "Y8000"), ("X10", "X10000")):
        text = text.replace(f"{short}\n", f"{long}\n").replace(f"{short} ", f"{long} ")
    assert plan(tmp_path, text).offset_um == pytest.approx(155.0)


def test_an_offset_that_was_requested_wins_with_a_notice(tmp_path):
    path = plan(tmp_path, SQUARE.format("D1=0.155", "D1"), offset=0.16)
    assert path.offset_um == 160.0
    assert "the offset is 0.16 mm, as requested, not the 0.155 mm of the register" in path.notices


TWO_HOLES = """\
D1=0.16
D2=0.2
G92 X0 Y0
G42 D1 G1 X1. Y0
G2 X1. Y0 I-1. J0
G0 {x} Y0
G42 {second} G1 G91 X1.
G2 X0 Y0 I-1. J0
M02
"""


def test_contours_have_the_offsets_of_their_registers(tmp_path):
    path = plan(tmp_path, TWO_HOLES.format(x="X5.", second="D2"))
    assert path.offset_um is None
    assert [contour.offset_um for contour in path.contours] == [160.0, 200.0]
    for contour, radius_um in zip(path.contours, (840.0, 800.0), strict=True):
        away = np.hypot(*(contour.points_um[contour.lead_in_moves :] - contour.nominal_mm.mean(axis=0) * 1e3).T)
        assert away == pytest.approx(radius_um, abs=15.0)  # the mean of the chords' ends is only near the centre
    assert "offset 160, 200 um" in repr(path)
    requested = plan(tmp_path, TWO_HOLES.format(x="X5.", second="D2"), offset=0.18)
    assert requested.offset_um == 180.0
    assert "the offset is 0.18 mm, as requested, not the 0.16, 0.2 mm of the register" in requested.notices


def test_a_register_that_is_set_again_holds_from_there(tmp_path):
    path = plan(tmp_path, TWO_HOLES.format(x="X5.", second="G10 L12 P1 R0.2\nG1 D1").replace("G42 G10", "G42\nG10"))
    assert [contour.offset_um for contour in path.contours] == [160.0, 200.0]


def test_the_same_edge_at_a_larger_offset_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"the offset grows from pass 1 to pass 2, 0\.16 to 0\.2 mm") as refused:
        plan(tmp_path, TWO_HOLES.format(x="X0", second="D2"))
    assert refused.value.line == 8
    assert len(plan(tmp_path, TWO_HOLES.format(x="X5.", second="D1")).contours) == 2


@pytest.mark.parametrize(("text", "line", "named"), [
    (SQUARE.format("D1=0.155", "D2"), 3, "D2 is not in the table: there are D1"),
    (SQUARE.format("D1=0.155 H2=0.1", "D1 H2"), 3, "D1 and H2 are both offsets"),
    (SQUARE.format("D1=-0.155", "D1"), 2, "the offset D1 is -0.155 mm"),
    (SQUARE.format("D1=0.155 D2=0.15", "D1").replace("\nX0\n", "\nX0 D2\n"), 4, "D1 0.155 mm to D2 0.15 mm"),
    (SQUARE.format("G10 L2 P1 X0 Y0", "D1"), 2, "G10 L2 is not read"),
    (SQUARE.format("G10 L12 P1", "D1"), 2, "G10 L12 P1 R0.155"),
    (SQUARE.format("G10 L12 P1.5 R0.1", "D1"), 2, "G10 needs the register's number as P"),
    (SQUARE.format("G10 L12 P1 R12.", "D1"), 2, "the offset D1 is 12 mm"),
])  # fmt: skip
def test_registers_that_make_no_sense(tmp_path, text, line, named):
    with pytest.raises(InputError, match=named) as refused:
        plan(tmp_path, text)
    assert refused.value.line == line


@pytest.mark.parametrize(("text", "named"), [
    ("D1 is 0.1", "lines as D1 = 0.155"), ("X1 = 0.1", "'X1'"), ("D1 = 'thick'", "'thick'"), ("D1 = -1", "-1"),
    ("D1 = true", "True"), ("D1 = nan", "nan"), ("D1 = 0.155\nd01 = 0.2", "the offset D1 occurs twice"),
])  # fmt: skip
def test_tables_that_make_no_sense(tmp_path, text, named):
    (tmp_path / "table.toml").write_text(text)
    with pytest.raises(InputError, match=named):
        read_offsets(tmp_path / "table.toml")
    with pytest.raises(InputError, match="no such file"):
        read_offsets(tmp_path / "no.toml")


@pytest.mark.slow
@given(st.dictionaries(st.integers(0, 9999), st.floats(0, 10), max_size=20))
def test_a_table_is_read_as_it_is_written(tmp_path_factory, table):
    file = tmp_path_factory.mktemp("table") / "table.toml"
    file.write_text("".join(f"h{number:04} = {value!r}\n" for number, value in table.items()))
    assert read_offsets(file) == {f"H{number}": value for number, value in table.items()}


HOLE = "G91 G1 X1.5\nG3 X0 Y0 I-1.5 J0\nG0 X3.5\n"


def test_a_subprogram_is_cut_where_and_as_often_as_it_is_called(read):
    called = read(f"%\nO1\nG92 X0 Y0\nG42 D1\nM98 P100 L3\nM30\nO0100\n{HOLE}M99\n%\n")
    spelt = read("G92 X0 Y0\nG42 D1\n" + 3 * HOLE + "M30\n")
    assert len(called.outlines) == 3
    for one, other in zip(called.outlines, spelt.outlines, strict=True):
        assert np.array_equal(one.points_mm, other.points_mm)
        assert one.wire_side == other.wire_side
    assert not any("left out" in notice or "M98" in notice for notice in called.notices)
    assert called.outlines[2].line_numbers[0] == 9


def test_subprograms_call_others_and_idle_ones_are_named(read):
    text = f"G92 X0 Y0\nM98 P1\nM2\nO1\nM98 P2\nM98 P2\nM99\nO2\n{HOLE}M99\nO3\nG4 P1\nM99\n"
    program = read(text)
    assert len(program.outlines) == 2
    assert "line 13: subprogram O3 is never called" in program.notices


@pytest.mark.parametrize(("text", "line", "named"), [
    ("M98 P7\nM2\nO8\nG4 P1\nM99\n", 1, "no subprogram O7 after the end of the program; there are: O8"),
    ("M98 P7\nM2\n", 1, "there are: none"), ("M98\nM2\n", 1, "M98 needs the number"),
    ("M98 P1 X3\nM2\n", 1, "M98 needs the number"), ("M98 P1 L0\nM2\nO1\nM99\n", 1, "L0"),
    ("M98 P1\nM2\nO1\nM98 P1\nM99\n", 4, "O1 calls itself"),
    ("M98 P1\nM2\nO1\nG1 X1\n", 3, "O1 has no M99 at its end"),
    ("M98 P1\nM2\nO1\nG1 X1\nO2\nM99\n", 5, "O1 has no M99 before O2 begins"),
    ("M98 P1\nM2\nO1\nM99\nO1\nM99\n", 5, "O1 occurs twice"),
    ("M98 P1\nM2\nG1 X1\n", 3, "begin them with their O number"), ("G1 X1\nM99\n", 2, "M99 ends a subprogram"),
    ("G1 X1 L2\nM2\n", 1, "L2 is given without G10 or M98"), ("M98 P1\nM2\nO1\nV3\nM99\n", 4, "unknown word 'V3'"),
])  # fmt: skip
def test_calls_that_make_no_sense(read, text, line, named):
    with pytest.raises(InputError, match=named) as refused:
        read(text)
    assert refused.value.line == line


def test_calls_of_calls_do_not_grow_without_end(read):
    text = "M98 P1 L999\nM2\n" + "".join(f"O{k}\nM98 P{k + 1} L999\nM99\n" for k in range(1, 9)) + "O9\nG4 P1\nM99\n"
    with pytest.raises(InputError, match="too many"):
        read(text)


def test_without_calls_what_stands_behind_the_end_is_left_out_as_ever(read):
    program = read("G92 X0 Y0\nG1 X5\nM2\nO1\nanything\n")
    assert any("text after the end of the program" in notice for notice in program.notices)


def test_registers_that_are_always_in_um_need_no_unit_before_them(read):
    text = "H001 = 115;\nG20;\nG92 X0 Y0;\nG41 H001;\nG1 X.1;Y.1;X.3;Y0;X.1;\nG40;\n{}M02;\n"
    inches = read(text.format(""), dialect="skd2")
    assert not any("read in inches" in notice for notice in inches.notices)
    both = read(text.format("G21;\n"), dialect="skd2")  # would be refused if the register had a unit
    assert [program.outlines[0].offset_mm for program in (inches, both)] == [0.115, 0.115]


def test_the_program_ends_at_m02_where_other_blocks_follow_on_its_line(read):
    program = read("G92 X0 Y0; G1 X5.; M02; G0 X9.; G1 X8.;\n", dialect="skd2")
    assert len(program.outlines) == 1
    assert program.outlines[0].points_mm[-1].tolist() == [5.0, 0.0]
    assert any("line 1: text after the end of the program" in notice for notice in program.notices)
    called = read("G92 X0 Y0; M98 P1; M02; O1; G1 X5.; M99;\n", dialect="skd2")
    assert called.outlines[0].points_mm[-1].tolist() == [5.0, 0.0]
