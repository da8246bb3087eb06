"""The cuts controllers are compared on: one for each environment, drawn from a seed.

Whatever is random of a cut, its machine, heights, tension, corner, follows from the seed alone, so that every
controller meets the same ones. Seeds from `HELD_BACK` on are for comparing, those below for finding gains.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources

import numpy as np
import shapely
from numpy.typing import NDArray

from ..errors import InputError
from ..machine import Machine
from ..plant.relief import HeightStep
from ..plant.workpiece import Stock
from ..program.path import Contour, plan_path
from ..slot import begun_slot
from ..validation.setups import CENTRE_UM

HELD_BACK = 1_000_000
"""First seed of the comparisons; no gain is ever looked for at or above it."""
MAX_FEED_UM_S = 100.0
"""Feed a controller may command, either way (ours: above what any machine drawn here can cut)."""
HEIGHTS_MM = (4.0, 40.0)
"""Range of workpiece heights, drawn log-uniformly (ours: thin sheet to a die plate)."""
TALL_MM = (15.0, 40.0)
"""Range of the greater height of a stepped workpiece, drawn log-uniformly (ours)."""
THIN_SHARE = (0.12, 0.35)
"""Range of the lower height's share of it (ours: less than 1/10 would be lost between the slices of `fast`)."""
CONTOUR_HEIGHTS_MM = (4.0, 20.0)
"""Range of heights of the contour, drawn log-uniformly (ours)."""
TENSION = (8.0, 20.0)
"""Range of wire tensions in newton (within the 8 to 22 N of wires of 0.25 to 0.3 mm)."""
TURN_DEG = (45.0, 135.0)
"""Range of the corner's turn, to either side (ours: from blunt to sharp)."""
LENGTH_UM = 1000.0
"""Straight cut, and legs of the corner together."""
STRETCH_UM = 400.0
"""Length of each height of a stepped workpiece."""
NEAR_CORNER_UM = 300.0
"""Distance from the corner within which its error is taken: a little more than the wire."""


@dataclass(frozen=True)
class Scenario:
    """One cut, ready to begin.

    Attributes
    ----------
    machine : Machine
    stock : Stock
    points_um : float64 array (n, 2)
        The wire's path.
    limit_s : float
        Machine time after which the cut ends.
    corner_um : (float, float) or None
        Where the wire's true path is compared with the path.
    contour : Contour or None
        What the cut edge is compared with.
    """

    machine: Machine
    stock: Stock
    points_um: NDArray[np.float64]
    limit_s: float
    corner_um: tuple[float, float] | None = None
    contour: Contour | None = None


def draw(env_id: str, seed: int) -> Scenario:
    """Draw a cut.

    Parameters
    ----------
    env_id : str
        One of `env_ids`.
    seed : int
        0 or more.

    Raises
    ------
    InputError
        If there is no such environment.
    """
    if env_id not in _DRAW:
        raise InputError(f"there is no environment '{env_id}'; choose one of {', '.join(_DRAW)}")
    return _DRAW[env_id](np.random.default_rng(seed))


def env_ids() -> tuple[str, ...]:
    """Names of the environments."""
    return tuple(_DRAW)


def _log_uniform(rng: np.random.Generator, bounds: tuple[float, float]) -> float:
    return math.exp(rng.uniform(math.log(bounds[0]), math.log(bounds[1])))


def _machine(rng: np.random.Generator, height_mm: float) -> Machine:
    """Draw all uncertain constants and the tension."""
    return Machine.load(height_mm=height_mm, tension=rng.uniform(*TENSION)).sample(rng)


def _straight(length_um: float) -> NDArray[np.float64]:
    x, y = CENTRE_UM
    return np.array([(x, y), (x + length_um, y)])


def _gap_feed(rng: np.random.Generator) -> Scenario:
    machine = _machine(rng, _log_uniform(rng, HEIGHTS_MM))
    return Scenario(machine, begun_slot(machine, CENTRE_UM), _straight(LENGTH_UM), limit_s=180.0)


def _height_step(rng: np.random.Generator) -> Scenario:
    """From tall to thin and back to tall."""
    tall_mm, thin_share = _log_uniform(rng, TALL_MM), rng.uniform(*THIN_SHARE)
    machine = _machine(rng, tall_mm)
    whole = begun_slot(machine, CENTRE_UM)
    _, y0, _, y1 = whole.rectangle_um
    x = CENTRE_UM[0]
    thin = HeightStep(shapely.box(x + STRETCH_UM, y0, x + 2 * STRETCH_UM, y1), tall_mm * thin_share)
    stock = Stock(whole.rectangle_um, whole.holes_um, (thin,), tall_mm)
    return Scenario(machine, stock, _straight(3 * STRETCH_UM), limit_s=240.0)


def _corner(rng: np.random.Generator) -> Scenario:
    machine = _machine(rng, _log_uniform(rng, HEIGHTS_MM))
    turn = math.radians(rng.uniform(*TURN_DEG)) * rng.choice((-1.0, 1.0))
    x, y = CENTRE_UM
    leg = LENGTH_UM / 2
    corner = (x + leg, y)
    end = (corner[0] + leg * math.cos(turn), y + leg * math.sin(turn))
    path = np.array([(x, y), corner, end])
    return Scenario(machine, begun_slot(machine, CENTRE_UM), path, limit_s=180.0, corner_um=corner)


def _contour(rng: np.random.Generator) -> Scenario:
    """A small part; its offset is that of the machine's undrawn constants, for nobody knows the drawn ones."""
    height_mm = _log_uniform(rng, CONTOUR_HEIGHTS_MM)
    machine = _machine(rng, height_mm)
    program = resources.files("edmsim.evaluation") / "small-part.ngc"
    with resources.as_file(program) as file:
        path = plan_path(file, "auto", auto_offset_mm=Machine.load(height_mm=height_mm).auto_offset_mm)
    contour = path.contours[0]
    x0, y0, x1, y1 = (1e3 * side for side in path.stock_mm)
    start = contour.points_um[0].astype(np.float64)
    hole = (float(start[0]), float(start[1]), 1e3 * path.start_hole_radius_mm)
    return Scenario(
        machine, Stock((x0, y0, x1, y1), (hole,)), contour.points_um.astype(np.float64), limit_s=600.0,
        contour=contour,
    )


_DRAW: dict[str, Callable[[np.random.Generator], Scenario]] = {
    "edmsim/GapFeed-v0": _gap_feed,
    "edmsim/HeightStep-v0": _height_step,
    "edmsim/Corner-v0": _corner,
    "edmsim/Contour-v0": _contour,
}
