"""The constant feed of trims: slowed by shorts, backwards from one that stays."""

from __future__ import annotations

import pytest

from edmsim.controllers import WindowObservation, from_text
from edmsim.errors import InputError


def window(short: int, time_s: float = 0.0) -> WindowObservation:
    return WindowObservation(time_s, 0.02, short, 50, 20.0, 1.0, 2.0, 0.0, 0.0)


def test_it_keeps_its_feed_and_shorts_slow_it_down() -> None:
    trim = from_text("trim:feed_um_s=60,stop_share=0.4,filter_s=0")
    assert trim.reset(400.0).feed_um_s == 60.0
    assert trim.update(window(0)).feed_um_s == 60.0
    assert trim.update(window(51)).feed_um_s == pytest.approx(30.0)
    assert trim.update(window(102)).feed_um_s == 0.0
    assert trim.update(window(0)).feed_um_s == 60.0


def test_it_runs_back_from_a_short_that_stays_and_continues_from_a_snapshot() -> None:
    trim = from_text("trim:feed_um_s=60")
    trim.reset(400.0)
    feeds = [trim.update(window(255)).feed_um_s for _ in range(12)]
    assert feeds[0] > 0 > feeds[-1]
    again = from_text("trim:feed_um_s=60")
    again.reset(400.0)
    again.restore(trim.snapshot())
    assert again.update(window(10)) == trim.update(window(10))


def test_a_feed_beyond_the_machine_is_refused() -> None:
    with pytest.raises(InputError, match=r"feed_um_s of the trim controller is 60\.0 um/s"):
        from_text("trim:feed_um_s=60").reset(33.3)
