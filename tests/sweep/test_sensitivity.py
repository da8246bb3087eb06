"""Indices of Sobol' of functions whose indices are known, from every kind of runs a sweep can be made of."""

import itertools

import numpy as np
import pytest
from scipy.stats import qmc

from edmsim.sweep.summary import sensitivity

NAMES = "abcdefgh"


def grid(*levels, seeds=1):
    return np.repeat(np.array(list(itertools.product(*levels)), float), seeds, axis=0)


def sobol(dimensions, points, seed=1):
    return qmc.Sobol(dimensions, rng=np.random.default_rng(seed)).random(points)


def found(runs, figure):
    return sensitivity({n: column.tolist() for n, column in zip(NAMES, runs.T, strict=False)}, figure)


def first(result):
    return [effect.first_order for effect in result.effects.values()]


def total(result):
    return [effect.total for effect in result.effects.values()]


THREE = [0.0, 1.0, 2.0]


@pytest.mark.parametrize(("of", "singly", "in_all"), [
    (lambda a, b, c: a + 2 * b, [0.2, 0.8, 0.0], [0.2, 0.8, 0.0]),
    (lambda a, b, c: (a - 1) * (b - 1), [0.0, 0.0, 0.0], [1.0, 1.0, 0.0]),  # only in an interaction
    # 2/3, and (2/3)^3 of all three together
    (lambda a, b, c: a + (a - 1) * (b - 1) * (c - 1), [9 / 13, 0.0, 0.0], [1.0, 4 / 13, 4 / 13]),
])  # fmt: skip
def test_a_whole_grid_gives_the_exact_indices(of, singly, in_all):
    runs = grid(THREE, THREE, THREE)
    result = found(runs, of(*runs.T))
    assert first(result) == pytest.approx(singly, abs=1e-12)
    assert total(result) == pytest.approx(in_all, abs=1e-12)
    assert sum(first(result)) + result.interactions == pytest.approx(1.0)
    assert np.isnan(result.unexplained)  # each was run once


@pytest.mark.slow
@pytest.mark.parametrize("fraction", [1.0, 0.8])
def test_seeds_show_what_is_chance_also_where_runs_failed(fraction):
    """Of 27 combinations of four seeds: a variance of 2/3 and 6, an interaction of 4/9, and a chance of 1."""
    rng = np.random.default_rng(5)
    all_runs = grid(THREE, THREE, THREE, seeds=4)
    whole = 2 / 3 + 6 + 4 / 9 + 1
    shares = []
    for _ in range(40):
        runs = all_runs[rng.random(len(all_runs)) < fraction]
        a, b, _ = runs.T
        result = found(runs, a + 3 * b + (a - 1) * (b - 1) + rng.normal(size=len(runs)))
        shares.append([*first(result), *total(result), result.interactions, result.unexplained])
    mean_result = np.mean(shares, axis=0)
    expected = [2 / 3, 6, 0, 2 / 3 + 4 / 9, 6 + 4 / 9, 0, 4 / 9, 1]
    np.testing.assert_allclose(mean_result, np.array(expected) / whole, atol=0.02)


def test_a_run_that_failed_leaves_a_gap_and_not_another_answer():
    runs = grid(THREE, THREE)
    rate = runs[:, 0] + 2 * runs[:, 1]
    rate[4] = np.nan
    result = found(runs, rate)
    assert first(result) == pytest.approx([0.2, 0.8])
    assert total(result) == pytest.approx([0.2, 0.8])


def test_of_one_setting_at_a_time_interactions_are_not_claimed():
    runs = np.array([[1, 1, 1], [0, 1, 1], [2, 1, 1], [1, 0, 1], [1, 2, 1], [1, 1, 0], [1, 1, 2]], float)
    result = found(runs, runs[:, 0] + 3 * runs[:, 1])
    assert first(result) == pytest.approx([0.1, 0.9, 0.0], abs=1e-12)
    assert np.isnan([*total(result), result.interactions]).all()


def test_settings_that_only_change_together_are_not_parted():
    result = found(np.array([[1, 10, 1], [2, 20, 1], [3, 30, 1], [1, 10, 2], [2, 20, 2], [3, 30, 2]], float),
                 np.array([1.0, 2.0, 3.0, 2.0, 3.0, 4.0]))  # fmt: skip
    assert np.isnan(first(result)[:2]).all()


def test_names_that_only_change_together_are_not_parted_either():
    wires = {"copper": "molybdenum", "graphite": "brass", "steel": "copper"}
    runs = [(material, t_on_us) for material in wires for t_on_us in (10, 20) for _ in range(4)]
    names = {"material": [m for m, _ in runs], "wire": [wires[m] for m, _ in runs], "t_on_us": [t for _, t in runs]}
    figure = np.array([{"copper": 0.0, "graphite": 3.0, "steel": 5.0}[material] for material, _ in runs])
    effects = sensitivity(names, figure + np.tile([0.0, 0.1], 12)).effects
    assert np.isnan([effects["material"].first_order, effects["wire"].first_order]).all()
    assert effects["t_on_us"].first_order == pytest.approx(0.0, abs=0.01)


def test_a_setting_that_is_a_name_counts_by_its_names():
    runs = [(name, height) for name in ("counts", "voltage", "fixed") for height in (5, 10)]
    figure = np.array([{"counts": 3.0, "voltage": 0.0, "fixed": 3.0}[name] + height for name, height in runs])
    settings = {"controller": [r[0] for r in runs], "height_mm": [r[1] for r in runs]}
    result = sensitivity(settings, figure)
    assert first(result) == pytest.approx([2 / 8.25, 6.25 / 8.25])
    assert np.isnan(result.effects["controller"].rank_correlation)


def ishigami(u):
    """Ishigami and Homma 1990, with 7 and 0.1."""
    x, y, z = np.pi * (2 * u[:, :3].T - 1)
    return np.asarray(np.sin(x) + 7 * np.sin(y) ** 2 + 0.1 * z**4 * np.sin(x))


SAMPLES = {
    "sobol": sobol(3, 256), "random": np.random.default_rng(3).random((300, 3)),
    "latin": qmc.LatinHypercube(3, rng=np.random.default_rng(4)).random(300),
    "of five settings": sobol(5, 512),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("kind", SAMPLES)
def test_ishigami_in_samples(kind):
    result = found(SAMPLES[kind], ishigami(SAMPLES[kind]))
    assert first(result)[:3] == pytest.approx([0.314, 0.442, 0.0], abs=0.03)
    assert total(result)[:3] == pytest.approx([0.558, 0.442, 0.244], abs=0.04)
    assert max(total(result)[3:], default=0.0) < 0.01
    assert result.unexplained < 0.03
    assert sum(first(result)) + result.interactions + result.unexplained == pytest.approx(1.0)


@pytest.mark.slow
def test_a_sample_of_orders_of_magnitude_needs_nothing_else():
    runs = 10.0 ** (3 * sobol(2, 64))
    result = found(runs, np.log10(runs[:, 0]) + 2 * np.log10(runs[:, 1]))
    assert first(result) == pytest.approx([0.2, 0.8], abs=0.02)


def test_what_is_chance_in_a_sample_is_unexplained():
    """Variances of 1, 9 and none, and a chance of 2.5: the sample tells each to a few percent."""
    runs = sobol(3, 256)
    noise = np.random.default_rng(0).normal(0.0, np.sqrt(2.5), 256)
    result = found(runs, np.sqrt(12) * (runs[:, 0] + 3 * runs[:, 1]) + noise)
    assert first(result) == pytest.approx([1 / 12.5, 9 / 12.5, 0.0], abs=0.04)
    assert total(result)[2] < 0.02
    assert result.unexplained == pytest.approx(0.2, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("points", [8, 16, 64])
def test_chance_alone_is_nearly_never_taken_for_an_effect(points):
    rng = np.random.default_rng(points)
    claimed = [1 - found(sobol(3, points, seed), rng.normal(size=points)).unexplained for seed in range(25)]
    assert np.median(claimed) == 0.0
    assert np.mean(np.array(claimed) > 0.05) <= 0.2


@pytest.mark.slow
def test_a_sample_with_a_grid_and_seeds():
    points = sobol(2, 64)
    runs = np.array([[setting, *point] for setting in (0, 1) for point in points for _ in range(3)])
    shares = []
    for seed in range(3):
        noise = np.random.default_rng(seed).normal(0.0, 0.3, len(runs))
        result = found(runs, 2 * runs[:, 0] * runs[:, 1] + noise)
        shares.append([*first(result), *total(result), result.unexplained])
    # of 2 a u: the means over u and over a vary by 1/4 and 1/12, and 1/12 is of both together
    whole = 1 / 4 + 1 / 12 + 1 / 12 + 0.09
    expected = np.array([1 / 4, 1 / 12, 0, 1 / 3, 1 / 6, 0, 0.09]) / whole
    np.testing.assert_allclose(np.mean(shares, axis=0), expected, atol=0.02)


@pytest.mark.parametrize("figure", [[], [1.0], [np.nan, np.nan, np.nan, np.nan], [2.0, 2.0, 2.0, 2.0]])
def test_what_tells_nothing_is_unknown(figure):
    result = found(np.arange(2.0 * len(figure)).reshape(-1, 2), np.array(figure))
    assert np.isnan([*first(result), *total(result), result.interactions, result.unexplained]).all()


@pytest.mark.parametrize("points", [6, 8, 12])
def test_one_run_with_another_setting_says_nothing_of_chance(points):
    """The fit goes through it, so that its error without it is unknown; the other runs know what chance does."""
    other, figure = np.zeros(points), 1e-3 * np.random.default_rng(0).random(points)
    other[-1], figure[-1] = 1.0, 100.0
    result = found(np.column_stack([other, np.linspace(0.0, 1.0, points)]), figure)
    assert first(result) == pytest.approx([1.0, 0.0], abs=1e-6)
    assert result.unexplained == pytest.approx(0.0, abs=1e-6)
