"""The example programs, and two from a workshop if their files are present."""

import math
import runpy
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import shapely

from edmsim.program import plan_path

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
SHOP = ROOT.parent / "shared" / "data" / "programs"
OFFSET_MM = 0.155


@cache
def planned(file):
    if not file.exists():
        pytest.skip(f"{file.name} is not there")
    return plan_path(file, auto_offset_mm=OFFSET_MM)


def length_mm(contour):
    return np.hypot(*np.diff(contour.points_um, axis=0).T).sum() / 1000


@pytest.mark.parametrize("file", [
    EXAMPLES / "punch.ngc", EXAMPLES / "gear.dxf", EXAMPLES / "slot.iso",
    SHOP / "pinion-15.iso", SHOP / "chain-sprocket-18.dxf",
], ids=lambda file: file.name)  # fmt: skip
def test_the_wire_keeps_its_distance_everywhere(file):
    path = planned(file)
    for contour in path.contours:
        cut = contour.points_um[contour.lead_in_moves :] / 1000
        edge = shapely.LineString(contour.nominal_mm)
        assert abs(shapely.distance(edge, shapely.points(cut)) - OFFSET_MM).max() < 0.002
        assert shapely.LineString(contour.points_um / 1000).distance(edge) > OFFSET_MM - 0.002
        hole = shapely.Point(contour.points_um[0] / 1000).buffer(path.start_hole_radius_mm)
        assert not any(hole.intersects(shapely.LineString(other.nominal_mm)) for other in path.contours)


def test_the_punch():
    (contour,) = planned(EXAMPLES / "punch.ngc").contours
    edge = shapely.Polygon(contour.nominal_mm)
    rounded = (1.5**2 + 1.0**2) * (1 - math.pi / 4)
    assert edge.area == pytest.approx(60 - rounded - math.pi * 0.8**2 / 2, abs=0.01)
    assert np.ptp(contour.nominal_mm, axis=0) == pytest.approx([10, 6])
    assert length_mm(contour) == pytest.approx(34.2, abs=0.2)
    assert contour.part_side == "right"


def test_the_slot():
    path = planned(EXAMPLES / "slot.iso")
    (contour,) = path.contours
    assert length_mm(contour) == pytest.approx(8 + math.tau * (1 - OFFSET_MM) + 1, abs=0.02)
    assert contour.part_side == "left"
    for what in ("whole um", "absolute", "G60", "G38", "D0", "F1000"):
        assert any(what in notice for notice in path.notices), what


@pytest.mark.slow
def test_the_gear():
    path = planned(EXAMPLES / "gear.dxf")
    bore, outside = (shapely.Polygon(contour.nominal_mm) for contour in path.contours)
    assert bore.area == pytest.approx(math.pi * 1.2**2, rel=2e-3)
    assert shapely.minimum_bounding_radius(outside) == pytest.approx(3.5, abs=1e-3)
    assert outside.contains(bore)
    turned = shapely.affinity.rotate(outside, 30, origin=bore.centroid)
    assert turned.symmetric_difference(outside).area < 0.01


@pytest.mark.slow
def test_the_gear_is_what_its_script_draws(tmp_path):
    script = tmp_path / "make_gear.py"
    script.write_text((EXAMPLES / "make_gear.py").read_text())
    runpy.run_path(str(script), run_name="__main__")
    drawn, shipped = (planned(folder / "gear.dxf") for folder in (tmp_path, EXAMPLES))
    for one, other in zip(drawn.contours, shipped.contours, strict=True):
        # not exactly: the last bit of a sine depends on the processor, and so do the chords
        apart = shapely.LineString(one.points_um).hausdorff_distance(shapely.LineString(other.points_um))
        assert apart < 2.0


def test_the_pinion_is_an_opening_cut_from_inside():
    path = planned(SHOP / "pinion-15.iso")
    (contour,) = path.contours
    assert len(contour.nominal_mm) == 91
    assert contour.part_side == "left"
    assert shapely.Polygon(contour.nominal_mm).contains(shapely.Point(contour.points_um[0] / 1000))
    assert length_mm(contour) == pytest.approx(101.5, abs=0.2)
    for what in ("G60", "G38", "F1000", "lead-in"):
        assert any(what in notice for notice in path.notices), what


def test_the_sprocket_is_one_closed_outside():
    path = planned(SHOP / "chain-sprocket-18.dxf")
    (contour,) = path.contours
    edge = shapely.Polygon(contour.nominal_mm)
    assert shapely.minimum_bounding_radius(edge) == pytest.approx(12.5, abs=1e-3)
    assert not edge.contains(shapely.Point(contour.points_um[0] / 1000))
    turned = shapely.affinity.rotate(edge, 20, origin=edge.centroid)
    assert turned.symmetric_difference(edge).area < 0.05
    assert any("unit" in notice for notice in path.notices)
