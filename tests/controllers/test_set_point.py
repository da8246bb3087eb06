"""Servos with settings of their own at corners; laws that set the period by the wire's heat, or find its limit."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from edmsim import controllers
from edmsim.controllers import WindowObservation, make
from edmsim.controllers.feed.law import lead_um
from edmsim.controllers.feed.periods import MOST_HOLD, heat_per_ignition_s
from edmsim.controllers.protocols import SeesBreaks, set_up_controller
from edmsim.errors import InputError
from edmsim.machine.machine import Machine

from .test_guarded_hold import EVEN, Cut, law_on_production_machine, production_machine

LEFT = np.array([(0.0, 0.0), (300.0, 0.0), (300.0, 300.0)])
START_UM = 50.0


@pytest.fixture(scope="module")
def machine():
    return Machine.load(height_mm=40.0, tension=8.0)


def at_work(machine, name, points_um=LEFT, **parameters):
    """A controller that knows the set-up and its leg, and the first command that it gave."""
    controller = make(name, **parameters)
    set_up_controller(controller, machine, points_um, START_UM)
    return controller, controller.reset(33.0)


def window(path_um):
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
    controller, first = at_work(machine, "set-point", LEFT * (1, side), pull_N_m=0.1, offset_um=-3.0)
    assert first.offset_um == -3.0
    ahead = lead_um(machine, 0.1)
    offsets = [controller.update(window(START_UM + path_um)).offset_um for path_um in (299.0, 300.0, 400.0, 600.0)]
    expected = [0.0, *(side * ahead * math.exp(-behind / 100.0) for behind in (0.0, 100.0, 300.0))]
    assert offsets == pytest.approx([-3.0 + lateral_um for lateral_um in expected])
    sudden, _ = at_work(machine, "set-point", LEFT * (1, side), pull_N_m=0.1, offset_um=-3.0, fade_um=0.0)
    assert [sudden.update(window(START_UM + path_um)).offset_um for path_um in (300.0, 400.0)] == [-3.0, -3.0]


@pytest.mark.parametrize(("side", "outer"), [("left", True), ("right", False), (None, False)])
def test_a_trim_lengthens_its_period_before_outer_corners_only(machine, side, outer):
    trim = make("trim", feed_um_s=20.0, before_um=60.0, corner_factor=3.0)
    set_up_controller(trim, machine, LEFT, START_UM, side)  # it turns left, to a part on the left
    assert trim.reset(33.0).t_period_us is None
    commands = [trim.update(window(START_UM + path_um)) for path_um in (230.0, 241.0, 300.0, 301.0, 320.0)]
    slow = 3.0 * machine.t_period_us
    expected = [None, slow, slow, machine.t_period_us, None] if outer else [None] * 5
    assert [command.t_period_us for command in commands] == expected


@pytest.mark.parametrize(("generator", "on_us"), [("iso-pulse", 30.0), ("production", 1.4), ("fine", 0.2)])
def test_pulses_shorter_than_a_microsecond_keep_their_on_time(generator, on_us):
    _, first = at_work(Machine.load("production", generator=generator), "set-point", on_factor=0.5)
    assert first.t_on_us == pytest.approx(0.5 * on_us)


def test_pauses_are_longer_near_corners_only(machine):
    near = {"before_um": 60.0, "behind_um": 60.0, "corner_factor": 4.0}
    controller, _ = at_work(machine, "set-point", **near, period_factor=0.7, on_factor=0.5)
    places = (0.0, 239.0, 241.0, 300.0, 359.0, 361.0)
    found = [controller.update(window(START_UM + path_um)) for path_um in places]
    far, first = found[0].t_period_us, machine.t_period_us
    assert [command.t_period_us for command in found] == [far, far, *[round(2.8 * first)] * 3, far]
    assert far < first
    assert {command.t_on_us for command in found} == {15}


@pytest.mark.parametrize("name", ["offset_um", "pull_N_m"])
def test_lateral_numbers_have_either_sign(name):
    assert getattr(make("set-point", **{name: -0.5}), name) == -0.5
    with pytest.raises(InputError, match=f"{name} of the set-point controller must be a number, not nan"):
        make("set-point", **{name: math.nan})


def test_a_fixed_feed_has_an_offset():
    controller = make("fixed", feed_um_s=12.0, offset_um=-4.0)
    assert controller.reset(33.0) == controller.update(window(0.0))
    assert controller.reset(33.0).offset_um == -4.0


def test_the_oracle_of_leads_brings_the_bent_wire_on_the_path(machine):
    """Across the path, to the other side, on either leg; what the wire is bent along the path stays."""
    controller, first = at_work(machine, "lead-oracle", average_s=0.5, offset_um=1.0)
    assert first.offset_um == 1.0
    controller.see(SimpleNamespace(deflection_um=(6.0, -4.0)))
    along, across = (controller.update(window(START_UM + path_um)).offset_um for path_um in (299.0, 300.0))
    # left of +x is +y, left of +y is -x; a leg or wire may begin at any time, here 1 s
    assert along == pytest.approx(1.0 + 4.0 * (1.0 - math.exp(-0.0255 / 0.5)))
    assert across == pytest.approx(1.0 + 6.0 * (1.0 - math.exp(-2 * 0.0255 / 0.5)))
    other, _ = at_work(machine, "lead-oracle", average_s=0.5, offset_um=1.0)
    other.restore(controller.snapshot())
    other.see(SimpleNamespace(deflection_um=(6.0, -4.0)))
    assert other.update(window(START_UM + 350.0)) == controller.update(window(START_UM + 350.0))


def test_pauses_at_corners_grow_with_the_root_of_what_the_wire_bends(machine):
    slack, first = lead_um(machine, 1.0), machine.t_period_us
    for slack_um, factor in ((0.0, 4.0), (slack, 4.0), (slack / 4, 8.0), (100.0 * slack, 1.0)):
        controller, _ = at_work(machine, "set-point", before_um=60.0, corner_factor=4.0, slack_um=slack_um)
        assert controller.update(window(START_UM + 260.0)).t_period_us == round(factor * first), slack_um


WINDOW_S = 0.02


def observed(time_s, fifths=(30,) * 5):
    ignited = sum(fifths)
    return WindowObservation(time_s, WINDOW_S, 20, 235 - ignited, 30.0, 5.0, 5.0, 10.0, 0.0, fifths)


def periods(name, fifths, seconds=3.0, **parameters):
    controller = law_on_production_machine(name, **parameters)
    count = round(seconds / WINDOW_S)
    answers = [controller.update(observed((k + 1) * WINDOW_S, fifths)) for k in range(count)]
    return [answer.t_period_us or 0.0 for answer in answers]


def test_heat_of_an_ignition_is_that_of_its_spark_and_of_its_current():
    """Closed form: all that a middle spark gives the wire beside the workpiece; half its current flows either way."""
    m = production_machine()
    cooling, wire = m.base.cooling, m.wire
    on_s, current_A, area_m2 = m.t_on_us * 1e-6, 350.0, math.pi / 4 * 0.3e-3**2
    spark_J = cooling.wire_heat_share.value * current_A * m.material.burning_voltage_V.value * on_s
    joule_J = 4 / 3 * current_A**2 * on_s * wire.resistivity_Ohm_m.value / area_m2 * 0.06 / 4
    patch_m2 = math.pi * 0.3e-3 * 0.06 / 5
    expected = (spark_J + joule_J) / (patch_m2 * cooling.critical_W_m2.value)
    assert heat_per_ignition_s(m)[:, 2].sum() == pytest.approx(expected, rel=1e-3)
    assert heat_per_ignition_s(production_machine(height_mm=30.0))[0, 0] > 1.4 * heat_per_ignition_s(m)[0, 0]


def test_sparks_in_one_place_ask_for_a_longer_period_than_as_many_all_over():
    spread, crowded = (periods("heat-flux", fifths, hold_share=0.25)[-1] for fifths in ((30,) * 5, (75, 75, 0, 0, 0)))
    assert crowded > 1.2 * spread


def test_more_hold_is_a_shorter_period_within_the_limits():
    long_us, short_us = (periods("heat-flux", (30,) * 5, 12.0, hold_share=hold)[-1] for hold in (0.02, 0.9))
    assert long_us >= 150.0
    assert short_us == pytest.approx(25.0)


@pytest.mark.parametrize("name", ["fixed-period", "heat-flux"])
def test_a_fresh_wire_comes_to_its_period_slowly(name):
    controller = controllers.make(name)
    controller.reset(400.0)
    first = [controller.update(observed((k + 1) * WINDOW_S)).t_period_us for k in range(100)]
    assert isinstance(controller, SeesBreaks)
    assert controller.wire_lost().feed_um_s == controller.start_feed_um_s
    threaded = controller.update(observed(22.0 + WINDOW_S)).t_period_us
    assert first[0] is not None
    assert first[-1] is not None
    assert threaded is not None
    assert first[0] > 1.5 * first[-1]
    assert threaded > 1.5 * first[-1]


@pytest.mark.parametrize("name", ["fixed-period", "heat-flux", "guarded-hold"])
def test_a_period_of_0_is_the_operators_and_not_that_of_pulses_that_wait_to_ignite(name):
    """The windows are 20 ms long: 78 us a pulse, of which the operator set 72."""
    controller = law_on_production_machine(name, period_us=0.0, slow_factor=1.0)
    named = law_on_production_machine(name, period_us=production_machine().t_period_us, slow_factor=1.0)
    for k in range(3):
        measured = observed((k + 1) * WINDOW_S)
        assert controller.update(measured) == named.update(measured)


@pytest.mark.parametrize(("name", "parameters"), [
    ("climbing-hold", {"climb_per_s": 1e9}), ("guarded-hold", {"ramp_s": 1e9, "ramp_per_s": 1e9}),
])
def test_what_is_held_grows_to_an_end(name, parameters):
    controller = law_on_production_machine(name, **parameters)
    for k in range(60):
        controller.update(observed((k + 1) * WINDOW_S))
    assert controller.period.hold == MOST_HOLD


def test_what_broke_a_wire_is_held_no_more():
    sparks = (30,) * 5
    found = []
    for share in (1.0, 0.5):
        controller = law_on_production_machine("heat-flux", hold_share=0.3, break_hold_share=share)
        controller.wire_lost()
        found.append([controller.update(observed((k + 1) * WINDOW_S, sparks)).t_period_us for k in range(300)][-1])
    assert found[1] > 1.2 * found[0]


@pytest.mark.parametrize("name", ["heat-flux", "climbing-hold", "adaptive-hold"])
def test_sparks_that_clear_a_short_find_no_shorter_period_than_those_before_it(name):
    """A short heats no wire, so that a hold would shorten the period; wires broke as such shorts cleared."""
    cut = Cut(name, shortest_us=18.0, recovery_s=0.5)
    before_us = cut.periods_us(300)[-1]
    assert before_us > 25.0
    shorted_us = cut.periods_us(50, (0,) * 5, short=255)
    assert min(shorted_us) >= 0.99 * before_us
    assert shorted_us[-1] > 1.2 * before_us
    after_us = cut.periods_us(300)
    assert after_us[0] > 0.85 * before_us
    assert after_us[-1] == pytest.approx(before_us, rel=0.1)


@pytest.mark.parametrize("name", ["climbing-hold", "adaptive-hold", "guarded-hold"])
def test_a_gap_that_is_still_wide_after_a_short_does_not_shorten_the_period(name):
    """Wires broke as such a gap closed again, at the shortest period."""
    found = []
    for refill_s in (0.0, 60.0):
        cut = Cut(name, refill_s=refill_s, shortest_us=12.0)
        phases = (500, EVEN, 20), (50, (0,) * 5, 255), (150, (20,) * 5, 0), (150, EVEN, 20)
        found.append([cut.periods_us(*phase)[-1] for phase in phases])
    (usual_us, _, wide_us, _), (_, _, limited_us, closed_us) = found
    assert wide_us < 0.6 * usual_us
    assert limited_us > 0.9 * usual_us
    assert closed_us == pytest.approx(usual_us, rel=0.1)


@pytest.mark.parametrize(("name", "factor"), [("adaptive-off-time", 1.0), ("sato", 2.5)])
def test_the_operators_period_is_the_set_ups_and_not_that_of_a_first_window_with_late_ignitions(name, factor):
    controller, _ = at_work(Machine.load(t_on_us=20.0, t_period_us=80.0), name)
    assert controller.update(observed(1.2 * 255 * 80e-6)).t_period_us == factor * 80.0


def test_sato_begins_every_wire_above_the_operators_period():
    controller = controllers.make("sato")
    controller.reset(400.0)
    operator_us = WINDOW_S / 255 * 1e6
    first = controller.update(observed(WINDOW_S)).t_period_us
    assert first == pytest.approx(2.5 * operator_us, rel=1e-3)
    for k in range(1, 200):
        held = controller.update(observed((k + 1) * WINDOW_S)).t_period_us
    assert held != pytest.approx(first, rel=0.05)
    assert isinstance(controller, SeesBreaks)
    controller.wire_lost()
    assert controller.update(observed(30.0)).t_period_us == pytest.approx(first)


def test_climb_shortens_the_period_until_a_wire_breaks(machine):
    law, first = at_work(machine, "climb", period_factor=4.0, climb_s=0.1, step_share=0.2, back_factor=1.5)
    assert (first.t_on_us, first.t_period_us) == (30, 400)
    periods = [law.update(window(0.0)).t_period_us for _ in range(9)]
    assert periods == [400] * 3 + [320] * 4 + [256] * 2
    assert law.wire_lost().t_period_us == 384
    assert {law.update(window(0.0)).t_period_us for _ in range(20)} == {384}
    assert law.wire_lost().t_period_us == 576
    assert law.reset(33.0) == first


def test_no_law_asks_for_more_than_the_supply_gives(machine):
    law, first = at_work(machine, "set-point", period_factor=0.2)
    assert first.t_period_us == law.update(window(0.0)).t_period_us == 100


# what laws find out of the heat that a wire bears


def for_seconds(law, seconds):
    return [law.update(observed(1.0)) for _ in range(round(seconds / WINDOW_S))]


@pytest.fixture(scope="module")
def flux():
    """What the windows of `observed` are of the critical flux."""
    law = law_on_production_machine("heat-flux")
    for_seconds(law, 1.0)
    return float(law.gauge.flux.max())


def test_no_break_at_a_flux_says_that_more_can_be_held(flux):
    law = law_on_production_machine("adaptive-hold", limit_share=1.2 * flux, limit_spread=0.5)
    first = law.period.hold
    for_seconds(law, 60.0)
    assert law.period.hold > 1.1 * first
    assert law.period.limit(0.05) > 0.8 * law.period.hold


def test_a_break_says_where_the_limit_is_and_the_more_breaks_the_better(flux):
    """Breaks at one flux: the limit is found within its few per cent, and what is held lies below it."""
    law = law_on_production_machine("adaptive-hold")
    for _ in range(4):
        for_seconds(law, 10.0)
        law.wire_lost()
    for_seconds(law, 3.0)
    assert law.period.limit(0.95) / law.period.limit(0.05) < 1.5
    assert law.period.limit(0.5) == pytest.approx(flux, rel=0.15)
    assert law.period.hold < flux


def test_a_dear_break_makes_the_law_careful():
    cheap, dear = (
        law_on_production_machine("adaptive-hold", break_weight=weight).period.hold for weight in (0.05, 30.0)
    )
    assert dear < 0.8 * cheap


@pytest.mark.parametrize("name", ["adaptive-hold", "climbing-hold"])
def test_a_snapshot_has_what_was_learned(name):
    law, copied = law_on_production_machine(name), law_on_production_machine(name)
    for_seconds(law, 5.0)
    law.wire_lost()
    for_seconds(law, 5.0)
    copied.restore(law.snapshot())
    assert for_seconds(law, 3.0) == for_seconds(copied, 3.0)
    assert law.snapshot() == copied.snapshot()


def test_climbing_is_slower_after_every_break(flux):
    law = law_on_production_machine(
        "climbing-hold", hold_share=0.4 * flux, climb_per_s=0.05, patience_factor=2.0, break_hold_share=0.5
    )
    before = law.period.hold
    for_seconds(law, 10.0)
    assert law.period.hold == pytest.approx(before * math.exp(0.5), rel=1e-6)
    law.wire_lost()
    low = law.period.hold
    assert low == pytest.approx(before * math.exp(0.5) * 0.5, rel=1e-6)
    for_seconds(law, 10.0)
    assert law.period.hold == pytest.approx(low * math.exp(0.25), rel=1e-6)
