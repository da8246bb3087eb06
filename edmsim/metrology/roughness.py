"""Roughness of the cut, from the size of its craters."""

from __future__ import annotations

import numpy as np

from edmsim.errors import InputError

CRATER_DEPTH_RATIO = 0.067
"""Depth over diameter of a crater: median of the nine rows (0.053 to 0.081) of ETH's single discharges in
WEDM (Esteves et al. 2022, Procedia CIRP 113:232, doi:10.1016/j.procir.2022.09.151)."""


def roughness_um(crater_volume_um3: float, depth_ratio: float = CRATER_DEPTH_RATIO) -> float:
    """Estimate Ra in um of a surface that craters of a mean volume cover side by side.

    A crater is half a flat ellipsoid, as in ETH's data: volume 2/3 area * depth, so with ``k`` = depth over
    diameter ``V = pi k D**3 / 6``. Over its area the depth is ``k D sqrt(u)``, ``u`` uniform in 0..1: on
    average 2/3 of the full depth, with a mean deviation, which is Ra, of 16/81 of it. Derived here, not
    measured: rims, overlap and recast metal are left out, so take it as a lower bound with the right trend
    (Ra rises with the cube root of the volume; published: with the pulse energy to the power 0.3 to 0.4).

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
    return 16 / 81 * depth_ratio * diameter_um
