"""The field's classic: fuzzy rules from the ratios of short and open pulses to a change of feed.

Source: Lin, Chung, Huang, J. Mater. Process. Technol. 113 (2001) 324-330, fuzzy control of a wire-EDM machine from
what its pulses show. Their memberships and rule table could not be read; those below are ours, after the usual
scheme: a Sugeno controller of order zero, triangular memberships, product and weighted mean.

====================  =========  =====  =====
open ratio            low        right  high
====================  =========  =====  =====
falling               -1         -0.5   +0.5
steady                -1          0     +1
rising                -0.5       +0.5   +1
short ratio is high   -2, whatever the open ratio
====================  =========  =====  =====
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

from edmsim.controllers.feed.gap_servo import Gains, ServoController
from edmsim.controllers.protocols import FeedCommand, WindowObservation
from edmsim.machine.setting import WINDOW_PULSES

_RULES = ((-1.0, -0.5, 0.5), (-1.0, 0.0, 1.0), (-0.5, 0.5, 1.0))
"""Change of feed by the open ratio's change (falling, steady, rising) and by the ratio (low, right, high)."""
_ON_SHORTS = -2.0


@dataclass
class _Ratios:
    """Low-passed ratios."""

    short: float = 0.0
    open: float = 0.0


@dataclass
class FuzzyController(ServoController):
    """Changes the feed by fuzzy rules; retracts from shorts as `ServoController` does.

    Further parameters: see `ServoController`; its filter works on both ratios.

    Parameters
    ----------
    open_target_share : float
        Share of open pulses that is right.
    open_width_share : float
        Distance from it at which the ratio is low or high and nothing else.
    change_share_s : float
        Change of the open ratio per second that is falling or rising and nothing else, in parts of all pulses.
    short_begin_share, short_high_share : float
        Short ratio that begins to be high, and that which is high and nothing else.
    rate_um_s2 : float
        Change of feed per second where the rules say 1.
    """

    name: ClassVar[str] = "fuzzy"

    open_target_share: float = 0.2
    open_width_share: float = 0.2
    change_share_s: float = 1.0
    short_begin_share: float = 0.1
    short_high_share: float = 0.4
    rate_um_s2: float = 10.0

    _ratios: _Ratios = field(default_factory=_Ratios, init=False, repr=False)

    def gains(self) -> Gains:
        """The feed is the sum of its changes."""
        return Gains(0.0, self.rate_um_s2, 0.0)

    def error(self, window: WindowObservation) -> float:
        """What the rules say, from -2 to 1, after taking in a window's ratios."""
        ratios, before = self._ratios, self._ratios.open
        weight = -math.expm1(-window.duration_s / self.filter_s) if self.filter_s else 1.0
        ratios.open += weight * (window.open / WINDOW_PULSES - ratios.open)
        ratios.short += weight * (window.short / WINDOW_PULSES - ratios.short)
        return self._infer((ratios.open - before) / window.duration_s)

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a new cut."""
        self._ratios = _Ratios(open=self.open_target_share)
        return super().reset(max_feed_um_s)

    def _infer(self, open_change_s: float) -> float:
        """What the rules say, from -2 to 1."""
        span = max(self.short_high_share - self.short_begin_share, 1e-9)
        high = min(max((self._ratios.short - self.short_begin_share) / span, 0.0), 1.0)
        ratio = _memberships((self._ratios.open - self.open_target_share) / max(self.open_width_share, 1e-9))
        change = _memberships(open_change_s / max(self.change_share_s, 1e-9))
        free = sum(
            c * r * out
            for c, row in zip(change, _RULES, strict=True)
            for r, out in zip(ratio, row, strict=True)
        )
        return (1.0 - high) * free + high * _ON_SHORTS


def _memberships(value: float) -> tuple[float, float, float]:
    """Degrees of low, right and high; they add up to 1."""
    low, high = min(max(-value, 0.0), 1.0), min(max(value, 0.0), 1.0)
    return low, 1.0 - low - high, high
