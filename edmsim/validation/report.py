"""The rows of a validation for the terminal, in Markdown and as JSON."""

from __future__ import annotations

import json
import math
import posixpath
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

from edmsim.validation.rows import Row

if TYPE_CHECKING:
    from rich.console import RenderableType


def simulated(row: Row) -> str:
    """Simulated value with its uncertainty and unit: "38.1 ± 1.7 us"."""
    if row.uncertainty == 0:
        return f"{row.simulated:.4g} {row.unit}".strip()
    decimals = 0
    if math.isfinite(row.uncertainty):
        decimals = max(0, 1 - math.floor(math.log10(row.uncertainty)))
    return f"{row.simulated:.{decimals}f} ± {row.uncertainty:.{decimals}f} {row.unit}".strip()


def summary(rows: Sequence[Row]) -> str:
    """Say how many rows agree, how many fail, and how many of those nobody explains."""
    failing = [row for row in rows if not row.passed]
    unexpected = sum(row.unexpected for row in failing)
    return (
        f"{len(rows)} rows: {len(rows) - len(failing)} agree, {len(failing)} fail, "
        f"{unexpected} of them without an explanation"
    )


def render(rows: Sequence[Row]) -> RenderableType:
    """Return the rows as a table for the terminal."""
    from rich.table import Table

    table = Table("", "fact", "published", "model", title="edmsim validate", caption=summary(rows))
    topic = ""
    for row in rows:
        if row.topic != topic:
            topic = row.topic
            table.add_section()
            table.add_row("", topic, "", "", style="bold")
        result = "ok" if row.passed else "fails" if row.note else "FAILS"
        table.add_row(result, row.name, row.published, simulated(row), style="" if row.passed else "red")
    return table


def rows_table(rows: Sequence[Row], seen_from: str = "docs") -> list[str]:
    """Return a Markdown table of rows; links lead from a page in the folder `seen_from`."""
    lines = ["| fact | published | model | agreement asked for | result | source |", "|---|---|---|---|---|---|"]
    for row in rows:
        cells = row.name, row.published, simulated(row), row.tolerance, _result(row, seen_from), row.source
        lines.append("| " + " | ".join(markdown_cell(cell) for cell in cells) + " |")
    return lines


def _result(row: Row, seen_from: str) -> str:
    if row.passed:
        return "agrees"
    if not row.note:
        return "**fails**"
    return f"**fails**, [why]({posixpath.relpath(row.note, seen_from)})"


def markdown_cell(text: str) -> str:
    """Return a text as it stands in a cell of a Markdown table."""
    return text.replace("|", "\\|")


def as_json(rows: Sequence[Row]) -> str:
    """Return the rows as JSON; what is not finite is null."""
    return json.dumps(
        {
            "agree": sum(row.passed for row in rows),
            "fail": sum(not row.passed for row in rows),
            "unexpected": sum(row.unexpected for row in rows),
            "rows": [
                {key: None if isinstance(value, float) and not math.isfinite(value) else value
                 for key, value in asdict(row).items()}
                for row in rows
            ],
        },
        indent=2, allow_nan=False,
    )
