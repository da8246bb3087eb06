"""The integer routines against a second implementation, written from the thesis' text alone (5.2.1, 5.3.1).

The text says what each routine yields; here that is plain arithmetic on whole arrays, where the controller shifts,
adds and subtracts. Nothing is shared with it: not the routines, not their constants.
"""

import itertools

import numpy as np
import pytest

from edmsim.controllers.mcu.firmware import poscal

ALL_WORDS = np.arange(65_536, dtype=np.int64)


def text_subsgn(a, b):
    """Absolute value of the difference, and which of the two is the larger."""
    return np.abs(a - b), np.where(a < b, -1, 1)


def text_reduc(a, b):
    """Both without the binary places that the larger has beyond 8 (T-A2)."""
    larger = np.maximum(a, b)
    places = np.ceil(np.log2(larger + 1)).astype(np.int64) - 8
    places = np.where(places > 0, places, 0)
    return a // 2**places, b // 2**places, places


def text_divide(a, b):
    """Whole quotient; 0 if either is 0, 1 if the dividend is the smaller (T-A3)."""
    whole = np.floor_divide(a, np.where(b == 0, 1, b))
    return np.where((a == 0) | (b == 0), 0, np.where(a < b, 1, whole))


def text_sqrt(n, passes=False):
    """Iterate the printed program for a whole array; what has settled stays. 16 bits hold all numbers."""
    x, following, taken = n.copy(), (n + 1) % 65_536 // 2, np.zeros_like(n)
    for _ in range(40):
        settled = x == following
        if settled.all():
            return taken if passes else x
        x, taken = following, taken + ~settled
        following = np.where(settled, following, (text_divide(n, x) + x + 1) % 65_536 // 2)
    raise AssertionError("a root never settles")


def text_length(dx, dy, wraps=False):
    """Reduced components and the root of their squares' sum; halved once more where that has 17 bits (T-A2)."""
    a, b, places = text_reduc(dx, dy)
    total = a * a + b * b
    if wraps:
        return a, b, text_sqrt(total % 65_536), places
    carries = total > 65_535
    a, b = np.where(carries, a // 2, a), np.where(carries, b // 2, b)
    return a, b, text_sqrt(a * a + b * b), places + carries


def text_poscal(position, target, speed, wraps=False):
    """Both axis speeds: component times speed over length, with its direction."""
    (dx, x_sign), (dy, y_sign) = (text_subsgn(target[:, i], position[:, i]) for i in (0, 1))
    a, b, length, _ = text_length(dx, dy, wraps)
    return x_sign * text_divide(a * speed, length), y_sign * text_divide(b * speed, length)


def boundaries():
    """0, the ends of 16 bits, and every power of two with what stands beside it."""
    near = {2**k + d for k in range(17) for d in (-2, -1, 0, 1, 2)} | {3 * 2**k for k in range(15)}
    return sorted(n for n in near if 0 <= n <= 65_535)


def called(routine, *columns):
    """Results of a routine of the controller over columns of arguments."""
    return np.array([routine(*row) for row in zip(*(c.tolist() for c in columns), strict=True)])


def test_sqrt_of_every_word():  # T-67, T-G1, T-G2, T-G3, T-G7
    """Nearest whole number, up at k (k + 1); of 65 535 it is 0."""
    k = np.floor(np.sqrt(ALL_WORDS)).astype(np.int64)
    roots = np.where((k * k + k <= ALL_WORDS) & (ALL_WORDS > 0), k + 1, k)
    roots[65_535] = 0
    np.testing.assert_array_equal(called(poscal.sqrt, ALL_WORDS), roots)
    np.testing.assert_array_equal(text_sqrt(ALL_WORDS), roots)
    assert text_sqrt(ALL_WORDS, passes=True).max() == 11
    error = text_sqrt(ALL_WORDS[:-1]) - np.sqrt(ALL_WORDS[:-1])
    assert (error.argmin(), error.min()) == (65_279, pytest.approx(-0.4976, abs=5e-5))
    assert (error.argmax(), error.max()) == (2, pytest.approx(0.5858, abs=5e-5))


def test_without_the_1_that_is_added_roots_below_a_square_never_settle():  # T-G4
    """Without the wrap at 16 bits, too, which would save 65 535."""
    n = np.arange(1, 65_536, dtype=np.int64)
    x, following = n.copy(), (n + 1) // 2
    for _ in range(200):
        x, following = following, np.where(x == following, following, (text_divide(n, following) + following) // 2)
    endless = n[x != following]
    assert endless.tolist() == [k * k - 1 for k in range(2, 257)]


def test_verm_of_every_pair_of_bytes_and_square():  # T-64, T-65
    a, b = np.divmod(ALL_WORDS, 256)
    np.testing.assert_array_equal(called(poscal.verm, a, b), np.multiply.outer(*[np.arange(256)] * 2).ravel())
    np.testing.assert_array_equal(called(poscal.square, np.arange(256)), np.arange(256) ** 2)


def test_divide_of_every_boundary_by_every_boundary():  # T-66, T-A3
    near = np.array(boundaries())
    a, b = (grid.ravel() for grid in np.meshgrid(near, near))
    np.testing.assert_array_equal(called(poscal.divide, a, b), text_divide(a, b))


def test_subsgn_and_reduc_at_every_boundary():  # T-62, T-63, T-A2
    near = np.array(boundaries())
    a, b = (grid.ravel() for grid in np.meshgrid(near, near))
    np.testing.assert_array_equal(called(poscal.subsgn, a, b).T, text_subsgn(a, b))
    np.testing.assert_array_equal(called(poscal.reduc, a, b).T, text_reduc(a, b))
    others = np.roll(ALL_WORDS, 12_345)
    np.testing.assert_array_equal(called(poscal.reduc, ALL_WORDS, others).T, text_reduc(ALL_WORDS, others))
    np.testing.assert_array_equal(called(poscal.subsgn, ALL_WORDS, others).T, text_subsgn(ALL_WORDS, others))


@pytest.mark.slow
def test_length_of_every_vector_of_bytes():  # T-69, T-G6, T-G7, T-A2
    a, b = np.divmod(ALL_WORDS, 256)
    for wraps in (False, True):
        found = [
            poscal.resolve(x, y, 1, 1, wraps)
            for x, y in itertools.product(range(0, 256, 5 if wraps else 7), range(256))
        ]
        x, y, length, halvings = text_length(*_pairs(5 if wraps else 7), wraps)
        np.testing.assert_array_equal([[f.x, f.y, f.length, f.halvings] for f in found],
                                      np.array([x, y, length, halvings]).T)
    assert text_sqrt(np.array([65_534])) == 256
    assert (a * a + b * b > 65_535).sum() == 13_816


def _pairs(stride):
    a, b = np.meshgrid(np.arange(0, 256, stride), np.arange(256), indexing="ij")
    return a.ravel(), b.ravel()


def test_poscal_at_every_boundary_and_over_the_table():  # T-60, T-61, T-69, T-G8
    near = np.array(boundaries())
    dx, dy = (grid.ravel()[::7] for grid in np.meshgrid(near, near))
    rng = np.random.default_rng(69)
    anywhere = rng.integers(0, 65_536, (4000, 4))
    position = np.concatenate([np.zeros((len(dx), 2), np.int64), anywhere[:, :2]])
    target = np.concatenate([np.array([dx, dy]).T, anywhere[:, 2:]])
    speed = rng.integers(0, 128, len(position))
    for wraps in (False, True):
        found = [
            poscal.poscal(tuple(p), tuple(t), v, wraps)
            for p, t, v in zip(position.tolist(), target.tolist(), speed.tolist(), strict=True)
        ]
        np.testing.assert_array_equal(found, np.array(text_poscal(position, target, speed, wraps)).T)
