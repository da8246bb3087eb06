"""Feed controllers: what every one promises, and how the count controller behaves on an algebraic gap."""

import math

import numpy as np
import pytest

from edmsim import controllers
from edmsim.controllers import FeedCommand, WindowObservation
from edmsim.errors import InputError

MAX_FEED = 33.3375
WINDOW_S = 0.0255


class Gap:
    """A gap that widens by removal and narrows by feed, with the shares a wire-EDM gap shows.

    No discharges, no wire: open pulses rise with the gap (30 % at 17 um, 50 % at 19, 74 % at 25), shorts rise
    steeply below 8 um, and sparks remove in proportion to their share. `stuck_below_um` forces a short until
    the gap is wider.
    """

    def __init__(self, removal_um_s=40.0, gap_um=30.0, window_s=WINDOW_S, seed=1):
        self.removal_um_s, self.gap_um, self.window_s = removal_um_s, gap_um, window_s
        self.path_um = self.time_s = self.stuck_below_um = 0.0
        self._rng = np.random.default_rng(seed)

    def shares(self):
        if self.gap_um < self.stuck_below_um:
            return 1.0, 0.0
        self.stuck_below_um = 0.0
        short = 1 / (1 + math.exp((self.gap_um - 7) / 0.6))
        return short, (1 - short) * float(np.interp(self.gap_um, [10, 17, 19, 25, 40], [0, 0.3, 0.5, 0.74, 1]))

    def window(self, feed_um_s):
        short, open_ = self.shares()
        counts = self._rng.multinomial(255, [short, open_, max(1 - short - open_, 0.0)])
        self.gap_um += (self.removal_um_s * counts[2] / 255 - feed_um_s) * self.window_s
        self.gap_um = min(max(self.gap_um, 0.0), 80.0)
        self.path_um += feed_um_s * self.window_s
        self.time_s += self.window_s
        return WindowObservation(
            self.time_s, self.window_s, int(counts[0]), int(counts[1]), 40.0, 2.0, 9.0, feed_um_s, self.path_um
        )


def cut(controller, gap, seconds, command):
    """Run the loop; return the windows and the commands that answered them."""
    windows, commands = [], [command]
    for _ in range(round(seconds / gap.window_s)):
        windows.append(gap.window(commands[-1].feed_um_s))
        commands.append(controller.update(windows[-1]))
    return windows, commands[1:]


def started():
    controller = controllers.make("counts")
    return controller, controller.reset(MAX_FEED)


def under_way(seconds):
    """A controller that has cut for some time: it, its gap, and its last command."""
    controller, command = started()
    gap = Gap()
    return controller, gap, cut(controller, gap, seconds, command)[1][-1]


@pytest.mark.slow
@pytest.mark.parametrize("window_s", [0.00051, 0.0255, 0.255])
@pytest.mark.parametrize("removal", [40.0, 20.0, 8.0])
def test_counts_settles_without_hunting(removal, window_s):  # T-15
    controller, command = started()
    seconds = 15 if window_s < 0.001 else 60
    windows, commands = cut(controller, Gap(removal, window_s=window_s), seconds, command)
    settled = len(commands) * 2 // 3
    feeds = np.array([c.feed_um_s for c in commands[settled:]])
    assert 0.7 * removal < feeds.mean() < removal
    assert feeds.std() < 0.5 + 0.05 * feeds.mean()
    short = np.mean([w.short for w in windows[settled:]]) / 255
    open_ = np.mean([w.open for w in windows[settled:]]) / 255
    assert short + open_ < 0.3  # both small
    if feeds.max() < MAX_FEED:  # what the law holds, as long as the machine can run that fast
        held = open_ - controller.short_weight * short
        assert held == pytest.approx(controller.open_target_share, abs=0.02)


def test_counts_survives_a_halved_removal():  # T-15
    controller, gap, command = under_way(20)
    gap.removal_um_s = 20.0
    windows, commands = cut(controller, gap, 20, command)
    assert all(c.alarm is None for c in commands)
    assert sum(w.short > 127 for w in windows) < 20
    assert 0.7 * gap.removal_um_s < np.mean([c.feed_um_s for c in commands[-100:]]) < gap.removal_um_s


def test_counts_runs_through_air_at_full_feed_and_brakes_at_the_metal():  # T-15
    controller, command = started()
    gap = Gap(gap_um=80.0)
    windows, commands = cut(controller, gap, 8, command)
    assert commands[20].feed_um_s == MAX_FEED
    assert sum(w.short for w in windows) < 255


def test_counts_retracts_from_a_short_and_returns_slowly():
    controller, gap, command = under_way(20)
    place = gap.path_um
    gap.stuck_below_um = 30.0
    windows, commands = cut(controller, gap, 20, command)
    back = [i for i, c in enumerate(commands) if c.feed_um_s < 0]
    assert back
    assert min(w.path_um for w in windows) < place - 10
    returning = [c.feed_um_s for c, w in zip(commands, windows, strict=True) if w.path_um < place and w.short == 0]
    assert max(returning) <= 10.0
    assert all(c.alarm is None for c in commands)
    assert np.mean([c.feed_um_s for c in commands[-100:]]) > 0.7 * gap.removal_um_s


def test_counts_gives_up_where_a_short_never_clears():
    controller, gap, command = under_way(10)
    place = gap.path_um
    gap.stuck_below_um = math.inf
    windows, commands = cut(controller, gap, 30, command)
    alarms = [i for i, c in enumerate(commands) if c.alarm]
    assert windows[alarms[0]].time_s < 10 + 15
    assert commands[-1] == FeedCommand(0.0, "persistent short")
    assert min(w.path_um for w in windows) >= place - 60 - 1e-9
    assert min(w.path_um for w in windows) < place - 55


def test_counts_gives_up_where_the_same_place_shorts_again_and_again():
    controller, gap, command = under_way(10)
    place, shorts = gap.path_um, 0
    for _ in range(10_000):
        if command.alarm:
            break
        if gap.path_um > place and not gap.stuck_below_um:
            gap.stuck_below_um = 40.0
            shorts += 1
        command = controller.update(gap.window(command.feed_um_s))
    assert command.alarm == "persistent short"
    assert shorts == 9


def test_counts_forgets_old_shorts_once_it_has_moved_on():
    controller, command = started()
    gap = Gap()
    for i in range(1, 25):
        while gap.path_um < 40 * i:
            command = controller.update(gap.window(command.feed_um_s))
            assert command.alarm is None
        gap.stuck_below_um = 30.0
        command = controller.update(gap.window(command.feed_um_s))


@pytest.mark.parametrize(("name", "parameters", "words"), [
    ("pid", {}, "no feed controller 'pid'; choose one of counts, fixed"),
    ("fixed", {"feed": 3.0}, "no parameter 'feed'; it has feed_um_s"),
    ("fixed", {"feed_um_s": -1.0}, "feed_um_s of the fixed controller must be a number of 0 or more, not -1.0"),
    ("fixed", {"feed_um_s": math.nan}, "must be a number of 0 or more, not nan"),
    ("fixed", {"feed_um_s": 10**400}, "must be a number of 0 or more, not 1000"),
    ("counts", {"_state": 1.0}, "no parameter '_state'"),
    ("counts", {"air_share": 1.5}, "air_share of the counts controller must be a number from 0 to 1, not 1.5"),
    ("sato", {"slow_factor": 0.9}, "slow_factor of the sato controller must be a number of 1 or more, not 0.9"),
    ("trim", {"corner_factor": 0}, "corner_factor of the trim controller must be a number of 1 or more, not 0"),
    ("climbing-hold", {"patience_factor": 0.5}, "must be a number of 1 or more, not 0.5"),
    ("climb", {"back_factor": 0.7}, "back_factor of the climb controller must be a number of 1 or more, not 0.7"),
    ("sato", {"longest_factor": 0.5}, "longest_factor of the sato controller must be a number of 1 or more, not 0.5"),
    ("sato", {"shortest_factor": 2}, "shortest_factor of the sato controller must be a number from 0 to 1, not 2"),
    ("counts", {"max_tries": 1.5}, "max_tries of the counts controller must be a whole number of 0 or more, not 1.5"),
    ("counts", {"dwell_s": "1"}, "dwell_s of the counts controller must be a number of 0 or more, not '1'"),
])  # fmt: skip
def test_what_cannot_be_made_is_refused(name, parameters, words):
    with pytest.raises(InputError) as refused:
        controllers.make(name, **parameters)
    assert words in str(refused.value)


@pytest.mark.parametrize(("name", "parameter"), [
    ("fixed", "feed_um_s"), ("counts", "retract_feed_um_s"), ("trim", "feed_um_s"), ("voltage", "start_feed_um_s"),
    ("delay", "start_feed_um_s"), ("fuzzy", "start_feed_um_s"), ("adaptive-off-time", "start_feed_um_s"),
    ("adaptive-hold", "retract_feed_um_s"),
])  # fmt: skip
def test_feeds_beyond_the_machine_are_refused(name, parameter):  # T-A1
    with pytest.raises(InputError, match=rf"{parameter} of the {name} controller is 40\.0 um/s"):
        controllers.make(name, **{parameter: 40.0}).reset(MAX_FEED)
