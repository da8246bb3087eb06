"""The search of a setting on the machine itself: more power until a wire breaks, then less.

It is how an operator finds the setting for a wire and a height that no table has (ours). Of five paces on 64 training
machines of ThinWire, that of the defaults earned 1,336, with 23 wires lost; the others 1,100 to 1,359, with 20 to 27.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar, cast

from edmsim.controllers.feed.set_point import SetPointController
from edmsim.controllers.protocols import ControllerState, FeedCommand, WindowObservation


@dataclass
class ClimbController(SetPointController):
    """Shortens the period step by step until the wire breaks, and stays below what broke it.

    Further parameters: see `SetPointController`; ``period_factor`` is where the first wire begins.

    Parameters
    ----------
    climb_s : float
        Time of cutting after which the period is made shorter; it waits while the wire retracts.
    step_share : float
        By how much: a share of it.
    back_factor : float
        Period after a break over the one that broke the wire. From there on it is held; a further break lengthens it
        again.
    """

    name: ClassVar[str] = "climb"

    climb_s: float = 5.0
    step_share: float = 0.13
    back_factor: float = 1.41

    _climb: dict[str, float] = field(default_factory=dict, init=False, repr=False)

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a new cut, with nothing known of the machine."""
        self._climb = {"factor": self.period_factor, "held_s": 0.0, "broken": 0.0}
        return super().reset(max_feed_um_s)

    def update(self, window: WindowObservation) -> FeedCommand:
        """Feed and setting for the next window."""
        climb = self._climb
        if not (self._servo.retracting or climb["broken"]):
            climb["held_s"] += window.duration_s
        if climb["held_s"] >= self.climb_s:
            climb["held_s"] = 0.0
            climb["factor"] = max(climb["factor"] * (1.0 - self.step_share), self.least_factor)
        return super().update(window)

    def wire_lost(self) -> FeedCommand:
        """Begin with a fresh wire where the last one broke, at a longer period."""
        climb, limit_um_s = self._climb, self._servo.max_feed_um_s
        climb |= {"factor": climb["factor"] * self.back_factor, "held_s": 0.0, "broken": 1.0}
        return SetPointController.reset(self, limit_um_s)

    def _wanted(self) -> float:
        """Period away from corners, in the operator's."""
        return self._climb["factor"]

    def snapshot(self) -> ControllerState:
        """Everything that changes while cutting."""
        return {**super().snapshot(), **{f"climb.{name}": value for name, value in self._climb.items()}}

    def restore(self, state: ControllerState) -> None:
        """Continue where `snapshot` was taken."""
        values = cast(dict[str, Any], state)
        self._climb = {k.removeprefix("climb."): v for k, v in values.items() if k.startswith("climb.")}
        super().restore({k: v for k, v in values.items() if not k.startswith("climb.")})
