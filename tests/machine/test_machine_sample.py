"""Drawn machines: within their ranges, spread as documented, reproducible, and able to run."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import edmsim
from edmsim.errors import InputError
from edmsim.machine.machine import Machine
from edmsim.machine.options import available
from edmsim.machine.ranges import LOG_FROM_RATIO, MOST_DRAWS, share_of, value_at
from edmsim.machine.setting import discharge_current_A, flushing_Pa, wire_speed_m_s

MACHINE = Machine.load()
UNCERTAIN = MACHINE.uncertain()


def values(machine: Machine) -> dict[str, float]:
    return {name: constant.value for name, constant in machine.uncertain().items()}


def test_uncertain_are_the_constants_with_a_range_by_section_and_name() -> None:
    assert {"gap.critical_um", "wire.strength_MPa", "material.removal_mm3_J"} <= set(UNCERTAIN)
    assert UNCERTAIN["gap.critical_um"] is MACHINE.base.gap.critical_um
    assert all(constant.range is not None for constant in UNCERTAIN.values())
    # what an operator sets and what is known exactly
    assert not {"generator.t_on_us", "gap.median_a_us_um2", "table.step_um"} & set(UNCERTAIN)


@pytest.mark.slow
@settings(max_examples=50)
@given(
    st.integers(0, 2**32), st.sampled_from(available("wires")), st.sampled_from(available("materials")),
    st.sampled_from(available("generators")),
)  # fmt: skip
def test_every_draw_is_a_valid_machine_within_its_ranges(seed: int, wire: str, material: str, generator: str) -> None:
    machine = Machine.load(wire=wire, material=material, generator=generator)
    drawn = machine.sample(np.random.default_rng(seed))
    drawn.check()
    assert Machine.model_validate(drawn.model_dump()) == drawn
    for name, constant in drawn.uncertain().items():
        low, high = cast(Any, constant.range)
        assert low <= constant.value <= high, name
        before = machine.uncertain()[name]
        assert (constant.source, constant.range, type(constant)) == (before.source, before.range, type(before))
    for field in ("tension", "height_mm", "wire_diameter_um", "t_on_us", "t_period_us", "generator", "name"):
        assert getattr(drawn, field) == getattr(machine, field), field


@pytest.mark.slow
@settings(max_examples=200)
@given(st.floats(-10, 1e3), st.floats(1e-6, 1e3), st.floats(0, 1), st.floats(0, 1))
def test_a_larger_share_is_a_larger_value_and_the_ends_are_the_range(
    low: float, span: float, a: float, b: float
) -> None:
    bounds = (low, low + span)
    assert value_at(bounds, 0.0) == low
    assert value_at(bounds, 1.0) == pytest.approx(bounds[1], rel=1e-12)
    less, more = (value_at(bounds, share) for share in sorted((a, b)))
    assert low <= less <= more <= bounds[1]


def test_a_range_of_an_order_is_drawn_by_its_logarithm() -> None:
    assert value_at((1.0, 100.0), 0.5) == pytest.approx(10.0)
    assert value_at((1.0, LOG_FROM_RATIO), 0.5) == pytest.approx(math.sqrt(LOG_FROM_RATIO))
    assert value_at((1.0, 0.999 * LOG_FROM_RATIO), 0.5) == pytest.approx((1 + 0.999 * LOG_FROM_RATIO) / 2)
    assert value_at((0.0, 20.0), 0.5) == 10.0  # from zero there is no logarithm
    assert value_at((-1.0, 9.0), 0.5) == 4.0


@pytest.mark.slow
def test_draws_fill_the_ranges_as_documented() -> None:
    from scipy.stats import kstest

    rng = np.random.default_rng(7)
    draws = [values(MACHINE.sample(rng)) for _ in range(600)]
    for name, constant in UNCERTAIN.items():
        if name == "material.burning_voltage_V":
            continue  # cut short by the generator's mean current: the test below
        low, high = cast(Any, constant.range)
        column = np.array([draw[name] for draw in draws])
        is_log = low > 0 and high / low >= LOG_FROM_RATIO
        shares = np.log(column / low) / np.log(high / low) if is_log else (column - low) / (high - low)
        assert kstest(shares, "uniform").pvalue > 1e-4, name


def test_same_generator_state_same_machine() -> None:
    first, second = (MACHINE.sample(np.random.default_rng(3)) for _ in range(2))
    assert first == second
    rng = np.random.default_rng(3)
    assert MACHINE.sample(rng) == first
    assert MACHINE.sample(rng) != first


def test_only_draws_what_it_names_and_draws_it_alike() -> None:
    drawn = MACHINE.sample(np.random.default_rng(5), only=["gap", "wire.strength_MPa"])
    everything = values(MACHINE.sample(np.random.default_rng(5)))
    changed = {name for name, value in values(drawn).items() if value != UNCERTAIN[name].value}
    assert changed == {name for name in UNCERTAIN if name.startswith("gap.")} | {"wire.strength_MPa"}
    assert {name: values(drawn)[name] for name in changed} == {name: everything[name] for name in changed}
    assert MACHINE.sample(np.random.default_rng(5), only=[]) == MACHINE


@pytest.mark.parametrize("name", ["gravity", "generator", "gap.contact_um", "critical_um", "gap."])
def test_a_name_without_a_range_is_refused_with_those_that_have_one(name: str) -> None:
    with pytest.raises(InputError, match=f"'{name}' is not a section or constant with a range") as caught:
        MACHINE.sample(np.random.default_rng(1), only=["wire", name])
    assert "gap.critical_um" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_single_text_is_refused() -> None:
    with pytest.raises(InputError, match=r"\['gap'\]"):
        MACHINE.sample(np.random.default_rng(1), only="gap")


def test_a_set_up_that_cannot_run_is_drawn_again() -> None:
    """At 30 us in 100 us the generator's 2 A refuse burning voltages below 21.3 V, 13 % of the range."""
    rng = np.random.default_rng(2)
    burning = [MACHINE.sample(rng, only=["material"]).material.burning_voltage_V.value for _ in range(300)]
    least = 100.0 - 2.0 * 11.8 * 100.0 / 30.0
    assert least <= min(burning) < least + 0.3
    assert max(burning) > 29.7
    tight = Machine.load(tension=0.95 * MACHINE.breaking_force)  # holds from 902.5 MPa on
    strengths = [tight.sample(rng, only=["wire"]).wire.strength_MPa.value for _ in range(100)]
    assert 902.5 < min(strengths) < 910


def test_a_setting_no_draw_can_run_is_refused(own_file: Callable[..., str]) -> None:
    wide = "value = 1000.0, range = [1.0, 1000.0]"
    wire = own_file("wires", "brass", ("value = 950.0, range = [900.0, 1000.0]", wide))
    machine = Machine.load(wire=wire)
    tight = machine.with_(tension=0.999 * machine.breaking_force)
    with pytest.raises(InputError, match=f"none of {MOST_DRAWS} machines .* wire tension .* breaks") as caught:
        tight.sample(np.random.default_rng(1), only=["wire"])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("seed", range(6))
def test_a_plant_runs_on_drawn_machines(seed: int) -> None:
    machine = MACHINE.sample(np.random.default_rng(seed))
    plant = edmsim.Plant(machine, seed, resolution="fast")
    interval = 80_000_000  # 25 um/s in steps of 2 um
    windows = []
    for due in range(interval, 40 * interval, interval):
        windows.append(plant.advance([(max(due, plant.time_ns), 0, 1)]))
        while plant.time_ns < due:
            windows.append(plant.advance())
    assert sum(w.spark for w in windows) > 0
    assert plant.removed_mm3 == pytest.approx(plant.craters_mm3, rel=1e-9)


def test_drawn_machines_keep_the_operator_s_choices() -> None:
    """The constants are drawn, the choices made in their place hold all the same."""
    chosen: dict[str, Any] = {"wire_speed_m_s": 0.2, "flushing_lower_Pa": 0.0, "standoff_upper_mm": 0.5,
                              "peak_current_A": 4.0, "open_voltage_V": 90.0}  # fmt: skip
    drawn = MACHINE.with_(**chosen).sample(np.random.default_rng(4))
    assert {name: getattr(drawn, name) for name in chosen} == chosen
    assert values(drawn) == values(MACHINE.sample(np.random.default_rng(4)))
    assert wire_speed_m_s(drawn) == 0.2
    assert discharge_current_A(drawn) == pytest.approx(4.0)  # whatever burning voltage was drawn
    assert flushing_Pa(drawn) == (0.0, drawn.base.dielectric.flushing_pressure_Pa.value)


BOUNDED = {
    "table.backlash_um": "a nut has no less than none",
    "gas.shielding": "gas shields all of the pull at most",
    "cooling.dry_share": "the front is half of the girth",
    "wire.density_kg_m3": "its range is 1 % wide, and its source has that end",
}
"""Constants whose value stands at an end of its range, and why it may."""


@pytest.mark.parametrize("name", sorted(set(UNCERTAIN) - set(BOUNDED)))
def test_the_standard_machine_is_within_what_is_drawn_and_not_at_its_edge(name: str) -> None:
    constant = UNCERTAIN[name]
    assert constant.range is not None
    assert 0.15 <= share_of(constant.range, constant.value) <= 0.86
