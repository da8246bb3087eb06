"""Arrays of a plant at rest, for a mechanical model without the rest of the plant."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from edmsim.plant.constants import fill_model, reset_arrays, set_vertical
from edmsim.plant.kernel.state import Arrays, ArraySizes, allocate
from edmsim.plant.mechanics.full_model import FullMechanics
from edmsim.plant.mechanics.model import ModalModel


def arrays(
    model: ModalModel | FullMechanics, sizes: ArraySizes, water_K: float,
    along_wire: Mapping[str, NDArray[np.float64]],
) -> Arrays:
    """Allocate the arrays; ``along_wire`` has values for every slice, by name of the array."""
    a = allocate(Arrays, sizes)
    fill_model(a, model)
    set_vertical(a)
    reset_arrays(a, ("reference_um", "distance", "temperature_K", "ray_metal", "metal"), water_K)
    for name, values in along_wire.items():
        getattr(a, name)[..., : len(model.wire_shape)] = values
    return a
