"""Rows: what passes and what does not, and how a table of them is shown."""

import json
import math
import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import edmsim
from edmsim import validation
from edmsim.runs import RunTable
from edmsim.validation import closed_forms
from edmsim.validation.report import as_json, simulated, summary
from edmsim.validation.rows import Row, differences, mean_and_interval, ratios, worst
from edmsim.validation.setups import altered


def value(simulated, uncertainty=0.0, note=""):
    return Row.value(
        "wire", "n", "s", published=-10.0, simulated=simulated, within=0.1, uncertainty=uncertainty, unit="um",
        note=note,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("central", "half", "passed"),
    [(-10.0, 0.0, True), (-10.9, 1.0, True), (-11.1, 0.0, False), (-10.0, 1.1, False), (math.nan, 0.0, False),
     (-10.0, math.nan, False), (10.0, 0.0, False)],
)  # fmt: skip
def test_a_value_lies_within_its_tolerance_and_is_known_to_it(central, half, passed):
    row = value(central, half)
    assert row.passed is passed
    assert (row.published, row.tolerance) == ("-10 um", "within 10 %, and known to it")


@pytest.mark.parametrize(
    ("bounds", "central", "passed", "published"),
    [({"low": 8, "high": 10}, 8.0, True, "8..10 um"), ({"low": 8, "high": 10}, 10.01, False, "8..10 um"),
     ({"low": 8}, 1e9, True, "at least 8 um"), ({"high": 10}, 10.5, False, "at most 10 um"),
     ({"high": 10}, math.nan, False, "at most 10 um")],
)  # fmt: skip
def test_a_band_holds_the_central_value(bounds, central, passed, published):
    row = Row.band("t", "n", "s", simulated=central, unit="um", uncertainty=99.0, **bounds)
    assert (row.passed, row.published) == (passed, published)


@pytest.mark.parametrize(
    ("rises", "change", "half", "passed"),
    [(True, 2.0, 1.9, True), (True, 2.0, 2.0, False), (False, -2.0, 1.9, True), (False, -2.0, 2.1, False),
     (False, 2.0, 0.1, False), (True, 0.0, 0.0, False), (True, 1.0, math.inf, False), (True, math.nan, 0.0, False)],
)  # fmt: skip
def test_a_sign_needs_its_whole_interval_on_one_side(rises, change, half, passed):
    assert Row.sign("t", "n", "s", rises=rises, simulated=change, uncertainty=half).passed is passed


def test_a_sign_says_what_was_published():
    document = {"simulated": 1.0, "uncertainty": 0.1}
    assert Row.sign("t", "n", "s", rises=True, **document).published == "rises"
    assert Row.sign("t", "n", "s", rises=False, **document).published == "falls"
    assert Row.sign("t", "n", "s", rises=True, published="positive", **document).published == "positive"


def test_a_row_of_seeds_shows_their_mean_and_interval():
    seeds = differences([1.0, 2.0, 3.0], [2.0, 4.5, 5.0])
    mean, half = mean_and_interval([1.0, 2.5, 2.0])
    for row in (
        Row.sign("t", "n", "s", rises=True, simulated=seeds), Row.band("t", "n", "s", low=0.0, simulated=seeds),
        Row.value("t", "n", "s", published=2.0, within=0.1, simulated=np.array(seeds)),
        Row.report("t", "n", "nothing in print", simulated=seeds),
    ):  # fmt: skip
        assert (row.simulated, row.uncertainty) == (mean, half)
    assert ratios([1.0, 2.0], [3.0, 5.0]) == [3.0, 2.5]
    with pytest.raises(ValueError, match="longer"):
        differences([1.0], [1.0, 2.0])


def test_a_failure_is_unexpected_unless_a_page_explains_it():
    assert value(0.0).unexpected
    assert not value(0.0, note="docs/theory/wire.md#x").unexpected
    assert not value(-10.0).unexpected


def test_only_judged_rows_count():
    rows = [value(-10.0), value(0.0).calibration("fitted to it"), value(0.0).context("another pulse"),
            Row.report("t", "r", "nothing in print", simulated=3.0)]
    assert not any(row.unexpected for row in rows)
    assert summary(rows) == (
        "1 rows: 1 agree, 0 fail, 0 of them without an explanation; 1 of calibration (failing: 1) and 2 of context "
        "do not count"
    )
    document = json.loads(as_json(rows))
    assert (document["agree"], document["fail"]) == (1, 0)
    assert [row["kind"] for row in document["rows"]] == ["judged", "calibration", "context", "context"]
    assert document["rows"][2]["reason"] == "another pulse"


@pytest.mark.slow
@given(st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=9), st.floats(-100.0, 100.0))
def test_the_interval_moves_with_the_values_and_not_with_their_order(values, shift):
    mean, half = mean_and_interval(values)
    again, same = mean_and_interval([v + shift for v in reversed(values)])
    assert again == pytest.approx(mean + shift, abs=1e-6)
    assert same == pytest.approx(half, abs=1e-4)


@pytest.mark.slow
def test_the_interval_holds_the_mean_19_times_in_20():
    draw = np.random.default_rng(1)
    found = [mean_and_interval(draw.normal(5.0, 2.0, 4)) for _ in range(4_000)]
    held = np.mean([abs(mean - 5.0) <= half for mean, half in found])
    assert 0.94 < held < 0.96


def test_one_value_has_no_interval():
    assert mean_and_interval([3.0]) == (3.0, math.inf)


def test_the_worst_is_so_in_proportion():
    assert worst([(100.0, 103.0, "a"), (1.0, 0.95, "b")]) == (1.0, 0.95, "b")


def test_json_has_no_numbers_json_does_not_know():
    rows = [value(math.nan, math.inf), value(-10.0), value(0.0, note="docs/x")]
    document = json.loads(as_json(rows))
    assert (document["agree"], document["fail"], document["unexpected"]) == (1, 2, 1)
    assert document["rows"][0]["simulated"] is None
    assert document["rows"][0]["uncertainty"] is None
    assert document["rows"][1]["passed"] is True
    assert summary(rows) == "3 rows: 1 agree, 2 fail, 1 of them without an explanation"


@pytest.mark.parametrize(
    ("central", "half", "text"),
    [(38.127, 1.66, "38.1 ± 1.7 um"), (0.21302, 0.00326, "0.2130 ± 0.0033 um"), (12084.0, 122.0, "12084 ± 122 um"),
     (3.13607, 0.0, "3.136 um"), (2.0, math.inf, "2 ± inf um")],
)  # fmt: skip
def test_values_are_reported_to_two_digits_of_their_uncertainty(central, half, text):
    assert simulated(value(central, half)) == text


def test_constants_are_replaced_where_they_stand_and_nowhere_else():
    machine = edmsim.Machine.load()
    other = altered(machine, {"base.gap.critical_um": 3.0, "wire.strength_MPa": 1.0})
    assert (other.base.gap.critical_um.value, other.wire.strength_MPa.value) == (3.0, 1.0)
    assert other.base.gap.contact_um == machine.base.gap.contact_um
    assert machine.base.gap.critical_um.value == 9.0


@pytest.mark.parametrize("place", ["base.gap.critical", "gap.critical_um", "base.gap", "height_mm", "base.title.x"])
def test_a_place_that_is_none_is_reported(place):
    with pytest.raises(edmsim.InputError, match=f"no constant '{place}'"):
        altered(edmsim.Machine.load(), {place: 1.0})


# --- running checks ---


def test_rows_come_in_order_whatever_finishes_first(monkeypatch):
    slow_may_end = threading.Event()

    def slow(seeds):
        assert slow_may_end.wait(10)
        return [value(-10.0), value(-9.5)]

    def fast(seeds):
        slow_may_end.set()
        return [Row.band("lag", "n", "s", simulated=float(seeds[0]), low=0)]

    monkeypatch.setattr(validation, "checks", lambda *_: [slow, fast, slow])
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    observed = []
    rows = validation.run(lambda done, total: observed.append((done, total)))
    assert [row.topic for row in rows] == ["wire"] * 4 + ["lag"]
    assert [row.simulated for row in rows[:4]] == [-10.0, -9.5] * 2
    assert observed == [(0, 3), (1, 3), (2, 3), (3, 3)]


def test_an_error_in_a_check_is_not_hidden(monkeypatch):
    def broken(seeds):
        raise edmsim.EdmsimError("no")

    monkeypatch.setattr(validation, "checks", lambda *_: [broken])
    with pytest.raises(edmsim.EdmsimError, match="no"):
        validation.run()


@pytest.mark.slow
def test_some_modules_can_be_run_alone():
    rows = validation.run(modules=["closed_forms"], topics=["corner"])
    assert len(rows) == 8
    assert rows == closed_forms.check_corners(validation.SEEDS)
    with pytest.raises(edmsim.InputError, match="unknown module of checks 'nonsense'; there are: discharges, closed"):
        validation.run(modules=["nonsense"])


def test_checks_of_some_topics_are_run_and_only_their_rows_shown():
    names = [check.__name__ for check in validation.checks(topics=["kerf", "vibration"])]
    assert names == ["removal", "diameters", "overcut", "gap_over_energy", "side_gap_over_energy", "rough_lag",
                     "vibration"]  # fmt: skip
    with pytest.raises(edmsim.InputError, match="unknown topic 'nonsense'; there are: ignition, crater"):
        validation.run(topics=["wire", "nonsense"])


def test_rows_of_other_topics_of_a_check_are_left_out(monkeypatch):
    monkeypatch.setattr(validation, "checks", lambda *_: [
        lambda seeds: [value(-10.0), Row.report("lag", "r", "nothing in print", simulated=3.0)]
    ])  # fmt: skip
    assert [row.topic for row in validation.run(topics=["lag"])] == ["lag"]


def test_an_interrupted_validation_makes_only_the_missing_checks(monkeypatch, tmp_path):
    made = []

    def first(seeds):
        made.append("first")
        return [value(-10.0, math.inf)]

    def second(seeds):
        made.append("second")
        if made.count("second") == 1:
            raise edmsim.EdmsimError("killed")
        return [value(-9.5)]

    monkeypatch.setattr(validation, "checks", lambda *_: [first, second])
    monkeypatch.setattr("edmsim.runs.processors", lambda: 1)
    file = tmp_path / "checks.jsonl"
    with pytest.raises(edmsim.EdmsimError, match="killed"):
        validation.run(table=RunTable(file))
    rows = validation.run(table=RunTable(file))
    assert made == ["first", "second", "second"]
    assert rows == validation.run(table=RunTable(file)) == [value(-10.0, math.inf), value(-9.5)]
    monkeypatch.setattr(validation, "SEEDS", (1, 2))
    validation.run(table=RunTable(file))
    assert made.count("first") == 2


def test_checks_are_made_again_after_a_change_of_a_constant(monkeypatch):
    before = validation._ids([value])
    content = validation.digest
    monkeypatch.setattr(
        validation, "digest", lambda file: "other" if file.endswith("tool-steel.toml") else content(file)
    )
    assert validation._ids([value]) != before
