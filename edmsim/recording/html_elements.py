"""The deviation table of ``report.html``: the error line by line and arc by arc of the program."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

_COLUMNS = (
    "contour", "line", "element", "from X, mm", "Y, mm", "to X, mm", "Y, mm", "length, mm", "mean, µm", "least, µm",
    "greatest, µm",
)
_MOST = 200
"""Rows shown (ours): a drawing of that many has its worst ones named."""


def elements_table(elements: Sequence[Mapping[str, Any]]) -> str:
    """Return the table of the report's elements; of very many those with the largest error, in order."""
    shown, more = list(elements), ""
    if len(shown) > _MOST:
        shown.sort(key=lambda row: -max(abs(row["low_um"] or 0.0), abs(row["high_um"] or 0.0)))
        shown = sorted(shown[:_MOST], key=lambda row: (row["contour"], row["element"]))
        more = f" The {_MOST} of {len(elements)} with the largest error are shown; report.json has all."
    head = "".join(f"<th>{name}</th>" for name in _COLUMNS)
    rows = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in _cells(row))}</tr>" for row in shown)
    told = f"<p>Profile error of each line and arc, without what is out of the round wire's reach.{more}</p>"
    return f'{told}<div style="overflow-x: auto"><table><tr>{head}</tr>{rows}</table></div>'


def _cells(row: Mapping[str, Any]) -> list[str]:
    kind = row["kind"] if row["radius_mm"] is None else f"{row['kind']} R {row['radius_mm']:.3f}"
    # 0.0 +: a hair below zero would read -0.000
    places = [f"{round(row[f'program_{name}_mm'], 6) + 0.0:.3f}" for name in ("x", "y", "end_x", "end_y")]
    errors = ["–" if row[name] is None else f"{row[name]:+.1f}" for name in ("mean_um", "low_um", "high_um")]
    line = "–" if row["line"] is None else str(row["line"])
    cells = [str(row["contour"]), line, kind, *places, f"{row['length_mm']:.3f}", *errors]
    return [f"−{cell[1:]}" if cell.startswith("-") else cell for cell in cells]
