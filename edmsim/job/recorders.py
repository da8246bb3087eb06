"""What is recorded of a cut while it runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from edmsim.machine.machine import Machine
from edmsim.plant.resolution import resolution as resolution_named
from edmsim.plant.workpiece.height_steps import LowerRegion
from edmsim.recording.stores import Closeups, Frames
from edmsim.recording.windows import WindowTable


class Recorders(NamedTuple):
    """The observers of a cut.

    Attributes
    ----------
    windows : WindowTable
        A row per window.
    frames : Frames
        The wire's shape, thinned.
    closeups : Closeups
        Windows kept pulse by pulse.
    """

    windows: WindowTable
    frames: Frames
    closeups: Closeups


def recorders_for(machine: Machine, steps: Sequence[LowerRegion], resolution: str) -> Recorders:
    """Return empty recorders for a cut of a workpiece with some height steps."""
    size = resolution_named(resolution)
    lowest_mm = min([step.height_mm for step in steps], default=machine.height_mm)
    middle = max(round(size.slices * lowest_mm / machine.height_mm), 1) // 2  # it has metal everywhere
    windows = WindowTable(machine.generator.equalising is not None)
    return Recorders(windows, Frames(size.slices), Closeups(size.slices, size.rays, middle))
