"""What shipped policies and classic controllers are worth at finer resolutions and on other machines: tables.

python docs/make/transfer.py           # that of docs/training.md, and those of docs/tasks
python docs/make/transfer.py Corner    # one of them
"""

from __future__ import annotations

import sys
from pathlib import Path

from tasks import with_block

from edmsim.envs.registry import env_id_of
from edmsim.evaluation.lines import lines_of
from edmsim.evaluation.transfer import rows_of, transfer

DOCS = Path(__file__).parents[1]
CORNER, THIN, TRIM = (lines_of(env_id_of(task)) for task in ("Corner", "ThinWire", "Trim"))
CORNER_LAW = next(name for name in CORNER.compared if "corner_factor" in name)
TABLES = {
    "GapFeed": ("training.md", {name: f"`{name}`" for name in ("policy:GapFeed-ppo", "voltage", "counts")}),
    "Corner": ("tasks/corner.md", {
        "policy:Corner-imitation": "`policy:Corner-imitation`", CORNER_LAW: "longer pauses at corners",
        CORNER.blind: "the best constant",
    }),
    "ThinWire": ("tasks/thin-wire.md", {
        "policy:ThinWire-imitation": "`policy:ThinWire-imitation`", "climb:open_target_share=0.05": "`climb`",
        THIN.compared[1]: "the constant that earns most",
    }),
    "Trim": ("tasks/trim.md", {
        "policy:Trim-ppo": "`policy:Trim-ppo`", TRIM.blind: "the best constant",
        TRIM.compared[1]: "a constant without offset",
    }),
}  # fmt: skip
"""Page and controllers, with their heads, by task."""
CUTS = 12
"""As many as a comparison in GapFeed has."""


def write(task: str) -> None:
    """Make the cuts, and write the table."""
    def watch(done: int, total: int) -> None:
        sys.stderr.write(f"\r{task}: {done} of {total} cuts")

    name, controllers = TABLES[task]
    moved = transfer(env_id_of(task), list(controllers), CUTS, watch=watch)
    rows = [["place", *controllers.values()], ["---"] * (1 + len(controllers)), *rows_of(moved)]
    table = "".join(f"| {' | '.join(row)} |\n" for row in rows)
    page = DOCS / name
    page.write_text(with_block(page.read_text(encoding="utf-8"), "transfer", table), encoding="utf-8")


def main() -> None:
    """Write those asked for, or all."""
    for task in sys.argv[1:] or TABLES:
        write(task)


if __name__ == "__main__":
    main()
