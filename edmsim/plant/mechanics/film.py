"""The film of water between wire and metal, which the wire must squeeze out to come nearer.

In a narrow gap that takes more force than anything else on the wire: the resistance grows as one over the square of
the gap in a kerf. Its mean over the slices damps all modes; where a slice's gap is narrow, what its film has more is
applied after every pulse, implicitly, so that no gap is too narrow for it, and with it the change of the pull while
the wire moves. How much a film resists is taken from the pull, in the ratio that the rays give when they are traced.
"""

import math

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.elementary import cube_root
from edmsim.compiled.jit import compiled, compiled_apart
from edmsim.compiled.vectors import COORDINATES, highest, load, spread, store, total
from edmsim.plant.gap.breakdown import PULL_GAP_FLOOR_UM
from edmsim.plant.gap.gas import GasLaw
from edmsim.plant.gap.rays import Rays, facing_blocks, gaps_of, moved, rays_of
from edmsim.plant.gap.water import DENSITY_KG_M3, EINSTEIN, mean_of_slices
from edmsim.plant.kernel.state import Array, Arrays, Constants, Propagators

LEAST_PULL = 0.2
"""Pull under which the film is no longer scaled by it, over that of a front at `Resolution.film_from_um` (ours)."""

_ANGLES = np.linspace(0.0, math.pi / 2, 721)


def _gaps_um(front_um: float, side_um: float) -> NDArray[np.float64]:
    """Gap of a wire that leads its kerf's axis, from the front round to the side."""
    return side_um - (side_um - front_um) * np.cos(_ANGLES)


def drag_N_s_m2(radius_um: float, front_um: float, side_um: float, viscosity_Pa_s: float) -> float:
    """Force per metre and per m/s with which the film resists a wire that moves towards its front."""
    # Reynolds' equation of a film with open sides: ``c = 12 eta r^3 integral sin^2(theta) / g^3``, in a uniform gap
    # ``6 pi eta (r / g)^3``; behind, water has to pass between wire and straight walls
    front = 2 * np.trapezoid(np.sin(_ANGLES) ** 2 / _gaps_um(front_um, side_um) ** 3, _ANGLES)
    behind = 2 * np.trapezoid(np.cos(_ANGLES) ** 2 / (side_um + radius_um * (1 - np.cos(_ANGLES))) ** 3, _ANGLES)
    return float(12 * viscosity_Pa_s * radius_um**3 * (front + behind))


def edge_loss_kg_m2(radius_um: float, side_um: float, loss: float) -> float:
    """Force per metre over the mean square speed of a wire that drives water round its sides, linearised."""
    # water leaves the film at ``u = v r / g`` and loses ``loss rho u^2 / 2``, on the wire's diameter; random motion
    # of the mean square speed s^2 meets ``sqrt(8 / pi) s v`` in place of ``v |v|``
    return loss * DENSITY_KG_M3 * radius_um * 1e-6 * (radius_um / side_um) ** 2 * math.sqrt(8 / math.pi)


def added_mass_kg_m(radius_um: float, front_um: float, side_um: float) -> float:
    """Mass per metre of the water a wire moves when it moves towards its front, in the flow of `drag_N_s_m2`."""
    front = 2 * np.trapezoid(np.sin(_ANGLES) ** 2 / _gaps_um(front_um, side_um), _ANGLES)
    behind = 2 * np.trapezoid(np.cos(_ANGLES) ** 2 / (side_um + radius_um * (1 - np.cos(_ANGLES))), _ANGLES)
    return float(DENSITY_KG_M3 * (radius_um * 1e-6) ** 2 * radius_um * (front + behind))


def pull_sum_um2(radius_um: float, front_um: float, side_um: float, rays: int) -> float:
    """Sum in 1/um^2 that `breakdown.slice_sums` finds of the pull on a wire that leads its kerf's axis."""
    inverse = 1 / _gaps_um(front_um, side_um) + 0.5 / radius_um
    return float(rays / math.tau * 2 * np.trapezoid(np.cos(_ANGLES) * inverse**2, _ANGLES))


@compiled
def film_sum(rays: Rays, s: int, sx: np.float32, sy: np.float32, nx: np.float32, ny: np.float32) -> float:
    """Sum over a slice's rays of sin^2 / g^3 around a direction, in 1/um^3."""
    film, floor = spread(np.float32(0.0)), np.float32(PULL_GAP_FLOOR_UM)
    for at in facing_blocks(rays, s):
        gap = highest(gaps_of(rays, s, at, sx, sy), floor)
        across = load(rays.cosine, (s, at)) * ny - load(rays.sine, (s, at)) * nx
        # a floor under the gap keeps the cube finite where the wire touches
        film += across * across / (gap * gap * gap)
    return float(total(film))


@compiled_apart
def scale_film(state: NDArray[np.void], a: Arrays, c: Constants, position: Array, sums: Array) -> None:
    """Find the films' resistance over the pull, which they keep until the rays are traced again."""
    # both grow as the front comes nearer: over the pull the resistance is the same within a quarter from 3 to 20 um
    # in a kerf, six times less along a wall
    rays = rays_of(a)
    film = pulls = 0.0
    for s in range(sums.shape[0]):
        pull = math.sqrt(sums[s, 2] * sums[s, 2] + sums[s, 3] * sums[s, 3])
        if pull > 0.0:
            sx, sy = moved(a, position, s)
            nx, ny = np.float32(sums[s, 2] / pull), np.float32(sums[s, 3] / pull)
            film += a.metal[s] * film_sum(rays, s, sx, sy, nx, ny)
            # gas shields the pull and not the film: take the pull as it would be without gas
            pulls += pull / (1.0 - c.shielding * a.covered[s])
    # opposite pulls may cancel, and the ratio must stay finite
    least = LEAST_PULL * c.film_pull_um2 * sums.shape[0]
    state[0].film_kg_um2_s = c.film_um3_kg_s * film / max(pulls, least)


@compiled
def _motion(a: Arrays, held: Array, s: int, nx: float, ny: float) -> tuple[float, float]:
    """How far a slice's wire has come along a direction since `held`, and its speed (um/s)."""
    place, speed = spread(0.0), spread(0.0)
    for m in range(0, a.shape.shape[1], COORDINATES):
        shape = load(a.shape, (s, m))
        x, y = load(a.wire_q, (0, m)) - load(held, (0, m)), load(a.wire_q, (1, m)) - load(held, (1, m))
        place += shape * (x * nx + y * ny)
        speed += shape * (load(a.wire_v, (0, m)) * nx + load(a.wire_v, (1, m)) * ny)
    return float(total(place)), float(total(speed))


@compiled
def _apply(
    a: Arrays, p: Propagators, s: int, k_period: int, nx: float, ny: float, force: float, impulse: float
) -> None:
    """Add what a force (um kg/s2) on a slice over the whole period and an impulse (um kg/s) at its end have done."""
    for m in range(0, a.shape.shape[1], COORDINATES):
        shape = load(a.shape, (s, m))
        # exact answer of a mode to a force that is constant over the period: what has settled, and its speed
        settled = shape * (spread(1.0) - load(p.wire, (k_period, 0, m))) * load(p.wire_compliance, (m,)) * force
        moving = shape * (load(p.wire, (k_period, 1, m)) * force + impulse)
        store(a.wire_q, (0, m), load(a.wire_q, (0, m)) + settled * nx)
        store(a.wire_q, (1, m), load(a.wire_q, (1, m)) + settled * ny)
        store(a.wire_v, (0, m), load(a.wire_v, (0, m)) + moving * nx)
        store(a.wire_v, (1, m), load(a.wire_v, (1, m)) + moving * ny)


@compiled
def mean_film(state: NDArray[np.void], pull_x: float, pull_y: float, slices: int) -> float:
    """Viscous resistance of the film in kg/s, the mean of the slices, by their pull (see `scale_film`)."""
    return float(state[0].film_kg_um2_s * math.sqrt(pull_x * pull_x + pull_y * pull_y) / slices)


@compiled
def _speed(a: Arrays) -> float:
    """Root mean square of the slices' speed in um/s."""
    sum_ = spread(0.0)
    for m in range(0, a.inertia.shape[0], COORDINATES):
        x, y = load(a.wire_v, (0, m)), load(a.wire_v, (1, m))
        sum_ += load(a.inertia, (m,)) * (x * x + y * y)
    return math.sqrt(total(sum_))


@compiled
def mean_resistance(a: Arrays, c: Constants, gas: GasLaw, film: float) -> float:
    """Resistance of a slice in kg/s that damps all modes: the mean film, and what the water loses at its edges."""
    # the loss is linearised at the slices' mean square speed; to it comes the water that every pocket of steam moves.
    # Modes stay apart: in a load that creeps for long, single slices go 0.6 to 1.6 times as fast as they should
    return film + c.jet_kg_um * (_speed(a) + gas.refill_um_s * mean_of_slices(a.steam, a.shape.shape[0]))


@compiled
def suction_limited(a: Arrays, c: Constants, s: int, force: float) -> float:
    """A film's force (um kg/s2) towards the metal is at most the ambient pressure on the wire: then it cavitates."""
    # what the mean film resists is not limited: it takes 0.7 m/s at a gap of 3 um to be as much
    return float(min(force, c.suction_N * 1e6 * (1.0 - a.covered[s]) * a.metal[s]))


@compiled
def is_narrow(a: Arrays, c: Constants, sums: Array) -> bool:
    """Whether a slice's gap is so narrow that `find_films` finds a film there."""
    most = -1.0
    for s in range(sums.shape[0]):  # no way out before the end: it takes no longer than a branch for each
        least = c.film_pull_um2 * a.metal[s]
        most = max(most, sums[s, 2] * sums[s, 2] + sums[s, 3] * sums[s, 3] - least * least)
    return most >= 0.0


@compiled_apart
def find_films(state: NDArray[np.void], a: Arrays, c: Constants, sums: Array, mean: float, films: Array) -> int:
    """Write every slice's film into `films` (slices, 6), and return how many there are."""
    # direction to the metal; resistance in kg/s that the film has more than the mean one; the front gap in um; the
    # pull in 1/um^2; the way the wire has come since, 0 here. All are 0 where the gap is wide
    found = 0
    for s in range(sums.shape[0]):
        pull2 = sums[s, 2] * sums[s, 2] + sums[s, 3] * sums[s, 3]
        films[s, 2] = films[s, 3] = films[s, 4] = films[s, 5] = 0.0
        least = c.film_pull_um2 * a.metal[s]
        if pull2 >= least * least:
            pull = math.sqrt(pull2)
            per_pull = 1.0 / pull
            films[s, 0], films[s, 1], films[s, 4] = sums[s, 2] * per_pull, sums[s, 3] * per_pull, pull
            # the pull goes with g^(-3/2), so the gap with its power -2/3
            root = cube_root(c.film_pull_um2 * per_pull * (1.0 - c.shielding * a.covered[s]) * a.metal[s])
            films[s, 3] = c.film_from_um * root * root
            film = state[0].film_kg_um2_s * pull * (1.0 + EINSTEIN * a.debris[s])
            # the mean film damps all modes already; only the excess is corrected per slice
            films[s, 2] = max(film - mean, 0.0)
            found += 1
    return found


@compiled
def film_now(films: Array, s: int, mean: float, way: float) -> tuple[float, float]:
    """Resistance of a slice's film over the mean one when the wire has come `way` nearer, and its pull's growth."""
    gap = films[s, 3]
    # resistance grows with g^-2 and pull with g^(-3/2) over the way that the wire has come
    nearer = gap / max(gap - way, PULL_GAP_FLOOR_UM)
    film = (films[s, 2] + mean) * nearer * nearer - mean
    return max(film, 0.0), films[s, 4] * (nearer * math.sqrt(nearer) - 1.0)


@compiled
def _brake(
    a: Arrays, c: Constants, p: Propagators, held: Array, s: int, k: int, per_s: float, scale: float, mean: float,
    slow: float, films: Array,
) -> None:
    """Correct a slice's motion over a span, of which `per_s` fit into a second, for film and change of the pull."""
    nx, ny = films[s, 0], films[s, 1]
    travel, speed = _motion(a, held, s, nx, ny)
    film, growth = film_now(films, s, mean, films[s, 5] + 0.5 * travel)
    drag, growth = film * per_s, growth * scale
    yielding, throwing = p.yielding[k, s, 0] * slow, p.yielding[k, s, 1] * slow
    # implicit: the share of its free motion that a slice makes against the film
    free = 1.0 / (1.0 + yielding * drag)
    moves = (travel + yielding * growth) * free
    # away from the metal the film pulls back until the water cavitates
    resists = suction_limited(a, c, s, -drag * moves)
    force, impulse = resists + growth, 0.0
    # not limited: a stiff film leaves the slice the speed of its motion, without a rebound
    if resists == -drag * moves:
        stiff = 1.0 - free
        impulse = stiff * stiff * (moves * per_s - speed - throwing * force) * a.slice_mass_kg[s]
    _apply(a, p, s, k, nx, ny, force * slow, impulse)
    films[s, 5] += travel + yielding * force


@compiled_apart
def squeeze(
    a: Arrays, c: Constants, p: Propagators, held: Array, k: int, span_us: float, scale: float, mean: float,
    slow: float, upward: bool, films: Array,
) -> None:
    """Correct the wire's motion over a span for the films and for the pull's change, slice after slice."""
    # with the resistance c and the yielding H, a slice that would have moved by x moves by ``x / (1 + H c / T)``. The
    # pull, which the motion took as it was when the films were found, is that in the middle of the way; `scale` is
    # that of the pull over the span
    slices = films.shape[0]
    for at in range(slices):
        s = at if upward else slices - 1 - at
        if films[s, 3] != 0.0:
            _brake(a, c, p, held, s, k, 1e6 / span_us, scale, mean, slow, films)
