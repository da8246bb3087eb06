"""Validation: compare the plant with published facts, one row per fact."""

from collections.abc import Callable, Sequence
from dataclasses import asdict
from importlib import import_module
from pathlib import Path

import edmsim
from edmsim import controllers, models
from edmsim.errors import refuse_unknown
from edmsim.runs import Engine, RunTable, digest, identity, perform
from edmsim.validation.rows import Check, Checks, Row

MODULES = ("discharges", "closed_forms", "cuts", "lag", "breakage", "stable_rate", "passes", "spread")
"""Modules of this package with ``CHECKS``."""
TOPICS = (
    "ignition", "crater", "wire", "gas", "film", "dielectric", "corner", "taper", "pulse ratios", "debris", "shorts",
    "removal", "kerf", "lag", "vibration", "trim cuts", "rupture", "stable rate", "roughness", "passes", "ranges",
    "resolution",
)
"""Topics in the order in which their rows are shown."""
SEEDS = tuple(range(1, 9))
"""Seeds of every check (ours: shorts come in bursts, and half as many seeds would hide many effects)."""
CHECK_TEXTS = "id", "check"
"""Text columns of a table of finished checks."""

Watch = Callable[[int, int], None]


def checks(modules: Sequence[str] = MODULES, topics: Sequence[str] | None = None) -> list[Check]:
    """Return the checks of some of `MODULES`, by default of all; with `topics`, only those with such rows."""
    for name in modules:
        refuse_unknown("module of checks", name, MODULES)
    tables: list[Checks] = [import_module(f".{name}", __name__).CHECKS for name in modules]
    found = {check: of_check for table in tables for check, of_check in table.items()}
    for name in topics or ():
        refuse_unknown("topic", name, TOPICS)
    return [check for check, of_check in found.items() if topics is None or not set(topics).isdisjoint(of_check)]


def _rows(check: Check) -> dict[str, object]:
    return {"check": _name(check), "rows": [asdict(row) for row in check(SEEDS)]}


def _name(check: Check) -> str:
    return f"{check.__module__}:{check.__qualname__}"


def _ids(found: Sequence[Check]) -> list[str]:
    """Return a digest of checks: their names, the seeds, and all code and data of the package."""
    folders = [Path(package.__path__[0]) for package in (edmsim, controllers, models)]
    files = [file for folder in folders for file in sorted(folder.rglob("*.*")) if file.suffix != ".pyc"]
    made_with = {"files": [digest(str(file)) for file in files], "seeds": SEEDS}
    return [identity({**made_with, "check": _name(check)}) for check in found]


def run(
    watch: Watch | None = None, modules: Sequence[str] = MODULES, engine: Engine | None = None, *,
    topics: Sequence[str] | None = None, table: RunTable | None = None,
) -> list[Row]:
    """Run checks in parallel, by default in threads, and return their rows in a fixed order.

    Rows depend only on the seeds. All checks together end sooner with `edmsim.runs.Processes`.

    Parameters
    ----------
    watch : callable, optional
        Called with the checks done and to do.
    modules : sequence of str
        Modules of checks.
    engine : edmsim.runs.Engine, optional
    topics : sequence of str, optional
        Topics of the rows, by default all. Only checks that have such rows are run.
    table : edmsim.runs.RunTable, optional
        Finished checks, which are not run again unless code or data of the package has changed.

    Raises
    ------
    InputError
        If a module or topic is unknown.
    """
    found = checks(modules, topics)
    ids = [] if table is None else _ids(found)
    made = perform(_rows, found, watch, engine=engine, table=table, ids=ids)
    rows = [Row(**row) for of_check in made for row in of_check["rows"]]
    rows.sort(key=lambda row: TOPICS.index(row.topic))
    return [row for row in rows if topics is None or row.topic in topics]
