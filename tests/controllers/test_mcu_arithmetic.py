"""The 1982 integer routines against closed forms and worked numbers."""

import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from edmsim.controllers.mcu.firmware import arithmetic
from edmsim.controllers.mcu.firmware.arithmetic import divide, reduc, reduc2, sqrt, square, subsgn, verm
from edmsim.errors import InputError

WORDS = st.integers(0, 65_535)
BYTES = st.integers(0, 255)


@given(WORDS, WORDS)
def test_subsgn_gives_distance_and_the_larger(a, b):  # T-62
    distance, direction = subsgn(a, b)
    assert distance == abs(a - b)
    assert direction == (1 if a >= b else -1)


@given(WORDS, WORDS)
@example(256, 255)
@example(65_535, 0)
def test_reduc_halves_both_together_until_8_bits(a, b):  # T-63, T-A2
    x, y, halvings = reduc(a, b)
    assert (x, y) == (a // 2**halvings, b // 2**halvings)
    assert max(x, y) <= 255
    assert halvings == 0 or max(a, b) // 2 ** (halvings - 1) > 255


def test_reduc2_halves_once_more():  # T-A2
    assert reduc2(182, 255) == (91, 127)


def test_verm_is_exact_for_every_pair_and_square_is_its_diagonal():  # T-64, T-65
    assert all(verm(a, b) == a * b for a in range(256) for b in range(256))
    assert [square(a) for a in range(256)] == [a**2 for a in range(256)]


@pytest.mark.parametrize("pair", [(256, 1), (1, 256), (-1, 0)])
def test_verm_refuses_more_than_8_bits(pair):  # T-64
    with pytest.raises(InputError, match=f"0..255, not {pair[0]} and {pair[1]}"):
        verm(*pair)


def quotient(dividend, divisor):
    """Closed form of T-66."""
    return max(dividend // divisor, 1) if dividend and divisor else 0


@given(WORDS, WORDS)
@example(65_535, 32_768)
@example(65_535, 40_000)
@example(65_535, 65_535)
@example(65_535, 1)
@example(3, 5)
@example(0, 5)
@example(5, 0)
def test_divide_is_the_floor_but_1_for_a_fraction(dividend, divisor):  # T-66, T-A3
    assert divide(dividend, divisor) == quotient(dividend, divisor)


def test_divide_around_every_power_of_two_needs_its_17th_bit():  # T-66
    numbers = sorted({0, 65_535} | {2**k + d for k in range(16) for d in (-1, 0, 1)})
    assert all(divide(a, b) == quotient(a, b) for a in numbers for b in numbers)


@pytest.mark.slow
def test_sqrt_of_every_16_bit_number(monkeypatch):  # T-67, T-G1, T-G2, T-G3, T-G7
    passes = 0

    def counted(dividend, divisor):
        nonlocal passes
        passes += 1
        return quotient(dividend, divisor)

    monkeypatch.setattr(arithmetic, "divide", counted)
    worst_low, worst_high, most_passes = (0.0, 0), (0.0, 0), 0
    for n in range(65_535):
        passes = 0
        root, k = sqrt.py_func(n), math.isqrt(n)
        assert root == sqrt(n)
        assert root == k + (n >= k * k + k > 0), n
        most_passes = max(most_passes, passes)
        error = root - math.sqrt(n)
        worst_low, worst_high = min(worst_low, (error, n)), max(worst_high, (error, n))
    assert most_passes == 11
    assert worst_low == (pytest.approx(-0.4976, abs=5e-5), 65_279)
    assert worst_high == (pytest.approx(0.5858, abs=5e-5), 2)
    assert sqrt(65_280) == sqrt(65_534) == 256
    assert sqrt(65_535) == 0


@pytest.mark.parametrize(
    "sequence",
    [
        [2, 1, 2, 2],
        [25, 13, 7, 5, 5],
        [10_000, 5_000, 2_501, 1_252, 630, 323, 177, 117, 101, 100, 100],
        [65_535, 0, 0],
    ],
)
def test_sqrt_takes_the_worked_steps(monkeypatch, sequence):  # T-G5
    divisors = []

    def spied(dividend, divisor):
        divisors.append(divisor)
        return divide(dividend, divisor)

    monkeypatch.setattr(arithmetic, "divide", spied)
    root = sqrt.py_func(sequence[0])
    assert root == sqrt(sequence[0])
    assert [sequence[0], *divisors, root] == sequence
