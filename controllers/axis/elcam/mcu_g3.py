"""The control MCU-G3: axes with setpoint, actual position and auxiliary encoder, travel commands, and ELCAM.

Commands have PLCopen's names (`move_absolute`, `halt`, `cam_in`, `cam_out`, `in_sync`); ``docs/cam-tables.md`` lists
the document's. Ramps have constant acceleration, as the document does not define them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.axis_rows import SampleFunction, carray, sample
from edmsim.controllers.axis.drive import Drive, axis_row, new_record
from edmsim.controllers.axis.elcam.module import Elcam
from edmsim.controllers.axis.elcam.table import DATA, Function, Mode
from edmsim.errors import InputError, methods_refuse_wrong_types
from edmsim.numeric import finite

CYCLE_S = DATA["axis"]["cycle_ns"] * 1e-9  # interpolator's cycle


@dataclass
class ControlAxis:
    """An axis of the control; positions are in its unit, mostly mm."""

    counts_per_unit: float  # encoder counts, or a stepper's steps, in one unit
    stepper: bool = False  # whether it is open-loop: the control sends steps to the motor
    # "Use encoder for position feedback" of the system data: a stepper's encoder is its auxiliary register
    use_encoder: bool = False
    auxiliary_factor: float = 1.0  # counts of that encoder in one unit (gfaux); it may change at any time
    accel: float = DATA["axis"]["accel"]  # acceleration in units per s2
    # extension: rate of compensation after switching, in units per s; 0 applies it at once
    compensation_rate: float = 0.0
    setpoint: float = 0.0
    velocity: float = 0.0
    count: int = 0
    auxiliary_count: int = 0
    compensation: float = 0.0
    target: float | None = field(default=None, repr=False)
    speed: float = field(default=0.0, repr=False)

    @property
    def actual(self) -> float:
        """Displayed position: the count (of its steps, for a stepper) minus the compensation."""
        return self.count / self.counts_per_unit - self.compensation

    @property
    def auxiliary(self) -> float | None:
        """A stepper's position by its own encoder; None if that is not used."""
        return self.auxiliary_count / self.auxiliary_factor if self.stepper and self.use_encoder else None

    def travel(self, dt: float) -> None:
        """Advance speed and setpoint by a cycle, towards a target or at the commanded speed."""
        demand, change = self.speed, self.accel * dt
        if self.target is not None:
            rest = self.target - self.setpoint
            brakes = math.sqrt(0.25 * change * change + 2.0 * self.accel * abs(rest)) - 0.5 * change  # whole cycles
            demand = math.copysign(min(self.speed, brakes), rest)
            last = 1.01 * change  # speed of the last cycle, with a share for rounding, so that no axis turns back
            if abs(rest) <= last * dt and abs(self.velocity) <= 2.0 * last:
                self.setpoint, self.velocity, self.speed, self.target = self.target, 0.0, 0.0, None
                return
        self.velocity += min(max(demand - self.velocity, -change), change)
        self.setpoint += self.velocity * dt


@methods_refuse_wrong_types
class MotionControl:
    """Axes under one control.

    Parameters
    ----------
    axes : sequence of ControlAxis
    **options
        Those of `Elcam`.

    Attributes
    ----------
    elcam : Elcam
    """

    def __init__(self, axes: Sequence[ControlAxis], **options: Any) -> None:
        self.axes = list(axes)
        self.elcam = Elcam(self.axes, **options)
        self._followers: set[int] = set()
        self._ramps: dict[int, tuple[float, float, float]] = {}  # initial offset, elapsed time, duration

    def move_absolute(self, axis: int, target: float, speed: float) -> bool:
        """Move an axis to a position; False if it follows a cam table and so refuses travel commands."""
        if axis in self._release():
            return False
        moved = self._axis(axis)
        moved.target, moved.speed = finite("target", target), abs(finite("speed", speed))
        return True

    def move_velocity(self, axis: int, speed: float) -> bool:
        """Move an axis at a speed until the next command; False if it follows a cam table."""
        if axis in self._release():
            return False
        moved = self._axis(axis)
        moved.target, moved.speed = None, finite("speed", speed)
        return True

    def halt(self, axis: int) -> bool:
        """Stop an axis on its ramp (the control's js); False if it follows a cam table."""
        return self.move_velocity(axis, 0.0)

    def cam_in(self, table: int, ramp_s: float = 0.0) -> bool:
        """Start to follow a table.

        Parameters
        ----------
        table : int
            Number of a table that is ready to run.
        ramp_s : float
            Extension: time in which the follower moves to its position in the table, without a jump.

        Returns
        -------
        bool
            Whether it follows; if not, see the register ERROR.
        """
        at = self.elcam.at(table)
        if at.write_int(Function.MODE, int(at.read_int(Function.MODE).value) | Mode.RUN):
            return False
        axis = self.elcam.tables[table].axis
        self._ramps.pop(axis, None)  # of a ramp that was not completed
        if ramp_s > 0.0 and axis in (places := self.elcam.follow()):
            self._ramps[axis] = self.axes[axis].setpoint - places[axis], 0.0, ramp_s
        return True

    def cam_out(self, table: int) -> None:
        """Stop following a table; a moving follower continues at its speed until the next command."""
        at = self.elcam.at(table)
        at.write_int(Function.MODE, int(at.read_int(Function.MODE).value) & ~Mode.RUN)

    def in_sync(self, table: int) -> bool:
        """Return whether the follower is at its position in the table."""
        found = self.elcam.tables.get(table)
        return found is not None and found.runs and found.axis not in self._ramps

    def resource(self, number: int, axis: int) -> float:
        """Return a resource of an axis: 73, its compensation, the sum of all active tables.

        Raises
        ------
        InputError
            This firmware does not have the resource.
        """
        if number != DATA["elcam"]["compensation_resource"] or not self.elcam.has("resource"):
            first = DATA["since"]["resource"]
            raise InputError(f"this control has no resource {number}; there is 73, with firmware from {first} on")
        return self._axis(axis).compensation

    def turn(self, counts: Sequence[int], auxiliary_counts: Sequence[int] | None = None) -> None:
        """Run one cycle.

        Parameters
        ----------
        counts : sequence of int
            Each axis' encoder count, or the steps sent to a stepper.
        auxiliary_counts : sequence of int, optional
            Counts of steppers' own encoders.
        """
        for k, axis in enumerate(self.axes):
            axis.count = counts[k]
            axis.auxiliary_count = auxiliary_counts[k] if auxiliary_counts is not None else 0
        cams = self._release()
        for k, axis in enumerate(self.axes):
            if k not in cams:
                axis.travel(CYCLE_S)
        followed = self.elcam.follow()
        for k, place in followed.items():
            self._place(k, place)
        self._followers = set(followed)
        for k, axis in enumerate(self.axes):
            demand = self.elcam.compensation(k) - axis.compensation
            most = axis.compensation_rate * CYCLE_S or math.inf
            axis.compensation += min(max(demand, -most), most)

    def _axis(self, number: int) -> ControlAxis:
        if not 0 <= number < len(self.axes):
            raise InputError(f"there is no axis {number}: this control has 0 to {len(self.axes) - 1}")
        return self.axes[number]

    def _release(self) -> set[int]:
        """Let axes that have stopped following continue at their speed; return the axes that follow."""
        cams = {table.axis for table in self.elcam.tables.values() if table.leads}
        for k in self._followers - cams:
            self.axes[k].target, self.axes[k].speed = None, self.axes[k].velocity
            self._ramps.pop(k, None)
        self._followers &= cams
        return cams

    def _place(self, k: int, place: float) -> None:
        """Set a follower's setpoint to its position in the table, or on the ramp to it."""
        axis = self.axes[k]
        if k in self._ramps:
            offset, passed_s, ramp_s = self._ramps[k]
            passed_s += CYCLE_S
            share = min(passed_s / ramp_s, 1.0)
            place += offset * (1.0 - share * share * (3.0 - 2.0 * share))  # no jump in speed at either end
            if passed_s >= ramp_s:
                del self._ramps[k]
            else:
                self._ramps[k] = offset, passed_s, ramp_s
        axis.velocity = (place - axis.setpoint) / CYCLE_S
        axis.setpoint, axis.target = place, None


TARGET, COMPENSATION, FEED_FORWARD, PROPORTIONAL, PER_SAMPLE, STILL, SUM = range(7)
"""Indices of a record's ``real``: target and compensation in counts, the feed-forward of speed, gains, the error up
to which the integrator is unchanged, the integrator as a share of the supply."""


@sample
def _hold(drive_at: Any, axis_at: Any) -> None:
    drive, axis = carray(drive_at, 1)[0], carray(axis_at, 1)[0]
    real = drive.real
    actual = axis.count - real[COMPENSATION]
    error = real[TARGET] - actual
    demand = real[FEED_FORWARD] + real[PROPORTIONAL] * error + real[SUM]
    drive.command = min(max(demand, -1.0), 1.0)
    if abs(error) > real[STILL] and abs(demand) < 1.0:
        real[SUM] += real[PROPORTIONAL] * real[PER_SAMPLE] * error


class AxisLoop(Drive):
    """A motor in a control's position loop, for a servo axis of `mcu_g3.MotionControl`."""

    name = "mcu-g3"
    counts_per_step = 0.0  # its control writes the target
    sample: SampleFunction = _hold

    def __init__(self, motor: NDArray[np.void] | None = None) -> None:
        data = DATA["axis"]
        self.record: NDArray[np.void] = new_record((data["cycle_ns"], 1))
        real = self.record["real"][0]
        real[PROPORTIONAL], real[STILL] = data["proportional"], data["still_counts"]
        real[PER_SAMPLE] = data["cycle_ns"] * 1e-9 / data["integral_s"]
        self.motor: NDArray[np.void] | None = motor
        if motor is None:
            bench = axis_row("bench")
            self.motor = axis_row("bench", counts_per_rad=float(bench["um_per_rad"][0]))
