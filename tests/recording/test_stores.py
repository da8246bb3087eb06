"""Windows and frames that are kept: bounded, all windows around events, the same for the same cut."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edmsim.recording.windows import AROUND, BLOCKS, NOTHING, REGULAR, RETRACT, TURN, Closeups, Frames, turns_um


def show(closeups, start, stop, happened):
    for i in range(start, stop):
        row = closeups.row
        row["t_s"], row["path_um"] = 0.5 * (i + 1), 2.0 * i
        closeups.keep(happened.get(i, NOTHING))


def stored_rows(closeups):
    return np.round(closeups.table()["t_s"] / 0.5 - 1).astype(int)


def test_everything_around_an_event_is_stored():
    closeups = Closeups(3, 8, 1)
    show(closeups, 0, 5000, {2000: RETRACT, 3333: TURN})
    found = set(stored_rows(closeups))
    for event in (2000, 3333):
        assert set(range(event - AROUND, event + AROUND + 1)) <= found
    assert set(range(5000 - AROUND, 5000)) <= found  # and how the cut ended
    assert set(range(0, 5000, closeups.stride)) <= found
    assert closeups.stride == 16
    assert len(found) <= REGULAR + 2 * (2 * AROUND + 1) + AROUND + 1


def test_an_event_in_the_first_window_has_none_before():
    closeups = Closeups(3, 8, 1)
    show(closeups, 0, 10, {0: TURN})
    np.testing.assert_array_equal(stored_rows(closeups), np.arange(10))


@pytest.mark.slow
@settings(max_examples=20)
@given(every=st.integers(1, 60), windows=st.integers(0, 12_000))
def test_no_number_of_events_makes_it_grow_beyond_bounds(every, windows):
    closeups = Closeups(1, 1, 0)
    show(closeups, 0, windows, dict.fromkeys(range(0, windows, every), RETRACT))
    found = stored_rows(closeups)
    assert len(found) <= REGULAR + BLOCKS * (2 * AROUND + 1) + AROUND + 1
    assert np.all(np.diff(found) > 0)


@pytest.mark.slow
@settings(max_examples=20)
@given(before=st.integers(0, 2500), after=st.integers(0, 400), every=st.integers(1, 90))
def test_resuming_keeps_the_same(before, after, every):
    happened = {i: (RETRACT, TURN)[i % 2] for i in range(0, before + after, every)}
    whole, first, resumed = (Closeups(1, 2, 0) for _ in range(3))
    show(whole, 0, before + after, happened)
    show(first, 0, before, happened)
    state = first.snapshot()
    show(first, before, before + 5, {before: TURN})  # a snapshot is a copy
    resumed.restore(state)
    show(resumed, before, before + after, happened)
    np.testing.assert_array_equal(resumed.table(), whole.table())


def test_corners_of_a_path():
    arc = [(1000 + round(500 * np.sin(a)), round(500 * (1 - np.cos(a)))) for a in np.linspace(0, np.pi / 2, 20)]
    points = np.array([(0, 0), (1000, 0), *arc, (1500, 2000), (1500, 2000), (0, 2000)], np.int64)
    (start, corner) = turns_um(points)  # neither the arc's chords nor a point said twice
    assert start == 0.0
    assert corner == pytest.approx(1000 + 500 * np.pi / 2 + 1500, abs=2)
    assert turns_um(np.array([(5, 5)], np.int64)) == [0.0]


# The wire's frames: never more than fit, evenly spread, the same for the same cut.


def offer(frames, start, stop):
    for i in range(start, stop):
        deflection, coverage = i + np.tile([0.0, 0.25], (frames.n_slices, 1)), np.full(frames.n_slices, 1 / (i + 1))
        frames.offer(0.5 * i, (10.0 * i, -i), 3.0 * i, deflection, coverage)


@pytest.mark.slow
@given(capacity=st.integers(2, 40), windows=st.integers(0, 700))
def test_stored_windows_are_the_multiples_of_the_stride(capacity, windows):
    frames = Frames(3, capacity)
    offer(frames, 0, windows)
    assert len(frames) <= capacity
    stored = np.arange(0, windows, frames.stride)
    np.testing.assert_array_equal(frames.rows["t_s"], 0.5 * stored)
    np.testing.assert_array_equal(frames.rows["guides_um"], np.column_stack([10.0 * stored, -stored]))
    np.testing.assert_array_equal(frames.rows["path_um"], 3.0 * stored)
    assert frames.rows["deflection_um"].shape == (len(stored), 3, 2)
    np.testing.assert_array_equal(frames.rows["deflection_um"][:, 1, 1], stored + 0.25)
    np.testing.assert_allclose(frames.rows["coverage"][:, 2], 1 / (stored + 1), rtol=1e-6)
    assert windows < capacity or len(frames) >= capacity // 2


@pytest.mark.slow
@given(before=st.integers(0, 300), after=st.integers(0, 300))
def test_resuming_keeps_the_same_frames(before, after):
    whole, first, resumed = Frames(2, 16), Frames(2, 16), Frames(2, 16)
    offer(whole, 0, before + after)
    offer(first, 0, before)
    state = first.snapshot()
    offer(first, before, before + 1)
    resumed.restore(state)
    offer(resumed, before, before + after)
    assert resumed.stride == whole.stride
    np.testing.assert_array_equal(resumed.rows["t_s"], whole.rows["t_s"])
    np.testing.assert_array_equal(resumed.rows["deflection_um"], whole.rows["deflection_um"])


def test_what_does_not_fit_is_refused():
    with pytest.raises(ValueError, match="capacity of 1"):
        Frames(3, 1)
    other = Frames(4, 16)
    offer(other, 0, 3)
    with pytest.raises(ValueError, match="does not fit"):
        Frames(3, 16).restore(other.snapshot())
