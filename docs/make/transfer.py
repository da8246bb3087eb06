"""What the shipped policy and two laws are worth at finer resolutions and on other machines.

python docs/make/transfer.py    # writes the table of docs/training.md
"""

from __future__ import annotations

import sys
from pathlib import Path

from sections import write_sections

from edmsim.evaluation.transfer import rows_of, transfer

PAGE = Path(__file__).parents[1] / "training.md"
ENV_ID = "edmsim/GapFeed-v2"
CONTROLLERS = ("policy:GapFeed-ppo", "delay", "counts")
CUTS = 12
"""As many as a comparison in GapFeed has."""


def main() -> None:
    """Make the cuts, and write the table."""
    def watch(done: int, total: int) -> None:
        sys.stderr.write(f"\r{done} of {total} cuts")

    moved = transfer(ENV_ID, list(CONTROLLERS), CUTS, watch=watch)
    heads = [f"`{name}`" for name in CONTROLLERS]
    rows = [["place", *heads], ["---"] * (1 + len(heads)), *rows_of(moved)]
    write_sections(PAGE, {"transfer": "\n".join(f"| {' | '.join(row)} |" for row in rows)})


if __name__ == "__main__":
    main()
