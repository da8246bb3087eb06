"""A short tapered cut: guides, walls at every height, resume, drives, and what is refused."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import shapely

import edmsim
from edmsim.closed_loop.passes import PassRecord, PassSetup, Sums
from edmsim.closed_loop.simulation import Simulation
from edmsim.controllers import axis, from_text
from edmsim.errors import InputError
from edmsim.job.options import CutSettings
from edmsim.job.plan import check, guides_of
from edmsim.job.result import inspect, pass_figures
from edmsim.machine.machine import Machine
from edmsim.metrology.edges import metal_at
from edmsim.metrology.kerf import WallError
from edmsim.metrology.profile import slice_heights_mm
from edmsim.metrology.roughness import electrolysed_um
from edmsim.plant.plant import Plant
from edmsim.plant.workpiece.height_steps import LowerRegion
from edmsim.plant.workpiece.kerf_field import Stock
from edmsim.program.outline import Outline, Program, Taper
from edmsim.program.passes import PassPlan
from edmsim.program.path import plan_path
from edmsim.recording.scene import read_scene, write_scene
from edmsim.recording.windows import WindowTable
from edmsim.validation.setups import altered

HEIGHT_MM, ANGLE_DEG = 3.0, 15.0
TAN = math.tan(math.radians(ANGLE_DEG))


def line_of(angle_deg, length_mm=0.6):
    """A straight cut along x whose wall leans towards +y, threaded 0.5 mm before its beginning."""
    points = np.array([[0.0, 0.0], [length_mm, 0.0]])
    outline = Outline(
        points, (0,), False, "right", "left", np.array([[-0.5, -0.164 / math.cos(math.radians(angle_deg))]]), (0,), 1,
        needs_lead_in=False, elements=(1,), taper=Taper((angle_deg,), corners="sharp"),
    )  # fmt: skip
    return Program((outline,), (), "line")


def cut_of(angle_deg=ANGLE_DEG, planner="exact", machine=None, **options):
    machine = machine or Machine.load(height_mm=HEIGHT_MM)
    path = plan_path(
        line_of(angle_deg), auto_offset_mm=machine.auto_offset_mm, start_hole_radius_mm=0.17,
        guides=[guides_of(machine, (0.0, 0.0))],
    )  # fmt: skip
    return Simulation(machine, path, from_text("fixed:feed_um_s=33"), planner=planner, resolution="fast", **options)


@pytest.fixture(scope="module")
def finished():
    cut = cut_of()
    assert cut.run() == "finished"
    return cut


def walls_um(cut):
    """Edges of the metal on both sides of the wire, slice by slice, averaged over some points of the path."""
    return np.mean([_across_um(cut, x_mm) for x_mm in np.linspace(0.2, 0.4, 21)], axis=0)


def _across_um(cut, x_mm):
    contour, field = cut.path.contours[0], cut.plant.field
    origin = contour.lean.wall.at(0.0)[0]
    across = np.arange(-400.0, 1600.0, 0.5)
    places = np.stack([np.full_like(across, 1e3 * (origin[0] + x_mm)), 1e3 * origin[1] + across], axis=1)
    metal = metal_at(field, places)
    found = []
    for row in metal:
        open_ = np.flatnonzero(row < 0.5)
        found.append((across[open_[0]], across[open_[-1]]))
    return np.array(found)


def test_the_upper_guide_leads_by_its_angle(finished):
    u, v = finished.plant.lead_um
    low, high = guides_of(finished.machine, (0.0, 0.0)).bends_mm(np.array([[0.0, TAN]]))[0]
    assert v == pytest.approx(1e3 * (high - low) * TAN, abs=2.0)
    assert u == 0.0


@pytest.mark.slow
def test_a_stop_is_marked_where_the_wire_was_at_mid_height():
    cut = cut_of()
    while cut.path_um < 100.0:
        cut.step()
    low, high = guides_of(cut.machine, (0.0, 0.0)).bends_mm(np.array([[0.0, TAN]]))[0]
    stop_mm, led_mm = inspect(cut, WindowTable()).scene.stop_mm, cut.plant.lead_um[1] * 1e-3
    ahead_mm = np.array(stop_mm) - np.array(cut.commanded_um) * 1e-3
    assert led_mm > 0.1
    assert ahead_mm == pytest.approx([0.0, led_mm * (HEIGHT_MM / 2 - low) / (high - low)], abs=3e-3)


def test_both_walls_lean_and_lie_an_ellipse_apart(finished):
    heights_um = slice_heights_mm(finished.plant.field, HEIGHT_MM) * 1e3
    upright = cut_of(1e-6)
    upright.run()
    tilted, straight = walls_um(finished), walls_um(upright)
    lean = np.polyfit(heights_um, tilted.mean(axis=1), 1)[0]
    assert lean == pytest.approx(TAN, abs=2e-3)
    kerf, plain = np.diff(tilted, axis=1).mean(), np.diff(straight, axis=1).mean()
    assert kerf == pytest.approx(plain / math.cos(math.radians(ANGLE_DEG)), abs=4.0)
    part = tilted[:, 1] - heights_um * TAN  # the part's wall, relative to the drawn line
    assert np.abs(part - straight[:, 1].mean()).max() < 5.0


@pytest.mark.parametrize("angle_deg", [0.0, ANGLE_DEG])
def test_a_rate_counts_the_local_height_along_the_wire(angle_deg):
    cut = cut_of(angle_deg, lower_regions=(LowerRegion(shapely.box(-1e6, -1e6, 1e6, 1e6), 2.0),))
    ends_um = cut.total_um - 500.0, cut.total_um
    cut.passes.records.append(PassRecord(1, 1, "profile", False, 164.0, 0.0, 60.0, *ends_um))
    (found,) = pass_figures(cut)
    assert found.rate_mm2_min == pytest.approx(0.5 * 2.0 / math.cos(math.radians(angle_deg)), rel=2e-3)


def test_the_layer_of_a_trim_is_unknown_where_its_stock_is():
    cut = cut_of()
    for number in (1, 2):
        cut.passes.records.append(PassRecord(1, number, "profile", False, 164.0, 0.0, 60.0, 0.0, 500.0))
    rough, trim = pass_figures(cut)
    assert rough.heat_affected_um is not None
    assert (trim.stock_um, trim.heat_affected_um) == (None, None)


@pytest.mark.slow
def test_what_the_water_dissolved_is_of_the_last_pass():
    cut = cut_of()
    for number, voltage_s, left_um in ((1, 900.0, 30.0), (2, 50.0, 2.0)):
        wall = WallError(9, left_um, 1.0, (left_um,) * 5, 0.0, 0.0, 0.0, 0.1)
        ends, sums = (0.0, float(number), 0.0, 500.0), Sums(voltage_s=voltage_s)
        cut.passes.records.append(PassRecord(1, number, "profile", False, 150.0 + left_um, *ends, sums, wall))
    expected = electrolysed_um(cut.machine, 50.0 / 0.5, 150.0 - cut.machine.wire_diameter_um / 2)
    assert inspect(cut, WindowTable()).part.surface.electrolysed_um == pytest.approx(expected)


@pytest.mark.slow
@pytest.mark.parametrize("options", [{"planner": "poscal"}, {"drives": {n: axis.tuned("uhu") for n in "xy"}}])
def test_planners_that_count_and_drives_make_the_same_wall(finished, options):
    cut = cut_of(**options)
    assert cut.run() == "finished"
    np.testing.assert_allclose(walls_um(cut), walls_um(finished), atol=8.0)


def test_a_guide_that_is_higher_than_the_control_knows_moves_the_wall():
    machine = Machine.load(height_mm=HEIGHT_MM)
    stock = Stock((0.0, 0.0, 65_000.0, 65_000.0), ((30_000.0, 30_000.0, 5_000.0),))
    lead = (0.0, 2_000.0)
    found = []
    for error_mm in (0.0, 0.1):
        moved = altered(machine, {"base.guides.lower_error_mm": error_mm})
        plant = Plant(moved, 0, stock=stock, position_um=(30_000.0, 30_000.0, *lead), resolution="fast")
        plant.advance()
        plant.advance()
        found.append(plant._arrays.lean_share[: plant.resolution.slices] * lead[1])
    # an error of z of 0.1 mm gives tan a x 0.1 mm at the lower guide, and less towards the upper one
    distance_mm = machine.guide_distance_mm - 2 * 1.45
    heights_mm = 10.0 - 1.45 + (np.arange(len(found[0])) + 0.5) / len(found[0]) * HEIGHT_MM
    expected = -lead[1] / distance_mm * 0.1 * (1 - heights_mm / distance_mm)
    np.testing.assert_allclose(found[1] - found[0], expected, rtol=0.03)


OFFSETS_MM = (0.2, 0.165)


def in_passes(tensions_N=(10.0, 14.0)):
    """A rough cut and a trim back along the leaning line, under two tensions."""
    machines = [Machine.load(height_mm=HEIGHT_MM, tension=tension_N) for tension_N in tensions_N]
    path = plan_path(
        line_of(ANGLE_DEG, 1.6), auto_offset_mm=0.2, start_hole_radius_mm=0.17, passes=PassPlan(OFFSETS_MM),
        guides=[guides_of(machine, (0.0, 0.0)) for machine in machines],
    )  # fmt: skip
    setups = [PassSetup(machine, from_text("fixed:feed_um_s=33")) for machine in machines]
    return Simulation(machines[0], path, setups[0].controller, planner="exact", resolution="fast", setups=setups)


@pytest.fixture(scope="module")
def trimmed():
    """A cut in passes after its end, and a snapshot from the middle of its trim."""
    cut, snapshot = in_passes(), None
    while cut.outcome is None:
        cut.step()
        if snapshot is None and len(cut.passes.records) == 2 and cut.path_um > cut.total_um - 300.0:
            snapshot = cut.snapshot()
    assert cut.outcome == "finished"
    return cut, snapshot


@pytest.mark.slow
def test_a_leaning_wire_trims_its_wall_at_every_height(trimmed):
    cut, _ = trimmed
    rough, trim = cut.passes.records
    assert (rough.number, trim.number, trim.reversed) == (1, 2, True)
    assert rough.wall.mean_um - trim.wall.mean_um == pytest.approx(1e3 * (OFFSETS_MM[0] - OFFSETS_MM[1]), abs=8.0)
    assert np.ptp(trim.wall.slices_um) < cut.plant.resolution.cell_um  # as straight as the rulings
    heights_um = slice_heights_mm(cut.plant.field, HEIGHT_MM) * 1e3
    part = walls_um(cut)[:, 1]
    assert np.polyfit(heights_um, part, 1)[0] == pytest.approx(TAN, abs=2e-3)
    # the wall measured by the pass equals that measured at right angles to it
    across = (part - heights_um * TAN) * math.cos(math.radians(ANGLE_DEG))
    assert across.mean() == pytest.approx(-trim.wall.mean_um, abs=3.0)
    for record in (rough, trim):  # the face stored for pictures, in the planes of the slices
        face = np.array(record.face_um)
        inner = face[:, len(face[0]) // 3 : -len(face[0]) // 3]
        assert np.nanmean(inner) * math.cos(math.radians(ANGLE_DEG)) == pytest.approx(record.wall.mean_um, abs=3.0)


@pytest.mark.slow
def test_every_pass_leads_its_guides_by_its_own_tension(trimmed):
    cut, _ = trimmed
    bends = [guides_of(cut.machine_of(number), (0.0, 0.0)).bends_mm(np.array([[0.0, TAN]]))[0] for number in (1, 2)]
    leads = [one.lean.upper_um[-1, 1] for one in cut.path.contours[0].passes]
    assert leads[1] > leads[0]  # with more tension the wire bends nearer to the guides
    np.testing.assert_allclose(leads, [1e3 * (high - low) * TAN for low, high in bends], atol=1.0)


@pytest.mark.slow
def test_a_leaning_trim_goes_on_to_the_bit_from_its_snapshot(trimmed):
    cut, snapshot = trimmed
    again = in_passes()
    again.restore(*snapshot)
    again.run()
    arrays, whole = again.snapshot()[0], cut.snapshot()[0]
    assert all(arrays[name].tobytes() == whole[name].tobytes() for name in whole)
    assert json.dumps(again.passes.snapshot()) == json.dumps(cut.passes.snapshot())


SODICK = """( ONE WALL THAT LEANS IN BY 3 DEGREES, CUT AND TRIMMED )
C001 = 0012 0016 2215 000 250 +034.0 8.0 0040 0 0000 0000 025 120 100 050;
C002 = 0002 0010 2205 000 230 +052.0 7.0 6040 0 0000 0000 025 140 100 012;
H000 = +000000.0000;
H001 = +000000.1850;
H002 = +000000.1550;
TP0.0 TN2.0;
G90 G92 X0.0 Y-0.5;
C001 G41 H001 G52 A0;
G01 Y0.0;
A3.0;
X-1.6;
G40 H000 A0 G01 Y-0.3;
C002 G42 H002 G51 A0;
G01 Y0.0;
A3.0;
X0.0;
G40 H000 G50 G01 Y-0.3;
M02;
"""
CONDITIONS = """[C001]
tension_N = 10.0
feed_um_s = 70.0
[C002]
tension_N = 14.0
t_on_us = 0.6
t_period_us = 16.0
feed_um_s = 90.0
"""


@pytest.mark.slow
def test_a_program_trims_its_leaning_wall_with_its_own_conditions(tmp_path):
    program, table = tmp_path / "wall.nc", tmp_path / "conditions.toml"
    program.write_text(SODICK)
    table.write_text(CONDITIONS)
    result = edmsim.cut(
        program, conditions=str(table), height_mm=2.0, machine="production", generator="production",
        wire="brass-250", planner="exact", resolution="fast",
    )  # fmt: skip
    rough, trim = result.report["passes"]
    assert result.report["outcome"] == "finished"
    assert (rough["offset_um"], trim["offset_um"]) == (185.0, 155.0)
    assert (rough["reversed"], trim["reversed"]) == (False, True)
    assert trim["stock_um"] == pytest.approx(30.0, abs=10.0)
    assert trim["straightness_um"] < 6.0
    leads = [one.lean.upper_um[-2, 1] for one in result.path.contours[0].passes]
    assert leads[1] > leads[0]  # with more tension the wire bends nearer to the guides
    assert [face.error_um.shape[0] for face in result.scene.pass_faces] == [5, 5]


@pytest.mark.parametrize("name", ["taper-sodick.nc", "taper-mitsubishi.nc", "taper-charmilles.iso"])
def test_the_examples_of_tapers_in_passes_are_planned_whole(name):
    found = check(
        Path(__file__).parents[1] / "examples" / "dialects" / name, CutSettings(height_mm=16.0, resolution="fast")
    )
    (contour,) = found.path.contours
    assert [one.number for one in contour.passes] == [1, 2]
    assert contour.passes[0].offset_um > contour.passes[1].offset_um
    assert all(np.abs(one.lean.upper_um).max() > 300 for one in contour.passes)
    assert [row.number for row in found.passes] == [1, 2]
    assert 600 < found.expected_s < 3000


@pytest.mark.slow
@pytest.mark.usefixtures("draws_pictures")
def test_a_cut_reports_its_taper(tmp_path):
    file = tmp_path / "block.ngc"
    file.write_text("G21 G90\nG92 X0.5 Y-0.6\nG41 D1 G1 X0.5 Y0\nX0\nY1\nX1\nY0\nX0.5\nG40 Y-0.6\nM02\n")
    result = edmsim.cut(
        file, height_mm=2.0, taper_deg=5.0, taper_corners="sharp", planner="exact",
        resolution="fast", controller="fixed:feed_um_s=33",
    )
    report = result.report
    assert report["settings"]["taper_deg"] == 5.0
    assert report["profile_error_um"]["rms"] < 12.0
    scene = result.scene
    assert len(scene.walls_mm) == 1
    np.testing.assert_allclose(
        np.ptp(scene.walls_mm[0][0], axis=0) - np.ptp(scene.walls_mm[0][1], axis=0), 4 * math.tan(math.radians(5)),
    )
    write_scene(scene, tmp_path / "part.npz")
    again = read_scene(tmp_path / "part.npz")
    np.testing.assert_array_equal(again.lead, scene.lead)
    at = again.lead_mm(np.array([again.lead[-1, 0]]), np.array([0.0, 2.0]))[0]
    assert at[1, 1] - at[0, 1] == pytest.approx(2.0 * math.tan(math.radians(5)), rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(("feed_um_s", "slowed"), [(33, True), (5, False)])
def test_a_cut_tells_that_its_planner_slowed_a_tilted_wire(feed_um_s, slowed, tmp_path):
    file = tmp_path / "disc.ngc"
    file.write_text("G21 G90\nG92 X1 Y-0.4\nG42 D1 G1 X1 Y0\nG3 X1 Y0 I0 J2\nG1 G40 Y-0.4\nM02\n")
    result = edmsim.cut(
        file, height_mm=2.0, taper_deg=-3.0, planner="poscal", resolution="fast", max_time_s=1.0,
        controller=f"fixed:feed_um_s={feed_um_s}",
    )  # fmt: skip
    assert any("the wire was slower than its feed in" in text for text in result.report["notices"]) == slowed


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"taper_deg": 50.0}, "cannot lean by 50 degrees"),
        ({"taper_deg": 3.0, "taper_corners": "shap"}, "did you mean 'sharp'"),
        ({"taper_deg": 3.0, "planner": "poscal-literal"}, "moves two axes"),
        ({"upper_layer": "UPPER"}, "a drawing has this"),
        ({"guide_errors_mm": (9.0, 0.0)}, "not within 5 mm"),
        ({"taper_deg": 20.0, "height_mm": 80.0}, "the upper guide go"),
    ],
)
def test_bad_input_is_one_line(options, said, tmp_path):
    file = Path(__file__).parents[1] / "examples" / "die.ngc"
    with pytest.raises(InputError, match=said) as caught:
        edmsim.cut(file, **{"height_mm": 4.0, "resolution": "fast", **options})
    assert "\n" not in str(caught.value)
