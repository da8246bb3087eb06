"""Reading of drawings as closed outlines."""

import math

import ezdxf
import numpy as np
import pytest
import shapely

from edmsim.errors import InputError
from edmsim.program.dxf import read_dxf
from edmsim.program.outline import signed_area


def square(space, size=10.0, at=(0.0, 0.0)):
    corners = [(at[0], at[1]), (at[0] + size, at[1]), (at[0] + size, at[1] + size), (at[0], at[1] + size)]
    for i in range(4):
        space.add_line(corners[i], corners[(i + 1) % 4])


def area(outline):
    return signed_area(outline.points_mm)


def chord_error(outline, curve):
    """Return the greatest distance of the chords' middles from a curve, a dense polyline."""
    points = outline.points_mm
    return shapely.distance(shapely.LineString(curve), shapely.points((points[1:] + points[:-1]) / 2)).max()


def test_loose_lines_in_any_order_and_direction_make_one_outside(drawing):
    def draw(space):
        space.add_line((10, 0), (10, 10))
        space.add_line((0, 0), (10, 0))
        space.add_line((0, 0), (0, 10.003))
        space.add_line((10, 10), (0, 10))

    (outline,) = drawing(draw).outlines
    assert outline.closed
    assert area(outline) == pytest.approx(100, rel=1e-3)
    assert outline.points_mm[0].tolist() == [10, 0]
    assert (outline.wire_side, outline.part_side) == ("right", "left")
    assert set(outline.line_numbers) == {0}


def test_nesting_by_parity_and_inner_contours_first(drawing):
    def draw(space):
        square(space, 40)
        space.add_circle((20, 20), 15)
        square(space, 6, (17, 17))

    outlines = drawing(draw).outlines
    areas = [area(outline) for outline in outlines]
    assert areas == pytest.approx([36, -225 * math.pi, 1600], rel=1e-3)
    assert all(outline.part_side == "left" for outline in outlines)


def circle_line(radius, count=20000):
    angle = np.linspace(0, math.tau, count)
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def test_circles_and_arcs_within_a_micrometre(drawing):
    def draw(space):
        space.add_arc((0, 0), 25, 30, 200)
        space.add_arc((0, 0), 25, 200, 30)

    (outline,) = drawing(draw).outlines
    assert np.allclose(np.hypot(*outline.points_mm.T), 25, atol=1e-6)
    assert chord_error(outline, circle_line(25)) <= 1.01e-3


@pytest.mark.slow
def test_ellipses_within_a_micrometre(drawing):
    (outline,) = drawing(lambda space: space.add_ellipse((0, 0), (20, 0), 0.3)).outlines
    curve = circle_line(1, 100_000) * [20, 6]
    assert chord_error(outline, curve) <= 1.0e-3
    assert area(outline) == pytest.approx(120 * math.pi, rel=1e-3)


@pytest.mark.parametrize("start", [-math.pi, 0.3, math.tau])
def test_an_ellipse_all_round_may_begin_anywhere(drawing, start):
    def draw(space):
        space.add_ellipse((0, 0), (5, 0), 0.5, start, start + math.tau)
        block = space.doc.blocks.new("TURNED")
        block.add_ellipse((0, 0), (2, 0), 0.5, start, start + math.tau)
        space.add_blockref("TURNED", (0, 0), dxfattribs={"rotation": 20, "xscale": 1.2})

    inner, outer = drawing(draw).outlines
    assert [area(inner), area(outer)] == pytest.approx([-2.4 * math.pi, 12.5 * math.pi], rel=1e-3)


def test_splines_within_a_micrometre(drawing):
    control = [(0, 0), (10, -8), (20, 6), (30, -4), (33, 15), (20, 12), (5, 22), (-9, 10), (0, 0)]

    def draw(space):
        space.add_open_spline([(x, y, 0) for x, y in control])

    (outline,) = drawing(draw).outlines
    spline = ezdxf.math.BSpline(control, order=4)
    curve = np.array([(p.x, p.y) for p in spline.approximate(20000)])
    assert chord_error(outline, curve) <= 1.0e-3


def test_polylines_with_bulges(drawing):
    def draw(space):
        slot = [(0, 0, 0), (10, 0, 1), (10, 4, 0), (0, 4, 1)]
        space.add_lwpolyline(slot, format="xyb", close=True)
        space.add_polyline2d([(30, 0, -1), (34, 0, -1)], format="xyb", close=True)

    first, second = sorted(drawing(draw).outlines, key=lambda outline: -area(outline))
    assert area(first) == pytest.approx(40 + 4 * math.pi, rel=1e-3)
    assert area(second) == pytest.approx(4 * math.pi, rel=1e-3)


def test_a_mirrored_arc_lies_where_it_is_drawn(drawing):
    def draw(space):
        space.add_arc((0, 0), 5, 0, 180, dxfattribs={"extrusion": (0, 0, -1)})
        space.add_arc((0, 0), 5, 180, 360)

    (outline,) = drawing(draw).outlines
    assert area(outline) == pytest.approx(25 * math.pi, rel=1e-3)


@pytest.mark.parametrize(("code", "unit_mm"), [(1, 25.4), (5, 10.0), (13, 0.001), (4, 1.0), (0, 1.0)])
def test_units_are_honoured_and_reported(drawing, code, unit_mm):
    def draw(space):
        space.add_circle((0, 0), 3 / unit_mm)
        space.add_ellipse((0, 0), (5 / unit_mm, 0), 0.8)
        for half, add in ((6, space.add_lwpolyline), (7, space.add_polyline2d)):
            corners = half / unit_mm * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
            add(corners.tolist(), close=True)
        square(space, 16 / unit_mm, (-8 / unit_mm, -8 / unit_mm))

    program = drawing(draw, units=code)
    sizes = [np.ptp(outline.points_mm, axis=0).tolist() for outline in program.outlines]
    assert np.array(sizes) == pytest.approx(np.array([(6, 6), (10, 8), (12, 12), (14, 14), (16, 16)]), rel=1e-3)
    assert chord_error(program.outlines[0], circle_line(3)) <= 1.01e-3
    assert any("mm" in notice for notice in program.notices) == (code != 4)


@pytest.mark.parametrize("version", ["R12", "R2000", "R2018"])
def test_old_and_new_versions(drawing, version):
    assert area(drawing(square, version=version).outlines[0]) == pytest.approx(100)


def test_what_does_not_cut_is_named(drawing):
    def draw(space):
        square(space)
        space.add_text("PART 7")
        space.add_point((3, 3))
        space.add_line((2, 2), (2, 2))
        space.add_circle((5, 5), 1, dxfattribs={"layer": "Defpoints"})

    program = drawing(draw)
    assert len(program.outlines) == 1
    for what in ("1 TEXT", "1 POINT", "1 LINE of no length", "1 CIRCLE on a layer that is off"):
        assert any(what in notice for notice in program.notices), what


def test_a_layer_that_is_off_is_not_cut(tmp_path):
    document = ezdxf.new()
    document.layers.add("hidden").off()
    square(document.modelspace())
    document.modelspace().add_circle((5, 5), 1, dxfattribs={"layer": "hidden"})
    document.saveas(tmp_path / "layers.dxf")
    assert len(read_dxf(tmp_path / "layers.dxf").outlines) == 1


def gap(space):
    space.add_line((0, 0), (10, 0))
    space.add_line((10, 0.037), (10, 10))
    space.add_line((10, 10), (0, 0))


def branch(space):
    square(space)
    space.add_line((10, 10), (15, 15))


def crossed_circles(space):
    space.add_circle((0, 0), 5)
    space.add_circle((6, 0), 5)


def bow_tie(space):
    space.add_lwpolyline([(0, 0), (10, 10), (10, 0), (0, 10)], close=True)


def tilted(space):
    space.add_circle((0, 0), 5, dxfattribs={"extrusion": (0, 1, 1)})


def block_in_itself(space):
    space.doc.blocks.new("A").add_blockref("A", (1, 1))
    space.add_blockref("A", (0, 0))


@pytest.mark.parametrize(("draw", "words"), [
    (gap, ("gap of 0.037 mm", "X10.000 Y0.000", "X10.000 Y0.037")), (branch, ("3 ends meet at X10.000 Y10.000",)),
    (crossed_circles, ("cross or touch at X3.000",)), (bow_tie, ("crosses or retraces itself at X5.000 Y5.000",)),
    (tilted, ("CIRCLE", "out of the XY plane")), (block_in_itself, ("the block A lies in itself",)),
    (lambda space: space.add_text("nothing else"), ("nothing to cut",)),
    (lambda space: space.add_lwpolyline([(0, 0), (5, 0)], close=True), ("retraces itself",)),
])  # fmt: skip
def test_drawings_that_cannot_be_cut_are_refused(drawing, draw, words):
    with pytest.raises(InputError) as caught:
        drawing(draw)
    assert caught.value.file is not None
    for word in words:
        assert word in caught.value.reason


def test_an_unknown_unit_is_refused(drawing):
    with pytest.raises(InputError, match="INSUNITS = 20"):
        drawing(square, units=20)


def plate(space):
    """A plate with holes in nested blocks, which are rotated, stretched and repeated in a grid."""
    hole = space.doc.blocks.new("HOLE")
    hole.add_circle((0, 0), 1)
    hole.add_text("H")
    pair = space.doc.blocks.new("PAIR")
    pair.add_blockref("HOLE", (0, 0))
    pair.add_blockref("HOLE", (5, 0), dxfattribs={"xscale": 2, "layer": "slots"})
    space.add_circle((5, 5), 20)
    space.add_blockref("PAIR", (0, 0), dxfattribs={"rotation": 90})
    grid = {"column_count": 2, "column_spacing": 4, "row_count": 2, "row_spacing": 4, "layer": "grid"}
    space.add_blockref("HOLE", (10, 0), dxfattribs=grid)


def read_plate(tmp_path, **options):
    document = ezdxf.new("R2010", units=4)
    plate(document.modelspace())
    document.saveas(tmp_path / "plate.dxf")
    return read_dxf(tmp_path / "plate.dxf", **options)


def test_blocks_are_cut_where_they_are_inserted(tmp_path):
    program = read_plate(tmp_path)
    boxes = sorted(tuple(np.round(outline.points_mm.max(axis=0), 2)) for outline in program.outlines)
    assert boxes == [(1, 1), (1, 7), (11, 1), (11, 5), (15, 1), (15, 5), (25, 25)]
    assert program.notices == ("6 TEXT left out",)


def test_a_turned_block_in_a_stretched_block_is_stretched_across(drawing):
    def draw(space):
        bar, turned = space.doc.blocks.new("BAR"), space.doc.blocks.new("TURNED")
        bar.add_lwpolyline([(0, 0), (10, 0), (10, 1), (0, 1)], close=True)
        turned.add_blockref("BAR", (0, 0), dxfattribs={"rotation": 90})
        space.add_blockref("TURNED", (0, 0), dxfattribs={"xscale": 3})

    (outline,) = drawing(draw).outlines
    assert np.ptp(outline.points_mm, axis=0) == pytest.approx([3, 10])


@pytest.mark.parametrize("closed", [True, False])
def test_a_spline_through_fit_points_is_stretched_with_its_block(drawing, closed):
    points = [(3, 0), (1, 2.5), (-2, 2), (-3.5, -1), (0, -3)]

    def draw(space):
        for at, block in enumerate((space, space.doc.blocks.new("B"))):
            block.add_spline([(x + 20 * at, y, 0) for x, y in points]).closed = closed
            if not closed:
                block.add_line((20 * at, -3), (3 + 20 * at, 0))
        space.add_blockref("B", (0, 0), dxfattribs={"xscale": 2, "yscale": 0.7})

    drawn, stretched = drawing(draw).outlines
    expected = shapely.LineString((drawn.points_mm + np.array([20, 0])) * (2, 0.7))
    assert expected.hausdorff_distance(shapely.LineString(stretched.points_mm)) < 0.005


def test_only_the_layers_requested_are_cut_also_within_blocks(tmp_path):
    grid, rest = (read_plate(tmp_path, layers=layers) for layers in (["GRID"], ["0", "slots"]))
    assert [len(program.outlines) for program in (grid, rest)] == [4, 3]
    assert "3 CIRCLE on a layer not asked for left out" in grid.notices
    with pytest.raises(InputError, match="no layer nix; there are: 0, Defpoints, grid, slots"):
        read_plate(tmp_path, layers=["nix"])


def test_a_unit_that_makes_no_sense_is_requested(tmp_path):
    program = read_plate(tmp_path, unit="in")
    assert np.ptp(program.outlines[-1].points_mm, axis=0) == pytest.approx([1016, 1016], rel=1e-3)
    assert "the drawing is read in in, as requested, though the drawing says 1 mm" in program.notices
    refused = {"um": "spans 0.04 mm.*give --unit", "m": "spans 40000 mm.*--unit", "mile": "give one of"}
    for unit, words in refused.items():
        with pytest.raises(InputError, match=words):
            read_plate(tmp_path, unit=unit)


RING = [(10 * math.cos(a), 10 * math.sin(a), 0.0) for a in np.linspace(0, math.tau, 13)[:-1]]


def wrapped(spline):  # repeated control points, knots beyond the ends
    spline.set_closed(RING)


def written_once(spline):
    spline.control_points, spline.knots = RING, range(len(RING) + 7)


def through_points(spline):
    spline.fit_points = RING


@pytest.mark.parametrize(("write", "reach"), [(wrapped, 9.56), (written_once, 9.56), (through_points, 10.0)])
def test_closed_splines_as_cad_systems_write_them(drawing, write, reach):
    def draw(space):
        spline = space.add_spline()
        spline.dxf.flags, spline.dxf.degree = 11, 3  # closed, periodic, planar
        write(spline)

    (outline,) = drawing(draw).outlines
    assert np.hypot(*outline.points_mm.T) == pytest.approx(reach, abs=0.01)  # round, without a nick at its start
    assert outline.closed
