"""What controllers earn in whole shifts on training machines, beside the first of them.

python docs/make/training_shifts.py MaxRateShift 22200 16 adaptive-hold policy:MaxRateShift-adapt
python docs/make/training_shifts.py ThinWireShift 23000 12 climb:open_target_share=0.05 adaptive-hold:limit_share=0.2

The numbers are the first seed and how many there are; laws are tried here, so that the held-back machines remain for
the comparison. A shift takes some 15 s of a processor; shifts are noted in ``out/shifts`` and not cut again.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from edmsim.envs.registry import env_id_of
from edmsim.evaluation.compare import ratio
from edmsim.evaluation.episode import HELD_BACK, cut
from edmsim.runs import RunTable, perform

FOUND = Path("out/shifts")


def main() -> None:
    """Cut the shifts that are missing, and print returns and lost wires."""
    parser = argparse.ArgumentParser(description="Compare controllers in shifts on training machines.")
    parser.add_argument("task", choices=("MaxRateShift", "ThinWireShift"))
    parser.add_argument("first", type=int, help="seed of the first machine")
    parser.add_argument("machines", type=int)
    parser.add_argument("controllers", nargs="+")
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.machines)
    if seeds[-1] >= HELD_BACK:
        parser.error(f"seeds from {HELD_BACK} on are held back for the comparison")

    def shift(job: tuple[str, int]) -> dict[str, Any]:
        result = cut(env_id_of(options.task), job[1], job[0])
        return {"return": result.total_return, "lost": result.wires_lost}

    FOUND.mkdir(parents=True, exist_ok=True)
    jobs = [(name, seed) for name in options.controllers for seed in seeds]
    rows = perform(
        shift, jobs, lambda done, all_: print(done, "of", all_, flush=True),
        table=RunTable(FOUND / f"{options.task}.jsonl"), ids=[f"{name} {seed}" for name, seed in jobs],
    )  # fmt: skip
    returns = np.array([row["return"] for row in rows]).reshape(-1, len(seeds))
    lost = np.array([row["lost"] for row in rows]).reshape(-1, len(seeds)).sum(axis=1)
    for name, gained, wires in zip(options.controllers, returns, lost, strict=True):
        share = ratio(100 * gained, returns[0])
        print(f"{share.value:.0f} ({share.low:.0f} to {share.high:.0f}) %, {wires} wires lost: {name}")


if __name__ == "__main__":
    main()
