"""``cut.rrd``: read back with rerun's own reader; equal cuts give equal recordings."""

import dataclasses
import multiprocessing
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pytest
import rerun as rr

from edmsim.recording.rerun.logs import face_mesh, log_errors, shapes_of, wire_strips
from edmsim.recording.rerun.viewer import RERUN
from edmsim.recording.rerun.write import ELECTRICAL, PROCESS, group_starts, recording_id, releasing
from edmsim.recording.scene import PassFace, read_scene, write_scene
from edmsim.recording.windows import NAMES, Closeups, Frames, WindowTable, column, group_means, lag_along_um

from .conftest import NOTHING, changed


def compare(one, two):
    command = [*RERUN, "rrd", "compare", str(one), str(two)]
    return subprocess.run(command, capture_output=True, check=False).returncode


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system forks no processes")
@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")  # threads and fork, from Python 3.12 on
def test_a_forked_process_writes_a_recording_while_its_parent_records():
    recording = rr.RecordingStream("parent")
    recording.log("level", rr.Scalars(1.0))
    child = multiprocessing.get_context("fork").Process(target=releasing(lambda: None), daemon=True)
    child.start()
    child.join(30)
    assert child.exitcode == 0
    recording.disconnect()


class Read:
    """The chunks of a recording, by entity."""

    def __init__(self, file):
        from rerun.chunk import RrdReader

        reader = RrdReader(file)
        self.recordings = reader.recordings()
        self.chunks = [chunk.to_record_batch() for chunk in reader.stream().to_chunks()]

    def entities(self):
        return {self._path(batch) for batch in self.chunks}

    def content(self):
        """Every logged value; left out are the row's number and the moment of writing."""
        values = {}
        for batch in self.chunks:
            for name in set(batch.schema.names) - {"log_time", "log_tick", "rerun.controls.RowId"}:
                values.setdefault((self._path(batch), name), []).extend(batch.column(name).to_pylist())
        return values

    def column(self, entity, name):
        rows = []
        for batch in self.chunks:
            if self._path(batch) == entity and name in batch.schema.names:
                rows += batch.column(name).to_pylist()
        return rows

    def scalars(self, entity):
        return np.array([row[0] for row in self.column(entity, "Scalars:scalars")])

    @staticmethod
    def _path(batch):
        return str(batch.schema.metadata[b"rerun:entity_path"].decode())


@pytest.fixture(scope="module")
def read(recording):
    return Read(recording)


def test_identity_comes_from_what_the_cut_was_made_with(cut, read):
    (entry,) = read.recordings
    assert entry.recording_id == recording_id(cut.report)
    assert recording_id(dataclasses.replace(cut.report, wall_time_s=1.0)) == recording_id(cut.report)
    assert recording_id(dataclasses.replace(cut.report, seed=8)) != recording_id(cut.report)


def test_all_series_are_there_to_the_last_bit(cut, read):
    np.testing.assert_array_equal(read.scalars("/feed/feed_um_s"), column(cut.windows, "feed_um_s"))
    np.testing.assert_array_equal(read.scalars("/gap/lag_um"), lag_along_um(cut.windows))
    shares = sum(read.scalars(f"/pulses/{kind}") for kind in ("short", "open", "spark", "arc"))
    np.testing.assert_allclose(shares, 100.0)
    delay = column(cut.windows, "mean_delay_us")
    np.testing.assert_array_equal(read.scalars("/times/mean_delay_us"), delay[np.isfinite(delay)])


def test_a_series_without_values_is_not_in_the_recording(cut, record, tmp_path):
    windows = changed(cut.windows, error_um=np.full(len(cut.windows), np.nan))
    entities = Read(record(tmp_path / "cut.rrd", windows=windows)).entities()
    assert "/gap/gap_um" in entities
    assert "/gap/error_um" not in entities  # beside it the viewer draws no curve at all


def test_every_column_of_the_table_has_a_curve():
    shown = {series.entity for plot in PROCESS + ELECTRICAL for series in plot.series}
    shared = {"t_s", "path_um", "lag_x_um", "lag_y_um"}  # the two timelines, and the lag along the feed
    assert set(NAMES) - shared <= shown


def test_timelines_are_machine_time_and_path(cut, read):
    seconds = [t.total_seconds() for t in read.column("/feed/feed_um_s", "machine_time")]
    np.testing.assert_allclose(seconds, column(cut.windows, "t_s"), atol=1e-6)
    np.testing.assert_array_equal(read.column("/feed/feed_um_s", "path_um"), np.round(column(cut.windows, "path_um")))


def test_the_table_moves_and_the_wire_stands(cut, read):
    moved = np.array([row[0] for row in read.column("/world/table", "Transform3D:translation")])
    shapes = shapes_of(cut.frames, cut.closeups.table())
    assert set(cut.frames.rows["t_s"]) <= set(shapes["t_s"])
    np.testing.assert_allclose(moved[:, :2], -shapes["guides_um"] / 1000.0, atol=1e-5)
    carried = np.array([row[0] for row in read.column("/world/cross", "Transform3D:translation")])
    np.testing.assert_array_equal(carried[:, 0], moved[:, 0])
    np.testing.assert_array_equal(carried[:, 1], 0.0)  # the x carriage does not go along y
    strips = np.array([row[0] for row in read.column("/world/wire", "LineStrips3D:strips")])
    assert strips.shape == (len(shapes), 11, 3)
    np.testing.assert_array_equal(strips[:, [0, -1], :2], 0.0)
    np.testing.assert_array_equal(strips[:, [0, -1], 2], np.broadcast_to((-15.0, 35.0), (len(shapes), 2)))


def test_the_part_is_drawn(read):
    edges = ["nominal/bottom", "nominal/top", "cut/bottom", "cut/middle", "cut/top", "error/0"]
    expected = {"plate", "carriage", "workpiece", "discharges", "corners", "starts", "done", *edges}
    assert {f"/world/table/{name}" for name in expected} <= read.entities()
    assert {"/world/base", "/world/cross/carriage", "/world/guides", "/world/wire"} <= read.entities()
    assert "/world/table/stop" not in read.entities()
    corners = read.column("/world/table/corners", "Points3D:labels")
    assert corners == [["-9.1", "-8.4", "-10.2", "-7.9"]]


def test_out_of_the_wires_reach_no_error_is_drawn(cut):
    edge = cut.scene.maps[0]
    away = np.where(np.arange(len(edge.error_um)) < 40, 5.0, 0.0)
    scene = dataclasses.replace(cut.scene, maps=(dataclasses.replace(edge, unreachable_um=away),))
    drawn = []
    log_errors(SimpleNamespace(log=lambda _, lines, static: drawn.append(lines)), scene)
    points = drawn[0].strips.as_arrow_array().flatten().flatten().to_numpy()
    assert np.isfinite(points).all()  # NaN also differs from NaN when recordings are compared


def test_deflection_is_exaggerated_by_the_factor(cut):
    shapes = shapes_of(cut.frames, cut.closeups.table()[:0])
    strips = wire_strips(cut.scene, shapes, 100.0)
    np.testing.assert_allclose(strips[:, 1:-1, :2], cut.frames.rows["deflection_um"] / 10.0, rtol=1e-6)
    np.testing.assert_allclose(strips[0, 1:-1, 2], 20.0 * (np.arange(9) + 0.5) / 9)


def test_the_factors_and_the_thinning_are_said(cut, read):
    (text,) = read.column("/about", "TextDocument:text")[0]
    for piece in ("punch.ngc", "× 200", "× 50", f"one window of {cut.frames.stride}", f"one of {cut.closeups.stride}",
                  "last 96 pulses", "one window", "seed: 7", "controller: counts"):  # fmt: skip
        assert piece in text
    assert not any(name in text for name in ("unit:", "heights:"))  # what was not set
    labels = read.column("/world/guides", "Points3D:labels")[0]
    assert "wire deflection × 200" in labels[1]  # on screen, too


@pytest.mark.slow
def test_equal_cuts_compare_equal_and_others_do_not(cut, recording, read, record, tmp_path):
    same = record(tmp_path / "same.rrd")
    assert compare(recording, same) == 0
    assert read.content() == Read(same).content()  # to the last bit: rerun allows a tolerance
    other = changed(cut.windows, feed_um_s=column(cut.windows, "feed_um_s") + 0.01)
    assert read.content() != Read(record(tmp_path / "other.rrd", windows=other)).content()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["other.rrd", "same.rrd"]


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="threads are counted as Linux lists them")
def test_a_recording_leaves_no_threads(recording, record, tmp_path):
    def threads():
        return len(list(Path("/proc/self/task").iterdir()))

    before = threads()  # after the first recording
    for number in range(2):
        record(tmp_path / f"{number}.rrd")
    assert threads() <= before


@pytest.mark.slow
def test_a_long_cut_is_thinned_by_means(cut, record, tmp_path):
    longer = pa.concat_tables([cut.windows] * 10)
    read = Read(record(tmp_path / "long.rrd", windows=longer))
    feed = read.scalars("/feed/feed_um_s")
    assert 15_000 < len(feed) < 20_000
    assert feed.mean() == pytest.approx(column(cut.windows, "feed_um_s").mean(), rel=1e-3)
    (text,) = read.column("/about", "TextDocument:text")[0]
    assert "the mean of 2 windows, around events one window" in text


def test_groups_leave_nan_out_and_may_end_short():
    starts = group_starts(5, 2, np.zeros(0, np.int64))
    np.testing.assert_array_equal(group_means(np.array([1.0, 3.0, np.nan, 5.0, np.nan]), starts), [2.0, 5.0, np.nan])


def test_rows_around_events_are_not_averaged():
    starts = group_starts(1000, 100, np.array([450]))
    np.testing.assert_array_equal(np.diff(starts[(starts >= 430) & (starts <= 471)]), 1)
    assert len(starts) == 10 + 42
    many = group_starts(10**6, 50, np.arange(0, 10**6, 50))
    assert len(many) <= 20_000 + 20_000 + 2 * 500  # bounded, however much happens


@pytest.mark.slow
def test_the_faces_of_passes_appear_when_these_end(cut, record, tmp_path):
    points = cut.scene.maps[0].points_mm[::5]
    error_um = np.array([[95.0], [40.0], [2.0]])[:, :, None] + np.array([-3.0, 0.0, 3.0])[:, None]
    faces = [
        PassFace(0, 100.0 * k, 1000.0 * k, points, np.broadcast_to(row, (3, len(points))).copy())
        for k, row in enumerate(error_um, 1)
    ]
    faces[0].error_um[1, 4] = np.nan  # nothing was measured there
    scene = dataclasses.replace(cut.scene, pass_faces=tuple(faces))
    write_scene(scene, tmp_path / "part.npz")
    faces = read_scene(tmp_path / "part.npz").pass_faces
    assert [(face.contour, face.time_s, face.path_um) for face in faces] == [
        (0, 100.0, 1000.0), (0, 200.0, 2000.0), (0, 300.0, 3000.0),
    ]  # fmt: skip
    (mesh, off_um), (whole, _) = (face_mesh(scene, face) for face in faces[:2])
    assert len(mesh.positions) == 5 * len(points)  # both faces of the workpiece, and the middle of every slice
    assert len(mesh.triangles) == len(whole.triangles) - 6  # all that touch the place
    np.testing.assert_allclose(off_um.reshape(5, -1)[:, 10], [-3.0, -3.0, 0.0, 3.0, 3.0], atol=0.1)
    before_mm = whole.positions.reshape(5, -1, 3)[2, 10, :2] - points[10]
    assert np.hypot(*before_mm) == pytest.approx(0.04 + 0.02, abs=1e-3)  # metal left, and just before it
    read = Read(record(tmp_path / "passes.rrd", scene=scene))
    assert len(read.column("/world/table/face/0", "Mesh3D:vertex_colors")) == 3


@pytest.mark.slow
def test_a_stopped_or_empty_cut_is_recorded(cut, record, tmp_path):
    stopped = dataclasses.replace(cut.scene, stop_mm=(30.0, 23.0))
    report = dataclasses.replace(cut.report, outcome="wire-break", reason="612 K")
    read = Read(record(tmp_path / "stopped.rrd", scene=stopped, report=report))
    assert read.column("/world/table/stop", "Points3D:labels") == [["stopped here"]]
    assert read.column("/events", "TextLog:level")[-1] == ["CRITICAL"]
    assert read.column("/events", "TextLog:text")[-1] == ["wire-break: 612 K"]
    empty = record(
        tmp_path / "empty.rrd", scene=NOTHING, windows=WindowTable().to_arrow(), frames=Frames(9),
        closeups=Closeups(9, 32, 4),
    )  # fmt: skip
    assert "/world/table/workpiece" in Read(empty).entities()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="no limit of a file's size")
def test_a_recording_that_finds_no_room_leaves_nothing_behind(cut, record, tmp_path):
    import resource

    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, limits[1]))
    try:
        with pytest.raises(OSError, match="File too large"):  # as on a full disk; rerun itself would wait endlessly
            record(tmp_path / "cut.rrd")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert not list(tmp_path.iterdir())
    assert Read(record(tmp_path / "cut.rrd")).recordings
