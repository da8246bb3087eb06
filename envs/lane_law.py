"""A feed controller at a lane of an environment: it is shown what a machine shows, and says what it would command."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers import FeedController, SeesTruth
from edmsim.controllers.protocols import FeedCommand, SeesBreaks, check_command, tell
from edmsim.envs.as_action import as_action
from edmsim.machine.setting import WINDOW_PULSES

if TYPE_CHECKING:
    from edmsim.envs.lanes import Lanes


class LaneLaw:
    """A feed controller that looks at a lane's windows; whether its commands are run is up to who asks for them.

    Parameters
    ----------
    lanes : Lanes
        Every window of the lane is shown to it, also where a step has several, until `stop`.
    lane : int
    controller : FeedController
    """

    def __init__(self, lanes: Lanes, lane: int, controller: FeedController) -> None:
        self._lanes, self._lane, self._controller = lanes, lane, controller
        self._leg = self._lost = 0
        self._command = FeedCommand(0.0)
        lanes.watchers[lane].append(self._see)

    def stop(self) -> None:
        """Look no more."""
        self._lanes.watchers[self._lane].remove(self._see)

    def begin(self) -> FeedCommand:
        """Begin the leg that the lane is on; returns the command for its first window."""
        lanes, lane = self._lanes, self._lane
        scenario = lanes.scenarios[lane]
        assert scenario is not None
        self._leg, self._lost = lanes.leg[lane], int(lanes.rows[lane]["wires_lost"])
        start_um = float(lanes.rows[lane]["before_um"])
        tell(self._controller, scenario.machine, scenario.legs_um[self._leg], start_um)
        self._take(self._controller.reset(lanes.family.greatest_feed_um_s))
        return self._command

    def command(self) -> FeedCommand:
        """Return what it commands for the next window, after all that the lane has had."""
        lanes, lane, controller = self._lanes, self._lane, self._controller
        if self._leg != lanes.leg[lane]:
            return self.begin()
        if self._lost != lanes.rows[lane]["wires_lost"]:
            self._lost = int(lanes.rows[lane]["wires_lost"])
            if isinstance(controller, SeesBreaks):
                self._take(controller.wire_lost())
            else:
                self._take(controller.reset(lanes.family.greatest_feed_um_s))
        return self._command

    def action(self) -> NDArray[np.float32]:
        """Return the action of the environment that commands what it wants: see `as_action`."""
        lanes, row = self._lanes, self._lanes.rows[self._lane]
        scenario = lanes.scenarios[self._lane]
        assert scenario is not None
        first_us = scenario.machine.t_on_us, scenario.machine.t_period_us
        now_us, feed_um_s = row["setting_us"].tolist(), float(row["feed_um_s"])
        return as_action(lanes.family, self._controller, self.command(), first_us, now_us, feed_um_s)

    def _see(self) -> None:
        """Show it the window that the lane has just had."""
        self.command()  # a leg or wire that the last window ended is over before this one
        window = self._lanes.fleet.plants[self._lane].window()
        if window.pulses != WINDOW_PULSES:
            return
        if isinstance(self._controller, SeesTruth):
            self._controller.see(window)
        self._take(self._controller.update(self._lanes.observation(self._lane)))

    def _take(self, command: FeedCommand) -> None:
        self._command = check_command(self._controller.name, command)
