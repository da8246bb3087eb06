"""A line of 0.3 mm through thin stock, of which the first second is cut: a fifth of a second of this computer; and a
cluster of two nodes."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from edmsim.sweep.specification import Specification


@pytest.fixture
def line(tmp_path: Path) -> Path:
    """Part program of a straight line."""
    file = tmp_path / "line.ngc"
    file.write_text("G21 G90\nG0 X0 Y0\nG1 X0.3\nM2\n")
    return file


@pytest.fixture
def short() -> dict[str, Any]:
    """Settings of a cut that takes no time."""
    return {"resolution": "fast", "max_time_s": 1.0, "offset": "none", "height_mm": 5.0}


@pytest.fixture
def giving_up(tmp_path: Path) -> str:
    """A controller that fails in its first window, as a sweep names it."""
    file = tmp_path / "giving_up.py"
    file.write_text(
        "from typing import ClassVar\n\nfrom edmsim.controllers import FeedCommand\n\n\nclass Own:\n"
        "    name: ClassVar[str] = 'own'\n\n    def reset(self, max_feed_um_s):\n        return FeedCommand(5.0)\n\n"
        "    def update(self, window):\n        raise RuntimeError('out of ideas')\n\n"
        "    def snapshot(self):\n        return {}\n\n    def restore(self, state):\n        pass\n"
    )
    return f"{file}:Own"


@pytest.fixture
def two_controllers(line: Path, short: dict[str, Any]) -> Specification:
    """Two controllers, two seeds."""
    return Specification(
        program=[str(line)], seeds=[0, 1], settings=short, grid={"controller": ["counts", "fixed:feed_um_s=9"]}
    )


@pytest.fixture
def nodes(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Two nodes, each with a processor and a loopback address of its own."""
    ray = pytest.importorskip("ray")
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    monkeypatch.setenv("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    monkeypatch.setenv("PYTHONPATH", f"{Path(__file__).parents[2]}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Ray's, of files it leaves to the collector
        from ray.cluster_utils import Cluster as Nodes

        node = {"num_cpus": 1, "object_store_memory": 80 * 2**20, "include_dashboard": False}
        cluster = Nodes(initialize_head=True, head_node_args={**node, "node_ip_address": "127.0.0.2"})
        cluster.second = cluster.add_node(**node, node_ip_address="127.0.0.3")
        yield cluster
        ray.shutdown()
        cluster.shutdown()
