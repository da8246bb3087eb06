"""Tables of tasks/corner.md: errors near the corner, relative to the best constant's, and their places.

python docs/make/corner_errors.py           # errors, from the cuts in leaderboard.jsonl; intervals over the machines
python docs/make/corner_errors.py where     # also their places, for which some cuts are made again

Machines on which any controller's wire broke before the corner are omitted from all rows.
"""

import argparse
from itertools import pairwise

import numpy as np
from headroom import shown
from numpy.typing import NDArray
from sections import DOCS, table, write_sections

from edmsim.controllers import from_text
from edmsim.envs.episode import Task
from edmsim.evaluation.compare import held_back, leaderboard, mean, ratio
from edmsim.evaluation.episode import Episode, lines_of

ENV_ID, POLICY = "edmsim/Corner-v3", "policy:Corner-lag"
MACHINES = 16  # held-back machines whose cuts are made again
EDGES_UM = (-100.0, 0.0, 20.0, 60.0, 100.0)  # places of the guides after the corner


def errors() -> str:
    """Return the table of every controller's error, in um and relative to the constant's, time and return."""
    results = leaderboard(DOCS / "leaderboard.jsonl")[ENV_ID, "fast"].results
    errors_um = {name: np.array([cut.error_um for cut in cuts]) for name, cuts in results.items()}
    there = np.isfinite(list(errors_um.values())).all(axis=0)
    constant_um = errors_um[lines_of(ENV_ID).blind][there]
    rows = []
    for name in sorted(results, key=lambda name: float(errors_um[name][there].mean())):
        found_um = errors_um[name][there]
        share = ratio(found_um, constant_um)
        time_s = np.array([cut.time_s for cut in results[name]])[there].mean()
        mean_return = np.array([cut.total_return for cut in results[name]])[there].mean()
        rows.append((f"`{name}`", f"{found_um.mean():.2f}", shown(share, 2), f"{time_s:.1f}", f"{mean_return:.0f}"))
    heads = "controller", "error, um", "in the best constant's", "time, s", "return"
    return f"{table(heads, rows)}\n\n{there.sum()} of {len(there)} held-back machines."


def squares(name: str, seed: int) -> NDArray[np.float64]:
    """Return parts of a cut's mean square error in um2: between `EDGES_UM`, and of the guides alone.

    The error of the guides is the distance from the path of the position commanded by the motors' steps.
    """
    task = Task(ENV_ID)
    episode = Episode(task, from_text(name), seed, name)
    start, corner, end = task.scenario.legs_um[0]
    leg_um = float(np.hypot(*(corner - start)))
    found: list[tuple[float, float, float, float]] = []
    for window in episode.windows():
        if not window.near or not window.progress_um:
            continue
        first, second = (corner, end) if task.path_um >= leg_um else (start, corner)
        along, off = second - first, np.array(task.plant.commanded_um) - first
        across_um = float(along[0] * off[1] - along[1] * off[0]) / float(np.hypot(*along))
        found.append((task.path_um - leg_um, window.error_um, across_um, window.progress_um))
    place_um, error_um, across_um, cut_um = np.array(found).reshape(-1, 4).T
    parts = [
        (cut_um * error_um**2)[(place_um >= low) & (place_um < high)].sum()
        for low, high in pairwise(EDGES_UM)
    ]
    return np.array([*parts, (cut_um * across_um**2).sum()]) / (cut_um.sum() or np.nan)


def where() -> str:
    """Return the table of the errors' places for the constant, the policy and the reference."""
    lines = lines_of(ENV_ID)
    places = [f"{low:g} to {high:g} um" for low, high in pairwise(EDGES_UM)]
    names, rows = (lines.blind, POLICY, lines.reference), []
    found = np.array([[squares(name, seed) for seed in held_back(MACHINES)] for name in names])
    there = np.isfinite(found).all(axis=(0, 2))
    for name, parts in zip(names, found[:, there], strict=True):
        cells = np.insert(parts, -1, parts[:, :-1].sum(axis=1), axis=1)
        rows.append([f"`{name}`", *(shown(mean(column), 2) for column in cells.T)])
    machines = f"{there.sum()} of {MACHINES} held-back machines"
    said = f"Mean squares in um2 on {machines}, by the place of the guides behind the corner."
    return f"{table(('controller', *places, 'sum', 'motor steps alone'), rows)}\n\n{said}"


def main() -> None:
    """Write the tables into the page."""
    parser = argparse.ArgumentParser(description="Errors near the corner.")
    parser.add_argument("what", nargs="?", choices=["where"], help="where they arise, too")
    tables = {"errors": errors()}
    if parser.parse_args().what:
        tables["where"] = where()
    write_sections("tasks/corner.md", tables)


if __name__ == "__main__":
    main()
