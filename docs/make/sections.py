"""Sections of a page that a script writes, between ``<!-- begin NAME -->`` and ``<!-- end NAME -->``."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path


def with_sections(text: str, sections: Mapping[str, str]) -> str:
    """Return a page with the text of each section."""
    for name, section in sections.items():
        begin, end = f"<!-- begin {name} -->\n", f"<!-- end {name} -->"
        mark = re.compile(f"{re.escape(begin)}.*?{re.escape(end)}", re.DOTALL)
        text = mark.sub(lambda _, written=f"{begin}\n{section}\n\n{end}": written, text)
    return text


def write_sections(page: Path, sections: Mapping[str, str]) -> None:
    """Write the text of each section into a page."""
    page.write_text(with_sections(page.read_text(encoding="utf-8"), sections), encoding="utf-8")
