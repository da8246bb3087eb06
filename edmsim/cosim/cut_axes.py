"""The axes of a cut under drives: steps of the machine's length, faults at their time, waits at the ends of legs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from edmsim.errors import InputError
from edmsim.plant.axes.faults import AxisFault
from edmsim.plant.axes.rapid import constants, time_left_s
from edmsim.plant.plant import Plant
from edmsim.snapshots import Snapshots

_STEP_SHARE = 1e-6  # share by which a drive's step may differ from the machine's: what rounding leaves


class CutAxes(Snapshots):
    """What a cut asks of its axes, and what befalls them; refuses drives whose steps differ from the machine's."""

    STATE = ("_since_ns", "_before_um")

    def __init__(self, plant: Plant, faults: Sequence[AxisFault]) -> None:
        self._plant, self._faults = plant, sorted(faults, key=lambda fault: fault.at_s)
        self._since_ns: int | None = None
        self._before_um: list[float] = []
        own = plant.own_step_um
        for fault in self._faults:
            if fault.axis not in own:
                raise InputError(f"{fault.axis} has no drive with a loop, which the fault {fault.fault} needs")
        step_um = plant.machine.base.table.step_um.value
        for name, own_um in own.items():
            if not abs(own_um / step_um - 1) <= _STEP_SHARE:
                raise InputError(
                    f"the drive of {name} ({plant.drives[name].name}) moves {own_um:g} um at a step; this machine's "
                    f"steps are {step_um:g}"
                )
        self.fail_due()

    def fail_due(self) -> None:
        """Let the faults happen whose time has come."""
        for fault in self._faults:
            if self._plant.time_ns >= fault.at_s * 1e9:
                self._plant.break_axis(fault.axis, fault.fault)

    def late(self) -> str | None:
        """Return why axes need not be waited for any longer at a leg's end; None if they may still come, or have."""
        plant = self._plant
        if plant.in_place:
            self._since_ns = None
            return None
        if self._since_ns is None:
            self._since_ns, self._before_um = plant.time_ns, plant.away_um.tolist()
            return None
        waited_s = (plant.time_ns - self._since_ns) * 1e-9
        if waited_s < constants()["settled_s"]:
            return None
        step_um = plant.machine.base.table.step_um.value
        late_s = time_left_s(np.array(self._before_um), plant.away_um, waited_s, step_um)
        if late_s > constants()["longest_s"]:
            return plant.reason_of_delay(late_s)
        self._since_ns, self._before_um = plant.time_ns, plant.away_um.tolist()
        return None

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue where `snapshot` was taken, with the plant restored before; a supply once off stays off."""
        super().restore(state)
        self.fail_due()
