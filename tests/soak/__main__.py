"""The soak: ``python -m tests.soak [PART ...] --out out/soak``, or ``make soak``; figures go to ``soak.json``.

The parts are ``open``, ``vectors``, ``kills``, ``hour``, ``steps`` and ``sweep`` (``make lost-node``); all but the
last by default, one after the other.
"""

import argparse
import json
import platform
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from . import endurance, kills, lost_node, vectors


def _in_a_folder(work: Callable[[Path], dict[str, Any]]) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as name:
        return work(Path(name))


PARTS: dict[str, Callable[[], dict[str, Any]]] = {
    "open": lambda: vectors.open_and_close(100), "vectors": lambda: vectors.compare(200),
    "kills": lambda: _in_a_folder(lambda folder: kills.kill(100, folder)),
    "hour": lambda: endurance.simulate(3600.0), "steps": lambda: endurance.step(1_000_000),
    "sweep": lambda: _in_a_folder(lost_node.lose),
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []])
    parser.add_argument("--out", type=Path, default=Path("out/soak"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    file = options.out / "soak.json"
    for name in options.parts or [part for part in PARTS if part != "sweep"]:
        found = {**PARTS[name](), "python": platform.python_version()}
        known = json.loads(file.read_text()) if file.exists() else {}
        file.write_text(json.dumps({**known, name: found}, indent=1) + "\n")
        print(name, json.dumps(found), flush=True)


if __name__ == "__main__":
    main()
