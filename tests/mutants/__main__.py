"""Do the tests notice? Sixty small wrongs of `mutants.toml`, put into a copy of the tree one at a time.

    python -m tests.mutants --out out/mutants                 all of them: `make mutants`
    python -m tests.mutants --out out/mutants recording       those in files with `recording` in their names

A mutant is killed if one of its tests fails or they take too long, and survives if all pass: quick tests first, then
the slow ones. Results are added to ``results.jsonl`` in the folder, and a mutant that stands there is not run again.
Without a mutant the tests must pass: `make test` says so.
"""

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from .listed import ROOT, Mutant, load

NOTHING_TO_RUN = 5
"""Exit status of pytest when no test was chosen."""
ENDED = {0: "survived", 1: "killed", 2: "killed"}
"""What an exit status means: 1 is a failed test, 2 a module that cannot be imported."""


def copied(folder: Path) -> Path:
    """Copy the files that git tracks from the working tree, links as links."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in filter(None, listed.split("\0")):
        if os.path.lexists(ROOT / name):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name, follow_symlinks=False)
    return folder


def status(tree: Path, tests: tuple[str, ...], chosen: str, limit_s: float) -> int | None:
    """Exit status of pytest in the tree; None if it took longer than the limit."""
    command = [sys.executable, "-m", "pytest", "-x", "-p", "no:xdist", "-p", "no:cacheprovider", "-m", chosen, *tests]
    run = subprocess.Popen(
        command, cwd=tree, env={**os.environ, "PYTHONPATH": str(tree)}, stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    try:
        return run.wait(limit_s)
    except subprocess.TimeoutExpired:
        return None
    finally:
        if run.poll() is None:  # with all that a test has begun
            os.killpg(run.pid, signal.SIGKILL)
            run.wait()


def outcome(tree: Path, mutant: Mutant, limit_s: float) -> str:
    """Put a mutant in, run its tests, take it out again."""
    file = tree / mutant.file
    text = file.read_text(encoding="utf-8")
    assert text.count(mutant.old) == 1, mutant
    file.write_text(text.replace(mutant.old, mutant.new), encoding="utf-8")
    try:
        found = [NOTHING_TO_RUN]
        for chosen in ("not slow", "slow"):
            code = status(tree, mutant.tests, chosen, limit_s)
            if code is None:
                return "killed"
            if code not in (0, NOTHING_TO_RUN):
                return ENDED.get(code, f"pytest ended with {code}")
            found.append(code)
        return ENDED.get(min(found), f"pytest ended with {min(found)}")
    finally:
        file.write_text(text, encoding="utf-8")


def main() -> int:
    parser = argparse.ArgumentParser(description="Put sixty small wrongs into a copy, one at a time.")
    parser.add_argument("names", nargs="*", help="parts of files' names; all mutants if none is named")
    parser.add_argument("--out", type=Path, required=True, help="folder for the results; is made, and gone on with")
    parser.add_argument("--limit", type=float, default=600.0, help="seconds for the tests of one mutant")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    results = arguments.out / "results.jsonl"
    lines = results.read_text(encoding="utf-8").splitlines() if results.exists() else []
    known = {(row["file"], row["old"], row["new"]): row["outcome"] for row in map(json.loads, lines)}
    chosen = [m for m in load() if not arguments.names or any(name in m.file for name in arguments.names)]
    with tempfile.TemporaryDirectory() as folder:
        tree = copied(Path(folder))
        for number, mutant in enumerate(chosen, 1):
            key = mutant.file, mutant.old, mutant.new
            began = time.monotonic()
            if key not in known:
                known[key] = outcome(tree, mutant, arguments.limit)
                took_s = round(time.monotonic() - began, 1)
                row = {**dict(zip(("file", "old", "new"), key, strict=True)), "outcome": known[key], "took_s": took_s}
                with results.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(row) + "\n")
            print(f"{number:2}/{len(chosen)} {known[key]:9} {mutant.file}: {mutant.old} -> {mutant.new}", flush=True)
    ended = Counter(known[m.file, m.old, m.new] for m in chosen)
    print(", ".join(f"{count} {name}" for name, count in sorted(ended.items())))
    return 0 if set(ended) <= {"killed"} else 1


if __name__ == "__main__":
    raise SystemExit(main())
