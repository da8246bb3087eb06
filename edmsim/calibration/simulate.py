"""The simulated side of a calibration: a stretch of the log cut again by a machine with other constants."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edmsim.calibration.log import Stretch, statistics
from edmsim.cosim.straight import Traverse, begin
from edmsim.machine.setting import WINDOW_PULSES
from edmsim.plant.gap.generator import timing
from edmsim.plant.window import PlantError

if TYPE_CHECKING:
    from edmsim.machine.machine import Machine
    from edmsim.plant.window import PulseWindow


SETTLED_DIAMETERS = 1.3
"""Travel, in wire diameters, after which walls and gap are nearly those of the present feed (ours: shares of short
circuits rise most over the first 300 um of a cut with the 250 um wire)."""
WHOLLY_SETTLED_DIAMETERS = 5.0
"""Travel, in wire diameters, that is simulated before a stretch at most (ours: with a 200 um wire the share of short
circuits rises from 13.5 % after 0.3 mm to 14.4 % after 1 mm, as in a log of 12 mm; each is known to 0.2 %)."""


def settle_um(machine: Machine) -> float:
    """Travel after a change of feed or setting that tells of the change, not of what follows it."""
    return SETTLED_DIAMETERS * machine.wire_diameter_um


def simulate(machine: Machine, stretch: Stretch, windows: int, seed: int, resolution: str) -> NDArray[np.float64]:
    """Cut straight at a stretch's feed and setting; return `log.STATISTICS` of its batches, (batches, 5)."""
    # before it is measured the cut goes as far as the log did at this feed and setting, but no further than it
    # takes to settle wholly. If the wire breaks or is driven into the metal, what is missing counts as short
    # circuits: no other set of statistics is as far from that of a machine that cut
    set_up = machine.model_copy(update={"t_on_us": stretch.t_on_us, "t_period_us": stretch.t_period_us})
    windows_fired: list[PulseWindow] = []
    try:
        traverse = Traverse(begin(set_up, seed, resolution=resolution), stretch.feed_um_s)
        wholly_um = WHOLLY_SETTLED_DIAMETERS * machine.wire_diameter_um
        travel_um = min(max(stretch.travelled_um, settle_um(machine)), wholly_um)
        if not traverse.run(travel_um / stretch.feed_um_s)[-1].broken:
            while len(windows_fired) < windows and not (windows_fired and windows_fired[-1].broken):
                windows_fired.append(traverse.window())
    except PlantError:
        pass
    if windows_fired and windows_fired[-1].broken:
        windows_fired.pop()
    lost = windows - len(windows_fired)
    short_A = timing(set_up).short_A * stretch.t_on_us / stretch.t_period_us
    rows = [(w.short, w.open, w.mean_voltage_V, w.mean_current_A, w.mean_delay_us) for w in windows_fired]
    rows += [(WINDOW_PULSES, 0, 0.0, short_A, 0.0)] * lost
    short, open_, voltage, current, delay = np.array(rows, float).T
    return statistics(short, open_, voltage, current, delay)
