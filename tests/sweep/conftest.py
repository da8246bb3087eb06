"""A line of 0.3 mm through thin stock, of which the first second is cut: a fifth of a second of this computer."""

import pytest

from edmsim.sweep.specification import Specification


@pytest.fixture
def line(tmp_path):
    """Part program of a straight line."""
    file = tmp_path / "line.ngc"
    file.write_text("G21 G90\nG0 X0 Y0\nG1 X0.3\nM2\n")
    return file


@pytest.fixture
def short():
    """Settings of a cut that takes no time."""
    return {"resolution": "fast", "max_time_s": 1.0, "offset": "none", "height_mm": 5.0}


@pytest.fixture
def giving_up(tmp_path):
    """A controller that fails in its first window, as a sweep names it."""
    file = tmp_path / "giving_up.py"
    file.write_text(
        "from edmsim.controllers.feed.laws import FixedController\n\n\nclass Own(FixedController):\n"
        "    name = 'own'\n\n    def update(self, window):\n        raise RuntimeError('out of ideas')\n"
    )
    return f"{file}:Own"


@pytest.fixture
def two_controllers(line, short):
    """Two controllers, two seeds."""
    return Specification(
        program=[str(line)], seeds=[0, 1], settings=short, grid={"controller": ["counts", "fixed:feed_um_s=9"]}
    )
