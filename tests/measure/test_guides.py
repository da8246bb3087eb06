"""Where the guides are, found from a test cut, as `edmsim measure guides` does."""

from __future__ import annotations

import pytest

from edmsim.errors import InputError
from edmsim.machine.machine import Machine
from edmsim.machine.overrides import with_overrides
from edmsim.measure.guides import measure_guides

LOWER_MM, UPPER_MM = 0.1, -0.06


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_errors_of_both_guides_are_found_from_a_leaning_block():
    machine = with_overrides(
        Machine.load(height_mm=6.0), (("guides.lower_error_mm", LOWER_MM), ("guides.upper_error_mm", UPPER_MM))
    )
    found = measure_guides(machine, 15.0, seed=1)
    assert found.lower_mm == pytest.approx(LOWER_MM, abs=0.02)
    assert found.upper_mm == pytest.approx(UPPER_MM, abs=0.02)
    # a lower guide that is too high takes the wall back at its own height, an upper one that is too low takes it on
    assert found.shift_um[0] < -3.0


@pytest.mark.parametrize(("angle", "said"), [(0.5, "give 1 to 30"), (31.0, "give 1 to 30")])
def test_a_block_that_does_not_lean_is_refused(angle, said):
    with pytest.raises(InputError, match=said):
        measure_guides(Machine.load(height_mm=6.0), angle)


def test_a_machine_whose_upper_guide_does_not_move_is_refused():
    machine = Machine.load(height_mm=6.0)
    guides = machine.base.guides.model_copy(update={"upper_travel_mm": None})
    still = machine.model_copy(update={"base": machine.base.model_copy(update={"guides": guides})})
    with pytest.raises(InputError, match="no guides that lead"):
        measure_guides(still)
