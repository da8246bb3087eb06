"""The cut face of a wall in closed form, as a mesh, and the contour of a part at any height."""

import csv
import dataclasses
import math
from itertools import pairwise

import numpy as np
import pytest

from edmsim.errors import InputError
from edmsim.recording.exports import cut_faces, write_contour, write_faces
from edmsim.recording.scene import ErrorMap, Scene, Terrace

trimesh = pytest.importorskip("trimesh")

HEIGHT_MM, SIDE_MM, SLICES = 5.0, 4.0, 5
LEAN_MM, LEFT_UM = 0.5, 7.0
"""How far the wall leans inwards over the height, and what metal is left on it."""


def square(half_mm):
    return half_mm * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)], float)


@pytest.fixture
def scene():
    heights = (np.arange(SLICES) + 0.5) / SLICES
    halves = SIDE_MM / 2 - LEAN_MM * heights + LEFT_UM * 1e-3
    middle = square(SIDE_MM / 2 - LEAN_MM / 2)
    return Scene(
        maps=(ErrorMap(middle, "left", middle, np.full(5, LEFT_UM)),),
        cut_edges_mm=tuple((square(half), square(half + 0.34)) for half in halves), corners=(),
        starts_mm=np.array([[0.0, -3.0]]), stock_mm=(-4.0, -4.0, 4.0, 4.0), height_mm=HEIGHT_MM,
        guides_z_mm=(-10.0, 15.0), wire_diameter_um=250.0,
        walls_mm=((square(SIDE_MM / 2), square(SIDE_MM / 2 - LEAN_MM)),),
    )  # fmt: skip


def test_a_face_follows_the_wall_slice_by_slice(scene):
    (face,) = cut_faces(scene)
    assert face.points_mm.shape[0] == SLICES + 2
    assert face.points_mm[0, :, 2].max() == 0.0
    assert face.points_mm[-1, :, 2].min() == HEIGHT_MM
    for k, half in ((0, SIDE_MM / 2), (-1, SIDE_MM / 2 - LEAN_MM)):  # the faces lie beyond the outer slices
        assert np.abs(face.points_mm[k, :, :2]).max() == pytest.approx(half + LEFT_UM * 1e-3, abs=2e-3)
    inner = np.abs(np.abs(face.points_mm[3, :, :2]).min(axis=1)) < 1.5  # away from corners
    np.testing.assert_allclose(face.error_um[3][inner], LEFT_UM, atol=0.1)
    (at,) = face.at(2.0)  # between two slices
    assert np.abs(at).max() == pytest.approx(SIDE_MM / 2 - LEAN_MM * 0.4 + LEFT_UM * 1e-3, abs=2e-3)


def outwards(mesh):
    """Mean sign of the normals of a mesh along the way out of its middle."""
    out = mesh.triangles_center - mesh.bounds.mean(axis=0)
    return float(np.sign(np.einsum("ij,ij->i", out, mesh.face_normals)).mean())


def test_stl_is_in_mm_and_gltf_in_metres_with_y_upwards(scene, tmp_path):
    write_faces(scene, tmp_path / "face.stl")
    mesh = trimesh.load(tmp_path / "face.stl")
    assert mesh.bounds[:, 2].tolist() == [0.0, HEIGHT_MM]
    slant = math.hypot(1.0, LEAN_MM / HEIGHT_MM)
    assert mesh.area == pytest.approx(4 * (SIDE_MM - LEAN_MM) * HEIGHT_MM * slant, rel=0.02)
    write_faces(scene, tmp_path / "face.glb")
    shown = trimesh.load(tmp_path / "face.glb")
    wide_mm = SIDE_MM + 2e-3 * LEFT_UM
    np.testing.assert_allclose(np.ptp(shown.bounds, axis=0) * 1e3, (wide_mm, HEIGHT_MM, wide_mm), atol=4e-3)
    (geometry,) = shown.geometry.values()
    assert [round(outwards(one), 1) for one in (mesh, geometry)] == [1.0, 1.0]  # it is turned, not mirrored
    (edge,), (walls,), away = scene.maps, scene.walls_mm, np.array([20.0, 0.0])
    other = dataclasses.replace(edge, nominal_mm=edge.nominal_mm + away, points_mm=edge.points_mm + away)
    both = dataclasses.replace(
        scene, maps=(edge, other), walls_mm=(walls, tuple(wall + away for wall in walls)),
        cut_edges_mm=tuple((*lines, *(line + away for line in lines)) for lines in scene.cut_edges_mm),
    )
    write_faces(both, tmp_path / "both.stl")
    two = trimesh.load(tmp_path / "both.stl")
    assert two.area == pytest.approx(2 * mesh.area, rel=1e-3)
    assert np.ptp(two.bounds, axis=0)[0] == pytest.approx(20.0 + wide_mm, abs=4e-3)
    assert geometry.visual.kind == "vertex"


def test_normals_point_away_from_the_part_in_either_direction(scene, tmp_path):
    (edge,) = scene.maps
    turned = dataclasses.replace(
        edge, nominal_mm=edge.nominal_mm[::-1], points_mm=edge.points_mm[::-1], part_side="right"
    )
    walls = tuple(wall[::-1] for wall in scene.walls_mm[0])
    write_faces(dataclasses.replace(scene, maps=(turned,), walls_mm=(walls,)), tmp_path / "face.stl")
    assert round(outwards(trimesh.load(tmp_path / "face.stl")), 1) == 1.0


def test_a_contour_at_a_height_lies_on_the_wall(scene, tmp_path):
    write_contour(scene, tmp_path / "part.csv", 4.0)
    rows = list(csv.DictReader((tmp_path / "part.csv").read_text(encoding="utf-8").splitlines()))
    cut = np.array([(float(row["x_mm"]), float(row["y_mm"])) for row in rows if row["layer"] == "CUT"])
    nominal = np.array([(float(row["x_mm"]), float(row["y_mm"])) for row in rows if row["layer"] == "NOMINAL"])
    assert np.abs(nominal).max() == pytest.approx(SIDE_MM / 2 - LEAN_MM * 0.8, abs=1e-5)
    assert np.abs(cut).max() == pytest.approx(SIDE_MM / 2 - LEAN_MM * 0.8 + LEFT_UM * 1e-3, abs=2e-3)


def test_no_contour_runs_through_what_was_not_cut(scene, tmp_path):
    open_mm = [(2.5, 0.0), (5.0, 0.0), (5.0, -9.0)]
    lines = [np.concatenate([line[:2], open_mm, line[:1]]) for line, _ in scene.cut_edges_mm]
    part = dataclasses.replace(scene, cut_edges_mm=tuple((line,) for line in lines))
    write_contour(part, tmp_path / "part.csv", 4.0)
    rows = list(csv.DictReader((tmp_path / "part.csv").read_text(encoding="utf-8").splitlines()))
    cut = [row for row in rows if row["layer"] == "CUT"]
    assert cut
    for number in {row["line"] for row in cut}:
        line = [(float(row["x_mm"]), float(row["y_mm"])) for row in cut if row["line"] == number]
        assert np.hypot(*np.diff(line, axis=0).T).max() < 0.2


def test_a_face_is_where_the_profile_error_is_known_and_nowhere_else(scene):
    dense = np.concatenate([np.linspace(a, b, 200, endpoint=False) for a, b in pairwise(scene.maps[0].nominal_mm)])
    known_um = np.full((SLICES, len(dense)), LEFT_UM)
    known_um[0, :400], known_um[1, 400:] = np.nan, np.nan  # as behind the front of a cut, or next to a step
    mean_um = np.full(len(dense), LEFT_UM)
    edge = dataclasses.replace(scene.maps[0], points_mm=dense, error_um=mean_um, face_um=known_um)
    (face,) = cut_faces(dataclasses.replace(scene, maps=(edge,)))
    shares = np.isfinite(face.error_um[1:-1]).mean(axis=1)
    np.testing.assert_allclose(shares, (0.5, 0.5, 1.0, 1.0, 1.0), atol=0.01)


def test_a_wall_far_from_its_edge_has_a_face(scene):
    left_mm = 0.24  # as with an offset that is too large
    halves = SIDE_MM / 2 - LEAN_MM * (np.arange(SLICES) + 0.5) / SLICES + left_mm
    far = dataclasses.replace(scene, cut_edges_mm=tuple((square(half), square(half + 0.34)) for half in halves))
    (face,) = cut_faces(far)
    np.testing.assert_allclose(np.median(face.error_um, axis=1), 1e3 * left_mm, atol=0.1)


def test_the_kerf_of_a_stepped_workpiece_is_next_to_the_edge_of_its_height(scene, tmp_path):
    low = Terrace((square(4.0),), 0.4 * HEIGHT_MM)  # its middle slice is the second from below, at 1.5 mm
    write_contour(dataclasses.replace(scene, terraces=(low,)), tmp_path / "kerf.csv")
    rows = list(csv.DictReader((tmp_path / "kerf.csv").read_text(encoding="utf-8").splitlines()))
    cut, drawn = (
        max(float(row["x_mm"]) for row in rows if (row["layer"], row["line"]) == (layer, "1"))
        for layer in ("CUT", "NOMINAL")
    )
    assert drawn == pytest.approx(SIDE_MM / 2 - LEAN_MM * 0.3, abs=1e-5)
    assert cut - drawn == pytest.approx(LEFT_UM * 1e-3, abs=1e-5)


def test_what_cannot_be_written_is_one_line(scene, tmp_path):
    with pytest.raises(InputError, match="5 mm"):
        write_contour(scene, tmp_path / "part.dxf", 6.0)
    with pytest.raises(InputError, match=r"written as \.stl \.glb"):
        write_faces(scene, tmp_path / "face.obj")
    with pytest.raises(InputError, match="no cut face"):
        write_faces(dataclasses.replace(scene, cut_edges_mm=()), tmp_path / "face.stl")


def test_a_contour_that_is_no_edge_of_the_part_has_no_face(scene, tmp_path):
    none = np.zeros(0)
    on_the_wire = dataclasses.replace(scene.maps[0], points_mm=np.zeros((0, 2)), error_um=none)
    unmeasured = dataclasses.replace(scene.maps[0], error_um=np.full(5, np.nan))
    for edge in (on_the_wire, unmeasured):
        with pytest.raises(InputError, match="no cut face"):
            write_faces(dataclasses.replace(scene, maps=(edge,)), tmp_path / "face.stl")
        write_contour(dataclasses.replace(scene, maps=(edge,)), tmp_path / "part.csv", 4.0)
        assert "CUT" not in (tmp_path / "part.csv").read_text(encoding="utf-8")
