"""The table of docs/training.md on finer resolutions, and machines beyond the ranges of the training.

python docs/make/transfer.py    # 12 cuts of every controller in every place
"""

from __future__ import annotations

import re
from pathlib import Path

from edmsim.evaluation.transfer import rows_of, transfer

PAGE = Path(__file__).parents[1] / "training.md"
ENV_ID, CUTS = "edmsim/GapFeed-v1", 12
CONTROLLERS = "policy:GapFeed-ppo", "voltage", "counts"
_TABLE = re.compile(r"(?<=<!-- transfer -->\n).*?(?=<!-- /transfer -->)", re.DOTALL)


def table() -> str:
    """Make the cuts, and return the table."""
    heads = ("place", *(f"`{name}`" for name in CONTROLLERS))
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    lines += [f"| {' | '.join(cells)} |" for cells in rows_of(transfer(ENV_ID, CONTROLLERS, CUTS))]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Write the table into its page."""
    found = table()
    PAGE.write_text(_TABLE.sub(lambda _: found, PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
