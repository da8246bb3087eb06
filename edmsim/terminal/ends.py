"""The ends of the table's travel: end switches, and the stops behind them."""

from __future__ import annotations

from collections.abc import Iterable

from edmsim.controllers.mcu.chips.switches import X_END, Y_END, SafetySwitches
from edmsim.controllers.mcu.firmware.poscal import STEP_UM
from edmsim.controllers.protocols import Step
from edmsim.cosim.stops import switches_open
from edmsim.machine.machine import Machine
from edmsim.plant.constants import table_mechanics

END_SWITCHES = (X_END, Y_END)


class TableEnds:
    """What keeps the carriage on its table.

    Parameters
    ----------
    machine : Machine
        Its MJCF has the stops.
    switches : SafetySwitches
        Those that are stuck never open.
    """

    def __init__(self, machine: Machine, switches: SafetySwitches) -> None:
        self._travel_um = machine.base.table.travel_mm.value * 1e3
        self._stops_um = table_mechanics(machine, longest_us=1e3).stops_um
        self._switches = switches

    def switch_open(self, axis: int, direction: int, place_um: float) -> bool:
        """Whether a step of an axis in that direction has led to where its end switch opens."""
        if END_SWITCHES[axis] in self._switches.stuck:
            return False
        return switches_open(place_um, self._travel_um, STEP_UM) == direction

    def passed(self, place_um: tuple[float, float], steps: Iterable[Step]) -> list[Step]:
        """Return the steps that the table makes from a place; a motor that drives it against a stop loses its own."""
        place, made = [*place_um], []
        low_um, high_um = self._stops_um
        for step in steps:
            there_um = place[step.axis] + STEP_UM * step.direction
            if low_um <= there_um <= high_um:
                place[step.axis] = there_um
                made.append(step)
        return made
