"""Pictures and tables of docs/tasks, the pages of the environments.

python docs/make/tasks.py             # tables of reference lines, from docs/leaderboard.jsonl
python docs/make/tasks.py pictures    # also the output of render() in each task

A picture is taken after a servo has cut for some time, on the machine of seed 1.
"""

import argparse

import gymnasium
import numpy as np
from PIL import Image
from sections import DOCS, table, write_sections

import edmsim  # noqa: F401 - registers the environments
from edmsim.envs.registry import env_id_of
from edmsim.evaluation.compare import Comparison, leaderboard, ranked, shown
from edmsim.evaluation.episode import is_part, lines_of

PAGES = {
    "GapFeed": "gap-feed", "HeightStep": "height-step", "Corner": "corner", "Contour": "contour",
    "MaxRate": "max-rate", "ThinWire": "thin-wire", "Trim": "trim", "Part": "part",
    "MaxRateShift": "max-rate-shift", "ThinWireShift": "thin-wire-shift",
}  # fmt: skip
TAKEN_S = {
    "GapFeed": 20.0, "HeightStep": 20.0, "Corner": 15.0, "Contour": 25.0, "MaxRate": 15.0, "ThinWire": 30.0,
    "Trim": 8.0, "Part": 1800.0, "MaxRateShift": 60.0, "ThinWireShift": 60.0,
}  # fmt: skip
"""Latest machine time at which a picture is taken."""
FURTHER = {
    "Corner": (0.0, 0.0, 0.0), "MaxRate": (1.0,), "ThinWire": (0.0,), "Trim": (0.0, 0.0, 0.0),
    "Part": (0.0, 0.0, 0.0), "MaxRateShift": (0.0,), "ThinWireShift": (-0.5,),
}  # fmt: skip
"""Actions for knobs and offset of a task; MaxRate's wire would break at its first period."""
FIRST = {"Trim": 0.4, "Part": 0.0}
"""Entry 0 of the action if not the middle of a servo's targets: a feed of 80 um/s, or the technology's value."""
COLUMNS = {"score": "score", "rate_mm2_min": "net rate, mm2/min", "total_return": "return"}
OF_PARTS = {
    "score": "score", "total_return": "return", "time_s": "s", "edge_error_um": "error, um", "ra_um": "Ra, um",
}  # fmt: skip
"""Columns of Part; the last three are of finished parts."""


def lines(comparison: Comparison) -> str:
    """Return the table of the reference lines, laws and policies of a task, with the best score first."""
    references = lines_of(comparison.env_id)
    ends = {references.reference: "the reference", references.blind: "score 0"}
    shows = OF_PARTS if is_part(comparison.env_id) else COLUMNS
    rows = []
    for name in ranked(comparison):
        figures, cuts = comparison.figures[name], comparison.results[name]
        cells = [shown(column, figures[column]) for column in shows]
        lost = f"{sum(cut.wires_lost for cut in cuts)}, {sum(cut.jammed for cut in cuts)}"
        label = f"`{name}`, {ends[name]}" if name in ends else f"`{name}`"
        rows.append((label, *cells, lost))
    said = f"{len(comparison.seeds)} cuts on machines of held-back seeds, at `{comparison.resolution}`."
    return f"{table(('controller', *shows.values(), 'wires lost, jams'), rows)}\n\n{said}"


def photograph(name: str) -> None:
    """Cut, and write the picture."""
    served = {} if name in FIRST else {"action": "servo"}
    env = gymnasium.make(env_id_of(name), render_mode="rgb_array", **served)
    _, info = env.reset(seed=1)
    action, over = np.array([FIRST.get(name, 0.0), *FURTHER.get(name, ())], np.float32), False
    while not over and info["time_s"] < TAKEN_S[name]:
        *_, terminated, truncated, info = env.step(action)
        over = terminated or truncated
    picture = Image.fromarray(np.asarray(env.render()))
    picture.save(DOCS / "tasks" / f"{PAGES[name]}.png", optimize=True)


def main() -> None:
    """Write the tables, and the pictures if they are requested."""
    parser = argparse.ArgumentParser(description="Write tables and pictures of docs/tasks.")
    parser.add_argument("what", nargs="?", choices=["pictures"], help="the pictures, too")
    pictures = parser.parse_args().what is not None
    board = leaderboard(DOCS / "leaderboard.jsonl")
    for name, page in PAGES.items():
        write_sections(f"tasks/{page}.md", {"lines": lines(board[env_id_of(name), "fast"])})
        if pictures:
            photograph(name)


if __name__ == "__main__":
    main()
