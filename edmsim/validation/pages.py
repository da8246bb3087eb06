"""The tables of the documentation: constants with their sources, and the rows of the validation.

A page marks the place of a table with two comments; what stands between them is replaced::

    <!-- begin table: constants gap discharge -->
    <!-- end table -->

``constants`` takes sections of the machine file (``gap``), or ``wire``, ``material``, ``generator`` for all files of
that kind; ``rows`` takes a topic of the validation.
"""

from __future__ import annotations

import posixpath
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from edmsim.errors import InputError
from edmsim.machine.files import available
from edmsim.machine.machine import Machine
from edmsim.machine.parts import Constant
from edmsim.validation.report import simulated, summary
from edmsim.validation.rows import Row

PAGE = "validation.md"
_MARK = re.compile(
    r"(?P<begin><!-- begin table: (?P<kind>\w+) (?P<words>[^>]*?) -->\n).*?(?P<end><!-- end table -->)", re.DOTALL
)


def check_folder(folder: Path) -> None:
    """Raise `InputError` unless `folder` holds the docs: a folder with the theory pages in it."""
    if not (folder / "theory").is_dir():
        raise InputError(f"{folder} has no folder theory/; --write takes the folder of the docs")


def write(folder: Path, rows: Sequence[Row]) -> None:
    """Write the validation page into the docs' folder and refresh the tables of its theory pages."""
    (folder / PAGE).write_text(validation_page(rows), encoding="utf-8")
    for page in sorted((folder / "theory").glob("*.md")):
        before = page.read_text(encoding="utf-8")
        page.write_text(refreshed(before, rows, page), encoding="utf-8")


def refreshed(text: str, rows: Sequence[Row] | None = None, page: Path | None = None) -> str:
    """Return a page with its tables made anew.

    Parameters
    ----------
    text : str
        The page.
    rows : sequence of Row, optional
        Without them the tables of rows stay as they are.
    page : path, optional
        Where the page stands, for messages.

    Raises
    ------
    InputError
        If a mark asks for a table there is not.
    """

    def table(mark: re.Match[str]) -> str:
        kind, words = mark["kind"], mark["words"].strip()
        if kind == "constants":
            lines = constants_table(words.split(), page)
        elif kind != "rows":
            raise InputError(f"no table '{kind} {words}'; there are constants and rows", page)
        elif rows is None:
            return mark[0]
        else:
            lines = rows_table([row for row in rows if row.topic == words], "docs/theory")
        return f"{mark['begin']}\n" + "\n".join(lines) + f"\n\n{mark['end']}"

    return _MARK.sub(table, text)


def constants_table(words: Sequence[str], page: Path | None = None) -> list[str]:
    """Return a Markdown table of constants: name, value, range and source of each.

    Parameters
    ----------
    words : sequence of str
        Sections of the machine file, plain or as ``machine.gap``; ``wire``, ``material`` or ``generator``.
    """
    lines = ["| constant | value | range | source |", "|---|---|---|---|"]
    for word in words:
        for label, part in _sections(word.removeprefix("machine."), page):
            for name, constant in part:
                if isinstance(constant, Constant):
                    span = "" if constant.range is None else "{:g} to {:g}".format(*constant.range)
                    lines.append(f"| {label}`{name}` | {constant.value:g} | {span} | {_cell(constant.source)} |")
    return lines


def _sections(word: str, page: Path | None) -> Iterator[tuple[str, Iterable[tuple[str, object]]]]:
    """Yield a label and the constants of every file, or of the machine's section, that `word` names."""
    if word == "wire":
        for name in available("wires"):
            yield f"{name} ", Machine.load(wire=name).wire
    elif word == "material":
        for name in available("materials"):
            yield f"{name} ", Machine.load(material=name).material
    elif word == "generator":
        for name in available("generators"):
            yield f"{name} ", Machine.load(generator=name).generator
    else:
        base: Mapping[str, object] = dict(Machine.load().base)
        section = base.get(word)
        if not isinstance(section, Iterable) or isinstance(section, str):
            sections = ", ".join(name for name, part in base.items() if not isinstance(part, str))
            raise InputError(f"no constants '{word}'; there are: {sections}, wire, material, generator", page)
        yield "", section


def rows_table(rows: Sequence[Row], seen_from: str = "docs") -> list[str]:
    """Return a Markdown table of rows; links lead from a page in the folder `seen_from`."""
    lines = ["| fact | published | model | agreement asked for | result | source |", "|---|---|---|---|---|---|"]
    for row in rows:
        cells = row.name, row.published, simulated(row), row.tolerance, _result(row, seen_from), row.source
        lines.append("| " + " | ".join(_cell(cell) for cell in cells) + " |")
    return lines


def _result(row: Row, seen_from: str) -> str:
    if row.passed:
        return "agrees"
    if not row.note:
        return "**fails**"
    return f"**fails**, [why]({posixpath.relpath(row.note, seen_from)})"


def validation_page(rows: Sequence[Row]) -> str:
    """Return the page with all rows, by topic."""
    lines = [
        "# Validation",
        "",
        "What was published beside what the model does, written by `edmsim validate --write docs`. A value agrees",
        "if it lies within its tolerance and its 95 % interval is no wider than that; a band, if the central value",
        "lies in it; a sign, if the whole interval lies on its side of zero. Intervals are over seeds or draws.",
        "Rows that fail stay, with the reason behind the link.",
        "",
        f"{summary(rows)}.",
    ]
    for topic in dict.fromkeys(row.topic for row in rows):
        lines += ["", f"## {topic[0].upper()}{topic[1:]}", "", *rows_table([r for r in rows if r.topic == topic])]
    return "\n".join(lines) + "\n"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
