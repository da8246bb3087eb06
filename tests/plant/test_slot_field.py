"""The field of a pulse in the wire's slot: closed forms at both ends of permeability and conductivity."""

import math
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "docs" / "make" / "slot_field.py"
WIDTHS = 2 * math.pi * (125 + 27) / (250 + 2 * 36)
"""2 pi d / w: the wire's distance from the end of the slot, over the slot's width."""


@pytest.fixture(scope="module")
def field(load_script):
    return load_script(SCRIPT)


@pytest.fixture(scope="module")
def slot(field):
    return field.slot()


@pytest.mark.slow
def test_permeable_metal_pulls_as_images_of_the_same_sign_do(field, slot):
    """In a slot with a flat end, coth(2 pi d / w); the round one has the metal a little nearer."""
    ideal = field.steady_share(slot, field.Metal(0.0, 1e5), 350.0)
    assert ideal == pytest.approx(1 / math.tanh(WIDTHS), rel=0.04)
    assert field.steady_share(slot, field.Metal(0.0, 1.0), 350.0) == pytest.approx(0.0, abs=1e-3)


@pytest.mark.slow
def test_a_conductor_repels_as_images_of_alternating_sign_do(field, slot):
    """In a slot with a flat end, -1 / sinh(2 pi d / w)."""
    share = field.pulse_share(slot, field.Metal(1e11, 1.0), 350.0, 1.4)
    assert share == pytest.approx(-1 / math.sinh(WIDTHS), rel=0.3)


@pytest.mark.slow
def test_saturation_and_eddy_currents_lower_the_share(field, slot):
    steel = field.Metal(0.0, 100.0, 1.7)
    weak, strong = (field.steady_share(slot, steel, current_A) for current_A in (3.5, 350.0))
    linear = field.steady_share(slot, steel._replace(saturation_T=math.inf), 350.0)
    assert weak == pytest.approx(linear, rel=0.01)
    assert strong < 0.8 * weak
    long = field.pulse_share(slot, steel._replace(conductivity_S_m=2e6), 350.0, 1e5, field.rectangle)
    assert long == pytest.approx(strong, rel=0.02)
    assert field.pulse_share(slot, steel._replace(conductivity_S_m=2e6), 350.0, 1.4) < 0.5 * strong
