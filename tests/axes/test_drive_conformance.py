"""Every drive by name passes `check_drive`, which refuses what a plant could not work with."""

from functools import partial

import numpy as np
import pytest

from edmsim.compiled.axis_rows import carray, sample
from edmsim.controllers import axis as axes
from edmsim.controllers.axis.drive import PositionServo
from edmsim.errors import InputError


@sample
def _too_much(drive_at, axis_at):
    carray(drive_at, 1)[0].command = 1.5


@sample
def _moves_its_axis(drive_at, axis_at):
    carray(axis_at, 1)[0].place_um = 0.5


@sample
def _skips_time(drive_at, axis_at):
    carray(drive_at, 1)[0].due_ns += 1


@sample
def _no_number(drive_at, axis_at):
    carray(drive_at, 1)[0].command = np.nan


@pytest.mark.slow
@pytest.mark.parametrize("name", axes.names())
def test_drives_conform(name):
    axes.check_drive(lambda: axes.make(name))


@pytest.mark.parametrize(("own", "reason"), [
    ({"sample": _too_much}, "commands 1.5 of its supply"),
    ({"sample": _moves_its_axis}, "writes into its axis' row"),
    ({"sample": _skips_time}, "that belong to the plant"), ({"sample": _no_number}, "commands nan"),
    *(({"counts_per_step": counts}, f"asks for {counts} counts at a step") for counts in (np.nan, np.inf, None)),
])  # fmt: skip
def test_a_drive_that_oversteps_is_refused(own, reason):
    kind = type("Own", (PositionServo,), own)
    globals()["Own"] = kind
    kind.__module__ = __name__
    with pytest.raises(InputError, match=reason):
        axes.check_drive(kind)


def test_state_outside_the_record_is_refused():
    made = []

    def make():
        made.append(PositionServo())
        made[-1].record["reg"][0, 1] += len(made)
        return made[-1]

    with pytest.raises(InputError, match="gives other commands when it is made again"):
        axes.check_drive(make)


def test_what_cannot_be_used_is_refused():
    with pytest.raises(InputError, match="is not a drive"):
        axes.check_drive(object)
    with pytest.raises(InputError, match="period of 1/1 ns"):
        axes.check_drive(lambda: _with_period(1, 1))
    for field, value, said in (
        ("record", {}, "not one row of DRIVE"), ("motor", "table", "not one row of MOTOR"),
        ("sample", len, "without the decorator"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=said):
            axes.check_drive(partial(_with, field, value))
    with pytest.raises(InputError, match="there is no drive 'uhu2'"):
        axes.make("uhu2")


def _with(field, value):
    drive = PositionServo()
    setattr(drive, field, value)
    return drive


def _with_period(num, den):
    drive = PositionServo()
    drive.record["num"], drive.record["den"] = num, den
    return drive
