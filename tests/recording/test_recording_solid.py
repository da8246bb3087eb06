"""Solids: closed, of the right volume; the kerf grows from nothing to what was cut; the machine's own bodies."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from edmsim.machine.machine import Machine
from edmsim.plant.constants import wire_setup
from edmsim.plant.mechanics.model import build_model
from edmsim.recording.rerun.logs import (
    BASE,
    CROSS,
    KERF_FRAMES,
    TABLE,
    bodies_of,
    box,
    cylinder,
    growing_kerf,
    prism,
)
from edmsim.recording.scene import Terrace
from edmsim.recording.windows import column

from .conftest import LEAD


def volume(mesh):
    """Return the volume by the divergence theorem; the normals say which side of a triangle is outside."""
    a, b, c = (mesh.positions.astype(float)[mesh.triangles[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    outside = np.sign(np.einsum("ij,ij->i", across, mesh.normals[mesh.triangles[:, 0]]))
    return float((outside * np.einsum("ij,ij->i", across, a)).sum() / 6.0)


@settings(max_examples=30)
@given(
    points=st.lists(st.tuples(st.floats(0, 20), st.floats(0, 20)), min_size=1, max_size=5), reach=st.floats(0.5, 3)
)
def test_a_prism_has_area_times_height(points, reach):
    area = shapely.box(-5, -5, 25, 25).difference(shapely.MultiPoint(points).buffer(reach, quad_segs=4))
    assert volume(prism(area, -2.0, 5.0)) == pytest.approx(7.0 * area.area, rel=1e-4)


def test_simple_bodies():
    assert volume(box(np.array([1.0, 2.0, 3.0]))) == pytest.approx(48.0)
    assert volume(cylinder(2.0, 5.0)) == pytest.approx(np.pi * 4 * 10, rel=0.02)  # 24 sides


def grown(cut, **changed):
    methods = {name: getattr(cut.scene, name) for name in ("middle_slice", "bored", "lead_mm")}
    scene = SimpleNamespace(**{**vars(cut.scene), **methods, **changed})
    places = np.column_stack([column(cut.windows, name) for name in ("x_um", "y_um")])
    return growing_kerf(scene, places, column(cut.windows, "path_um"))


@pytest.mark.slow
def test_the_kerf_grows_until_it_is_what_was_cut(cut):
    growth = grown(cut)
    assert len(growth.solids) <= KERF_FRAMES + 1
    assert growth.rows[0] == 0
    assert growth.rows[-1] == len(cut.windows) - 1
    volumes = np.array([volume(solid) for solid in growth.solids])
    whole = (20.0 * 16.0 - np.pi * 0.5**2) * 20.0  # the start hole is drilled
    assert volumes[0] == pytest.approx(whole, rel=1e-3)
    assert np.all(np.diff(volumes) < 0.1)  # mm3
    kerf = shapely.build_area(shapely.MultiLineString(list(cut.scene.cut_edges_mm[4])))
    hole = shapely.Point(19.0, 19.0).buffer(0.5)
    assert volumes[0] - volumes[-1] == pytest.approx(kerf.difference(hole).area * 20.0, rel=0.03)


@pytest.mark.slow
def test_a_stepped_workpiece_has_its_steps(cut):
    low, high = (shapely.box(15, 15, x, 31) for x in (25, 35))
    rings = [np.array(part.exterior.coords) for part in (low, high.difference(low))]
    growth = grown(cut, terraces=(Terrace((rings[0],), 8.0), Terrace((rings[1],), 20.0)))
    assert volume(growth.solids[0]) == pytest.approx(16 * (10 * 8 + 10 * 20) - np.pi * 0.25 * 8, rel=1e-3)


def test_the_machine_is_drawn_as_its_mjcf_has_it():
    machine = Machine.load(height_mm=30.0)
    clearance = machine.base.guides.clearance_mm.value
    model = build_model(wire_setup(machine), machine.base.model)
    bodies = bodies_of(model, -clearance)
    for carrier in (BASE, CROSS, TABLE):
        assert len(bodies.solids[carrier].positions) == len(bodies.colours[carrier]) > 100
    lower, upper = (bodies.solids[part].positions for part in (TABLE, BASE))
    assert lower[:, 2].min() > upper[:, 2].min()  # the table stands on the base
    low, high = bodies.plate_mm
    assert high[2] - low[2] == pytest.approx(30.0)  # as thick as the guides leave room for
    assert low[2] == pytest.approx(0.0, abs=1e-6)
    nozzle = model.geom("upper_nozzle")  # it ends at the upper guide, where the arm holds it
    ends = upper[np.hypot(upper[:, 0], upper[:, 1]) < nozzle.size[0] * 1000 * 1.01]
    assert np.any(np.isclose(ends[:, 2], 30.0 + clearance, atol=1e-3))


def test_a_leaning_wire_leaves_a_kerf_that_leans(cut):
    count, height_mm = len(cut.scene.cut_edges_mm), 20.0
    square = np.array([(20.0, 20.0), (20.4, 20.0), (20.4, 20.4), (20.0, 20.4), (20.0, 20.0)])
    heights = (np.arange(count) + 0.5) / count * height_mm
    edges = tuple((np.column_stack([square[:, 0] + (z + 10.0) / 10.0, square[:, 1]]),) for z in heights)
    scene = replace(cut.scene, lead=LEAD, cut_edges_mm=edges, terraces=())
    np.testing.assert_allclose(scene.lead_mm(np.array([0.0]), heights)[0, :, 0], (heights + 10.0) / 10.0)
    places = np.array([[20_200.0, 20_000.0], [20_200.0, 20_400.0]])
    solids = growing_kerf(scene, places, np.array([0.0, 400.0])).solids
    assert volume(solids[0]) - volume(solids[-1]) == pytest.approx(0.4 * 0.4 * height_mm, rel=0.01)
