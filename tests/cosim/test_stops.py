"""Why the machine stops: one judge and one limit switch for cuts, episodes and the terminal."""

from __future__ import annotations

import itertools

import pytest

from edmsim.cosim.stops import WORDS, StopCause, judge, switches_open

ORDER = (
    StopCause.WIRE_BREAK, StopCause.OUT_OF_RANGE, StopCause.LIMIT_SWITCH, StopCause.DRIVE_TRIP,
    StopCause.PERSISTENT_SHORT, StopCause.TIME_LIMIT, StopCause.FINISHED,
)  # fmt: skip


def test_of_several_causes_the_first_in_order_counts() -> None:
    for flags in itertools.product([False, True], repeat=7):
        causes = [cause for cause, flag in zip(ORDER, flags, strict=True) if flag]
        assert judge(*flags) == (causes[0] if causes else StopCause.RUNNING)


@pytest.mark.parametrize(
    ("place_um", "open_"), [(-2.1, -1), (-2.0, 0), (0.0, 0), (30_000.0, 0), (65_002.0, 0), (65_002.1, 1)]
)
def test_a_switch_opens_one_step_beyond_its_end(place_um: float, open_: int) -> None:
    assert switches_open(place_um, 65_000.0, 2.0) == open_


def test_every_cause_has_its_words() -> None:
    assert set(WORDS) == set(StopCause)
    reports = [words.report for words in WORDS.values()]
    assert len(set(reports)) == len(reports)
