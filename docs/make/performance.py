"""The measured parts of ``docs/performance.md``: the time of a pulse by parts, and this checkout over a revision.

python docs/make/performance.py [PAIRS]
"""

import os
import sys

from sections import DOCS, table, write_sections
from vector_envs import processor

from edmsim.bench.profile import PARTS, LoopProfile, draw, profile
from edmsim.bench.revisions import PAIRS, Pairs, compare

AGAINST = "a80349b"
NAMES = {
    "pulses_per_s_fast": "pulses at `fast`",
    "pulses_per_s_default": "pulses at `default`",
    "pulses_per_s_fine": "pulses at `fine`",
    "mujoco_pulses_per_s": "pulses with MuJoCo, at its usual rate",
    "vector_env_steps_per_s_fast": "windows of 64 environments at `fast`, one thread",
    "vector_env_steps_per_s_fast_threads": "the same by the clock, with a thread for each processor",
    "drawn_resets_per_s": "resets that draw a machine, at `fast`",
}
"""Figures of `bench.workloads`, and their texts on the page."""


def parts(found: dict[str, LoopProfile]) -> str:
    """Return the table of a pulse's parts."""
    heads = [f"`{name}`, {unit}" for name in found for unit in ("ns", "%")]
    rows = [
        [part, *(f"{value:.0f}" for one in found.values() for value in (one.ns(part), 100 * one.shares[part]))]
        for part in PARTS
    ]
    rows.append(["together", *(cell for one in found.values() for cell in (f"{one.ns_per_pulse:.0f}", "100"))])
    slower = " and ".join(f"{one.marked_ns_per_pulse / one.ns_per_pulse:.2f}" for one in found.values())
    looks = " and ".join(f"{one.looks:,}" for one in found.values())
    made = table(["part", *heads], rows, numbers=len(heads))
    return (
        f"{made}\n\nOn {processor()}; {looks} samples. In the loop compiled for sampling a pulse took {slower} "
        "times as long."
    )


def pairs(found: Pairs, load: tuple[float, ...]) -> str:
    """Return the table of ratios; `load` is the load average before and after."""
    heads = "per second of the processor", f"over that at {found.commit[:7]}", "95 % interval"
    ratios = [(words, found.ratio(name)) for name, words in NAMES.items()]
    rows = [(words, f"{one.value:.2f}", f"{one.low:.2f} to {one.high:.2f}") for words, one in ratios]
    count = len(next(iter(found.here.values())))
    before, after = (f"{value:.1f}" for value in load)
    return (
        f"{table(heads, rows, numbers=2)}\n\n{count} pairs on {processor()}, "
        f"with a load average of {before} before and {after} after; the measurement itself accounts for 1."
    )


def main() -> None:
    """Measure, and write the page's sections and the figure."""
    shares = profile()
    draw(shares).savefig(DOCS / "figures" / "loop-profile.png", metadata={"Software": "edmsim"})
    before = os.getloadavg()[0]
    compared = compare(AGAINST, int(sys.argv[1]) if sys.argv[1:] else PAIRS)
    load = before, os.getloadavg()[0]
    write_sections("performance.md", {"parts": parts(shares), "pairs": pairs(compared, load)})


if __name__ == "__main__":
    main()
