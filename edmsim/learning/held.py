"""A policy above a law: it sets the heat flux that the law holds, and observes the flux that the law measures."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers import from_text
from edmsim.controllers.feed.law import ServoLaw
from edmsim.controllers.feed.measures import OpenShare
from edmsim.controllers.feed.periods import FluxGauge, HoldHeat
from edmsim.controllers.protocols import FeedCommand, WindowObservation
from edmsim.envs.observation import Entry
from edmsim.errors import InputError
from edmsim.snapshots import Snapshots

MOST = 4.0
"""Bound of the logarithms of fluxes in an observation (ours: above any flux that a law holds)."""
BREAK_S = 0.1
"""Time constant of the flux that a break is put down to (ours: a wire breaks some 20 ms after it boils dry)."""
ENTRIES = tuple(
    Entry(name, -MOST, MOST, f"natural logarithm of {what}", "1")
    for name, what in (
        ("held", "the flux that the law held, over the critical one"),
        ("flux", "the greatest local flux, its mean over the step, over the critical one"),
        ("broke_flux", "the greatest local flux when the last wire broke; 0 where none did"),
    )
)
"""Entries behind those of the environment; fluxes are those of `FluxGauge`, by constants of the files."""
HOLDS = "heat flux that the law holds, over the critical one"
"""Meaning of the second entry of the action; the first is the environment's, the servo's target."""


def _logarithm(flux: float) -> float:
    return math.log(min(max(flux, math.exp(-MOST)), math.exp(MOST)))


@dataclass
class HeldLaw(Snapshots):
    """The law below a policy, and the policy's observation of it.

    Parameters
    ----------
    law : ServoLaw
        See `flux_law`.
    """

    STATE = ("law",)

    law: ServoLaw

    target: float | None = field(default=None, init=False)  # share of open pulses that is held; None for the law's
    step_s: float = field(default=0.0, init=False)
    flux_s: float = field(default=0.0, init=False)  # greatest flux, summed over the step's time
    flux: float = field(default=0.0, init=False)  # its slow mean now
    broke_flux: float = field(default=1.0, init=False)
    shown: NDArray[np.float64] = field(default_factory=lambda: np.zeros(len(ENTRIES)), init=False)

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a leg."""
        self.step_s = self.flux_s = self.flux = 0.0
        self.broke_flux, self.target = 1.0, None
        self.shown = np.zeros(len(ENTRIES))
        return self.law.reset(max_feed_um_s)

    def update(self, window: WindowObservation) -> FeedCommand:
        """Return the law's command, and measure its flux."""
        assert isinstance(self.law.measure, OpenShare)
        if self.target is not None:  # an argument of the law, so no part of its state
            self.law.measure.open_target_share = self.target
        command = self.law.update(window)
        assert isinstance(self.law.gauge, FluxGauge)
        greatest = float(self.law.gauge.flux.max())
        self.flux -= math.expm1(-window.duration_s / BREAK_S) * (greatest - self.flux)
        self.step_s += window.duration_s
        self.flux_s += greatest * window.duration_s
        return command

    def wire_lost(self) -> FeedCommand:
        """Note the flux at which the wire broke, and start with the next wire."""
        self.broke_flux, self.flux = self.flux, 0.0
        self.shown[-1] = _logarithm(self.broke_flux)  # also where it broke as a step ended
        return self.law.wire_lost()

    def end_step(self) -> None:
        """Put the step's measurements into the observation, and begin the next step."""
        assert isinstance(self.law.period, HoldHeat)
        mean = self.flux_s / self.step_s if self.step_s else 0.0
        self.shown = np.array([_logarithm(flux) for flux in (self.law.period.hold, mean, self.broke_flux)])
        self.step_s = self.flux_s = 0.0

    def hold(self, flux: float, open_target_share: float) -> None:
        """Hold another flux, and another share of open pulses, from now on."""
        assert isinstance(self.law.period, HoldHeat)
        self.law.period.hold, self.target = flux, open_target_share


def flux_law(text: str) -> ServoLaw:
    """Make a law that holds a heat flux and changes it only at wire breaks: `heat-flux` with its parameters.

    Raises
    ------
    InputError
        If it is another law.
    """
    law = from_text(text) if text.partition(":")[0] == "heat-flux" else None
    if not (isinstance(law, ServoLaw) and type(law.period) is HoldHeat and isinstance(law.gauge, FluxGauge)):
        raise InputError(f"a policy says what flux 'heat-flux' holds, not what '{text}' does")
    return law
