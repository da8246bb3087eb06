"""The sine table of T-72: its accuracy, and the search for a direction."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmsim.controllers.mcu.firmware.poscal import velocm
from edmsim.controllers.mcu.firmware.sine_table import SINE, cosine, direction, look_up, sine
from edmsim.errors import InputError


def test_255_entries_of_8_bits_are_right_to_half_a_percent():  # T-72, T-A7
    assert len(SINE) == 255
    angles = np.linspace(0, math.pi / 2, 200_001)
    nearest = np.rint(angles / (math.pi / 2) * 254).astype(int)
    error = 100 * np.abs(np.frombuffer(SINE, np.uint8)[nearest] / 255 - np.sin(angles)).max()
    assert 0.49 < error <= 0.5


def test_sine_and_cosine_are_mirrored_and_rise():  # T-72
    assert (sine(0), sine(254), cosine(0), cosine(254)) == (0, 255, 255, 0)
    assert all(sine(i) <= sine(i + 1) for i in range(254))
    assert all(cosine(i) == sine(254 - i) for i in range(255))


def test_the_search_finds_the_nearest_entry_of_every_8_bit_vector():  # T-72
    entries = np.array([(cosine(i), sine(i)) for i in range(255)])
    for x in range(0, 256, 3):
        for y in range(1, 256, 2):
            aside = np.abs(y * entries[:, 0] - x * entries[:, 1])
            assert aside[direction(x, y)] == aside.min()


@given(st.integers(0, 65_535), st.integers(0, 65_535))
def test_a_direction_is_right_to_a_degree_whatever_its_length(x, y):  # T-72, T-63
    found = look_up(x, y, 1, -1)
    if max(x, y) < 128:
        return
    wanted = math.degrees(math.atan2(y, x))
    # 0.45 degrees are lost by REDUC (T-G11), 0.18 by half an entry, 0.16 by the rounding of sine and cosine
    assert math.degrees(math.atan2(found.y, found.x)) == pytest.approx(wanted, abs=0.8)
    assert math.hypot(found.x, found.y) == pytest.approx(255, rel=0.004)


def test_axis_speeds_from_the_table():  # T-72, T-68
    assert velocm(look_up(3000, 4000, 1, -1), 127) == (76, -101)
    assert velocm(look_up(0, 900, -1, 1), 64) == (0, 64)
    assert velocm(look_up(0, 0, 1, 1), 127) == (0, 0)


def test_the_table_takes_8_bits():
    with pytest.raises(InputError, match=r"0\.\.255"):
        direction(256, 1)
