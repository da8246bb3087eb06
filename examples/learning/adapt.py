"""Adapt to a machine: a bandit that has learned from other machines chooses settings of a law while it cuts.

python examples/learning/adapt.py --machines 16 --out out/adapt
edmsim evaluate edmsim/MaxRateShift-v0 --controllers policy:out/adapt/policy.json,adaptive-hold --seeds 4

The law `adaptive-hold` cuts, and finds out what heat its wires bear. How its servo cuts fastest differs from machine
to machine: on some a wider gap removes the shorts, on others shorts must be accepted. Two settings are enough to see
how a bandit finds out which:

1. `record` cuts on many training machines with each setting in turn, and notes what each segment of 10 s measured.
2. `prior_of` fits what machines have in common: what each setting does, how much that differs from machine to
   machine, how exactly a segment measures it, and how fast it changes.
3. On a new machine the policy tries each setting, updates by Bayes' rule, and uses what cuts fastest: `Watched`
   prints what it expects after every segment.

`edmsim train edmsim/MaxRateShift-v0 --algo bandit` does 1 and 2 with eight settings. Put in yours: parameters of a
law of edmsim. An interrupted recording continues with the same command. Needs no extra.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

from edmsim.envs.episode import Task
from edmsim.evaluation.episode import Episode
from edmsim.learning import bandit
from edmsim.learning.bandit import BanditController, BanditSettings, History
from edmsim.runs import RunTable, perform

ENV_ID, FIRST_SEED, NEW_MACHINE = "edmsim/MaxRateShift-v0", 23_000, 24_000
SETTINGS = BanditSettings(
    law="adaptive-hold:break_weight=1.5",
    settings=[
        {"open_target_share": 0.0, "short_weight": 1.0, "shortest_us": 18.0},  # the law's own
        {"open_target_share": 0.2, "short_weight": 1.0, "shortest_us": 12.5},  # a wider gap
        {"open_target_share": 0.0, "short_weight": 0.15, "shortest_us": 12.5},  # shorts are accepted
    ],
    segment_s=10.0, settle_s=2.0,  # a decision, and its beginning that is not measured
    first_s=5.0, start_s=5.0,  # of the first and of a later wire, before a setting is tried
    trial_s=60.0, trial_bonus=1.0,  # of the test cut: what a deviation would make the best is tried once
    bonus=0.15,  # standard deviations that what is not known counts more
    machines=16, passes=4,
    shrink=0.3,  # of the covariance towards its diagonal, as machines are few
    meter=0.03,  # standard deviation of the measured rate's logarithm
    drift=0.01,  # of a setting's rate per segment, relative to the others
)  # fmt: skip


class Watched(BanditController):
    """The policy, and what it expects after every segment."""

    def choose(self) -> int:
        """Return the setting of the next segment."""
        setting = super().choose()
        lead = 100.0 * (self.belief.net(self.lost_s) - self.belief.net(self.lost_s)[0])
        variance = np.diag(self.belief.covariance)[: len(lead)]
        covariance = self.belief.covariance[0, : len(lead)]
        spread = 100.0 * np.sqrt(np.maximum(variance + variance[0] - 2.0 * covariance, 0.0))
        expected = "  ".join(f"{each:+4.0f} ± {error:2.0f} %" for each, error in zip(lead, spread, strict=True))
        print(f"{self.spent_s:5.0f} s  {expected}  next: {setting}", flush=True)
        return setting


def main() -> None:
    """Record, fit, save, and watch the policy on a new machine."""
    parser = argparse.ArgumentParser(description=f"A policy that adapts to machines of {ENV_ID}.")
    parser.add_argument("--machines", type=int, default=SETTINGS.machines, help="training machines")
    parser.add_argument("--watch", type=float, default=180.0, metavar="S", help="time to cut on a new machine")
    parser.add_argument("--out", type=Path, required=True, help="folder for histories and the policy")
    arguments = parser.parse_args()
    if arguments.machines < 2:
        parser.error(f"--machines {arguments.machines}: what machines have in common shows on 2 or more")
    arguments.out.mkdir(parents=True, exist_ok=True)
    table = RunTable(arguments.out / "histories.jsonl", {"settings": SETTINGS.model_dump()})
    seeds = [FIRST_SEED + k for k in range(arguments.machines)]
    rows = perform(
        lambda seed: bandit.record(ENV_ID, SETTINGS, seed), seeds,
        lambda done, total: print(f"{done} of {total} machines recorded", flush=True),
        table=table, ids=[str(seed) for seed in seeds],
    )  # fmt: skip
    histories = [History(row["rows"], row["lost"], row["cut_s"]) for row in rows]
    steps = sum(len(history.rows) for history in histories)
    prior, command = bandit.prior_of(histories, SETTINGS), "python " + " ".join(sys.argv)
    card = bandit.card_of(ENV_ID, SETTINGS, prior, command, 0, steps)
    bandit.write(card, arguments.out / "policy.json")
    if arguments.watch:
        print("Rate beside that of setting 0, by what the policy knows of a new machine:")
        task = Task(ENV_ID, episode_s=arguments.watch)
        result = Episode(task, Watched(card), NEW_MACHINE, "watched").run()
        print(f"{result.rate_mm2_min:.0f} mm2/min, {result.wires_lost} wires lost")


if __name__ == "__main__":
    main()
