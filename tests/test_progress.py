"""Progress: lines in a file, one bar in a notebook, and nothing before the first message."""

import io
import sys
from types import SimpleNamespace

import pytest
from rich.console import Console

from edmsim import screen
from edmsim.closed_loop.simulation import Progress
from edmsim.job.cut import CutProgress
from edmsim.screen import ShownProgress, in_notebook


@pytest.fixture
def now(monkeypatch):
    clock = [100.0]
    monkeypatch.setattr(screen.time, "monotonic", lambda: clock[0])
    return clock


def test_in_a_file_it_is_a_line_now_and_then(now, capsys):
    with ShownProgress() as bar:
        for done in range(1, 41):
            now[0] += 1.0
            bar.show("runs", done, 40, "none failed")
    assert capsys.readouterr().err.splitlines() == [f"runs {share}.0 % none failed" for share in (25, 50, 75, 100)]


def test_what_is_stored_ends_with_its_last_line(now, capsys):
    for keep in (False, True):
        with ShownProgress(keep=keep) as bar:
            bar.show("runs", 1, 2)
            bar.of("runs")(2, 2)
            bar.show("score", 1, 1)
    assert capsys.readouterr().err == "runs 100.0 %\nscore 100.0 %\n"
    with ShownProgress(quiet=True, keep=True) as bar:
        bar.show("runs", 2, 2)
    assert capsys.readouterr().err == ""


def test_a_narrow_terminal_keeps_share_and_time(monkeypatch):
    console = Console(file=io.StringIO(), force_terminal=True, width=40, color_system=None)
    monkeypatch.setattr(screen, "Console", lambda stderr: console)
    with ShownProgress(keep=True) as bar:
        bar.show("part.ngc", 1, 8, "12 min 40 s simulated in 45.3 s, 33.3 um/s, short 3 %, open 35 %")
    assert "12.5 % 0:00:00" in console.file.getvalue()


class FakeDisplay:
    """IPython's display: the first output and its updates."""

    def __init__(self):
        self.shown = []

    def __call__(self, data, *, raw, display_id=True):
        self.shown.append(data)
        return self

    def update(self, data, *, raw):
        self.shown.append(data)


def test_a_cut_shows_its_progress_in_a_notebook_only(now, monkeypatch):
    display = FakeDisplay()
    shell = SimpleNamespace(kernel=object())
    session = SimpleNamespace(get_ipython=lambda: shell)
    monkeypatch.setitem(sys.modules, "IPython", session)
    monkeypatch.setitem(sys.modules, "IPython.display", SimpleNamespace(display=display))
    monkeypatch.delenv("EDMSIM_PROGRESS", raising=False)
    assert in_notebook()
    bar = CutProgress(ShownProgress(), "<punch>.ngc")
    bar.enter("cutting")
    now[0] += 1.0
    for _ in range(3):  # a browser is updated less often than windows end
        bar.show(Progress(500.0, 2000.0, 65.0, 12.5, 51, 102, 4.0))
    bar.enter("finished")
    first, middle, last = display.shown
    assert first["text/plain"] == "<punch>.ngc: 0.0 %, cutting"
    assert middle["text/plain"] == (
        "<punch>.ngc: 25.0 %, 1 min 05 s simulated in 4.0 s, 12.5 um/s, short 20 %, open 40 %"
    )
    assert 'value="0.2500"' in middle["text/html"]
    assert "&lt;punch&gt;" in middle["text/html"]
    assert last["text/plain"].endswith("4.0 s, finished")
    monkeypatch.setenv("EDMSIM_PROGRESS", "0")
    assert not in_notebook()
    monkeypatch.delenv("EDMSIM_PROGRESS")
    shell.kernel = None  # IPython in a terminal
    assert not in_notebook()
