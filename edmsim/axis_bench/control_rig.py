"""A control of several axes on the bench: each cycle it reads the encoders and sets its loops' targets."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from edmsim.axis_bench.bench import AxisBench
from edmsim.controllers.axis.drive import Drive, PositionServo
from edmsim.controllers.axis.elcam import mcu_g3
from edmsim.errors import methods_refuse_wrong_types
from edmsim.geometry import Floats
from edmsim.numeric import finite

_CYCLE_NS = round(mcu_g3.CYCLE_S * 1e9)


class Traces(NamedTuple):
    """Records of a run, a row per cycle and a column per axis: times in s, positions in the axes' units."""

    time_s: Floats
    setpoint: Floats
    actual: Floats
    compensation: Floats
    table_um: Floats


@methods_refuse_wrong_types
class ControlRig:
    """Axes of a control with their motors, screws and tables on a bench.

    A servo axis is an `mcu_g3.AxisLoop`; a stepper's motor takes steps, and its encoder counts its true motion.

    Parameters
    ----------
    axes : mapping of str to ControlAxis
        Axes by the bench's axis, of ``x y u v``; the control numbers them in this order.
    drives : mapping of str to drive, optional
        Overrides of the default drives.
    **options
        Those of `mcu_g3.MotionControl`.

    Attributes
    ----------
    control : MotionControl
    bench : AxisBench
    names : tuple of str
        The axes in the control's order.
    """

    def __init__(
        self, axes: Mapping[str, mcu_g3.ControlAxis], drives: Mapping[str, Drive] | None = None, **options: object
    ):
        self.names = tuple(axes)
        usual = {name: PositionServo() if axis.stepper else mcu_g3.AxisLoop() for name, axis in axes.items()}
        self.bench = AxisBench({**usual, **(drives or {})})
        self.control = mcu_g3.MotionControl(list(axes.values()), **options)
        self._sent = [0] * len(self.names)
        self._times: list[float] = []
        self._notes: list[list[list[float]]] = []

    def run(self, seconds: float) -> None:
        """Run for a time, in whole cycles."""
        for _ in range(round(finite("seconds", seconds) / mcu_g3.CYCLE_S)):
            self._turn()
            self.bench.run_to(round(self.bench.time_s * 1e9) + _CYCLE_NS)

    def count(self, axis: str) -> int:
        """Return an axis' encoder count."""
        return int(self.bench.axis(axis)["count"])

    def table_um(self, axis: str) -> float:
        """Return an axis' table position in um, by its screw."""
        return float(self.bench.axis(axis)["place_um"])

    def traces(self) -> Traces:
        """Return the records since the last call."""
        times, columns = np.array(self._times), np.array(self._notes).reshape(-1, 4, len(self.names))
        self._times, self._notes = [], []
        return Traces(times, *(columns[:, k] for k in range(4)))

    def _turn(self) -> None:
        axes, encoders = self.control.axes, [self.count(name) for name in self.names]
        self.control.turn([self._sent[k] if axes[k].stepper else count for k, count in enumerate(encoders)], encoders)
        for k, (name, axis) in enumerate(zip(self.names, axes, strict=True)):
            self._command(k, name, axis)
        self._times.append(self.bench.time_s)
        self._notes.append([
            [axis.setpoint for axis in axes], [axis.actual for axis in axes], [axis.compensation for axis in axes],
            [self.table_um(name) for name in self.names],
        ])  # fmt: skip

    def _command(self, k: int, name: str, axis: mcu_g3.ControlAxis) -> None:
        """Set target and compensation of a servo axis, or step a stepper to the sum of both."""
        record = self.bench.drive(name).record
        if axis.stepper:
            steps = round((axis.setpoint + axis.compensation) * axis.counts_per_unit) - self._sent[k]
            record["setpoint"] += steps
            self._sent[k] += steps
            return
        motor, real = self.bench.motor(name), record["real"][0]
        real[mcu_g3.TARGET] = axis.setpoint * axis.counts_per_unit
        real[mcu_g3.COMPENSATION] = axis.compensation * axis.counts_per_unit
        rad_s = axis.velocity * axis.counts_per_unit / float(motor["counts_per_rad"])
        real[mcu_g3.FEED_FORWARD] = rad_s * float(motor["torque_Nm_A"]) / float(motor["supply_V"])
