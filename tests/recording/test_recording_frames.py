"""The wire's frames: never more than fit, evenly spread, the same for the same cut."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmsim.recording import Frames


def offer(frames: Frames, start: int, stop: int) -> None:
    for i in range(start, stop):
        deflection, coverage = i + np.tile([0.0, 0.25], (frames.n_slices, 1)), np.full(frames.n_slices, 1 / (i + 1))
        frames.offer(0.5 * i, 10.0 * i, -i, 3.0 * i, deflection, coverage)


@pytest.mark.slow
@given(capacity=st.integers(2, 40), windows=st.integers(0, 700))
def test_stored_windows_are_the_multiples_of_the_stride(capacity: int, windows: int) -> None:
    frames = Frames(3, capacity)
    offer(frames, 0, windows)
    assert len(frames) <= capacity
    stored = np.arange(0, windows, frames.stride)
    np.testing.assert_array_equal(frames.t_s, 0.5 * stored)
    np.testing.assert_array_equal(frames.guides_um, np.column_stack([10.0 * stored, -stored]))
    np.testing.assert_array_equal(frames.path_um, 3.0 * stored)
    assert frames.deflection_um.shape == (len(stored), 3, 2)
    np.testing.assert_array_equal(frames.deflection_um[:, 1, 1], stored + 0.25)
    np.testing.assert_allclose(frames.coverage[:, 2], 1 / (stored + 1), rtol=1e-6)
    assert windows < capacity or len(frames) >= capacity // 2


@pytest.mark.slow
@given(before=st.integers(0, 300), after=st.integers(0, 300))
def test_resuming_keeps_the_same_frames(before: int, after: int) -> None:
    whole, first, resumed = Frames(2, 16), Frames(2, 16), Frames(2, 16)
    offer(whole, 0, before + after)
    offer(first, 0, before)
    state = first.snapshot()
    offer(first, before, before + 1)
    resumed.restore(state)
    offer(resumed, before, before + after)
    assert resumed.stride == whole.stride
    np.testing.assert_array_equal(resumed.t_s, whole.t_s)
    np.testing.assert_array_equal(resumed.deflection_um, whole.deflection_um)


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="capacity of 1"):
        Frames(3, 1)
    other = Frames(4, 16)
    offer(other, 0, 3)
    with pytest.raises(ValueError, match="does not fit"):
        Frames(3, 16).restore(other.snapshot())
