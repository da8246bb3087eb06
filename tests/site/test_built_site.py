"""The documentation as a reader gets it: built without a warning, and nothing in it leads nowhere."""

import json
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlparse

import pytest

ROOT = Path(__file__).parents[2]
SITE = ROOT / "out" / "docs"


class Page(HTMLParser):
    """A page's links, what they can lead to, and whether it fits a phone."""

    def __init__(self, text):
        super().__init__()
        self.links = set()
        self.anchors = {""}
        self.fits = False
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        attributes = {name: value or "" for name, value in attrs}
        self.anchors |= {attributes[name] for name in ("id", "name") if name in attributes}
        self.links |= {attributes[name] for name in ("href", "src") if name in attributes}
        if tag == "meta" and attributes.get("name") == "viewport":
            self.fits |= "width=device-width" in attributes["content"]


def is_built():
    """Return whether `make docs` has run since the last change of its inputs."""
    index = SITE / "searchindex.js"
    if not index.is_file():
        return False
    folders = ("docs", "edmsim", "controllers", "envs", "models", "notebooks", "examples")
    sources = [file for folder in folders for file in (ROOT / folder).rglob("*") if "__pycache__" not in file.parts]
    newest = max(file.stat().st_mtime for file in [*sources, *ROOT.glob("*.*")] if file.is_file())
    return newest < index.stat().st_mtime


@pytest.fixture(scope="module")
def site():
    """All pages as text, built if `make docs` has not just built them, which fails at a warning as this does."""
    if not is_built():
        command = [sys.executable, "-m", "sphinx", "-b", "html", "-d", "out/doctrees", "-n", "-W", "-q"]
        command += ["--keep-going", "docs", "out/docs"]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    index = (SITE / "searchindex.js").read_text(encoding="utf-8")
    names = json.loads(re.fullmatch(r"Search\.setIndex\((.*)\)", index)[1])["docnames"]
    return {SITE / f"{name}.html": (SITE / f"{name}.html").read_text(encoding="utf-8") for name in names}


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_the_site_holds_together(site):
    pages = {file.resolve(): Page(text) for file, text in site.items()}
    faults = [f"{file.name} is no page for a phone" for file, page in pages.items() if not page.fits]
    for file, page in pages.items():
        for link in page.links:
            parts = urlparse(unquote(link))
            if parts.scheme or parts.netloc:
                continue
            target = (file.parent / parts.path).resolve() if parts.path else file
            if not target.is_file():
                faults.append(f"{file.name}: {link} leads nowhere")
            elif target in pages and parts.fragment not in pages[target].anchors:
                faults.append(f"{file.name}: {link} leads to no place on its page")
    places = ["site-packages", *(str(place) for place in (ROOT, Path.home()) if len(place.parts) > 1)]
    faults += [f"{file.name} tells {place}" for file, text in site.items() for place in places if place in text]
    assert not faults, "\n".join(faults)
    written = [*(ROOT / "docs").glob("*.md"), *(ROOT / "docs").glob("[!_]*/*.md")]
    assert {file.resolve().relative_to(SITE.resolve()).with_suffix("") for file in pages} >= {
        file.relative_to(ROOT / "docs").with_suffix("") for file in written
    }
    notebooks = {SITE / "notebooks" / f"{file.stem}.html" for file in (ROOT / "notebooks").glob("*.ipynb")}
    assert notebooks <= site.keys()
    assert "edmsim.cut" in pages[(SITE / "api" / "edmsim.html").resolve()].anchors  # the docstrings are in


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_options_of_commands_are_not_broken_at_their_hyphens(site):
    page = site[SITE / "guide" / "quick-start.html"]
    assert '<span class="option">--height</span>' in page
    style = (SITE / "_static" / "site.css").read_text(encoding="utf-8")
    assert ".highlight .option { white-space: nowrap; }" in style
