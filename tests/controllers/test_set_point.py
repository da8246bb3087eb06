"""The servo with settings of its own: what it does at corners, and where it leads the guides."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from edmsim.controllers import WindowObservation, make
from edmsim.controllers.feed.corners import lead_um
from edmsim.controllers.protocols import tell
from edmsim.errors import InputError
from edmsim.machine.machine import Machine

LEFT = np.array([(0.0, 0.0), (300.0, 0.0), (300.0, 300.0)])
START_UM = 50.0


@pytest.fixture(scope="module")
def machine() -> Machine:
    return Machine.load(height_mm=40.0, tension=8.0)


def seen(path_um: float) -> WindowObservation:
    return WindowObservation(1.0, 0.0255, 10, 40, 40.0, 2.0, 9.0, 10.0, path_um)


@pytest.mark.parametrize("height_mm", [2.0, 40.0, 90.0])
def test_the_wire_is_bent_as_a_string_with_an_even_load(height_mm):
    machine, load = Machine.load(height_mm=height_mm, tension=8.0), 0.3
    length, nodes = machine.guide_distance_mm * 1e-3, 4001
    z = np.linspace(0.0, length, nodes)
    loaded = np.abs(z - length / 2) <= height_mm * 0.5e-3
    # T u'' = -q, u = 0 at both guides: two sums over the nodes
    step = z[1] - z[0]
    slope = -np.cumsum(loaded * load / machine.tension) * step
    bent = np.cumsum(slope) * step
    bent -= z / length * bent[-1]
    assert lead_um(machine, load) == pytest.approx(1e6 * bent[loaded].mean(), rel=2e-3)
    assert lead_um(machine, -load) == -lead_um(machine, load)


@pytest.mark.parametrize("side", [1, -1])
def test_a_corner_is_rounded_on_the_inside_by_what_the_wire_is_ahead(machine, side):
    controller = make("set-point", pull_N_m=0.1, offset_um=-3.0)
    tell(controller, machine, LEFT * (1, side), START_UM)
    assert controller.reset(33.0).offset_um == -3.0
    ahead = lead_um(machine, 0.1)
    offsets = [controller.update(seen(START_UM + path_um)).offset_um for path_um in (299.0, 300.0, 400.0, 600.0)]
    wanted = [0.0, *(side * ahead * math.exp(-behind / 100.0) for behind in (0.0, 100.0, 300.0))]
    assert offsets == pytest.approx([-3.0 + beside for beside in wanted])


def test_pauses_are_longer_near_corners(machine):
    controller = make("set-point", before_um=60.0, behind_um=60.0, corner_factor=4.0, period_factor=0.7)
    tell(controller, machine, LEFT, START_UM)
    controller.reset(33.0)
    periods = [controller.update(seen(START_UM + path_um)).t_period_us for path_um in (200.0, 260.0, 340.0, 400.0)]
    first = machine.t_period_us
    assert periods[1:3] == [round(2.8 * first)] * 2
    assert periods[0] == periods[3] < periods[1]


@pytest.mark.parametrize("name", ["offset_um", "pull_N_m"])
def test_numbers_beside_the_path_have_either_sign(name):
    assert getattr(make("set-point", **{name: -0.5}), name) == -0.5
    with pytest.raises(InputError, match=f"{name} of the set-point controller must be a number, not nan"):
        make("set-point", **{name: math.nan})


def test_a_fixed_feed_has_an_offset():
    controller = make("fixed", feed_um_s=12.0, offset_um=-4.0)
    assert controller.reset(33.0) == controller.update(seen(0.0))
    assert controller.reset(33.0).offset_um == -4.0


def test_the_oracle_of_leads_brings_the_bent_wire_on_the_path(machine):
    """Across the path, to the other side, on either leg; what the wire is bent along the path stays."""
    controller = make("lead-oracle", average_s=0.5, offset_um=1.0)
    tell(controller, machine, LEFT, START_UM)
    assert controller.reset(33.0).offset_um == 1.0
    controller.see(SimpleNamespace(deflection_um=(6.0, -4.0)))
    weight = 1.0 - math.exp(-1.0 / 0.5)  # the first window is seen at 1 s
    along, across = (controller.update(seen(START_UM + path_um)).offset_um for path_um in (299.0, 301.0))
    assert along == pytest.approx(1.0 + 4.0 * weight)  # left of +x is +y
    assert across == pytest.approx(1.0 + 6.0 * weight)  # left of +y is -x
    other = make("lead-oracle", average_s=0.5, offset_um=1.0)
    tell(other, machine, LEFT, START_UM)
    other.reset(33.0)
    other.restore(controller.snapshot())
    other.see(SimpleNamespace(deflection_um=(6.0, -4.0)))
    assert other.update(seen(START_UM + 350.0)) == controller.update(seen(START_UM + 350.0))


def test_pauses_at_corners_grow_with_the_root_of_what_the_wire_bends(machine):
    slack, first = lead_um(machine, 1.0), machine.t_period_us
    for slack_um, factor in ((0.0, 4.0), (slack, 4.0), (slack / 4, 8.0), (100.0 * slack, 1.0)):
        controller = make("set-point", before_um=60.0, corner_factor=4.0, slack_um=slack_um)
        tell(controller, machine, LEFT, START_UM)
        controller.reset(33.0)
        assert controller.update(seen(START_UM + 260.0)).t_period_us == round(factor * first), slack_um
