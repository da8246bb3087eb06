"""``profile.png``: drawn without global state, the same each time, and true to the numbers."""

import dataclasses
import sys

import matplotlib.image
import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmsim.recording.figures.profile import binned, draw_map, profile_figure
from edmsim.recording.figures.style import NotebookFigure, write_figure
from edmsim.recording.scene import Scene, Terrace
from edmsim.recording.windows import WindowTable

from .conftest import NOTHING, changed, texts


def drawn(cut, scene, **report):
    return texts(profile_figure(scene, cut.windows, dataclasses.replace(cut.report, **report), "punch.ngc"))


@pytest.mark.slow
def test_png_has_the_stated_size_and_equal_bytes(cut, tmp_path):
    for name in ("one.png", "two.png"):
        write_figure(profile_figure(cut.scene, cut.windows, cut.report, "punch.ngc"), tmp_path / name)
    assert matplotlib.image.imread(tmp_path / "one.png").shape == (1920, 1600, 4)
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()
    assert len(list(tmp_path.iterdir())) == 2


def test_pyplot_is_never_loaded(cut, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)  # importing it would raise
    profile_figure(cut.scene, cut.windows, cut.report, "punch.ngc")


@pytest.mark.slow
def test_heading_corners_and_exaggeration_are_written(cut):
    shown = drawn(cut, cut.scene)
    assert cut.scene.error_factor() == 50.0
    for piece in ("punch.ngc", "finished", "profile error drawn × 50", "1 mm", "20 µm of error", "−10.2", "−7.9"):
        assert piece in shown


@pytest.mark.slow
def test_the_map_is_to_scale(cut):
    figure = profile_figure(cut.scene, cut.windows, cut.report, "punch.ngc")
    axes = figure.axes[0]
    figure.canvas.draw()
    (x0, y0), (x1, y1) = axes.transData.transform([(20.0, 20.0), (21.0, 21.0)])
    assert x1 - x0 == pytest.approx(y1 - y0, rel=1e-3)
    low, high = axes.get_xlim()
    left, _ = cut.scene.origin_mm
    assert low < 19.0 - left < 30.0 - left < high


def test_the_kerf_round_a_small_part_is_in_the_map():
    """It reaches a wire and two gaps beyond the edge, 0.41 mm behind a rough pass of the production generator."""
    corners_mm, wire_um = np.array([(0.0, 0.0), (1.0, 1.0)]), 250.0
    figure = NotebookFigure()
    axes = figure.add_subplot()
    draw_map(axes, Scene((), (), (), corners_mm, (-9, -9, 9, 9), 20.0, (-10, 30), wire_um))
    for low, high in (axes.get_xlim(), axes.get_ylim()):
        assert low < -0.41 < 1.41 < high


def test_a_stopped_cut_says_why_and_where(cut):
    scene = dataclasses.replace(cut.scene, stop_mm=(30.155, 23.0))
    shown = drawn(cut, scene, outcome="wire break", reason="the wire broke at 612 K")
    assert "stopped: the wire broke at 612 K" in shown
    assert "stopped here" in shown


def test_a_long_name_is_written_whole(cut):
    figure = profile_figure(cut.scene, cut.windows, cut.report, f"{'long-' * 18}.ngc")
    name, outcome = (text.get_window_extent() for text in figure.texts[:2])
    assert name.x1 < outcome.x0


@pytest.mark.slow
def test_a_long_reason_and_the_longest_legend_lie_within_the_figure(cut):
    reason = "; ".join(["the wire broke at 612 K", *4 * ["its sensor did not see that, and the machine went on"]])
    report = dataclasses.replace(cut.report, outcome="time-limit", reason=reason)
    far = [np.full(len(edge.points_mm), 99.0) for edge in cut.scene.maps]
    maps = tuple(dataclasses.replace(edge, unreachable_um=um) for edge, um in zip(cut.scene.maps, far, strict=True))
    steps = tuple(Terrace(cut.scene.cut_edges_mm[0], height_mm) for height_mm in (16.0, 20.0))
    scene = dataclasses.replace(cut.scene, maps=maps, terraces=steps, stop_mm=(30.155, 23.0))
    figure = profile_figure(scene, cut.windows, report, "long")
    figure.canvas.draw()
    (text,) = (text for text in figure.texts if text.get_text().startswith("stopped: "))
    assert text.get_text().count("\n") == 1
    names = figure.axes[0].get_legend()
    assert len(names.get_texts()) > 6
    assert max(of.get_window_extent().x1 for of in (text, names)) < figure.bbox.x1
    assert names.get_window_extent().y1 < text.get_window_extent().y0 + 2.0


def test_a_legend_wider_than_the_map_takes_more_rows(cut):
    steps = tuple(Terrace(cut.scene.cut_edges_mm[0], height_mm) for height_mm in (12.5, 16.25, 18.75, 20.0))
    axes = NotebookFigure(figsize=(10.0, 6.0)).add_subplot()
    draw_map(axes, dataclasses.replace(cut.scene, terraces=steps))
    assert axes.get_legend().get_window_extent().width <= axes.bbox.width


def placed(scene):
    """Return the points at which a map draws the nominal edge, the errors and the corners."""
    axes = NotebookFigure().add_subplot()
    draw_map(axes, scene)
    (edge,) = (of.get_segments()[0] for of in axes.collections if of.get_label() == "nominal edge")
    (corners,) = (of.get_xydata() for of in axes.lines if of.get_label() == "corner, its error in µm")
    count = len(scene.maps[0].points_mm)
    (errors,) = (of.get_segments() for of in axes.collections if len(of.get_paths()) == count)
    return np.concatenate([edge, corners, *errors])


def test_a_map_of_a_tapered_stepped_part_is_at_one_height(cut):
    flat = dataclasses.replace(cut.scene, terraces=(Terrace(cut.scene.middle_edges_mm(), 8.0),))
    (edge,), height_mm, away_mm = flat.maps, flat.middle_mm(), np.array([0.05, -0.025])
    assert height_mm < 8.0
    low, high = (edge.nominal_mm + away_mm * (z - height_mm) for z in (0.0, flat.height_mm))
    lean_mm = away_mm * (flat.height_mm / 2 - height_mm)
    tapered = dataclasses.replace(
        flat, walls_mm=((low, high),),
        maps=(dataclasses.replace(edge, nominal_mm=(low + high) / 2, points_mm=edge.points_mm + lean_mm),),
        corners=tuple(
            dataclasses.replace(c, x_mm=c.x_mm + lean_mm[0], y_mm=c.y_mm + lean_mm[1]) for c in flat.corners
        ),
    )  # fmt: skip
    np.testing.assert_allclose(placed(tapered), placed(flat), atol=1e-9)


def test_every_start_hole_has_its_rim(cut):
    holes = np.array([(19.0, 19.0, 0.25), (25.0, 19.0, 0.25)])
    axes = NotebookFigure().add_subplot()
    draw_map(axes, dataclasses.replace(cut.scene, holes_mm=holes, origin_mm=(0.0, 0.0)))
    drawn = [path.get_extents() for of in axes.collections for path in of.get_paths() if len(path.vertices) > 1]
    for x, y, radius in holes:
        rim = [x - radius, y - radius, x + radius, y + radius]
        assert any(np.allclose(box.extents, rim, atol=1e-3) for box in drawn)


@pytest.mark.slow
def test_a_cut_that_left_nothing_can_be_drawn(cut, tmp_path):
    report = dataclasses.replace(cut.report, machining_time_s=None, path_length_mm=None)
    write_figure(profile_figure(NOTHING, WindowTable().to_arrow(), report, "nothing"), f"{tmp_path}/profile.png")
    assert (tmp_path / "profile.png").stat().st_size > 10_000


def test_long_cuts_are_drawn_with_few_points(cut):
    longer = pa.concat_tables([cut.windows] * 40)
    longer = changed(longer, t_s=0.05 * np.arange(len(longer)))
    figure = profile_figure(cut.scene, longer, cut.report, "long")
    assert max(len(line.get_xdata()) for axes in figure.axes for line in axes.get_lines()) <= 800


@pytest.mark.slow
@given(st.lists(st.one_of(st.floats(-1e6, 1e6), st.just(np.nan)), max_size=300), st.integers(1, 40))
def test_bins_hold_mean_and_extremes(values, bins):
    series = np.array(values, float)
    band = binned(np.arange(len(series), dtype=float), series, bins)
    assert len(band.x) == min(len(series), bins)
    known = ~np.isnan(band.mean)
    assert (band.low[known] <= band.mean[known] + 1e-6).all()
    assert (band.mean[known] <= band.high[known] + 1e-6).all()
    if np.isfinite(series).any():
        assert np.nanmin(band.low) == np.nanmin(series)
        assert np.nanmax(band.high) == np.nanmax(series)


def test_bins_of_a_ramp():
    band = binned(np.arange(8.0), np.array([0, 2, 4, 6, np.nan, np.nan, 1, np.nan]), 4)
    np.testing.assert_array_equal(band.x, [0.5, 2.5, 4.5, 6.5])
    np.testing.assert_array_equal(band.mean, [1, 5, np.nan, 1])
    np.testing.assert_array_equal(band.low, [0, 4, np.nan, 1])
    np.testing.assert_array_equal(band.high, [2, 6, np.nan, 1])
