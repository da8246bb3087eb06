"""A check of your own drive against the rules for all drives."""

from __future__ import annotations

import ctypes
import pickle
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.axis_rows import AXIS, DRIVE, MOTOR
from edmsim.controllers.axis.drive import Drive
from edmsim.errors import InputError

_SAMPLES = 400
_OWN = (
    "command", "lines", "busy_ns", "delay_ns", "pwm_ns", "watchdog_ns", "count_rate_Hz", "index_ns", "n_sent",
    "sent", "reg", "real", "memory", "eeprom",
)
"""Fields that a sample may write."""


def check_drive(make: Callable[[], Drive]) -> None:
    """Check that a drive can be used in a plant, copied, and continued from a snapshot.

    The check runs its sample with an encoder that follows, encoders that run away, and random step edges.

    Parameters
    ----------
    make : callable
        Returns a new drive at each call, for example its class.

    Raises
    ------
    InputError
        Its record, motor or period is invalid; it does not pickle; a command is not finite or exceeds its supply; a
        sample writes to fields of others, or depends on something outside its record.

    Examples
    --------
    >>> from edmsim.controllers import axis
    >>> check_drive(lambda: axis.make("servo"))
    """
    drive = make()
    if not isinstance(drive, Drive):
        raise InputError(f"{drive!r} is not a drive: it lacks name, record, motor, sample or line")
    if drive.record.dtype != DRIVE or drive.record.shape != (1,):
        raise _wrong(drive, "has a record that is not one row of DRIVE")
    if not isinstance(drive.line(b""), bytes):
        raise _wrong(drive, "answers its serial line with something else than bytes")
    if (drive.sample is None) != (drive.motor is None):
        raise _wrong(drive, "needs both a sample and a motor, or neither")
    try:
        copied = pickle.loads(pickle.dumps(drive))
    except (TypeError, AttributeError, pickle.PicklingError) as error:
        raise _wrong(drive, f"does not pickle: {error}") from None
    if copied.record.tobytes() != drive.record.tobytes():
        raise _wrong(drive, "has another record after it was pickled")
    if drive.sample is not None:
        _check_loop(make)


def _check_loop(make: Callable[[], Drive]) -> None:
    drive = make()
    assert drive.motor is not None
    if drive.motor.dtype != MOTOR or drive.motor.shape != (1,):
        raise _wrong(drive, "has a motor that is not one row of MOTOR")
    num, den = int(drive.record["num"][0]), int(drive.record["den"][0])
    if den < 1 or num < 1000 * den:
        raise _wrong(drive, f"has a period of {num}/{den} ns; it must be 1 us or more")
    counts = getattr(drive, "counts_per_step", None)
    if counts is None or not abs(counts) < np.inf:
        raise _wrong(drive, f"asks for {counts} counts at a step (counts_per_step); that must be a finite number")
    for pace in (0, 1, 1000, -1000):
        whole = _run(make(), pace, 0, _SAMPLES)
        if _run(make(), pace, 0, _SAMPLES).tobytes() != whole.tobytes():
            raise _wrong(drive, "does not command the same again, when it is made again")
        first, second = make(), make()
        _run(first, pace, 0, _SAMPLES // 2)
        second.record[:] = first.record
        if _run(second, pace, _SAMPLES // 2, _SAMPLES).tobytes() != whole[_SAMPLES // 2 :].tobytes():
            raise _wrong(drive, "does not go on from its record as it would have without")


def _run(drive: Drive, pace: int, first: int, last: int) -> NDArray[np.float64]:
    """Return the commands of some samples; the count moves by `pace` a sample, for 0 with the setpoint."""
    assert drive.sample is not None
    call = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)(drive.sample.address)
    edges = np.cumsum(np.random.default_rng(1).integers(-1, 2, last))
    record, axis = drive.record, np.zeros(1, AXIS)
    commands = np.zeros(last)
    for k in range(first, last):
        record["index"], record["setpoint"] = k + 1, edges[k]
        record["due_ns"] = record["now_ns"] = (k + 1) * int(record["num"][0]) // int(record["den"][0])
        axis["time_ns"], axis["count"] = record["due_ns"], pace * k if pace else edges[max(k - 1, 0)]
        before, axis_before = record.copy(), axis.tobytes()
        call(record.ctypes.data, axis.ctypes.data)
        if axis.tobytes() != axis_before:
            raise _wrong(drive, "writes into its axis' row")
        if any(record[name].tobytes() != before[name].tobytes() for name in DRIVE.names or () if name not in _OWN):
            raise _wrong(drive, "writes what is the plant's in its record")
        commands[k] = record["command"][0]
        if not abs(commands[k]) <= 1.0:
            raise _wrong(drive, f"commands {commands[k]:g} of its supply; it must be -1 to 1")
    return commands[first:]


def _wrong(drive: Drive, what: str) -> InputError:
    return InputError(f"the {drive.name} drive {what}")
