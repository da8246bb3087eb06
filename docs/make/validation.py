"""``docs/validation.md`` and the tables of ``docs/theory``: constants with their sources, rows of the validation.

    python docs/make/validation.py

After an interruption the same command runs only the missing checks, as ``edmsim validate --out`` does. A page marks
the place of a table with two comments; the text between them is replaced::

    <!-- begin table: constants gap discharge -->
    <!-- end table -->

``constants`` takes sections of the machine file (``gap``), or ``wire``, ``material``, ``generator`` for all files of
that kind; ``rows`` takes a topic of the validation.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

from sections import DOCS, table, with_tables

from edmsim import validation
from edmsim.errors import InputError
from edmsim.files import make_writable
from edmsim.machine.components import Constant
from edmsim.machine.machine import Machine
from edmsim.machine.options import available
from edmsim.runs import Processes, RunTable
from edmsim.validation.report import judged, reasons_table, rows_table, summary
from edmsim.validation.rows import Row

TABLE = Path("out/validation.jsonl")  # of finished checks


def write(folder: Path, rows: Sequence[Row]) -> None:
    """Write the validation page into the docs' folder, and the tables of its theory pages."""
    (folder / "validation.md").write_text(validation_page(rows), encoding="utf-8")
    for page in sorted((folder / "theory").glob("*.md")):
        before = page.read_text(encoding="utf-8")
        page.write_text(refreshed(before, rows, page), encoding="utf-8")


def refreshed(text: str, rows: Sequence[Row] | None = None, page: Path | None = None) -> str:
    """Return a page with its tables replaced, except those of rows if `rows` is None; messages name the `page`."""

    def of_topic(*words: str) -> str:
        return "\n".join(rows_table([row for row in rows or () if row.topic == " ".join(words)], "docs/theory"))

    made = {"constants": partial(constants_table, page=page), "rows": None if rows is None else of_topic}
    return with_tables(text, made, page)


def constants_table(*words: str, page: Path | None) -> str:
    """Return a Markdown table of constants of the named `_sections`, such as ``gap`` or ``machine.gap``."""
    rows = []
    for word in words:
        for label, part in _sections(word.removeprefix("machine."), page):
            for name, constant in part:
                if isinstance(constant, Constant):
                    span = "" if constant.range is None else "{:g} to {:g}".format(*constant.range)
                    rows.append((f"{label}`{name}`", f"{constant.value:g}", span, constant.source))
    return table(("constant", "value", "range", "source"), rows)


def _sections(word: str, page: Path | None) -> Iterator[tuple[str, Iterable[tuple[str, object]]]]:
    """Yield a label and the constants of every file, or of the machine's section, that `word` names."""
    if word == "wire":
        yield from ((f"{name} ", Machine.load(wire=name).wire) for name in available("wires"))
    elif word in ("material", "surface"):
        for name in available("materials"):
            material = Machine.load(material=name).material
            yield f"{name} ", material if word == "material" else material.surface or ()
    elif word == "generator":
        for name in available("generators"):
            generator = Machine.load(generator=name).generator
            yield f"{name} ", generator
            yield f"{name} ", ((f"equalising.{constant}", value) for constant, value in generator.equalising or ())
    else:
        base: Mapping[str, object] = dict(Machine.load().base)
        section = base.get(word)
        if not isinstance(section, Iterable) or isinstance(section, str):
            sections = ", ".join(name for name, part in base.items() if not isinstance(part, str))
            files = "wire, material, surface, generator"
            raise InputError(f"no constants '{word}'; there are: {sections}, {files}", page)
        yield "", section


def validation_page(rows: Sequence[Row]) -> str:
    """Return the page with all rows, by topic."""
    lines = [
        "# Validation",
        "",
        "    edmsim validate --failed",
        "",
        "This command compares the model with facts from publications, from practice and from closed forms. It",
        "prints those that the model misses, each with the reason. This page has all of them",
        "(`python docs/make/validation.py`):",
        "",
        f"{summary(rows)}.",
        "",
        "- A published *value* agrees if the model's value is within the tolerance, and its 95 % interval is not",
        "  wider than the tolerance (\"known to it\"). A published *band* agrees if the model's central value lies",
        "  in it. A published *sign* agrees if the model's whole interval lies on that side of zero. Intervals are",
        "  over seeds or draws. Rows that fail stay in the table, with a link to the reason.",
        "- A row is a *calibration* if a constant was chosen with its fact, and *context* if its source has another",
        "  subject or no published figure. Neither counts; [the end of the page](#rows-that-do-not-count) has their",
        "  reasons. The other constants come from derivations and sources.",
        "- The column \"agreement asked for\" has the tolerance of a row; `--topics` compares a part of the rows.",
    ]
    for topic in dict.fromkeys(row.topic for row in rows):
        lines += ["", f"## {topic[0].upper()}{topic[1:]}", "", *rows_table([r for r in rows if r.topic == topic])]
    if len(judged(rows)) < len(rows):
        lines += ["", "## Rows that do not count", "", *reasons_table(rows)]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    make_writable(TABLE.parent)
    write(DOCS, validation.run(engine=Processes(), table=RunTable(TABLE, texts=validation.CHECK_TEXTS)))
