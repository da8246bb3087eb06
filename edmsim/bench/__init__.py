"""Speed of plant, controllers and environments: ``edmsim bench``."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from edmsim.errors import InputError
from edmsim.screen import ScreenTable

Measured = tuple[Mapping[str, Any], ScreenTable]
"""A measurement as numbers and texts only, and as a table for the terminal."""


def measured(
    watch: Callable[[str], None], against: str | None, pairs: int | None, profile: bool, serial: bool, training: bool,
    figure: Path | None,
) -> dict[str, Measured]:
    """Make the measurements of these options of ``edmsim bench``, or of the speed if there are none."""
    if against is None and pairs is not None:
        raise InputError("--pairs is for a comparison: give the revision with --against")
    found: dict[str, Measured] = {}
    if profile or figure is not None:
        from edmsim.bench import profile as profiling

        found["profile"] = profiling.measured(figure, watch)
    if against is not None:
        from edmsim.bench import pairs as pairing

        found["against"] = pairing.measured(against, pairs, watch)
    if serial:
        from edmsim.bench.serial import measure as measure_serial

        found["serial"] = _listed(measure_serial(watch), "edmsim gap --serial", lambda value: f"{value:.3g}")
    if training:
        from edmsim.bench.training import measure as measure_training

        found["training"] = _listed(
            measure_training(watch), "edmsim bench --training",
            lambda value: f"{value:,.0f}" if value > 1 else f"{value:.2f}",
        )  # fmt: skip
    if not found:
        from edmsim.bench.figures import measure

        found["speed"] = _listed(
            measure(), "edmsim bench", lambda value: f"{value:,.0f}" if value > 1000 else f"{value:,.2f}"
        )
    return found


def _listed(figures: Mapping[str, float], title: str, text: Callable[[float], str]) -> Measured:
    """Return the figures, and a table with a row for each."""
    table = ScreenTable("figure", numbers=("value",), title=title)
    for name, value in figures.items():
        table.add_row(name, text(value))
    return figures, table
