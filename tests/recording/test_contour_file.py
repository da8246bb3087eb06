"""The contour of a cut in files for other programs, and its deviation table."""

import csv
import dataclasses
import re

import numpy as np
import pytest
import shapely
from ezdxf.filemanagement import readfile

from edmsim.errors import InputError
from edmsim.recording.exports import write_contour
from edmsim.recording.html_report import elements_table
from edmsim.recording.report import Element


def expected(cut):
    scene = cut.scene.in_program()
    return list(scene.cut_edges_mm[scene.middle_slice()])


def as_drawn(cut):
    return cut.scene.in_program().maps[0].nominal_mm


def test_a_drawing_has_the_cut_and_the_nominal_edge_in_the_programs_coordinates(cut, tmp_path):
    write_contour(cut.scene, tmp_path / "new" / "cut.dxf")
    document = readfile(tmp_path / "new" / "cut.dxf")
    assert document.units == 4
    lines = {layer: document.modelspace().query(f'LWPOLYLINE[layer=="{layer}"]') for layer in ("CUT", "NOMINAL")}
    for line, edge in zip(lines["CUT"], expected(cut), strict=True):
        assert line.closed
        assert shapely.LinearRing(line.get_points("xy")).hausdorff_distance(shapely.LinearRing(edge)) < 1e-9
    (nominal,) = lines["NOMINAL"]
    assert np.array(nominal.get_points("xy")) == pytest.approx(as_drawn(cut)[:-1])


def test_a_table_and_a_picture_hold_the_same(cut, tmp_path):
    write_contour(cut.scene, tmp_path / "cut.csv")
    write_contour(cut.scene, tmp_path / "cut.svg")
    with (tmp_path / "cut.csv").open() as file:
        rows = list(csv.DictReader(file))
    nominal = np.array([(float(r["x_mm"]), float(r["y_mm"])) for r in rows if r["layer"] == "NOMINAL"])
    assert nominal == pytest.approx(as_drawn(cut), abs=1e-5)
    assert {r["line"] for r in rows if r["layer"] == "CUT"} == {str(k + 1) for k in range(len(expected(cut)))}
    paths = re.findall(r'class="nominal".* d="M([^"]*) Z"', (tmp_path / "cut.svg").read_text())
    drawn = np.array([[float(v) for v in point.split(",")] for point in paths[0].split(" L")])
    assert drawn * (1, -1) == pytest.approx(nominal)


def test_specks_are_left_out(cut, tmp_path):
    speck = shapely.get_coordinates(shapely.Point(25, 24).buffer(0.005))
    edges = tuple((*lines, speck) for lines in cut.scene.cut_edges_mm)
    write_contour(dataclasses.replace(cut.scene, cut_edges_mm=edges), tmp_path / "cut.dxf")
    assert len(readfile(tmp_path / "cut.dxf").modelspace().query('LWPOLYLINE[layer=="CUT"]')) == len(expected(cut))


def test_a_contour_without_a_cut_has_no_line_at_a_height(cut, tmp_path):
    far = dataclasses.replace(cut.scene.maps[0], nominal_mm=cut.scene.maps[0].nominal_mm + 40.0)
    scene = dataclasses.replace(cut.scene, maps=(*cut.scene.maps, far))
    write_contour(scene, tmp_path / "cut.svg", height_mm=5.0)
    text = (tmp_path / "cut.svg").read_text()
    assert (text.count('class="cut"'), text.count('class="nominal"')) == (1, 2)


def test_another_suffix_is_refused(cut, tmp_path):
    with pytest.raises(InputError, match=r"\.dxf \.csv \.svg"):
        write_contour(cut.scene, tmp_path / "cut.step")


def row(number, high_um):
    return Element(1, number, None, "arc", 0.5, float(number), *[high_um] * 4, -1e-9, -2.0, 1.0, 2.0)


def test_the_table_shows_every_element_or_the_worst_of_very_many():
    text = elements_table([row(1, 3.0), row(2, None)])
    cells = re.findall(r"<td>([^<]*)</td>", text)
    assert cells[:8] == ["1", "–", "arc R 0.500", "0.000", "−2.000", "1.000", "2.000", "1.000"]
    assert cells[8:11] == ["+3.0"] * 3
    assert cells[19:] == ["–", "–", "–"]
    many = elements_table([row(number, float(number)) for number in range(1, 301)])
    assert "The 200 of 300" in many
    assert many.count("<tr>") == 201
    assert "<td>101.000</td>" in many
    assert "<td>100.000</td>" not in many
