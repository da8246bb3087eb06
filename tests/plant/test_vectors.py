"""Vectors of the pulse loop and its elementary functions, against those of numpy."""

import numpy as np
import pytest

from edmsim.compiled.elementary import cube_root, exponential, inverse_cube_root, logarithm, power
from edmsim.compiled.jit import compiled
from edmsim.compiled.vectors import (
    COORDINATES,
    EACH,
    GAPS,
    PACK,
    counted,
    element,
    filled,
    highest,
    least,
    load,
    lowest,
    packed,
    passed,
    power_of_half,
    running,
    spread,
    store,
    store_sums,
    total,
)


@compiled
def _arithmetic(a, b, out):
    x, y = load(a, (1, 3)), load(b, (0,))
    z = (x - y * 2.0) / (y + 1.0)
    z += 3.0 * x
    store(out, (0, 0), z)
    store(out, (1, 0), highest(x, y))
    store(out, (2, 0), 7.0 - x)
    store(out, (3, 0), lowest(x, y))


@compiled
def _sums(a, limit):
    x = load(a, (0, 0))
    return total(x), element(running(x), 2), passed(running(x), limit), least(x)


@pytest.fixture
def numbers():
    rng = np.random.default_rng(7)
    return rng.random((2, 3 + GAPS), np.float32), rng.random(GAPS, np.float32)


def test_arithmetic_is_that_of_numpy_lane_by_lane(numbers):
    a, b = numbers
    out = np.zeros((4, GAPS), np.float32)
    _arithmetic(a, b, out)
    x = a[1, 3:]
    np.testing.assert_allclose(out[0], (x - 2 * b) / (b + 1) + 3 * x, rtol=1e-5)
    np.testing.assert_array_equal(out[1], np.maximum(x, b))
    np.testing.assert_array_equal(out[2], np.float32(7.0) - x)
    np.testing.assert_array_equal(out[3], np.minimum(x, b))


@compiled
def _powers_of_half(x, out):
    store(out, (0,), power_of_half(load(x, (0,))))


def test_powers_of_half_are_right_to_a_hundredth_of_a_percent_and_never_less_than_normal_numbers():
    for first in range(0, 200, 4):
        x, out = np.linspace(first, first + 4, GAPS, dtype=np.float32), np.zeros(GAPS, np.float32)
        _powers_of_half(x, out)
        np.testing.assert_allclose(out, 0.5 ** np.minimum(x.astype(float), 125.0), rtol=1e-4)
        assert out.min() >= np.finfo(np.float32).tiny


@compiled
def _spread_over_slices(numbers, out, counts):
    store(out, (0,), packed(load(numbers, (0,)), numbers[PACK - 1]))
    store(counts, (0,), counted(2.5))


def test_a_packed_vector_has_each_slice_s_number_in_its_lanes():
    numbers, out, counts = np.linspace(0.5, 2.5, PACK), np.zeros(GAPS, np.float32), np.zeros(COORDINATES)
    _spread_over_slices(numbers, out, counts)
    np.testing.assert_array_equal(out[: PACK * EACH], np.repeat(numbers, EACH))
    np.testing.assert_array_equal(counts, 2.5 + np.arange(COORDINATES))


@compiled
def _sum_by_slices(a, first, rows, whole):
    x = load(a, (0, 0))
    store(whole, (0,), store_sums(rows, first, x, x * x, x + 1.0, spread(np.float32(2.0))))


@pytest.mark.parametrize("slices", [PACK, 3, 8])
def test_sums_over_the_lanes_of_slices_go_to_their_rows(numbers, slices):
    """Rows beyond the slices are not written; the sum over the rows includes the whole pack."""
    x, rows, whole = numbers[0][0, :GAPS], np.full((slices + 1, 4), -1.0), np.zeros(COORDINATES)
    first = slices // PACK * PACK if slices > PACK else 0
    _sum_by_slices(numbers[0], first, rows[:slices], whole)
    lanes = x[: PACK * EACH].reshape(PACK, EACH).astype(float)
    found = np.stack([lanes.sum(1), (lanes**2).sum(1), (lanes + 1).sum(1), np.full(PACK, 2.0 * EACH)], axis=1)
    np.testing.assert_allclose(rows[first:slices], found[: slices - first], rtol=1e-6)
    assert (rows[slices] == -1.0).all()
    np.testing.assert_allclose(whole, found.sum(0), rtol=1e-6)


def test_coordinates_are_vectors_of_float64():
    a = np.arange(2.0 * COORDINATES)
    out = np.zeros((4, COORDINATES))
    _arithmetic(np.stack([a, a + 0.25]), a[:COORDINATES].copy(), out)
    x, y = (a + 0.25)[3 : 3 + COORDINATES], a[:COORDINATES]
    np.testing.assert_allclose(out[0], (x - 2 * y) / (y + 1) + 3 * x, rtol=1e-14)


@pytest.mark.parametrize("limit", [0.0, 1.3, 1e9])
def test_sums_counts_and_the_least_of_a_vector(numbers, limit):
    a, _ = numbers
    x = a[0, :GAPS]
    found, third, within, smallest = _sums(a, np.float32(limit))
    assert found == pytest.approx(x.sum(), rel=1e-6)
    assert third == pytest.approx(x[:3].sum(), rel=1e-6)
    assert within == (np.cumsum(x) <= limit).sum()
    assert smallest == (x.min(), x.argmin())


def test_of_equal_elements_the_first_is_the_least():
    same = np.ones((1, GAPS), np.float32)
    assert _sums(same, np.float32(2.5))[2:] == (2, (1.0, 0))


@pytest.mark.parametrize(("count", "whole"), [(1, 4), (4, 4), (5, 8), (25, 28)])
def test_arrays_are_filled_up_to_whole_vectors(count, whole):
    assert filled(count) == whole


def test_logarithm_and_exponential_are_the_library_s():
    rng = np.random.default_rng(1)
    for x in np.concatenate([rng.random(2000), 10.0 ** rng.uniform(-300, 300, 2000), [1.0]]):
        assert logarithm(x) == pytest.approx(np.log(x), rel=1e-8, abs=1e-12)
    for x in rng.uniform(-700.0, 700.0, 2000):
        assert exponential(x) == pytest.approx(np.exp(x), rel=2e-8)
    assert exponential(0.0) == 1.0
    assert exponential(-1e9) == 0.0
    assert np.isfinite(exponential(1e9))


def test_powers_and_cube_roots_are_the_library_s():
    rng = np.random.default_rng(2)
    for x in 10.0 ** rng.uniform(-9, 9, 2000):
        assert power(x, 0.7) == pytest.approx(x**0.7, rel=5e-8)
        assert cube_root(x) == pytest.approx(np.cbrt(x), rel=2e-8)
        assert inverse_cube_root(x) == pytest.approx(1 / np.cbrt(x), rel=1e-8)
