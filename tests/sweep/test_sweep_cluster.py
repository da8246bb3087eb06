"""A real Ray cluster of two nodes: a population is trained on both, and a sweep loses one of them in the middle."""

import os
import sys
import tomllib
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace

import pyarrow.parquet as pq
import pytest
import ray

from edmsim.controllers import from_text
from edmsim.errors import EdmsimError, InputError
from edmsim.runs import Cluster, LostJob
from edmsim.sweep.population import TABLE, train_population
from edmsim.sweep.run import SweepProgress, read, sweep
from edmsim.sweep.specification import Specification
from edmsim.sweep.tune import TRAINING
from tests.soak.lost_node import two_nodes

pytestmark = pytest.mark.filterwarnings("ignore")
ENV = "edmsim/GapFeed-v2"


@pytest.fixture
def nodes():
    """Two nodes, each with a processor and a loopback address of its own.

    Not shared: removing a placement group of Tune's while its actor exits can lose Ray the processor (2.60), and with
    the other node removed, the next run would wait endlessly.
    """
    # of Ray's shared folder another user of this computer may own the files; a socket's path is short
    with TemporaryDirectory(prefix="ray") as folder, pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        patch.setenv("RAY_TMPDIR", folder)
        patch.setenv("PYTHONPATH", f"{Path(__file__).parents[2]}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
        warnings.simplefilter("ignore")  # Ray's, of files it leaves to the collector
        with two_nodes() as cluster:
            yield cluster
            ray.shutdown()


@pytest.mark.slow
@pytest.mark.skipif(" " in sys.executable, reason="Ray Tune starts no worker with a Python whose path has a space")
@pytest.mark.timeout(400)
def test_a_population_exploits_and_explores_on_two_nodes(nodes, short_training, tmp_path):
    observed = []
    options = {"address": nodes.address, "population": 4, "generations": 2, "steps": 256, "seeds": 1}
    found = train_population(ENV, tmp_path, **options, watch=observed.append)
    assert len(observed) == 8
    rows = pq.read_table(tmp_path / TABLE).to_pylist()
    first, second = ([row for row in rows if row["generation"] == n] for n in (1, 2))
    assert sorted(row["learner"] for row in first) == sorted(row["learner"] for row in second) == [0, 1, 2, 3]
    assert all(row["parent"] == row["learner"] for row in first)
    assert {row["windows"] for row in first} == {128}
    assert {row["windows"] for row in second} == {256}
    best, worst = (choose(first, key=lambda row: row["score"])["learner"] for choose in (max, min))
    moved = [row for row in second if row["parent"] != row["learner"]]
    assert [(row["learner"], row["parent"]) for row in moved] == [(worst, best)]
    before = next(row for row in first if row["learner"] == best)
    assert [key for key in TRAINING["ppo"] if moved[0][key] != before[key]]
    for row in rows:
        assert all(bound.low <= row[key] <= bound.high for key, bound in TRAINING["ppo"].items())
    assert found.value == max(row["score"] for row in second)
    assert tomllib.loads((tmp_path / "best.toml").read_text())["algorithm"] == found.values
    assert from_text(f"policy:{tmp_path / 'policy.json'}").name == "policy"

    assert train_population(ENV, tmp_path, **options) == found  # all is done: nothing is trained again
    with pytest.raises(InputError, match="it has the runs of population 4, not 5"):
        train_population(ENV, tmp_path, **{**options, "population": 5})


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_a_lost_node_loses_nothing(nodes, line, short, giving_up, tmp_path):
    spec = Specification(program=[str(line)], seeds=5, settings={**short, "max_time_s": 3.0})
    spec = Specification.model_validate({**spec.model_dump(), "grid": {"controller": ["counts", giving_up]}})
    engine = Cluster(nodes.address)
    assert engine.count == 2

    def watch(progress):
        if progress.made == 3:
            nodes.remove_node(nodes.second, allow_graceful=False)

    assert sweep(spec, tmp_path / "ray", engine=engine, watch=watch) == SweepProgress(10, 10, 10, 5)
    sweep(spec, tmp_path / "here")
    there, here = (read(tmp_path / name).drop_columns(["wall_time_s", "host"]) for name in ("ray", "here"))
    assert there.equals(here)
    assert len(set(there["id"].to_pylist())) == 10


def test_a_cluster_that_is_lost_ends_a_sweep_and_fails_no_run(monkeypatch):
    def lost(_):
        raise error

    job = SimpleNamespace(remote=lambda job: job)
    for name, fake in {
        "is_initialized": lambda: True, "cluster_resources": lambda: {"CPU": 1}, "cancel": lambda *_, **__: None,
        "remote": lambda **_: lambda function: job, "wait": lambda out, **_: (out[:1], out[1:]), "get": lost,
    }.items():  # fmt: skip
        monkeypatch.setattr(ray, name, fake)
    error = ray.exceptions.WorkerCrashedError()
    assert [type(answer) for _, answer in Cluster().done(len, "ab")] == [LostJob] * 2
    error = ray.exceptions.LocalRayletDiedError()
    with pytest.raises(EdmsimError, match="Ray has ended on this computer: start it again"):
        list(Cluster().done(len, "ab"))


def test_a_python_whose_path_has_a_space_is_refused(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "executable", "/home/ada/wire edm/.venv/bin/python")
    with pytest.raises(InputError, match="the path has a space"):
        train_population(ENV, tmp_path / "out")


@pytest.mark.slow
def test_without_a_cluster_it_says_so(monkeypatch):
    def refuse(**_):
        raise ConnectionError("Could not find any running Ray instance. Start one")

    monkeypatch.setattr(ray, "is_initialized", lambda: False)
    monkeypatch.setattr(ray, "init", refuse)
    with pytest.raises(InputError, match="no Ray cluster at 'auto'"):
        Cluster()
    with pytest.raises(InputError, match=r"no Ray cluster at '127\.0\.0\.1:1' .*refused"):
        Cluster("127.0.0.1:1")  # at once: Ray itself would try for minutes
