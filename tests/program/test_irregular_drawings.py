"""Drawings by CAD programs and scripts other than plain lines: all polylines, annotations, damaged files."""

import itertools
import random

import ezdxf
import numpy as np
import pytest

from edmsim.errors import InputError
from edmsim.program.dxf import read_dxf

INSERT = " 0 INSERT 8 0 2 B 10 1 20 1"
CORNERS = [(0, 0), (10, 0), (10, 6), (0, 6)]


def line(start, end, order=(10, 20, 11, 21)):
    value = {10: start[0], 20: start[1], 11: end[0], 21: end[1]}
    return " 0 LINE 8 0 " + " ".join(f"{code} {value[code]}" for code in order)


def rectangle(order=(10, 20, 11, 21)):
    return "".join(line(a, b, order) for a, b in itertools.pairwise([*CORNERS, CORNERS[0]]))


def size(program):
    (outline,) = program.outlines
    return [float(extent) for extent in np.ptp(outline.points_mm, axis=0).round(2)]


def block_of(entity):
    return f"0 SECTION 2 BLOCKS 0 BLOCK 8 0 2 B 70 0 10 0 20 0 {entity} 0 ENDBLK 8 0 0 ENDSEC"


def polyline(flags, vertices):
    """Return a POLYLINE; a vertex is x, y, z and its flags."""
    body = "".join(f" 0 VERTEX 8 0 10 {x} 20 {y} 30 {z} 70 {f}" for x, y, z, f in vertices)
    return f" 0 POLYLINE 8 0 66 1 10 0 20 0 30 0 70 {flags}{body} 0 SEQEND 8 0"


FRAME = [(-3.0, -3.0, 0.0, 16), (14.0, -3.0, 0.0, 16), (5.0, 20.0, 0.0, 16)]
CURVE = [(0.0, 0.0, 0.0, 8), (10.0, 0.0, 0.0, 8), (10.0, 6.0, 0.0, 8), (0.0, 6.0, 0.0, 8)]


@pytest.mark.parametrize(("flags", "vertices"), [
    (5, [*FRAME, *CURVE]), (5, [v for pair in zip(FRAME, CURVE[1:], strict=True) for v in pair] + CURVE[:1]),
    (3, [(x, y, z, 1) for x, y, z, _ in CURVE]), (1, [(x, y, z, 0) for x, y, z, _ in CURVE]),
    (9, [(x, y, 4.0, 32) for x, y, _, _ in CURVE]), (9, [(x, y, 4.0 + 1e-9 * x, 32) for x, y, _, _ in CURVE]),
    (13, [*[(x, y, 7.0, 48) for x, y, _, _ in FRAME], *[(x, y, 4.0, 40) for x, y, _, _ in CURVE]]),
])  # fmt: skip
def test_polylines_are_drawn_by_their_flags(own_text, flags, vertices):
    """Control points of a spline (16) are not drawn; fitted points (8, 1) are; 3D of one height is flat."""
    assert size(own_text(polyline(flags, vertices))) == [10, 6]


@pytest.mark.parametrize(("flags", "vertices", "named"), [
    (9, [(0.0, 0.0, 0.0, 32), (10.0, 0.0, 0.0, 32), (10.0, 6.0, 5.0, 32)], "a 3D polyline climbs from Z0.000 to Z5"),
    (16, [(0.0, 0.0, 0.0, 64), (10.0, 0.0, 0.0, 64)], "a polygon mesh cannot be cut"),
    (64, [(0.0, 0.0, 0.0, 192), (10.0, 0.0, 0.0, 192)], "a polyface mesh cannot be cut"),
    (5, FRAME, "a POLYLINE holds only what controls its spline"),
])  # fmt: skip
def test_other_polylines_are_refused_by_name(own_text, flags, vertices, named):
    with pytest.raises(InputError, match=named):
        own_text(rectangle() + polyline(flags, vertices))


def test_the_arcs_of_mirrored_polylines_keep_their_side(drawing):
    def draw(space):
        slot = [(0, 0, 0), (10, 0, 1), (10, 4, 0), (0, 4, 0)]
        space.add_lwpolyline(slot, format="xyb", close=True, dxfattribs={"extrusion": (0, 0, -1)})

    (outline,) = drawing(draw).outlines
    assert outline.points_mm.min(axis=0) == pytest.approx([-12, 0], abs=0.002)
    assert outline.points_mm.max(axis=0) == pytest.approx([0, 4], abs=0.002)


@pytest.mark.parametrize("kind", ["3DFACE", "SOLID", "TRACE", "3DSOLID", "REGION", "BODY", "MLINE", "MESH", "NEW"])
@pytest.mark.parametrize("where", ["model space", "block", "stretched block"])
def test_what_cannot_be_cut_is_refused_by_its_name(own_text, kind, where):
    corners = " ".join(f"1{k} {x} 2{k} {y} 3{k} 0" for k, (x, y) in enumerate(CORNERS))
    entity = f" 0 {kind} 8 0 {corners}"
    drawn = entity if where == "model space" else INSERT + " 41 2" * (where != "block")
    with pytest.raises(InputError, match=f"a {kind} cannot be cut: draw lines"):
        own_text(rectangle() + drawn, block_of(entity))


@pytest.mark.parametrize("kind", [
    "ACAD_TABLE", "LARGE_RADIAL_DIMENSION", "ARC_DIMENSION", "DIMENSION", "MTEXT", "HATCH", "MPOLYGON", "LEADER",
    "MULTILEADER", "ARCALIGNEDTEXT", "OLEFRAME", "WIPEOUT",
])  # fmt: skip
def test_annotations_are_left_out_with_a_notice(own_text, kind):
    entity = f" 0 {kind} 8 0 10 3 20 3 30 0"
    for drawn in (entity, INSERT + " 41 2"):
        program = own_text(rectangle() + drawn, block_of(entity) if drawn != entity else "")
        assert size(program) == [10, 6]
        assert f"1 {kind} left out" in program.notices


@pytest.mark.slow
@pytest.mark.parametrize("order", list(itertools.permutations((10, 20, 11, 21))))
def test_codes_come_in_any_order(own_text, order):
    program = own_text(rectangle(order))
    assert size(program) == [10, 6]
    assert sum("irregular" in notice for notice in program.notices) <= 1


@pytest.mark.parametrize(("entities", "extent"), [
    ("0 CIRCLE 8 0 10 5 40 2 20 7", [4, 4]),
    ("0 ARC 8 0 20 0 50 0 51 180 40 2 10 5" + line((3, 0), (7, 0)), [4, 2]),
    ("0 ELLIPSE 8 0 11 3 10 5 21 0 20 5 40 0.5 41 0 42 6.283185307179586", [6, 3]),
    ("0 LWPOLYLINE 8 0 90 4 70 1 10 0 10 10 10 10 10 0 20 0 20 0 20 6 20 6", [10, 6]),
    ("0 LWPOLYLINE 8 0 90 4 70 1 20 0 10 0 20 0 10 10 42 1 20 6 10 10 20 6 10 0", [13, 6]),
    ("0 POLYLINE 8 0 66 1 70 1 0 VERTEX 8 0 20 0 10 0 0 VERTEX 8 0 20 0 30 0 10 10 0 VERTEX 8 0 20 6 10 10 0 SEQEND",
     [10, 6]),
    ("0 SPLINE 8 0 70 8 71 1 72 4 73 2 40 0 40 0 40 1 40 1 10 0 10 10 20 0 20 0" + line((10, 0), (10, 6))
     + line((10, 6), (0, 0)), [10, 6]),
])  # fmt: skip
def test_so_do_those_of_every_kind(own_text, entities, extent):
    assert size(own_text(entities)) == pytest.approx(extent, abs=0.01)


TEXT = ("\n".join(f"0 SECTION 2 HEADER 9 $ACADVER 1 AC1009 0 ENDSEC 0 SECTION 2 ENTITIES {rectangle()} 0 ENDSEC 0 EOF"
                  .split()) + "\n").encode()  # fmt: skip
TURNED = TEXT.replace(b"\n10\n10\n20\n0\n11\n", b"\n20\n0\n10\n10\n11\n")
IRREGULAR = {
    "without an end": TEXT.removesuffix(b"0\nEOF\n"),
    "with an open section": TEXT.replace(b"0\nENDSEC\n0\nEOF", b"0\nEOF"),
    "with a byte order mark": b"\xef\xbb\xbf" + TEXT, "with carriage returns": TURNED.replace(b"\n", b"\r"),
    "with bad handles": TEXT.replace(b"LINE\n", b"LINE\n5\nZZ\n"),
    "with handles 0": TEXT.replace(b"LINE\n", b"LINE\n5\n0\n"),
    "with handles twice": TURNED.replace(b"LINE\n", b"LINE\n5\n21\n"),
    "with comments": TURNED.replace(b"0\nLINE\n", b"999\nnote\n0\nLINE\n"),
}  # fmt: skip


@pytest.mark.parametrize("data", IRREGULAR.values(), ids=list(IRREGULAR))
def test_irregular_files_are_recovered_with_one_notice(own_text, data):
    assert data != TEXT
    program = own_text(data)
    assert size(program) == [10, 6]
    assert sum("the drawing is irregular" in notice for notice in program.notices) == 1


def test_the_librarys_warnings_are_one_notice(own_text, capfd):
    program = own_text(TEXT.replace(b"LINE\n", b"LINE\n5\n21\n"))
    assert size(program) == [10, 6]
    (message,) = [notice for notice in program.notices if "irregular" in notice]
    assert "handle #21" in message
    assert capfd.readouterr() == ("", "")


def test_a_drawing_without_a_header_is_in_mm(own_text):
    program = own_text(TEXT[TEXT.index(b"0\nSECTION\n2\nENTITIES") :])
    assert size(program) == [10, 6]
    assert "the drawing sets no unit ($INSUNITS): it is read as mm" in program.notices


OTHERS = {
    "empty": (b"", "this file is empty"), "blank": (b" \r\n\n", "this file is empty"),
    "DWG": (b"AC1032\0\0\0" + bytes(99), "this is a DWG file"), "old DWG": (b"AC1.40\0", "this is a DWG file"),
    "UTF-16": (TEXT.decode().encode("utf-16"), "in UTF-16: save it as UTF-8"),
    "UTF-16 without mark": (TEXT.decode().encode("utf-16-be"), "in UTF-16: save it as UTF-8"),
    "noise": (random.Random(1).randbytes(5000) + b"\0", "not a DXF drawing but a binary file"),
    "zeros": (bytes(900), "not a DXF drawing but a binary file"),
    "G-code": (b"G1 X5\nM2\n", "text that does not begin with a group code"),
    "numbers": (b"0\n1\n2\n3\n", "it has no SECTION"), "cut off": (TEXT[:200], r"dxf:\d+: the drawing is cut off"),
    "no group code": (TEXT.replace(b"\n11\n", b"\nxy\n", 1), r"dxf:23: this is not a group code"),
    "X alone": (TEXT.replace(b"\n21\n0\n", b"\n", 1), r"dxf:15: LINE has X and Y without each other"),
    "decimal comma": (TURNED.replace(b"\n10\n10\n", b"\n10\n10,0\n"), "'10,0' is not a number: write it with a dec"),
    "no such block": (TURNED.replace(b"0\nLINE", b"0\nINSERT\n2\nNIX\n10\n0\n20\n0\n0\nLINE", 1), "1 of its parts"),
    "binary DXF cut off": (b"AutoCAD Binary DXF\r\n\x1a\x00" + bytes(7), "this binary DXF drawing is damaged"),
}  # fmt: skip


@pytest.mark.parametrize(("data", "message"), OTHERS.values(), ids=list(OTHERS))
def test_what_is_no_whole_drawing_is_refused_in_plain_words(own_text, data, message):
    with pytest.raises(InputError) as caught:
        own_text(data)
    assert caught.match(message)
    assert "\n" not in str(caught.value)
    for python in ("Error", "Invalid", "object", "None", "Traceback", "b'"):
        assert python not in caught.value.reason


@pytest.mark.parametrize("version", ["R12", "R2010"])
def test_binary_drawings_are_read(tmp_path, version):
    document = ezdxf.new(version)
    document.header["$INSUNITS"] = 4
    document.modelspace().add_circle((0, 0), 3)
    document.saveas(tmp_path / "own.dxf", fmt="bin")
    assert size(read_dxf(tmp_path / "own.dxf")) == pytest.approx([6, 6], abs=0.01)
