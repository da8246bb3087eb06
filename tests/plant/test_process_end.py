"""A process with numba in it ends without looking through numba's objects, and loses nothing by that."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

BEGIN = """
import atexit, gc, sys
atexit.register(lambda: print("at once" if gc.get_freeze_count() else "slowly"))  # after edmsim's, which comes later
import edmsim.compiled.jit

class Circle:
    pass

circle = Circle()
circle.itself = circle
"""
ACTING = {
    "finaliser": """
class Speaks:
    def __del__(self):
        print("done")
circle.speaks = Speaks()
""",
    "generator": """
def waits():
    try:
        yield
    finally:
        print("done")
circle.waits = waits()
next(circle.waits)
""",
}


def _run(code: str, *arguments: str) -> list[str]:
    command = [sys.executable, "-c", BEGIN + code, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()


@pytest.mark.slow
@pytest.mark.parametrize("what", ACTING)
def test_what_objects_do_when_they_go_is_done(what: str) -> None:
    assert _run(ACTING[what]) == ["slowly", "done"]


@pytest.mark.slow
def test_a_file_left_open_is_written(tmp_path: Path) -> None:
    left = tmp_path / "left.txt"
    assert _run('circle.file = open(sys.argv[1], "w"); circle.file.write("written")', str(left)) == ["slowly"]
    assert left.read_text(encoding="utf-8") == "written"


@pytest.mark.slow
def test_a_process_ends_at_once_where_they_do_nothing() -> None:
    assert _run("") == ["at", "once"]


@pytest.mark.slow
def test_a_process_keeps_the_objects_that_it_froze_itself() -> None:
    """`gc.unfreeze` would bring them back to the collector."""
    code = "gc.freeze(); before = gc.get_freeze_count()\nfrom edmsim.compiled.start import garbage_left\n"
    code += "with garbage_left(): pass\nprint(gc.get_freeze_count() >= before)"
    assert _run(code)[0] == "True"
