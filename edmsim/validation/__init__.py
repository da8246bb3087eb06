"""Validation: compare the plant with published facts, one row per fact."""

from collections.abc import Callable, Sequence
from importlib import import_module

from edmsim.errors import refuse_unknown
from edmsim.runs import Engine, perform
from edmsim.validation.rows import Check, Row

MODULES = (
    "ignition", "craters", "wire", "gas", "water", "corners", "taper", "pulse_ratios", "cuts", "debris", "lag",
    "breakage", "stable_rate", "quality", "passes", "spread",
)
"""Modules of this package that have ``CHECKS``; topics come in the order in which these first name them."""
SEEDS = tuple(range(1, 9))
"""Seeds of every check (ours: shorts come in bursts, and with half as many seeds intervals hide many effects)."""

Watch = Callable[[int, int], None]


def checks(modules: Sequence[str] = MODULES) -> list[Check]:
    """Return the checks of some of `MODULES`, by default of all."""
    for name in modules:
        refuse_unknown("module of checks", name, MODULES)
    return [check for name in modules for check in import_module(f".{name}", __name__).CHECKS]


def _rows(check: Check) -> list[Row]:
    return check(SEEDS)


def run(watch: Watch | None = None, modules: Sequence[str] = MODULES, engine: Engine | None = None) -> list[Row]:
    """Run checks in parallel, by default in threads, and return their rows in a fixed order.

    Rows depend only on the seeds. All checks together end sooner with `edmsim.runs.Processes`.
    """
    rows = [row for found in perform(_rows, checks(modules), watch, engine=engine) for row in found]
    topics = list(dict.fromkeys(row.topic for row in rows))
    return sorted(rows, key=lambda row: topics.index(row.topic))
