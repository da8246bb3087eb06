"""Counter-based draws: uniform, and uncorrelated between counts and keys."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from edmsim.compiled.random import key_of, normal, uniform

WORDS = st.integers(0, 2**64 - 1)


def draws(seed, n=20_000, start=0):
    key = key_of(seed)
    return np.array([uniform(key, np.uint64(start + k)) for k in range(n)])


@given(WORDS, WORDS)
def test_draws_stay_inside_the_open_interval(key, count):
    assert 0.0 < uniform(np.uint64(key), np.uint64(count)) < 1.0


@pytest.mark.parametrize("seed", [0, 1, -1, 2**63])
def test_draws_are_uniform_and_forget_the_last_one(seed):
    u = draws(seed)
    assert stats.kstest(u, "uniform").pvalue > 1e-3
    assert abs(u.mean() - 0.5) < 4 / math.sqrt(12 * len(u))
    assert abs(np.corrcoef(u[:-1], u[1:])[0, 1]) < 4 / math.sqrt(len(u))


def test_neighbouring_seeds_are_unrelated():
    streams = [draws(seed, 5_000) for seed in range(8)]
    correlation = np.corrcoef(streams) - np.eye(8)
    assert np.abs(correlation).max() < 5 / math.sqrt(5_000)
    assert len({int(key_of(seed)) for seed in range(-1000, 1000)}) == 2000


def test_splitmix64_vectors():
    """First outputs of splitmix64 from state 0 and 1 (published reference outputs)."""
    for key, outputs in (
        (0, [0xE220A8397B1DCDAF, 0x6E789E6AA1B965F4, 0x06C45D188009454F]),
        (1234567, [6457827717110365317, 3203168211198807973, 9817491932198370423]),
    ):
        for n, word in enumerate(outputs, start=1):
            expected = ((word >> 11) + 0.5) * 2.0**-53
            assert uniform(np.uint64(key), np.uint64(n)) == expected


@pytest.mark.parametrize("seed", [0, 7])
def test_normal_draws_are_those_of_a_normal_distribution(seed):
    key, n = key_of(seed), 40_000
    z = np.array([normal(key, np.uint64(k)) for k in range(n)])
    assert abs(z.mean()) < 4 / math.sqrt(n)
    assert z.var() == pytest.approx(1.0, abs=4 * math.sqrt(2 / n))
    assert stats.kurtosis(z) == pytest.approx(0.0, abs=0.15)
    assert stats.kstest(z, "norm").statistic < 0.002 + 1.63 / math.sqrt(n)
    assert abs(np.corrcoef(z[:-1], z[1:])[0, 1]) < 4 / math.sqrt(n)


@given(WORDS, WORDS)
def test_no_normal_draw_lies_far_out(key, count):
    assert abs(normal(np.uint64(key), np.uint64(count))) < 7.1
