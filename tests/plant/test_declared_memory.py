"""Arrays of the loop are declared once; memory refuses what is not as declared."""

import numpy as np
import pytest

from edmsim.plant.kernel.declare import CHANGING, WALL, allocate, lasting, sizes_of
from edmsim.plant.kernel.memory import Memory
from edmsim.plant.kernel.state import Arrays

SIZES = sizes_of(5, 24, 4)


def test_allocated_arrays_are_as_declared():
    a = allocate(Arrays, SIZES)
    assert a.edge_um.shape == (5, 24)
    assert a.edge_um.dtype == np.float32
    assert a.sway.shape == (4, 8)
    assert a.first.dtype == np.int64
    assert not any(array.any() or array.ctypes.data % 64 for array in a)  # zeros, each on a cache line of its own
    assert len({array.ctypes.data for array in a}) == len(a)


@pytest.mark.parametrize(
    ("name", "wrong"),
    [("wire_q", np.zeros((2, 3))), ("edge_um", np.zeros((5, 24))), ("sway", np.zeros((8, 4)).T)],
)
def test_memory_refuses_another_shape_type_or_order(name, wrong):
    with pytest.raises(TypeError, match=name):
        Memory(SIZES).put(allocate(Arrays, SIZES)._replace(**{name: wrong}))


def test_what_lasts_with_the_wall_is_part_of_a_snapshot():
    assert set(lasting(Arrays, WALL)) < set(lasting(Arrays, WALL, CHANGING))
    assert "shape" not in lasting(Arrays, WALL, CHANGING)
