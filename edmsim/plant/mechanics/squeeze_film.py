"""The film of water between wire and metal, which a wire that approaches the metal must squeeze out.

In a narrow gap this takes more force than all other loads of the wire: in a kerf the resistance grows as the inverse
square of the gap. Its mean over the slices damps all modes. If the gap of a slice is narrow, the excess of its film
is applied implicitly after every pulse, which is stable for any gap, together with the change of the pull while the
wire moves. A film's resistance is computed from the pull, by their ratio when the rays were traced.
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
"""Least pull by which the film is scaled, over that of a front at `Resolution.film_from_um` (ours)."""

_ANGLES = np.linspace(0.0, math.pi / 2, 721)


def _gaps_um(front_um: float, side_um: float) -> NDArray[np.float64]:
    """Return the gaps of a wire that leads its kerf's axis, from the front to the side."""
    return side_um - (side_um - front_um) * np.cos(_ANGLES)


def drag_N_s_m2(radius_um: float, front_um: float, side_um: float, viscosity_Pa_s: float) -> float:
    """Return the film's force per metre and per m/s on a wire that moves towards its front."""
    # Reynolds' equation of a film with open sides: ``c = 12 eta r^3 integral sin^2(theta) / g^3``, in a uniform gap
    # ``6 pi eta (r / g)^3``; behind the wire, water flows between wire and straight walls
    front = 2 * np.trapezoid(np.sin(_ANGLES) ** 2 / _gaps_um(front_um, side_um) ** 3, _ANGLES)
    behind = 2 * np.trapezoid(np.cos(_ANGLES) ** 2 / (side_um + radius_um * (1 - np.cos(_ANGLES))) ** 3, _ANGLES)
    return float(12 * viscosity_Pa_s * radius_um**3 * (front + behind))


def edge_loss_kg_m2(radius_um: float, side_um: float, loss: float) -> float:
    """Return the linearised loss of water driven round the wire: force per metre over the squared rms speed."""
    # water leaves the film at ``u = v r / g`` and loses ``loss rho u^2 / 2``, on the wire's diameter; for random
    # motion of rms speed s, ``sqrt(8 / pi) s v`` replaces ``v |v|``
    return loss * DENSITY_KG_M3 * radius_um * 1e-6 * (radius_um / side_um) ** 2 * math.sqrt(8 / math.pi)


def added_mass_kg_m(radius_um: float, front_um: float, side_um: float) -> float:
    """Return the added mass of water per metre, for a wire that moves to its front in the flow of `drag_N_s_m2`."""
    front = 2 * np.trapezoid(np.sin(_ANGLES) ** 2 / _gaps_um(front_um, side_um), _ANGLES)
    behind = 2 * np.trapezoid(np.cos(_ANGLES) ** 2 / (side_um + radius_um * (1 - np.cos(_ANGLES))), _ANGLES)
    return float(DENSITY_KG_M3 * (radius_um * 1e-6) ** 2 * radius_um * (front + behind))


def pull_sum_um2(radius_um: float, front_um: float, side_um: float, rays: int) -> float:
    """Return the pull in 1/um^2 of `breakdown.slice_sums` for a wire that leads its kerf's axis."""
    inverse = 1 / _gaps_um(front_um, side_um) + 0.5 / radius_um
    return float(rays / math.tau * 2 * np.trapezoid(np.cos(_ANGLES) * inverse**2, _ANGLES))


@compiled
def film_sum(rays: Rays, s: int, sx: np.float32, sy: np.float32, nx: np.float32, ny: np.float32) -> float:
    """Return the sum over a slice's rays of sin^2 / g^3 around a direction, in 1/um^3."""
    film, floor = spread(np.float32(0.0)), np.float32(PULL_GAP_FLOOR_UM)
    for at in facing_blocks(rays, s):
        gap = highest(gaps_of(rays, s, at, sx, sy), floor)
        across = load(rays.cosine, (s, at)) * ny - load(rays.sine, (s, at)) * nx
        # the least gap keeps this finite if the wire touches
        film += across * across / (gap * gap * gap)
    return float(total(film))


@compiled_apart
def scale_film(state: NDArray[np.void], a: Arrays, c: Constants, position: Array, sums: Array) -> None:
    """Find the ratio of the films' resistance to the pull, which is used until the rays are traced again."""
    # Both grow as the front gap narrows: their ratio is constant within a quarter from 3 to 20 um in a kerf, and six
    # times smaller along a wall.
    rays = rays_of(a)
    film = pulls = 0.0
    for s in range(sums.shape[0]):
        pull = math.sqrt(sums[s, 2] * sums[s, 2] + sums[s, 3] * sums[s, 3])
        if pull > 0.0:
            sx, sy = moved(a, position, s)
            nx, ny = np.float32(sums[s, 2] / pull), np.float32(sums[s, 3] / pull)
            film += a.metal[s] * film_sum(rays, s, sx, sy, nx, ny)
            # gas shields the pull and not the film, so use the pull without gas
            pulls += pull / (1.0 - c.shielding * a.covered[s])
    # opposite pulls may cancel, and the ratio must stay finite
    least = LEAST_PULL * c.film_pull_um2 * sums.shape[0]
    state[0].film_kg_um2_s = c.film_um3_kg_s * film / max(pulls, least)


@compiled
def _motion(a: Arrays, held: Array, s: int, nx: float, ny: float) -> tuple[float, float]:
    """Return a slice's motion in um along a direction since the state `held`, and its speed in um/s."""
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
    """Add the effect of a force (um kg/s2) on a slice over the whole span and an impulse (um kg/s) at its end."""
    for m in range(0, a.shape.shape[1], COORDINATES):
        shape = load(a.shape, (s, m))
        # exact response of a mode to a force that is constant over the span: deflection and speed
        settled = shape * (spread(1.0) - load(p.wire, (k_period, 0, m))) * load(p.wire_compliance, (m,)) * force
        moving = shape * (load(p.wire, (k_period, 1, m)) * force + impulse)
        store(a.wire_q, (0, m), load(a.wire_q, (0, m)) + settled * nx)
        store(a.wire_q, (1, m), load(a.wire_q, (1, m)) + settled * ny)
        store(a.wire_v, (0, m), load(a.wire_v, (0, m)) + moving * nx)
        store(a.wire_v, (1, m), load(a.wire_v, (1, m)) + moving * ny)


@compiled
def mean_film(state: NDArray[np.void], pull_x: float, pull_y: float, slices: int) -> float:
    """Return the mean viscous resistance of the slices' films in kg/s, from their pull (see `scale_film`)."""
    return float(state[0].film_kg_um2_s * math.sqrt(pull_x * pull_x + pull_y * pull_y) / slices)


@compiled
def _speed(a: Arrays) -> float:
    """Return the rms speed of the slices in um/s."""
    sum_ = spread(0.0)
    for m in range(0, a.inertia.shape[0], COORDINATES):
        x, y = load(a.wire_v, (0, m)), load(a.wire_v, (1, m))
        sum_ += load(a.inertia, (m,)) * (x * x + y * y)
    return math.sqrt(total(sum_))


@compiled
def mean_resistance(a: Arrays, c: Constants, gas: GasLaw, film: float) -> float:
    """Return the resistance of a slice in kg/s that damps all modes: the mean film, and losses of the water."""
    # The loss is linearised at the slices' rms speed, to which the speed of the water that pockets of steam move is
    # added. Modes stay uncoupled: in slow creep, single slices move 0.6 to 1.6 times as fast as they should.
    return film + c.jet_kg_um * (_speed(a) + gas.refill_um_s * mean_of_slices(a.steam, a.shape.shape[0]))


@compiled
def suction_limited(a: Arrays, c: Constants, s: int, force: float) -> float:
    """Limit a film's force (um kg/s2) towards the metal to that of the ambient pressure, where it cavitates."""
    # the force of the mean film is not limited: it would reach this value at 0.7 m/s and a gap of 3 um
    return float(min(force, c.suction_N * 1e6 * (1.0 - a.covered[s]) * a.metal[s]))


@compiled
def is_narrow(a: Arrays, c: Constants, sums: Array) -> bool:
    """Return whether a slice's gap is narrow enough for `find_films`."""
    most = -1.0
    for s in range(sums.shape[0]):  # no early exit, which would cost a branch per slice
        least = c.film_pull_um2 * a.metal[s]
        most = max(most, sums[s, 2] * sums[s, 2] + sums[s, 3] * sums[s, 3] - least * least)
    return most >= 0.0


@compiled_apart
def find_films(state: NDArray[np.void], a: Arrays, c: Constants, sums: Array, mean: float, films: Array) -> int:
    """Write every slice's film into `films` (slices, 6), and return the number of films."""
    # Columns: direction to the metal (2); resistance in kg/s above the mean film's; front gap in um; pull in 1/um^2;
    # motion of the wire since, 0 here. All but the direction are 0 if the gap is wide.
    found = 0
    for s in range(sums.shape[0]):
        pull2 = sums[s, 2] * sums[s, 2] + sums[s, 3] * sums[s, 3]
        films[s, 2] = films[s, 3] = films[s, 4] = films[s, 5] = 0.0
        least = c.film_pull_um2 * a.metal[s]
        if pull2 >= least * least:
            pull = math.sqrt(pull2)
            per_pull = 1.0 / pull
            films[s, 0], films[s, 1], films[s, 4] = sums[s, 2] * per_pull, sums[s, 3] * per_pull, pull
            # the pull is proportional to g^(-3/2)
            root = cube_root(c.film_pull_um2 * per_pull * (1.0 - c.shielding * a.covered[s]) * a.metal[s])
            films[s, 3] = c.film_from_um * root * root
            film = state[0].film_kg_um2_s * pull * (1.0 + EINSTEIN * a.debris[s])
            # the mean film damps all modes already; only the excess is applied per slice
            films[s, 2] = max(film - mean, 0.0)
            found += 1
    return found


@compiled
def film_now(films: Array, s: int, mean: float, moved_um: float) -> tuple[float, float]:
    """Return the resistance of a slice's film above the mean one after a motion, and the growth of its pull."""
    gap = films[s, 3]
    # the resistance is proportional to g^-2, the pull to g^(-3/2)
    nearer = gap / max(gap - moved_um, PULL_GAP_FLOOR_UM)
    film = (films[s, 2] + mean) * nearer * nearer - mean
    return max(film, 0.0), films[s, 4] * (nearer * math.sqrt(nearer) - 1.0)


@compiled
def _brake(
    a: Arrays, c: Constants, p: Propagators, held: Array, s: int, k: int, per_s: float, scale: float, mean: float,
    slow: float, films: Array,
) -> None:
    """Correct a slice's motion over a span of ``1 / per_s`` for its film and the change of the pull."""
    nx, ny = films[s, 0], films[s, 1]
    travel, speed = _motion(a, held, s, nx, ny)
    film, growth = film_now(films, s, mean, films[s, 5] + 0.5 * travel)
    drag, growth = film * per_s, growth * scale
    yielding, throwing = p.yielding[k, s, 0] * slow, p.yielding[k, s, 1] * slow
    # implicit: the share of its free motion that remains against the film
    free = 1.0 / (1.0 + yielding * drag)
    moves = (travel + yielding * growth) * free
    # a film pulls a wire that leaves the metal back, until the water cavitates
    resists = suction_limited(a, c, s, -drag * moves)
    force, impulse = resists + growth, 0.0
    # without cavitation, a stiff film gives the slice the speed of its mean motion, so it does not rebound
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
    """Correct the wire's motion over a span for the films and for the change of the pull, slice after slice."""
    # With the resistance c and the compliance H, a free motion of x becomes ``x / (1 + H c / T)``. The motion was
    # computed with the pull at the time of `find_films`; the correction uses that in the middle of the motion.
    # `scale` is the factor on the pull over the span.
    slices = films.shape[0]
    for at in range(slices):
        s = at if upward else slices - 1 - at
        if films[s, 3] != 0.0:
            _brake(a, c, p, held, s, k, 1e6 / span_us, scale, mean, slow, films)
