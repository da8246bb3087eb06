"""Single pulses of a straight cut, for the figures that windows of 255 pulses are too coarse for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers import make
from edmsim.cosim.motion import EvenSteps
from edmsim.cosim.straight import Traverse, begin
from edmsim.errors import InputError
from edmsim.machine.machine import Machine
from edmsim.plant.plant import Plant

if TYPE_CHECKING:
    import pyarrow as pa

KINDS = ("short", "open", "spark", "arc")  # classes of pulses; `PulseSample.kind` counts them from 0
SETTLE_S = 3.0  # machine time before the first pulse is looked at (ours: several times what a gap takes to settle)
PULSES = 4096
"""Pulses looked at (ours: the spectrum's lines are some 20 Hz apart at 100 us, and a share is known to 1 %)."""
AIR_SHARE = 0.9  # from this share of open pulses on a window is taken for one without metal near (ours)


@dataclass(frozen=True)
class PulseSample:
    """Single pulses of a straight cut at a fixed feed in steady state.

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
        Ignition delay; NaN if the pulse did not ignite.
    deflection_um : float64 array (n, slices, 2)
        Wire minus guides after the pulse, per slice from the bottom, X and Y.
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
    """Cut straight along +X from the start of a slot, and sample single pulses in steady state.

    Parameters
    ----------
    machine : Machine
    feed_um_s : float
        Above 0.
    seed : int
    pulses : int
        Number of pulses, at least 1.
    settle_s : float
        Earlier machine time.
    resolution : {"fast", "default", "fine"}

    Raises
    ------
    InputError
        If the generator's period is not fixed, feed or number of pulses is not above 0, or the wire breaks before
        the steady state.
    PlantError
        If the feed drives the wire into the metal.
    """
    if not 0 < feed_um_s < math.inf or pulses < 1:
        raise InputError(f"sampling pulses needs a cut: {pulses} pulses at {feed_um_s:g} um/s are not a cut")
    plant = begin(machine, seed, resolution=resolution)
    if not plant.window_ns:
        raise InputError("sampling pulses needs generators of a fixed period")
    traverse = Traverse(plant, make("fixed", feed_um_s=feed_um_s))
    if traverse.run(settle_s)[-1].broken:
        raise InputError(f"the wire broke within {settle_s:g} s at {feed_um_s:g} um/s: no pulses to see")
    return _look(plant, traverse, pulses)


def _look(plant: Plant, steps: EvenSteps, pulses: int) -> PulseSample:
    period_ns = round(plant.machine.t_period_us * 1e3)
    kind, delay = np.empty(pulses, np.int64), np.empty(pulses)
    deflection = np.empty((pulses, plant.resolution.slices, 2))
    for n in range(pulses):
        start_ns = plant.time_ns
        pulse = plant.advance_pulse(steps.plan(start_ns, start_ns + period_ns))
        steps.keep(start_ns, plant.time_ns)
        kind[n] = (pulse.short, pulse.open, pulse.spark, pulse.arc).index(1)
        delay[n] = pulse.mean_delay_us
        deflection[n] = plant.deflections_um()
    return PulseSample(plant.machine, steps.feed_um_s, period_ns * 1e-3, kind, delay, deflection)


def cutting_feed_um_s(windows: pa.Table) -> float | None:
    """Median feed of the windows that cut: forward, and with metal near; None if there are none."""
    feed, open_ = windows.column("feed_um_s").to_numpy(), windows.column("open").to_numpy()
    pulses = np.sum([windows.column(kind).to_numpy() for kind in KINDS], axis=0)
    cutting = (feed > 0) & (open_ < AIR_SHARE * pulses)
    return float(np.median(feed[cutting])) if cutting.any() else None
