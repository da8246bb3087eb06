"""Interpretation of programs whose numbers, codes or moves are ambiguous."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmsim.errors import InputError
from edmsim.program import load_program, plan_path

AUTO = {"auto_offset_mm": 0.155}


def planned(program, offset="auto"):
    return plan_path(program.source, offset, **AUTO)


def length_mm(points):
    return float(np.hypot(*np.diff(points, axis=0).T).sum())


def has_notice(program, words):
    return any(words in notice for notice in program.notices)


# arcs near the tolerance


TINY = "G21 G90\nG0 X-3. Y4.\nG1 X10. Y4.\nG2 X10.002 Y4.002 I0. J0.002\n{}M2\n"


@pytest.mark.parametrize("rest", ["", "G1 X20.\n"])
def test_an_arc_within_the_tolerance_is_that_arc(read, rest):
    (outline,) = read(TINY.format(rest)).outlines
    assert np.ptp(outline.points_mm, axis=0)[1] == pytest.approx(0.002)
    assert length_mm(outline.points_mm[:3]) == pytest.approx(13.003, abs=1e-3)


@pytest.mark.parametrize("start", [0.0, 0.002, 8.5, 40.0])
@pytest.mark.parametrize("radius", [0.001, 0.002, 0.004])
def test_an_arc_within_the_tolerance_never_becomes_a_circle(read, start, radius):
    text = f"G21\nG0 X{start:.3f} Y5.\nG3 X{start + radius:.3f} Y{5 + radius:.3f} I0. J{radius:.3f}\nG1 Y9.\nM2\n"
    (outline,) = read(text).outlines
    assert length_mm(outline.points_mm) == pytest.approx(4.0, abs=0.01)


def test_arcs_within_the_tolerance_do_not_vote(read):
    """Three arcs of 2 um fit an absolute centre only by accident; the half circle, which fits both, is relative."""
    tiny = "".join(f"G1 Y{k}.\nG3 X10.002 Y{k}.002 I0. J0.002\nG1 X10.\n" for k in (1, 2, 3))
    program = read(f"G21\nG0 X10. Y0.\n{tiny}G0 X20. Y0.\nG3 X20. Y0. I5. J0.\nM2\n")
    circle = program.outlines[-1].points_mm
    assert circle.mean(axis=0) == pytest.approx((25, 0), abs=0.2)


def test_an_arc_without_a_radius_is_left_out(read):
    program = read("G21\nG0 X5. Y2.\nG1 Y5.\nX12.\nG3 X12. Y5. I0. J0.\nG4 P1.\nG1 Y9.\nM2\n")
    (outline,) = program.outlines
    assert outline.points_mm.tolist() == [[5, 2], [5, 5], [12, 5], [12, 9]]
    assert outline.dwells == ((2, 1.0),)
    assert has_notice(program, "line 5: an arc without a radius is left out")


def test_a_circle_about_the_zero_where_centres_are_absolute(read):
    half = "G3 X-5. Y0. I0. J0.\nG3 X5. Y0. I0. J0.\n"
    for text in (f"G21\nG0 X5. Y0.\n{half}G0 X9. Y0.\nG3 X9. Y0. I0. J0.\nM2\n",
                 "G90.1\nG0 X9. Y0.\nG3 X9. Y0. I0. J0.\nM2\n"):  # fmt: skip
        assert length_mm(read(text).outlines[-1].points_mm) == pytest.approx(18 * math.pi, rel=1e-3)


# full circles within the rounding


@pytest.mark.parametrize("end", ["X.5001 Y-.0001", "X.5 Y.0001", "X.4999 Y0.0001", "X.5 Y0.0"])
def test_a_circle_whose_ends_differ_by_rounding_is_full(read, end):
    program = read(f"G20\nG0 X0 Y0\nG1 X.5 Y0\nG3 {end} I-.5 J0\nG1 X0 Y0\nM2\n")
    (outline,) = program.outlines
    assert length_mm(outline.points_mm) == pytest.approx(25.4 * math.pi, rel=1e-3)
    assert has_notice(program, "it is read as a full circle") == (end != "X.5 Y0.0")


@pytest.mark.parametrize("begin", ["X0 Y-3.\nG1 Y0.", "X4. Y-3.\nG1 Y0."])  # in the second program a move crosses it
def test_a_short_arc_of_a_contour_that_closes_without_a_circle_is_one(read, begin):
    rest = "G3 X10.003 Y0.001 I-0.5 J3.\nG1 Y8.\nX0.\nY0.\nX5.\nM2\n"
    program = read(f"G21\nG0 {begin}\nX10.\n{rest}")
    (outline,) = program.outlines
    assert np.ptp(outline.points_mm, axis=0) == pytest.approx((10.003, 8))
    assert has_notice(program, "line 5: the arc's ends are 3.2 um apart: it is read as the short arc")


# tolerances from the number of decimal places


@pytest.mark.slow
@given(
    radius=st.floats(2, 20), begin=st.floats(0, 6.28), sweep=st.floats(0.5, 5.5), turn=st.sampled_from((2, 3)),
    unit=st.sampled_from([("G20", 25.4, 4), ("G20", 25.4, 3), ("G21", 1.0, 3), ("G21", 1.0, 2)]),
    centre=st.tuples(st.floats(-9, 9), st.floats(-9, 9)),
)  # fmt: skip
def test_every_arc_that_is_rounded_right_is_read(tmp_path_factory, radius, begin, sweep, turn, unit, centre):
    code, unit_mm, places = unit
    middle = complex(*centre)
    start, end = (middle + radius * np.exp(1j * angle) for angle in (begin, begin + (sweep if turn == 3 else -sweep)))
    x, y, i, j = (f"{value / unit_mm:.{places}f}" for value in (end.real, end.imag, (middle - start).real,
                                                               (middle - start).imag))  # fmt: skip
    file = tmp_path_factory.mktemp("arc") / "arc.ngc"
    first = f"X{start.real / unit_mm:.{places}f} Y{start.imag / unit_mm:.{places}f}"
    file.write_text(f"{code} G90\nG0 {first}\nG{turn} X{x} Y{y} I{i} J{j}\nM2\n")
    (outline,) = load_program(file).outlines
    assert length_mm(outline.points_mm) == pytest.approx(radius * sweep, abs=8 * unit_mm * 10.0**-places, rel=1e-3)


def test_what_no_rounding_explains_is_refused(read):
    for text in (
        "G21\nG0 X0.000 Y0\nG1 X-7.98 Y.53\nG3 X5.43 Y-7.77 I5.35 J-6.36\n", "G0 X0 Y0\nG3 X9.5 Y0 I4.7 J0\n",
        "G20\nG0 X0 Y0\nG3 X.3500 Y0 I.1745 J0\n",
    ):  # fmt: skip
        with pytest.raises(InputError, match="radii disagree"):
            read(text)
    rounded = "G20 G90\nG0 X0 Y0\nG1 X-0.3143 Y0.0209\nG3 X0.2138 Y-0.3059 I0.2106 J-0.2500\nM2\n"  # radii 6 um apart
    assert length_mm(read(rounded).outlines[0].points_mm) == pytest.approx(39.3, abs=0.05)


@pytest.mark.parametrize("block", ["", "G10 L12 P1 R0.1556\n", "G4 X0.1234\n"])
def test_an_offset_and_a_dwell_say_nothing_of_how_finely_places_are_written(read, block):
    program = read(f"{block}G0 X0. Y0.\nG1 X3.02\nG2 X5.03 Y-1.98 I0.0 J-2.00\nM2\n")
    assert has_notice(program, "the arc's radii differ by 10.1 um, which the rounding of its numbers explains")


# words that belong to a code


@pytest.mark.parametrize(
    "block", ["G64 P0.01", "G64 P0.01 Q0.02", "G64 Q.5", "G61.1", "G43 H9", "G39 I1. J0.", "G96 S20 D900", "G59.1"]
)
def test_words_of_codes_without_effect_have_none(read, block):
    program = read(f"D1=0.16\n{block}\nG0 X0 Y0\nG41 D1 G1 X5.\nX9.\nM2\n")
    assert program.outlines[0].offset_mm == 0.16
    assert has_notice(program, "line 2: ")


@pytest.mark.parametrize(("block", "named"), [
    ("G1 X5. Q3", "Q3 is given without G64"), ("G1 X5. P.01", "P0.01 is given without G4, G10, G64 or M98"),
    ("G1 X5. L2", "L2 is given without G10 or M98"), ("G1 X5. U2", "'U2' .line 2.: correct it"), ("G68 X5.", "'G68'"),
    ("G1 X1E2", "'E2'"), ("G92.1", "'G92.1'"),
])  # fmt: skip
def test_words_that_decide_the_contour_are_not_offered_to_be_ignored(read, block, named):
    with pytest.raises(InputError, match=named) as refused:
        read(f"G0 X0 Y0\n{block}\nX9. Y9.\n")
    assert "--ignore" not in str(refused.value)


def test_only_m_codes_are_offered_to_be_ignored(read):
    with pytest.raises(InputError, match=r"--ignore M77,M91$"):
        read("G0 X0 Y0\nM77\nG1 X5. V2\nM91\n")


@pytest.mark.parametrize(("code", "centre"), [("G90.1", (5, 0)), ("G91.1", (15, 0)), ("G091.1", (15, 0))])
def test_what_the_program_says_of_centres_is_read(read, code, centre):
    program = read(f"{code}\nG0 X10. Y0\nG3 X10. Y0 I5. J0\nM2\n")
    assert program.outlines[0].points_mm.mean(axis=0) == pytest.approx(centre, abs=0.2)
    assert not has_notice(program, "absolute")


@pytest.mark.parametrize(("text", "named"), [
    ("G91.1\nG0 X20. Y10.\nG3 X10. Y10. I15. J10.\n", ":3: .*with I J relative start"),
    ("G90.1\nG0 X20. Y10.\nG3 X10. Y10. I-5. J0.\n", ":3: .*with I J absolute start"),
    ("G90.1\nG0 X0 Y0\nG3 X5. Y0 I2.5\n", "G90.1 is in force: an arc needs both I and J"),
    ("G90.1 G91.1\nG0 X0 Y0\nG1 X5.\n", "G90.1 G91.1"),
])  # fmt: skip
def test_arcs_that_do_not_fit_what_the_program_says(read, text, named):
    with pytest.raises(InputError, match=named):
        read(text)


# beginnings of contours, and moves after them


RING = "G1 X{0}5. Y0.\nY3.\nX{0}8.\nY-3.\nX{0}5.\nY0.\nX0.\n"


@pytest.mark.parametrize("between", ["G0 X0. Y0.", "G0", "M50\nG0 X0. Y0.\nM60", "M50\nM60", "M60", "G0 X7.\nX0."])
def test_rapids_and_threading_begin_a_contour(read, between):
    program = read("G21\nG0 X0. Y0.\n" + RING.format("") + f"{between}\n" + RING.format("-") + "M2\n")
    assert [outline.closed for outline in program.outlines] == [True, True]
    assert [outline.points_mm[:, 0].min() for outline in program.outlines] == [5, -8]
    assert len(planned(program).contours) == 2


def test_the_wire_is_cut_off_at_the_end_of_its_block(read):
    assert read("G21\nG0 X0 Y0\nG1 X5. M50\nM2\n").outlines[0].points_mm.tolist() == [[0, 0], [5, 0]]
    with pytest.raises(InputError, match=":4: the wire is cut off since M50 on line 3"):
        read("G21\nG0 X0 Y0\nG1 X5. M50\nY3.\n")


SIDES = "X0.\nY8.\nX12.\nY0.\n"


@pytest.mark.parametrize(
    "end", ["X6.\n", "X6.\nX5.\nX4.\nX3.\n", "X4.\n", "X4.\nX1.\n", "X6.\nX0.\nY8.\nX12.\nY4.\n"]
)
@pytest.mark.parametrize("leave", ["", "G40 Y-3.\n", "G40 Y-.5\nX7.\nY-3.\nX6.\n"])
def test_overlap_of_any_number_of_moves_is_no_lead_out(read, end, leave):
    program = read(f"G21\nG0 X6. Y-3.\nG41 G1 Y0.\n{SIDES}{end}{leave}M2\n")
    (outline,) = program.outlines
    assert outline.closed
    assert outline.points_mm.tolist() == [[6, 0], [0, 0], [0, 8], [12, 8], [12, 0], [6, 0]]
    assert has_notice(program, "overlap") == (end != "X6.\n")
    planned(program)


def test_a_circle_may_overlap_its_beginning(read):
    program = read("G21\nG0 X0 Y0\nG41 G1 X5. Y0\nG3 X-5. Y0 I-5. J0\nG3 X4.698 Y1.710 I5. J0\nG40 G1 X0 Y0\nM2\n")
    (outline,) = program.outlines
    assert length_mm(outline.points_mm) == pytest.approx(10 * math.pi, rel=1e-3)
    assert has_notice(program, "line 5: the overlap")


def test_a_dwell_keeps_its_place_where_a_move_runs_over_the_beginning(read):
    (outline,) = read(f"G21\nG0 X6. Y-3.\nG41 G1 Y0.\nX0.\nG4 P1.\n{SIDES[4:]}X4.\nG4 P2.\nM2\n").outlines
    assert outline.dwells == ((2, 1.0), (6, 2.0))


@pytest.mark.parametrize(
    "after", ["G1 X20. Y0.\nG3 X20. Y0. I5. J0.\n", "X-3.\nY3.\nX-6.\nY0.\nX-3.\n", "G3 X0. Y0. I-2. J0.\n",
              "X-9.\nY-20.\nX20.\n"],
)  # fmt: skip
def test_a_closed_loop_or_a_long_way_is_no_lead_out(read, after):
    with pytest.raises(InputError, match=r":9: .*bring the wire to the next contour with G0"):
        read("G21 G90\n\nG0 X0. Y-3.\nG1 Y0.\nX12.\nY8.\nX0.\nY0.\n" + after)


# paths without compensation


@pytest.mark.parametrize("moves", [
    "Y-3.\nG1 Y0.\nX10.\nY10.\nX0.\nY0.\nX4.8\n", "Y0\nG1 X9.5\nY.2\nX0.\n", "Y-1.\nG1 Y0\nX5.2\nY.2\nX5.\nY0.\n",
])  # fmt: skip
def test_a_path_without_compensation_is_cut_as_written(read, moves):
    program = read(f"G21\nG0 X5. {moves}M2\n")
    path = planned(program)
    (contour,), (outline,) = path.contours, program.outlines
    drawn = [*outline.approach_mm.tolist(), *outline.points_mm.tolist()]
    assert (contour.points_um / 1e3 - path.origin_mm).tolist() == pytest.approx(np.array(drawn))
    assert (contour.points_um == planned(program, "none").contours[0].points_um).all()
    assert contour.offset_um == 0
    assert any("no edge lies at the offset" in notice for notice in path.notices)


# modal state before the first code that sets it


CIRCLE = "G92 X0 Y0\nG41 D1 G1 X.25 Y0\nG3 X-.25 Y0 I-.25 J0\nG3 X.25 Y0 I.25 J0\nG40 G1 X0 Y0\nM2\n"


@pytest.mark.parametrize("define", ["D1=.0061\nG20", "G10 L12 P1 R.0061\nG20", "G10 P1 R.0061\nG70", "G20 D1=.0061"])
def test_an_offset_before_the_unit_has_the_only_unit(read, define):
    program = read(f"{define}\n{CIRCLE}")
    assert program.outlines[0].offset_mm == pytest.approx(0.0061 * 25.4)
    assert has_notice(program, "lengths before G20 are read in inches") == (define[:3] != "G20")


def test_places_before_the_unit_have_the_only_unit(read):
    assert read("G92 X1. Y0\nG20 G1 X2.\n").outlines[0].points_mm.tolist() == [[25.4, 0], [50.8, 0]]
    assert read("G92 X1. Y0\nG21 G1 X2.\n").outlines[0].points_mm.tolist() == [[1, 0], [2, 0]]


@pytest.mark.parametrize(("text", "named"), [
    ("D1=.0061\nG20\n" + CIRCLE.replace("G40", "G21\nG40"), ":1: a length comes before its unit"),
    ("G0 X1. Y1.\nG20\nG1 X2.\nG21 Y3.\n", ":1: a length comes before its unit"),
    (CIRCLE.replace("G40", "D1=.16\nG40"), ":2: the offset D1 is called before"),
    (CIRCLE.replace("G40", "G10 L12 P1 R.16\nG40"), ":2: the offset D1 is called before"),
])  # fmt: skip
def test_what_would_be_a_guess_is_refused(read, text, named):
    with pytest.raises(InputError, match=named):
        read(text)


# messages with the right cause


@pytest.mark.parametrize(("block", "named"), [
    ("(a (b) c)", ":2: a comment has a '.' in it"), ("G1 X5. (a (b)", "a comment has a"),
    ("X1. (open", "is not closed"), ("G1 X5. )", "a '.' without a '.' before it"),
    ("G1 X1,5 Y2.", "with a decimal point, X1.5"), ("G1 X15. ,R2.", "',R' rounds a corner"),
    ("G1 X15. ,C2.", "',C' chamfers a corner"), ("#1=5", "variables"), ("G1 X[2+3]", "expressions"),
    ("G1 X#1", "variables"), ("D1=#2", "variables"),
])  # fmt: skip
def test_what_is_no_word_is_refused_with_its_cause(read, block, named):
    with pytest.raises(InputError, match=named) as refused:
        read(f"G0 X0 Y0\n{block}\nX9. Y9.\n")
    assert "--ignore" not in str(refused.value)
    assert refused.value.line == 2


def test_a_name_with_a_zero_byte_is_refused():
    with pytest.raises(InputError, match="cannot be read: embedded null byte"):
        load_program("a\0.ngc")


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-32"])
def test_a_byte_order_mark_says_the_encoding(read, encoding):
    text = "(Ölbad)\nG0 X0 Y0\nG1 X5.5\n"
    assert read(text.encode(encoding)).outlines[0].points_mm.tolist() == [[0, 0], [5.5, 0]]


@pytest.mark.parametrize(
    "data", ["G0 X0 Y0\nG1 X5.5\n".encode("utf-16-le"), b"\xff\xfeG0 X0 Y0\nG1 X5.", b"G0 X0 (\xd6l)\n"]
)
def test_other_encodings_are_refused_with_the_remedy(read, data):
    with pytest.raises(InputError, match=r"saved? (it )?as UTF-8"):
        read(data)
