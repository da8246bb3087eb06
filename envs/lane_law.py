"""A feed controller at a lane of an environment: it is shown what a machine shows, and says what it would command."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers import FeedController, SeesTruth, WindowObservation
from edmsim.controllers.protocols import FeedCommand, check_command, tell
from edmsim.controllers.pulse_counters import WINDOW_PULSES
from edmsim.envs.as_action import as_action

if TYPE_CHECKING:
    from edmsim.envs.lanes import Lanes


class LaneLaw:
    """A feed controller that looks at a lane's windows; whether its commands are run is up to who asks for them.

    Parameters
    ----------
    lanes : Lanes
        Of a step that has several windows, it is shown the last.
    lane : int
    controller : FeedController
    """

    def __init__(self, lanes: Lanes, lane: int, controller: FeedController) -> None:
        self._lanes, self._lane, self._controller = lanes, lane, controller
        self._leg = 0
        self._command = FeedCommand(0.0)

    def begin(self) -> FeedCommand:
        """Begin the leg that the lane is on; returns the command for its first window."""
        lanes, lane = self._lanes, self._lane
        scenario = lanes.scenarios[lane]
        assert scenario is not None
        self._leg = lanes.leg[lane]
        start_um = float(lanes.rows[lane]["before_um"])
        tell(self._controller, scenario.machine, scenario.legs_um[self._leg], start_um)
        first = self._controller.reset(lanes.family.greatest_feed_um_s)
        self._command = check_command(self._controller.name, first)
        return self._command

    def action(self) -> NDArray[np.float32]:
        """Return the action of the environment that commands what it wants: see `as_action`."""
        lanes, row = self._lanes, self._lanes.rows[self._lane]
        scenario = lanes.scenarios[self._lane]
        assert scenario is not None
        first_us = scenario.machine.t_on_us, scenario.machine.t_period_us
        now_us, feed_um_s = row["setting_us"].tolist(), float(row["feed_um_s"])
        return as_action(lanes.family, self._controller, self._command, first_us, now_us, feed_um_s)

    def after_window(self) -> FeedCommand:
        """Show it the window that the lane has just had; returns the command for the next one."""
        lanes, row = self._lanes, self._lanes.rows[self._lane]
        window = lanes.fleet.plants[self._lane].window()
        if window.pulses == WINDOW_PULSES:
            path_um = float(row["before_um"] + row["path_um"])
            seen = WindowObservation.of(
                window, window.start_ns + window.duration_ns, float(row["feed_um_s"]), path_um
            )
            if isinstance(self._controller, SeesTruth):
                self._controller.see(window)
            self._command = check_command(self._controller.name, self._controller.update(seen))
        return self._command if self._leg == lanes.leg[self._lane] else self.begin()
