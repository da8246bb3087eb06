"""The set-up a log is compared at: that of its cut, as far as the log says, and what the user says."""

from __future__ import annotations

from typing import Unpack

from edmsim.calibration.log import Log
from edmsim.job.settings import CutOptions, CutSettings


def start_of(log: Log) -> CutSettings:
    """Return the settings of the cut that a log is of; for another machine's log the usual ones, at "fast"."""
    return CutSettings(resolution="fast") if log.settings is None else log.settings


def settings_for(log: Log, **given: Unpack[CutOptions]) -> tuple[CutSettings, list[str]]:
    """Return the settings to compare a log at, and what the user should know about them.

    Parameters
    ----------
    log : Log
    **given
        Options that the user gives; they hold even where the log says otherwise.

    Returns
    -------
    CutSettings
        The workpiece has one height, the greatest of the cut if none is given.
    list of str
        A line for every option given that the log contradicts, and one if the cut's workpiece changed its height.

    Raises
    ------
    InputError
        An option that cannot be used.
    """
    start = start_of(log)
    notices = []
    if start.workpiece.lowest_mm < start.workpiece.greatest_mm:
        height_mm = start.workpiece.greatest_mm
        if "height_mm" not in given:
            notices.append(f"the height changed in the cut of this log: {height_mm:g} mm is taken for all of it")
        start = start.model_copy(update={"height_mm": height_mm, "heights": (), "height_areas": ()})
    wanted = CutSettings.model_validate({**dict(start), **given})
    for name in given if log.settings is not None else ():
        logged, asked = getattr(start, name), getattr(wanted, name)
        if logged != asked:
            was = "its default" if logged is None else logged
            notices.append(f"{name} {asked} is used, though the log was cut with {was}")
    return wanted, notices
