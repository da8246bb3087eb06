"""Lines break where a wire is threaded, which is marked; labels leave each other room; scales follow the process."""

import dataclasses
from itertools import combinations

import numpy as np
import pytest
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.text import Annotation

from edmsim.metrology.profile import CornerError
from edmsim.recording.figures.cut import error_figure, plane_figure, pulses_figure
from edmsim.recording.figures.profile import PANELS, draw_map, draw_series, profile_figure
from edmsim.recording.figures.style import NotebookFigure
from edmsim.recording.rerun.logs import growing_kerf
from edmsim.recording.rerun.playback import Playback
from edmsim.recording.video import Film
from edmsim.recording.windows import (
    broken,
    column,
    cut_alone,
    jump_rows,
    pause_rows,
    stretches,
    travel_direction,
)

from .conftest import changed, table_of

PAUSE_S = 200.0


def threaded(windows):
    """Let a wire be threaded half-way, in a place 5 mm away."""
    after = np.arange(len(windows)) >= len(windows) // 2
    t_s, x_um = (column(windows, name) for name in ("t_s", "x_um"))
    return changed(windows, t_s=t_s + PAUSE_S * after, x_um=x_um + 5000.0 * after)


def test_breaks_are_found_and_lines_stop_there():
    time = np.array([0.0, 0.1, 0.2, 60.2, 60.3])
    assert pause_rows(time).tolist() == [3]
    place = np.array([(0, 0), (10, 0), (20, 0), (500, 0), (510, 0)], float)
    assert jump_rows(place, np.array([0.0, 10, 20, 20, 30])).tolist() == [3]
    # a thinned way is no jump, whichever way it was travelled
    assert jump_rows(place, np.array([0.0, 10, 20, 500, 510])).tolist() == []
    assert jump_rows(place[::-1], np.array([510.0, 500, 20, 10, 0])).tolist() == []
    # windows of long periods, or thinned ones, are no pauses; one between two threadings is a stretch
    assert pause_rows(np.arange(1, 9) * 2.55).tolist() == []
    assert pause_rows(np.array([2.55, 5.1, 65.1, 67.65])).tolist() == [2]
    assert pause_rows(np.array([0.025, 0.05, 20.0, 40.0, 40.025])).tolist() == [2, 3]
    assert pause_rows(np.array([0.025, 61.0])).tolist() == [1]
    assert pause_rows(np.zeros(0)).tolist() == pause_rows(np.ones(1)).tolist() == []
    assert [time[part].tolist() for part in stretches(5, np.array([3]))] == [[0.0, 0.1, 0.2], [60.2, 60.3]]
    line = broken(place, np.array([3]))
    assert np.isnan(line[3]).all()
    assert np.array_equal(np.delete(line, 3, axis=0), place)


def test_the_cut_alone_begins_beyond_the_start_hole_and_ends_with_the_last_discharge():
    # 10 um a second; two contours, threaded at X 0 and X 5000 in holes of 25 um
    time = np.concatenate([np.arange(1.0, 9.0), 100.0 + np.arange(1.0, 7.0)])
    along = np.concatenate([np.arange(1.0, 9.0), 8.0 + np.arange(1.0, 7.0)]) * 10.0
    x, y, lit = np.repeat([0.0, 5000.0], [8, 6]), np.concatenate([along[:8], along[8:] - 80.0]), np.zeros(14)
    columns = {"t_s": time, "x_um": x, "y_um": y, "path_um": along, "spark": lit, "arc": np.zeros(14)}
    lit[[1, 2, 3, 6]] = 5.0  # the first of them still in the hole; nothing ignites at the second contour
    holes = np.array([[0.0, 0.0, 25.0], [5000.0, 0.0, 25.0]])
    found = cut_alone(columns, holes)
    assert np.flatnonzero(found.rows).tolist() == [2, 3, 4, 5, 6]
    assert (found.time_s, found.stretches_um) == (5.0, ((20.0, 70.0),))
    lit[13] = 1.0
    found = cut_alone(columns, holes)
    assert np.flatnonzero(found.rows[8:]).tolist() == [2, 3, 4, 5]
    assert (found.time_s, found.stretches_um) == (9.0, ((20.0, 70.0), (100.0, 140.0)))
    nothing = cut_alone({name: values[:2] for name, values in columns.items()}, holes)
    assert (nothing.rows.any(), nothing.time_s, nothing.stretches_um) == (False, 0.0, ())


def test_travel_never_points_to_another_contour():
    path = np.arange(100) * 2.0
    x = np.where(path < 100, path, 5000.0)
    y = np.where(path < 100, 0.0, path - 100)
    t_s = 0.1 * np.arange(100) + 60.0 * (path >= 100)
    ahead = travel_direction(table_of(
        {"t_s": at, "x_um": x, "y_um": y, "path_um": s} for at, x, y, s in zip(t_s, x, y, path, strict=True)
    ))  # fmt: skip
    np.testing.assert_allclose(ahead[:50], np.tile([1.0, 0.0], (50, 1)))
    np.testing.assert_allclose(ahead[50:], np.tile([0.0, 1.0], (50, 1)))


def pause_of(windows):
    """Minutes between which a wire is threaded."""
    time = column(windows, "t_s")
    row = int(pause_rows(time)[0])
    return time[row - 1] / 60, time[row] / 60


def series_figure(windows):
    figure = NotebookFigure()
    draw_series(list(figure.subplots(len(PANELS))), windows)
    return figure


def curves_of(axes):
    """Abscissae of all curves and areas, without marks of two points."""
    areas = [path.vertices[:, 0] for kind in axes.collections if isinstance(kind, PolyCollection)
             for path in kind.get_paths()]  # fmt: skip
    return [*areas, *(line.get_xdata() for line in axes.lines if len(line.get_xdata()) > 2)]


@pytest.mark.parametrize("draw", [series_figure, pulses_figure])
def test_no_curve_runs_over_a_pause_and_it_is_marked(cut, draw):
    windows = threaded(cut.windows)
    begin, end = pause_of(windows)
    figure = draw(windows)
    for axes in figure.axes:
        curves = curves_of(axes)
        assert curves
        assert all(x.max() <= begin + 1e-9 or x.min() >= end - 1e-9 for x in curves)
        if draw is series_figure:
            spans = [patch.get_extents().transformed(axes.transData.inverted()) for patch in axes.patches]
            assert any((span.x0, span.x1) == pytest.approx((begin, end)) for span in spans)
    assert "threading" in [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    if draw is series_figure:
        assert draw(cut.windows).axes[0].get_legend() is None


def test_the_way_of_pulses_in_their_plane_breaks_at_a_pause(cut):
    ways = [plane_figure(windows).axes[0].collections for windows in (threaded(cut.windows), cut.windows)]
    (with_pause,), (whole,) = ([kind for kind in way if isinstance(kind, LineCollection)] for way in ways)
    assert len(with_pause.get_segments()) == len(whole.get_segments()) - 1


def test_the_kerf_does_not_grow_on_the_way_to_the_next_contour(cut):
    """The wire is brought over a kerf that it has not cut yet."""
    place = np.concatenate([cut.scene.starts_mm * 1000 + [[k, 0.0]] for k in (0.0, 50.0)])
    over = np.ptp(cut.scene.maps[0].nominal_mm, axis=0)[0] * 1000
    away = place[-1] + [over + 5000.0, 0.0]
    jumped = np.stack([*place, away, np.add(away, [50.0, 0.0])])
    growth = growing_kerf(cut.scene, jumped, np.array([0.0, 50.0, 50.0, 100.0]))
    still = growing_kerf(cut.scene, place, np.array([0.0, 50.0]))
    assert len(growth.solids[-1].positions) == len(still.solids[-1].positions)


@pytest.mark.slow
def test_recording_and_film_break_their_curves(cut, record, tmp_path):
    windows = threaded(cut.windows)
    play = Playback(record(tmp_path / "cut.rrd", windows=windows))
    begin, end = pause_of(windows)
    (cleared,) = play.rows("/feed/feed_um_s", "Clear:is_recursive").t_s
    assert 60 * begin < cleared < 60 * end
    film = Film(play, 40)
    curves = [line.get_xdata() for axes in film._figure.axes for line in axes.lines if len(line.get_xdata()) > 100]
    middle = 30 * (begin + end)
    assert curves
    for x in curves:
        known = np.isfinite(x)
        crossing = (x[:-1] < middle) & (x[1:] > middle) & known[:-1] & known[1:]
        assert not crossing.any()


def labels(figure):
    return [text for text in figure.axes[0].texts if isinstance(text, Annotation)]


@pytest.mark.slow
def test_labels_of_corners_never_cover_each_other(cut):
    draw = np.random.default_rng(3)
    places = draw.uniform(22, 26, (40, 2))
    crowd = tuple(CornerError(float(x), float(y), 90.0, float(k + 1)) for k, (x, y) in enumerate(places))
    scene = dataclasses.replace(cut.scene, corners=crowd)
    for figure, least in ((profile_figure(scene, cut.windows, cut.report, "crowd"), 6), (error_figure(scene), 4)):
        figure.canvas.draw()
        boxes = [label.get_window_extent() for label in labels(figure)]
        assert len(boxes) >= least
        for one, other in combinations(boxes, 2):
            assert not one.overlaps(other)
        shown = figure.axes[0].get_window_extent()
        assert all(shown.count_contains(box.get_points()) == 2 for box in boxes)


def test_what_is_out_of_reach_does_not_set_the_scale(cut):
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
