"""Passes in a cut: one kerf field under several settings, resumed to the bit; pieces that come loose."""

import json
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
import shapely

import edmsim
from edmsim.closed_loop.passes import PassLog, PassSetup, legs_of
from edmsim.closed_loop.simulation import Simulation
from edmsim.controllers import from_text
from edmsim.controllers.axis.elcam.file import ErrorTable, load_tables
from edmsim.errors import InputError
from edmsim.job.options import CutSettings
from edmsim.job.plan import prepared
from edmsim.job.result import inspect, totals
from edmsim.machine.technology import machine_of, technology_for
from edmsim.metrology.edges import loose_pieces, metal_at
from edmsim.metrology.roughness import face_roughness_um, ra_over_depth, roughness_um
from edmsim.plant.workpiece.kerf_field import KerfField, Stock
from edmsim.program.straight import straight_path
from edmsim.recording.windows import WindowTable


def setups(height_mm=25.4):
    found = technology_for("tool-steel").table(height_mm, 2).settings
    machines = [machine_of(one, "production", "tool-steel", "brass-254", height_mm) for one in found]
    return [PassSetup(m, from_text(one.controller())) for m, one in zip(machines, found, strict=True)]


def started(length_mm=0.5, resolution="fast", height_mm=25.4, seed=0, **options):
    both = setups(height_mm)
    offsets_mm = technology_for("tool-steel").table(height_mm, 2).offsets_mm
    path = straight_path(offsets_mm, length_mm, both[0].machine)
    return Simulation(
        both[0].machine, path, both[0].controller, planner="exact", seed=seed, resolution=resolution, setups=both,
        **options,
    )  # fmt: skip


def state_of(simulation):
    arrays, values = simulation.snapshot()
    return {name: array.tobytes() for name, array in arrays.items()}, json.dumps(values)


@cache
def cut_with_a_snapshot_in_each_pass():
    simulation, states, windows = started(), [], 0
    while simulation.outcome is None:
        simulation.step()
        windows += 1
        if windows % 150 == 100:
            arrays, values = simulation.snapshot()
            states.append((arrays, json.loads(json.dumps(values))))
    return simulation, states


@pytest.mark.slow
def test_a_cut_resumed_in_any_pass_is_equal_to_the_bit():
    simulation, states = cut_with_a_snapshot_in_each_pass()
    assert {values["at"]["leg"] for _, values in states} >= {1, 2}  # in the rough pass, and in its trim
    for arrays, values in states[:: max(len(states) - 1, 1)]:
        again = started()
        again.restore(arrays, values)
        again.run()
        assert state_of(again) == state_of(simulation)


def test_a_trim_takes_from_one_side_what_the_rough_pass_left():
    simulation, _ = cut_with_a_snapshot_in_each_pass()
    rough, trim = simulation.passes.records
    assert (rough.number, trim.number, trim.reversed) == (1, 2, True)
    assert trim.sums.crater_um3 < 0.5 * rough.sums.crater_um3
    assert rough.sums.pulses + trim.sums.pulses < simulation.sums.pulses  # the lead-in is neither's
    assert trim.begin_s >= rough.end_s


@pytest.mark.slow
def test_no_offset_is_advised_before_the_last_pass_is_cut():
    simulation, states = cut_with_a_snapshot_in_each_pass()
    assert inspect(simulation, WindowTable()).part.offset.to_use_mm is not None
    stopped = started()
    stopped.restore(*states[-1])
    assert len(stopped.passes.records) == 2
    offset = inspect(stopped, WindowTable()).part.offset
    assert (offset.mean_error_um, offset.to_use_mm) == (None, None)


@pytest.mark.slow
def test_what_a_compensation_does_to_a_trimmed_wall_is_the_drives_share():
    rough_mm = 1e-3 * started(0.3).path.contours[0].wire_paths[0].along_um[-1]  # the rough pass is cut without it
    shift = ErrorTable("y", "path", np.array([(0.0, 0.0), (rough_mm, 0.0), (rough_mm + 0.001, 14.0), (9.0, 14.0)]))
    windows = WindowTable()
    simulation = started(0.3, compensation=load_tables([shift]), recorders=(windows,))
    simulation.run()
    found = inspect(simulation, windows)
    planner, drive = found.scene.maps[0].shares_um[1:3, 6:10]  # far from the trim's ends
    np.testing.assert_allclose(planner, 0.0, atol=0.1)
    np.testing.assert_allclose(drive, 14.0, atol=0.1)
    assert found.part.table_error_um.left_um.rms == pytest.approx(14.0, abs=0.1)


@pytest.mark.slow
def test_a_trim_that_begins_in_a_short_runs_back_along_the_rough_pass():
    """The wire hung behind; straightened for the trim, it touches the metal ahead of the rough pass."""
    simulation, trim_s, behind = started(0.1, height_mm=76.2), [], []
    while simulation.outcome is None:
        now = simulation.step()
        if simulation.leg == len(simulation.legs) - 1:
            trim_s.append(now.time_s)
            if simulation.path_um < simulation.leg_from_um and not behind:
                behind.append(simulation.snapshot())
    assert simulation.outcome == "finished"
    assert trim_s[-1] - trim_s[0] < 5.0  # 8 s if no trim ran back over its beginning
    ((arrays, values),) = behind
    again = started(0.1, height_mm=76.2)
    again.restore(arrays, json.loads(json.dumps(values)))
    again.run()
    assert state_of(again) == state_of(simulation)


@pytest.mark.slow
def test_craters_leave_no_waves_on_a_trimmed_wall():
    """Craters that take evenly from their width leave waves of 3 um at `fine` (theory/workpiece.md)."""
    simulation = started(1.4, "fine")  # at `default` such waves stay below the limit
    simulation.run()
    for record in simulation.passes.records:
        assert record.wall.places >= 6
        assert record.wall.waves_um < 1.2


@pytest.mark.slow
def test_a_dwell_in_a_pass_is_waited_for_and_is_part_of_it():
    simulation, waits_s = started(0.3), 2.0
    contour = simulation.path.contours[0]
    rough, trim = contour.passes
    passes = (rough, replace(trim, dwells=((1, waits_s),)))
    path = replace(simulation.path, contours=(replace(contour, passes=passes),))
    both, ended = setups(), []
    for one in (simulation.path, path):
        cut = Simulation(
            both[0].machine, one, setups()[0].controller, planner="exact", resolution="fast", setups=setups()
        )
        assert cut.run() == "finished"
        ended.append(cut)
    plain, waiting = ([(r.number, r.end_s - r.begin_s) for r in cut.passes.records] for cut in ended)
    assert [number for number, _ in waiting] == [1, 2]
    assert waiting[0] == plain[0]
    assert waiting[1][1] - plain[1][1] == pytest.approx(waits_s, abs=0.5)


@pytest.mark.slow
def test_what_is_cut_once_after_the_trims_of_another_contour_has_the_rough_setting():
    simulation, both = started(0.1), setups()
    contour = simulation.path.contours[0]
    apart_um = np.array([0, 3000])
    once = replace(
        contour, passes=(), points_um=contour.points_um + apart_um, nominal_mm=contour.nominal_mm + apart_um * 1e-3
    )
    path = replace(simulation.path, contours=(contour, once))
    windows = WindowTable()
    cut = Simulation(
        both[0].machine, path, both[0].controller, planner="exact", resolution="fast", setups=both,
        recorders=(windows,),
    )  # fmt: skip
    cut.run()
    assert cut.controller is both[0].controller
    assert cut.plant.machine.t_on_us == both[0].machine.t_on_us
    rough, alone = cut.passes.records[0], cut.legs[-1]
    out_of_hole_mm = np.ptp(alone.along_um) * 1e-3 - path.start_hole_radius_mm
    area_mm2 = ((rough.end_um - rough.begin_um) * 1e-3 + out_of_hole_mm) * both[0].machine.height_mm
    assert totals(cut, windows, 1.0).cut_area_mm2 == pytest.approx(area_mm2, rel=0.02)


TWO_SQUARES = """C001 = 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15
C002 = 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15
H001 = 0.19
H002 = 0.165
"""
ROUND = {1: (0.4, 0.0, "G41"), 2: (0.0, 0.4, "G42")}
CONDITIONS = """[C001]
t_on_us = 1.0
t_period_us = 60.0
tension_N = 12.0
open_target_share = 0.4
[C002]
t_on_us = 0.6
t_period_us = 40.0
tension_N = 14.0
feed_um_s = 120.0
"""


def cut_two_squares(folder, order):
    """Cut two squares of 0.4 mm rough and back, in an order of (left edge, pass)."""
    text = TWO_SQUARES
    for x, number in order:
        there, back, code = ROUND[number]
        text += f"C00{number}\nG0 X{x - 0.6} Y0.2\n{code} G1 X{x} H00{number}\n"
        text += f"Y{there}\nX{x + 0.4}\nY{back}\nX{x}\nY0.2\nG40\n"
    program, table = folder / "squares.nc", folder / "table.toml"
    program.write_text(text + "M02\n")
    table.write_text(CONDITIONS)
    return edmsim.cut(
        program, conditions=str(table), dialect="sodick", height_mm=3.0, resolution="fast", planner="exact",
        machine="production", generator="production", wire="brass-250",
    )  # fmt: skip


@pytest.mark.slow
def test_the_planner_has_no_share_where_the_last_pass_returns_for_a_tab_round_a_corner(tmp_path):
    """The third pass of the tab begins before a corner, that of the profile ends behind it."""
    program = tmp_path / "square.ngc"
    program.write_text("G92 X0.6 Y-0.5\nG41\nG1 X0.6 Y0\nX0\nY1.2\nX1.2\nY0\nX0.6\nG40\nM2\n")
    cut = edmsim.cut(program, passes=3, tab_mm=0.4, height_mm=25.4, resolution="fast")
    profile, tab = (row for row in cut.report.passes if row.number == 3)
    assert tab.begin_s > profile.end_s
    np.testing.assert_allclose(cut.scene.maps[0].shares_um[1], 0.0, atol=2.0)  # a motor step


@pytest.mark.slow
def test_trims_after_all_rough_passes_leave_the_same_walls(tmp_path):
    """In mean, walls of ten such cuts with other seeds scatter by 0.25 um."""
    shop, by_contour = (
        cut_two_squares(tmp_path, order)
        for order in (((0, 1), (2, 1), (0, 2), (2, 2)), ((0, 1), (0, 2), (2, 1), (2, 2)))
    )
    rows, others = shop.report.passes, by_contour.report.passes
    assert [(r.contour, r.number) for r in rows] == [(r.contour, r.number) for r in others]
    assert [r.offset_um for r in rows] == [r.offset_um for r in others] == [190.0, 165.0] * 2
    assert rows[0].ra_um == others[0].ra_um  # the first rough pass is the same cut
    assert rows[0].end_s < rows[2].begin_s < rows[2].end_s < rows[1].begin_s < rows[1].end_s < rows[3].begin_s
    walls_um = [[np.nanmean(edge.face_um) for edge in cut.scene.maps] for cut in (shop, by_contour)]
    np.testing.assert_allclose(walls_um, np.mean(walls_um), atol=0.75)


def test_a_plant_goes_on_under_another_setting():
    rough, trim = setups()
    plant = edmsim.Plant(rough.machine, 3, resolution="fast")
    for _ in range(20):
        plant.advance()
    metal, time_ns, pulses = plant.removed_mm3, plant.time_ns, plant.pulses
    plant.change_setup(trim.machine)
    assert plant.machine is trim.machine
    assert (plant.removed_mm3, plant.time_ns, plant.pulses) == (metal, time_ns, pulses)
    states = plant.snapshot()
    windows = [plant.advance() for _ in range(3)]
    plant.restore(states)
    assert [plant.advance() for _ in range(3)] == windows
    with pytest.raises(InputError, match="another height_mm cannot go on with this cut"):
        plant.change_setup(trim.machine.with_(height_mm=30.0))


def ring_of_holes(gap=0, radii_um=(500,)):
    """Return a block with circles of holes that meet, except for the last `gap` of each."""
    angles = np.linspace(0, 2 * np.pi, 80, endpoint=False)[: 80 - gap]
    holes = tuple((1000 + r * np.cos(a), 1000 + r * np.sin(a), 60.0) for r in radii_um for a in angles)
    return Stock((0.0, 0.0, 2000.0, 2000.0), holes)


def test_a_piece_that_nothing_holds_is_found_and_taken_out():
    field = KerfField(3, ring_of_holes(), 4.0, 4000.0)
    field.allocate(1000.0, 1000.0, 200.0)  # only its middle
    (piece,) = loose_pieces(field, 0.02)
    assert piece.area * 1e-6 == pytest.approx(np.pi * 0.44**2, rel=0.05)
    before = field.removed_parts
    assert field.remove_piece(piece) > 0
    assert field.removed_parts == before  # it was not removed by discharges
    field.allocate(1000.0, 1000.0, 600.0)  # the rest of it, and what is around
    inside, outside = np.array([[1000.0, 1000.0], [1000.0, 1380.0]]), np.array([[1000.0, 1620.0]])
    assert not metal_at(field, inside).any()
    assert metal_at(field, outside).all()
    assert loose_pieces(field, 0.02) == []
    again = KerfField(3, ring_of_holes(), 4.0, 4000.0)
    again.restore(field.snapshot())
    assert shapely.equals_exact(again.gone[0], field.gone[0])
    for no_piece in (5, piece.exterior, shapely.Polygon(), piece.difference(piece.buffer(-50.0))):
        with pytest.raises(edmsim.InputError, match=r"a piece is a shapely\.Polygon in um without"):
            field.remove_piece(no_piece)
    assert len(field.gone) == 1


def test_a_part_is_found_around_its_slug_that_fell():
    field = KerfField(3, ring_of_holes(radii_um=(300, 800)), 4.0, 4000.0)
    field.allocate(1000.0, 1000.0, 1000.0)
    field.remove_piece(shapely.Point(1000.0, 1000.0).buffer(250.0))
    (part,) = loose_pieces(field, 0.02)
    assert part.area * 1e-6 == pytest.approx(np.pi * 0.74**2, rel=0.05)


def test_a_piece_on_its_tab_is_held():
    field = KerfField(3, ring_of_holes(gap=6), 4.0, 4000.0)
    field.allocate(1000.0, 1000.0, 700.0)
    assert loose_pieces(field, 0.02) == []


CLIP_AND_BLOCK = """G21 G90
G92 X0.6 Y-0.5
G41 G1 X0.6 Y0.0
X0.0
Y1.2
X1.0
Y0.9
X0.3
Y0.3
X1.0
Y0.0
X0.6
G0 X2.4 Y-0.5
G41 G1 X2.4 Y0.0
X2.0
Y0.5
X2.6
Y0.0
X2.4
M02
"""


@pytest.mark.slow
def test_a_rough_pass_has_no_rate_before_it_leaves_the_start_hole(tmp_path):
    program = tmp_path / "square.ngc"
    program.write_text("G92 X0.5 Y-0.26\nG41\nG1 X0.5 Y0.\nX0.\nY1.\nX1.\nY0.\nX0.5\nG40\nM2\n")
    report = edmsim.cut(program, passes=2, height_mm=25.4, resolution="fast", max_time_s=8.0).report
    (rough,) = report["passes"]
    assert rough["length_mm"] > 0
    assert report["cutting_rate_mm2_min"] is None


@pytest.mark.slow
@pytest.mark.parametrize(("share", "place"), [(0.1, "in pass 1, "), (0.3, "on the way to pass 1, ")])
def test_a_wire_break_names_its_pass(tmp_path, share, place):
    program = tmp_path / "square.ngc"
    program.write_text("G92 X0.5 Y-0.5\nG41\nG1 X0.5 Y0.\nX0.\nY1.\nX1.\nY0.\nX0.5\nG40\nM2\n")
    hot = {
        "cooling.critical_W_m2": 1e3, "cooling.convection_W_m2K": 300.0, "cooling.critical_stream": 0.0,
        "cooling.wire_heat_share": share,
    }  # fmt: skip
    report = edmsim.cut(program, passes=2, height_mm=25.4, resolution="fast", constants=hot, max_time_s=40.0).report
    assert report["outcome"] == "wire-break"
    assert report["reason"].startswith(f"the wire broke {place}")


@pytest.mark.slow
def test_a_part_that_came_loose_is_not_the_slug_of_the_next_contour(tmp_path):
    (tmp_path / "parts.ngc").write_text(CLIP_AND_BLOCK)
    cut = CutSettings(height_mm=25.4, passes=2, tab_mm=0.2, after_tab="cut")
    ready = prepared(tmp_path / "parts.ngc", cut)
    legs = legs_of(ready.path)
    ways = [shapely.LineString(leg.points_um) for leg in legs if leg.cut_pass.number == 1]
    places = [way.interpolate(um) for way in ways for um in np.arange(0.0, way.length, 60.0)]
    field = KerfField(3, Stock((20e3, 20e3, 45e3, 45e3), tuple((p.x, p.y, 160.0) for p in places)), 8.0, 8000.0)
    field.allocate(*ready.path.contours[0].nominal_mm.mean(axis=0) * 1e3, 4000.0)
    taken, log = [], PassLog(ready.path, legs)
    plant = SimpleNamespace(field=field, machine=ready.machine, remove_piece=taken.append)
    for number, leg in enumerate(legs):
        log.begin_leg(number, leg, 0.0, 0.0)
        log.end_leg(number, leg, plant)
    assert taken == []
    assert [text for text in log.notices if "tip onto the wire" not in text] == [
        "the part comes loose before its last pass and is taken to lie still: after_tab stop lets the machine stop "
        "for it to be held"
    ] * 2


@pytest.mark.slow
def test_a_fine_pass_needs_stock_to_make_the_face_its_own():
    coarse, fine, flatness = 5000.0, 60.0, 0.065
    alone = roughness_um(fine, flatness)
    depth_um = roughness_um(coarse, flatness) / ra_over_depth()  # of a crater of the coarse pass
    enough, little, nothing = (
        face_roughness_um([coarse, fine], [0.0, share * depth_um], flatness)[1] for share in (0.5, 0.3, 0.0)
    )
    assert enough == pytest.approx(alone, rel=0.1)
    assert enough < little < nothing
    assert nothing == pytest.approx(roughness_um(coarse, flatness), rel=0.15)
