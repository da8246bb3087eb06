"""A sweep of short cuts on two Ray nodes: a node is lost, then the driver is killed; the same command finishes it."""

import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from edmsim.runs import read_rows
from edmsim.sweep.run import JOURNAL, RESULTS, read

LINE = "G21 G90\nG0 X0 Y0\nG1 X0.3\nM2\n"
SPECIFICATION = """\
program = "{program}"
seeds = {seeds}
[settings]
resolution = "fast"
offset = "none"
height_mm = 5
max_time_s = 1
[grid]
t_on_us = [20.0, 30.0]
controller = ["counts", "fixed:feed_um_s=9"]
"""
NODE_LOST, DRIVER_KILLED = 0.25, 0.5
"""Shares of the sweep that are done when the node is lost, and when the driver is killed (ours)."""


@contextmanager
def two_nodes() -> Iterator[Any]:
    """A Ray cluster on loopback addresses, a processor each; ``second`` is the node that may be lost."""
    os.environ |= {"RAY_USAGE_STATS_ENABLED": "0", "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0"}
    from ray.cluster_utils import Cluster

    node = {"num_cpus": 1, "object_store_memory": 80 * 2**20, "include_dashboard": False}
    nodes = Cluster(initialize_head=True, head_node_args={**node, "node_ip_address": "127.0.0.2"})
    nodes.second = nodes.add_node(**node, node_ip_address="127.0.0.3")
    try:
        yield nodes
    finally:
        nodes.shutdown()


def lose(folder: Path, cuts: int = 200) -> dict[str, Any]:
    """Run the sweep as said; tell what is missing, what was made twice, and what differs from a local sweep."""
    began = time.monotonic()
    program, spec = folder / "line.ngc", folder / "sweep.toml"
    program.write_text(LINE, encoding="ascii")
    spec.write_text(SPECIFICATION.format(program=program, seeds=cuts // 4), encoding="utf-8")
    out = folder / "ray"
    command = [sys.executable, "-m", "edmsim", "sweep", "run", str(spec), "--out"]
    with two_nodes() as nodes:
        ray = [*command, str(out), "--ray", nodes.address]
        driver = subprocess.Popen(ray, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        lost_at = _wait(driver, out, round(NODE_LOST * cuts))
        nodes.remove_node(nodes.second, allow_graceful=False)
        killed_at = _wait(driver, out, round(DRIVER_KILLED * cuts))
        driver.send_signal(signal.SIGKILL)
        driver.wait()
        before = {row["id"]: row for row in read_rows(out / JOURNAL)}
        nodes.add_node(num_cpus=1, node_ip_address="127.0.0.4", object_store_memory=80 * 2**20)
        _finish(ray)
    _finish([*command, str(folder / "here")])
    there, here = (read(place).drop_columns(["wall_time_s", "host"]) for place in (out, folder / "here"))
    ids = _ids(out)
    times = {row["id"]: row["wall_time_s"] for row in read(out).select(["id", "wall_time_s"]).to_pylist()}
    return {
        "cuts": cuts, "node_lost_after": lost_at, "driver_killed_after": killed_at,
        "missing": cuts - len(set(ids)), "twice": sum(n - 1 for n in Counter(ids).values()),
        "made_again_though_done": sum(times[name] != row["wall_time_s"] for name, row in before.items()),
        "same_as_local": there.equals(here), "failed": there.num_rows - there["error"].null_count,
        "errors": sorted({str(error) for error in there["error"].to_pylist() if error is not None}),
        "wall_s": time.monotonic() - began,
    }  # fmt: skip


def _finish(command: list[str]) -> None:
    """Run a sweep to its end; runs that fail are rows, and by a status of 3."""
    status = subprocess.run(command, check=False, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL).returncode
    if status not in (0, 3):
        raise RuntimeError(f"the sweep ended with status {status}")


def _wait(driver: subprocess.Popen[bytes], out: Path, rows: int) -> int:
    """Wait until a number of runs is done; return how many are."""
    while (done := _done(out)) < rows:
        if driver.poll() is not None:
            raise RuntimeError(f"the sweep ended with status {driver.returncode} after {done} runs")
        time.sleep(0.05)
    return done


def _done(out: Path) -> int:
    return len(read_rows(out / JOURNAL)) if out.exists() else 0


def _ids(out: Path) -> list[str]:
    """Ids of all rows in the files, twice if a row is there twice."""
    import pyarrow.parquet as pq

    parts = sorted((out / RESULTS).glob("*/*.parquet"))
    stored = [name for part in parts for name in pq.read_table(part, partitioning=None)["id"].to_pylist()]
    return stored + [row["id"] for row in read_rows(out / JOURNAL)]
