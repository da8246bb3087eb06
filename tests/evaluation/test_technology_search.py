"""The search of a technology: what it does with what cuts answer. The cuts themselves are replaced by a formula."""

from dataclasses import replace

import pytest

from edmsim import models
from edmsim.closed_loop.passes import PassRecord, Sums
from edmsim.controllers import from_text
from edmsim.errors import InputError
from edmsim.evaluation import technology_search
from edmsim.evaluation.technology_search import TARGETS, Cut, Job, Search, technology_text
from edmsim.files import locked_file
from edmsim.machine.technology import read_technology
from edmsim.metrology.kerf import WallError

BREAKS_BELOW_US = 40.0
GAPS_UM = {1: 36.0, 2: 22.0, 3: 20.0}


def answer(job, one, number, offset_mm, metal):
    """Answer as a plant might: the wire breaks below a period, each pass leaves its gap, trims keep their feed."""
    breaks = number == 1 and one.t_period_us < BREAKS_BELOW_US
    feed_um_s = 1500.0 / one.t_period_us if number == 1 else one.feed_mm_min / 0.06
    left_um = offset_mm * 1e3 - 127.0 - GAPS_UM[number]
    wall = None if breaks else WallError(9, left_um, 1.0, (left_um,) * 5, 0.5, 1.0, 0.5, 0.3)
    record = PassRecord(
        1, number, "profile", number % 2 == 0, offset_mm * 1e3, 0.0, 1500.0 / feed_um_s, 0.0, 1500.0, Sums(), wall
    )
    return Cut(record, metal, TARGETS[number - 1].ra_um, "wire-break" if breaks else "finished")


def answer_through(job, at):
    """Answer a cut through all passes; the walls of further seeds are 1, 2 and 3 um off."""
    cuts = []
    table = job.technology([at]).table(at.height_mm, len(at.passes))
    for number, (one, offset_mm) in enumerate(zip(table.settings, table.offsets_mm, strict=True), 1):
        cut = answer(job, one, number, offset_mm, None)
        wall = replace(cut.record.wall, mean_um=cut.record.wall.mean_um - job.seed // technology_search.NEXT_SEED)
        cuts.append(cut._replace(record=replace(cut.record, wall=wall)))
    return cuts


@pytest.fixture(autouse=True)
def no_cuts(monkeypatch):
    monkeypatch.setattr(
        technology_search, "cut_pass", lambda job, one, number, mm, _: answer(job, one, number, mm, number),
    )  # fmt: skip
    monkeypatch.setattr(technology_search, "cut_through", answer_through)


def forbidden(*_):
    raise AssertionError("a pass was cut by itself")


def test_the_rough_pass_stays_off_the_period_that_breaks_the_wire():
    messages = []
    found = Search(Job("tool-steel", passes=1), messages.append).run()
    assert found.passes[0].t_period_us >= BREAKS_BELOW_US
    assert found.passes[0].t_period_us <= 1.3 * BREAKS_BELOW_US
    assert "wire-break" in "".join(messages)


@pytest.mark.parametrize("height_mm", [0.5, 1.5])
def test_the_rough_pass_of_sheet_begins_at_a_feed_that_the_machine_has(monkeypatch, height_mm):
    tried = []
    monkeypatch.setattr(
        technology_search, "cut_pass",
        lambda job, one, number, mm, _: tried.append(one) or answer(job, one, number, mm, number),
    )  # fmt: skip
    Search(Job("tool-steel", height_mm=height_mm, passes=1), lambda text: None).run()
    from_text(tried[0].controller()).reset(400.0)


def test_offsets_let_every_pass_take_its_stock():
    rough, trim, last = Search(Job("tool-steel", passes=3), lambda text: None).run().passes
    # gaps of 36, 22 and 20 um; the four cuts through all passes leave walls 0, 1, 2 and 3 um off
    assert [one.last_offset_um for one in (rough, trim, last)] == [164.5, 150.5, 148.5]
    assert rough.step_um == pytest.approx(TARGETS[1].stock_um + 36.0 - 22.0, abs=6.0)
    assert trim.step_um == pytest.approx(TARGETS[2].stock_um + 22.0 - 20.0, abs=8.0)
    assert last.found.stock_um == pytest.approx(TARGETS[2].stock_um, abs=7.0)
    assert rough.feed == "adaptive"
    assert trim.feed == last.feed == "constant"


def test_a_trim_that_misses_its_targets_in_all_cuts_has_the_setting_of_the_last(monkeypatch):
    cuts = []

    def slow(job, one, number, offset_mm, metal):
        cuts.append(one)
        made = answer(job, one, number, offset_mm, number)
        slowed = replace(made.record, end_um=0.5 * made.record.end_um)
        return made if number == 1 else made._replace(record=slowed, ra_um=1.3 * made.ra_um)

    monkeypatch.setattr(technology_search, "cut_pass", slow)
    trim = Search(Job("tool-steel", passes=2), lambda text: None).run().passes[-1]
    assert (trim.peak_current_A, trim.t_period_us) == (cuts[-1].peak_current_A, cuts[-1].t_period_us)


def test_passes_that_are_known_keep_their_settings_and_get_their_offsets_again(monkeypatch):
    found = Search(Job("tool-steel", passes=3), lambda text: None).run()
    resolutions = []

    def noted(job, at):
        resolutions.append(job.resolution)
        return answer_through(job, at)

    monkeypatch.setattr(technology_search, "cut_pass", forbidden)
    monkeypatch.setattr(technology_search, "cut_through", noted)
    assert Search(Job("tool-steel", passes=3), lambda text: None, known=found).run() == found
    off = tuple(one.model_copy(update={"last_offset_um": one.last_offset_um + 9.0}) for one in found.passes)
    known = found.model_copy(update={"passes": off})
    again = Search(Job("tool-steel", passes=2, resolution="fine"), lambda text: None, known=known).run()
    assert again == found.model_copy(update={"resolution": "fine"})
    assert resolutions == 4 * ["default"] + 4 * ["fine"]


def test_passes_are_added_to_known_ones(monkeypatch):
    two, three = (Search(Job("tool-steel", passes=n), lambda text: None).run() for n in (2, 3))
    added = Search(Job("tool-steel", passes=3), lambda text: None, known=two).run()
    assert [one.t_period_us for one in added.passes] == [one.t_period_us for one in three.passes]
    assert added.passes[2].last_offset_um == three.passes[2].last_offset_um


def test_offsets_are_of_the_cuts_that_came_to_the_end_of_a_pass(monkeypatch):
    ends = {0: 2, 1: 2, 2: 1, 3: 1}  # the passes that a cut finishes, by its number

    def stopped(job, at):
        cuts = answer_through(job, at)
        last = ends[job.seed // technology_search.NEXT_SEED]
        records = [cut.record if k < last else replace(cut.record, wall=None) for k, cut in enumerate(cuts)]
        return [cut._replace(record=record) for cut, record in zip(cuts, records, strict=True)]

    monkeypatch.setattr(technology_search, "cut_through", stopped)
    found = Search(Job("tool-steel", passes=2), lambda text: None).run()
    assert [one.last_offset_um for one in found.passes] == [164.5, 149.5]
    with pytest.raises(InputError, match="pass 3 did not come to its end in any cut through all passes: ask for 2"):
        Search(Job("tool-steel", passes=3), lambda text: None).run()


def test_an_interrupted_measurement_of_offsets_goes_on_behind_its_cuts(tmp_path, monkeypatch):
    whole = Search(Job("tool-steel", passes=2), lambda text: None).run()
    seeds = []

    def interrupted(job, at):
        seeds.append(job.seed)
        if len(seeds) == 3:
            raise KeyboardInterrupt
        return answer_through(job, at)

    monkeypatch.setattr(technology_search, "cut_through", interrupted)
    with pytest.raises(KeyboardInterrupt):
        Search(Job("tool-steel", passes=2), lambda text: None, tmp_path / "steel.runs.jsonl").run()
    monkeypatch.setattr(technology_search, "cut_pass", forbidden)
    resumed = Search(Job("tool-steel", passes=2), lambda text: None, tmp_path / "steel.runs.jsonl").run()
    assert resumed == whole
    assert [seed // technology_search.NEXT_SEED for seed in seeds] == [0, 1, 2, 2, 3]


def test_an_interrupted_search_goes_on_behind_the_passes_it_found(tmp_path, monkeypatch):
    cuts = []

    def noted(job, one, number, offset_mm, _):
        cuts.append((number, one, offset_mm))
        return answer(job, one, number, offset_mm, number)

    monkeypatch.setattr(technology_search, "cut_pass", noted)
    journal, messages = tmp_path / "steel.runs.jsonl", list[str]()
    whole = Search(Job("tool-steel", passes=3), lambda text: None).run()
    last = {cut[0]: cut for cut in cuts}
    Search(Job("tool-steel", passes=2), lambda text: None, journal).run()
    cuts.clear()
    resumed = Search(Job("tool-steel", passes=3), messages.append, journal).run()
    assert resumed == whole
    assert cuts[:2] == [last[1], last[2]]  # cut once more, for their metal, each as when it was found
    assert {number for number, _, _ in cuts[2:]} == {3}
    with pytest.raises(InputError, match=r"it has the runs of height_mm 25\.4, not 30"):
        Search(Job("tool-steel", height_mm=30.0, passes=3), messages.append, journal).run()
    steel, own = tmp_path / "steel.toml", tmp_path / "own.runs.jsonl"
    steel.write_text(models.path("materials/tool-steel.toml").read_text())
    Search(Job(str(steel), passes=1), messages.append, own).run()
    steel.write_text(steel.read_text() + "\n")
    with pytest.raises(InputError, match="one of your files has changed"):
        Search(Job(str(steel), passes=1), messages.append, own)
    journal.write_text("{\n")
    with pytest.raises(InputError, match="the journal is damaged"):
        Search(Job("tool-steel", passes=3), messages.append, journal).run()


@pytest.mark.parametrize("before", range(1, 11))
def test_an_interrupted_search_repeats_no_trial(tmp_path, monkeypatch, before):
    cuts, ends_after = [], 99

    def noted(job, one, number, offset_mm, metal):
        if len(cuts) == ends_after:
            raise KeyboardInterrupt
        cuts.append((number, one, offset_mm))
        assert metal == (None if number == 1 else number - 1)  # what the pass before left
        return answer(job, one, number, offset_mm, number)

    monkeypatch.setattr(technology_search, "cut_pass", noted)
    journal = tmp_path / "steel.runs.jsonl"
    whole, all_cuts = Search(Job("tool-steel", passes=3), lambda text: None).run(), list(cuts)
    last = {cut[0]: cut for cut in all_cuts}
    assert len(all_cuts) == 11
    cuts.clear()
    ends_after = before
    with pytest.raises(KeyboardInterrupt):
        Search(Job("tool-steel", passes=3), lambda text: None, journal).run()
    cuts.clear()
    ends_after = 99
    resumed = Search(Job("tool-steel", passes=3), lambda text: None, journal).run()
    assert resumed == whole
    missing = all_cuts[before:]
    assert cuts == [last[k] for k in range(1, missing[0][0])] + missing  # passes that were found, for their metal


def test_two_searches_do_not_share_a_file(edmsim, tmp_path):
    file = tmp_path / "steel.toml"
    words = ("tune", "technology", "tool-steel", "--passes", 1, "--out", file)
    with locked_file(file, "edmsim tune technology"):
        refused = edmsim(*words)
        assert refused.status == 2
        assert f"{file}: another edmsim tune technology is at work on this file: wait, or give another" in refused.err
        second = edmsim(*words[:-1], tmp_path / "beside.toml")
        assert second.status == 0
    assert edmsim(*words).status == 0
    assert sorted(found.name for found in tmp_path.iterdir()) == ["beside.toml", "steel.toml"]


def test_the_command_writes_a_technology_and_adds_heights(edmsim, tmp_path):
    file = tmp_path / "steel.toml"
    for height, *more in ((30,), (20, "--resolution", "fast")):
        words = ("tune", "technology", "tool-steel", "--height", height, "--passes", 2, *more, "--out", file)
        assert edmsim(*words).status == 0
    found = read_technology(file)
    assert [at.height_mm for at in found.heights] == [20.0, 30.0]
    assert found.table(25.0, 2).offsets_mm[-1] == pytest.approx(0.150)
    assert not file.with_suffix(".runs.jsonl").exists()
    tune = "edmsim tune technology tool-steel"
    assert found.source.endswith(
        f": {tune} --height 30 --passes 2; {tune} --resolution fast --height 20 --passes 2"
    )
    before = file.read_bytes()
    repeated = edmsim(*words)
    assert repeated.status == 0
    assert f"--material tool-steel --height 20 --resolution fast --passes 2 --technology {file}" in repeated.out
    assert file.read_bytes() == before
    other = edmsim("tune", "technology", "copper", "--passes", 1, "--out", file)
    assert other.status == 2
    assert "holds a technology for material tool-steel, not copper" in other.err


def test_a_technology_is_valid_toml_whatever_its_files_are_called(tmp_path):
    known = read_technology("tool-steel-brass-254")
    job = Job('own\\"steel".toml', wire=r"C:\wires\thin.toml")
    file = tmp_path / "made.toml"
    file.write_text(technology_text(job.technology(known.heights)), encoding="utf-8")
    made = read_technology(str(file))
    assert (made.material, made.wire) == (job.material, job.wire)
    assert made.heights == known.heights


def test_what_cannot_be_searched_is_refused():
    with pytest.raises(InputError, match="a technology has 1 to 7 passes, not 8"):
        Search(Job("tool-steel", passes=8), lambda text: None)
    with pytest.raises(InputError, match="unknown material 'steel'"):
        Search(Job("steel"), lambda text: None)
