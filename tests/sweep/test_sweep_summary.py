"""What a sweep says: effects of known size are found, fronts are fronts, and the command shows them."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from rich.console import Console

from edmsim import runs
from edmsim.errors import InputError
from edmsim.sweep.run import as_table, read
from edmsim.sweep.summary import KEYS, TIME, front_of, groups, pareto_front, render, sensitivities, sensitivity


def row(name, **found):
    """Return a run's row, with what was measured in it."""
    known = {"task": "a.ngc", "seed": 0, "machine_sample": None, "error": None, "outcome": "finished"}
    return {"id": str(name), **known, **dict.fromkeys(KEYS), **found}


@pytest.fixture
def table():
    """A table whose rate is twice the height and one for the controller, and in which one run failed."""
    noise = np.random.default_rng(0).normal(0.0, 0.01, (2, 3, 20))
    rows = [
        row(f"{k}-{height}-{seed}", seed=seed, height_mm=height, controller=controller, ra_um=1.0 + k,
            cutting_rate_mm2_min=2.0 * height + k + noise[k, height, seed], short_share=0.1,
            **{TIME: 10.0 * height + 1})
        for k, controller in enumerate(["counts", "voltage"]) for height in range(3) for seed in range(20)
    ]  # fmt: skip
    rows[4] |= {"outcome": "wire-break", TIME: 0.1}  # a time of no cut
    rows[5] |= {"error": "it went wrong", "outcome": None, TIME: None, "cutting_rate_mm2_min": None, "ra_um": None}
    return as_table(rows)


def test_settings_to_group_by_may_be_any_names_but_one_text(table):
    assert len(groups(table, (name for name in ["height_mm"]))) == 3
    with pytest.raises(InputError, match=r"by is the text 'height_mm': give a list, as \['height_mm'\]"):
        groups(table, "height_mm")


def test_means_count_failures_and_leave_them_out(table):
    found = groups(table)
    assert [list(group.settings.values()) for group in found[:2]] == [[0.0, "counts"], [0.0, "voltage"]]
    assert (found[0].runs, found[0].failed, found[0].finished) == (20, 1, 18)
    assert found[0].figures[TIME].value == 1.0
    rate = found[5].figures["cutting_rate_mm2_min"]
    assert rate.low < rate.value < rate.high
    assert rate.value == pytest.approx(5.0, abs=0.01)


def test_sensitivities_are_shares_of_the_variance(table):
    found = sensitivities(table)["cutting_rate_mm2_min"]
    # the variances of 2 * {0, 1, 2} and of {0, 1} are 8/3 and 1/4
    assert found.effects["height_mm"].first_order == pytest.approx(8 / 3 / (8 / 3 + 0.25), abs=0.01)
    assert found.effects["controller"].total == pytest.approx(0.25 / (8 / 3 + 0.25), abs=0.01)
    assert found.effects["height_mm"].rank_correlation > 0.9
    assert np.isnan(found.effects["controller"].rank_correlation)
    assert 0 < found.unexplained < 0.001
    assert np.isnan(sensitivities(table)["short_share"].effects["height_mm"].first_order)  # it never changes


def test_runs_at_the_greatest_feed_are_counted(table, capsys):
    for shares, said in (([None, 1.0, 0.4, 0.6], "2 of 4 runs cut mostly at the greatest feed"), ([0.0] * 4, "")):
        Console(width=200).print(render(table.slice(6, 4).append_column("share_at_limit", [shares])))
        out = capsys.readouterr().out
        assert said in out
        assert bool(said) == ("greatest feed" in out)


def test_offsets_are_numbers_although_auto_is_a_text():
    offsets_mm = 0.05 * 1.1 ** np.arange(16)
    rows = [
        row(k, offset=float(mm), tension=5 * k % 16, error_rms_um=100.0 * mm) for k, mm in enumerate(offsets_mm)
    ]
    effects = sensitivities(as_table(rows))["error_rms_um"].effects
    assert effects["offset"].rank_correlation == pytest.approx(1.0)
    assert effects["offset"].first_order > 0.95
    assert effects["tension"].first_order < 0.05
    assert [group.settings["offset"] for group in groups(as_table(rows), ["offset"])] == offsets_mm.tolist()


@pytest.mark.parametrize(("machines", "shown"), [(3, ["height_mm", "machine_sample"]), (40, ["gap.a", "height_mm"])])
def test_of_few_drawn_machines_nobody_can_tell_which_constant_it_was(machines, shown):
    drawn = np.random.default_rng(2).random(machines)
    extra = ["gap.a"] if machines > 10 else ["gap.a", "gap.b", "wire.c"]
    rows = [
        row(f"{m}-{height}", machine_sample=m, height_mm=height, cutting_rate_mm2_min=height + 6.0 * drawn[m],
            **{name: drawn[m] + 0.01 * k for k, name in enumerate(extra)})
        for m in range(machines) for height in (1.0, 2.0)
    ]  # fmt: skip
    found = sensitivities(as_table(rows))["cutting_rate_mm2_min"]
    assert sorted(found.effects) == shown
    assert sum(effect.first_order for effect in found.effects.values()) == pytest.approx(1.0, abs=0.01)
    by_machine = (6.0 * drawn).var() / ((6.0 * drawn).var() + 0.25)
    machine = found.effects[min(shown, key=lambda name: name == "height_mm")]
    assert machine.total == pytest.approx(by_machine, abs=0.02)


def test_a_constant_that_was_chosen_is_grouped_by_although_machines_are_drawn():
    table = as_table([
        row(f"{m}-{chosen}", machine_sample=m, ra_um=chosen + m, **{"gap.chosen": chosen, "gap.drawn": 0.1 * m})
        for m in range(3) for chosen in (1.0, 2.0)
    ])  # fmt: skip
    assert [group.settings for group in groups(table)] == [{"gap.chosen": 1.0}, {"gap.chosen": 2.0}]
    assert sorted(sensitivities(table)["ra_um"].effects) == ["gap.chosen", "gap.drawn"]


def test_a_constant_that_the_first_runs_left_at_its_default_is_a_setting():
    table = as_table([row(0, ra_um=1.0), row(1, ra_um=1.0, **{"gap.chosen": 5.0})])
    assert [group.settings for group in groups(table)] == [{"gap.chosen": None}, {"gap.chosen": 5.0}]


def test_the_interval_of_a_mean_is_that_over_drawn_machines():
    rows = [
        row(f"{m}-{seed}", seed=seed, machine_sample=m, ra_um=float(m)) for m in range(4) for seed in range(20)
    ]
    (group,), one = groups(as_table(rows)), groups(as_table(rows[::20]))[0]
    assert group.figures["ra_um"] == one.figures["ra_um"]
    assert (group.runs, one.runs) == (80, 4)


def test_intervals_of_two_and_of_three_runs_hold_the_mean_as_often_as_they_say():
    rng = np.random.default_rng(0)
    for seeds in (2, 3):
        rows = [row(f"{k}-{n}", height_mm=k, ra_um=rng.normal(5.0)) for k in range(400) for n in range(seeds)]
        found = [group.figures["ra_um"] for group in groups(as_table(rows), ["height_mm"])]
        assert 0.92 < np.mean([figure.low <= 5.0 <= figure.high for figure in found]) < 0.98


def test_runs_of_a_changed_file_are_groups_of_their_own_unless_a_setting_names_it(table):
    texts = [{"counts": "a", "voltage": "b"}[name] for name in table["controller"].to_pylist()]
    assert groups(table.append_column("files", [texts])) == groups(table)
    changed = [text if seed < 10 else "c" for text, seed in zip(texts, table["seed"].to_pylist(), strict=True)]
    found = groups(table.append_column("files", [changed]))
    assert [(group.settings["files"], group.runs) for group in found[:4]] == [(text, 10) for text in "acbc"]


def test_the_front_is_what_nothing_surpasses(table):
    points = np.array([[1.0, 5.0], [2.0, 4.0], [1.5, 4.0], [2.0, 4.0], [0.0, 6.0]])
    assert pareto_front(points).tolist() == [True, True, False, True, True]
    found, front = front_of(table)
    best = {(g.settings["height_mm"], g.settings["controller"]) for g, on in zip(found, front, strict=True) if on}
    assert best == {(2.0, "counts"), (2.0, "voltage")}


def test_what_differs_by_rounding_errors_is_equal():
    rate = np.array([9.997302853248458, 9.997302853248454, 9.997302853248454, 9.997302853248458])
    ra = np.array([1.93, 1.90, 1.90, 1.95])
    assert pareto_front(np.column_stack([rate, -ra])).tolist() == [False, True, True, False]
    effect = sensitivity({"t_on_us": [10.0, 20.0, 20.0, 10.0]}, rate).effects["t_on_us"]
    assert np.isnan([effect.first_order, effect.rank_correlation]).all()


@pytest.mark.slow
def test_the_command_sweeps_shows_and_goes_on(line, giving_up, tmp_path, monkeypatch, edmsim):
    monkeypatch.chdir(tmp_path)
    counts = []
    in_threads = type("InThreads", (runs.Threads,), {"__init__": lambda self, count: counts.append(count)})
    monkeypatch.setattr(runs, "Processes", in_threads)
    words = ("sweep", "run", line, "--height", "5,8", "--controller", f"counts,{giving_up}", "--max-time=1",
             "--resolution", "fast", "--offset", "none", "--out", "o", "--processes", 1)  # fmt: skip
    shown = edmsim(*words)
    assert shown.status == 3  # some failed
    assert "4 runs, 4 made now, 2 failed." in shown.out
    assert "runs 100.0 % 4 of 4, 2 failed" in shown.err
    again = edmsim(*words)
    assert again.status == 3
    assert "4 runs, 0 made now, 2 failed." in again.out
    assert counts == [1, 1]
    status, table, _ = edmsim("sweep", "show", "o")
    assert status == 0
    for words in ("4 runs, 2 failed", "Own.update fails: RuntimeError: out of ideas", "height_mm"):
        assert words in table
    with Image.open("o/pareto.png") as picture:
        assert picture.size[0] == 700
    assert len(read("o")) == 4


@pytest.mark.parametrize(("words", "named"), [
    (("line.ngc",), "--out"), (("line.ngc", "--out", "o", "5"), "--height 5,10,20"),
    (("line.ngc", "--out", "o", "--height"), "--height has no values"),
    (("none.toml", "--out", "o"), "none.toml: no such file"), (("show", "o"), "no result"),
    (("show", "line.ngc"), "line.ngc: there is no result"),
    (("none.toml", "--out", "o", "--seeds", "3", "--record", "all"), "leave out --seeds --record"),
    (("line.ngc", "--out", "o", "--colour", "1"), "colour"),
    (("line.ngc", "--out", "o", "--processes", "0"), "--processes is 0: give a whole number, 1 or more"),
    (("line.ngc", "--out", "o", "--processes", "1", "--ray", "auto"), "leave them out"),
    (("edmsim/Pond-v0", "--out", "o"), "edmsim/Pond-v0"),
    (("none.py:Pond-v0", "--out", "o"), "none.py: no such file"),
    (("line.ngc", "--out", "o", "--height", "5,abc"), "with height_mm abc"),
])  # fmt: skip
def test_bad_usage_is_one_line(line, words, named, monkeypatch, edmsim):
    monkeypatch.chdir(line.parent)
    shown = edmsim("sweep", *(() if words[0] == "show" else ("run",)), *words)
    assert (shown.status, shown.out) == (2, "")
    assert shown.err.count("\n") == 1
    assert named in shown.err
    assert not Path("o").exists()
