"""Windows per second of the vector environment by numbers of environments and threads, for docs/environments.md.

python docs/make/vector_envs.py
"""

from __future__ import annotations

import os
import platform
import re
from pathlib import Path

from sections import write_sections

from edmsim.bench.envs import VectorRate, half_cheetah_comparison, table

PAGE = Path(__file__).parents[1] / "environments.md"


def processor() -> str:
    """Return what the system calls its processors, and how many there are."""
    info = Path("/proc/cpuinfo")
    named = re.search(r"model name\s*: (.+)", info.read_text()) if info.exists() else None
    return f"{os.cpu_count()} processors, {named[1] if named else platform.processor() or platform.machine()}"


def lines(rows: list[VectorRate], comparison: dict[str, float]) -> list[str]:
    """Return the table, and the sentence below it."""
    most = max(row.environments for row in rows)
    head = "| environments | threads | windows per s | processor time of a window, us |\n|--:|--:|--:|--:|"
    body = [f"| {r.environments} | {r.threads} | {r.windows_per_s:,.0f} | {r.processor_us:.0f} |" for r in rows]
    ours, theirs = comparison.values()
    alone, many = (next(r.processor_us for r in rows if r.environments == n and r.threads == 1) for n in (1, most))
    return [
        head, *body, "",
        f"On {processor()}. A window of one environment costs {alone / many:.1f} times one of {most}: Python's "
        f"share, which they divide. 64 environments with all processors made {ours / theirs:.2f} times the steps per "
        "second of 64 HalfCheetah-v5, timed in turns.",
    ]


def main() -> None:
    """Measure, and write the page's section."""
    write_sections(PAGE, {"vector environments": "\n".join(lines(table(), half_cheetah_comparison()))})


if __name__ == "__main__":
    main()
