"""The table between two moves: where x and y truly are when they have come to rest, without wire and gap.

The errors are those of the pulse loop (`edmsim.plant.axes.ways`), and so is the slack in the nuts.

>>> from edmsim.machine.machine import Machine
>>> table = StillTable(Machine.load())
>>> table.move((10_000.0, 20_000.0))
(10000.0, 20000.0)
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from edmsim.plant.axes.ways import errors_um, taken_up, ways_of

if TYPE_CHECKING:
    from edmsim.machine.machine import Machine


class StillTable:
    """A machine's table under steppers, first in the middle of the travel, perhaps with backlash of the nuts."""

    def __init__(self, machine: Machine, nuts: bool = True) -> None:
        self._ways = ways_of(machine, nuts)
        self.commanded_um = np.array(machine.base.table.centre_um)
        self._slack_um = [0.0, 0.0]

    def move(self, to_um: tuple[float, float]) -> tuple[float, float]:
        """Move the motors straight to a place, and return where the table truly comes to rest, in um."""
        for k in (0, 1):
            travel_um = float(to_um[k] - self.commanded_um[k])
            self._slack_um[k] = taken_up(self._slack_um[k], travel_um, float(self._ways["backlash_um"][k]))
            self.commanded_um[k] = to_um[k]
        x_um, y_um = (float(self.commanded_um[k]) - self._slack_um[k] for k in (0, 1))
        off_x, off_y = errors_um(self._ways, x_um, y_um, 0.0)
        return x_um - off_x, y_um - off_y
