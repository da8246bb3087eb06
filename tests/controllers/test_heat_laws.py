"""Laws that set the period by the wire's heat, and those they are compared with."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edmsim import controllers
from edmsim.controllers import WindowObservation
from edmsim.controllers.feed.periods import heat_per_ignition_s
from edmsim.controllers.protocols import SeesBreaks, tell
from edmsim.machine.machine import Machine

PATH = np.zeros((2, 2))
WINDOW_S = 0.02


def machine(**choices: float) -> Machine:
    given = {"height_mm": 60.0, "tension": 22.0, **choices}
    return Machine.load("production", generator="production", wire="brass-300", **given)


def seen(time_s: float, fifths: tuple[int, ...] = (30,) * 5) -> WindowObservation:
    ignited = sum(fifths)
    return WindowObservation(time_s, WINDOW_S, 20, 235 - ignited, 30.0, 5.0, 5.0, 10.0, 0.0, fifths)


def periods(name: str, fifths: tuple[int, ...], seconds: float = 3.0, **parameters: float) -> list[float]:
    controller = controllers.make(name, **parameters)
    tell(controller, machine(), PATH, 0.0)
    controller.reset(400.0)
    count = round(seconds / WINDOW_S)
    answers = [controller.update(seen((k + 1) * WINDOW_S, fifths)) for k in range(count)]
    return [answer.t_period_us or 0.0 for answer in answers]


def test_heat_of_an_ignition_is_that_of_its_spark_and_of_its_current() -> None:
    """Closed form: all that a middle spark gives the wire beside the workpiece; half its current flows either way."""
    m = machine()
    cooling, wire = m.base.cooling, m.wire
    on_s, current_A, area_m2 = m.t_on_us * 1e-6, 350.0, math.pi / 4 * 0.3e-3**2
    spark_J = cooling.wire_heat_share.value * current_A * m.material.burning_voltage_V.value * on_s
    joule_J = 4 / 3 * current_A**2 * on_s * wire.resistivity_Ohm_m.value / area_m2 * 0.06 / 4
    patch_m2 = math.pi * 0.3e-3 * 0.06 / 5
    expected = (spark_J + joule_J) / (patch_m2 * cooling.critical_W_m2.value)
    assert heat_per_ignition_s(m)[:, 2].sum() == pytest.approx(expected, rel=1e-3)
    assert heat_per_ignition_s(machine(height_mm=30.0))[0, 0] > 1.4 * heat_per_ignition_s(m)[0, 0]


def test_constants_of_the_machine_at_work_are_not_looked_at() -> None:
    drawn = machine().sample(np.random.default_rng(3), ["cooling", "wire", "material", "guides"])
    assert np.array_equal(heat_per_ignition_s(drawn), heat_per_ignition_s(machine()))


def test_sparks_in_one_place_ask_for_a_longer_period_than_as_many_all_over() -> None:
    spread, crowded = (periods("heat-flux", fifths, hold_share=0.25)[-1] for fifths in ((30,) * 5, (75, 75, 0, 0, 0)))
    assert crowded > 1.2 * spread


def test_more_hold_is_a_shorter_period_within_the_limits() -> None:
    long_us, short_us = (periods("heat-flux", (30,) * 5, 12.0, hold_share=hold)[-1] for hold in (0.02, 0.9))
    assert long_us >= 150.0
    assert short_us == pytest.approx(25.0)


@pytest.mark.parametrize("name", ["fixed-period", "heat-flux"])
def test_a_fresh_wire_comes_to_its_period_slowly(name: str) -> None:
    controller = controllers.make(name)
    controller.reset(400.0)
    first = [controller.update(seen((k + 1) * WINDOW_S)).t_period_us for k in range(100)]
    assert isinstance(controller, SeesBreaks)
    assert controller.wire_lost().feed_um_s == controller.start_feed_um_s
    threaded = controller.update(seen(22.0 + WINDOW_S)).t_period_us
    assert first[0] is not None
    assert first[-1] is not None
    assert threaded is not None
    assert first[0] > 1.5 * first[-1]
    assert threaded > 1.5 * first[-1]


def test_what_broke_a_wire_is_held_no_more() -> None:
    sparks = (30,) * 5
    once, again = (controllers.make("heat-flux", hold_share=0.3, break_hold_share=kept) for kept in (1.0, 0.5))
    found = []
    for controller in (once, again):
        tell(controller, machine(), PATH, 0.0)
        controller.reset(400.0)
        assert isinstance(controller, SeesBreaks)
        controller.wire_lost()
        found.append([controller.update(seen((k + 1) * WINDOW_S, sparks)).t_period_us for k in range(300)][-1])
    assert found[1] > 1.2 * found[0]


@pytest.mark.parametrize("name", ["heat-flux", "climbing-hold", "adaptive-hold"])
def test_sparks_that_clear_a_short_find_no_shorter_period_than_those_before_it(name: str) -> None:
    """A short heats no wire, so that a hold would shorten the period; wires broke as such shorts cleared."""
    controller = controllers.make(name, shortest_us=18.0, recovery_s=0.5)
    tell(controller, machine(), PATH, 0.0)
    controller.reset(400.0)
    period_us = 90.0

    def cut(windows: int, short: int, fifths: tuple[int, ...]) -> list[float]:
        found = []
        for _ in range(windows):
            nonlocal period_us
            window = seen(0.0, fifths)._replace(duration_s=255e-6 * period_us, short=short)
            period_us = controller.update(window).t_period_us or 0.0
            found.append(period_us)
        return found

    before_us = cut(300, 20, (45,) * 5)[-1]
    assert before_us > 25.0
    shorted_us = cut(50, 255, (0,) * 5)
    assert min(shorted_us) >= 0.99 * before_us
    assert shorted_us[-1] > 1.2 * before_us
    after_us = cut(300, 20, (45,) * 5)
    assert after_us[0] > 0.85 * before_us
    assert after_us[-1] == pytest.approx(before_us, rel=0.1)


def test_sato_begins_every_wire_above_the_operators_period() -> None:
    controller = controllers.make("sato")
    controller.reset(400.0)
    operator_us = WINDOW_S / 255 * 1e6
    first = controller.update(seen(WINDOW_S)).t_period_us
    assert first == pytest.approx(2.5 * operator_us, rel=1e-3)
    for k in range(1, 200):
        held = controller.update(seen((k + 1) * WINDOW_S)).t_period_us
    assert held != pytest.approx(first, rel=0.05)
    assert isinstance(controller, SeesBreaks)
    controller.wire_lost()
    assert controller.update(seen(30.0)).t_period_us == pytest.approx(first)
