"""Roughness of the cut from the size of its craters, and the layers of its face that heat and water changed.

There are two layers, one affected by the heat of sparks and one dissolved by the water (thesis, 2.6). Both are far
thinner than the cells of the kerf field, so they are computed from totals of the cut instead of measured there.
"""

import math
from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError, refuses_wrong_types
from edmsim.machine.machine import Machine

CELLS, CELLS_PER_DIAMETER = 128, 24
"""Side of the simulated surface and diameter of a crater, in cells (ours: twice as many of either change Ra by less
than 2 %)."""
LAYERS, LEFT_OUT = 20, 8
"""Number of times that the craters cover the surface in total, and before Ra is first measured (ours)."""


@refuses_wrong_types
def roughness_um(crater_volume_um3: float, depth_ratio: float) -> float:
    """Estimate Ra in um of a surface from the mean volume of its craters.

    A crater is half a flat ellipsoid, as in ETH's data: its volume is 2/3 area * depth, or ``V = pi k D**3 / 6``
    with ``k`` = depth over diameter. Ra is `ra_over_depth` times the depth ``k D``. This is derived, not measured.
    It omits rims and recast metal, and is a lower bound with the right trend (Ra rises with the cube root of the
    volume; published: with the pulse energy to the power 0.3 to 0.4).

    Parameters
    ----------
    crater_volume_um3 : float
        Mean volume of a crater, 0 or more.
    depth_ratio : float
        Depth over diameter, above 0: the machine's constant `discharge.crater_flatness`. ETH's data have 0.065 to
        0.081.

    Raises
    ------
    InputError
        If the volume is negative or the ratio not above 0.
    """
    if not crater_volume_um3 >= 0:
        raise InputError(f"a crater volume of {crater_volume_um3} um3 cannot be: it must be 0 or more")
    if not depth_ratio > 0:
        raise InputError(f"a crater depth ratio of {depth_ratio} cannot be: it must be above 0")
    diameter_um = float(np.cbrt(6 * crater_volume_um3 / (np.pi * depth_ratio)))
    return ra_over_depth() * depth_ratio * diameter_um


@cache
def ra_over_depth(seed: int = 0) -> float:
    """Ra of a surface of overlapping craters over the depth of one, by simulation: 0.30, within 1 % for any seed."""
    # Each crater is placed at the highest point, where the gap is narrowest. Its bowl is lowered until it has removed
    # the crater's volume, so it goes deeper where earlier craters have removed metal. The result is the mean over the
    # later part of the simulation. Separate craters on a flat surface would give 16/81, 0.20.
    draw = np.random.default_rng(seed)
    height = 1e-3 * draw.random((CELLS, CELLS))
    radius = CELLS_PER_DIAMETER / 2
    craters = round(LAYERS * CELLS**2 / (np.pi * radius**2))
    skipped = craters * LEFT_OUT // LAYERS
    total = 0.0
    for k in range(craters):
        _lay(height, radius, draw)
        if k >= skipped:
            total += float(np.abs(height - height.mean()).mean())
    return total / (craters - skipped)


def _lay(height: NDArray[np.float64], radius: float, draw: np.random.Generator, volume: float | None = None) -> None:
    """Cut a crater of this radius (and volume), in cells, at the highest point of a periodic surface."""
    reach = np.arange(-int(radius) - 1, int(radius) + 2)
    row, column = np.unravel_index(int(height.argmax()), height.shape)
    down, right = reach[:, None] + draw.random() - 0.5, reach[None, :] + draw.random() - 0.5
    bowl = np.sqrt(np.maximum(0.0, 1.0 - (down**2 + right**2) / radius**2))
    if volume is not None:
        bowl *= volume / bowl.sum()
    around = np.ix_((row + reach) % len(height), (column + reach) % len(height))
    height[around] = _cut(height[around], bowl)


def _cut(surface: NDArray[np.float64], bowl: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lower a bowl into a surface until it has removed its own volume; return the new surface."""
    inside = bowl > 0.0
    met = np.sort((surface + bowl)[inside])[::-1]  # levels of the bowl's rim at which it reaches the cells below it
    level = (np.cumsum(met) - bowl.sum()) / np.arange(1, len(met) + 1)  # rim level if it has reached 1, 2, ... cells
    rim = level[np.argmax(level >= np.append(met[1:], -np.inf))]
    return np.where(inside, np.minimum(surface, rim - bowl), surface)


CONDUCTIVITY_PER_K = 0.02
"""Rise of the conductivity of water per kelvin above 298 K (handbook: some 2 % for all dilute solutions)."""
STANDARD_K = 298.0  # temperature at which a conductivity is stated


def heat_affected_um(machine: Machine, discharge_us: float) -> float:
    """Return how deep a discharge heats the metal below its crater beyond `affected_K`; NaN for unknown metals.

    Heat flows in from a floor at the melting point for the time of the discharge (docs/theory/workpiece.md).
    """
    from scipy.special import erfcinv

    if not discharge_us >= 0:
        raise InputError(f"a discharge of {discharge_us:g} us cannot be: it lasts 0 us or more")
    surface, water_K = machine.material.surface, machine.base.dielectric.temperature_K.value
    if surface is None:
        return math.nan
    share = (surface.affected_K.value - water_K) / (surface.melting_K.value - water_K)
    return 2.0 * math.sqrt(surface.diffusivity_mm2_s.value * discharge_us) * float(erfcinv(share))


def electrolysed_um(machine: Machine, voltage_s_mm: float, gap_um: float) -> float:
    """Return the depth of metal that the mean voltage dissolves from the walls as the wire passes; NaN if unknown.

    All charge between a cylinder and a plane dissolves metal, an upper bound (docs/theory/workpiece.md). The voltage
    has its sign, and is summed over time per length of path.
    """
    surface, water = machine.material.surface, machine.base.dielectric
    if surface is None or not gap_um > 0:
        return math.nan
    warmer_K = water.gap_temperature_K.value - STANDARD_K
    conductivity_S_mm = water.conductivity_uS_cm.value * 1e-7 * (1.0 + CONDUCTIVITY_PER_K * warmer_K)
    spread = math.acosh(1.0 + gap_um / (machine.wire_diameter_um / 2))
    charge_C_mm2 = math.pi * conductivity_S_mm * voltage_s_mm / spread
    return charge_C_mm2 * surface.dissolved_mm3_C.value * 1e3


FACE_CELLS, FACE_CELLS_PER_DIAMETER = 144, 32
"""Side of the simulated surface of several passes, and diameter of the largest crater, in cells (ours)."""
FACE_LAYERS = 12  # coverings after which no trace of earlier passes is left; the rough pass has all (ours)
FEWEST_CELLS = 3.0  # least diameter of a simulated crater; smaller ones are widened at equal volume (ours)


def face_roughness_um(
    crater_volumes_um3: Sequence[float], taken_um: Sequence[float], depth_ratio: float
) -> list[float]:
    """Return Ra in um after each of several passes; NaN for the first pass with unknown data and all after it."""
    # Craters are placed as in `ra_over_depth`. A fine pass that removes little metal removes the peaks of the coarse
    # pass before it and leaves the valleys; one that removes enough metal leaves no trace of the coarse pass.
    diameters_um = np.cbrt(6 * np.asarray(crater_volumes_um3, np.float64) / (np.pi * depth_ratio))
    if not len(diameters_um):
        return []
    draw = np.random.default_rng(0)
    height, found = 1e-3 * draw.random((FACE_CELLS, FACE_CELLS)), []
    cell_um = float(np.nanmax(diameters_um)) / FACE_CELLS_PER_DIAMETER
    for number, (volume, diameter) in enumerate(zip(crater_volumes_um3, diameters_um, strict=True)):
        share = taken_um[number] if number else math.inf
        if not (volume > 0 and share == share):
            found += [math.nan] * (len(diameters_um) - number)
            break
        across = max(float(diameter) / cell_um, FEWEST_CELLS)
        most = FACE_LAYERS * FACE_CELLS**2 / (math.pi * (across / 2) ** 2)
        count = min(max(share, 0.0) * (FACE_CELLS * cell_um) ** 2 / volume, most)
        for _ in range(round(count)):
            _lay(height, across / 2, draw, volume / cell_um**3)
        found.append(float(np.abs(height - height.mean()).mean()) * cell_um)
    return found
