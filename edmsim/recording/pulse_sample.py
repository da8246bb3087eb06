"""Single pulses of a straight cut, for the figures that windows of 255 pulses are too coarse for."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.job.settings import CutSettings
from edmsim.machine.machine import Machine
from edmsim.plant.workpiece.start_slot import begun_slot
from edmsim.recording.windows import column

if TYPE_CHECKING:
    import pyarrow as pa

    from edmsim.plant.plant import Plant

KINDS = ("short", "open", "spark", "arc")
"""Classes of pulses; `PulseSample.kind` counts them from 0."""
SETTLE_S = 3.0
"""Machine time before the first pulse is looked at (ours: several times what a gap takes to settle)."""
PULSES = 4096
"""Pulses looked at (ours: the spectrum's lines are some 20 Hz apart at 100 us, and a share is known to 1 %)."""
_MIDDLE_UM = (32_500.0, 32_500.0)
AIR_SHARE = 0.9
"""From this share of open pulses on a window is taken for one without metal near (ours)."""


@dataclass(frozen=True)
class PulseSample:
    """Pulses one by one, of a straight cut at a fixed feed in steady state.

    Attributes
    ----------
    machine : Machine
        The set-up.
    feed_um_s : float
    period_us : float
        Pulse period.
    kind : int array (n,)
        Class of every pulse, see `KINDS`.
    delay_us : float64 array (n,)
        Ignition delay; NaN where nothing ignited.
    deflection_um : float64 array (n, slices, 2)
        Wire minus guides when the pulse was over, per slice from the bottom, X and Y.
    """

    machine: Machine
    feed_um_s: float
    period_us: float
    kind: NDArray[np.int64]
    delay_us: NDArray[np.float64]
    deflection_um: NDArray[np.float64]

    def share(self, kind: str) -> float:
        """Share of a class of pulses, 0..1."""
        return float(np.mean(self.kind == KINDS.index(kind)))


def sample_pulses(
    machine: Machine, feed_um_s: float, *, seed: int = 0, pulses: int = PULSES, settle_s: float = SETTLE_S,
    resolution: str = "fast",
) -> PulseSample:
    """Cut straight along +X from a begun slot, and look at single pulses once that has settled.

    Parameters
    ----------
    machine : Machine
    feed_um_s : float
        Above 0.
    seed : int
    pulses : int
        How many to look at, at least 1.
    settle_s : float
        Machine time before.
    resolution : {"fast", "default", "fine"}

    Raises
    ------
    InputError
        If the generator's period is not fixed, feed or number of pulses is not above 0, or the wire broke before
        the cut had settled.
    PlantError
        If the feed drove the wire into the metal.
    """
    from edmsim.plant.plant import Plant

    if not 0 < feed_um_s < math.inf or pulses < 1:
        raise InputError(f"pulses are looked at in a cut: {pulses} pulses at {feed_um_s:g} um/s are none")
    plant = Plant(
        machine, seed, stock=begun_slot(machine, _MIDDLE_UM), position_um=_MIDDLE_UM, resolution=resolution
    )
    if not plant.window_ns:
        raise InputError("single pulses are looked at with generators of a fixed period")
    steps = _Steps(machine.base.table.step_um.value, feed_um_s)
    while plant.time_ns < settle_s * 1e9:
        if plant.advance(steps.until(plant.time_ns + plant.window_ns)).broken:
            raise InputError(f"the wire broke within {settle_s:g} s at {feed_um_s:g} um/s: no pulses to see")
    return _look(plant, steps, feed_um_s, pulses)


class _Steps:
    """Motor steps along +X, evenly spaced."""

    def __init__(self, step_um: float, feed_um_s: float) -> None:
        self._every_ns = step_um / feed_um_s * 1e9
        self._made = 0

    def until(self, end_ns: int) -> list[tuple[int, int, int]]:
        """Return the steps due before a time that have not been made yet."""
        due = math.ceil(end_ns / self._every_ns) - 1
        steps = [(int(k * self._every_ns), 0, 1) for k in range(self._made + 1, due + 1)]
        self._made = max(self._made, due)
        return steps


def _look(plant: Plant, steps: _Steps, feed_um_s: float, pulses: int) -> PulseSample:
    period_ns = round(plant.machine.t_period_us * 1e3)
    kind, delay = np.empty(pulses, np.int64), np.empty(pulses)
    deflection = np.empty((pulses, plant.resolution.slices, 2))
    for n in range(pulses):
        pulse = plant.advance_pulse(steps.until(plant.time_ns + period_ns))
        kind[n] = (pulse.short, pulse.open, pulse.spark, pulse.arc).index(1)
        delay[n] = pulse.mean_delay_us
        deflection[n] = plant.deflections_um()
    return PulseSample(plant.machine, feed_um_s, period_ns * 1e-3, kind, delay, deflection)


def cutting_feed_um_s(windows: pa.Table) -> float | None:
    """Median feed of the windows that cut: forward, and with metal near; None if there are none."""
    feed, open_ = column(windows, "feed_um_s"), column(windows, "open")
    pulses = np.sum([column(windows, kind) for kind in KINDS], axis=0)
    cutting = (feed > 0) & (open_ < AIR_SHARE * pulses)
    return float(np.median(feed[cutting])) if cutting.any() else None


def sample_like(report: Mapping[str, Any], windows: pa.Table, *, pulses: int = PULSES) -> PulseSample:
    """Look at single pulses of a straight cut with a cut's set-up, seed and resolution, at its median feed.

    The workpiece has its greatest height, and modes move the wire, whatever moved it in the cut.

    Parameters
    ----------
    report : mapping
        The cut's report, as ``report.json`` holds it.
    windows : pyarrow.Table
        The cut's table of windows.
    pulses : int

    Raises
    ------
    InputError
        If the cut never cut, its set-up cannot be read any more, or as `sample_pulses`.
    """
    feed = cutting_feed_um_s(windows)
    if feed is None:
        raise InputError("the cut has no window with metal near the wire")
    settings = CutSettings.of_report(report)
    return sample_pulses(
        settings.load_machine(), feed, seed=settings.seed, pulses=pulses, resolution=settings.resolution
    )
