"""A sweep on a real Ray cluster of two nodes, one of which is lost in the middle."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from edmsim.errors import InputError
from edmsim.sweep.run import SweepProgress, sweep
from edmsim.sweep.specification import Specification
from edmsim.sweep.table import read

ray = pytest.importorskip("ray")


@pytest.mark.slow
@pytest.mark.timeout(400)
@pytest.mark.filterwarnings("ignore")
def test_a_lost_node_loses_nothing(
    nodes: Any, line: Path, short: dict[str, Any], giving_up: str, tmp_path: Path
) -> None:
    from edmsim.sweep.engine import Cluster

    spec = Specification(program=[str(line)], seeds=10, settings={**short, "max_time_s": 3.0})
    spec = Specification.model_validate({**spec.model_dump(), "grid": {"controller": ["counts", giving_up]}})
    engine = Cluster(nodes.address)
    assert engine.count == 2

    def watch(progress: SweepProgress) -> None:
        if progress.made == 3:
            nodes.remove_node(nodes.second, allow_graceful=False)

    assert sweep(spec, tmp_path / "ray", engine=engine, watch=watch) == SweepProgress(20, 20, 20, 10)
    sweep(spec, tmp_path / "here")
    there, here = (read(tmp_path / name).drop_columns(["wall_time_s", "host"]) for name in ("ray", "here"))
    assert there.equals(here)
    assert len(set(there["id"].to_pylist())) == 20


def test_without_a_cluster_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    from edmsim.sweep.engine import Cluster

    def refuse(**_: object) -> None:
        raise ConnectionError("Could not find any running Ray instance. Start one")

    monkeypatch.setattr(ray, "init", refuse)
    with pytest.raises(InputError, match="no Ray cluster at 'auto'"):
        Cluster()
