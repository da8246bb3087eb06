"""What a controller commands, as an action: the environment that is given it runs what was commanded."""

from dataclasses import dataclass

import numpy as np
import pytest

from edmsim.controllers import FeedCommand, make
from edmsim.controllers.feed.laws import FixedController
from edmsim.controllers.user_controllers import rehearsed
from edmsim.envs.episode import as_action
from edmsim.envs.gap_servo import target_of
from edmsim.envs.registry import make_family
from edmsim.errors import InputError

FIRST_US, NOW_US = (30.0, 100.0), (15.0, 200.0)
EXPECTED = FeedCommand(9.0, None, 20.0, 120.0, offset_um=-6.0)


def action_of(env_id, controller="set-point", command=EXPECTED, feed_um_s=8.0, **arguments):
    family = make_family(env_id, **arguments)
    return family, as_action(family, make(controller), command, FIRST_US, NOW_US, feed_um_s).tolist()


@pytest.mark.parametrize("env_id", ["edmsim/Corner-v3", "edmsim/ThinWire-v1", "edmsim/Trim-v1"])
def test_knobs_and_offset_are_what_the_environment_reads(env_id):
    family, action = action_of(env_id, offset_um=24.0)
    found = family.setting_us(np.array(FIRST_US), np.array(action[1:-1]))
    # a task that leaves the on-time alone keeps the first
    assert found[0] == pytest.approx(20.0 if "on_time" in family.knobs else 30.0, rel=1e-6)
    assert found[1] / found[0] == pytest.approx(120.0 / 20.0, rel=1e-6)
    assert action[-1] == pytest.approx(-0.25)


def test_a_servo_gets_the_target_that_the_controller_holds():
    family, action = action_of("edmsim/Corner-v3")
    assert target_of(action[0], family.servo_target_share) == pytest.approx(make("set-point").open_target_share)
    with pytest.raises(InputError, match="fixed holds no share of open pulses"):
        action_of("edmsim/Corner-v3", "fixed")


@pytest.mark.parametrize(("action", "expected"), [("speed", 9.0), ("change", 1.0)])
def test_a_feed_is_commanded_as_itself_or_as_a_change(action, expected):
    plain = FeedCommand(9.0)
    family, found = action_of("edmsim/GapFeed-v2", "fixed", plain, action=action, knobs=("period_ratio", "on_time"))
    scale = family.max_feed_um_s if action == "speed" else family.max_change_um_s
    assert found[0] == pytest.approx(expected / scale)


@dataclass
class Cautious(FixedController):
    """A law that turns a knob once a wire is lost."""

    def wire_lost(self):
        return FeedCommand(5.0, t_period_us=900.0)


def test_it_is_known_before_what_a_law_commands_after_a_lost_wire():
    assert 900.0 in {command.t_period_us for command in rehearsed(lambda: Cautious(5.0), 33.0)}


def test_knobs_and_offsets_that_are_not_there_are_refused():
    lateral = FeedCommand(9.0, None, *FIRST_US, offset_um=1.0)
    for command, named in ((EXPECTED, "turns the generator's knobs"), (lateral, "commands an offset")):
        with pytest.raises(InputError, match=f"{named}, and this environment has none"):
            action_of("edmsim/GapFeed-v2", command=command)


def test_actions_end_at_one():
    far = FeedCommand(1e6, None, 3000.0, 90_000.0, offset_um=1e3)
    _, action = action_of("edmsim/Trim-v1", command=far)
    assert action == [1.0] * len(action)
