"""Measure the time of a first cut with an empty cache, and write the table of ``docs/performance.md``.

python docs/make/compile_time.py [RUNS]
"""

import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median

from sections import DOCS, table, write_sections
from vector_envs import processor

LINE = "G21 G90\nG0 X0 Y0\nG1 X0.5 F5\nM2\n"
CUT = [sys.executable, "-m", "edmsim", "cut", "one.ngc", "--height", "3", "--resolution", "fast"]
STEP = "import gymnasium, edmsim.envs; env = gymnasium.make('edmsim/GapFeed-v2'); env.reset(seed=0); env.step([0.0])"
MEASURED = {
    "first cut": [*CUT, "--out", "first"],
    "then a first environment, reset and one step": [sys.executable, "-c", STEP],
    "the environment again": [sys.executable, "-c", STEP],
    "then another resolution": [*CUT[:-1], "default", "--out", "second"],
    "the first cut again": [*CUT, "--out", "again"],
}


def once() -> dict[str, float]:
    """Return the processor times in s of the processes and their children, run in this order from an empty cache."""
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "one.ngc").write_text(LINE, encoding="utf-8")
        surroundings = os.environ | {"XDG_CACHE_HOME": str(Path(folder) / "cache"), "PYTHONPATH": str(DOCS.parent)}
        surroundings.pop("PYTHONDONTWRITEBYTECODE", None)  # an installation has bytecode, too
        for name, command in MEASURED.items():
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            subprocess.run(command, cwd=folder, env=surroundings, check=True, capture_output=True)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            found[name] = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return found


def main() -> None:
    """Measure, and write the table."""
    runs = [once() for _ in range(int(sys.argv[1]) if sys.argv[1:] else 3)]
    rows = [(name, f"{median(run[name] for run in runs):.1f} s") for name in MEASURED]
    times = table(("process", "processor time"), rows, numbers=1)
    write_sections("performance.md", {"compile time": f"{times}\n\nMedians of {len(runs)} runs on {processor()}."})


if __name__ == "__main__":
    main()
