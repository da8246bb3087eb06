"""``cut.rrd``: read back with rerun's own reader; equal cuts give equal recordings."""

from __future__ import annotations

import dataclasses
import subprocess
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from edmsim.recording import Frames, Scene, WindowTable
from edmsim.recording.blueprint import ELECTRICAL, PROCESS
from edmsim.recording.rerun_log import about, grouped, recording_id, wire_strips, write_recording
from edmsim.recording.viewer import RERUN
from edmsim.recording.windows import NAMES, column, lag_along_um


def compare(one: Path, two: Path) -> int:
    command = [*RERUN, "rrd", "compare", str(one), str(two)]
    return subprocess.run(command, capture_output=True, check=False).returncode


class Read:
    """The chunks of a recording, by entity."""

    def __init__(self, file: Path) -> None:
        from rerun.chunk import RrdReader

        reader = RrdReader(file)
        self.recordings = reader.recordings()
        self.chunks = [chunk.to_record_batch() for chunk in reader.stream().to_chunks()]

    def entities(self) -> set[str]:
        return {self._path(batch) for batch in self.chunks}

    def content(self) -> dict[tuple[str, str], list[Any]]:
        """Every logged value; left out are the row's number and the moment of writing."""
        values: dict[tuple[str, str], list[Any]] = {}
        for batch in self.chunks:
            for name in set(batch.schema.names) - {"log_time", "log_tick", "rerun.controls.RowId"}:
                values.setdefault((self._path(batch), name), []).extend(batch.column(name).to_pylist())
        return values

    def column(self, entity: str, name: str) -> list[Any]:
        rows: list[Any] = []
        for batch in self.chunks:
            if self._path(batch) == entity and name in batch.schema.names:
                rows += batch.column(name).to_pylist()
        return rows

    def scalars(self, entity: str) -> np.ndarray:
        return np.array([row[0] for row in self.column(entity, "Scalars:scalars")])

    @staticmethod
    def _path(batch: pa.RecordBatch) -> str:
        return str(batch.schema.metadata[b"rerun:entity_path"].decode())


def write(cut: SimpleNamespace, file: Path, **changed: Any) -> Path:
    given = {"scene": cut.scene, "windows": cut.windows, "frames": cut.frames, "report": cut.report} | changed
    write_recording(file, **given, title="punch.ngc")
    return file


@pytest.fixture(scope="module")
def read(cut: SimpleNamespace, tmp_path_factory: pytest.TempPathFactory) -> Read:
    return Read(write(cut, tmp_path_factory.mktemp("recording") / "cut.rrd"))


def test_identity_comes_from_what_the_cut_was_made_with(cut: SimpleNamespace, read: Read) -> None:
    (entry,) = read.recordings
    assert entry.recording_id == recording_id(cut.report)
    assert recording_id(cut.report | {"wall_time_s": 1.0}) == recording_id(cut.report)
    assert recording_id(cut.report | {"seed": 8}) != recording_id(cut.report)


def test_all_series_are_there_to_the_last_bit(cut: SimpleNamespace, read: Read) -> None:
    np.testing.assert_array_equal(read.scalars("/feed/feed_um_s"), column(cut.windows, "feed_um_s"))
    np.testing.assert_array_equal(read.scalars("/gap/lag_um"), lag_along_um(cut.windows))
    shares = sum(read.scalars(f"/pulses/{kind}") for kind in ("short", "open", "spark", "arc"))
    np.testing.assert_allclose(shares, 100.0)
    delay = column(cut.windows, "mean_delay_us")
    np.testing.assert_array_equal(read.scalars("/times/mean_delay_us"), delay[np.isfinite(delay)])


def test_every_column_of_the_table_has_a_curve() -> None:
    shown = {series.entity for plot in PROCESS + ELECTRICAL for series in plot.series}
    shared = {"t_s", "path_um", "lag_x_um", "lag_y_um"}  # the two timelines, and the lag along the feed
    assert set(NAMES) - shared <= shown


def test_timelines_are_machine_time_and_path(cut: SimpleNamespace, read: Read) -> None:
    seconds = [t.total_seconds() for t in read.column("/feed/feed_um_s", "machine_time")]
    np.testing.assert_allclose(seconds, column(cut.windows, "t_s"), atol=1e-6)
    np.testing.assert_array_equal(
        read.column("/feed/feed_um_s", "path_um"), np.round(column(cut.windows, "path_um"))
    )


def test_the_table_moves_and_the_wire_stands(cut: SimpleNamespace, read: Read) -> None:
    moved = np.array([row[0] for row in read.column("/world/table", "Transform3D:translation")])
    np.testing.assert_allclose(moved[:, :2], -cut.frames.guides_um / 1000.0, atol=1e-5)
    strips = np.array([row[0] for row in read.column("/world/wire", "LineStrips3D:strips")])
    assert strips.shape == (len(cut.frames), 11, 3)
    np.testing.assert_array_equal(strips[:, [0, -1], :2], 0.0)
    np.testing.assert_array_equal(strips[:, [0, -1], 2], np.broadcast_to((-15.0, 35.0), (len(cut.frames), 2)))


def test_the_part_is_drawn(read: Read) -> None:
    edges = ["nominal/bottom", "nominal/top", "cut/bottom", "cut/middle", "cut/top", "error/0"]
    expected = {"plate", "blank", "corners", "starts", "done", *edges}
    assert {f"/world/table/{name}" for name in expected} <= read.entities()
    assert "/world/table/stop" not in read.entities()
    corners = read.column("/world/table/corners", "Points3D:labels")
    assert corners == [["-9.1 µm", "-8.4 µm", "-10.2 µm", "-7.9 µm"]]


def test_deflection_is_exaggerated_by_the_factor(cut: SimpleNamespace) -> None:
    strips = wire_strips(cut.scene, cut.frames, 100.0)
    np.testing.assert_allclose(strips[:, 1:-1, :2], cut.frames.deflection_um / 10.0, rtol=1e-6)
    np.testing.assert_allclose(strips[0, 1:-1, 2], 20.0 * (np.arange(9) + 0.5) / 9)


def test_the_factors_and_the_thinning_are_said(cut: SimpleNamespace, read: Read) -> None:
    (text,) = read.column("/about", "TextDocument:text")[0]
    for piece in (
        "punch.ngc",
        "× 200",
        "× 50",
        "every 2 windows",
        "one window",
        "seed: 7",
        "controller: counts",
    ):
        assert piece in text
    long = about(cut.scene, cut.frames, cut.report, "punch.ngc", 200.0, 6)
    assert "the mean of 6 windows" in long


def test_equal_cuts_compare_equal_and_others_do_not(cut: SimpleNamespace, tmp_path: Path) -> None:
    one, two = (write(cut, tmp_path / name) for name in ("one.rrd", "two.rrd"))
    assert compare(one, two) == 0
    assert Read(one).content() == Read(two).content()  # to the last bit: rerun allows a tolerance
    feed = cut.windows.schema.field("feed_um_s")
    other = cut.windows.set_column(3, feed, pa.array(column(cut.windows, "feed_um_s") + 0.01))
    assert compare(one, write(cut, tmp_path / "three.rrd", windows=other)) != 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.rrd", "three.rrd", "two.rrd"]


def test_a_long_cut_is_thinned_by_means(cut: SimpleNamespace, tmp_path: Path) -> None:
    longer = pa.concat_tables([cut.windows] * 10)
    read = Read(write(cut, tmp_path / "long.rrd", windows=longer))
    feed = read.scalars("/feed/feed_um_s")
    assert len(feed) == 15_000
    assert feed.mean() == pytest.approx(column(cut.windows, "feed_um_s").mean())


def test_groups_leave_nan_out_and_may_end_short() -> None:
    np.testing.assert_array_equal(grouped(np.array([1.0, 3.0, np.nan, 5.0, np.nan]), 2), [2.0, 5.0, np.nan])


def test_a_stopped_or_empty_cut_is_recorded(cut: SimpleNamespace, tmp_path: Path) -> None:
    stopped = dataclasses.replace(cut.scene, stop_mm=(30.0, 23.0))
    report = cut.report | {"outcome": "wire break", "reason": "612 K"}
    read = Read(write(cut, tmp_path / "stopped.rrd", scene=stopped, report=report))
    assert read.column("/world/table/stop", "Points3D:labels") == [["stopped here"]]
    nothing = Scene((), (), (), np.zeros((0, 2)), (0, 0, 10, 80), 20.0, (-10, 30), 250.0)
    empty = write(
        cut, tmp_path / "empty.rrd", scene=nothing, windows=WindowTable().to_arrow(), frames=Frames(9)
    )
    assert "/world/table/blank" in Read(empty).entities()
