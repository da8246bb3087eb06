"""What a law that knew its machine could win on MaxRate: `python docs/make/heat_margin.py` prints two tables.

They are those of tasks/max-rate.md. Machines are drawn with training seeds. First `heat-flux` cuts some of them with
several margins, from the same for all to the best for each. Then, with its usual margin on more of them, how hot the
wire is beyond what the flux says is explained from what is seen in a cut, and from the constants that nobody sees, by
linear regression with each eighth of the machines predicted from the others.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers import from_text
from edmsim.envs.episode import Task
from edmsim.evaluation.episode import Episode, cut

ENV_ID = "edmsim/MaxRate-v0"
HOLDS = (0.2, 0.25, 0.3, 0.35)
FEW, MANY = range(40), range(200, 360)
"""Seeds of the machines for every margin, and of those for the regression."""
BEGIN_S = 2.0
"""Left out of what is explained: a fresh wire comes to its period slowly."""
FOLDS = 8
BOILING_K = 373.15
CUTS = 1.2
"""Superheats beyond, where the wire has boiled dry, are left out: 1 is where it does."""
Floats = NDArray[np.float64]


def margins() -> None:
    """Print the table of the margins."""
    found = {hold: [cut(ENV_ID, seed, f"heat-flux:hold_share={hold:g}") for seed in FEW] for hold in HOLDS}
    rates = np.array([[result.rate_mm2_min for result in results] for results in found.values()])
    print("| share of the critical heat flux held | mean rate, mm2/min | wires lost in 40 cuts |\n|---|---|---|")
    for results, rate in zip(found.items(), rates, strict=True):
        print(f"| {results[0]:g} | {rate.mean():.1f} | {sum(result.wires_lost for result in results[1])} |")
    print(f"| each machine's best | {rates.max(axis=0).mean():.1f} | |\n")


def seen_and_hidden(seed: int) -> tuple[float, list[float], list[float]]:
    """Return a cut's median superheat, what is seen of it, and the constants that are not."""
    task, law = Task(ENV_ID), from_text("heat-flux")
    episode = Episode(task, law, seed, "heat-flux")
    machine, rows, kelvins = task.scenario.machine, [], []
    outcome = None
    while outcome is None:
        outcome = episode.step()
        assert episode.last is not None
        window, truth = episode.last.seen, episode.last.truth
        if window.time_s > BEGIN_S:
            seen = [window.short, window.open, window.mean_voltage_V, window.mean_current_A, window.mean_delay_us]
            rows.append([*seen, window.duration_s, window.path_um, *window.fifths])
            kelvins.append(truth.wire_temperature_K)
    superheat = (np.median(kelvins) - BOILING_K) / machine.base.cooling.superheat_K.value
    dials = [machine.height_mm, machine.tension, machine.flushing_lower_Pa, machine.flushing_upper_Pa]
    constants = [constant.value for constant in machine.uncertain().values()]
    way_um = rows[-1][6] - rows[0][6]
    return superheat, [*dials, *np.nanmean(rows, axis=0), way_um], constants


def explained(values: Floats, by: Floats) -> float:
    """Return which share of the variance of values (n,) is explained by columns (n, k), of machines not fitted to."""
    spread = by.std(axis=0)
    by = ((by - by.mean(axis=0)) / np.where(spread > 0, spread, 1.0))[:, spread > 0]
    by = np.column_stack([by, np.ones(len(by))])
    predicted, fold = np.empty(len(values)), np.arange(len(values)) % FOLDS
    for k in range(FOLDS):
        known = by[fold != k]
        ridge = known.T @ known + np.eye(known.shape[1])
        predicted[fold == k] = by[fold == k] @ np.linalg.solve(ridge, known.T @ values[fold != k])
    return float(1 - ((values - predicted) ** 2).sum() / ((values - values.mean()) ** 2).sum())


def main() -> None:
    """Print both tables."""
    margins()
    superheat, seen, hidden = (np.array(column) for column in zip(*map(seen_and_hidden, MANY), strict=True))
    whole = superheat < CUTS
    print(f"{whole.sum()} of {len(whole)} machines whose wire did not stay dry: superheat over the one that dries it "
          f"{superheat[whole].mean():.2f}, standard deviation {superheat[whole].std():.2f}\n")
    print("| explained from | share of the variance |\n|---|---|")
    for name, columns in (("dials and what is seen", seen), ("constants that are not seen", hidden)):
        print(f"| {name} | {explained(superheat[whole], columns[whole]):.0%} |")


if __name__ == "__main__":
    main()
