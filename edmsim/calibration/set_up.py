"""The set-up for the comparison with a log: the log's settings, and the user's overrides."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from edmsim.calibration.log import Log
from edmsim.job.settings import CutSettings
from edmsim.machine.machine import Machine
from edmsim.machine.overrides import KINDS, with_overrides
from edmsim.machine.ranges import choose, uncertain, with_constants


def start_of(log: Log) -> CutSettings:
    """Return the settings of the cut that a log is of; for another machine's log the usual ones, at "fast"."""
    return CutSettings(resolution="fast") if log.settings is None else log.settings


def settings_for(log: Log, **options: Any) -> tuple[CutSettings, list[str]]:
    """Return the settings for comparing a log with the model, and notices for the user.

    Parameters
    ----------
    log : Log
    **options
        Options of a cut; they override the log's.

    Returns
    -------
    CutSettings
        The workpiece has one height, by default the greatest of the cut.
    list of str
        A line for every option that differs from the log's, one if the workpiece's height changed in the cut, and
        one for the log's constants that are not used because you name another machine, material or wire.

    Raises
    ------
    InputError
        If an option is invalid.
    """
    start = start_of(log)
    notices = []
    if start.workpiece.lowest_mm < start.workpiece.greatest_mm:
        height_mm = start.workpiece.greatest_mm
        if "height_mm" not in options:
            notices.append(f"the height changed in the cut of this log: {height_mm:g} mm is taken for all of it")
        start = start.model_copy(update={"height_mm": height_mm, "heights": (), "height_areas": ()})
    named = {"machine": options.get("machine"), "material": options.get("material"), "wire": options.get("wire")}
    others = {part for part, name in named.items() if name not in (None, getattr(start, part))}
    left_out = [name for name, _ in start.overrides if _part(name) in others]
    start_constants = {name: value for name, value in start.overrides if name not in left_out}
    if left_out and log.settings is not None:
        notices.append(f"the log was cut with another value of {', '.join(left_out)}: that of the file given is used")
    combined = CutSettings.model_validate({**dict(start), "constants": start_constants, **options})
    for name in options if log.settings is not None else ():
        logged, overridden = getattr(start, name), getattr(combined, name)
        if logged != overridden:
            was = "its default" if logged is None else logged
            notices.append(f"{name} {overridden} is used, though the log was cut with {was}")
    return combined, notices


def machine_of(settings: CutSettings) -> Machine:
    """Return the set-up for comparing a log; overridden constants have the ranges of their files."""
    # a cut takes them as known, so they have no range there; here they are where the search starts, or are held
    machine = settings.model_copy(update={"constants": ()}).load_machine()
    listed = dict(settings.overrides)
    checked = with_overrides(machine, listed.items())
    ranges = {name: constant.range for name, constant in uncertain(machine).items()}
    changed = {
        name: KINDS[name].model_construct(value=value, source="given to the cut of the log", range=ranges.get(name))
        for name, value in listed.items()
    }
    return with_constants(checked, changed)


def held(settings: CutSettings, machine: Machine, fitted: Iterable[str]) -> list[str]:
    """Return a line for every override of the log's cut that is not fitted, or is outside its range."""
    chosen = choose(machine, fitted)
    lines = []
    for name, value in settings.overrides:
        bounds = chosen[name].range if name in chosen else None
        if bounds is None:
            lines.append(f"{name} is held at {value:g}, as in the cut of the log")
        elif not bounds[0] <= value <= bounds[1]:
            within = f"its range {bounds[0]:g}..{bounds[1]:g}"
            lines.append(f"{name} was {value:g} in the cut of the log, outside {within}: what is fitted lies within")
    return lines


def _part(constant: str) -> str:
    """Return the option that names the file of a constant."""
    section = constant.partition(".")[0]
    return section if section in ("material", "wire") else "machine"
