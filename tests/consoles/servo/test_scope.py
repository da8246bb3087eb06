"""The scope of ``edmsim console servo``: what it draws and keeps, and its viewer with a screen and without one."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from edmsim.consoles.servo import Scope, bench_for, run_script
from edmsim.errors import InputError
from edmsim.recording.rerun import viewer

LISTENS = (
    "import socket, sys, time; s = socket.create_server((sys.argv[2], int(sys.argv[sys.argv.index('--port') + 1])));"
    "time.sleep(60)"
)


def curve(file: Path, name: str) -> list[float]:
    """A curve as rerun reads it back."""
    from rerun.chunk import RrdReader

    drawn: list[float] = []
    for chunk in RrdReader(str(file)).stream().to_chunks():
        if chunk.entity_path == f"/{name}":
            batch = chunk.to_record_batch()
            drawn += [value for row in batch.column("Scalars:scalars").to_pylist() for value in row]
    return drawn


def test_the_scope_writes_the_tracking_error_stream(tmp_path, capfdbinary: pytest.CaptureFixture[bytes]):  # U-34
    file = tmp_path / "scope.rrd"
    scope = Scope(False, file)
    bench = bench_for("uhu", "bench", True)
    bench.trace = True
    run_script(bench, b"A\nG60\n", scope)
    scope.close()
    streamed = [byte - 128 - 63 for byte in capfdbinary.readouterr().out if byte >= 128]
    assert max(streamed) > 40
    assert curve(file, "tracking_error") == streamed
    samples = bench.time_s / 533.3e-6
    assert len(curve(file, "duty")) == pytest.approx(samples, abs=3)


def test_a_recording_takes_little_room(tmp_path: Path):
    scope = Scope(False, tmp_path / "scope.rrd", streams=False)
    bench = bench_for("servo-module", "table", True)
    bench.trace = True
    for _ in range(300):
        bench.run(0.01)
        scope.draw([], bench.samples())
    scope.close()
    assert len(curve(tmp_path / "scope.rrd", "place_um")) > 4_000
    assert (tmp_path / "scope.rrd").stat().st_size < 600_000


def test_a_scope_s_file_that_cannot_be_written_is_refused(tmp_path: Path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError):
        Scope(False, tmp_path / "file" / "scope.rrd")
    with pytest.raises(InputError, match="is to be a file"):
        Scope(False, tmp_path)


@pytest.mark.slow
def test_without_a_screen_the_scope_is_a_page_and_the_drive_runs():
    without = {name: value for name, value in os.environ.items() if "DISPLAY" not in name}
    done = subprocess.run(
        [sys.executable, "-m", "edmsim", "console", "servo", "uhu", "--tuned", "--scope"],
        input=b"G60\n", capture_output=True, check=False, env=without,
    )
    assert done.returncode == 0
    assert done.stdout.endswith(b"OK\r\n>")
    lines = done.stderr.decode().strip().splitlines()
    assert len(lines) == 1
    assert "no screen here: open http://127.0.0.1:" in lines[0]


@pytest.mark.parametrize("screen", [True, False])
def test_a_window_is_left_to_its_user_and_a_page_ends_with_the_drive(screen, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(viewer, "RERUN", (sys.executable, "-c", LISTENS))
    monkeypatch.setattr(viewer, "has_screen", lambda environment, platform: screen)
    live = viewer.LiveViewer("the scope", "wait")
    live.close()
    process = live._process
    if screen:
        assert process.poll() is None
        os.killpg(process.pid, signal.SIGTERM)
    assert process.wait(timeout=10) == -signal.SIGTERM


def test_a_viewer_that_does_not_start_is_reported_in_a_line(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(viewer, "RERUN", (sys.executable, "-c", "raise SystemExit(1)"))
    with pytest.raises(InputError, match="viewer did not start, so there is no scope; --record"):
        Scope(True, None)
