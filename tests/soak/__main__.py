"""The soak: ``python -m tests.soak [PART ...] --out out/soak``, which is ``make soak``; figures go to ``soak.json``.

The parts are ``hour``, ``steps``, ``kills``, ``vectors`` and ``open``; all by default, one after the other.
"""

from __future__ import annotations

import argparse
import json
import platform
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from . import endurance, kills, vectors


def _kills() -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as name:
        return kills.kill(100, Path(name))


PARTS: dict[str, Callable[[], dict[str, Any]]] = {
    "open": lambda: vectors.open_and_close(100), "vectors": lambda: vectors.compare(200), "kills": _kills,
    "hour": lambda: endurance.simulate(3600.0), "steps": lambda: endurance.step(1_000_000),
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []])
    parser.add_argument("--out", type=Path, default=Path("out/soak"))
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    file = given.out / "soak.json"
    for name in given.parts or PARTS:
        found = {**PARTS[name](), "python": platform.python_version()}
        known = json.loads(file.read_text()) if file.exists() else {}
        file.write_text(json.dumps({**known, name: found}, indent=1) + "\n")
        print(name, json.dumps(found), flush=True)


if __name__ == "__main__":
    main()
