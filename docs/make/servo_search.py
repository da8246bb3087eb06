"""Settings of the servo of `adaptive-hold` on training machines: which cut fastest, and how much that differs.

python docs/make/servo_search.py --machines 32     # out/servo: some 18 h of machine time, an hour of one processor

Every machine is cut twice with all settings in random order, 9 s each: the law's own, single changes of it, those of
an earlier policy, and random combinations. The rate of a segment counts over the median of those around it in time,
as workpieces, water and the law's own adaptation change it. Interrupted, the same command goes on.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from edmsim.controllers import from_text
from edmsim.controllers.feed.law import ServoLaw
from edmsim.controllers.protocols import FeedCommand, WindowObservation, tell
from edmsim.envs.episode import Task
from edmsim.evaluation.episode import Episode
from edmsim.machine.machine import Machine
from edmsim.runs import RunTable, perform
from edmsim.snapshots import Snapshots

ENV_ID, LAW, FIRST_SEED, PASSES = "edmsim/MaxRateShift-v0", "adaptive-hold", 21_002, 2
FIRST_S, START_S, SEGMENT_S, SETTLE_S = 30.0, 5.0, 9.0, 2.0
"""Cutting time with the law's own setting at first, and of a new wire; of a segment; its beginning, which is left
out."""
AROUND = 8  # segments before and after one that its rate is compared with
OWN = {
    "open_target_share": 0.0, "short_weight": 1.0, "proportional_um_s": 30.0, "integral_um_s2": 100.0,
    "filter_s": 0.05, "patience_s": 0.15, "retract_feed_um_s": 80.0, "integral_share": 0.5, "recovery_s": 0.5,
    "shortest_us": 18.0, "proportional_share": 0.6, "integral_per_s": 4.0,
}  # fmt: skip
SINGLE = {
    "open_target_share": (0.1, 0.2, 0.3), "short_weight": (0.15, 0.5, 2.0),
    "proportional_um_s": (10.0, 60.0, 120.0, 250.0), "integral_um_s2": (30.0, 200.0, 400.0), "filter_s": (0.02, 0.1),
    "patience_s": (0.04, 0.4), "retract_feed_um_s": (40.0, 160.0), "integral_share": (0.25, 0.8, 1.0),
    "recovery_s": (0.2, 1.0), "shortest_us": (16.0, 14.0, 12.5), "proportional_share": (0.3, 1.0),
    "integral_per_s": (2.0, 8.0),
}  # fmt: skip
BEFORE = (
    {"open_target_share": 0.1, "shortest_us": 12.5},
    {"open_target_share": 0.2, "shortest_us": 12.5, "proportional_um_s": 120.0},
    {"open_target_share": 0.3, "shortest_us": 12.5, "proportional_um_s": 120.0},
    {"short_weight": 0.5, "shortest_us": 12.5}, {"short_weight": 0.15, "shortest_us": 12.5},
)  # fmt: skip
"""Settings of an earlier policy."""
DRAWN = {
    "open_target_share": (0.0, 0.0, 0.05, 0.1, 0.2, 0.3), "short_weight": (0.15, 0.3, 0.5, 1.0, 1.0, 2.0),
    "proportional_um_s": (10.0, 30.0, 60.0, 120.0, 250.0), "integral_um_s2": (30.0, 60.0, 100.0, 200.0, 400.0),
    "filter_s": (0.02, 0.05, 0.05, 0.1), "patience_s": (0.04, 0.08, 0.15, 0.4),
    "retract_feed_um_s": (40.0, 80.0, 160.0), "integral_share": (0.25, 0.5, 0.5, 0.8, 1.0),
    "recovery_s": (0.2, 0.5, 0.5, 1.0), "shortest_us": (18.0, 18.0, 18.0, 15.5, 12.5),
    "proportional_share": (0.3, 0.6, 1.0), "integral_per_s": (2.0, 4.0, 8.0),
}  # fmt: skip
COMBINATIONS = 66


def settings() -> list[dict[str, float]]:
    """Return the settings: the law's own four times, single changes, earlier ones, random combinations."""
    rng = np.random.default_rng(7)
    single = [{**OWN, name: value} for name, values in SINGLE.items() for value in values]
    drawn = [{name: float(rng.choice(values)) for name, values in DRAWN.items()} for _ in range(COMBINATIONS)]
    return [OWN] * 4 + single + [{**OWN, **setting} for setting in BEFORE] + drawn


SETTINGS = settings()


class Recorder(Snapshots):
    """Cuts with the law, and changes its setting every few seconds; a lost wire ends a segment."""

    name: ClassVar[str] = "recorder"
    STATE: ClassVar[tuple[str, ...]] = ("law", "left", "setting", "clock_s", "lost")

    def __init__(self, seed: int) -> None:
        law = from_text(LAW)
        assert isinstance(law, ServoLaw)
        self.law = law
        self.left = np.random.default_rng(seed).permutation(len(SETTINGS)).tolist()
        self.setting, self.clock_s, self.lost = int(self.left.pop()), -FIRST_S, [0] * len(SETTINGS)

    @property
    def measures(self) -> bool:
        """Whether the last window counts."""
        return self.clock_s > SETTLE_S

    def set_up(self, machine: Machine, points_um: Any, start_um: float) -> None:
        """Set the machine and the path."""
        tell(self.law, machine, points_um, start_um)

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin the cut."""
        return self.law.reset(max_feed_um_s)

    def wire_lost(self) -> FeedCommand:
        """Begin the next wire, then the same setting again."""
        self.lost[self.setting] += self.clock_s >= 0.0
        self.clock_s = -START_S
        return self.law.wire_lost()

    def update(self, window: WindowObservation) -> FeedCommand:
        """Return the law's command with the setting in force."""
        self.clock_s += window.duration_s
        self.law.override(SETTINGS[self.setting] if self.clock_s >= 0.0 else OWN)
        return self.law.update(window)


def record(job: tuple[int, int]) -> dict[str, Any]:
    """Return what a machine cut: rows of setting, seconds and area, in order of time; and lost wires."""
    seed, number = job
    recorder = Recorder(1000 * seed + number)
    episode = Episode(Task(ENV_ID, test_s=0.0), recorder, seed, "recorder")
    rows: list[tuple[int, float, float]] = []
    seconds, area, outcome = 0.0, 0.0, None
    while outcome is None and len(rows) < len(SETTINGS):
        outcome = episode.step()
        assert episode.last is not None
        if not recorder.measures:
            seconds = area = 0.0
            continue
        seconds += episode.last.observation.duration_s
        area += episode.last.area_mm2
        if recorder.clock_s >= SEGMENT_S:
            rows.append((recorder.setting, seconds, area))
            recorder.setting, recorder.clock_s = int(recorder.left.pop()) if recorder.left else 0, 0.0
    return {"seed": seed, "rows": rows, "lost": recorder.lost}


def gains(passes: list[dict[str, Any]]) -> tuple[np.ndarray, float]:
    """Return the logarithm of each setting's rate over the own one's on a machine, and that rate in mm2/min."""
    found: list[list[float]] = [[] for _ in SETTINGS]
    own: list[float] = []
    for one in passes:
        rows = np.array([row for row in one["rows"] if row[2] > 0.0])
        log_rate = np.log(rows[:, 2] / rows[:, 1])
        for k, (setting, *_) in enumerate(rows):
            found[int(setting)].append(log_rate[k] - np.median(log_rate[max(k - AROUND, 0) : k + AROUND + 1]))
            own += [60.0 * np.exp(log_rate[k])] * int(setting < 4)
    means = np.array([np.mean(each) if each else np.nan for each in found])
    return means - np.nanmean(means[:4]), float(np.mean(own))


def main() -> None:
    """Record what is missing, and print the settings by what they cut in the sum over the machines."""
    parser = argparse.ArgumentParser(description="Search settings of the servo.")
    parser.add_argument("--machines", type=int, default=32)
    parser.add_argument("--out", type=Path, default=Path("out/servo"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    jobs = [(FIRST_SEED + k, number) for k in range(options.machines) for number in range(PASSES)]
    table = RunTable(options.out / "segments.jsonl", {"settings": SETTINGS})
    made = perform(record, jobs, lambda done, all_: print(done, "of", all_, flush=True), table=table,
                   ids=[f"{seed}-{number}" for seed, number in jobs])  # fmt: skip
    each = [gains(made[k : k + PASSES]) for k in range(0, len(made), PASSES)]
    logs, rates = np.array([one[0] for one in each]), np.array([one[1] for one in each])
    total = np.nansum(rates[:, None] * np.exp(logs), axis=0) / (rates[:, None] * np.isfinite(logs)).sum(axis=0)
    lost = np.sum([one["lost"] for one in made], axis=0)
    for k in np.argsort(-total):
        changed = ",".join(f"{name}={value:g}" for name, value in SETTINGS[k].items() if value != OWN[name])
        print(f"{100 * total[k]:.1f} % of the own rate, {lost[k]} wires lost: {changed or 'own'}")


if __name__ == "__main__":
    main()
