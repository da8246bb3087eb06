"""`make pictures`: the pages it takes pictures of are there, and what it lacks is said in one line."""

import runpy
from pathlib import Path

import pytest

from edmsim.errors import InputError

ROOT = Path(__file__).parents[2]


@pytest.fixture
def pictures(load_script):
    return load_script(ROOT / "docs" / "pictures.py")


def test_the_pages_are_there(pictures):
    for step in pictures.STEPS:
        source = ROOT / f"{step}.ipynb" if step.startswith("notebooks/") else ROOT / "docs" / f"{step}.md"
        assert source.is_file(), step


def test_a_machine_without_a_browser_is_reported(pictures, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    page = tmp_path / "page.html"
    page.write_text("<p>a page</p>")
    with pytest.raises(InputError, match=r"need one of chromium, .* on the path"):
        pictures.photograph(page, tmp_path / "picture.png", pictures.WIDE)
    with pytest.raises(InputError, match="make cut and make docs first"):
        pictures.photograph(tmp_path / "none.html", tmp_path / "picture.png", pictures.WIDE)


def test_the_program_ends_with_one_line(tmp_path):
    # a copy elsewhere finds no cut beside it
    copy = tmp_path / "docs" / "pictures.py"
    copy.parent.mkdir()
    copy.write_text((ROOT / "docs" / "pictures.py").read_text(encoding="utf-8"), encoding="utf-8")
    with pytest.raises(SystemExit, match=r"^pictures: .*$") as ended:
        runpy.run_path(str(copy), run_name="__main__")
    assert "\n" not in ended.value.code  # which Python writes as a line, and ends with 1
