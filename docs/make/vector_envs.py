"""Windows per second of the vector environment, by numbers of environments and threads, for docs/environments.md.

python docs/make/vector_envs.py
"""

import os
import platform
import re
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from sections import table, write_sections

from edmsim.bench.figures import half_cheetah_comparison, settled
from edmsim.bench.workloads import fleet, spent_s

COUNTS, THREADS = (1, 4, 16, 64, 256), (1, 2)
"""Numbers of environments and threads of the table."""
ROUNDS = 8
"""Timed spells of every row of the table, by turns, because other programs use the machine, too."""


class VectorRate(NamedTuple):
    """One row: windows per second of all environments together, and processor time of one window in us."""

    environments: int
    threads: int
    windows_per_s: float
    processor_us: float


def rates(counts: Sequence[int] = COUNTS, threads: Sequence[int] = THREADS) -> list[VectorRate]:
    """Return the rates of straight cuts at ``fast``."""
    kinds = [(count, many) for count in counts for many in threads]
    best_s, processor_best_s = np.full(len(kinds), np.inf), np.full(len(kinds), np.inf)
    steps = [fleet(count, 0, many) for count, many in kinds]
    spells = [settled(step) for step in steps]
    for _ in range(ROUNDS):
        for k, (step, spell) in enumerate(zip(steps, spells, strict=True)):
            start_s = time.process_time()
            best_s[k] = min(best_s[k], spent_s(step, spell, time.perf_counter) / spell)
            processor_best_s[k] = min(processor_best_s[k], (time.process_time() - start_s) / spell)
    return [
        VectorRate(count, many, count / float(wall), 1e6 * float(processor) / count)
        for (count, many), wall, processor in zip(kinds, best_s, processor_best_s, strict=True)
    ]


def processor() -> str:
    """Return the number and name of the system's processors."""
    info = Path("/proc/cpuinfo")
    named = re.search(r"model name\s*: (.+)", info.read_text()) if info.exists() else None
    return f"{os.cpu_count()} processors, {named[1] if named else platform.processor() or platform.machine()}"


def section(rows: list[VectorRate], comparison: dict[str, float]) -> str:
    """Return the table, and the sentences below it."""
    most = max(row.environments for row in rows)
    heads = "environments", "threads", "windows per s", "processor time of a window, us"
    cells = [(f"{n}", f"{threads}", f"{per_s:,.0f}", f"{us:.0f}") for n, threads, per_s, us in rows]
    ours, theirs = comparison.values()
    alone, many = (next(r.processor_us for r in rows if r.environments == n and r.threads == 1) for n in (1, most))
    return (
        f"{table(heads, cells, numbers=4)}\n\n"
        f"On {processor()}. A window of one environment takes {alone / many:.1f} times the processor time of one of "
        f"{most}, because the environments of a step share the time that Python takes. 64 environments with all "
        f"processors made {ours / theirs:.2f} times the steps per second of 64 HalfCheetah-v5, timed in turns."
    )


def main() -> None:
    """Measure, and write the page's section."""
    write_sections("environments.md", {"vector environments": section(rates(), half_cheetah_comparison())})


if __name__ == "__main__":
    main()
