"""Adapt to a machine: a bandit that has learned from other machines chooses the settings of a law.

python examples/learning/adapt.py --machines 32 --seed 1 --out out/adapt
edmsim evaluate edmsim/MaxRateShift-v0 --controllers policy:out/adapt/policy.json,adaptive-hold --seeds 12

The law `adaptive-hold` cuts, and finds out what heat its wires bear. How its servo cuts fastest differs from machine
to machine: on some a wider gap removes the shorts, on others shorts must be accepted. Two steps:

1. `record` cuts four minutes on each of many training machines. Every 10 s another of `SETTINGS` follows, in random
   order; for each, the area cut and the shares of opens and shorts are saved.
2. `prior_of` fits what machines have in common: mean and covariance, over machines, of what each setting does; how
   exactly a segment measures it; and how fast it changes.

A machine does not know the area that it cuts: the policy measures its rate by the feed and by the local height, which
follows from where pulses ignite. On a new machine it tries each setting in the test cut, updates by Bayes' rule, and
from then on uses the setting with the largest expected rate. It tries another again where drift may have made it
better. Basu et al., "No Regrets for Learning the Prior in Bandits" (NeurIPS 2021), learn a bandit's prior in a
similar way. The first step takes nearly all the time, and can be interrupted and resumed. Needs no extra.
"""

from __future__ import annotations

import argparse
import math
from importlib.metadata import version
from pathlib import Path

import numpy as np

from edmsim.envs.episode import Task
from edmsim.evaluation.episode import Episode
from edmsim.learning import bandit_file
from edmsim.learning.bandit_controller import BanditController
from edmsim.learning.bandit_file import BanditCard, Segment

ENV_ID, FIRST_SEED = "edmsim/MaxRateShift-v0", 21_000
LAW = "adaptive-hold:break_weight=1.5"
PARAMETERS = "open_target_share", "short_weight", "shortest_us", "proportional_um_s"
SETTINGS = [
    dict(zip(PARAMETERS, values, strict=True))
    for values in (
        (0.0, 1.0, 18.0, 30.0),  # the law's own
        (0.1, 1.0, 12.5, 30.0),
        (0.2, 1.0, 12.5, 120.0),
        (0.3, 1.0, 12.5, 120.0),
        (0.0, 0.5, 12.5, 30.0),
        (0.0, 0.15, 12.5, 30.0),
    )
]
COUNT = len(SETTINGS)
SEGMENT_S, SETTLE_S, START_S, TRIAL_S = 10.0, 2.0, 5.0, 60.0
PASSES = 4  # of every setting on a training machine
BONUS = 0.15  # ours: little is tried again after the test cut
SHRINK = 0.3  # of the covariance towards its diagonal, as machines are few (ours)
METER = 0.03  # deviation of the measured rate's logarithm from the true one's (ours, on these machines)
DRIFT = 0.01  # of a setting's rate, relative to the others, per segment (ours)


def card_of(mean, covariance, noise, offset_drift, **about) -> BanditCard:
    """Return a policy with these settings and times."""
    return BanditCard(
        format=bandit_file.FORMAT, env_id=ENV_ID, environment={}, law=LAW, settings=SETTINGS, segment_s=SEGMENT_S,
        settle_s=SETTLE_S, start_s=START_S, trial_s=TRIAL_S, bonus=BONUS,
        mean=list(mean), covariance=[list(row) for row in covariance], noise=list(noise), offset_drift=offset_drift,
        drift=DRIFT, algorithm="bandit", **about, versions={name: version(name) for name in ("edmsim", "numpy")},
    )  # fmt: skip


# 1. histories of training machines


class Trier(BanditController):
    """Tries all settings in random order, and writes down what each segment measured."""

    def __init__(self, seed: int) -> None:
        size = 3 * COUNT
        about = {"command": "", "seed": seed, "steps": 0}
        super().__init__(card_of(np.zeros(size), np.eye(size), np.ones(3), 0.1, **about))
        self.rows: list[list[float]] = []
        self._random, self._order = np.random.default_rng(seed), []

    @property
    def measures(self) -> bool:
        """Whether the present segment's measurement has begun."""
        return self.seconds > 0.0

    def learn(self, measured: Segment) -> None:
        """Write down setting, opens and shorts."""
        self.rows.append([self.setting, measured.open, measured.short])

    def choose(self) -> int:
        """Return the next setting; each comes once before one comes again."""
        self._order = self._order or list(self._random.permutation(COUNT))
        return int(self._order.pop())


def record(seed: int, segments: int, file: Path) -> None:
    """Cut a training machine, and save its segments (n, 5): what `Trier` writes down, then seconds and area."""
    task, trier = Task(ENV_ID, test_s=0.0), Trier(seed)
    episode, rows, outcome, seconds, area = Episode(task, trier, seed, "trier"), [], None, 0.0, 0.0
    while outcome is None and len(rows) < segments:
        before = trier.measures
        outcome = episode.step()
        if before or trier.measures:
            seconds += episode.last.observation.duration_s
            area += episode.last.area_mm2
        if len(trier.rows) > len(rows):
            rows.append([*trier.rows[-1], seconds, area])
        if not trier.measures:  # a segment or a wire has ended
            seconds = area = 0.0
    np.save(file, np.array(rows, np.float32))


# 2. what machines have in common


def effects(values: np.ndarray, setting: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what each setting (k,) and each pass (p,) adds to values (n,), and what is left (n,)."""
    passes = np.arange(len(values)) // COUNT
    design = np.concatenate([np.eye(COUNT)[setting], np.eye(passes[-1] + 1)[passes]], axis=1)
    found = np.linalg.lstsq(design, values, rcond=None)[0]
    offset = found[COUNT:].mean()
    return found[:COUNT] + offset, found[COUNT:] - offset, values - design @ found


def prior_of(histories: list[np.ndarray], **about) -> BanditCard:
    """Return the policy whose prior fits these machines."""
    machines, left, moved = [], [], []
    for rows in histories:
        setting = rows[:, 0].astype(int)
        log_rate = np.log(rows[:, 4] / rows[:, 3])
        found = [effects(values, setting) for values in (log_rate, rows[:, 1], rows[:, 2])]
        rates = found[0][0] - found[0][0].mean()  # relative to the machine's others
        machines.append(np.concatenate([rates, found[1][0], found[2][0]]))
        freedom = len(rows) - len(found[0][0]) - len(found[0][1]) + 1
        left.append([(each[2] ** 2).sum() / freedom for each in found])
        moved.append(np.diff(found[0][1]))
    noise = np.sqrt(np.mean(left, axis=0) + np.array([METER**2, 0.0, 0.0]))
    covariance = np.cov(np.array(machines).T)
    covariance = (1.0 - SHRINK) * covariance + SHRINK * np.diag(np.diag(covariance))
    drift = math.sqrt(float(np.mean(np.concatenate(moved) ** 2)) / COUNT)
    return card_of(np.mean(machines, axis=0), covariance, noise, drift, **about)


def described(card: BanditCard) -> str:
    """Return how the settings differ on training machines, in a few lines."""
    deviations = np.sqrt(np.diag(np.array(card.covariance)))
    rows = [f"{'setting':60s} rate, %     opens, %  shorts, %"]
    for k, setting in enumerate(SETTINGS):
        text = ",".join(f"{name}={value:g}" for name, value in setting.items())
        shares = (f"{100 * card.mean[k + part]:8.0f}" for part in (COUNT, 2 * COUNT))
        rows.append(f"{text:75s} {100 * card.mean[k]:+4.0f} +- {100 * deviations[k]:2.0f} {'  '.join(shares)}")
    return "\n".join(rows)


def main() -> None:
    """Record what is missing, fit, save."""
    parser = argparse.ArgumentParser(description="A policy that adapts to machines of edmsim/MaxRateShift-v0.")
    parser.add_argument("--machines", type=int, default=32, help="training machines")
    parser.add_argument("--seed", type=int, default=1, help="added to the number of the first training machine")
    parser.add_argument("--out", type=Path, required=True, help="folder for histories and the policy")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    first = FIRST_SEED + arguments.seed - 1
    files = [arguments.out / f"{first + k}.npy" for k in range(arguments.machines)]
    for k, file in enumerate(files):
        if not file.exists():
            record(first + k, PASSES * COUNT, file)
            print(f"{k + 1} of {len(files)} machines recorded", flush=True)
    histories = [np.load(file).astype(float) for file in files]
    histories = [rows[np.isfinite(rows).all(axis=1) & (rows[:, 4] > 0)] for rows in histories]
    command = f"python examples/learning/adapt.py --machines {arguments.machines} --seed {arguments.seed}"
    card = prior_of(histories, command=command, seed=arguments.seed, steps=sum(map(len, histories)))
    bandit_file.write(card, arguments.out / "policy.json")
    print(described(card))


if __name__ == "__main__":
    main()
