"""All combinations of a sweep looked at before its first run: what no cut can be made with is refused in one line."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from edmsim.errors import CombinationError, EdmsimError, InputError
from edmsim.job.cut import planned, prepared
from edmsim.job.settings import CutSettings
from edmsim.machine.machine import Machine
from edmsim.machine.ranges import choose
from edmsim.program.path import CutPath
from edmsim.sweep.runs import checked, combinations
from edmsim.sweep.specification import Specification

MOST_REASONS = 3
"""Reasons that a refusal names (ours): it is one line."""


def check_runs(specification: Specification, checking: Callable[[int, int], None] | None = None) -> None:
    """Prepare every combination of settings as its cut would, without cutting.

    Points of a Sobol sample may be ones that no machine can be set to, as a long on-time with a short period: they
    become runs that failed, unless all of them are such points.

    Parameters
    ----------
    specification : Specification
    checking : callable, optional
        Called with the combinations looked at and to look at.

    Raises
    ------
    InputError
        Some cannot be run: which values, and why.
    """
    planner, is_cut = _Planner(), bool(specification.program)
    refused: dict[str, list[dict[str, Any]]] = {}
    seen: dict[str, set[str]] = {}
    values_wrong = False
    total = specification.runs // (len(specification.seeds) * max(specification.machine_samples, 1))
    for number, (task, given) in enumerate(combinations(specification)):
        if checking is not None:
            checking(number, total)
        combination = {"program" if is_cut else "environment": task, **given}
        for name, value in combination.items():
            seen.setdefault(name, set()).add(repr(value))
        try:
            settings = checked(task, given, is_cut)
            if is_cut:
                ready = prepared(task, CutSettings.model_validate(settings), planner)
                choose(ready.machine, specification.sample_only or ())
        except EdmsimError as error:
            values_wrong |= not isinstance(error, CombinationError)
            refused.setdefault(str(error), []).append(combination)
    wrong = sum(map(len, refused.values()))
    if not wrong or (specification.sobol is not None and not values_wrong and wrong < total):
        return
    varied = {name for name, values in seen.items() if len(values) > 1}
    if not varied:
        raise InputError(next(iter(refused)))
    told = [f"{_named(those, varied)}{reason}" for reason, those in refused.items()]
    more = f"; and {len(told) - MOST_REASONS} more" if len(told) > MOST_REASONS else ""
    raise InputError(
        f"{wrong} of {total} combinations cannot be run, so none was: {'; '.join(told[:MOST_REASONS])}{more}"
    )


def _named(those: list[dict[str, Any]], varied: set[str]) -> str:
    """Name the values that all of these have, of the settings that differ elsewhere."""
    first = those[0]
    common = [name for name in first if name in varied and all(other[name] == first[name] for other in those)]
    values = ", ".join(f"{name} {_said(first[name])}" for name in common)
    return f"with {values}: " if values else ""


def _said(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


class _Planner:
    """Plans paths, each once: most settings of a cut do not change its path."""

    _OPTIONS = "planner", "offset", "ignore", "layers", "unit", "offsets"

    def __init__(self) -> None:
        self._known: dict[tuple[Any, ...], CutPath | EdmsimError] = {}

    def __call__(self, program: str | Path, settings: CutSettings, machine: Machine) -> CutPath:
        options: Mapping[str, Any] = dict(settings)
        key = (str(program), machine.auto_offset_mm, machine.base.table.model_dump_json(),
               *(options[name] for name in self._OPTIONS))  # fmt: skip
        if key not in self._known:
            try:
                self._known[key] = planned(program, settings, machine)
            except EdmsimError as error:
                self._known[key] = error
        found = self._known[key]
        if isinstance(found, EdmsimError):
            raise found
        return found
