"""What a drive of an axis is: a record, a motor, and a compiled sample."""

from __future__ import annotations

import tomllib
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from edmsim import models
from edmsim.compiled.axis_rows import DRIVE, MOTOR, SampleFunction


@runtime_checkable
class Drive(Protocol):
    """A drive of one axis.

    A plant copies the drives it is given; the copy's ``record`` is its row in the plant's memory, which the sample
    works on and which is part of the plant's snapshot. Whatever a drive remembers stands there. Between windows it
    may be read and written, as by a serial line.

    Attributes
    ----------
    name : str
        By which `edmsim.controllers.axis.make` knows it.
    record : record array (1,)
        One row of `edmsim.compiled.axis_rows.DRIVE`: ``num / den`` is the sampling period in ns, 1 us or more; sample
        n falls on ``epoch_ns + n * num // den``, so that a period of no whole number of ns never drifts.
    motor : record array (1,) or None
        One row of `edmsim.compiled.axis_rows.MOTOR`; None for a stepper.
    """

    name: str
    record: NDArray[np.void]
    motor: NDArray[np.void] | None

    @property
    def sample(self) -> SampleFunction | None:
        """What happens at every sampling instant, made by `edmsim.compiled.axis_rows.sample`; None for a stepper.

        A property, or an attribute of the class: the object itself must pickle. The function reads the axis' row and
        writes ``command``, ``lines``, ``reg`` and ``real`` of its own.
        """
        ...

    def line(self, text: bytes) -> bytes:
        """Take what was sent over the drive's serial line, and return its answer; empty if it has no line."""
        ...


def new_record(period_ns: tuple[int, int] = (1, 1)) -> NDArray[np.void]:
    """Return a record of nought with a sampling period in ns, as a fraction."""
    record = np.zeros(1, DRIVE)
    record["num"], record["den"] = period_ns
    return record


def data_of(name: str) -> dict[str, Any]:
    """Return the tables of ``models/drives/NAME.toml``."""
    return tomllib.loads(models.path(f"drives/{name}.toml").read_text(encoding="utf-8"))


def motor_row(values: dict[str, float]) -> NDArray[np.void]:
    """Return a motor's row of its constants by name, all of `MOTOR`."""
    row = np.zeros(1, MOTOR)
    for name in MOTOR.names or ():
        row[name] = values[name]
    return row
