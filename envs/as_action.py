"""What a feed controller commands, as an action of an environment."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers import FeedController
from edmsim.controllers.protocols import FeedCommand
from edmsim.envs.task import Family
from edmsim.errors import InputError


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
