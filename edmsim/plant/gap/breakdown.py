"""When and where the gap breaks down.

Every ray stands for a patch of the wire's surface with its own gap to the metal, and every patch is an
independent site. Two mechanisms compete (two-regime finding of Esteves, Hensen, Kuffa, Wegener, J. Manuf.
Mater. Process. 7(5):177, 2023):

* the *long* branch, an exponential delay whose median on the reference patch is the parabola ``t50(g)`` of
  the SPARC simulator (MIT licence; ETH measurements, nominal 80 V). Rates of independent sites add, so the
  rate of a ray is ``ln 2 / t50`` times its share of the reference area.
* the *primed* branch, where a particle or asperity bridges most of the gap: a site is primed with a
  probability that rises as the gap falls below the critical 8..10 um, and then breaks down within a few us
  (Weibull). Sites that are not primed multiply, so the exponents ``W`` of ``1 - exp(-W)`` add.

Debris primes sites in wide gaps: a particle of size x leaves a gap of ``g - x``, and if that is below the critical
gap, the site is primed. If debris has a volume share c and exponentially distributed sizes of mean d,
``c / (pi d^3) exp(-x / d)`` particles per volume are larger than x.

The flow carries away the preparation of a breakdown: the rate of the long branch falls with the distance that the
water has moved since the voltage was switched on, as ``exp(-(v t / l)^2)``.

Other voltages scale the gap to equal field (``g * 80 V / V``).
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.elementary import logarithm, power
from edmsim.compiled.jit import compiled, compiled_apart
from edmsim.compiled.vectors import (
    GAPS,
    PACK,
    element,
    highest,
    load,
    passed,
    power_of_half,
    running,
    spread,
    store_sums,
    total,
)
from edmsim.plant.gap.rays import Rays, facing_blocks, gaps_of, narrowest


class GapLaw(NamedTuple):
    """Constants of the gap for the pulse loop, for one ray of one set-up (gaps in um, times in us)."""

    # median delay of the reference patch at 80 V: ``a g^2 + b g + c`` in us, divided by ln 2 and by the ray's share
    # of the reference area, so that ``1 / (a g^2 + b g + c)`` is the ray's rate per us
    t50_a: float
    t50_b: float
    t50_c: float
    gap_scale: float  # reference voltage over present voltage: gaps are multiplied by it (equal field)
    scaled_gap_floor_um: float  # below the parabola's minimum the rate is constant
    primed_gap_um: float  # gap below which a site can be primed, at the present voltage
    # ``W = primed_per_um2 * (primed_gap_um - g)^2`` for one ray; the squares are its primed weight
    primed_per_um2: float
    particle_gap_um: float  # a particle that leaves less than this gap primes its site, at the present voltage
    particle_um: float  # mean particle size of the debris of this setting
    # primed weight in um^2 of one ray per um of gap and share of debris, by particles of any size
    particles_um: float
    contact_gap_um: float  # asperities touch below this gap: the pulse is a short
    # inverse radius of the wire, 1/um: the field at a convex surface is stronger than between plates
    wire_curvature: float


_LN2 = math.log(2.0)
PULL_GAP_FLOOR_UM = 1.0  # below this gap the pull of a ray is constant (ours: asperities touch before)


class BlockLaw(NamedTuple):
    """Constants of `GapLaw` in float32 for blocks of rays, computed once for all slices."""

    # ``1 / (a g^2 + b g + c)`` is a ray's rate at its gap and the present voltage
    a: np.float32
    b: np.float32
    c: np.float32
    floor_um: np.float32  # below this gap the rate is constant
    primed_gap_um: np.float32
    # ``2^-(particle_gaps g - particle_offset)`` of the particles are large enough to prime a site
    particle_gaps: np.float32
    particle_offset: np.float32
    particles_um: np.float32
    # ``bare`` is the square of half the curvature
    wire_curvature: np.float32
    bare: np.float32


@compiled
def block_law(law: GapLaw) -> BlockLaw:
    """Return a law's constants for blocks of rays."""
    scale, per_um = law.gap_scale, 1.0 / (_LN2 * law.particle_um)
    return BlockLaw(
        np.float32(law.t50_a * scale * scale), np.float32(law.t50_b * scale), np.float32(law.t50_c),
        np.float32(law.scaled_gap_floor_um / scale), np.float32(law.primed_gap_um),
        np.float32(per_um), np.float32(per_um * law.particle_gap_um), np.float32(law.particles_um),
        np.float32(law.wire_curvature), np.float32(0.25 * law.wire_curvature * law.wire_curvature),
    )  # fmt: skip


@compiled
def _delays(gap: Any, law: BlockLaw) -> Any:
    """Return the inverse rates of a block of rays from their gaps."""
    least = highest(gap, law.floor_um)
    return (least * law.a + law.b) * least + law.c


@compiled
def _primed_weights(gap: Any, law: BlockLaw) -> Any:
    """Return the primed weights of a block of rays in um^2 from their gaps."""
    depth = highest(spread(law.primed_gap_um) - gap, np.float32(0.0))
    return depth * depth


@compiled
def _particle_weights(gap: Any, held: Any, law: BlockLaw) -> Any:
    """Return the primed weights by particles of a block of rays, over `GapLaw.particles_um` and the debris share."""
    return power_of_half(highest(gap * law.particle_gaps - law.particle_offset, np.float32(0.0))) * held


@compiled
def sum_pack(
    rays: Rays, pack: int, sx: Any, sy: Any, law: BlockLaw, gain: Any, pull: Any, debris: Any,
    sums: NDArray[np.float64], near: Any,
) -> Any:
    """Sum the rays of a pack of slices like `slice_sums`; the arguments are vectors with a value for each slice."""
    # Returns the sum over the slices, and upper bounds of `near` and of the primed weights without particles.
    one = np.float32(1.0)
    rate = primed = particles = pull_x = pull_y = spread(np.float32(0.0))
    for at in range(0, rays.packed_blocks[pack] * GAPS, GAPS):
        cosine, sine = load(rays.packed_cosine, (pack, at)), load(rays.packed_sine, (pack, at))
        gap = load(rays.packed_gap, (pack, at)) - (cosine * sx + sine * sy)
        delay, held = _delays(gap, law), highest(gap, np.float32(PULL_GAP_FLOOR_UM))
        square = held * held
        # one division for both rate and pull
        both = spread(one) / (delay * square)
        rate += both * square
        pressure = both * delay * (held * law.wire_curvature + one) + law.bare
        pull_x += pressure * cosine
        pull_y += pressure * sine
        primed += _primed_weights(gap, law)
        particles += _particle_weights(gap, held, law)
    near = highest(near, primed)
    primed += particles * (debris * law.particles_um)
    return store_sums(sums, pack * PACK, rate * gain, primed * gain, pull_x * pull, pull_y * pull), near


@compiled
def may_touch(near: Any, law: GapLaw) -> bool:
    """Return whether a ray may touch, from the bounds of `sum_pack`; mostly it cannot."""
    span = law.primed_gap_um - law.contact_gap_um
    return span <= 0.0 or bool(passed(near, np.float32(span * span)) < GAPS)


@compiled_apart
def contact_depth(rays: Rays, s: int, sx: np.float32, sy: np.float32, law: GapLaw) -> float:
    """Return the summed depth in um of a slice's rays below the contact gap."""
    contact = 0.0
    for at in facing_blocks(rays, s):
        depth = spread(np.float32(law.contact_gap_um)) - gaps_of(rays, s, at, sx, sy)
        contact += total(highest(depth, np.float32(0.0)))
    return contact


@compiled
def slice_sums(
    rays: Rays, s: int, shift_x: float, shift_y: float, law: GapLaw, sums: NDArray[np.float64], debris: float = 0.0
) -> float:
    """Sum the rays of slice `s` into its row of `sums` (slices, 4), and return the depth of its contacts in um."""
    # The other slices of its pack are summed, too. A row has the rate in 1/us, the primed weight in um^2, and the
    # pull in x and y in 1/um^2, that of coaxial cylinders, ``(1/g + 1/(2 r))^2``. The wire has moved by `shift`
    # since the tracing.
    sx, sy, nothing = np.float32(shift_x), np.float32(shift_y), spread(np.float32(0.0))
    whole, loading = spread(np.float32(1.0)), spread(np.float32(debris))
    _, near = sum_pack(rays, s // PACK, spread(sx), spread(sy), block_law(law), whole, whole, loading, sums, nothing)
    return contact_depth(rays, s, sx, sy, law) if may_touch(near, law) else 0.0


@compiled
def choose_ray(
    rays: Rays, s: int, shift_x: float, shift_y: float, law: GapLaw, primed: bool, target: float, debris: float
) -> int:
    """Return the place of the ray at which a slice's cumulative weight (rate or primed weight) passes `target`."""
    sx, sy, block = np.float32(shift_x), np.float32(shift_y), block_law(law)
    left, loading = np.float32(target), block.particles_um * np.float32(debris)
    for at in facing_blocks(rays, s):
        gap = gaps_of(rays, s, at, sx, sy)
        if primed:
            held = highest(gap, np.float32(PULL_GAP_FLOOR_UM))
            weights = _primed_weights(gap, block) + _particle_weights(gap, held, block) * loading
        else:
            weights = spread(np.float32(1.0)) / _delays(gap, block)
        sums = running(weights)
        before = passed(sums, left)
        if before < GAPS:
            return int(at + before)
        left -= element(sums, GAPS - 1)
    return narrowest(rays, s, sx, sy)[0]  # beyond the total by rounding: the most likely ray


@compiled
def weibull(scale_us: float, shape: float, u: float) -> float:
    """Return the Weibull delay in us at the survival probability `u`."""
    hazard = -logarithm(u)
    return scale_us * (hazard if shape == 1.0 else power(hazard, 1.0 / shape))
