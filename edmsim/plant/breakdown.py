"""When, where and how a pulse breaks through the gap.

Every ray is a patch of the wire's surface that faces the metal across its own gap, and every patch is a
site of its own. Two mechanisms compete (two-regime finding of Esteves, Hensen, Kuffa, Wegener, J. Manuf.
Mater. Process. 7(5):177, 2023):

* the *long* branch, an exponential delay whose median on the reference patch is the parabola ``t50(g)`` of
  the SPARC simulator (MIT licence; ETH measurements, nominal 80 V). Rates of independent sites add, so the
  rate of a ray is ``ln 2 / t50`` times its share of the reference area.
* the *primed* branch, a particle or asperity that already bridges most of the gap: a site is primed with a
  probability that rises as the gap falls through the critical 8..10 um, and then breaks down within a few us
  (Weibull). Sites that are not primed multiply, so the exponents ``W`` of ``1 - exp(-W)`` add.

Other voltages scale the gap to equal field (``g * 80 V / V``); debris multiplies both.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .compiled import compiled
from .workpiece import NO_METAL_UM


class GapLaw(NamedTuple):
    """Constants of the gap as the pulse loop wants them, for one ray of one set-up (gaps um, times us).

    Attributes
    ----------
    t50_a, t50_b, t50_c : float
        Median delay of the reference patch at 80 V: ``a g^2 + b g + c`` in us, divided by ln 2 and by the
        ray's share of the reference area, so that ``1 / (a g^2 + b g + c)`` is the ray's rate per us.
    gap_scale : float
        Reference voltage over present voltage: gaps are multiplied by it (equal field).
    scaled_gap_floor_um : float
        Below the parabola's minimum the rate stays what it is there.
    primed_gap_um : float
        Gap below which a site can be primed, at the present voltage.
    primed_per_um2 : float
        ``W = primed_per_um2 * (primed_gap_um - g)^2`` for one ray; the squares are its primed weight.
    contact_gap_um : float
        Asperities touch below this gap: the pulse is a short.
    wire_curvature : float
        One over the wire's radius, 1/um: the field at a convex surface is stronger than between plates.
    """

    t50_a: float
    t50_b: float
    t50_c: float
    gap_scale: float
    scaled_gap_floor_um: float
    primed_gap_um: float
    primed_per_um2: float
    contact_gap_um: float
    wire_curvature: float


PULL_GAP_FLOOR_UM = 1.0
"""The electrostatic pressure of a ray is not followed below this gap (ours: asperities touch before)."""


@compiled
def slice_sums(
    distance: NDArray[np.float32],
    cosine: NDArray[np.float32],
    sine: NDArray[np.float32],
    s: int,
    count: int,
    shift_x: float,
    shift_y: float,
    law: GapLaw,
) -> tuple[float, float, float, float, float]:
    """Sum the first `count` rays of slice `s`: rate 1/us, primed weight um^2, contact depth um, pull x, y 1/um^2.

    `distance` (slices, rays) is the gap traced from the reference position, `shift` how far the wire has moved
    from it since. Whole arrays and an index, as a view would cost two atomic reference counts.
    The pull is that of coaxial cylinders a ray's gap apart, to second order in gap over radius:
    ``(1/g + 1/(2 r))^2``. One pass without branches, so that it vectorises; the one division serves both.
    """
    one = np.float32(1.0)
    sx, sy = np.float32(shift_x), np.float32(shift_y)
    a, b, c = np.float32(law.t50_a), np.float32(law.t50_b), np.float32(law.t50_c)
    scale, floor = np.float32(law.gap_scale), np.float32(law.scaled_gap_floor_um)
    primed_gap = np.float32(law.primed_gap_um)
    pull_floor = np.float32(PULL_GAP_FLOOR_UM)
    curvature = np.float32(law.wire_curvature)
    bare = np.float32(0.25 * law.wire_curvature**2)
    zero = np.float32(0.0)
    rate = primed = contact = pull_x = pull_y = zero
    for k in range(count):
        gap = distance[s, k] - sx * cosine[s, k] - sy * sine[s, k]
        scaled = max(gap * scale, floor)
        delay = (a * scaled + b) * scaled + c
        held = max(gap, pull_floor)
        square = held * held
        both = one / (delay * square)
        rate += both * square
        pressure = both * delay * (one + held * curvature) + bare
        pull_x += pressure * cosine[s, k]
        pull_y += pressure * sine[s, k]
        depth = max(primed_gap - gap, zero)
        primed += depth * depth
    contact_gap = np.float32(law.contact_gap_um)
    span = primed_gap - contact_gap
    if span <= zero or primed >= span * span:  # else no ray is near enough to touch
        for k in range(count):
            gap = distance[s, k] - sx * cosine[s, k] - sy * sine[s, k]
            contact += max(contact_gap - gap, zero)
    return float(rate), float(primed), float(contact), float(pull_x), float(pull_y)


@compiled
def choose_ray(
    distance: NDArray[np.float32],
    cosine: NDArray[np.float32],
    sine: NDArray[np.float32],
    s: int,
    count: int,
    shift_x: float,
    shift_y: float,
    law: GapLaw,
    primed: bool,
    target: float,
) -> int:
    """Ray of slice `s` at which the cumulative weight (rate, or primed weight) passes `target`."""
    sx, sy = np.float32(shift_x), np.float32(shift_y)
    a, b, c = np.float32(law.t50_a), np.float32(law.t50_b), np.float32(law.t50_c)
    scale, floor = np.float32(law.gap_scale), np.float32(law.scaled_gap_floor_um)
    running = 0.0
    for k in range(count):
        gap = distance[s, k] - sx * cosine[s, k] - sy * sine[s, k]
        if primed:
            depth = max(np.float32(law.primed_gap_um) - gap, np.float32(0.0))
            weight = depth * depth
        else:
            scaled = max(gap * scale, floor)
            weight = np.float32(1.0) / ((a * scaled + b) * scaled + c)
        running += weight
        if running > target:
            return k
    best, narrowest = 0, np.float32(NO_METAL_UM)  # the target lay within rounding of the total: the likeliest
    for k in range(count):
        gap = distance[s, k] - sx * cosine[s, k] - sy * sine[s, k]
        if gap < narrowest:
            best, narrowest = k, gap
    return best


@compiled
def weibull(scale_us: float, shape: float, u: float) -> float:
    """Weibull delay in us at survival probability `u`."""
    return float(scale_us * (-math.log(u)) ** (1.0 / shape))
