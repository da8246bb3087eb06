"""The outcome of a pulse, open, spark, arc or short, from the gaps along the rays, contact and breakdown."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.elementary import exponential, logarithm
from edmsim.compiled.jit import compiled, compiled_apart
from edmsim.compiled.random import normal, uniform
from edmsim.compiled.vectors import GAPS, PACK, element, highest, load, packed, spread, total
from edmsim.plant.gap.breakdown import GapLaw, block_law, choose_ray, contact_depth, may_touch, sum_pack, weibull
from edmsim.plant.gap.rays import gap_of, meets_metal, moved, narrowest_now, place_of, rays_of
from edmsim.plant.gap.water import bridged_probability
from edmsim.plant.kernel.state import ARC, NO_METAL_UM, OPEN, SHORT, SPARK, Array, Arrays, Constants, Timing
from edmsim.plant.mechanics.modal import place_slice, place_wire, push_out

LEFT_UM = 0.1  # an overlap so small is left: the next contact is felt 2 um before the metal (ours)
MOST_TRIES = 64  # a delay put off so often by the flow does not end within the wait (ours: by then it has passed)
MOST_SWEEPS = 8
"""Greatest number of sweeps over the slices that push the wire out; what is left is judged at the window's end
(ours)."""


@compiled
def draw(state: NDArray[np.void]) -> float:
    """Next uniform draw of the plant."""
    state[0].draws += np.uint64(1)
    return uniform(state[0].key, state[0].draws)


@compiled
def draw_normal(state: NDArray[np.void]) -> float:
    """Next standard normal draw of the plant."""
    state[0].draws += np.uint64(1)
    return normal(state[0].key, state[0].draws)


@compiled
def leak_conductance(a: Arrays, c: Constants) -> float:
    """Conductance in siemens of the water between wire and metal (rays in parallel)."""
    conductance = 0.0
    for s in range(a.distance.shape[0]):
        inverse = spread(np.float32(0.0))
        for place in range(0, a.distance.shape[1], GAPS):
            inverse += spread(np.float32(1.0)) / highest(load(a.distance, (s, place)), np.float32(1.0))
        conductance += a.metal[s] * total(inverse)
    return conductance * c.leak_S_um


@compiled
def _gain(a: Arrays, c: Constants, s: int) -> float:
    """What gas and the height of its metal make of the breakdown rate in a slice."""
    return float((1.0 - c.dryness * a.covered[s]) * a.metal[s])


@compiled
def _packed(values: Array, first: int) -> Any:
    """Values of a pack of slices, from its first one on, in a vector."""
    return packed(load(values, (first,)), values[first + PACK - 1])


@compiled
def _packed_moves(a: Arrays, position: Array, axis: int, first: int) -> Any:
    """How far the wire of a pack of slices has moved along an axis from where their rays were traced."""
    last = first + PACK - 1
    return packed(
        load(position, (axis, first)) - load(a.reference_um, (axis, first)),
        position[axis, last] - a.reference_um[axis, last],
    )


@compiled
def sum_rays(
    a: Arrays, c: Constants, law: GapLaw, position: Array, sums: Array, contact: Array
) -> tuple[float, float, float, float, float]:
    """Sum every slice's rays where the wire is: rate, primed weight, depth of contacts, pull along x and y."""
    rays, block = rays_of(a), block_law(law)
    dryness, shielding, one = np.float32(c.dryness), np.float32(c.shielding), spread(np.float32(1.0))
    everything, near = spread(0.0), spread(np.float32(0.0))
    for first in range(0, sums.shape[0], PACK):
        # gas and the height of the metal act on the rate of breakdown and on the pull
        covered, metal = _packed(a.covered, first), _packed(a.metal, first)
        gain, pull = (one - covered * dryness) * metal, (one - covered * shielding) * metal
        sx, sy = _packed_moves(a, position, 0, first), _packed_moves(a, position, 1, first)
        rows, near = sum_pack(rays, first // PACK, sx, sy, block, gain, pull, _packed(a.debris, first), sums, near)
        everything += rows
    touching = 0.0
    if may_touch(near, law):
        for s in range(sums.shape[0]):
            sx, sy = moved(a, position, s)
            contact[s] = contact_depth(rays, s, sx, sy, law)
            touching += contact[s]
    return (
        element(everything, 0), element(everything, 1), touching, element(everything, 2), element(everything, 3),
    )  # fmt: skip


@compiled
def deepest_contact(a: Arrays, position: Array, contact: Array) -> tuple[float, int, int]:
    """Smallest gap among the slices that touch, its slice and place."""
    deepest, slice_, place = NO_METAL_UM, 0, 0
    for s in range(contact.shape[0]):
        if contact[s] > 0.0:
            nearest, gap = narrowest_now(a, position, s)
            if gap < deepest:
                deepest, slice_, place = gap, s, nearest
    return deepest, slice_, place


@compiled_apart
def touch(state: NDArray[np.void], a: Arrays, position: Array, contact: Array) -> tuple[int, int]:
    """Slice and place of the deepest contact; the wire is pushed out of the metal where it overlaps."""
    # the deepest slice comes first, and with the wire's new shape the others, up and down
    deepest, slice_, place = deepest_contact(a, position, contact)
    if deepest >= -LEFT_UM:
        return slice_, place
    push_out(a, slice_, np.float64(a.cosine[slice_, place]), np.float64(a.sine[slice_, place]), -deepest)
    slices, pushed = contact.shape[0], True
    for sweep in range(MOST_SWEEPS):
        if not pushed:
            break
        pushed = False
        for at in range(slices):
            s = at if sweep % 2 == 0 else slices - 1 - at
            if contact[s] > 0.0:
                place_slice(state, a, position, s)
                k, gap = narrowest_now(a, position, s)
                if gap < -LEFT_UM:
                    push_out(a, s, np.float64(a.cosine[s, k]), np.float64(a.sine[s, k]), -gap)
                    pushed = True
    place_wire(state, a, position)
    return slice_, place


@compiled
def _may_bridge(a: Arrays, c: Constants) -> bool:
    """Whether a slice has so much debris that it may bridge the gap."""
    most = 0.0
    for s in range(a.shape.shape[0]):
        most = max(most, a.debris[s])
    return most > 0.9 * c.bridge_base


@compiled_apart
def _bridged(state: NDArray[np.void], a: Arrays, position: Array, c: Constants) -> bool:
    """Whether debris bridges the gap somewhere."""
    for s in range(a.shape.shape[0]):
        if a.debris[s] > 0.9 * c.bridge_base:
            gap = narrowest_now(a, position, s)[1]
            p = bridged_probability(
                a.debris[s], gap, c.bridge_base, c.bridge_per_um, c.bridge_ceiling, c.bridge_steepness
            )
            if draw(state) < p:
                return True
    return False


@compiled
def _pick(sums: Array, kind: int, target: float) -> tuple[int, float]:
    """Slice at which the cumulative sum of a kind passes `target`, and what of it is left there."""
    passed, sum_, left = 0, 0.0, target
    for s in range(sums.shape[0]):  # no way out before the end: where it would be cannot be foreseen
        sum_ += sums[s, kind]
        if target >= sum_:
            passed, left = s + 1, target - sum_
    if passed < sums.shape[0]:
        return passed, left
    heaviest = 0  # the target lay within rounding of the total
    for s in range(sums.shape[0]):
        if sums[s, kind] > sums[heaviest, kind]:
            heaviest = s
    return heaviest, 0.5 * sums[heaviest, kind]


@compiled
def _await(state: NDArray[np.void], a: Arrays, sums: Array, rate: float, wait_us: float) -> tuple[float, int, float]:
    """Delay of the long branch in us, its slice, and what of a drawn sum is left there."""
    # thinning: breakdowns come at the summed rate; one is put off if the water has carried away what prepared it
    delay, per_rate = 0.0, 1.0 / max(rate, 1e-30)
    for _ in range(MOST_TRIES):
        delay -= logarithm(draw(state)) * per_rate
        if delay >= wait_us:
            break
        s, left = _pick(sums, 0, draw(state) * rate)
        carried = delay * a.carried_per_us[s]
        if carried < 0.01 or draw(state) < exponential(-carried * carried):
            return delay, s, left
    return wait_us, 0, 0.0


@compiled
def _chains_up(
    state: NDArray[np.void], a: Arrays, c: Constants, law: GapLaw, position: Array, s: int, k: int
) -> bool:
    """Whether a primed place owes it to a particle, and that particle finds others that bridge the gap with it."""
    return gap_of(a, position, s, k) > law.primed_gap_um and draw(state) < c.chaining * a.debris[s]


@compiled
def _ignite(
    state: NDArray[np.void], a: Arrays, c: Constants, law: GapLaw, t: Timing, position: Array, sums: Array,
    totals: tuple[float, float, float, float, float],
) -> tuple[int, float, int, int]:
    """Class of the pulse, delay until breakdown in us, its slice and place; an open one has no place."""
    # as likely as 1 - exp(-weight); the logarithm need not wait for the sums
    is_primed = -logarithm(draw(state)) < law.primed_per_um2 * totals[1]
    if is_primed:
        delay = weibull(c.primed_scale_us, c.primed_shape, draw(state))
        s, left = _pick(sums, 1, draw(state) * totals[1])
    else:
        delay, s, left = _await(state, a, sums, totals[0], t.wait_us)
    if delay >= t.wait_us:
        return OPEN, t.wait_us, 0, 0
    sx, sy = moved(a, position, s)
    k = choose_ray(rays_of(a), s, float(sx), float(sy), law, is_primed, left / _gain(a, c, s), a.debris[s])
    if is_primed and _chains_up(state, a, c, law, position, s, k):
        return SHORT, 0.0, s, k
    delay += max(c.formative_us + c.formative_sd_us * draw_normal(state), 0.01)
    return (SPARK, delay, s, k) if delay < t.wait_us else (OPEN, t.wait_us, 0, 0)


@compiled
def _reignites(state: NDArray[np.void], c: Constants) -> float:
    """Chance that the place that burned last burns again: its ions leave the later, the hotter it still is."""
    since = state[0].since_discharge_us
    hot = state[0].spot * exponential(-since / c.spot_us)
    return float(exponential(-since / (c.deionisation_us * (1.0 + hot))))


@compiled
def decide(
    state: NDArray[np.void], a: Arrays, c: Constants, law: GapLaw, t: Timing, position: Array, sums: Array,
    contact: Array, totals: tuple[float, float, float, float, float],
) -> tuple[int, float, int, int]:
    """How this pulse ends: class, delay until ignition in us, slice and place of its ray."""
    if totals[2] > 0.0:
        s, k = touch(state, a, position, contact)
        return SHORT, 0.0, s, k
    if _may_bridge(a, c) and _bridged(state, a, position, c):
        return SHORT, 0.0, -1, 0
    since, deionising = state[0].since_discharge_us, c.deionisation_us * (1.0 + state[0].spot)
    chance = draw(state)
    # the first rules it out most often
    if chance * (deionising + since) < deionising and chance < _reignites(state, c):
        s, r = state[0].last_slice, state[0].last_ray
        if meets_metal(a, c, s, r):
            return ARC, 0.0, s, place_of(a, s, r)
    return _ignite(state, a, c, law, t, position, sums, totals)
