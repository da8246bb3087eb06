"""The measured parts of ``docs/performance.md``: where a pulse's time goes, and this checkout beside a revision.

python docs/make/performance.py [PAIRS]
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from sections import write_sections
from vector_envs import processor

from edmsim.bench.pairs import PAIRS, Pairs, compare
from edmsim.bench.profile import PARTS, LoopProfile, draw, profile

PAGE = Path(__file__).parents[1] / "performance.md"
FIGURE = PAGE.parent / "figures" / "loop-profile.png"
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
"""Figures of `bench.subject`, and what the page calls them."""


def profile_lines(found: dict[str, LoopProfile]) -> list[str]:
    """Return the table of a pulse's parts."""
    head = " | ".join(f"`{name}`, ns | `{name}`, %" for name in found)
    lines = [f"| part | {head} |", "|---" + "|--:" * 2 * len(found) + "|"]
    for part in PARTS:
        cells = " | ".join(f"{one.ns(part):.0f} | {100 * one.shares[part]:.0f}" for one in found.values())
        lines.append(f"| {part} | {cells} |")
    lines.append("| together | " + " | ".join(f"{one.ns_per_pulse:.0f} | 100" for one in found.values()) + " |")
    slower = " and ".join(f"{one.marked_ns_per_pulse / one.ns_per_pulse:.2f}" for one in found.values())
    looks = " and ".join(f"{one.looks:,}" for one in found.values())
    return [*lines, "", f"On {processor()}; {looks} looks. With marks a pulse took {slower} times as long."]


def pair_lines(found: Pairs, load: tuple[float, ...]) -> list[str]:
    """Return the table of ratios; `load` is how many programs wanted a processor before and after."""
    lines = [f"| per second of the processor | over that at {found.commit[:7]} | 95 % interval |", "|---|--:|--:|"]
    for name, words in NAMES.items():
        ratio = found.ratio(name)
        lines.append(f"| {words} | {ratio.value:.2f} | {ratio.low:.2f} to {ratio.high:.2f} |")
    count = len(found.here[name])
    before, after = (f"{value:.1f}" for value in load)
    return [
        *lines, "",
        f"{count} pairs on {processor()}, with a load average of {before} before and {after} after: this measurement "
        "takes 1.",
    ]


def main() -> None:
    """Measure, and write the page's sections and the figure."""
    shares = profile()
    draw(shares).savefig(FIGURE, metadata={"Software": "edmsim"})
    before = os.getloadavg()[0]
    compared = compare(AGAINST, int(sys.argv[1]) if sys.argv[1:] else PAIRS)
    pairs = pair_lines(compared, (before, os.getloadavg()[0]))
    write_sections(PAGE, {"parts": "\n".join(profile_lines(shares)), "pairs": "\n".join(pairs)})


if __name__ == "__main__":
    main()
