"""Lines break where a wire is threaded, which is marked; labels leave each other room; scales follow the process."""

from __future__ import annotations

import dataclasses
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.text import Annotation

from edmsim.recording import Playback, write_recording
from edmsim.recording.figures import error_figure
from edmsim.recording.figures.canvas import NotebookFigure
from edmsim.recording.figures.map import draw_map
from edmsim.recording.figures.profile import profile_figure
from edmsim.recording.figures.series import PANELS, draw_series
from edmsim.recording.film import Film
from edmsim.recording.pauses import broken, jump_rows, pause_rows, stretches
from edmsim.recording.scene import SceneCorner
from edmsim.recording.windows import column

PAUSE_S = 200.0


def threaded(windows: pa.Table) -> pa.Table:
    """Let a wire be threaded half-way, in a place 5 mm away."""
    half = len(windows) // 2
    for name, by in (("t_s", PAUSE_S), ("x_um", 5000.0)):
        values = column(windows, name).copy()
        values[half:] += by
        index = windows.column_names.index(name)
        windows = windows.set_column(index, windows.schema.field(name), pa.array(values))
    return windows


def test_breaks_are_found_and_lines_stop_there() -> None:
    time = np.array([0.0, 0.1, 0.2, 60.2, 60.3])
    assert pause_rows(time).tolist() == [3]
    place = np.array([(0, 0), (10, 0), (20, 0), (500, 0), (510, 0)], float)
    assert jump_rows(place, np.array([0.0, 10, 20, 20, 30])).tolist() == [3]
    # a thinned way is no jump, whichever way it was travelled
    assert jump_rows(place, np.array([0.0, 10, 20, 500, 510])).tolist() == []
    assert jump_rows(place[::-1], np.array([510.0, 500, 20, 10, 0])).tolist() == []
    assert [time[part].tolist() for part in stretches(5, np.array([3]))] == [[0.0, 0.1, 0.2], [60.2, 60.3]]
    line = broken(place, np.array([3]))
    assert np.isnan(line[3]).all()
    assert np.array_equal(np.delete(line, 3, axis=0), place)


@pytest.fixture(scope="module")
def drawn(cut: SimpleNamespace) -> Figure:
    figure = NotebookFigure()
    draw_series(list(figure.subplots(len(PANELS))), threaded(cut.windows))
    return figure


def test_no_curve_runs_over_a_pause_and_it_is_marked(cut: SimpleNamespace, drawn: Figure) -> None:
    time = column(threaded(cut.windows), "t_s")
    row = int(pause_rows(time)[0])
    begin, end = time[row - 1] / 60, time[row] / 60
    for axes in drawn.axes:
        spans = [patch.get_extents().transformed(axes.transData.inverted()) for patch in axes.patches]
        assert any((span.x0, span.x1) == pytest.approx((begin, end)) for span in spans)
        curves = [line.get_xdata() for line in axes.lines if len(line.get_xdata()) > 2]
        areas = [path.vertices[:, 0] for kind in axes.collections if isinstance(kind, PolyCollection)
                 for path in kind.get_paths()]  # fmt: skip
        for x in [*curves, *areas]:
            assert x.max() <= begin + 1e-9 or x.min() >= end - 1e-9
    told = [text.get_text() for text in drawn.axes[0].get_legend().get_texts()]
    assert told == ["threading", "feed"]


def test_a_cut_without_a_pause_has_no_mark(cut: SimpleNamespace) -> None:
    figure = NotebookFigure()
    draw_series(list(figure.subplots(len(PANELS))), cut.windows)
    assert figure.axes[0].get_legend() is None


def test_recording_and_film_break_their_curves(cut: SimpleNamespace, tmp_path: Path) -> None:
    windows = threaded(cut.windows)
    write_recording(
        tmp_path / "cut.rrd", cut.scene, windows, cut.frames, cut.closeups, cut.machine, cut.report, "rectangle.ngc"
    )
    play = Playback(tmp_path / "cut.rrd")
    time = column(windows, "t_s")
    row = int(pause_rows(time)[0])
    (cleared,) = play.rows("/feed/feed_um_s", "Clear:is_recursive").t_s
    assert time[row - 1] < cleared < time[row]
    film = Film(play, 40)
    curves = [line.get_xdata() for axes in film._figure.axes for line in axes.lines if len(line.get_xdata()) > 100]
    middle = (time[row - 1] + time[row]) / 2
    assert curves
    for x in curves:
        known = np.isfinite(x)
        crossing = (x[:-1] < middle) & (x[1:] > middle) & known[:-1] & known[1:]
        assert not crossing.any()


def labels(figure: Figure) -> list[Annotation]:
    return [text for text in figure.axes[0].texts if isinstance(text, Annotation)]


def test_labels_of_corners_never_cover_each_other(cut: SimpleNamespace) -> None:
    draw = np.random.default_rng(3)
    places = draw.uniform(22, 26, (40, 2))
    crowd = tuple(SceneCorner(float(x), float(y), 90.0, float(k + 1)) for k, (x, y) in enumerate(places))
    scene = dataclasses.replace(cut.scene, corners=crowd)
    for figure, least in ((profile_figure(scene, cut.windows, cut.report, "crowd"), 6), (error_figure(scene), 4)):
        figure.canvas.draw()
        boxes = [label.get_window_extent() for label in labels(figure)]
        assert len(boxes) >= least
        for one, other in combinations(boxes, 2):
            assert not one.overlaps(other)
        shown = figure.axes[0].get_window_extent()
        assert all(shown.count_contains(box.get_points()) == 2 for box in boxes)


def test_what_is_out_of_reach_does_not_set_the_scale(cut: SimpleNamespace) -> None:
    (edge,) = cut.scene.maps
    away = np.zeros(len(edge.error_um))
    away[100:200] = 60.0
    error = np.where(away > 0, 70.0, edge.error_um)
    corner = dataclasses.replace(edge, error_um=error, unreachable_um=away)
    scene = dataclasses.replace(cut.scene, maps=(corner,))
    assert scene.error_limit_um() == pytest.approx(cut.scene.error_limit_um(), rel=0.1)
    assert scene.error_factor() == cut.scene.error_factor()
    drawn_as_it_was = dataclasses.replace(scene, maps=(dataclasses.replace(corner, unreachable_um=None),))
    assert drawn_as_it_was.error_limit_um() > 2 * scene.error_limit_um()
    assert [len(run) for run in corner.out_of_reach_mm()] == [100]
    figure = NotebookFigure()
    draw_map(figure.add_subplot(), scene)
    assert "out of the wire's reach" in [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
