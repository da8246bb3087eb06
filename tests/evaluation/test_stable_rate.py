"""The search for the highest stable cutting rate: what it holds, what ends it, and what it refuses."""

import math
from itertools import pairwise
from typing import Any

import pytest

import edmsim
from edmsim.evaluation.stable_rate import SHORTENING, quick_counts, shortest_period_us
from edmsim.machine.setting import mean_current_A
from edmsim.validation.setups import altered

QUICK: dict[str, Any] = {"seeds": (1,), "hold_s": 0.3, "approach_s": 1.0}


@pytest.fixture(scope="module")
def machine():
    return edmsim.Machine.load(height_mm=10.0, t_on_us=10.0)


@pytest.fixture(scope="module")
def steps():
    return []


@pytest.fixture(scope="module")
def found(machine, steps):
    return edmsim.highest_stable_rate(
        machine, **{**QUICK, "seeds": (1, 2)}, watch=lambda seed, held: steps.append((seed, held))
    )


def test_the_laboratory_s_generator_gives_out_before_its_wire(found):
    assert found.limited_by == "generator"
    assert found.rate_mm2_min > 0
    assert found.rate_mm2_min == pytest.approx(found.feed_um_s * 60e-3 * 10.0)
    assert found.power_W == pytest.approx(22.0 * found.current_A)
    assert 0 < found.current_A <= 2.0


def test_the_setting_returned_is_the_one_that_was_held(machine, found, steps):
    assert found.machine == machine.with_(t_period_us=found.machine.t_period_us)
    held = [step for _, step in steps if step.t_period_us == found.machine.t_period_us]
    assert len(held) == 2
    assert found.rate_mm2_min == pytest.approx(sum(step.rate_mm2_min for step in held) / 2)


def test_periods_shrink_from_ten_times_the_generator_s_shortest_down_to_it(machine, found, steps):
    periods = [step.t_period_us for seed, step in steps if seed == 1]
    assert periods[0] == pytest.approx(10 * shortest_period_us(machine))
    assert periods[-1] == shortest_period_us(machine)
    assert mean_current_A(machine.with_(t_period_us=periods[-1])) == pytest.approx(2.0)
    ratios = [b / a for a, b in pairwise(periods)]
    assert ratios[:-1] == pytest.approx([SHORTENING] * (len(ratios) - 1))
    assert found.windows == sum(step.windows for _, step in steps)
    assert {seed for seed, _ in steps} == {1, 2}


def test_no_mean_rate_of_a_step_is_higher(found, steps):
    one, other = ([step for seed, step in steps if seed == n] for n in (1, 2))
    means = [(a.rate_mm2_min + b.rate_mm2_min) / 2 for a, b in zip(one, other, strict=True)]
    assert found.rate_mm2_min == pytest.approx(max(means))


def weak(machine, newton):
    """Return the machine with a wire that holds little more than its tension, and is heated strongly."""
    area_mm2 = math.pi / 4 * (machine.wire_diameter_um * 1e-3) ** 2
    return altered(machine, {"wire.strength_MPa": newton / area_mm2, "base.cooling.wire_heat_share": 1.0})


def test_a_weaker_wire_breaks_and_holds_a_lower_rate(machine, found):
    broken = edmsim.highest_stable_rate(weak(machine, 1.3 * machine.tension), **QUICK)
    assert broken.limited_by == "break"
    assert 0 < broken.rate_mm2_min < 0.9 * found.rate_mm2_min
    assert broken.machine.t_period_us > found.machine.t_period_us


def test_a_wire_that_breaks_at_once_holds_nothing(machine):
    broken = edmsim.highest_stable_rate(weak(machine, 1.005 * machine.tension), **QUICK)
    assert broken[:4] == (0.0, 0.0, 0.0, 0.0)
    assert (broken.limited_by, broken.windows) == ("break", 0)


def test_a_gap_that_always_shorts_is_a_jam(machine):
    jammed = edmsim.highest_stable_rate(altered(machine, {"base.gap.contact_um": 60.0}), **QUICK)
    assert (jammed.limited_by, jammed.rate_mm2_min) == ("jam", 0.0)


def test_the_same_search_finds_the_same(machine):
    quick = {**QUICK, "longest_period_us": 1.1 * shortest_period_us(machine)}
    assert edmsim.highest_stable_rate(machine, **quick) == edmsim.highest_stable_rate(machine, **quick)


def test_a_feed_controller_may_be_named(machine):
    quick = {**QUICK, "longest_period_us": 1.02 * shortest_period_us(machine)}
    slow = edmsim.highest_stable_rate(machine, **quick, controller="fixed:feed_um_s=5")
    assert slow.feed_um_s == pytest.approx(5.0, rel=0.1)
    wide = edmsim.highest_stable_rate(machine, **quick, controller=quick_counts(0.5))
    usual = edmsim.highest_stable_rate(machine, **quick)
    assert slow.feed_um_s < wide.feed_um_s < usual.feed_um_s


@pytest.mark.parametrize(("options", "said"), [
    ({"seeds": ()}, "wants one seed or more"),
    ({"hold_s": 0.0}, "hold_s 0 must be finite and above zero"),
    ({"hold_s": math.nan}, "hold_s nan must be finite"),
    ({"approach_s": math.inf}, "approach_s inf must be finite"),
    ({"longest_period_us": 12.0}, "above the generator's 2 A"),
    ({"longest_period_us": 20_000.0}, "t_period 20000 us is not within"),
    ({"controller": "oracle"}, "looks at the true gap, which no machine shows"),
    ({"controller": "genius"}, "genius"), ({"resolution": "superb"}, "superb"),
])  # fmt: skip
def test_what_cannot_be_searched_is_refused_in_one_line(machine, options, said):
    with pytest.raises(edmsim.InputError, match=said) as refused:
        edmsim.highest_stable_rate(machine, **{**QUICK, **options})
    assert "\n" not in str(refused.value)
