"""The machine's own geometry, from its MJCF: what stands, and what each carriage carries."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.recording.rerun.solid import Mesh, box, cylinder, joined, moved

if TYPE_CHECKING:
    import mujoco

BASE, CROSS, TABLE = "base", "cross", "table"
"""What a body of the machine goes with: nothing, the x carriage, the y carriage with the workpiece."""
_CARRIED = {"x_carriage": CROSS, "y_rotor": CROSS, "y_carriage": TABLE}
_PLATE = "workpiece"
"""The drawn workpiece, in whose place the recording draws the one that is cut."""


class Bodies(NamedTuple):
    """Drawn bodies of a machine, in mm from the lower guide's axis and the workpiece's lower face, at X0 Y0.

    Attributes
    ----------
    solids : dict of str to Mesh
        By `BASE`, `CROSS` and `TABLE`.
    colours : dict of str to uint8 array (n, 3)
        A colour for every vertex.
    plate_mm : (low, high)
        Opposite corners of the plate the MJCF draws as workpiece.
    """

    solids: dict[str, Mesh]
    colours: dict[str, NDArray[np.uint8]]
    plate_mm: tuple[tuple[float, float, float], tuple[float, float, float]]


def bodies_of(model: mujoco.MjModel, lower_guide_mm: float) -> Bodies:
    """Return the drawn bodies of a machine.

    Parameters
    ----------
    model : mujoco.MjModel
        Of `edmsim.plant.mechanics.model.build_model`.
    lower_guide_mm : float
        Height of the lower guide over the workpiece's lower face: negative.
    """
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    shift = np.array([0.0, 0.0, lower_guide_mm])
    parts: dict[str, list[Mesh]] = {BASE: [], CROSS: [], TABLE: []}
    colours: dict[str, list[NDArray[np.uint8]]] = {BASE: [], CROSS: [], TABLE: []}
    plate = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    for g in range(model.ngeom):
        geom = model.geom(g)
        at = data.geom_xpos[g] * 1000.0 + shift
        size = geom.size * 1000.0
        if geom.name == _PLATE:
            plate = (tuple((at - size).tolist()), tuple((at + size).tolist()))
            continue
        carrier = _CARRIED.get(model.body(int(geom.bodyid[0])).name, BASE)
        shape = box(size) if geom.type[0] == mujoco.mjtGeom.mjGEOM_BOX else cylinder(size[0], size[1])
        parts[carrier].append(moved(shape, data.geom_xmat[g].reshape(3, 3), at))
        material = int(geom.matid[0])
        rgba = geom.rgba if material < 0 else model.mat_rgba[material]
        colour = np.round(255 * np.asarray(rgba[:3])).astype(np.uint8)
        colours[carrier].append(np.tile(colour, (len(shape.positions), 1)))
    return Bodies(
        {carrier: joined(shapes) for carrier, shapes in parts.items()},
        {carrier: np.concatenate([np.zeros((0, 3), np.uint8), *rows]) for carrier, rows in colours.items()},
        plate,
    )
