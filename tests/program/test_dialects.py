"""Programs in dialects of machines: the geometry of each example, and errors in programs."""

import math
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from edmsim.errors import InputError
from edmsim.program import load_program, plan_path
from edmsim.program.blocks import UnknownWordsError
from edmsim.program.dialects import DIALECTS

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples" / "dialects"
PUNCH_MM2 = 60 - 4 * (1 - math.pi / 4)
"""A rectangle of 10 x 6 mm with one corner rounded by 2 mm."""

def example(name, **options):
    return load_program(EXAMPLES / name, **options)


def summary(outlines):
    return [(o.wire_side, o.offset_mm, o.condition, o.adaptive, o.continues, o.stops_after) for o in outlines]


def upper_mm(outline):
    """Return the points of the second plane."""
    return outline.taper.upper_mm


PASSES = {
    "punch-sodick.nc": [
        ("left", 0.195, "C001", None, False, False), ("right", 0.145, "C002", None, True, False),
        ("left", 0.135, "C003", None, True, True),
        ("left", 0.195, "C001", None, True, False), ("right", 0.145, "C002", None, True, False),
        ("left", 0.135, "C003", None, True, False),
    ],
    "punch-mitsubishi.nc": [
        ("left", 0.0077 * 25.4, "E1221", True, False, False), ("right", 0.0057 * 25.4, "E1222", False, True, False),
        ("left", 0.0053 * 25.4, "E1223", False, True, True),
        ("left", 0.0077 * 25.4, "E1221", True, True, False), ("right", 0.0057 * 25.4, "E1222", False, True, False),
        ("left", 0.0053 * 25.4, "E1223", False, True, False),
    ],
    "punch-skd2.nc": [
        ("left", 0.115, "E001", None, False, True), ("right", 0.1, "E002", None, True, True),
        ("right", 0.115, "E001", None, True, False),
    ],
    "punch-fanuc.nc": [
        ("left", 0.195, "S1", None, False, False), ("right", 0.145, "S2", None, True, True),
        ("right", 0.195, "S1", None, True, False), ("left", 0.145, "S2", None, True, False),
    ],
}  # fmt: skip


@pytest.mark.parametrize("name", PASSES)
def test_the_passes_of_a_punch_are_read_in_order(name):
    program = example(name)
    assert program.dialect == name.removeprefix("punch-").removesuffix(".nc")
    assert any(notice.startswith(f"dialect {program.dialect} (") for notice in program.notices)
    for found, expected in zip(summary(program.outlines), PASSES[name], strict=True):
        assert found[:1] + found[2:] == expected[:1] + expected[2:]
        assert found[1] == pytest.approx(expected[1])
    unit_mm = 25.4 / 25 if name == "punch-mitsubishi.nc" else 1.0
    tab = next(k for k, o in enumerate(program.outlines) if len(o.points_mm) == 2)
    profile = program.outlines[0].points_mm / unit_mm
    ends = {tuple(profile[0].round(6).tolist()), tuple(profile[-1].round(6).tolist())}
    assert ends == {(5.0, 0.0), (7.0, 0.0)}
    assert shapely.Polygon(profile).area == pytest.approx(PUNCH_MM2, rel=1e-4)
    for number, outline in enumerate(program.outlines[:tab]):
        again = outline.points_mm[::-1] if number % 2 else outline.points_mm
        assert again / unit_mm == pytest.approx(profile, abs=1e-9)
    for outline in program.outlines[tab:]:
        assert {tuple(point) for point in (outline.points_mm / unit_mm).round(6).tolist()} == ends


def test_a_pass_begins_where_the_one_before_left_off():
    first, *later = example("punch-sodick.nc").outlines
    assert first.approach_mm.tolist() == [[5, -2], [5, -1]]
    assert (first.condition, first.approach_condition) == ("C001", "C000")
    before = first
    for outline in later:
        assert outline.approach_mm[0] == pytest.approx(before.points_mm[-1])
        assert outline.approach_mm[-1] == pytest.approx(outline.points_mm[0] - [0, 0.5])
        assert not outline.needs_lead_in
        before = outline


def test_the_table_in_the_head_is_stored_as_written():
    table = example("punch-sodick.nc").conditions
    assert list(table) == ["C000", "C001", "C002", "C003"]
    assert {name: row["ON"] for name, row in table.items()} == {"C000": 10, "C001": 12, "C002": 2, "C003": 1}
    assert table["C003"]["SV"] == 48.0
    fast_wire = example("punch-skd2.nc").conditions
    assert fast_wire["E002"]["PUL_ON"] == 6
    assert fast_wire["E002"]["SPEED"] == 120


@pytest.mark.parametrize(("name", "angles", "corners"), [
    ("taper-sodick.nc", [-3.0, 3.0], None), ("taper-mitsubishi.nc", [1.5, 1.5], None),
    ("taper-fanuc.nc", [-2.0], None), ("taper-charmilles.iso", [1.0, 1.0], "cylindrical"),
])  # fmt: skip
def test_a_taper_leans_by_its_angle(name, angles, corners):
    program = example(name, offsets=EXAMPLES / "charmilles-offsets.toml" if "charmilles" in name else None)
    for outline, angle in zip(program.outlines, angles, strict=True):
        assert outline.taper.angle_deg == (angle,) * (len(outline.points_mm) - 1)
        assert (outline.taper.upper_mm, outline.taper.corners) == (None, corners)
        assert outline.taper.program_plane_mm == 0.0


def test_charmilles_takes_offsets_by_number_from_a_table():
    program = example("taper-charmilles.iso", offsets=EXAMPLES / "charmilles-offsets.toml")
    assert [outline.offset_mm for outline in program.outlines] == [0.195, 0.145]
    assert [outline.condition for outline in program.outlines] == ["S1", "S2"]
    area = 36 - (4 - math.pi)
    for outline in program.outlines:
        assert outline.closed
        assert shapely.Polygon(outline.points_mm).area == pytest.approx(area, abs=0.005)  # chords


def test_two_planes_by_a_colon():
    (outline,) = example("planes-sodick.nc").outlines
    upper, taper = upper_mm(outline), outline.taper
    assert (taper.program_plane_mm, taper.second_plane_mm) == (0.0, 20.0)
    assert len(upper) == len(outline.points_mm) == len(outline.elements) + 1
    below, above = shapely.Polygon(outline.points_mm), shapely.Polygon(upper)
    assert below.area == pytest.approx(64 - (4 - math.pi), abs=0.005)
    assert above.area == pytest.approx(36 - 4 * (4 - math.pi), abs=0.01)
    ends = np.flatnonzero(np.diff([0, *outline.elements, 0]))  # elements begin and end together below and above
    assert upper[ends][:4] == pytest.approx(np.array([[4, 1], [3, 1], [1, 3], [1, 5]]))


def test_upper_arcs_of_fanuc_have_their_centre_from_the_lower_one():
    (outline,) = example("cone-fanuc.nc").outlines
    upper = upper_mm(outline) - [0.5, 0]
    assert np.hypot(*outline.points_mm.T) == pytest.approx(5.0, abs=1e-9)
    assert np.hypot(*upper.T) == pytest.approx(4.0, abs=1e-9)
    angle = [np.arctan2(*p.T) for p in (outline.points_mm, upper)]
    assert np.exp(1j * angle[0]) == pytest.approx(np.exp(1j * angle[1]))


def test_the_upper_plane_of_linuxcnc_has_coordinates_of_its_own():
    (outline,) = example("wedge-linuxcnc.ngc").outlines
    assert outline.points_mm.tolist() == [[0, 0], [10, 0], [10, 10], [0, 10], [0, 0]]
    assert upper_mm(outline).tolist() == [[2, 2], [8, 2], [8, 8], [2, 8], [2, 2]]
    assert (outline.taper.program_plane_mm, outline.taper.second_plane_mm) == (0.0, 20.0)


UV = "G92 X0. Y0.{0}\nG1 X5. U1. V2.\nG1 Y5. U1.\nX0. Y5.\n"


def test_u_and_v_count_from_x_and_y_or_are_coordinates(read):
    relative = read(UV.format(" U0. V0."), dialect="fanuc").outlines[0]
    absolute = read(UV.format(""), dialect="linuxcnc").outlines[0]
    assert upper_mm(relative).tolist() == [[0, 0], [6, 2], [6, 7], [1, 7]]
    notices = read(UV.format(" U0. V0."), dialect="fanuc").notices
    assert any(notice.startswith("the heights of the two planes are not in the program") for notice in notices)
    assert upper_mm(absolute).tolist() == [[0, 0], [1, 2], [1, 2], [1, 2]]
    turned = read(UV.format("").replace("G1 X5.", "G91 G1 X5."), dialect="mitsubishi").outlines[0]
    assert turned.points_mm.tolist() == [[0, 0], [5, 0], [5, 5], [5, 10]]
    assert upper_mm(turned).tolist() == [[0, 0], [6, 2], [7, 7], [7, 12]]


def test_the_tip_of_a_cone_is_one_point_under_an_arc(read):
    cone = "TP0. TN10.\nG92 X5. Y-3.\nG1 X5. Y0 : X5. Y0\nG3 X5. Y0 I0 J5. : G1 X5. Y5.\nG1 X5. Y-3. : X5. Y-3.\n"
    with pytest.raises(InputError, match=r"second plane ends 5\.000 mm from where it began"):
        read(cone)
    (outline,) = read(cone.replace("Y0 : X5. Y0\n", "Y0 : X5. Y5.\n")).outlines
    assert (upper_mm(outline) == [5, 5]).all()
    assert shapely.Polygon(outline.points_mm).area == pytest.approx(25 * math.pi, rel=1e-3)


def test_an_upper_contour_like_the_lower_one_is_no_taper(read):
    (outline,) = read("TP0. TN10.\nG92 X0. Y0\nG1 X5. : X5.\nY5. : Y5.\n").outlines
    assert outline.taper is None


TABLE = "C001 = 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15;\n"
ONE_PASS = "{}G92 X5. Y-2.\n{}\nG1 X5. Y0.\nX0.\nY6.\nX10.\nY0.\nX5.\nG40 G1 Y-2.\nM02\n"


@pytest.mark.parametrize(("text", "dialect"), [
    (ONE_PASS.format(f"{TABLE}H001 = +000000.1950;\n", "C001 G41 H001"), "sodick"),
    (ONE_PASS.format("H001 = +000000.1950;\n", "C001 G41 H001"), "sodick"),
    (ONE_PASS.format("QAIC(2,1,0015,025.0);\nH1=.1900;\n", "G41 H1"), "sodick"),
    (ONE_PASS.format("H1=.1+H2\n", "G41 H1").replace("H1=", "H2=.09\nH1="), "mitsubishi"),
    (ONE_PASS.format("H1=.19\nM80\n", "E1221 G41 H1"), "mitsubishi"),
    (ONE_PASS.format("H001=190\n", "E001 G41 H001"), "skd2"),
    (ONE_PASS.format("D1=0.19\n", "G41 D1 G51 T0"), "fanuc"),
    (ONE_PASS.format("D1=0.19\n", "G29 G41 D1"), "charmilles"),
    (ONE_PASS.format("(Exported by FreeCAD)\nD1=0.19\n", "G41 D1"), "freecad"),
    (ONE_PASS.format("D1=0.19\n", "G41 D1"), None),
    (ONE_PASS.format("D1=0.19\n(by hand for LinuxCNC)\n", "G41 D1"), None),
])  # fmt: skip
def test_a_dialect_is_recognised_and_one_pass_is_cut(read, text, dialect):
    program = read(text)
    assert program.dialect == dialect
    assert any("recognised" in notice for notice in program.notices) == (dialect is not None)
    (outline,) = program.outlines
    assert outline.points_mm.tolist() == [[5, 0], [0, 0], [0, 6], [10, 6], [10, 0], [5, 0]]
    assert outline.offset_mm == pytest.approx(0.19, abs=0.006)
    path = plan_path(program, auto_offset_mm=0.3)
    assert path.offset_um == pytest.approx(190, abs=6)


def test_a_routine_of_the_control_is_left_out(read):
    text = ONE_PASS.format("QAIC(2,1,0015);\nH1=.19;\nQCALL(7);\n", "G41 H1")
    with pytest.raises(InputError, match=r"unknown word 'QCALL' \(line 3\)"):
        read(text)
    notices = read(text, ignore=["QCALL"]).notices
    assert "line 1: the word QAIC has no effect on the contour" in notices
    assert "line 3: QCALL is left out" in notices


def test_a_dialect_that_was_requested_is_taken(read):
    text = ONE_PASS.format("D1=0.19\n", "S3 G41 D1")
    assert read(text).outlines[0].condition is None
    program = read(text, dialect="fanuc")
    assert program.outlines[0].condition == "S3"
    assert "dialect fanuc (machines with a Fanuc control), as requested" in program.notices
    plain = ONE_PASS.format("H001 = +000000.1950;\n", "C001 G41 H001")
    assert read(plain, dialect="iso").dialect is None
    with pytest.raises(InputError, match="did you mean 'sodick'"):
        read(text, dialect="sodik")


def test_passes_without_compensation_are_reported_by_their_conditions(read):
    ring = "G1 X{0} Y0.\nX{0} Y{0}\nX0. Y{0}\nX0. Y0.\n"
    lines = ["G92 X-2. Y0.", "S9", "G1 X0. Y0.", "S1", ring.format(4.0), "S2", "G1 X.05 Y.05", "X3.95", "Y3.95",
             "X.05", "Y.05"]  # fmt: skip
    first, second = read("\n".join(lines), dialect="fanuc").outlines
    assert (first.approach_condition, first.condition, second.condition) == ("S9", "S1", "S2")
    assert (first.continues, second.continues) == (False, True)
    assert shapely.Polygon(first.points_mm).area == pytest.approx(16)
    assert shapely.Polygon(second.points_mm).area == pytest.approx(3.9**2)


def test_a_second_blocks_on_a_line_is_one_where_a_semicolon_ends_blocks(read):
    text = TABLE + "G92 X0. Y0;\nG1 X5.; Y5.; (AN END)\nX0. Y9. ; anything\n"
    assert read(text).outlines[0].points_mm.tolist() == [[0, 0], [5, 0], [5, 5], [0, 9]]
    assert len(read(text.partition("\n")[2]).outlines[0].points_mm) == 3


CLOSED = "G1 X0.\nY6.\nX10.\nY0.\nX5.\n"


def test_passes_may_follow_on_each_other_on_the_contour(read):
    head = "D1=0.2\nD2=0.15\nG92 X5. Y-2.\nG41 D1 G1 X5. Y0.\n"
    around = read(f"{head}{CLOSED}D2\n{CLOSED}G40 Y-2.\n").outlines
    assert [outline.closed for outline in around] == [True, True]
    back = read(head + CLOSED.replace("X5.", "X7.") + "M0\nG42 D2\nX10.\nY6.\nX0.\nY0.\nX5.\nG40 Y-2.\n").outlines
    assert back[1].points_mm[::-1].tolist() == back[0].points_mm.tolist()
    for first, second in (around, back):
        assert (first.offset_mm, second.offset_mm) == (0.2, 0.15)
        assert second.continues
        assert not second.needs_lead_in
        assert not len(second.approach_mm)
    assert [outline.stops_after for outline in back] == [True, False]


steps_50th_mm = st.lists(st.integers(5, 400), min_size=2, max_size=8)


@pytest.mark.slow
@given(
    steps=steps_50th_mm, offsets=st.lists(st.integers(100, 300), min_size=2, max_size=6, unique=True), data=st.data()
)
def test_passes_to_and_fro_are_the_same_profile(tmp_path_factory, steps, offsets, data):
    """A staircase cut forwards and backwards with any offsets, with or without G40 between passes."""
    profile = [(0.0, 0.0)]
    for number, step in enumerate(steps):
        x, y = profile[-1]
        profile.append((x + step / 50, y) if number % 2 else (x, y + step / 50))
    lines = [f"D{k}={um / 1e3}" for k, um in enumerate(offsets, 1)]
    lines += ["G92 X-3. Y-1.", "G41 D1 G1 X0 Y0"]
    stops = []
    for k in range(len(offsets)):
        way = profile[:: -1 if k % 2 else 1]
        lines += [f"G1 X{x:.3f} Y{y:.3f}" for x, y in way[1:]]
        stops.append(data.draw(st.booleans()))
        lines += ["M01"] * stops[-1]
        last = k == len(offsets) - 1
        if last or data.draw(st.booleans()):
            x, y = way[-1]
            lines.append(f"G40 G1 X{x - 1:.3f} Y{y + 0.5:.3f}")
            if not last:
                lines.append(f"{'G41' if k % 2 else 'G42'} D{k + 2} G1 X{x:.3f} Y{y:.3f}")
        else:
            lines.append(f"{'G41' if k % 2 else 'G42'} D{k + 2}")
    file = tmp_path_factory.mktemp("passes") / "part.nc"
    file.write_text("\n".join([*lines, "M02", ""]))
    outlines = load_program(file).outlines
    assert [round((outline.offset_mm or 0) * 1e3) for outline in outlines] == offsets
    assert [outline.continues for outline in outlines] == [False, *[True] * (len(offsets) - 1)]
    assert [outline.stops_after for outline in outlines] == stops
    for k, outline in enumerate(outlines):
        assert outline.points_mm[:: -1 if k % 2 else 1] == pytest.approx(np.array(profile), abs=1e-9)
        assert outline.wire_side == ("right" if k % 2 else "left")
        assert outline.part_side == ("left" if k % 2 else "right")


def test_the_condition_of_the_longest_part_counts_and_a_notice_says_so(read):
    text = ONE_PASS.format("D1=0.19\n", "S1 G41 D1").replace("X0.\n", "S2 X0.\n").replace("X5.\nG40", "S4 X5.\nG40")
    program = read(text.replace("Y6.", "S3 Y6."), dialect="fanuc")
    assert (program.outlines[0].condition, program.outlines[0].approach_condition) == ("S3", "S1")
    assert any("line 6: the condition changes within a contour, S2, S3, S4" in notice for notice in program.notices)


@pytest.mark.parametrize(("angle", "later", "corners", "noted"), [
    ("2.", "", "conical", True), ("0.", "A2. ", "cylindrical", False),
])  # fmt: skip
def test_the_corners_of_the_first_tilted_move_count_and_a_notice_says_so(read, angle, later, corners, noted):
    text = f"G92 X5 Y-4\nG42 D1 G28 G52 A{angle}\nG1 X5 Y0\nX10\n{later}G29 Y10\nX0\nY0\nX5\nG40 G50 Y-4\nM2\n"
    program = read(text, dialect="charmilles")
    assert program.outlines[0].taper.corners == corners
    said = "line 5: the shape of tapered corners changes within a contour, conical, cylindrical"
    assert any(said in notice for notice in program.notices) is noted


TWO = "TP0. TN10.\nG92 X0. Y0\n"
BAD = [
    (TABLE.replace(" 15", ""), 1, "C001 has 14 values, its table 15 columns"),
    (TABLE.replace(" 15", " x"), 1, "'X' for WP"), (TABLE + TABLE, 2, "C001 occurs twice"),
    (TABLE + "G92 X0. Y0\nC002 G1 X5.\n", 3, "C002 is not in the program's table: there are C001"),
    ("( ON OFF IP )\n" + TABLE, 2, "3 columns"), (TABLE + "G92 X0. Y0\nC001 C001 G1 X5.\n", 3, "both conditions"),
    ("H001=0.2\n" + TABLE + "G92 X0. Y0\nG41 H002 G1 X5.\n", 4, "H2 is not in the table: there are H1"),
    ("H1=.0085+H175\nG92 X0. Y0\n", 1, "H1 refers to H175"),
    (TWO + "G1 X5. : X4.\nY5.\n", 4, "2 elements below and 1 above"),
    (TWO + "G141\nG1 X5. : X4.\nY5.\n", 5, "G141 leads the wire in two planes"),
    (TWO + "G1 X5. : G2 X4. Y1.\n", 3, "after the colon needs its centre"),
    (TWO + "G1 X5. : G2 X4. Y0 I1. J1.\n", 3, "radii disagree in the second plane"),
    (TWO + "G1 X5. : X4. X3.\n", 3, "twice after the colon"),
    ("TP5. TN5.\nG92 X0. Y0\nG1 X5.\n", 1, "two planes have two heights"),
    (TWO + "A3.\nG1 X5.\n", 3, "without G51 or G52"), (TWO + "G51 A61.\nG1 X5.\n", 3, "0 to 60 degrees"),
    (TWO + "G51 G52 A1.\nG1 X5.\n", 3, "two of G50 G51 G52"), (TWO + "G41 G141\nG1 X5.\n", 3, "exclude each other"),
    (TWO + "G51 A3.\nG1 X5. : X4.\n", 4, "by an angle and by a second contour"),
    ("G92 X0. Y0\nG2 X5. Y5. I5. J0 U1.\n", 2, "an arc with U or V", "linuxcnc"),
    ("G92 X0. Y0\nG1 X5. U1.\nG92 X0.\n", 3, "G92 after the first move", "fanuc"),
    ("G92 X0. Y0\nG1 X5. K1.\n", 2, "K is given without", "fanuc"),
    ("(XY plane 5, UV plane 5)\nG92 X0. Y0\nG1 X5. U1.\n", None, "two planes have two", "linuxcnc"),
    ("G92 X0. Y0\nA-61. G1 X5.\n", 2, "-60 to 60 degrees", "mitsubishi"),
    ("G92 X0. Y0\nG1 X300.\n", None, "another scale", "freecad"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "line", "what", "dialect"), [(*case, "auto")[:4] for case in BAD])
def test_what_makes_no_sense_is_refused_with_its_line(read, text, line, what, dialect):
    with pytest.raises(InputError) as refused:
        read(text, dialect=dialect)
    assert what in refused.value.reason
    assert refused.value.line == line


def test_unknown_words_are_named_at_once_with_the_dialects_that_know_them(read):
    with pytest.raises(UnknownWordsError) as refused:
        read("G92 X0. Y0\nG51 A2.\nG1 X5.\nY5. A1.\n")
    assert refused.value.words == {"G51": [2], "A2.": [2], "A1.": [4]}
    assert refused.value.reason.endswith("known to --dialect sodick or mitsubishi or charmilles")
    with pytest.raises(UnknownWordsError) as refused:
        read(TABLE + "G92 X0. Y0\nG1 X5. Q2\nU1. B2\n")
    assert refused.value.words == {"Q2": [3], "U1.": [4], "B2": [4]} or list(refused.value.words) == ["U1.", "B2"]


SIDES = "Y4.{}\nX-3.\nY-3.\nX3.\nY0\nG40 G1 X0\nM2\n"


def test_a_block_behind_a_semicolon_is_read_or_refused(read):
    text = TABLE + "G92 X0 Y0\nC001 G41 H1 G1 X3.;\n" + SIDES
    (outline,) = read(text.format("; X2. Y5.")).outlines
    assert [2, 5] in outline.points_mm.tolist()
    assert [2, 5] not in read(text.format("; corner of X 2")).outlines[0].points_mm.tolist()
    with pytest.raises(InputError, match="variables"):
        read(text.format("; X2. Y5. #1"))
    with pytest.raises(UnknownWordsError, match="O"):
        read(text.format("; X2. Y5.O"))
    planes = read(TABLE + "TP0; TN10.;\nG92 X0 Y0\nG141 G1 X3. : X4.\nY3. : Y3.; X1. : X0.\nM2\n").outlines[0]
    assert upper_mm(planes)[-1].tolist() == [0, 3]
    assert planes.taper.second_plane_mm == 10.0


def test_a_block_in_a_comment_is_named_where_comments_begin_so(read):
    text = "G92 X0 Y0\nG41 D1 G1 X3.\n" + SIDES
    assert any(notice.startswith("line 3: X2. Y5. after ';'") for notice in read(text.format("; X2. Y5.")).notices)
    assert not any("behind" in notice for notice in read(text.format("; X2. Y5. old")).notices)


@pytest.mark.parametrize(("dwell", "dialect", "seconds"), [
    ("P2000", "fanuc", 2.0), ("X1500", "mitsubishi", 1.5), ("X1.5", "fanuc", 1.5), ("P2", "iso", 2.0),
    ("P2000", "iso", 2000.0),
])  # fmt: skip
def test_a_dwell_is_in_ms_where_the_control_has_it_so(read, dwell, dialect, seconds):
    program = read(f"G92 X0. Y0\nG1 X3.\nG4 {dwell}\nX5.\nM2\n", dialect=dialect)
    assert [dwell for _, dwell in program.outlines[0].dwells] == [seconds]
    assert any("P and X are seconds" in notice for notice in program.notices) == (seconds == 2000)


def test_a_dwell_does_not_decide_the_unit(read):
    program = read("G92 X0 Y0\nG1 X3000\nG4 X0.5\nX5000\nM2\n")
    assert program.outlines[0].points_mm[-1].tolist() == [5, 0]


def test_words_of_other_controls_do_not_make_a_dialect(read):
    mitsubishi = "H175=0.\nH1=.2+H175\nG90 G92 X0. Y0.\nE1221 M90 G41 H1 G52 A2. G1 X3.\n" + SIDES.format("")
    assert "dialect mitsubishi" in read(mitsubishi).notices[0]
    with pytest.raises(UnknownWordsError, match="G28"):  # the reference point elsewhere
        read("G92 X0 Y0\nG41 D1 G1 X3.\n" + SIDES.format("").replace("M2", "G28 X0. Y0.\nM2"))


def test_a_tape_begins_with_its_number_and_ends_with_offset_0(read):
    program = read("%\n:0012\nD1=.16\nG92 X0 Y0\nG41 D1 G1 X3.\n" + SIDES.format("").replace("G40", "G40 D0"))
    assert program.outlines[0].offset_mm == 0.16


def test_an_angle_before_its_taper_is_named(read):
    text = "G92 X0 Y0\nG41 D1\nT2.\nG51\nG1 X3.\n" + SIDES.format("")
    notices = read(text, dialect="fanuc").notices
    assert "line 4: the taper has no angle: write T2 of line 3 after G51 or G52" in notices


@pytest.mark.parametrize(("text", "notice"), [
    ("D1=.1\nG92 X0 Y0\nG41 D1 G51\nG1 X3.\n", "line 4: the taper has no angle: the wire is vertical"),
    ("G92 X0 Y0\nG51 T2.\nG1 X3.\nG50\nG0 X5.\nG51\nG1 X8.\n", "line 7: the taper has no angle"),
    ("D1=.1\nG92 X0 Y0\nG41 G51 T2.\nG1 X3.\n", "line 4: compensation without D or H: the offset is that of the cut"),
])  # fmt: skip
def test_what_is_switched_on_without_its_number_is_named(read, text, notice):
    sound = read("D1=.1\nG92 X0 Y0\nG41 D1 G51 T2.\nG1 X3.\n" + SIDES.format(""), dialect="fanuc").notices
    assert not any(notice[8:] in one for one in sound)
    assert any(one.startswith(notice) for one in read(text + SIDES.format(""), dialect="fanuc").notices)


@pytest.mark.parametrize("end", ["", "M2\n", "%\n"])
def test_a_tape_without_an_end_is_named(read, end):
    text = "%\nG92 X0 Y0\nG41 D1 G1 X3.\n" + SIDES.format("").replace("M2\n", end)
    assert any("is it complete?" in notice for notice in read(text).notices) == (not end)


def test_u_and_v_of_0_leave_the_angle_of_a_taper(read):
    text = "G92 X0 Y0 {}\nG41 D1 G51 T2.\nG1 X3.\n" + SIDES.format("")
    plain, with_both = (read(text.format(words), dialect="fanuc").outlines[0].taper for words in ("", "U0 V0"))
    assert with_both.angle_deg == plain.angle_deg


def test_subprograms_may_begin_at_their_n_number_where_controls_have_it(read):
    text = TABLE + "G92 X0. Y0\nM98 P0007 H0\nM02\nN0007\nN10 G1 X5.\nN20 Y5.\nM99\nM199\n"
    assert read(text).outlines[0].points_mm.tolist() == [[0, 0], [5, 0], [5, 5]]
    with pytest.raises(InputError, match="subprogram N7 occurs twice"):
        read(text + "N0007\nM99\n")
    with pytest.raises(InputError, match="begin them with their O number"):
        read(text.partition("\n")[2].replace("M199\n", ""), dialect="iso")


def test_every_dialect_has_an_example():
    dialect_found = {example(file.name).dialect for file in EXAMPLES.iterdir() if file.suffix != ".toml"}
    assert dialect_found == set(DIALECTS) - {"iso"}
