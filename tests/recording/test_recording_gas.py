"""Gas in what a cut leaves: share per slice, bubbles that show it and nothing else, figures of the report."""


import numpy as np
import pytest

from edmsim.controllers import WindowObservation
from edmsim.machine.machine import Machine
from edmsim.plant.plant import Plant
from edmsim.recording.figures.cut import pulses_figure
from edmsim.recording.rerun.logs import SMALLEST, shapes_of, travel_at, wire_strips
from edmsim.recording.rerun.playback import Playback
from edmsim.recording.video import Film
from edmsim.recording.windows import column

from .conftest import closeups_of

RADIUS_UM, GAP_UM = 125.0, 15.0
"""Of the made-up cut."""


def test_a_plant_tells_the_gas_in_every_slice_and_keeps_its_own():
    plant = Plant(Machine.load(height_mm=10.0), seed=1, resolution="fast")
    for _ in range(20):
        window = plant.advance()
        assert plant.coverage().shape == (5,)
        assert plant.coverage().mean() == pytest.approx(window.coverage, abs=1e-12)
    assert 0.0 < plant.coverage().max() < 1.0
    plant.coverage()[:] = 1.0
    assert plant.coverage().max() < 1.0


def test_a_machine_does_not_observe_gas():
    hidden = "cover", "gas", "debris", "gap_um"
    assert not [name for name in WindowObservation._fields if any(word in name for word in hidden)]


@pytest.mark.slow
def test_a_cut_records_the_same_gas_everywhere(small_cut):
    result = small_cut.result
    t_s, covered = column(result.windows, "t_s"), column(result.windows, "coverage")
    assert 0.0 <= covered.min() < covered.mean() < covered.max() <= 1.0
    closeups = result.closeups.table()
    for rows in (result.frames.rows, closeups):
        windows = np.searchsorted(t_s, rows["t_s"])
        np.testing.assert_allclose(rows["coverage"].mean(axis=1), covered[windows], atol=1e-6)
    coverage = result.report["coverage"]
    assert coverage["mean"] == pytest.approx(covered.mean())  # its period is the same in all windows
    assert coverage["max"] == covered.max()


def test_the_figure_of_the_pulses_has_a_panel_of_gas(cut):
    (panel,) = [axes for axes in pulses_figure(cut.windows).axes if axes.get_ylabel() == "gas, %"]
    drawn = np.concatenate([line.get_ydata() for line in panel.get_lines()])
    assert drawn.mean() == pytest.approx(100 * column(cut.windows, "coverage").mean(), rel=1e-3)


def test_every_slice_has_its_curve(cut, play):
    shapes = shapes_of(cut.frames, cut.closeups.table())
    rows = play.rows("/slices/coverage", "Scalars:scalars")
    np.testing.assert_allclose(rows.t_s, shapes["t_s"], atol=1e-9)
    np.testing.assert_allclose(np.array(rows.values.to_pylist()), shapes["coverage"])
    names = play.rows("/slices/coverage", "SeriesLines:names").values[0].as_py()
    assert (names[0], names[4], names[8]) == ("1.1 mm", "10.0 mm", "18.9 mm")


def test_bubbles_stand_on_the_front_of_the_drawn_wire(cut, play):
    shapes, at = shapes_of(cut.frames, cut.closeups.table()), 40
    t_s = float(shapes["t_s"][at])
    centres = play.points("/world/gas", "Ellipsoids3D:centers", t_s)
    halves = play.points("/world/gas", "Ellipsoids3D:half_sizes", t_s)
    shown = shapes["coverage"][at] >= SMALLEST
    assert (shown.sum(), len(centres)) == (8, 8)  # the lowest slice has no gas, so no bubble
    shares = np.repeat(shapes["coverage"][at][shown, None], 3, axis=1)
    np.testing.assert_allclose((halves / (20.0 / 9 / 2)) ** 2, shares, rtol=1e-5)
    wire = wire_strips(cut.scene, shapes, float(play.sizes[7]))[at, 1:-1][shown]
    ahead = travel_at(cut.windows, shapes["t_s"][at : at + 1]) * 0.125
    np.testing.assert_allclose(centres - wire, np.repeat(np.column_stack([ahead, [0.0]]), 8, axis=0), atol=1e-5)


@pytest.mark.slow
def test_the_top_view_has_a_bubble_at_the_last_discharge_of_every_slice(cut, record, tmp_path):
    covered = np.array([0.0, 0.02, 0.06, 0.3, 0.5, 0.6, 0.1, 0.2, 0.9], np.float32)
    rows = cut.closeups.table()[:8].copy()
    rows["pulses"]["ray"] = np.arange(96) % 16
    rows["pulses"]["slice"] = np.where(np.arange(96) % 4 == 1, -1, np.arange(96) // 4 % 8)  # slice 8 has none
    closeups = closeups_of(rows, coverage=covered)
    play, row = Playback(record(tmp_path / "cut.rrd", closeups=closeups)), closeups.table()[5]
    strips = [line * (1.0, -1.0) for line in play.strips("/top/gas", "LineStrips2D:strips", float(row["t_s"]))]
    radii = play.points("/top/gas", "LineStrips2D:radii", float(row["t_s"]))
    middle = RADIUS_UM + GAP_UM / 2
    np.testing.assert_allclose(radii, [GAP_UM / 2] * 6)  # slices 2 to 7, from the wire to the metal
    for number, (line, share) in enumerate(zip(strips, covered[2:8], strict=True), 2):
        away = line - (row["wire_um"] - row["guides_um"])
        np.testing.assert_allclose(np.hypot(*away.T), middle, atol=1e-2)
        turned = np.unwrap(np.arctan2(away[:, 1], away[:, 0]))
        assert np.ptp(turned) * middle + GAP_UM == pytest.approx(share * np.pi * RADIUS_UM, abs=0.1)
        arc = max(p for p in range(96) if p % 4 in (0, 3) and p // 4 % 8 == number)  # the last spark or arc there
        assert turned[4] == pytest.approx(2 * np.pi / 32 * (arc % 16), abs=1e-3)


@pytest.mark.slow
def test_a_film_shows_gas_where_there_is_some(cut, play, record, tmp_path):
    dry = closeups_of(cut.closeups.table(), coverage=0.0)
    t_s, without = float(cut.closeups.table()["t_s"][50]), Playback(record(tmp_path / "dry.rrd", closeups=dry))
    wet, dried = (Film(shown, 60).picture(t_s).astype(int) for shown in (play, without))
    rows, columns = np.nonzero(np.abs(wet - dried).max(axis=2) > 20)
    assert len(rows) > 10
    height, width, _ = wet.shape
    assert rows.max() < 0.7 * height  # in the picture of the gap only
    assert columns.min() > 0.3 * width
    assert columns.max() < 0.65 * width


def test_a_cut_without_windows_has_no_gas(empty_recording):
    play = Playback(empty_recording)
    for entity, component in (("/world/gas", "Ellipsoids3D:centers"), ("/top/gas", "LineStrips2D:strips"),
                              ("/slices/coverage", "Scalars:scalars")):  # fmt: skip
        assert (entity, component) not in play
