"""What a notebook shows of a cut: a few lines, a card with table and picture, figures that show by themselves."""

import base64
import copy
import io
import re
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

import edmsim
from edmsim.errors import InputError
from edmsim.program.path import CutPath, WireContour
from edmsim.recording.report import RecordedCut
from edmsim.recording.scene import PassFace, Terrace
from edmsim.recording.windows import traces


@pytest.fixture(scope="module")
def result(cut):
    """The made-up cut as `edmsim.cut` returns one."""
    points = np.array([[0, 0], [3000, 0], [3000, 4000]])
    contour = WireContour(points, 1, points / 1e3, closed=False, part_side="left", offset_um=150.0)
    path = CutPath((contour,), cut.scene.stock_mm, 0.5, (20.0, 20.0), (), "rectangle.ngc")
    field = None
    return edmsim.CutResult(
        cut.report, cut.windows, path, field, cut.frames, cut.scene, cut.closeups, cut.machine
    )


def test_what_is_worked_with_is_said_in_a_few_lines(result):
    plant = edmsim.Plant(result.machine, resolution="fast")
    recorded = RecordedCut(result.report, result.windows, result.scene)
    for shown in (result, result.machine, plant, result.path, result.scene, recorded):
        lines = repr(shown).splitlines()
        assert len(lines) <= 6
        assert max(map(len, lines)) < 240
    assert repr(result).startswith("<CutResult of rectangle.ngc: finished\n")
    assert "10.2 µm max, 2.1 µm rms" in repr(result)
    assert "height_mm=20.0" in repr(result.machine)
    assert "5 slices x 24 rays" in repr(plant)
    assert "7.000 mm in 2 moves" in repr(result.path)


@pytest.mark.slow
def test_a_result_shows_its_table_and_its_picture(result):
    html = result._repr_html_()
    assert "<b>rectangle.ngc: finished</b>" in html
    assert "10.2 µm max, 2.1 µm rms" in html
    assert "note: made up" in html
    (picture,) = re.findall(r'src="data:image/png;base64,([^"]+)"', html)
    assert Image.open(io.BytesIO(base64.b64decode(picture))).width == 800
    assert len(html) < 400_000  # a notebook keeps it


def test_a_figure_shows_by_itself(result):
    assert result.plot("kerf-section")._repr_png_().startswith(b"\x89PNG")


def test_a_figure_that_is_not_there_is_reported(result):
    with pytest.raises(InputError, match=r"no figure 'kerf'; there are: profile, profile-error, .*wire-spectrum$"):
        result.plot("kerf")
    with pytest.raises(InputError, match=r"slice_index cannot be 2\.5: give int \| None"):
        result.contour(2.5)


@pytest.mark.slow
def test_a_file_of_samples_has_every_pulse_as_the_model_had_it(result, tmp_path):
    rows = result.closeups.table()
    result.write_traces(tmp_path / "traces.parquet", every_us=0.1, end_s=float(rows["t_s"][2]))
    table = pq.read_table(tmp_path / "traces.parquet")
    assert table.column_names == ["window_t_s", "time_us", "voltage_V", "current_A", "pulse", "kind"]
    at, t, u, i, pulse = (table.column(name).to_numpy() for name in table.column_names[:5])
    assert np.unique(at).tolist() == rows["t_s"][:3].tolist()
    first = at == at[0]
    assert np.allclose(np.diff(t[first]), 0.1)
    count = int(rows["count"][0])
    time, voltage, current = (corners[0].reshape(count, 7) for corners in traces(rows[:1], count))
    for number in range(8):
        mine = first & (pulse == number)
        assert 0.1 * u[mine].sum() == pytest.approx(np.trapezoid(voltage[number], time[number]), abs=0.2 * 100)
        assert 0.1 * i[mine].sum() == pytest.approx(np.trapezoid(current[number], time[number]), abs=0.2 * 8)
    kinds = np.array(table.column("kind").to_pylist())
    assert not u[kinds == "short"].any()
    assert not i[kinds == "open"].any()
    assert u[kinds == "spark"].max() == 100.0


@pytest.mark.parametrize("every_us", [0.0, -1.0, 1e-9, float("nan")])
def test_samples_need_a_time_between_them(result, tmp_path, every_us):
    with pytest.raises(InputError, match=r"must be 0\.001 us or more"):
        result.write_traces(tmp_path / "traces.parquet", every_us=every_us)
    for limits in ({"begin_s": np.nan}, {"end_s": True}):
        with pytest.raises(InputError, match=r"_s is (nan|True): give a machine time in s"):
            result.write_traces(tmp_path / "traces.parquet", **limits)
    for limits in ({"begin_s": 1e6}, {"begin_s": 0.5, "end_s": 0.2}):
        with pytest.raises(InputError, match=r"no window with samples ends between .*: the cut has \d+, from "):
            result.write_traces(tmp_path / "traces.parquet", **limits)
    assert list(tmp_path.iterdir()) == []


def test_a_result_and_what_it_holds_are_compared_and_hashed_as_objects(result):
    for held in (result, result.path, result.path.contours[0], result.scene, result.scene.maps[0]):
        alike = copy.deepcopy(held)
        assert held == held
        assert held != alike
        assert len({held, alike}) == 2
    result.frames.rows["t_s"] = -1.0
    assert result.frames.rows["t_s"].min() >= 0.0


def test_pictures_are_in_the_coordinates_of_the_program(result):
    (edge,), line = result.scene.maps, np.array([(21.0, 23.0), (22.0, 24.0)])
    scene = replace(result.scene, stop_mm=(30.0, 26.0), walls_mm=((line, line),), terraces=(Terrace((line,), 8.0),),
                    pass_faces=(PassFace(0, 1.0, 1.0, line, np.zeros((1, 2))),))  # fmt: skip
    moved = scene.in_program()
    assert moved.extent_mm()[:2] == (-1.0, -1.0)  # the start hole, a millimetre off the corner
    assert (moved.stop_mm, moved.stock_mm) == ((10.0, 6.0), (-5.0, -5.0, 15.0, 11.0))
    assert [(c.x_mm, c.y_mm) for c in moved.corners[:2]] == [(0.0, 0.0), (10.0, 0.0)]
    for now, before in (
        (moved.maps[0].nominal_mm, edge.nominal_mm), (moved.maps[0].points_mm, edge.points_mm),
        (moved.cut_edges_mm[4][0], scene.cut_edges_mm[4][0]), (moved.starts_mm, scene.starts_mm),
        (moved.holes_mm[:, :2], scene.holes_mm[:, :2]), *((wall, line) for wall in moved.walls_mm[0]),
        (moved.terraces[0].outlines_mm[0], line), (moved.pass_faces[0].points_mm, line),
    ):  # fmt: skip
        np.testing.assert_allclose(now, before - 20.0, atol=1e-12)
    assert result.plot("profile-error").axes[0].get_xlabel() == "X of the program, mm"
    assert result.report["corners"][0]["program_x_mm"] == 0.0
    assert result.report["corners"][0]["x_mm"] == 20.0
