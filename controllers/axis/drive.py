"""The interface of a drive: a record, a motor, and a compiled sample; and a check of your own drive."""

import ctypes
import pickle
import tomllib
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from edmsim import models
from edmsim.compiled.axis_rows import AXIS, DRIVE, FAULT, MOTOR, SampleFunction, carray, is_row, sample
from edmsim.errors import InputError, one_of


class Screw(NamedTuple):
    """Data of a machine's axis for a drive: travel per motor step, and per radian of its motor."""

    step_um: float
    um_per_rad: float

    def counts_of(self, motor: NDArray[np.void]) -> float:
        """Return the encoder counts per step of a motor (a row of `MOTOR`) on this screw."""
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
        return b""


@runtime_checkable
class PowersUp(Drive, Protocol):
    """A drive that restarts when its logic is switched on, with the state in its memory."""

    def power_up(self) -> bytes:
        """Start as after the release of the reset pin; returns what it sends over its serial line, if it has one."""


@runtime_checkable
class SerialDrive(PowersUp, Protocol):
    """A chip with non-volatile memory and a serial line: 8 data bits, no parity, 1 stop bit."""

    baud: float  # bits per second

    def receive_error(self) -> None:
        """Register that a byte came without a stop bit, or before the previous byte was read."""


_OWN = (
    "command", "lines", "num", "den", "busy_ns", "delay_ns", "pwm_ns", "watchdog_ns", "stalled_until_ns",
    "count_rate_Hz", "index_ns", "reg", "real", "memory",
)
"""Fields of a record that the drive owns and that are lost without power."""


def restart(record: NDArray[np.void], fresh: NDArray[np.void]) -> None:
    """Reset a drive's own fields, except the EEPROM, to those of a new record, and restart its sampling."""
    for name in _OWN:
        record[name] = fresh[name]
    set_period(record, int(fresh["num"][0]), int(fresh["den"][0]))


def set_period(record: NDArray[np.void], num: int, den: int) -> None:
    """Set a drive's sampling period to ``num / den`` ns, from its last sample or power-up on."""
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
        raise InputError(f"a motor's constants are {', '.join(names)}; missing or unknown: {', '.join(wrong)}")
    row = np.zeros(1, MOTOR)
    for name in names:
        row[name] = merged[name]
    return row


def axis_names(amplifier: bool | None = None) -> tuple[str, ...]:
    """Return the names of the axes of `axis_row`: all, or those with or without a velocity amplifier."""
    folder = models.path("drives/board.toml").parent
    names = sorted(file.stem.removeprefix("axis-") for file in folder.glob("axis-*.toml"))
    return tuple(n for n in names if amplifier is None or amplifier == ("amplifier" in data_of(f"axis-{n}")))


def axis_row(name: str = "table", **changes: float) -> NDArray[np.void]:
    """Return motor, supply, encoder and screw of ``models/drives/axis-NAME.toml``, with changed constants.

    Constants that the file does not have are those of ``plain.toml``: no velocity amplifier and no home cam.
    """
    if name not in axis_names():
        raise InputError(f"there is no axis {name!r}; choose one of {one_of(name, axis_names())}")
    tables = (*data_of("plain").values(), *data_of(f"axis-{name}").values())
    parts = [part for part in tables if isinstance(part, dict)]
    return motor_row({key: value for part in parts for key, value in part.items()}, **changes)


# The stepper: a step edge turns the motor's field by one step, without feedback from the rotor.


class Stepper(Drive):
    """A stepping motor without a loop, the default drive of an axis.

    Its step length, torque, friction and backlash come from the machine (``table`` in its TOML file, and the MJCF).
    """

    name = "stepper"
    sample = None
    counts_per_step = 0.0

    def __init__(self) -> None:
        self.record: NDArray[np.void] = new_record()
        self.motor: NDArray[np.void] | None = None


# A check of your own drive against the rules for all drives.

_SAMPLES = 400
_WRITTEN = (
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
    if not callable(make):
        raise InputError(f"make is {make!r}: give what returns a new drive, for example its class")
    drive = make()
    if not isinstance(drive, Drive):
        raise InputError(f"{drive!r} is not a drive: it lacks name, record, motor, sample or line")
    if not is_row(drive.record, DRIVE):
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
    if not is_row(drive.motor, MOTOR):
        raise _wrong(drive, "has a motor that is not one row of MOTOR")
    if not hasattr(drive.sample, "address"):
        raise _wrong(drive, "has a sample without the decorator edmsim.compiled.axis_rows.sample")
    num, den = int(drive.record["num"][0]), int(drive.record["den"][0])
    if den < 1 or num < 1000 * den:
        raise _wrong(drive, f"has a period of {num}/{den} ns; it must be 1 us or more")
    counts = getattr(drive, "counts_per_step", None)
    if counts is None or not abs(counts) < np.inf:
        raise _wrong(drive, f"asks for {counts} counts at a step (counts_per_step); that must be a finite number")
    for pace in (0, 1, 1000, -1000):
        whole = _run(make(), pace, 0, _SAMPLES)
        if _run(make(), pace, 0, _SAMPLES).tobytes() != whole.tobytes():
            raise _wrong(drive, "gives other commands when it is made again")
        first, second = make(), make()
        _run(first, pace, 0, _SAMPLES // 2)
        second.record[:] = first.record
        if _run(second, pace, _SAMPLES // 2, _SAMPLES).tobytes() != whole[_SAMPLES // 2 :].tobytes():
            raise _wrong(drive, "does not continue the same way from a copy of its record")


def _run(drive: Drive, pace: int, first: int, last: int) -> NDArray[np.float64]:
    """Return the commands of some samples; the count moves by `pace` per sample or, for 0, follows the setpoint."""
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
        if any(record[name].tobytes() != before[name].tobytes() for name in set(DRIVE.names or ()) - set(_WRITTEN)):
            raise _wrong(drive, "writes fields of its record that belong to the plant")
        commands[k] = record["command"][0]
        if not abs(commands[k]) <= 1.0:
            raise _wrong(drive, f"commands {commands[k]:g} of its supply; it must be -1 to 1")
    return commands[first:]


def _wrong(drive: Drive, what: str) -> InputError:
    return InputError(f"the {drive.name} drive {what}")


# The reference servo: a direct-current motor with an encoder, and a proportional-derivative loop in whole numbers.
#
# Use it as a template for your own drive. Its constants are in ``models/drives/servo.toml``.

COUNTS_PER_EDGE, KP, KD, LAST_ERROR, LARGEST_ERROR = range(5)  # registers


@sample
def _servo(drive_at: Any, axis_at: Any) -> None:
    drive, axis = carray(drive_at, 1)[0], carray(axis_at, 1)[0]
    error = drive.setpoint * drive.reg[COUNTS_PER_EDGE] - axis.count
    duty = drive.reg[KP] * error + drive.reg[KD] * (error - drive.reg[LAST_ERROR])
    drive.reg[LAST_ERROR] = error
    if abs(error) > drive.reg[LARGEST_ERROR]:
        drive.lines |= FAULT
    if drive.lines & FAULT:
        duty = 0
    drive.command = min(max(duty, -32768), 32768) / 32768.0


class PositionServo(Drive):
    """A position servo for step edges, without a serial dialogue.

    If the following error exceeds ``largest_error`` counts, the drive reports a fault and switches the motor's
    voltage off until the plant is reset.
    """

    name = "servo"
    sample: SampleFunction = _servo

    def __init__(self) -> None:
        data = data_of(self.name)
        loop = data["loop"]
        self.record: NDArray[np.void] = new_record(tuple(loop["period_ns"]))
        self.record["reg"][0, : LARGEST_ERROR + 1] = (
            loop["counts_per_edge"], loop["kp"], loop["kd"], 0, loop["largest_error"],
        )
        self.motor: NDArray[np.void] | None = axis_row("table", **data["motor"])

    @property
    def counts_per_step(self) -> float:
        """Encoder counts of a step edge."""
        return float(self.record["reg"][0, COUNTS_PER_EDGE])

    def why_stopped(self) -> str:
        """Return why the drive reports a fault; empty without a fault."""
        if not self.record["lines"][0] & FAULT:
            return ""
        return f"its following error passed the limit of {self.record['reg'][0, LARGEST_ERROR]} counts"
