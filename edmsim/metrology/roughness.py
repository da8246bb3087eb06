"""Roughness of the cut, from the size of its craters."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError

CRATER_DEPTH_RATIO = 0.067
"""Depth over diameter of a crater: median of the nine rows (0.053 to 0.081) of ETH's single discharges in
WEDM (Esteves et al. 2022, Procedia CIRP 113:232, doi:10.1016/j.procir.2022.09.151)."""

CELLS, CELLS_PER_DIAMETER = 128, 24
"""Side of the simulated surface and diameter of a crater, in cells (ours: twice as many of either change Ra by less
than 2 %)."""
LAYERS, LEFT_OUT = 20, 8
"""Craters are laid until they have covered the surface so often, and Ra is not looked at before so often (ours)."""


def roughness_um(crater_volume_um3: float, depth_ratio: float = CRATER_DEPTH_RATIO) -> float:
    """Estimate Ra in um of a surface that craters of a mean volume have made.

    A crater is half a flat ellipsoid, as in ETH's data: volume 2/3 area * depth, so with ``k`` = depth over
    diameter ``V = pi k D**3 / 6``. Ra is `ra_over_depth` times its depth ``k D``. Derived here, not measured: rims
    and recast metal are left out, so take it as a lower bound with the right trend (Ra rises with the cube root of
    the volume; published: with the pulse energy to the power 0.3 to 0.4).

    Parameters
    ----------
    crater_volume_um3 : float
        Mean volume of a crater, 0 or more.
    depth_ratio : float
        Depth over diameter, above 0; 0.053 to 0.081 in ETH's data.

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
    """Ra of a surface of overlapping craters over the depth of one, by simulation: 0.30.

    Every crater is laid on the spot that stands highest, where a spark finds the narrowest gap. Its bowl sinks in
    until it has taken the crater's volume from what stands there, so deeper where others have been before. The mean
    over the simulation's later part is taken. Craters side by side on a flat surface would give 16/81, 0.20.

    Parameters
    ----------
    seed : int
        Of the draws; the result differs by less than 1 % between seeds.
    """
    draw = np.random.default_rng(seed)
    height = 1e-3 * draw.random((CELLS, CELLS))
    radius = CELLS_PER_DIAMETER / 2
    reach = np.arange(-int(radius) - 1, int(radius) + 2)
    craters = round(LAYERS * CELLS**2 / (np.pi * radius**2))
    skipped = craters * LEFT_OUT // LAYERS
    total = 0.0
    for k in range(craters):
        row, column = np.unravel_index(int(height.argmax()), height.shape)
        down, right = reach[:, None] + draw.random() - 0.5, reach[None, :] + draw.random() - 0.5
        bowl = np.sqrt(np.maximum(0.0, 1.0 - (down**2 + right**2) / radius**2))
        around = np.ix_((row + reach) % CELLS, (column + reach) % CELLS)
        height[around] = _cut(height[around], bowl)
        if k >= skipped:
            total += float(np.abs(height - height.mean()).mean())
    return total / (craters - skipped)


def _cut(surface: NDArray[np.float64], bowl: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a surface from which a bowl has taken its volume, sunk in as deep as that needs."""
    inside = bowl > 0.0
    met = np.sort((surface + bowl)[inside])[::-1]  # levels of the bowl's rim at which it meets the places under it
    level = (np.cumsum(met) - bowl.sum()) / np.arange(1, len(met) + 1)  # if it has met so many of them
    rim = level[np.argmax(level >= np.append(met[1:], -np.inf))]
    return np.where(inside, np.minimum(surface, rim - bowl), surface)
