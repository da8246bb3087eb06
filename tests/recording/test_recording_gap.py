"""The gap in the recording: discharges where they were, traces as the model has them, rays and wall."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from edmsim.plant.kernel.state import OPEN
from edmsim.recording.figures import palette
from edmsim.recording.rerun.logs import AGES, SCOPE_PULSES, discharges, faded
from edmsim.recording.rerun.playback import Playback
from edmsim.recording.scene import Terrace
from edmsim.recording.video import Film
from edmsim.recording.windows import traces

from .conftest import LEAD


def test_traces_show_delay_burning_and_short(cut):
    table = cut.closeups.table()
    time, voltage, current = traces(table, SCOPE_PULSES)
    assert time.shape == (len(table), SCOPE_PULSES, 7)
    # by turns: 10 us of 100 V and 20 us of burning, 30 us open, 30 us short, an arc burning at once
    for number, (peak_V, volt_us, ampere_us) in enumerate(
        [(100.0, 10 * 100.0 + 20 * 22.0, 20 * 6.6), (100.0, 30 * 100.0, 0.0), (0.0, 0.0, 30 * 8.0),
         (100.0, 30 * 22.0, 30 * 6.6)]
    ):  # fmt: skip
        t, u, i = (values[0, number] for values in (time, voltage, current))
        assert u.max() == pytest.approx(peak_V)
        assert np.trapezoid(u, t) == pytest.approx(volt_us, rel=1e-6)
        assert np.trapezoid(i, t) == pytest.approx(ampere_us, rel=1e-6)
        assert np.all(np.diff(t) >= 0)
    np.testing.assert_allclose(time[:, :, 0], np.broadcast_to(100.0 * np.arange(SCOPE_PULSES), time.shape[:2]))


def test_a_trace_ends_with_the_window_where_pulses_wait_for_their_ignition(cut):
    """Their periods differ, their pauses do not: 70 us after discharges of 1 us that began after 20 us or 5."""
    table = cut.closeups.table()[:1].copy()
    delay_us = np.resize([20.0, 5.0], table["pulses"].shape[1])
    took_us = delay_us + 1.0 + 70.0
    table["pulses"]["delay_us"], table["pulses"]["conducting_us"] = delay_us, 1.0
    table["pulses"]["start_us"], table["count"] = np.cumsum(took_us) - took_us, len(took_us)
    for count in (5, SCOPE_PULSES):
        assert traces(table, count)[0].max() == pytest.approx(took_us[-count:].sum())
    assert traces(table, 1)[0].max() == pytest.approx(6.0)  # of one pulse no pause is known


def test_discharges_are_on_the_metal_and_opens_have_no_place(cut):
    table = cut.closeups.table()
    known, place = discharges(table, 125.0)
    np.testing.assert_array_equal(known, table["pulses"]["kind"] != OPEN)
    out = place - np.stack([table["pulses"]["x_um"], table["pulses"]["y_um"]], axis=-1)
    sparks = table["pulses"]["kind"] == 1
    np.testing.assert_allclose(out[sparks], np.broadcast_to((140.0, 0.0), out[sparks].shape), atol=1e-6)


def test_points_lie_on_the_table_and_fade(cut, play):
    table = cut.closeups.table()
    t_s = float(table["t_s"][50])
    points = play.points("/world/table/discharges", "Points3D:positions", t_s)
    colours = play.points("/world/table/discharges", "Points3D:colors", t_s).astype(np.uint32)
    radii = play.points("/world/table/discharges", "Points3D:radii", t_s)
    assert len(points) == len(colours) == 72 + (AGES - 1) * 36  # of the older ones every second
    np.testing.assert_allclose(points[:, 2], 10.0, atol=1e-4)  # the middle of 20 mm
    np.testing.assert_allclose(points[0, :2], (table["wire_um"][50] + (140.0, 0.0)) / 1000.0, atol=1e-4)
    assert len(set(colours.tolist())) > AGES
    assert radii[0] < radii[-1] < 0  # points of the screen, ever smaller


def test_faded_colours_reach_the_ground():
    some = np.array([[200, 100, 50]] * 2, np.uint8)
    np.testing.assert_array_equal(faded(some, np.array([1.0, 0.0])), [[200, 100, 50], [0x1F, 0x29, 0x33]])


def test_rays_end_on_the_wall(cut, play):
    table = cut.closeups.table()
    rays = np.array(play.strips("/top/rays", "LineStrips2D:strips", float(table["t_s"][0])))
    assert rays.shape == (16, 2, 2)  # the half that meets metal
    wire = play.points("/top/wire", "Points2D:positions", float(table["t_s"][0]))[0]
    shift = table["wire_um"][0] - table["guides_um"][0]
    np.testing.assert_allclose(wire, shift * (1.0, -1.0), atol=1e-4)
    np.testing.assert_allclose(np.hypot(*(rays[:, 0] - wire).T), 125.0, atol=1e-3)
    np.testing.assert_allclose(np.hypot(*(rays[:, 1] - wire).T), 140.0, atol=1e-3)
    assert len(play.strips("/top/metal", "LineStrips2D:strips", float(table["t_s"][0]))) == 15


def test_a_leaning_wire_is_on_its_guides_axis_at_the_height_of_the_wall(cut, record, play, tmp_path):
    table = cut.closeups.table()[:30].copy()
    scene = replace(cut.scene, lead=LEAD, terraces=(Terrace(cut.scene.middle_edges_mm(), 8.0),))
    led_mm, away_mm, (edge,) = 0.1 * (scene.middle_mm() + 10.0), np.array([2.0, 0.0]), scene.maps
    table["wire_um"][:, 0] += 1e3 * led_mm
    leaning = Playback(record(
        tmp_path / "cut.rrd", scene=replace(scene, walls_mm=((edge.nominal_mm, edge.nominal_mm + away_mm),)),
        windows=cut.windows.slice(0, 30), closeups=SimpleNamespace(table=lambda: table, stride=1),
    ))  # fmt: skip
    t_s = float(table["t_s"][0])
    places = [of.points("/top/wire", "Points2D:positions", t_s) for of in (leaning, play)]
    np.testing.assert_allclose(*places, atol=1e-3)
    drawn, upright = (of.strips("/top/part/nominal", "LineStrips2D:strips", t_s)[0] for of in (leaning, play))
    np.testing.assert_allclose(drawn - upright, [[1e2 * scene.middle_mm(), 0.0]] * len(drawn), atol=0.01)


@pytest.mark.slow
def test_a_leaning_wire_has_its_discharges_and_its_path_in_the_kerf(cut, record, play, tmp_path):
    """The wire leads its lower guide by 0.1 mm per mm of height over -10 mm."""
    table = cut.closeups.table()[:30].copy()
    slices = table["deflection_um"].shape[1]
    pulses, heights = table["pulses"], 20.0 * (np.arange(slices) + 0.5) / slices
    table["wire_um"][:, 0] += 2000.0
    pulses["slice"] = np.where(pulses["kind"] == OPEN, -1, np.arange(pulses.shape[1]) % slices)
    pulses["x_um"] = table["wire_um"][:, :1] + 100.0 * (heights[pulses["slice"]] - 10.0)
    scene = replace(cut.scene, lead=LEAD)
    upright, play = play, Playback(record(
        tmp_path / "cut.rrd", scene=scene, windows=cut.windows.slice(0, 30),
        closeups=SimpleNamespace(table=lambda: table, stride=1),
    ))  # fmt: skip
    t_s = float(table["t_s"][0])
    x_mm, _, z_mm = play.points("/world/table/discharges", "Points3D:positions", t_s).T
    wall_mm = table["wire_um"][0, 0] / 1000.0 + 0.1 * (z_mm - 10.0) + 0.125
    assert set(np.round(x_mm - wall_mm, 3).tolist()) == {0.0, 0.015}  # shorts have no gap, discharges one of 15 um
    above = play.points("/top/discharges", "Points2D:positions", t_s)
    gap_um = np.hypot(*(above - play.points("/top/wire", "Points2D:positions", t_s)[0]).T) - 125.0
    assert set(np.round(gap_um, 1).tolist()) == {0.0, 15.0}
    done = play.strips("/world/table/done", "LineStrips3D:strips", t_s)[0][-1]
    led_mm = 0.1 * (heights[-1] + 10.0)
    np.testing.assert_allclose(done[:2], table["guides_um"][0] / 1000.0 + (led_mm, 0.0), atol=1e-5)
    leaning, upright = (
        np.argwhere((Film(of, 60).picture(t_s)[60:250, 20:230] == palette.rgb(palette.ORANGE)).all(axis=2))
        for of in (play, upright)
    )
    part_mm = 0.62 * 2 * 11.0  # width of the part in the film
    assert leaning[:, 1].mean() - upright[:, 1].mean() == pytest.approx(215 / part_mm * led_mm, rel=0.05)


def test_both_timelines_reach_every_part(cut, play):
    for entity, component in (("/top/rays", "LineStrips2D:strips"), ("/scope/voltage", "LineStrips2D:strips"),
                              ("/world/table/discharges", "Points3D:positions")):  # fmt: skip
        rows = play.rows(entity, component)
        np.testing.assert_allclose(rows.t_s, cut.closeups.table()["t_s"], atol=1e-9)
        np.testing.assert_array_equal(rows.path_um, np.round(cut.closeups.table()["path_um"]))


def test_playback_before_the_first_row_shows_nothing(play):
    assert play.strips("/top/rays", "LineStrips2D:strips", -1.0) == []
    assert len(play.points("/no/such", "Points2D:positions", 1.0)) == 0
    assert play.title == "punch.ngc"
    assert Path(play.recording).name == "cut.rrd"
