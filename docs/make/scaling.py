"""The measured tables of ``docs/scaling.md``: cost of a run for the driver in time, memory and disk space.

python docs/make/scaling.py
"""

import re
import tempfile
import time
import tracemalloc
from collections.abc import Iterable, Iterator
from pathlib import Path
from posixpath import basename  # a trivial function that every process can import
from typing import Any

import numpy as np
from sections import table, write_sections
from vector_envs import processor

from edmsim.runs import Cluster, Processes
from edmsim.sweep.run import RESULTS, ROWS_PER_PART, Outcome, Store, blank, perform, read, sweep
from edmsim.sweep.specification import Specification, runs_of

PUNCH = "G21 G90\nG0 X-2.5 Y0.5\nG41 D1\nG1 X0 Y0.5\nY1\nX1\nY0\nX0\nY0.5\nG40\nM2\n"
"""A punch of 1 x 1 mm, about two minutes of machine time."""
ROWS = 20_000
"""Runs of the simulated cluster."""
JOBS = 2000


class Instant:
    """An infinite cluster: every run is done at once, as if a node were always free."""

    def __init__(self, outcome: Outcome) -> None:
        # digits are varied, because equal rows would be compressed to almost nothing
        rng = np.random.default_rng(0)
        self._rows = [
            {name: self._varied(value, rng) for name, value in outcome.row.items()} for _ in range(ROWS_PER_PART)
        ]

    def _varied(self, value: Any, rng: np.random.Generator) -> Any:
        if isinstance(value, float) and not value.is_integer():
            return value * rng.uniform(0.999, 1.001)
        if isinstance(value, str) and value.startswith("{"):
            return re.sub(r"\d+\.\d{6,}", lambda found: repr(float(found[0]) * rng.uniform(0.999, 1.001)), value)
        return value

    def done(self, function: Any, jobs: Iterable[Any]) -> Iterator[tuple[Any, Any]]:
        """Yield the outcome of one cut for each job, with varied digits."""
        for run in jobs:
            known = {name: value for name, value in blank(run).items() if value is not None}
            yield run, Outcome({**self._rows[run.seed % ROWS_PER_PART], **known}, {})


def measure(folder: Path) -> tuple[list[tuple[str, str]], list[tuple[str, str]]]:
    """Return the measured figures, and the cost of a million runs computed from them: names and texts."""
    program = folder / "punch.ngc"
    program.write_text(PUNCH, encoding="utf-8")
    shared = {"program": [str(program)], "settings": {"resolution": "fast", "height_mm": 5.0}}
    one = Specification(**shared, recordings=["windows"])
    (run,) = runs_of(one)
    perform(run)  # compiles
    started = time.perf_counter()
    outcome = perform(run)
    cut_s = time.perf_counter() - started
    machine_s = float(outcome.row["machining_time_s"])
    windows = len(outcome.files["windows.parquet"])

    many = Specification(**shared, seeds=list(range(ROWS)))
    started = time.perf_counter()
    for _ in runs_of(many):
        pass
    plan_s = (time.perf_counter() - started) / ROWS

    started = time.perf_counter()
    handed = sum(1 for _ in Processes(1).done(basename, ["job"]))
    start_s = (time.perf_counter() - started) / handed
    started = time.perf_counter()
    for _ in Processes(1).done(basename, ["job"] * JOBS):
        pass
    hand_s = (time.perf_counter() - started - start_s) / JOBS

    ray_s = handed_by_ray()

    started = time.perf_counter()
    sweep(many, folder / "out", engine=Instant(outcome))
    driver_s = (time.perf_counter() - started) / ROWS
    parquet = sum(file.stat().st_size for file in (folder / "out" / RESULTS).rglob("*.parquet")) / ROWS
    tracemalloc.start()
    with Store(folder / "out") as store:
        memory = tracemalloc.get_traced_memory()[0] / len(store.failed)
    tracemalloc.stop()
    started = time.perf_counter()
    results = read(folder / "out")
    read_s = (time.perf_counter() - started) / len(results)
    runs_per_s = 1 / (driver_s + ray_s)
    measured = [
        ("a cut of " + f"{machine_s:.0f} s of machine time, `fast`", f"{cut_s:.1f} s of a processor"),
        ("one more process, from its start to its first answer", f"{start_s:.1f} s"),
        ("a run planned: values combined, checked, named by its id", f"{1e6 * plan_s:.0f} us of the driver"),
        ("a job handed to a process, and its answer taken", f"{1e6 * hand_s:.0f} us"),
        ("the same by Ray, on a node of this computer", f"{1e6 * ray_s:.0f} us"),
        ("a run from plan to disk, with no cut in between", f"{1e6 * driver_s:.0f} us of the driver"),
        ("a row of the dataset", f"{parquet:.0f} bytes"),
        ("`windows.parquet` of that cut, if recorded", f"{1e-3 * windows:.0f} kB"),
        ("memory of the driver for a run that is done", f"{memory:.0f} bytes"),
        ("a row read again", f"{1e6 * read_s:.0f} us"),
        ("runs that one driver gets done with Ray, at most", f"{runs_per_s:.0f} a second"),
        ("**processors it keeps busy with cuts of that length**", f"**{cut_s * runs_per_s:,.0f}**"),
    ]  # fmt: skip
    follows = [
        *((f"processors kept busy with runs of {s} s", f"{s * runs_per_s:,.0f}") for s in (10, 60, 600)),
        ("a million runs: the driver's time, at least", f"{1e6 / runs_per_s / 3600:.1f} h"),
        ("their dataset", f"{1e-3 * parquet:.1f} GB in {1e6 / ROWS_PER_PART:,.0f} files"),
        ("memory of their driver", f"{1e-3 * memory:.2f} GB"),
        ("`windows.parquet` of all, if recorded",
         f"{1e-6 * windows:.1f} TB, through the driver at {1e-6 * windows * runs_per_s:.0f} MB/s"),
        ("restart of a complete sweep", f"{1e6 * (plan_s + read_s) / 60:.0f} min to the first that is missing"),
    ]  # fmt: skip
    return measured, follows


def handed_by_ray() -> float:
    """Return the time in s to send a trivial job to a Ray cluster of one node and to receive its answer."""
    import ray
    from ray.cluster_utils import Cluster as Nodes

    node = {"num_cpus": 1, "include_dashboard": False, "node_ip_address": "127.0.0.2"}
    nodes = Nodes(initialize_head=True, head_node_args=node)
    try:
        cluster = Cluster(nodes.address)
        for _ in cluster.done(basename, ["job"] * 10):
            pass
        started = time.perf_counter()
        for _ in cluster.done(basename, ["job"] * JOBS):
            pass
        return (time.perf_counter() - started) / JOBS
    finally:
        ray.shutdown()
        nodes.shutdown()


def main() -> None:
    """Measure, and write the tables into the page."""
    with tempfile.TemporaryDirectory() as name:
        sections = dict(zip(("measured", "follows"), measure(Path(name)), strict=True))
    heads = "what", "how much"
    made = {name: f"{table(heads, rows)}\n\nOn {processor()}." for name, rows in sections.items()}
    write_sections("scaling.md", made)


if __name__ == "__main__":
    main()
