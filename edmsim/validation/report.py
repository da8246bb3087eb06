"""The rows of a validation for the terminal, in Markdown and as JSON, with the reasons of failures."""

import json
import math
import posixpath
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from itertools import groupby
from operator import attrgetter

from rich.console import Group, RenderableType
from rich.padding import Padding
from rich.text import Text

from edmsim.screen import ScreenTable
from edmsim.validation.rows import Row

REASONS = {
    ("passes", "feeds-of-fine-passes"):
        "Shorts slow the finest pass down: its offset is too near to the wall. At one that is 4 um greater it keeps "
        "its feed and removes the shop's stock, but the search, on a table with steps of 2 um, does not find it.",
    ("passes", "accuracy"):
        "The model lacks the main errors of a shop's cut: machine, temperature and stress in the metal. So it is "
        "more accurate than the trade page, with one pass and two by ten times, with three by two and a half.",
    ("passes", "one-pass-of-a-tall-part"):
        "The model's cutting rate still rises at 76 mm, where that of shops falls already.",
    ("ignition", "two-regimes"):
        "Two studies of one group disagree below 12 um. The model follows the later one, in which narrow gaps ignite "
        "much faster.",
    ("ignition", "flow"):
        "At 300 V and equal fields every gap of the figure is below the critical one, and delays are 2 us: too short "
        "for an effect of the flow. The critical gap was measured at 80 V only.",
    ("debris", "debris-and-flushing"):
        "Debris is hardly denser at mid-height than at the faces, as bubbles exchange it with the kerf, and the "
        "gap depends on its logarithm.",
    ("lag", "lag"):
        "The push of the discharges is spread over the height, the pull of field and current is not: in a high "
        "workpiece the wire leads.",
    ("rupture", "wire-rupture"):
        "A tenth of the heat, which matches Sato's limit on 80 mm, is too little to break Mori's wire in still water "
        "at 11 A. A slice that boils dry passes from 600 to 700 K within 10 ms, so the tension hardly matters.",
    ("stable rate", "greatest-stable-rate"):
        "A workpiece of 120 mm gathers too little gas to stop the cut earlier than one of 40 mm. A thin wire "
        "survives more power than in shops, which do not run at the limit.",
}  # fmt: skip
"""One or two sentences by topic, and by the heading to which a row's `note` links."""


def reason(row: Row) -> str:
    """Return the shortest reason why a row fails; empty if unknown."""
    return REASONS.get((row.topic, row.note.partition("#")[2]), "")


def simulated(row: Row) -> str:
    """Return the simulated value with uncertainty and unit: "38.1 ± 1.7 us"."""
    if row.uncertainty == 0:
        return f"{row.simulated:.4g} {row.unit}".strip()
    decimals = 0
    if math.isfinite(row.uncertainty):
        decimals = max(0, 1 - math.floor(math.log10(row.uncertainty)))
    return f"{row.simulated:.{decimals}f} ± {row.uncertainty:.{decimals}f} {row.unit}".strip()


def judged(rows: Sequence[Row]) -> list[Row]:
    """Return the rows that count."""
    return [row for row in rows if row.kind == "judged"]


def summary(rows: Sequence[Row]) -> str:
    """Return the numbers of rows that agree, fail, fail without explanation, and do not count, as text."""
    counted = judged(rows)
    failing = [row for row in counted if not row.passed]
    counts = (
        f"{len(counted)} rows: {len(counted) - len(failing)} agree, {len(failing)} fail, "
        f"{sum(row.unexpected for row in failing)} of them without an explanation"
    )
    if len(counted) == len(rows):
        return counts
    calibrations = [row for row in rows if row.kind == "calibration"]
    return (
        f"{counts}; {len(calibrations)} of calibration (failing: {sum(not row.passed for row in calibrations)}) and "
        f"{len(rows) - len(counted) - len(calibrations)} of context do not count"
    )


def render(rows: Sequence[Row]) -> ScreenTable:
    """Return the rows as a table for the terminal."""
    table = ScreenTable("", "fact", "published", "model", title="edmsim validate", caption=summary(rows))
    for topic, of_topic in groupby(rows, attrgetter("topic")):
        table.add_section()
        table.add_row("", topic, "", "", style="bold")
        for row in of_topic:
            result = row.kind if row.kind != "judged" else "ok" if row.passed else "fails" if row.note else "FAILS"
            style = "dim" if row.kind != "judged" else "" if row.passed else "red"
            table.add_row(result, row.name, row.published, simulated(row), style=style)
    return table


def failed(rows: Sequence[Row]) -> list[Row]:
    """Return the rows that count and fail."""
    return [row for row in judged(rows) if not row.passed]


def render_failed(rows: Sequence[Row]) -> Group:
    """Return the rows that count and fail for the terminal, each with the reason; fits any width."""
    shown: list[RenderableType] = []
    for topic, of_topic in groupby(failed(rows), attrgetter("topic")):
        shown.append(Text(f"{'' if len(shown) == 0 else chr(10)}{topic}", "bold"))
        for row in of_topic:
            lines = [f"published: {row.published}", f"model: {simulated(row)}", f"why: {reason(row) or 'unknown'}"]
            if row.note:
                lines.append(f"more: {row.note}")
            shown.append(Padding(Text(row.name, "red"), (0, 0, 0, 2)))
            shown.append(Padding(Text("\n".join(lines)), (0, 0, 0, 4)))
    return Group(*shown, Text(f"\n{summary(rows)}"))


def rows_table(rows: Sequence[Row], base: str = "docs") -> list[str]:
    """Return a Markdown table of rows; links lead from a page in the folder `base`."""
    return _markdown(("fact", "published", "model", "agreement asked for", "result", "source"), (
        (row.name, row.published, simulated(row), row.tolerance, _result(row, base), row.source) for row in rows
    ))  # fmt: skip


def reasons_table(rows: Sequence[Row]) -> list[str]:
    """Return a Markdown table of the rows that do not count, with the reason of each."""
    return _markdown(("fact", "topic", "kind", "reason"), (
        (row.name, row.topic, row.kind, row.reason) for row in rows if row.kind != "judged"
    ))  # fmt: skip


def _markdown(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    cells = ([cell.replace("|", "\\|") for cell in row] for row in (heads, *rows))
    head, *lines = (f"| {' | '.join(row)} |" for row in cells)
    return [head, "|---" * len(heads) + "|", *lines]


def _result(row: Row, base: str) -> str:
    if row.kind == "context":
        return "context"
    if row.kind == "calibration":
        return f"calibration: {'agrees' if row.passed else 'fails'}"
    if row.passed:
        return "agrees"
    if not row.note:
        return "**fails**"
    return f"**fails**, [why]({posixpath.relpath(row.note, base)})"


def as_json(rows: Sequence[Row], shown: Sequence[Row] | None = None) -> str:
    """Return the rows as JSON, or of the judged ones only those `shown`; values that are not finite are null."""
    counted = judged(rows)
    return json.dumps(
        {
            "agree": sum(row.passed for row in counted),
            "fail": sum(not row.passed for row in counted),
            "unexpected": sum(row.unexpected for row in rows),
            "rows": [
                {key: None if isinstance(value, float) and not math.isfinite(value) else value
                 for key, value in asdict(row).items()}
                for row in (rows if shown is None else shown)
            ],
        },
        indent=2, allow_nan=False,
    )
