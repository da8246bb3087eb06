"""POSCAL, VELOCM, POSITI and the integer routines below them against the worked numbers of the requirements."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmsim.controllers.mcu.firmware import poscal as routines
from edmsim.controllers.mcu.firmware.poscal import SINE, look_up, poscal, positi, resolve, velocm
from edmsim.controllers.planner.kinds import lengthened
from edmsim.errors import InputError


def ends(dx, dy):
    """A position and a target on the table that differ by a displacement."""
    position = (max(-dx, 0), max(-dy, 0))
    return position, (position[0] + dx, position[1] + dy)


@pytest.mark.parametrize(("dx", "dy", "v", "halvings", "reduced", "length", "vx", "vy"), [
    (3, 4, 127, 0, (3, 4), 5, 76, 101), (3000, 4000, 127, 5, (93, 125), 156, 75, 101),
    (1, 1, 127, 0, (1, 1), 2, 63, 63), (255, 0, 127, 0, (255, 0), 255, 127, 0),
    (181, 181, 127, 0, (181, 181), 256, 89, 89), (182, 182, 127, 1, (91, 91), 129, 89, 89),
    (255, 255, 127, 1, (127, 127), 180, 89, 89), (10_000, 100, 127, 6, (156, 1), 156, 127, 1),
    (60_000, 200, 127, 8, (234, 0), 234, 127, 0), (-20_000, 12_345, 64, 7, (156, 96), 183, -54, 33),
    (255, 1, 1, 0, (255, 1), 255, 1, 1), (0, 0, 50, 0, (0, 0), 0, 0, 0),
    (65_535, 65_535, 127, 9, (127, 127), 180, 89, 89), (300, -400, 10, 1, (150, 200), 250, 6, -8),
])  # fmt: skip
def test_worked_vectors(dx, dy, v, halvings, reduced, length, vx, vy):  # T-68, T-69, T-G7, T-G8
    found = resolve(abs(dx), abs(dy), 1, 1)
    assert (found.halvings, (found.x, found.y), found.length) == (halvings, reduced, length)
    assert poscal(*ends(dx, dy), v) == (vx, vy)


@pytest.mark.parametrize(("side", "speed"), [(182, 856), (200, 211), (220, 157), (255, 127)])
def test_literal_wrap_makes_nonsense_of_the_length(side, speed):  # T-G6
    assert poscal((0, 0), (side, side), 127, literal_wrap=True) == (speed, speed)
    x, y = poscal((0, 0), (side, side), 127)
    assert x == y == pytest.approx(127 / math.sqrt(2), abs=1)
    assert poscal((0, 0), (32, 254), 127, literal_wrap=True)[1] == 16_003 + 126  # of all vectors the furthest off


@given(st.integers(-65_535, 65_535), st.integers(-65_535, 65_535), st.sampled_from([1, 2, 4, 8, 16, 32, 64, 127]))
def test_component_errors_stay_within_their_bounds(dx, dy, v):  # T-68, T-G9, T-A4
    low = {1: -0.008, 2: -0.996, 4: -1.014, 8: -1.055, 16: -1.110, 32: -1.242, 64: -1.483, 127: -1.991}[v]
    high = {1: 0.996, 2: 0.992, 4: 0.984, 8: 0.969, 16: 0.938, 32: 0.875, 64: 0.750, 127: 0.749}[v]
    if max(abs(dx), abs(dy)) < 128:
        return
    for found, component in zip(poscal(*ends(dx, dy), v), (dx, dy), strict=True):
        error = abs(found) - abs(component) * v / math.hypot(dx, dy)
        assert low - 1e-3 <= error <= high + 1e-3


def test_short_vectors_are_imprecise_unless_doubled():  # T-G10
    errors, improved = [], []
    for x in range(128):
        for y in range(1, 128):
            true = (x * 127 / math.hypot(x, y), y * 127 / math.hypot(x, y))
            errors += [v - t for v, t in zip(poscal((0, 0), (x, y), 127), true, strict=True)]
            improved += [v - t for v, t in zip(velocm(resolve(*lengthened(x, y)), 127), true, strict=True)]
    assert (min(errors), max(errors)) == (pytest.approx(-26.8, abs=0.05), pytest.approx(13.4, abs=0.05))
    assert min(improved) >= -1.74
    assert max(improved) <= 0.75


def test_at_one_and_two_units_every_oblique_path_runs_at_45_degrees():  # T-A4, T-G9
    assert poscal((0, 0), (10_000, 1_000), 1) == (1, 1)
    assert poscal((0, 0), (10_000, 5_000), 2) == (1, 1)


@given(st.integers(0, 65_535), st.sampled_from([1, -1]))
def test_positi_counts_2_um_and_wraps_or_stops_at_the_end(position, direction):  # T-70, T-A11
    moved = position + 2 * direction
    assert positi(position, direction, wrap=True) == moved % 65_536
    if 0 <= moved <= 65_535:
        assert positi(position, direction) == moved
    else:
        with pytest.raises(InputError, match=f"soft limit: a step to {moved} um"):
            positi(position, direction)


def test_reduc2_halves_once_more_and_verm_refuses_more_than_8_bits():  # T-A2, T-64
    assert routines.reduc2(182, 255) == (91, 127)
    for pair in [(256, 1), (1, 256), (-1, 0)]:
        with pytest.raises(InputError, match=f"0..255, not {pair[0]} and {pair[1]}"):
            routines.verm(*pair)


@pytest.mark.parametrize("sequence", [
    [2, 1, 2, 2], [25, 13, 7, 5, 5], [10_000, 5_000, 2_501, 1_252, 630, 323, 177, 117, 101, 100, 100], [65_535, 0, 0],
])  # fmt: skip
def test_sqrt_takes_the_worked_steps(monkeypatch, sequence):  # T-G5
    divisors, divide, root = [], routines.divide, routines.sqrt(sequence[0])
    monkeypatch.setattr(routines, "divide", lambda dividend, by: divisors.append(by) or divide(dividend, by))
    assert routines.sqrt.py_func(sequence[0]) == root
    assert [sequence[0], *divisors, root] == sequence


def test_255_entries_of_8_bits_are_right_to_half_a_percent():  # T-72, T-A7
    assert len(SINE) == 255
    angles = np.linspace(0, math.pi / 2, 200_001)
    nearest = np.rint(angles / (math.pi / 2) * 254).astype(int)
    error = 100 * np.abs(np.frombuffer(SINE, np.uint8)[nearest] / 255 - np.sin(angles)).max()
    assert 0.49 < error <= 0.5


def test_the_table_finds_the_nearest_entry_of_every_8_bit_vector():  # T-72
    entries = np.array([(SINE[254 - i], SINE[i]) for i in range(255)])  # cosine and sine
    for x in range(0, 256, 3):
        for y in range(1, 256, 2):
            found, aside = look_up(x, y, 1, 1), np.abs(y * entries[:, 0] - x * entries[:, 1])
            assert abs(y * found.x - x * found.y) == aside.min()
            assert [found.x, found.y] in entries.tolist()


@given(st.integers(0, 65_535), st.integers(0, 65_535))
def test_a_direction_is_right_to_a_degree_whatever_its_length(x, y):  # T-72, T-63
    found = look_up(x, y, 1, -1)
    if max(x, y) < 128:
        return
    expected = math.degrees(math.atan2(y, x))
    # 0.45 degrees are lost by REDUC (T-G11), 0.18 by half an entry, 0.16 by the rounding of sine and cosine
    assert math.degrees(math.atan2(found.y, found.x)) == pytest.approx(expected, abs=0.8)
    assert math.hypot(found.x, found.y) == pytest.approx(255, rel=0.004)


def test_axis_speeds_from_the_table():  # T-72, T-68
    assert velocm(look_up(3000, 4000, 1, -1), 127) == (76, -101)
    assert velocm(look_up(0, 900, -1, 1), 64) == (0, 64)
    assert velocm(look_up(0, 0, 1, 1), 127) == (0, 0)
