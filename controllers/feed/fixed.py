"""A constant feed that ignores the gap: the baseline for every other controller."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from edmsim.controllers.protocols import FeedCommand, WindowObservation, check_feed, check_parameters
from edmsim.snapshots import Snapshots


@dataclass
class FixedController(Snapshots):
    """Commands the same feed for every window."""

    name: ClassVar[str] = "fixed"

    # the feed in um/s, 0 or more (ours: at 20 um/s half of the pulses are open in 20 mm of steel)
    feed_um_s: float = 20.0
    offset_um: float = 0.0  # offset to the left of the path, for example for a finishing pass

    def __post_init__(self) -> None:
        check_parameters(self)

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a new cut; refuses a feed the machine cannot run."""
        check_feed(self.name, "feed_um_s", self.feed_um_s, max_feed_um_s)
        return FeedCommand(self.feed_um_s, offset_um=self.offset_um)

    def update(self, window: WindowObservation) -> FeedCommand:
        """Return the same feed for every window."""
        return FeedCommand(self.feed_um_s, offset_um=self.offset_um)
