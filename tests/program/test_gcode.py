"""Reading of G-code: geometry, notices of decisions, and refusal of unclear programs."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmsim.errors import InputError
from edmsim.program.gcode_outlines import read_gcode
from edmsim.program.outline import signed_area

SQUARE = "G92 X5 Y-2\nG41 D0 G1 X5 Y0\nX0\nY8\nX10\nY0\nX5\nG40 Y-2\nM02\n"


def only(program):
    assert len(program.outlines) == 1
    return program.outlines[0]


def refusal(read, text, line, *words):
    with pytest.raises(InputError) as caught:
        read(text)
    assert caught.value.line == line
    assert caught.value.file is not None
    for word in words:
        assert word in caught.value.reason
    return caught.value


def test_a_compensated_square_with_lead_in_and_lead_out(read):
    program = read(SQUARE)
    outline = only(program)
    assert outline.points_mm.tolist() == [[5, 0], [0, 0], [0, 8], [10, 8], [10, 0], [5, 0]]
    assert outline.approach_mm.tolist() == [[5, -2]]
    assert outline.line_numbers == (3, 4, 5, 6, 7)
    assert (outline.closed, outline.wire_side, outline.part_side) == (True, "left", "right")
    assert any("line 8" in notice and "lead-out" in notice for notice in program.notices)


VARIANTS = [
    SQUARE.lower(), SQUARE.replace("\n", "\r\n"), SQUARE.replace(" ", ""),
    SQUARE.replace("X", "X ").replace("Y", " Y "), "\ufeff%\n" + SQUARE + "%\n", "%PART 12 (any text) ?\n" + SQUARE,
    "".join(f"N{10 * i}{block}\n" for i, block in enumerate(SQUARE.splitlines())),
    SQUARE.replace("\n", " (a comment; X99)\n"), SQUARE.replace("\n", " ; a comment (X99\n"),
    SQUARE.replace("G1", "G01").replace("G41", "G041").replace("M02", "M2"),
    SQUARE.replace("M02", "M30END OF PART 7"), SQUARE.replace("M02", "M02%"),
    SQUARE.replace("X5", "X+5.0").replace("Y-2", "Y-2.").replace("X10", "X10.000"),
    "\n\n" + SQUARE + "anything goes here $$\n",
]  # fmt: skip


@pytest.mark.parametrize("text", VARIANTS)
def test_the_way_of_writing_does_not_matter(read, text):
    assert np.array_equal(only(read(text)).points_mm, only(read(SQUARE)).points_mm)


moves = st.lists(st.tuples(st.integers(-400, 400), st.integers(1, 400)), min_size=2, max_size=12)


@pytest.mark.slow
@given(moves=moves)
def test_incremental_and_absolute_give_the_same_path(tmp_path_factory, moves):
    folder = tmp_path_factory.mktemp("g91")
    points = np.cumsum(moves, axis=0) / 100
    absolute = "G90 G0 X0 Y0\n" + "".join(f"G1 X{x:.2f} Y{y:.2f}\n" for x, y in points)
    incremental = "G91\n" + "".join(f"G1 X{x / 100:.2f} Y{y / 100:.2f}\n" for x, y in moves)
    outlines = []
    for text in (absolute, incremental):
        file = folder / f"{len(outlines)}.ngc"
        file.write_text(text)
        outlines.append(only(read_gcode(file)).points_mm)
    assert np.allclose(outlines[0], outlines[1], atol=1e-9)


@pytest.mark.parametrize(("text", "end_mm", "said"), [
    ("G20 G0 X0 Y0\nG1 X1. Y.5\n", [25.4, 12.7], ""),
    ("G0 X0 Y0\nG1 X20\nG1 Y10\n", [20, 10], "read as mm"),  # whole numbers that fit the table
    ("G0 X100 Y100\nG1 X110\nG1 Y120\n", [110, 120], "read as mm"),  # also if far from zero
    ("G91\nG1 X400\nX400\nY-300\n", [0.8, -0.3], "read as whole um"),
])  # fmt: skip
def test_the_unit_of_a_program(read, text, end_mm, said):
    program = read(text)
    assert only(program).points_mm[-1].tolist() == pytest.approx(end_mm)
    assert any("read as" in notice and said in notice for notice in program.notices) is bool(said)


def test_numbers_with_and_without_a_point_are_reported_where_those_without_may_be_um(read):
    text = "G0 X0 Y0\nG1 X200\nG1 Y1.5\n"
    program = read(text)
    assert only(program).points_mm[-1].tolist() == [200, 1.5]
    said = "this block has a decimal point, line 2 none, and the coordinates span 200"
    assert f"line 3: {said}: all are read as mm" in program.notices
    refusal(read, text.replace("200", "2000"), 3, f"{said}0: too much in mm; write all with decimal points")
    refusal(read, text.replace("200", "500"), 3, f"{said.replace('200', '500')}: too much in mm")  # as without points
    assert not any("decimal" in notice for notice in read(text.replace("200", "20")).notices)


def test_g92_in_mid_program_shifts_what_follows(read):
    outline = only(read("G92 X1. Y1.\nG1 X3.\nG92 X0 Y0\nG1 X2. Y4.\nG92 X5.\nG1 X6.\n"))
    assert outline.points_mm.tolist() == [[1, 1], [3, 1], [5, 5], [6, 5]]


def test_bare_g92_in_mid_program_is_reported(read):
    program = read("G92 X1. Y1.\nG1 X3.\nG92\nG1 X2. Y4.\n")
    assert only(program).points_mm[-1].tolist() == [5, 5]
    assert any("line 3" in notice and "G92" in notice for notice in program.notices)


def test_stops_feed_registers_and_idle_codes_are_reported_once_each(read):
    program = read("G17 G21 G60\nG38\nG39\nM28\nG0 X0 Y0\nD3\nM0\nM01\nG1 X5.5 F12\nG1 Y2 F12\n")
    for what in ("G60", "G38", "G39", "M28", "M0 ", "M1 ", "F12", "D3"):
        assert sum(what in notice for notice in program.notices) == 1, what
    assert any("(2 times)" in notice for notice in program.notices if "F12" in notice)


@pytest.mark.parametrize("begin", ["/", "/2 ", "N10 / ", "N10 /1 "])
def test_block_delete_is_switched_off_and_says_so(read, begin):
    program = read(f"G0 X0 Y0\n{begin}G1 X5.5\nG1 Y2\n")
    assert len(only(program).points_mm) == 3
    assert any("line 2" in notice and "block delete" in notice for notice in program.notices)


def test_contours_joined_by_rapids(read):
    ring = "G1 X{0} Y1\nX{0} Y4\nX{1} Y4\nX{1} Y1.0\n"
    program = read("G42 D0\nG0 X1 Y1\n" + ring.format(4, 1) + "G0 X11 Y1\n" + ring.format(14, 11) + "M30\n")
    assert [outline.points_mm[0].tolist() for outline in program.outlines] == [[1, 1], [11, 1]]
    assert all(outline.closed and outline.wire_side == "right" for outline in program.outlines)
    assert all(outline.needs_lead_in and not len(outline.approach_mm) for outline in program.outlines)


def test_compensation_switched_on_at_the_thread_point_makes_the_first_move_the_approach(read):
    outline = only(read("G0 X0 Y0\nG41 G1 X5.5\nY10\nX9\n"))
    assert outline.approach_mm.tolist() == [[0, 0]]
    assert outline.points_mm.tolist() == [[5.5, 0], [5.5, 10], [9, 10]]


def test_an_uncompensated_approach_before_g41(read):
    outline = only(read("G92 X0 Y-5\nG1 Y-3.5\n" + SQUARE.split("\n", 1)[1]))
    assert outline.approach_mm.tolist() == [[0, -5], [0, -3.5]]
    assert outline.points_mm[0].tolist() == [5, 0]


ARC_RELATIVE = "G0 X20 Y10\nG3 X20 Y10 I-5.0 J0\n"


def test_a_full_circle_as_one_arc_or_two(read):
    one = only(read(ARC_RELATIVE))
    two = only(read("G0 X20 Y10\nG3 X10 Y10 I-5.0 J0\nG3 X20 Y10 I5 J0\n"))
    for outline in (one, two):
        assert outline.closed
        assert signed_area(outline.points_mm) == pytest.approx(25 * math.pi, rel=1e-3)
        radius = np.hypot(*(outline.points_mm - [15, 10]).T)
        assert np.allclose(radius, 5, atol=1e-9)


@pytest.mark.parametrize(("second", "times"), [("I15. J10", " (2 times)"), ("I5 J0", "")])
def test_absolute_arc_centres_are_found_out_and_reported(read, second, times):
    program = read(f"G0 X20 Y10\nG3 X10 Y10 I15.0 J10\nG3 X20 Y10 {second}\n")
    assert signed_area(only(program).points_mm) == pytest.approx(25 * math.pi, rel=1e-3)
    assert [notice for notice in program.notices if "absolute" in notice] == [
        f"line 2: I J are taken as an absolute arc centre, because start and end radius agree only then{times}"
    ]


@pytest.mark.parametrize(("before", "centre"), [("", (25, 0)), ("G3 X20. Y0 I15. J0\n", (15, 0))])
def test_an_arc_that_fits_both_ways_follows_the_others_and_says_so(read, before, centre):
    begin = "G0 X10. Y0\n" if before else "G0 X20. Y0\n"
    text = begin + before + "G0 X20. Y0.0\nG3 X20. Y0 " + ("I15. J0\n" if before else "I5. J0\n")
    program = read(text)
    circle = program.outlines[-1].points_mm
    assert circle.mean(axis=0) == pytest.approx(centre, abs=0.2)
    meant = "absolute" if before else "relative"
    assert any(f"fit both as relative and as absolute centre: taken as {meant}" in n for n in program.notices)


@pytest.mark.parametrize("code", ["G2", "G3"])
def test_arcs_by_radius(read, code):
    short = only(read(f"G0 X0 Y0\n{code} X10 Y0 R10.0\n")).points_mm
    turn = 1 if code == "G3" else -1
    assert np.sign(short[1:-1, 1]).tolist() == [-turn] * (len(short) - 2)
    assert abs(short[:, 1]).max() == pytest.approx(10 - math.sqrt(75), abs=1e-2)


def test_a_program_in_whole_um(read):
    program = read("G92\nG42 D0\nG90\nG0 X5000 Y3000\nG1 X7000\nG2 Y1000 I7000 J2000\n"
                   "G1 X3000\nG2 Y3000 I3000 J2000\nG1 X5000\nM02\n")
    points = only(program).points_mm
    assert np.ptp(points, axis=0).tolist() == pytest.approx([6, 2], abs=2e-3)
    assert abs(signed_area(points)) == pytest.approx(8 + math.pi, rel=1e-3)
    assert any("whole um" in notice for notice in program.notices)


BAD = [
    ("G0 X0 Y0\nG1 X5 Y\n", 2, "'Y'"), ("G0 X0 Y0\nG1 X5 $\n", 2, "$"),
    ("G0 X0 Y0\nG1 X5 (not closed\n", 2, "("), ("G0 X0 Y0\nG18\nG1 X5\n", 2, "G18"),
    ("G0 X0 Y0\nG41.1 X5\n", 2, "G41.1"), ("G0 X0 Y0\nM99\n", 2, "M99"), ("G0 X0 Y0\nG1 X5 X6\n", 2, "twice"),
    ("G0 X0 Y0\nG0 G1 X5\n", 2, "G0 G1"), ("G0 X0 Y0\nG90 G91 X5\n", 2, "G90 G91"), ("X5 Y5\n", 1, "how to move"),
    ("G0 X0 Y0\nG1 X5 I3\n", 2, "I, J or R"), ("G0 X0 Y0\nG1 X5 P3\n", 2, "P"), ("G0 X0 Y0\nG4\n", 2, "seconds"),
    ("G0 X0 Y0\nG4 P-1\n", 2, "seconds"), ("G92 X0 Y0 I3\n", 1, "G92"), ("G0 X0 Y0\nG2 X5.0 Y5\n", 2, "centre"),
    ("G0 X0 Y0\nG2 X5.0 Y5 I1 J1 R3\n", 2, "centre"), ("G0 X0 Y0\nG2 X9.0 Y0 R3\n", 2, "9.0000 mm"),
    ("G0 X0 Y0\nG2 X9.0 Y0 I3 J0\n", 2, "3.0000", "6.0000"),
    ("G0 X1 Y1\nG2 X9.0 Y0 I3 J0\n", 2, "relative", "absolute"), ("G0 X0 Y0\nG41 G1 X5.5\n", 2, "approach"),
    ("G41 D0\nG0 X0 Y0\nG1 X9.5\nY9\nX0\nY0.02\n", 6, "0.020 mm"),
    (SQUARE.replace("X10\n", "G42 X10\n"), 5, "compensation"), (SQUARE.replace("M02", "X30\nY30\n"), 8, "3 moves"),
    ("G0 X0 Y0\nM50\nG1 X5.5\n", 3, "cut off since M50 on line 2"),
    ("G54 G0 X0 Y0\nG1 X5.5\nG55 G0 X9\n", 3, "G54 and G55"), ("G0 X0 Y0\nG1 X1O5\n", 2, "'O5'"),
    ("G0 X0 Y-5.\nG41 G1 X0 Y0\nX10 Y10\nY0\nX0 Y10\nY0\n", 5,
     "crosses or retraces itself at X5.000 Y5.000 (lines 3 and 5)"),
    ("G0 X0 Y0\nG1 X5.5 Y5\nX10\nY10\nX5.5 Y5\nX0 Y10\nX-3\nY0\n", 6, "met itself at X5.500 Y5.000 (lines 3 and 5)"),
    ("G0 X0 Y0\nG1 X9.5\nX4\nY3\n", 3, "lines 2 and 3"),
    ("G42\nG0 X0 Y0\nG1 X9.5 Y9\nX9\nX0\nX3.5 Y0\nY20\nX0.5\n", None, "crosses"),
    ("G0 X0 Y0\nG1 X100\n", None, "too much in mm"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "line", "words"), [(text, line, words) for text, line, *words in BAD])
def test_bad_programs_are_refused_with_their_line(read, text, line, words):
    if line is None:
        with pytest.raises(InputError, match=words[0]):
            read(text)
    else:
        refusal(read, text, line, *words)


@pytest.mark.parametrize("text", ["", "\n\n", "(only a comment)\n", "%\n%\n", "N10\n", "G0 X1 Y1\nM30\n"])
def test_programs_that_cut_nothing_are_refused(read, text):
    with pytest.raises(InputError, match=r"empty|nothing"):
        read(text)


def test_words_that_cannot_change_a_contour_are_read_and_reported(read):
    idle = "O1234\nT84 T85\nG54 G71 G80 G90\nM60\nS1 C003 H0 Z20.\nM80 M82 M84\n"
    program = read(idle + SQUARE.replace("M02", "M50\nM02"))
    assert np.array_equal(only(program).points_mm, only(read(SQUARE)).points_mm)
    for what in ("G54", "G71", "G80", "M60", "M50", "M80", "M82", "M84", "register H0", *(
        f"word {letter} " for letter in "OTSCZ"
    )):  # fmt: skip
        assert sum(what in notice for notice in program.notices) == 1, what


def test_all_unknown_words_of_a_file_stand_in_one_list(read):
    text = "G0 X0 Y0\nG51 A2\nG1 X5.5 U1. V2\nM77\nX9 U2\n"
    found = refusal(read, text, 2, "words 'G51' (line 2), 'A2'", "'U1.' (line 3)", "'M77'", "'U2'", "--ignore")
    assert found.words == {"G51": [2], "A2": [2], "U1.": [3], "V2": [3], "M77": [4], "U2": [5]}
    program = read(text, ignore=["g51", "A", "u", "V", "M77"])
    assert only(program).points_mm.tolist() == [[0, 0], [5.5, 0], [9, 0]]
    assert "line 2: G51 is left out" in program.notices


@pytest.mark.parametrize(("word", "what"), [("X", "X: the contour"), ("G1", "G1: the"), ("$", "letters or words")])
def test_what_makes_the_contour_is_not_ignored(read, word, what):
    with pytest.raises(InputError, match=what):
        read(SQUARE, ignore=[word])


@pytest.mark.parametrize(("text", "feed"), [
    ("G20 G0 X0 Y0\nF0.1 G1 X1. Y.5\n", "F0.1 in/min"), ("G0 X0 Y0\nF9 G1 X1. Y.5\n", "F9 mm/min"),
    ("G0 X0 Y0\nF9 G1 X1000 Y500\n", "F9 um/min"), ("G93 G0 X0 Y0\nF9 G1 X1. Y.5\n", "F9 is"),
    ("G95 G0 X0 Y0\nF9 G1 X1. Y.5\n", "F9 is"), ("G93\nG94 G0 X0 Y0\nF9 G1 X1. Y.5\n", "F9 mm/min"),
])  # fmt: skip
def test_feeds_are_reported_in_the_units_of_the_program(read, text, feed):
    assert sum(f"feed {feed}" in notice for notice in read(text).notices) == 1
