"""Constants that are given as an option of a cut: in force, checked as a file's are, and told afterwards."""

from __future__ import annotations

from typing import Any

import pytest

from edmsim.errors import InputError
from edmsim.job.settings import CutSettings


def test_a_given_constant_is_in_force_and_not_drawn() -> None:
    settings = CutSettings(constants={"gap.critical_um": 5.5, "wire.strength_MPa": 1000})
    machine = settings.load_machine()
    assert machine.base.gap.critical_um.value == 5.5
    assert machine.wire.strength_MPa.value == 1000.0
    assert {"gap.critical_um", "wire.strength_MPa"}.isdisjoint(machine.uncertain())
    assert CutSettings.of_json(settings.model_dump_json()).load_machine() == machine
    table = CutSettings(constants={"geometry.x_pitch_um_m": 10}).load_machine()  # of which our file has none
    assert table.base.geometry.value("x_pitch_um_m") == 10.0


@pytest.mark.parametrize(("given", "named"), [
    ({"gap.colour": 1}, "gap.critical_um"), ({"colour": 1}, "gap.*"), ({"gap.critical_um": -1}, "gap.critical_um"),
    ({"gap.critical_um": float("nan")}, "gap.critical_um"), ({"wire.default_diameter_um": 200}, "brass-200"),
    ({"geometry.x_periodic_um": 2}, "lead_mm"), (3, "{'gap.critical_um': 5.0}"),
])  # fmt: skip
def test_a_constant_that_cannot_be_is_refused_in_one_line(given: Any, named: str) -> None:
    with pytest.raises(InputError) as refused:
        CutSettings(constants=given).load_machine()
    assert named in str(refused.value)
    assert "\n" not in str(refused.value)
