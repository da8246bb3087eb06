"""MaxRateShift and ThinWireShift: a shift on one machine, long enough to learn its limits and use them."""

from typing import ClassVar

import numpy as np

from edmsim.envs.arguments import Range, argument, ends_of, record_of_arguments
from edmsim.envs.environment import EdmEnv
from edmsim.envs.families import HeightStep, MaxRate, ThinWire
from edmsim.envs.page import page
from edmsim.envs.reward import Weights
from edmsim.envs.task import ROOM_MM, Drawn, Drift, Scenario
from edmsim.machine.machine import Machine
from edmsim.machine.ranges import with_constants
from edmsim.numeric import above_zero, within
from edmsim.plant.workpiece.blanks import SLOT_UM

TRAVEL_MM = 400.0
"""Travel of the table, that of `production-400`: long enough for all workpieces of a shift."""
DRIFT_EVERY_S = 60.0
"""Machine time between two steps of the drift (ours: each changes the water by a few per cent of its range)."""
SHIFT_S, WIRES, LENGTH_MM, WORKPIECES_MM = 1200.0, 100, 390.0, (2.0, 8.0)
"""Ours: a shift much longer than the time to learn a machine's limits; more wires and length than a shift can use;
workpieces of about a minute each."""
AREA = Weights(short=0.0, open=0.0, wire_break=0.0)
"""A lost wire costs only its threading time, because the shift ends by the clock."""


@record_of_arguments
class Shift(HeightStep):
    """Workpieces in a row on one machine whose water changes."""

    test_s: float = argument(60.0, "s", "duration of the test cut, with a reward of 0")
    # ours: within the range of the machine's file, as the resin of the deioniser is used up
    conductivity_uS_cm: Range | None = argument(
        (5.0, 20.0), "uS/cm", "final value of the water, or (low, high); None: no change"
    )
    # ours: a worn nozzle, or a filter that fills, takes up to half
    flushing_left: Range = argument((0.5, 1.0), "", "final share of the pressures at the workpiece")

    counts_threading: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Refuse what cannot be used."""
        super().__post_init__()
        within("test_s", self.test_s, 0.0, 1e6)
        if self.conductivity_uS_cm is not None:
            for end in ends_of("conductivity_uS_cm", self.conductivity_uS_cm):
                above_zero("conductivity_uS_cm", end, 1000.0)
        for end in ends_of("flushing_left", self.flushing_left):
            within("flushing_left", end, 0.1, 1.0)

    @property
    def scrap_s(self) -> float:
        """Time of the test cut."""
        return self.test_s

    @property
    def reach_mm(self) -> float:
        """Longest possible cut: the travel of the table."""
        return self.base.base.table.travel_mm.value - 2 * ROOM_MM - SLOT_UM * 1e-3

    def start_um(self, machine: Machine) -> tuple[float, float]:
        """Return the wire's first position: the table's low end of x."""
        return ROOM_MM * 1e3 + SLOT_UM, machine.base.table.centre_um[1]

    def draw_cut(self, rng: np.random.Generator, machine: Machine, seed: int, drawn: Drawn) -> Scenario:
        """Draw the workpieces and the drift of the machine's water."""
        scenario = super().draw_cut(rng, machine, seed, drawn)
        at_begin = machine.base.dielectric.conductivity_uS_cm.value
        ends = (at_begin, at_begin) if self.conductivity_uS_cm is None else ends_of("", self.conductivity_uS_cm)
        conductivity = float(rng.uniform(*ends))
        left = float(rng.uniform(*ends_of("flushing_left", self.flushing_left)))
        drawn |= {"last_conductivity_uS_cm": conductivity, "last_flushing_share": left}
        return scenario._replace(drift=Drift(self.episode_s or np.inf, DRIFT_EVERY_S, conductivity, left))


def on_a_large_table(machine: Machine) -> Machine:
    """Return a machine with a table for all workpieces of a shift."""
    travel = machine.base.table.travel_mm.model_copy(update={"value": TRAVEL_MM})
    return with_constants(machine, {"table.travel_mm": travel})


@record_of_arguments
class MaxRateShift(MaxRate, Shift):
    """A shift on the production machine.

    Further parameters: see `MaxRate` and `Shift`.
    """

    length_mm: float = LENGTH_MM
    band_mm: Range = WORKPIECES_MM
    low_share: float = 0.5
    episode_s: float | None = SHIFT_S
    wires: int = WIRES

    knows_wires: ClassVar[bool] = True
    own_weights: ClassVar[Weights] = AREA

    @staticmethod
    def own_machine() -> Machine:
        """Return that of `MaxRate`, on a table of 400 mm."""
        return on_a_large_table(MaxRate.own_machine())


@record_of_arguments
class ThinWireShift(ThinWire, Shift):
    """A shift with a thin wire.

    Further parameters: see `ThinWire` and `Shift`.
    """

    length_mm: float = LENGTH_MM
    band_mm: Range = WORKPIECES_MM
    low_share: float = 0.5
    height_mm: Range | None = (8.0, 20.0)
    episode_s: float | None = SHIFT_S
    wires: int = WIRES

    locates_discharges: ClassVar[bool] = True
    own_weights: ClassVar[Weights] = AREA

    @staticmethod
    def own_machine() -> Machine:
        """Return that of `ThinWire`, on a table of 400 mm."""
        return on_a_large_table(ThinWire.own_machine())


@page
class MaxRateShiftEnv(EdmEnv):
    """A shift of 20 minutes on one production machine: learn the limit of its wire, then cut near it.

    Description
    -----------
    This is `MaxRateEnv` for the time of a shift. Workpieces of 2 to 8 mm are cut in a row, each with its own height.
    The first minute is a test cut on scrap with a reward of 0: there you can break a wire to find the limit, and the
    observation has entries about lost wires. A lost wire costs the 20 s of threading the next one, 1.7 % of the
    shift, and no other penalty: the shift ends by the clock. During the shift the water's conductivity changes, and
    nozzles and filter wear: the pressure at the workpiece falls below the gauge's.

    Action space
    ------------
    The period is that of a pulse that ignites at once; the period of others is longer by their ignition delay.

    Observation space
    -----------------
    Local heights below the greatest and the drifting quantities are not observed.

    Starting state
    --------------
    The wire is at the low end of a table of 400 mm, in a slot, 25 um from the metal. The first workpiece has the
    greatest height; lengths are drawn uniformly from ``band_mm``, further heights from ``low_share`` to 1 times the
    greatest. Machine, tension and pressures are drawn as in `MaxRateEnv`. The final conductivity and the final share
    of the pressures are drawn uniformly from ``conductivity_uS_cm`` and ``flushing_left``. Both change linearly with
    time, in steps of a minute.
    """

    task = MaxRateShift


@page
class ThinWireShiftEnv(EdmEnv):
    """A shift of 20 minutes with a wire of 0.1 mm: learn the limit of this machine's wire, then cut near it.

    Description
    -----------
    This is `ThinWireEnv` for the time of a shift, with discharges located as in `MaxRateEnv`. Workpieces, test cut
    and the changes of water and pressure are those of `MaxRateShiftEnv`. A lost wire costs the 60 s of threading the
    next one, 5 % of the shift, and no other penalty: the shift ends by the clock.

    Observation space
    -----------------
    Local heights below the greatest and the drifting quantities are not observed.

    Starting state
    --------------
    As in `MaxRateShiftEnv`, with the machine of `ThinWireEnv`.
    """

    task = ThinWireShift
