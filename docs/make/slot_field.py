"""The magnetic field of a pulse in the wire and its slot: a plane field with saturation and eddy currents.

The vector potential A obeys sigma dA/dt - div(nu grad A) = J. J is the current density of the wire, sigma the
conductivity of the metal, nu its reluctivity by a magnetisation M = M_s H / (H + H_half) (Froehlich). Linear
triangles and implicit Euler steps, each solved by Newton's method; half of the section, as the slot is symmetric.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import spsolve

from edmsim.plant.wire import VACUUM_PERMEABILITY_N_A2 as MU_0

Floats = NDArray[np.float64]

WIRE_UM, FRONT_UM, SIDE_UM = 250.0, 27.0, 36.0  # wire, and gaps of a rough cut in front of it and beside it
CELL_UM, SLOT_UM, FAR_UM, GROWTH = 8.0, 600.0, 3000.0, 1.25
"""Cells at the wire (twice as long behind it), length of slot with them, distance of the outer edge, and growth of
cells outwards (ours: cells half as wide change the force by 1 %)."""
STEPS, MOST_ITERATIONS, CONVERGED = 40, 60, 1e-7


class Metal(NamedTuple):
    """Conductivity (S/m), initial relative permeability, and magnetisation at saturation (T) of a metal."""

    conductivity_S_m: float
    permeability: float
    saturation_T: float = math.inf  # no saturation


class Slot(NamedTuple):
    """Triangles of the half section: nodes, gradients of their linear functions, and what lies in them."""

    triangles: NDArray[np.intp]  # (n, 3) nodes
    gradients: Floats  # (n, 3, 2) of the linear functions, 1/m
    area: Floats  # (n,) m2
    in_metal: NDArray[np.bool_]
    in_wire: NDArray[np.bool_]
    free: NDArray[np.intp]  # nodes within the outer edge
    nodes: int

    @property
    def wire_m2(self) -> float:
        """Area of the whole wire as the triangles have it."""
        return 2.0 * float(self.area[self.in_wire].sum())


def _outwards_um(from_um: float, to_um: float, cell_um: float) -> list[float]:
    """Return places beyond `from_um`, up to `to_um`, whose distances grow."""
    places = []
    while from_um + cell_um < to_um:
        from_um += cell_um
        places.append(from_um)
        cell_um *= GROWTH
    return [*places, to_um]


def slot() -> Slot:
    """Divide the section into triangles; the slot runs along -x and ends in front of the wire, at the origin."""
    near_um = WIRE_UM / 2 + 4 * max(FRONT_UM, SIDE_UM)
    ahead = [*np.arange(0.0, near_um, CELL_UM), *_outwards_um(near_um, FAR_UM, CELL_UM)]
    behind = [*np.arange(2 * CELL_UM, SLOT_UM, 2 * CELL_UM), *_outwards_um(SLOT_UM, FAR_UM, 2 * CELL_UM)]
    x_m, y_m = 1e-6 * np.array([*(-place for place in reversed(behind)), *ahead]), 1e-6 * np.array(ahead)
    x, y = (grid.ravel() for grid in np.meshgrid(x_m, y_m, indexing="ij"))
    corner = np.arange(x.size).reshape(len(x_m), len(y_m))
    quads = np.stack([corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]], axis=-1)
    even = np.add.outer(np.arange(len(x_m) - 1), np.arange(len(y_m) - 1)) % 2 == 0  # diagonals alternate
    triangles = np.concatenate(
        [quads[even][:, [0, 1, 2]], quads[even][:, [0, 2, 3]], quads[~even][:, [0, 1, 3]], quads[~even][:, [1, 2, 3]]]
    )
    px, py = x[triangles], y[triangles]
    across = np.stack([np.roll(py, -1, 1) - np.roll(py, -2, 1), np.roll(px, -2, 1) - np.roll(px, -1, 1)], axis=-1)
    area = 0.5 * (across[:, 0, 0] * across[:, 1, 1] - across[:, 0, 1] * across[:, 1, 0])
    centre_um = 1e6 * np.stack([px.mean(1), py.mean(1)])
    from_wire_um = np.hypot(*centre_um)
    sideways = (centre_um[1] / from_wire_um) ** 2
    end_um = WIRE_UM / 2 + FRONT_UM + (SIDE_UM - FRONT_UM) * sideways
    in_slot = np.where(centre_um[0] >= 0.0, from_wire_um < end_um, centre_um[1] < WIRE_UM / 2 + SIDE_UM)
    inside = (x > x_m[0]) & (x < x_m[-1]) & (y < y_m[-1])  # no flux crosses the outer edge
    return Slot(triangles, across / (2 * area)[:, None, None], area, ~in_slot, from_wire_um < WIRE_UM / 2,
                np.flatnonzero(inside), x.size)


def _reluctivity(flux2_T2: Floats, metal: Metal) -> tuple[Floats, Floats]:
    """Return the reluctivity at a squared flux density, and its derivative."""
    if math.isinf(metal.saturation_T):
        same = np.full(flux2_T2.shape, 1.0 / (MU_0 * metal.permeability))
        return same, np.zeros_like(same)
    most = metal.saturation_T / MU_0
    half = most / (metal.permeability - 1.0)
    flux = np.sqrt(flux2_T2) + 1e-9
    # B = mu_0 (H + M_s H / (H + H_half)), solved for H
    short, product = half + most - flux / MU_0, 4.0 * half * flux / MU_0
    root = np.sqrt(short**2 + product)
    field = np.where(short > 0.0, 0.5 * product / (short + root), 0.5 * (root - short))
    slope = MU_0 * (1.0 + most * half / (field + half) ** 2)
    return field / flux, (1.0 / slope - field / flux) / (2.0 * flux**2)


class _Step:
    """The equations of one step in time, or of a steady current if the step is infinite."""

    def __init__(self, at: Slot, metal: Metal, step_s: float) -> None:
        self.at, self.metal = at, metal
        self._to = np.repeat(at.triangles, 3, axis=1).ravel(), np.tile(at.triangles, (1, 3)).ravel()
        weight = at.area * np.where(at.in_metal, metal.conductivity_S_m / step_s, 0.0) / 12.0
        self._eddies = self._matrix(weight[:, None, None] * (np.ones((3, 3)) + np.eye(3)))
        self._stiffness = np.einsum("eid,ejd->eij", at.gradients, at.gradients) * at.area[:, None, None]
        self.load = np.zeros(at.nodes)
        np.add.at(self.load, at.triangles[at.in_wire], at.area[at.in_wire, None] / (3.0 * at.wire_m2))

    def _matrix(self, elements: Floats) -> csr_matrix:
        return csr_matrix((elements.ravel(), self._to), shape=(self.at.nodes, self.at.nodes))

    def _elements(self, potential: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the reluctivity of every triangle, its derivative, and the product of stiffness and potential."""
        at = self.at
        flux = np.einsum("ei,eid->ed", potential[at.triangles], at.gradients)
        nu, slope = np.full(len(at.area), 1.0 / MU_0), np.zeros(len(at.area))
        nu[at.in_metal], slope[at.in_metal] = _reluctivity((flux**2).sum(1)[at.in_metal], self.metal)
        return nu, slope, np.einsum("eij,ej->ei", self._stiffness, potential[at.triangles])

    def _residual(self, growth: Floats, elements: tuple[Floats, Floats, Floats], current_A: float) -> Floats:
        nu, _, product = elements
        left = self._eddies @ growth - current_A * self.load
        np.add.at(left, self.at.triangles, nu[:, None] * product)
        return left[self.at.free]

    def solve(self, before: Floats, current_A: float) -> Floats:
        """Return the potential at the end of the step, by Newton's method with a search along its direction."""
        potential, free, elements = before.copy(), self.at.free, self._elements(before)
        residual = self._residual(np.zeros_like(before), elements, current_A)
        for _ in range(MOST_ITERATIONS):
            nu, slope, product = elements
            bend = 2.0 * (slope / self.at.area)[:, None, None] * product[:, :, None] * product[:, None, :]
            matrix = self._matrix(nu[:, None, None] * self._stiffness + bend) + self._eddies
            direction, part = spsolve(matrix[free][:, free].tocsc(), -residual), 1.0
            size = np.linalg.norm(residual)
            while part > 1e-3:
                trial = potential.copy()
                trial[free] += part * direction
                elements = self._elements(trial)
                residual = self._residual(trial - before, elements, current_A)
                if np.linalg.norm(residual) < (1.0 - 0.1 * part) * size:
                    break
                part /= 2.0
            potential = trial
            if np.linalg.norm(part * direction) < CONVERGED * np.linalg.norm(potential):
                return potential
        raise ArithmeticError(f"no field was found for {current_A:g} A")

    def force_N_m(self, potential: Floats, current_A: float) -> float:
        """Return the force on the wire towards the end of the slot."""
        wire = self.at.in_wire
        upward = np.einsum("ei,ei->e", potential[self.at.triangles[wire]], self.at.gradients[wire, :, 0])
        return float(2.0 * current_A / self.at.wire_m2 * (upward * self.at.area[wire]).sum())


def ideal_N_m(current_A: float) -> float:
    """Return the force in a slot of ideally permeable metal, mu_0 i^2 / (2 w)."""
    return MU_0 * current_A**2 / (2.0 * (WIRE_UM + 2 * SIDE_UM) * 1e-6)


def steady_share(at: Slot, metal: Metal, current_A: float) -> float:
    """Return the force of a steady current over the ideal one."""
    step = _Step(at, metal, math.inf)
    return step.force_N_m(step.solve(np.zeros(at.nodes), current_A), current_A) / ideal_N_m(current_A)


def triangle(time: float) -> float:
    """Return the current of a triangular pulse over its peak, at a share of its duration."""
    return 1.0 - abs(2.0 * time - 1.0)


def rectangle(time: float) -> float:
    """Return the current of a rectangular pulse over its height."""
    return 1.0


def pulse_share(
    at: Slot, metal: Metal, peak_A: float, on_us: float, form: Callable[[float], float] = triangle
) -> float:
    """Return the impulse of a pulse on the wire over that in a slot of ideally permeable metal."""
    step, potential = _Step(at, metal, on_us * 1e-6 / STEPS), np.zeros(at.nodes)
    found = ideal = 0.0
    for number in range(1, STEPS + 1):
        current_A = peak_A * form(number / STEPS)
        potential = step.solve(potential, current_A)
        found += step.force_N_m(potential, current_A)
        ideal += ideal_N_m(current_A)
    return found / ideal
