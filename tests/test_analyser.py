"""The pulse analyser's counters and handshake."""

import json

import pytest

from edmsim.controllers.pulse_counters import PulseAnalyser
from edmsim.errors import InputError


def test_counting_a_whole_cycle_is_clocking_its_pulses():  # T-39, T-40
    clocked, counted = PulseAnalyser(), PulseAnalyser()
    for sc, op in [(True, False)] * 40 + [(False, True)] * 77 + [(False, False)] * 138:
        clocked.clock(sc, op)
    assert not counted.buffer_full
    counted.count_window(40, 77)
    assert clocked.snapshot() == counted.snapshot()
    assert counted.buffer_full
    assert (counted.read(), counted.buffer_full) == ((40, 77), False)


def test_unread_result_stays_and_the_new_one_is_missed():  # T-44
    analyser = PulseAnalyser()
    analyser.count_window(1, 2)
    analyser.count_window(3, 4)
    analyser.count_window(5, 6)
    assert analyser.missed == 2
    assert analyser.read() == (1, 2)
    analyser.count_window(7, 8)
    assert analyser.missed == 2
    assert analyser.read() == (7, 8)
    assert analyser.read() == (7, 8)


def test_a_snapshot_continues_identically():
    analyser = PulseAnalyser()
    analyser.count_window(9, 99)
    analyser.count_window(9, 99)
    analyser.clock(True, False)
    copy = PulseAnalyser()
    copy.restore(json.loads(json.dumps(analyser.snapshot())))
    for _ in range(254):
        analyser.clock(False, True)
        copy.clock(False, True)
    assert copy.snapshot() == analyser.snapshot()
    assert copy.missed == 2
    assert copy.read() == analyser.read() == (9, 99)


def test_pulses_that_cannot_be_are_refused():  # T-38, T-41
    analyser = PulseAnalyser()
    with pytest.raises(InputError, match="short and open at once"):
        analyser.clock(True, True)
    for short, open_ in [(-1, 0), (0, -1), (128, 128)]:
        with pytest.raises(InputError, match=f"{short} short and {open_} open pulses"):
            analyser.count_window(short, open_)
    analyser.clock(False, False)
    with pytest.raises(InputError, match="not after 1 pulses"):
        analyser.count_window(0, 0)
