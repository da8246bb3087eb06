"""A gas bubble in the slit between wire and metal: the equations of theory/gas.md, integrated.

A gas bubble of radius R and pressure p drives the water out of the slit of width g between the wire's front half and
the metal. Two shapes of the slit are compared: a disc of radius W = pi d/4, a quarter of the circumference, and the
actual strip, 2 W wide and infinite along the wire, whose pressure is weighted by the cosine of its place on the wire.
Each is described by a few functions of x = R/W (`Slit`); the equations are the same.
"""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.special import j1

from edmsim.machine.machine import Machine
from edmsim.plant.gap import gas, water

GAP_UM, WIRE_UM, RHO, P0 = (
    gas.REFERENCE_GAP_UM, gas.REFERENCE_DIAMETER_UM, water.DENSITY_KG_M3, gas.AMBIENT_PA
)  # fmt: skip
VISCOSITY_PA_S = 1.0e-3
"""Water at 20 C."""
SEED_UM = 10.0
"""Radius of the bubble at ignition (ours: a channel of about ten um)."""
_SHARE = Machine.load().base.discharge.bubble_share
SHARE = _SHARE.value
"""Share of the energy that goes into the gas, of the default machine (`docs/theory/gas.md`)."""
assert _SHARE.range is not None
LEAST_SHARE, GREATEST_SHARE = _SHARE.range


class Slit(NamedTuple):
    """Effect of a slit's shape on a bubble of radius x, in units of the slit's half width W.

    The bubble's volume grows by 2 pi g K per time. The water has a kinetic energy of rho pi g K^2 L (`inertia`; its
    `slope` is dL/dx), carries rho (K / W)^2 e per volume out through the edges (`outflow`), and would be started
    from rest by an impulse of 2 pi rho K W^2 m (`momentum`). It pushes with the rate of this impulse plus
    rho pi K^2 b (`bernoulli`). The gas reaches the edges at x = `full`; its projected area is then `gas_area` W^2,
    and it escapes through edges of length `opening` W.
    """

    inertia: Callable[[float], float]
    slope: Callable[[float], float]
    outflow: Callable[[float], float]
    momentum: Callable[[float], float]
    bernoulli: Callable[[float], float]
    full: float
    gas_area: float
    opening: float


class Gas(NamedTuple):
    """Share of the discharge's energy in the gas, speed of escape of the gas, and ratio of its heats."""

    share: float = SHARE
    escape_m_s: float = gas.ESCAPE_M_S
    heat_ratio: float = gas.HEAT_RATIO


class Pulse(NamedTuple):
    """A discharge of constant power."""

    power_W: float
    burn_us: float


class Push(NamedTuple):
    """The effect of a bubble, its history, and its balance of ``energy`` in J.

    ``given`` is the energy of gas and seed; it becomes ``internal``, ``work`` on the water, or ``vented``.
    The work becomes ``kinetic`` when the gas reaches the edges, is ``carried`` out, ``rubbed`` (friction), or
    ``displaced`` (work against the ambient pressure).
    """

    impulse_Ns: float
    vent_us: float
    fastest_m_s: float
    energy: Mapping[str, float]
    time_us: NDArray[np.float64]
    pressure_Pa: NDArray[np.float64]
    pushed_Ns: NDArray[np.float64]


DISC = Slit(
    inertia=lambda x: -math.log(x),
    slope=lambda x: -1.0 / x,
    outflow=lambda x: 0.5,
    momentum=lambda x: (1.0 - x * x) / 4.0,
    bernoulli=lambda x: 1.0 + math.log(x),
    full=0.99,  # a thin ring of water breaks
    gas_area=math.pi,
    opening=2.0 * math.pi,
)


def strip(poles: int = 12) -> Slit:
    """Return the functions of the strip in front of a wire, with the bubble constrained to a circle."""
    places = np.linspace(0.02, 0.94, 24)
    found = np.array([_strip_at(x, poles) for x in places])

    def smooth(values: NDArray[np.float64]) -> CubicSpline:
        return CubicSpline(np.concatenate([[0.0], places]), np.concatenate([values[:1], values]))

    # splines of L + ln x and b - ln x, because these have limits at x = 0
    rest, bare = smooth(found[:, 0] + np.log(places)), smooth(found[:, 3] - np.log(places))
    bend, outflow, momentum = rest.derivative(), smooth(found[:, 1]), smooth(found[:, 2])
    return Slit(
        inertia=lambda x: float(rest(x)) - math.log(x),
        slope=lambda x: float(bend(x)) - 1.0 / x,
        outflow=lambda x: float(outflow(x)),
        momentum=lambda x: float(momentum(x)),
        bernoulli=lambda x: float(bare(x)) + math.log(x),
        # a larger circle would need suction in the water, which is under pressure between gas and edges: the bubble
        # bulges instead, and its bulges have reached the edges
        full=0.84,
        gas_area=4.0 * float(j1(math.pi / 2)),
        opening=4.0,  # two edges, each of the bubble's width
    )


def _strip_at(x: float, poles: int) -> tuple[float, float, float, float]:
    """Return L, e, m and b of a circle of radius x in the strip.

    The potential is that of a source between two edges at which it is zero, and of even poles whose strengths make
    it constant on the circle. The real axis is along the wire, the imaginary one along its circumference.
    """
    images = np.arange(-6, 7)
    signs = np.where(abs(images) < 6, 1.0, 0.5) * (-1.0) ** images  # half of the last, because the series alternates

    def basis(at: NDArray[np.complex128], derived: bool) -> NDArray[np.complex128]:
        """Return even poles, or their derivatives, with their images beyond the edges."""
        away = at[..., None] - 2j * images
        square = (x / away) ** 2
        terms, found = signs * (square / away if derived else square), []
        for pole in range(1, poles + 1):
            found.append((-2.0 * pole if derived else 1.0) * terms.sum(axis=-1))
            terms = terms * square
        return np.stack(found, axis=-1)

    def speed(at: NDArray[np.complex128]) -> NDArray[np.float64]:
        """Return the speed of the flow with K = 1."""
        return np.abs(math.pi / 2 / np.sinh(math.pi / 2 * at) - basis(at, True) @ strengths)

    angle = (np.arange(6 * poles) + 0.5) / (6 * poles) * math.pi / 2
    circle = x * np.exp(1j * angle)
    source = -np.log(np.abs(np.tanh(math.pi / 4 * circle)))
    system = np.column_stack([basis(circle, False).real, -np.ones_like(angle)])
    solved = np.linalg.lstsq(system, -source, rcond=None)[0]
    strengths, inertia = solved[:-1], float(solved[-1])
    wire = 2 / math.pi  # radius in half widths
    normal = speed(circle)
    momentum = wire**2 * float((np.cos(circle.imag / wire) * normal).sum() / normal.sum())
    node, weight = np.polynomial.legendre.leggauss(24)
    edge = speed(3.0 * (node + 1.0) + 1j)  # beyond 6 half widths the flow is negligible
    outflow = 12.0 * float(weight @ edge**3) / (4 * math.pi)
    lifted = wire * 12.0 * float(weight @ edge**2) / 2
    turn = math.pi / 4 * (node + 1.0)
    spread = np.log(np.minimum(1.0 / np.sin(turn), 6.0) / x)[:, None]
    field = x * np.exp(0.5 * spread * (node + 1.0) + 1j * turn[:, None])
    squared = (speed(field) * np.abs(field)) ** 2 * np.cos(field.imag / wire) * spread
    drawn = math.pi / 4 * float(weight @ squared @ weight)
    inside = 2 * math.pi * x * wire * float(j1(x / wire))
    risen = inside * float((normal**2).mean()) / 2  # pressure on the circle due to its growth: -dL/dx / 2x
    return inertia, outflow, momentum, (lifted + risen - drawn) / math.pi


def grow(
    pulse: Pulse, gap_um: float, gas: Gas, slit: Slit, diameter_um: float = WIRE_UM, *,
    seed_um: float = SEED_UM, drag: float = 1.0,
) -> Push:
    """Integrate a bubble until its gas has escaped and the discharge has ended, or until its growth ends.

    `drag` is a factor on the friction of laminar flow in the slit.
    """
    g, half = gap_um * 1e-6, math.pi / 4 * diameter_um * 1e-6
    rub = drag * 12 * VISCOSITY_PA_S / g**2
    burn_s, excess = pulse.burn_us * 1e-6, gas.heat_ratio - 1.0

    def rates(_: float, state: NDArray[np.float64], heat_W: float) -> list[float]:
        radius, k, internal = state[:3]
        x = min(radius / half, 1 - 1e-6)
        inertia, swept = slit.inertia(x), 2 * math.pi * g * k
        p = excess * internal / (math.pi * radius**2 * g)
        jet, friction = RHO * (k / half) ** 2 * slit.outflow(x), rub * k * inertia
        driven = p - P0 - friction - jet - RHO * (k / half) ** 2 * slit.slope(x) / (2 * x)
        push = RHO * math.pi * k**2 * slit.bernoulli(x) + rub * 2 * math.pi * k * half**2 * slit.momentum(x)
        return [
            k / radius, driven / (RHO * inertia), heat_W - p * swept, p * swept, jet * swept,
            friction * swept, P0 * swept, push,
        ]  # fmt: skip

    def escapes(_: float, state: NDArray[np.float64], __: float) -> float:
        return float(state[0] - slit.full * half)

    def turns(_: float, state: NDArray[np.float64], __: float) -> float:
        return float(state[1])

    turns.direction = -1.0  # type: ignore[attr-defined]
    escapes.terminal = turns.terminal = True  # type: ignore[attr-defined]
    seed = P0 * math.pi * (seed_um * 1e-6) ** 2 * g / excess
    begin, start, parts = 0.0, np.array([seed_um * 1e-6, 0.0, seed, 0.0, 0.0, 0.0, 0.0, 0.0]), []
    for end, power_W in ((burn_s, pulse.power_W), (burn_s + 1e-3, 0.0)):
        part = solve_ivp(
            rates, (begin, end), start, method="LSODA", rtol=1e-8, events=(escapes, turns), first_step=1e-12,
            atol=[1e-12, 1e-9, *[1e-13] * 6], args=(gas.share * power_W,),
        )  # fmt: skip
        parts.append(part)
        begin, start = float(part.t[-1]), part.y[:, -1]
        if part.status == 1:
            break
    state = np.concatenate([part.y for part in parts], axis=1)
    radius, k, internal, work, carried, rubbed, displaced = (float(value) for value in state[:7, -1])
    started = 2 * math.pi * RHO * half**2 * state[1] * [slit.momentum(r / half) for r in state[0]]
    energy = {
        "given": seed + gas.share * pulse.power_W * min(begin, burn_s), "internal": internal, "work": work,
        "vented": 0.0, "kinetic": RHO * math.pi * g * k**2 * slit.inertia(radius / half), "carried": carried,
        "rubbed": rubbed, "displaced": displaced,
    }  # fmt: skip
    push = Push(
        impulse_Ns=float((started + state[7])[-1]), vent_us=begin * 1e6 if len(parts[-1].t_events[0]) else math.inf,
        fastest_m_s=float((state[1] / state[0]).max()), energy=energy,
        time_us=np.concatenate([part.t for part in parts]) * 1e6,
        pressure_Pa=excess * state[2] / (math.pi * state[0] ** 2 * g), pushed_Ns=started + state[7],
    )  # fmt: skip
    return push if math.isinf(max(push.vent_us, gas.escape_m_s)) else _vent(push, pulse, gas, slit, g, half)


def _vent(push: Push, pulse: Pulse, gas: Gas, slit: Slit, g: float, half: float) -> Push:
    """Integrate the escape of the gas through the slit's edges, while the discharge may still heat it.

    Gas below the ambient pressure does not pull the wire here; `refill` computes what follows.
    """
    excess, edge_m2, area_m2 = gas.heat_ratio - 1.0, slit.opening * half * g, slit.gas_area * half**2
    per_Pa = push.energy["internal"] / push.pressure_Pa[-1]
    choked = 1.0 - ((gas.heat_ratio + 1.0) / 2.0) ** (-gas.heat_ratio / excess)

    def rates(_: float, state: NDArray[np.float64], heat_W: float) -> list[float]:
        p = state[0] / per_Pa
        flow = edge_m2 * gas.escape_m_s * min(1.0, math.sqrt(max(0.0, 1.0 - P0 / p) / choked))
        left = gas.heat_ratio / excess * p * flow
        return [(heat_W - left) * 1e-6, left * 1e-6, max(0.0, p - P0) * area_m2 * 1e-6]

    begin, start = push.vent_us, np.array([push.energy["internal"], 0.0, push.impulse_Ns])
    times, states = [push.time_us], []
    ends = max(pulse.burn_us, begin)
    for end, power_W in ((ends, pulse.power_W), (ends + 60.0, 0.0)):
        if end > begin:
            part = solve_ivp(
                rates, (begin, end), start, method="LSODA", rtol=1e-8, atol=1e-14, max_step=0.5,
                args=(gas.share * power_W,),
            )  # fmt: skip
            times.append(part.t)
            states.append(part.y)
            begin, start = end, part.y[:, -1]
    state = np.concatenate(states, axis=1)
    later = gas.share * pulse.power_W * (ends - push.vent_us) * 1e-6
    energy = {"given": push.energy["given"] + later, "internal": float(start[0]), "vented": float(start[1])}
    return push._replace(
        impulse_Ns=float(start[2]), energy={**push.energy, **energy}, time_us=np.concatenate(times),
        pressure_Pa=np.concatenate([push.pressure_Pa, state[0] / per_Pa]),
        pushed_Ns=np.concatenate([push.pushed_Ns, state[2]]),
    )


def refill() -> tuple[float, float, float]:
    """Integrate the return of the water from a reservoir at ambient pressure into a disc of condensing steam.

    Returns the time in us until the water meets, the impulse until then (suction), and that of the meeting.
    """
    half, rub = math.pi / 4 * WIRE_UM * 1e-6, 12 * VISCOSITY_PA_S / (GAP_UM * 1e-6) ** 2

    def rates(_: float, state: NDArray[np.float64]) -> list[float]:
        radius, k, _ = state
        inertia = math.log(half / radius)
        driven = (-P0 - rub * k * inertia) / RHO + k**2 / (2 * radius**2)
        push = RHO * math.pi * k**2 * (0.5 - inertia)
        return [k / radius, driven / inertia, push + rub * 2 * math.pi * k * half**2 * DISC.momentum(radius / half)]

    def meet(_: float, state: NDArray[np.float64]) -> float:
        return float(state[0] - 0.01 * half)

    meet.terminal = True  # type: ignore[attr-defined]
    start = [0.9999 * half, 0.0, 0.0]
    found = solve_ivp(rates, (0.0, 1e-3), start, method="LSODA", rtol=1e-9, atol=1e-15, events=meet)
    moving = 2 * math.pi * RHO * found.y[1, -1] * half**2 * DISC.momentum(found.y[0, -1] / half)
    return float(found.t[-1] * 1e6), float(found.y[2, -1] + moving), float(-moving)
