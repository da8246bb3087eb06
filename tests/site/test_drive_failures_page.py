"""The tables of what a cut does when a drive fails: every way is in its page, and does what the page says."""

from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
DRIVES = ("uhu", "servo-module", "eanpos")
LATE = ("none", "swings", "fault line")
"""Ways whose cuts last to the line's end, or nearly."""


@pytest.fixture(scope="module")
def script(load_script):
    return load_script(DOCS / "make" / "drive_failures.py")


def written(script, drive):
    """Return the rows of a drive's table in its page."""
    text = (DOCS / script.PAGES[drive]).read_text(encoding="utf-8").split(f"<!-- begin failures {drive} -->")[1]
    lines = text.split(f"<!-- end failures {drive} -->")[0].splitlines()
    return [tuple(cell.strip() for cell in line.split("|")[1:-1]) for line in lines if line.startswith("|")]


@pytest.mark.parametrize("drive", DRIVES)
def test_the_page_has_every_way_to_fail(script, drive):
    typed = [typed for _, typed, *_ in written(script, drive)[2:]]
    assert typed == [f"`{failure.typed}`" for failure in script.failures(drive)]


@pytest.mark.slow
@pytest.mark.parametrize("drive", DRIVES)
def test_each_does_what_the_page_says(script, drive):
    rows = written(script, drive)
    soon = [found for found in script.failures(drive) if found.program == script.LINE and found.name not in LATE]
    assert len(soon) >= 8
    for failure in soon:
        assert script.row(failure) in rows
