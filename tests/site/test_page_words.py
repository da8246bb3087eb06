"""Pages are plain English, and no line of theirs vanishes from the site."""

import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = [
    ROOT / "README.md", ROOT / "notebooks" / "README.md",
    *sorted(page for page in (ROOT / "docs").rglob("*.md") if page.parent != ROOT / "docs" / "notebooks"),
]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
BANNED = (
    "told", "anew", "stands", "lays down", "tells of", "worth the while", "for good", "what came of it", "so that",
    "as one would", "whom", "nobody", "of its own accord", "as it were", "save for", "if need be", "another than",
    "one's own", "an own", "no machine shows", "what it comes to", "comes to nothing", "truth lies", "go on from",
    "for certain", "to the bit", "one behind the other", "in its course", "what comes of", "begun", "fresh wire",
    "a bar says", "goes by", "so long as", "time and again", "thereby", "thereof", "whereby",
)  # fmt: skip
"""Words that a reader of other documentation would not meet, or not in this sense."""
_CODE = re.compile(r"^ *(```|~~~).*?^ *\1|^(?: {4}|\t).*?$|`[^`\n]*`", re.DOTALL | re.MULTILINE)


def prose(text):
    """Return a page's text without its code; the lines stay where they are."""
    return _CODE.sub(lambda code: "\n" * code[0].count("\n"), text)


def cells(notebook):
    """Return a notebook's text."""
    held = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    return "\n\n".join("".join(cell["source"]) for cell in held if cell["cell_type"] == "markdown")


@pytest.mark.parametrize("page", [*PAGES, *NOTEBOOKS], ids=lambda page: page.relative_to(ROOT).as_posix())
def test_pages_are_plain_english_and_lose_no_line(page):
    text = prose(cells(page) if page.suffix == ".ipynb" else page.read_text(encoding="utf-8"))
    for number, line in enumerate(text.splitlines(), 1):
        place = f"{page.name}:{number}: {line}"
        assert not re.match(r" {0,3}(%|\+\+\+)", line), f"the site takes this line for a comment: {place}"
        for words in BANNED:
            assert not re.search(rf"\b{words}\b", line, re.IGNORECASE), f"'{words}' in {place}"


@pytest.mark.parametrize("text", ["a share of 5\n% of it\n", "tells of\n"])
def test_what_is_looked_for_would_be_found(text, tmp_path):
    page = tmp_path / "page.md"
    page.write_text(text, encoding="utf-8")
    with pytest.raises(AssertionError, match=r"page\.md"):
        test_pages_are_plain_english_and_lose_no_line(page)
