"""Feed controller of a bandit: a law cuts, and every few seconds the bandit chooses a setting of it."""

import math
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.protocols import FeedCommand, WindowObservation, tell
from edmsim.learning import bandit_file
from edmsim.learning.bandit_file import BanditCard, Belief, Segment
from edmsim.learning.policy_controller import PolicyController
from edmsim.learning.policy_file import load
from edmsim.machine.machine import Machine
from edmsim.machine.setting import WINDOW_PULSES
from edmsim.snapshots import Snapshots


class BanditController(Snapshots):
    """Cuts with a law, and learns which of its settings cuts fastest on this machine."""

    name: ClassVar[str] = "policy"
    STATE: ClassVar[tuple[str, ...]] = (
        "law", "belief", "setting", "clock_s", "spent_s", "path_um", "seconds", "way_um", "pulses", "open", "short",
        "fifths", "untried", "broken",
    )  # fmt: skip

    def __init__(self, card: BanditCard) -> None:
        self.card = card
        self.law = bandit_file.law_of(card)
        self.belief = Belief(card)
        self.path_um = 0.0  # at the end of the last window
        self.lost_s = card.start_s  # that a lost wire costs
        self._begin()

    def _begin(self) -> None:
        self.setting = 0
        self.untried = list(range(1, len(self.card.settings)))
        self.clock_s = -self.card.first_s  # since the setting was chosen; below 0 while a wire begins
        self.spent_s = 0.0  # cutting time
        self.broken = False  # whether a wire was lost
        self._clear()

    def _clear(self) -> None:
        """Begin a measurement."""
        self.seconds = self.way_um = 0.0
        self.pulses = self.open = self.short = 0
        self.fifths = np.zeros(5, np.int64)  # ignitions in each fifth of the height

    def set_up(self, machine: Machine, points_um: NDArray[Any], start_um: float) -> None:
        """Set the machine and the path; called before every leg of the cut."""
        self.path_um = start_um
        self.lost_s = machine.base.table.threading_s.value + self.card.start_s
        self.law.override(self.card.settings[0])  # it had that of the last leg
        tell(self.law, machine, points_um, start_um)

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin a leg, with what was learned of other machines."""
        self.belief.begin()
        self._begin()
        return self.law.reset(max_feed_um_s)

    def wire_lost(self) -> FeedCommand:
        """Begin the next wire with the first setting; what was measured of the segment is left out."""
        if self.broken and self.clock_s >= 0.0:  # the first one shows the law what the machine's wires bear
            self.belief.lost[self.setting] += 1
        self.broken = True
        self.clock_s = -self.card.start_s
        self._clear()
        self.law.override(self.card.settings[0])
        return self.law.wire_lost()

    def update(self, window: WindowObservation) -> FeedCommand:
        """Measure, decide at the end of a segment, and return the law's command with the setting in force."""
        self.clock_s += window.duration_s
        self.spent_s += window.duration_s
        if self.clock_s >= 0.0:
            self.belief.cut_s[self.setting] += window.duration_s
        if self.clock_s > self.card.settle_s:
            self._measure(window)
        self.path_um = window.path_um
        if self.clock_s >= self.card.segment_s:
            self._end_segment()
        # arguments of the law are no part of its state: put them in place in every window
        self.law.override(self.card.settings[self.setting if self.clock_s >= 0.0 else 0])
        return self.law.update(window)

    def _measure(self, window: WindowObservation) -> None:
        self.seconds += window.duration_s
        self.way_um += window.path_um - self.path_um
        self.pulses += WINDOW_PULSES
        self.open += window.open
        self.short += window.short
        self.fifths += np.array(window.fifths)

    def _end_segment(self) -> None:
        """Take in what was measured, and choose the next segment's setting."""
        if self.way_um > 0.0 and self.fifths.any():
            log_rate = math.log(self.way_um / self.seconds * bandit_file.height_share(self.fifths.tolist()))
            self.learn(Segment(log_rate, self.open / self.pulses, self.short / self.pulses))
        self.setting = self.choose()
        self.clock_s = 0.0
        self._clear()

    def learn(self, measured: Segment) -> None:
        """Take in a segment."""
        self.belief.learn(self.setting, measured)

    def choose(self) -> int:
        """Return the setting of the next segment."""
        if self.spent_s < self.card.trial_s:
            at_best = self.belief.at_best(self.card.trial_bonus, self.lost_s)
            promising = [k for k in self.untried if at_best[k] > self.belief.net(self.lost_s).max()]
            if promising:
                setting = max(promising, key=lambda k: float(at_best[k]))
                self.untried.remove(setting)
                return setting
        return int(np.argmax(self.belief.at_best(self.card.bonus, self.lost_s)))


def from_name(name: str) -> BanditController | PolicyController:
    """Make the controller of a policy from its file or its name under ``models/policies``."""
    file = bandit_file.find(name)
    if file is not None:
        return BanditController(bandit_file.load(file))
    return PolicyController(load(name))
