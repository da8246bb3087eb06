"""What was measured of a machine's table, for the terminal, for JSON and for the head of a compensation file."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import RenderableType

    from edmsim.measure.table import TableMeasurement

_NAMES = {
    "accuracy": "accuracy A", "systematic": "systematic deviation E", "mean_range": "range of means M",
    "reversal": "greatest reversal value B", "mean_reversal": "mean reversal value",
    "repeatability": "repeatability R",
    "repeatability_up": "repeatability from below", "repeatability_down": "repeatability from above",
}  # fmt: skip
_OF_CIRCLE = {
    "circular_deviation": "circular deviation G", "circular_deviation_clockwise": "circular deviation G, clockwise",
    "hysteresis": "hysteresis H", "radial_high": "radial deviation F, greatest",
    "radial_low": "radial deviation F, least",
}  # fmt: skip


def headline(found: TableMeasurement) -> list[str]:
    """Return the most telling figures as sentences."""
    lines = [
        f"Accuracy (ISO 230-2) of {axis}: {found.along[axis, axis].figures()['accuracy']:.1f} um."
        for axis in ("x", "y")
    ]
    return [*lines, f"Out of square by {found.squareness_um_m:.0f} um/m."]


def as_json(found: TableMeasurement) -> str:
    """Return all figures in um as JSON."""
    figures = {axis: found.along[axis, axis].figures() for axis in ("x", "y")}
    return json.dumps(
        {**figures, "squareness_um_m": found.squareness_um_m, "circle": found.circle.figures()}, indent=2
    )


def render(found: TableMeasurement) -> RenderableType:
    """Return all figures as a table for the terminal."""
    from edmsim.screen import ScreenTable

    table = ScreenTable(
        "ISO 230-2, um", numbers=("x", "y"), title=f"{len(found.along['x', 'x'].targets_mm)} targets an axis"
    )
    x, y = (found.along[axis, axis].figures() for axis in ("x", "y"))
    for name, words in _NAMES.items():
        table.add_row(words, f"{x[name]:.2f}", f"{y[name]:.2f}")
    table.add_section()
    table.add_row("out of square, um/m", f"{found.squareness_um_m:.1f}", "")
    table.add_section()
    circle = found.circle.figures()
    for name, words in _OF_CIRCLE.items():
        table.add_row(f"{words} (ISO 230-4)", f"{circle[name]:.2f}", "")
    return table
