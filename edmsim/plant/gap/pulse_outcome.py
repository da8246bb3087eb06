"""The outcome of a pulse (open, spark, arc or short) from gaps, contacts and breakdown."""

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

LEFT_UM = 0.1  # an overlap of this size remains: the next contact acts 2 um before the metal (ours)
MOST_TRIES = 64  # after so much thinning by the flow the pulse is open (ours: the wait has passed by then)
MOST_SWEEPS = 8
"""Greatest number of sweeps over the slices that push the wire out; an overlap that remains is judged at the window's
end (ours)."""


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
    """Return the conductance in siemens of the water between wire and metal (rays in parallel)."""
    conductance = 0.0
    for s in range(a.distance.shape[0]):
        inverse = spread(np.float32(0.0))
        for place in range(0, a.distance.shape[1], GAPS):
            inverse += spread(np.float32(1.0)) / highest(load(a.distance, (s, place)), np.float32(1.0))
        conductance += a.metal[s] * total(inverse)
    return conductance * c.leak_S_um


@compiled
def _gain(a: Arrays, c: Constants, s: int) -> float:
    """Return the factor of gas and metal height on the breakdown rate of a slice."""
    return float((1.0 - c.dryness * a.covered[s]) * a.metal[s])


@compiled
def _packed(values: Array, first: int) -> Any:
    """Return the values of a pack of slices, starting at its first slice, as a vector."""
    return packed(load(values, (first,)), values[first + PACK - 1])


@compiled
def _packed_moves(a: Arrays, position: Array, axis: int, first: int) -> Any:
    """Return the motion along an axis of a pack of slices since their rays were traced."""
    last = first + PACK - 1
    return packed(
        load(position, (axis, first)) - load(a.reference_um, (axis, first)),
        position[axis, last] - a.reference_um[axis, last],
    )


@compiled
def sum_rays(
    a: Arrays, c: Constants, law: GapLaw, position: Array, sums: Array, contact: Array
) -> tuple[float, float, float, float, float]:
    """Sum every slice's rays at the wire's position: rate, primed weight, depth of contacts, pull in x and y."""
    rays, block = rays_of(a), block_law(law)
    dryness, shielding, one = np.float32(c.dryness), np.float32(c.shielding), spread(np.float32(1.0))
    everything, near = spread(0.0), spread(np.float32(0.0))
    for first in range(0, sums.shape[0], PACK):
        # gas and the height of the metal change the breakdown rate and the pull
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
    """Return the smallest gap among the slices in contact, its slice and place."""
    deepest, slice_, place = NO_METAL_UM, 0, 0
    for s in range(contact.shape[0]):
        if contact[s] > 0.0:
            nearest, gap = narrowest_now(a, position, s)
            if gap < deepest:
                deepest, slice_, place = gap, s, nearest
    return deepest, slice_, place


@compiled_apart
def resolve_contact(state: NDArray[np.void], a: Arrays, position: Array, contact: Array) -> tuple[int, int]:
    """Push the wire out of the metal where they overlap; return slice and place of the deepest contact."""
    # first the deepest slice, then with the wire's new shape the others, upwards and downwards in turn
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
    """Return whether a slice has enough debris to bridge the gap."""
    most = 0.0
    for s in range(a.shape.shape[0]):
        most = max(most, a.debris[s])
    return most > 0.9 * c.bridge_base


@compiled_apart
def _bridged(state: NDArray[np.void], a: Arrays, position: Array, c: Constants) -> bool:
    """Draw whether debris bridges the gap somewhere."""
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
    """Return the slice at which a column's cumulative sum passes `target`, and the rest of `target` there."""
    passed, sum_, left = 0, 0.0, target
    for s in range(sums.shape[0]):  # no early exit, because processors would mispredict it
        sum_ += sums[s, kind]
        if target >= sum_:
            passed, left = s + 1, target - sum_
    if passed < sums.shape[0]:
        return passed, left
    heaviest = 0  # beyond the total by rounding
    for s in range(sums.shape[0]):
        if sums[s, kind] > sums[heaviest, kind]:
            heaviest = s
    return heaviest, 0.5 * sums[heaviest, kind]


@compiled
def _await(state: NDArray[np.void], a: Arrays, sums: Array, rate: float, wait_us: float) -> tuple[float, int, float]:
    """Draw the delay of the long branch in us; return it, its slice, and the rest of the drawn sum there."""
    # thinning: breakdowns come at the summed rate, and are rejected if the water has carried away their preparation
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
    """Draw whether a place is primed by a particle that bridges the gap together with others."""
    return gap_of(a, position, s, k) > law.primed_gap_um and draw(state) < c.chaining * a.debris[s]


@compiled
def _ignite(
    state: NDArray[np.void], a: Arrays, c: Constants, law: GapLaw, t: Timing, position: Array, sums: Array,
    totals: tuple[float, float, float, float, float],
) -> tuple[int, float, int, int]:
    """Return outcome, delay until breakdown in us, slice and place; an open pulse has no place."""
    # with the probability 1 - exp(-weight); the logarithm can be computed before the sums
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
    """Return the chance that the last place burns again: the hotter it is, the longer its ions stay."""
    since = state[0].since_discharge_us
    hot = state[0].spot * exponential(-since / c.spot_us)
    return float(exponential(-since / (c.deionisation_us * (1.0 + hot))))


@compiled
def decide(
    state: NDArray[np.void], a: Arrays, c: Constants, law: GapLaw, t: Timing, position: Array, sums: Array,
    contact: Array, totals: tuple[float, float, float, float, float],
) -> tuple[int, float, int, int]:
    """Return how the pulse ends: outcome, delay until ignition in us, slice and place of its ray."""
    if totals[2] > 0.0:
        s, k = resolve_contact(state, a, position, contact)
        return SHORT, 0.0, s, k
    if _may_bridge(a, c) and _bridged(state, a, position, c):
        return SHORT, 0.0, -1, 0
    since, deionising = state[0].since_discharge_us, c.deionisation_us * (1.0 + state[0].spot)
    chance = draw(state)
    # the first condition excludes it in most pulses
    if chance * (deionising + since) < deionising and chance < _reignites(state, c):
        s, r = state[0].last_slice, state[0].last_ray
        if meets_metal(a, c, s, r):
            return ARC, 0.0, s, place_of(a, s, r)
    return _ignite(state, a, c, law, t, position, sums, totals)
