"""Windows kept in full: bounded, all of them around events, the same for the same cut."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edmsim.recording.stores import (
    AROUND,
    BLOCKS,
    NOTHING,
    REGULAR,
    RETRACT,
    TURN,
    Closeups,
    turns_um,
)


def show(closeups: Closeups, start: int, stop: int, happened: dict[int, int]) -> None:
    for i in range(start, stop):
        row = closeups.row
        row["t_s"], row["path_um"] = 0.5 * (i + 1), 2.0 * i
        closeups.keep(happened.get(i, NOTHING))


def stored_rows(closeups: Closeups) -> np.ndarray:
    return np.round(closeups.table()["t_s"] / 0.5 - 1).astype(int)


def test_everything_around_an_event_is_stored() -> None:
    closeups = Closeups(3, 8, 1)
    show(closeups, 0, 5000, {2000: RETRACT, 3333: TURN})
    found = set(stored_rows(closeups))
    for event in (2000, 3333):
        assert set(range(event - AROUND, event + AROUND + 1)) <= found
    assert set(range(5000 - AROUND, 5000)) <= found  # and how the cut ended
    assert set(range(0, 5000, closeups.stride)) <= found
    assert closeups.stride == 16
    assert len(found) <= REGULAR + 2 * (2 * AROUND + 1) + AROUND + 1


def test_an_event_in_the_first_window_has_none_before() -> None:
    closeups = Closeups(3, 8, 1)
    show(closeups, 0, 10, {0: TURN})
    np.testing.assert_array_equal(stored_rows(closeups), np.arange(10))


@pytest.mark.slow
@settings(max_examples=20)
@given(every=st.integers(1, 60), windows=st.integers(0, 12_000))
def test_no_number_of_events_makes_it_grow_beyond_bounds(every: int, windows: int) -> None:
    closeups = Closeups(1, 1, 0)
    show(closeups, 0, windows, dict.fromkeys(range(0, windows, every), RETRACT))
    found = stored_rows(closeups)
    assert len(found) <= REGULAR + BLOCKS * (2 * AROUND + 1) + AROUND + 1
    assert np.all(np.diff(found) > 0)


@pytest.mark.slow
@settings(max_examples=20)
@given(before=st.integers(0, 2500), after=st.integers(0, 400), every=st.integers(1, 90))
def test_resuming_keeps_the_same(before: int, after: int, every: int) -> None:
    happened = {i: (RETRACT, TURN)[i % 2] for i in range(0, before + after, every)}
    whole, first, resumed = (Closeups(1, 2, 0) for _ in range(3))
    show(whole, 0, before + after, happened)
    show(first, 0, before, happened)
    state = first.snapshot()
    show(first, before, before + 5, {before: TURN})  # a snapshot is a copy
    resumed.restore(state)
    show(resumed, before, before + after, happened)
    np.testing.assert_array_equal(resumed.table(), whole.table())


def test_a_snapshot_of_another_resolution_is_refused() -> None:
    with pytest.raises(ValueError, match="does not fit"):
        Closeups(3, 8, 1).restore(Closeups(3, 16, 1).snapshot())


def test_corners_of_a_path() -> None:
    arc = [(1000 + round(500 * np.sin(a)), round(500 * (1 - np.cos(a)))) for a in np.linspace(0, np.pi / 2, 20)]
    points = np.array([(0, 0), (1000, 0), *arc, (1500, 2000), (1500, 2000), (0, 2000)], np.int64)
    (start, corner) = turns_um(points)  # neither the arc's chords nor a point said twice
    assert start == 0.0
    assert corner == pytest.approx(1000 + 500 * np.pi / 2 + 1500, abs=2)
    assert turns_um(np.array([(5, 5)], np.int64)) == [0.0]
