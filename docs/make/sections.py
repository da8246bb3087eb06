"""Functions for all scripts: tables of Markdown, and replacing of a page's sections."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from edmsim.errors import InputError

DOCS = Path(__file__).parents[1]
_TABLE = re.compile(r"(<!-- begin table: ([\w-]+) ?([^\n]*?) -->\n).*?(<!-- end table -->)", re.DOTALL)
"""Place of a table, with its kind and the words that are its arguments."""


def has_tables(page: Path) -> bool:
    """Return whether a page has places of tables."""
    return _TABLE.search(page.read_text(encoding="utf-8")) is not None


def with_tables(text: str, made: Mapping[str, Callable[..., str] | None], page: Path | None = None) -> str:
    """Return a page with its tables replaced by kind, unchanged if `made` has None; messages name the page."""

    def written(mark: re.Match[str]) -> str:
        begin, kind, words, end = mark.groups()
        if kind not in made:
            raise InputError(f"no table '{kind} {words}'; there are {' and '.join(made)}", page)
        make = made[kind]
        return mark[0] if make is None else f"{begin}\n{make(*words.split())}\n\n{end}"

    return _TABLE.sub(written, text)


def write_sections(page: str, sections: Mapping[str, str]) -> None:
    """Print sections, and write each into a page of `DOCS`, between ``<!-- begin NAME -->`` and the end mark."""
    file = DOCS / page
    text = file.read_text(encoding="utf-8")
    for name, section in sections.items():
        print(section, end="\n\n", flush=True)
        begin, end = f"<!-- begin {name} -->\n", f"<!-- end {name} -->"
        place = re.compile(f"{re.escape(begin)}.*?{re.escape(end)}", re.DOTALL)
        text = place.sub(lambda _, written=f"{begin}\n{section}\n\n{end}": written, text)
    file.write_text(text, encoding="utf-8")


def table(heads: Sequence[str], rows: Iterable[Sequence[str]], numbers: int = 0) -> str:
    """Return a table of Markdown, whose last `numbers` columns are aligned to the right."""
    rule = "|---" * (len(heads) - numbers) + "|--:" * numbers + "|"
    lines = ([cell.replace("|", "\\|") for cell in cells] for cells in (heads, *rows))
    head, *body = (f"| {' | '.join(cells)} |" for cells in lines)
    return "\n".join([head, rule, *body])
