"""The planner with the sine table: as the default one, but without a square root (row T-72)."""

from __future__ import annotations

from edmsim.controllers.mcu.firmware.sine_table import look_up
from edmsim.controllers.planner.poscal import PoscalPlanner


class SineTablePlanner(PoscalPlanner):
    """Steers at the same carrot as `PoscalPlanner`, with directions from the table.

    A direction is right to half an entry and the rounding of its sine and cosine, 0.3 degrees; as the next step
    aims anew, the line is kept as well as with POSCAL.
    """

    _resolve = staticmethod(look_up)
