"""Errors near the corner in parts of the best constant's: `python docs/make/corner_errors.py` prints a table.

It is that of tasks/corner.md, from the cuts in leaderboard.json; intervals are of the machines drawn. Machines on
which a controller's wire broke before the corner are left out of all rows.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from edmsim.evaluation import leaderboard
from edmsim.evaluation.compare import ratio
from edmsim.evaluation.lines import lines_of

ENV_ID = "edmsim/Corner-v2"


def main() -> None:
    """Print every controller's error, in um and in parts of the constant's, and its time."""
    results = leaderboard.read(Path(__file__).parents[1] / "leaderboard.json")[ENV_ID].results
    errors_um = {name: np.array([cut.error_um for cut in cuts]) for name, cuts in results.items()}
    there = np.isfinite(list(errors_um.values())).all(axis=0)
    print(f"{there.sum()} of {len(there)} machines")
    errors_um = {name: errors[there] for name, errors in errors_um.items()}
    constant_um = errors_um[lines_of(ENV_ID).blind]
    print("| controller | error, um | in the best constant's | time, s |\n|---|---|---|---|")
    for name in sorted(results, key=lambda name: errors_um[name].mean()):
        share = ratio(errors_um[name], constant_um)
        time_s = np.array([cut.time_s for cut in results[name]])[there].mean()
        print(f"| `{name}` | {errors_um[name].mean():.2f} | {share.value:.2f} ({share.low:.2f} to {share.high:.2f}) "
              f"| {time_s:.1f} |")


if __name__ == "__main__":
    main()
