"""The interface of a drive: a record, a motor, and a compiled sample."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from edmsim import models
from edmsim.compiled.axis_rows import DRIVE, MOTOR, SampleFunction
from edmsim.errors import InputError, one_of


class Screw(NamedTuple):
    """Data of a machine's axis for a drive: travel per motor step, and per radian of its motor."""

    step_um: float
    um_per_rad: float

    def counts_of(self, motor: NDArray[np.void]) -> float:
        """Return the encoder counts that a step is on the axis of a motor (a row of `MOTOR`) with this screw."""
        return self.step_um * float(motor["counts_per_rad"][0]) / self.um_per_rad


@runtime_checkable
class Drive(Protocol):
    """A drive of one axis.

    A plant copies its drives. The copy's ``record`` is a row in the plant's memory and part of its snapshot; it must
    hold all of the drive's state. The sample works on it, and you can read and write it between windows, as a serial
    line does.

    Attributes
    ----------
    name : str
        Its name for `edmsim.controllers.axis.make`.
    record : record array (1,)
        One row of `edmsim.compiled.axis_rows.DRIVE`: ``num / den`` is the sampling period in ns, 1 us or more; sample
        n falls on ``epoch_ns + n * num // den``; a period with a fraction of a ns does not drift.
    motor : record array (1,) or None
        One row of `edmsim.compiled.axis_rows.MOTOR`; None for a stepper.
    counts_per_step : float
        Encoder counts per step edge. A cut refuses a drive whose steps differ from the machine's; a bench ignores
        the value. 0 if the drive ignores step edges; unused for a stepper.
    makes_ramps : bool, optional
        Whether it makes ramps itself; it then receives all steps of a rapid at once.
    why_stopped : callable, optional
        Returns in a few words why it reports a fault or does not follow, if it knows; empty if only its fault input
        is low.
    """

    name: str
    record: NDArray[np.void]
    motor: NDArray[np.void] | None

    @property
    def sample(self) -> SampleFunction | None:
        """Function of each sampling instant, made by `edmsim.compiled.axis_rows.sample`; None for a stepper.

        A property or a class attribute, as the object must pickle. The function reads the axis' row and writes
        ``command``, ``lines``, ``reg`` and ``real`` of its own record.
        """

    def line(self, text: bytes) -> bytes:
        """Receive text over the drive's serial line and return the answer; empty if it has no line."""


@runtime_checkable
class StartsAnew(Drive, Protocol):
    """A drive that restarts when its logic is switched on, with the state in its memory."""

    def power_up(self) -> bytes:
        """Start as after the release of the reset pin; returns what it sends over its serial line, if it has one."""


@runtime_checkable
class SerialDrive(StartsAnew, Protocol):
    """A chip with a memory that outlasts the power and a serial line: 8 data bits, no parity, 1 stop bit."""

    baud: float  # bits per second

    def receive_error(self) -> None:
        """Take note that a byte came without a stop bit, or before the last one was read."""


_OWN = (
    "command", "lines", "num", "den", "busy_ns", "delay_ns", "pwm_ns", "watchdog_ns", "stalled_until_ns",
    "count_rate_Hz", "index_ns", "reg", "real", "memory",
)
"""A record's fields that the drive owns and loses with the power."""


def restart(record: NDArray[np.void], fresh: NDArray[np.void]) -> None:
    """Give a drive's record what a new one has: all that is its own but the EEPROM, its clock starting now."""
    for name in _OWN:
        record[name] = fresh[name]
    set_period(record, int(fresh["num"][0]), int(fresh["den"][0]))


def set_period(record: NDArray[np.void], num: int, den: int) -> None:
    """Let a drive sample with another period, ``num / den`` ns, from its last sample or power-up on."""
    record["epoch_ns"], record["index"] = record["now_ns"], 1
    record["num"], record["den"] = num, den
    record["due_ns"] = record["now_ns"] + num // den


def new_record(period_ns: tuple[int, int] = (1, 1)) -> NDArray[np.void]:
    """Return a record of zeros; its sampling period is a fraction, in ns."""
    record = np.zeros(1, DRIVE)
    record["num"], record["den"] = period_ns
    return record


def data_of(name: str) -> dict[str, Any]:
    """Return the tables of ``models/drives/NAME.toml``."""
    return tomllib.loads(models.path(f"drives/{name}.toml").read_text(encoding="utf-8"))


def motor_row(values: Mapping[str, float], **changes: float) -> NDArray[np.void]:
    """Return a motor's row from its constants by name, all of `MOTOR`, with changes.

    Raises
    ------
    InputError
        A change has a name that `MOTOR` does not have, or a constant is missing.
    """
    names = MOTOR.names or ()
    merged = {**values, **changes}
    wrong = sorted(set(names) ^ merged.keys())
    if wrong:
        raise InputError(f"a motor's constants are {', '.join(names)}; missing or none of them: {', '.join(wrong)}")
    row = np.zeros(1, MOTOR)
    for name in names:
        row[name] = merged[name]
    return row


def axis_names() -> tuple[str, ...]:
    """Names of the axes of `axis_row`."""
    folder = models.path("drives/board.toml").parent
    return tuple(sorted(file.stem.removeprefix("axis-") for file in folder.glob("axis-*.toml")))


def axis_row(name: str = "table", **changes: float) -> NDArray[np.void]:
    """Return motor, supply, encoder and screw of ``models/drives/axis-NAME.toml``, but for constants that differ.

    What that file does not name is as in ``plain.toml``: no velocity amplifier and no home cam.
    """
    if name not in axis_names():
        raise InputError(f"there is no axis {name!r}; choose one of {one_of(name, axis_names())}")
    tables = (*data_of("plain").values(), *data_of(f"axis-{name}").values())
    parts = [part for part in tables if isinstance(part, dict)]
    return motor_row({key: value for part in parts for key, value in part.items()}, **changes)
