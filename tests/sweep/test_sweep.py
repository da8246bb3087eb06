"""A sweep loses nothing and does nothing twice: engines, failures, interruptions, and what is read afterwards."""

import functools
import importlib
import json
import pickle
import re
import subprocess
import sys
import time
from pathlib import Path

import pyarrow.dataset
import pytest

from edmsim.errors import EdmsimError, InputError
from edmsim.machine.machine import Machine
from edmsim.runs import LostJob, Processes, RunTable
from edmsim.runs import perform as perform_jobs
from edmsim.sweep import run as stores
from edmsim.sweep.run import JOURNAL, Outcome, Store, SweepProgress, blank, perform, read, sweep
from edmsim.sweep.specification import Specification, runs_of

CLOCKS = ["wall_time_s", "host"]


class Here:
    """An engine in this process that stops, as by Ctrl-C, after a number of jobs."""

    def __init__(self, stop_after=10**9):
        self.left, self.made = stop_after, list[str]()

    def done(self, function, jobs):
        for job in jobs:
            if not self.left:
                raise KeyboardInterrupt
            self.left -= 1
            self.made.append(job.id)
            yield job, function(job)


class _Nothing:
    """An engine that makes no run."""

    def done(self, function, jobs):
        yield from ()


@pytest.fixture
def jobs(monkeypatch):
    """Jobs that raise errors or kill their process, in a file that other processes can import."""
    monkeypatch.syspath_prepend(Path(__file__).parent)
    return importlib.import_module("jobs")


@pytest.mark.slow
def test_a_process_that_dies_costs_a_retry_and_no_other_run(jobs, tmp_path):
    files = [tmp_path / name for name in "abc"]
    assert sorted(answer for _, answer in Processes(2).done(jobs.dies_once, files)) == ["a", "b", "c"]
    found = dict(Processes(2).done(jobs.dies, [1, 3]))
    assert found[3] == 3
    assert isinstance(found[1], LostJob)
    assert "status -9; given up after 3 attempts" in found[1].why


@pytest.mark.slow
def test_jobs_in_processes_are_answered_in_order_and_saved_once(jobs, tmp_path):
    table = RunTable(tmp_path / "runs.jsonl")
    counts = []
    table.add({"id": "b", "job": "made before"})
    found = perform_jobs(
        jobs.answer, ["x", "y", "z"], lambda *both: counts.append(both), engine=Processes(2), table=table,
        ids=["a", "b", "c"],
    )  # fmt: skip
    assert found == [{"id": "a", "job": "x"}, {"id": "b", "job": "made before"}, {"id": "c", "job": "z"}]
    assert counts == [(1, 3), (2, 3), (3, 3)]
    with (tmp_path / "runs.jsonl").open("ab") as other:  # which another process adds to
        assert RunTable(tmp_path / "runs.jsonl").rows == table.rows
        other.write(b'{"id": "of another process"}\n')
    assert "of another process" in RunTable(tmp_path / "runs.jsonl").rows


@pytest.mark.slow
@pytest.mark.parametrize(("job", "kind", "said"), [
    ("input", InputError, "cut.toml:3: there is no such wire"),
    ("own", ZeroDivisionError, "in a user's law"),
    ("unportable", EdmsimError, "this and that"),
])  # fmt: skip
def test_an_error_of_a_job_in_a_process_is_raised_here(jobs, job, kind, said):
    with pytest.raises(kind) as caught:
        perform_jobs(jobs.answer, [job], engine=Processes(1))
    assert type(caught.value) is kind
    assert str(caught.value) == said
    if job == "own":
        assert "jobs.py" in caught.value.__notes__[0]  # where it was raised


@pytest.mark.slow
def test_a_job_that_cannot_be_sent_or_an_answer_that_cannot_be_read_ends_the_study(jobs):
    with pytest.raises((AttributeError, pickle.PicklingError, TypeError)):
        perform_jobs(jobs.answer, [lambda: None], engine=Processes(1))
    with pytest.raises(EdmsimError, match=r"cannot be read: .*second"):
        perform_jobs(jobs.unreadable, ["x"], engine=Processes(1))


def test_work_that_another_process_cannot_import_is_refused():
    for work in (lambda job: job, functools.partial(lambda by, job: by * job, 2)):
        with pytest.raises(InputError, match=r"cannot import 'test_work.*<lambda>': define it in a module"):
            perform_jobs(work, [1], engine=Processes(1))


@pytest.mark.slow
def test_a_process_that_always_dies_ends_the_study_with_a_reason(jobs):
    with pytest.raises(EdmsimError, match=r"status -9; given up after 3 attempts"):
        perform_jobs(jobs.dies, [1], engine=Processes(1))


@pytest.mark.slow
def test_processes_find_the_same_bits_as_this_one(two_controllers, tmp_path):
    observed = []
    sweep(two_controllers, tmp_path / "here", engine=Here())
    last = sweep(two_controllers, tmp_path / "there", engine=Processes(1), watch=observed.append)
    here, there = (read(tmp_path / name).drop_columns(CLOCKS) for name in ("here", "there"))
    assert here.equals(there)
    assert last == SweepProgress(4, 4, 4, 0)
    sweep(two_controllers, tmp_path / "there", engine=Here(), watch=observed.append)
    assert [progress.done for progress in observed] == [0, 1, 2, 3, 4, 0, 4]
    assert here["controller"].to_pylist().count("counts") == 2
    assert json.loads(here["report"][0].as_py())["settings"]["resolution"] == "fast"


@pytest.mark.slow
def test_a_run_that_fails_is_a_row_with_its_error(line, short, giving_up, tmp_path):
    spec = Specification(program=[str(line)], settings=short, grid={"controller": ["counts", giving_up]})
    out = tmp_path / "out"
    assert sweep(spec, out, engine=Here()).failed == 1
    by_law = {row["controller"]: row for row in read(out).to_pylist()}
    assert by_law["counts"]["error"] is None
    assert by_law["counts"]["outcome"] == "time-limit"
    assert "RuntimeError: out of ideas" in by_law[giving_up]["error"]
    assert by_law[giving_up]["machining_time_s"] is None
    again = Here()
    assert sweep(spec, out, engine=again).failed == 1
    assert again.made == []  # it is done
    sweep(spec, out, engine=again, retry_failed=True)
    assert again.made == [by_law[giving_up]["id"]]
    assert len(read(out)) == 2
    line.write_text("G0 X0 Y0\nG1 X0.2\nM2\n")
    changed = sweep(spec, out, engine=Here())
    assert changed.made == 2  # another program: other runs, and those of the first stay
    assert len(read(out)) == 4


@pytest.mark.parametrize(("grid", "named"), [
    ({"height_mm": [5, "abc"]}, "1 of 2 combinations cannot be run, so none was: with height_mm abc: option height"),
    ({"height_mm": [5, 900], "t_on": [20, 30]}, "2 of 4 combinations cannot be run, so none was: with height_mm 900"),
    ({"t_on": [30, 60]}, "with t_on_us 60: t_on 60 us in t_period 100 us"),  # beyond the generator
    ({"tension": [8, 80]}, "with tension 80: "),
    ({"controller": ["counts", "genius"]}, "with controller genius: "),
    ({"controller": ["counts", "oracle"]}, "which no machine shows"),  # but a comparison may have it
    ({"controller": ["counts", "policy:none.json"]}, "none.json"),
    ({"controller": ["fixed:feed_um_s=20", "fixed:feed_um_s=40"]}, "with controller fixed:feed_um_s=40: feed_um_s"),
    ({"material": ["tool-steel", "none.toml"]}, "with material none.toml: "),
    ({"offset": ["none", "wide"]}, "with offset wide: "),
    ({"drive": ["stepper", "steam"]}, "with drive steam: "),
    ({"planner": ["poscal", "compass"]}, "with planner compass: "),
    ({"compensation": ["none.txt"]}, "none.txt"),
    ({"gap.critical_um": [5, -5]}, "with gap.critical_um -5: "),
])  # fmt: skip
def test_all_values_are_looked_at_before_the_first_run(line, short, tmp_path, grid, named):
    settings = {name: value for name, value in short.items() if name not in grid}
    spec = Specification(program=[str(line)], settings=settings, grid=grid)
    engine = Here()
    with pytest.raises(InputError) as refused:
        sweep(spec, tmp_path / "out", engine=engine)
    assert named in str(refused.value)
    assert "\n" not in str(refused.value)
    assert engine.made == []
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.parametrize("chosen", [
    {"sobol": {"samples": 4, "ranges": {"t_on": [10, 60], "t_period": [80, 120]}}},
    {"grid": {"t_on": [10, 36], "t_period": [80, 120]}},
    {"grid": {"wire": ["brass-100", "brass-250"], "tension": [2, 12]}},
])  # fmt: skip
def test_values_that_no_machine_can_have_together_are_rows_with_an_error(line, short, tmp_path, chosen):
    sweep(Specification(program=str(line), settings=short, **chosen), tmp_path / "out", engine=Here())
    errors = [row["error"] for row in read(tmp_path / "out").to_pylist()]
    assert len(errors) == 4
    assert 0 < sum(error is not None for error in errors) < 4
    assert all(error is None or re.search("t_period must be at least|12 N breaks the", error) for error in errors)


def test_programs_samples_and_environments_are_looked_at_as_well(line, short, tmp_path):
    odd = tmp_path / "odd.ngc"
    odd.write_text("G0 X0 Y0\nG1 X1 Q5 Q6\nG77\nM2\n")
    for options, named in (
        ({"program": [str(line), str(odd)]}, "odd.ngc"),
        ({"program": str(line), "sobol": {"samples": 4, "ranges": {"tension": [8, 80]}}}, "with tension "),
        ({"program": str(line), "machine_samples": 2, "sample_only": ["nonsense"]}, "'nonsense' is not a section"),
    ):
        with pytest.raises(InputError, match=named):
            sweep(Specification(settings=short, **options), tmp_path / "out", engine=Here())
    grid = {"height_mm": [5, 900], "controller": ["counts", "genius"]}
    with pytest.raises(InputError, match=r"3 of 4 .*controller genius: .* with height_mm 900: "):
        sweep(Specification(environment="edmsim/GapFeed-v2", grid=grid), tmp_path / "out", engine=Here())
    observed = []
    spec = Specification(program=[str(line)], seeds=3, settings=short, grid={"t_on": [20, 30]})
    sweep(spec, tmp_path / "out", engine=_Nothing(), checking=lambda *count: observed.append(count))
    assert observed == [(1, 2), (2, 2)]


@pytest.mark.slow
def test_an_interrupted_sweep_makes_only_what_is_missing(two_controllers, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        sweep(two_controllers, tmp_path, engine=Here(3))
    assert len(read(tmp_path)) == 3
    rest = Here()
    assert sweep(two_controllers, tmp_path, engine=rest) == SweepProgress(4, 4, 1, 0)
    assert len(rest.made) == 1
    more = two_controllers.model_copy(update={"seeds": [0, 1, 2]})
    assert sweep(more, tmp_path, engine=rest) == SweepProgress(6, 6, 2, 0)


def outcomes(count):
    spec = Specification(environment="edmsim/GapFeed-v2", seeds=list(range(count)))
    return [(run, Outcome({**blank(run), "machining_time_s": 0.1 + run.seed}, {})) for run in runs_of(spec)]


def test_what_was_stored_is_there_once_whenever_the_driver_dies(tmp_path, monkeypatch):
    monkeypatch.setattr(stores, "ROWS_PER_PART", 4)
    store = Store(tmp_path)
    made = outcomes(11)
    for run, outcome in made:
        store.add(run, outcome)
        store.add(run, outcome)  # twice is once
    with pytest.raises(InputError, match="another sweep"):
        Store(tmp_path)
    store._held.close()  # the process is gone: nothing was flushed
    journal = tmp_path / JOURNAL
    # and died between a part and the journal it was made of, with a line half written
    journal.write_bytes(b"".join(json.dumps(o.row).encode() + b"\n" for _, o in made[4:]) + b'{"id": "cut o')
    with Store(tmp_path) as again:
        assert not any(again.misses(run) for run, _ in made)
    table = read(tmp_path)
    assert sorted(table["seed"].to_pylist()) == list(range(11))
    assert sorted(table["machining_time_s"].to_pylist()) == [0.1 + k for k in range(11)]
    assert journal.read_bytes() == b""
    # others read the dataset, too: the folders name the task
    observed = pyarrow.dataset.dataset(tmp_path / "results", partitioning="hive").to_table()
    assert set(observed["task"].to_pylist()) == {"edmsim/GapFeed-v2"}
    assert len(observed) == 11


@pytest.mark.parametrize(("name", "value"), [("technology", "own.toml"), ("guide_errors_mm", [0.01, 0.0])])
def test_a_setting_has_a_column_of_one_type_whether_or_not_it_is_set(name, value):
    assert stores.as_table([{name: value}]).schema == stores.as_table([{name: None}]).schema


@pytest.mark.slow
def test_recordings_are_whole_and_play(line, short, tmp_path):
    spec = Specification(program=[str(line)], settings=short, recordings=["windows", "report"])
    (run,) = runs_of(spec)
    folder = tmp_path / "recordings" / run.id
    # of a run that is done its recording is still wanted, and what there is stays
    for requested, made in (([], [run.id]), (["report"], [run.id]), (["windows"], [run.id]), (spec.recordings, [])):
        engine = Here()
        sweep(spec.model_copy(update={"recordings": requested}), tmp_path, engine=engine)
        assert engine.made == made
    assert sorted(file.name for file in folder.iterdir()) == ["report.json", "windows.parquet"]
    assert json.loads((folder / "report.json").read_text())["outcome"] == "time-limit"
    assert len(read(tmp_path)) == 1


@pytest.mark.slow
def test_machines_are_drawn_the_same_for_every_setting(line, short):
    spec = Specification(
        program=[str(line)], settings=short, grid={"controller": ["counts", "voltage"]}, machine_samples=2,
        sample_only=["gap.critical_um", "discharge"],
    )  # fmt: skip
    rows = [perform(run).row for run in runs_of(spec)]
    drawn = [(row["machine_sample"], row["gap.critical_um"], row["discharge.wear_ratio"]) for row in rows]
    assert drawn[:2] == drawn[2:]
    assert drawn[0][1:] != drawn[1][1:]
    assert "gas.wetting" not in rows[0]
    assert json.loads(rows[0]["report"])["settings"]["constants"][0][0].startswith("discharge.")


@pytest.mark.slow
def test_machines_of_a_cut_in_passes_are_drawn_within_the_ranges_of_its_technology(small_punch):
    passes = {"passes": 2, "height_mm": 25.4, "max_time_s": 0.05, "resolution": "fast"}
    spec = Specification(
        program=str(small_punch), settings=passes, machine_samples=2, sample_only=["dielectric.flushing_pressure_Pa"],
        sobol={"samples": 2, "ranges": {"guides.clearance_mm": "range"}},
    )  # fmt: skip
    production = Machine.load("production").uncertain()
    for row in (perform(run).row for run in runs_of(spec)):
        assert row["error"] is None
        for name in ("dielectric.flushing_pressure_Pa", "guides.clearance_mm"):
            low, high = production[name].range
            assert low <= row[name] <= high


def test_a_file_that_changed_under_way_fails_its_runs(line, short):
    (run,) = runs_of(Specification(program=[str(line)], settings=short))
    line.write_text("G0 X0 Y0\nG1 X0.1\nM2\n")
    assert "has changed" in perform(run).row["error"]


@pytest.mark.slow
def test_controllers_and_entries_of_mappings_are_swept_in_environments():
    spec = Specification(
        environment="edmsim/GapFeed-v2",
        grid={"controller": ["fixed", "oracle:gap_target_um=6"], "weights": {"time": [0, 1]}},
        settings={"resolution": "fast", "length_mm": 0.05, "machine": {"wire": "brass-200"}, "tension": 5},
    )  # fmt: skip
    rows = [perform(run).row for run in runs_of(spec)]
    assert [(row["error"], row["machine.wire"]) for row in rows] == [(None, "brass-200")] * 4
    assert [row["weights.time"] for row in rows] == [0, 1] * 2
    assert len({row["total_return"] for row in rows}) == 4
    free, timed = rows[:2]
    assert free["total_return"] > timed["total_return"]
    assert free["cutting_rate_mm2_min"] == timed["cutting_rate_mm2_min"] > 0


@pytest.mark.slow
def test_a_killed_driver_leaves_no_process_and_nothing_is_done_twice(two_controllers, tmp_path):
    spec = two_controllers.model_copy(update={"seeds": list(range(15))})
    file = tmp_path / "sweep.json"
    file.write_text(spec.model_dump_json())
    code = (
        "import sys; from edmsim.sweep.run import sweep; from edmsim.sweep.specification import Specification\n"
        "from edmsim.runs import Processes\n"
        "from pathlib import Path\n"
        "sweep(Specification.model_validate_json(Path(sys.argv[1]).read_text()), sys.argv[2], engine=Processes(1))"
    )
    driver = subprocess.Popen([sys.executable, "-c", code, str(file), str(tmp_path / "out")])
    journal = tmp_path / "out" / JOURNAL
    until = time.monotonic() + 120
    while time.monotonic() < until and (not journal.exists() or journal.read_bytes().count(b"\n") < 3):
        time.sleep(0.05)
    threads = Path(f"/proc/{driver.pid}/task").iterdir()
    worker = next(int(pid) for thread in threads for pid in (thread / "children").read_text().split())
    driver.kill()
    driver.wait()
    finished = {row["id"] for row in read(tmp_path / "out").to_pylist()}
    assert 3 <= len(finished) < 30
    while Path(f"/proc/{worker}").exists() and time.monotonic() < until:
        time.sleep(0.05)
    assert not Path(f"/proc/{worker}").exists()
    rest = Here()
    assert sweep(spec, tmp_path / "out", engine=rest) == SweepProgress(30, 30, 30 - len(finished), 0)
    assert not finished & set(rest.made)
