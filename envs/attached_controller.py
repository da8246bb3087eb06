"""A feed controller that watches a sub-environment: it sees what a machine shows, and says what it would command."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers import FeedController, SeesTruth
from edmsim.controllers.protocols import FeedCommand, SeesBreaks, check_command, tell
from edmsim.envs.task import Family
from edmsim.errors import InputError
from edmsim.machine.setting import WINDOW_PULSES

if TYPE_CHECKING:
    from edmsim.envs.sub_envs import SubEnvs

def as_action(
    family: Family, controller: FeedController, command: FeedCommand, first_us: Sequence[float],
    now_us: Sequence[float], feed_um_s: float,
) -> NDArray[np.float32]:
    """Return the action within -1..1 for what a controller wants; refuse where the environment has none."""
    if family.action == "servo":
        low, high = family.servo_target_share
        entries = [2.0 * (target_share(controller) - low) / (high - low) - 1.0]
    elif family.action == "speed":
        entries = [command.feed_um_s / family.max_feed_um_s]
    else:
        entries = [(command.feed_um_s - feed_um_s) / family.max_change_um_s]
    on_us, period_us = (
        now if chosen is None else chosen
        for chosen, now in zip((command.t_on_us, command.t_period_us), now_us, strict=True)
    )
    octaves = {"on_time": math.log2(on_us / first_us[0]), "period": math.log2(period_us / first_us[1])}
    octaves["duty_factor"] = octaves["period"] - octaves["on_time"]
    if not family.knobs and any(octaves.values()):
        raise InputError("a controller turns the generator's knobs, and this environment has none: leave it out")
    entries += [octaves[name] / family.setting_octaves for name in family.knobs]
    if family.offset_um is not None:
        entries.append(command.offset_um / family.offset_um)
    return np.clip(np.array(entries, np.float32), -1.0, 1.0)


def target_share(controller: FeedController) -> float:
    """Return the share of open pulses that a controller holds; raises `InputError` where it holds none."""
    target: float | None = getattr(controller, "open_target_share", None)
    if target is None:
        raise InputError(f"{controller.name} holds no share of open pulses: the environment's servo asks for one")
    return target


class AttachedController:
    """A feed controller that is shown every window until `stop`; whether its commands are run is up to the caller."""

    def __init__(self, sub_envs: SubEnvs, index: int, controller: FeedController) -> None:
        self._sub_envs, self._index, self._controller = sub_envs, index, controller
        self._leg = self._lost = 0
        self._command = FeedCommand(0.0)
        sub_envs.watchers[index].append(self._see)

    def stop(self) -> None:
        """Look no more."""
        self._sub_envs.watchers[self._index].remove(self._see)

    def begin(self) -> FeedCommand:
        """Begin the leg that the sub-environment is on; returns the command for its first window."""
        sub_envs, index = self._sub_envs, self._index
        scenario = sub_envs.scenarios[index]
        assert scenario is not None
        self._leg, self._lost = sub_envs.leg[index], int(sub_envs.rows[index]["wires_lost"])
        start_um = float(sub_envs.rows[index]["before_um"])
        tell(self._controller, scenario.machine, scenario.legs_um[self._leg], start_um)
        self._take(self._controller.reset(sub_envs.family.greatest_feed_um_s))
        return self._command

    def command(self) -> FeedCommand:
        """Return what it commands for the next window, after all that the sub-environment has had."""
        sub_envs, index, controller = self._sub_envs, self._index, self._controller
        if self._leg != sub_envs.leg[index]:
            return self.begin()
        if self._lost != sub_envs.rows[index]["wires_lost"]:
            self._lost = int(sub_envs.rows[index]["wires_lost"])
            if isinstance(controller, SeesBreaks):
                self._take(controller.wire_lost())
            else:
                self._take(controller.reset(sub_envs.family.greatest_feed_um_s))
        return self._command

    def action(self) -> NDArray[np.float32]:
        """Return the action of the environment that commands what it wants: see `as_action`."""
        sub_envs, row = self._sub_envs, self._sub_envs.rows[self._index]
        scenario = sub_envs.scenarios[self._index]
        assert scenario is not None
        first_us = scenario.machine.t_on_us, scenario.machine.t_period_us
        now_us, feed_um_s = row["setting_us"].tolist(), float(row["feed_um_s"])
        return as_action(sub_envs.family, self._controller, self.command(), first_us, now_us, feed_um_s)

    def _see(self) -> None:
        """Show it the window that the sub-environment has just had."""
        self.command()  # a leg or wire that the last window ended is over before this one
        window = self._sub_envs.fleet.plants[self._index].window()
        if window.pulses != WINDOW_PULSES:
            return
        if isinstance(self._controller, SeesTruth):
            self._controller.see(window)
        self._take(self._controller.update(self._sub_envs.observation(self._index)))

    def _take(self, command: FeedCommand) -> None:
        self._command = check_command(self._controller.name, command)
