"""What a script writes into a page: sections between ``<!-- begin NAME -->`` and ``<!-- end NAME -->``, tables."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
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


def table(heads: Sequence[str], rows: Iterable[Sequence[str]], numbers: int = 0) -> str:
    """Return a table of Markdown; its last columns, as many as are `numbers`, are aligned to the right."""
    rule = "|---" * (len(heads) - numbers) + "|--:" * numbers + "|"
    lines = ([cell.replace("|", "\\|") for cell in cells] for cells in (heads, *rows))
    head, *body = (f"| {' | '.join(cells)} |" for cells in lines)
    return "\n".join([head, rule, *body])
