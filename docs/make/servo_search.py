"""Settings of a law's servo on training machines: which cut fastest, and the effect of each value.

python docs/make/servo_search.py MaxRateShift      # out/servo: some 18 h of machine time, an hour of one processor
python docs/make/servo_search.py MaxRateShift-guarded                 # around the setting of `guarded-hold`, as long
python docs/make/servo_search.py ThinWireShift     # some 21 h of machine time, 20 minutes of one processor

Every machine is cut twice with all settings in random order, 9 s each: the law's own, single changes of it, those of
an earlier policy, and random combinations. The rate of a segment is divided by the median of those around it in
time, because workpieces, water and the law's own adaptation change it. The first table has the settings, the second
the effect of each value, by a linear fit to all segments. After an interruption the same command resumes.
"""

import argparse
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np

from edmsim.controllers import from_text
from edmsim.controllers.feed.law import ServoLaw
from edmsim.controllers.protocols import FeedCommand, WindowObservation, set_up_controller
from edmsim.envs.episode import Task
from edmsim.evaluation.episode import Episode
from edmsim.machine.machine import Machine
from edmsim.runs import Processes, RunTable, perform
from edmsim.snapshots import Snapshots

FIRST_SEED, PASSES = 21_002, 2
FIRST_S, START_S, SEGMENT_S, SETTLE_S = 30.0, 5.0, 9.0, 2.0
"""Cutting time with the law's own setting at first, and of a new wire; of a segment; of its ignored beginning."""
AROUND = 8  # segments before and after a segment to compare its rate with
OWN_REPEATS, COMBINATIONS = 4, 66
MOST_LEAD = 0.7  # clamps the logarithm of a segment's rate, because the next workpiece may begin in it
Setting = dict[str, float]


class Search(NamedTuple):
    """The search for a task."""

    law: str
    own: Setting  # the law's own values
    single: dict[str, tuple[float, ...]]  # values of single changes
    before: tuple[Setting, ...]  # settings of an earlier policy, as changes
    drawn: dict[str, tuple[float, ...]]  # values of random combinations

    @property
    def settings(self) -> list[Setting]:
        """The law's own setting several times, single changes, earlier settings, random combinations."""
        rng = np.random.default_rng(7)
        single = [{**self.own, name: value} for name, values in self.single.items() for value in values]
        before = [{**self.own, **setting} for setting in self.before]
        drawn = [
            {**self.own, **{name: float(rng.choice(values)) for name, values in self.drawn.items()}}
            for _ in range(COMBINATIONS)
        ]
        return [self.own] * OWN_REPEATS + single + before + drawn


SEARCHES = {
    "MaxRateShift": Search(
        "adaptive-hold",
        {
            "open_target_share": 0.0, "short_weight": 1.0, "proportional_um_s": 30.0, "integral_um_s2": 100.0,
            "filter_s": 0.05, "patience_s": 0.15, "retract_feed_um_s": 80.0, "integral_share": 0.5, "recovery_s": 0.5,
            "shortest_us": 18.0, "proportional_share": 0.6, "integral_per_s": 4.0,
        },
        {
            "open_target_share": (0.1, 0.2, 0.3), "short_weight": (0.15, 0.5, 2.0),
            "proportional_um_s": (10.0, 60.0, 120.0, 250.0), "integral_um_s2": (30.0, 200.0, 400.0),
            "filter_s": (0.02, 0.1), "patience_s": (0.04, 0.4), "retract_feed_um_s": (40.0, 160.0),
            "integral_share": (0.25, 0.8, 1.0), "recovery_s": (0.2, 1.0), "shortest_us": (16.0, 14.0, 12.5),
            "proportional_share": (0.3, 1.0), "integral_per_s": (2.0, 8.0),
        },
        (
            {"open_target_share": 0.1, "shortest_us": 12.5},
            {"open_target_share": 0.2, "shortest_us": 12.5, "proportional_um_s": 120.0},
            {"open_target_share": 0.3, "shortest_us": 12.5, "proportional_um_s": 120.0},
            {"short_weight": 0.5, "shortest_us": 12.5}, {"short_weight": 0.15, "shortest_us": 12.5},
        ),
        {
            "open_target_share": (0.0, 0.0, 0.05, 0.1, 0.2, 0.3), "short_weight": (0.15, 0.3, 0.5, 1.0, 1.0, 2.0),
            "proportional_um_s": (10.0, 30.0, 60.0, 120.0, 250.0),
            "integral_um_s2": (30.0, 60.0, 100.0, 200.0, 400.0), "filter_s": (0.02, 0.05, 0.05, 0.1),
            "patience_s": (0.04, 0.08, 0.15, 0.4), "retract_feed_um_s": (40.0, 80.0, 160.0),
            "integral_share": (0.25, 0.5, 0.5, 0.8, 1.0), "recovery_s": (0.2, 0.5, 0.5, 1.0),
            "shortest_us": (18.0, 18.0, 18.0, 15.5, 12.5), "proportional_share": (0.3, 0.6, 1.0),
            "integral_per_s": (2.0, 4.0, 8.0),
        },
    ),
    "MaxRateShift-guarded": Search(
        "guarded-hold:limit_share=0.14,limit_spread=0.65,by_chance_per_s=3e-4,fall_per_s=7e-5,break_weight=1.5,"
        "steepness=20,drift_per_s=8e-6,ramp_s=60,short_weight=0.3,proportional_um_s=250,integral_um_s2=60,"
        "filter_s=0.02,patience_s=0.04,recovery_s=0.2,shortest_us=12.5",
        {
            "open_target_share": 0.0, "short_weight": 0.3, "proportional_um_s": 250.0, "integral_um_s2": 60.0,
            "filter_s": 0.02, "patience_s": 0.04, "retract_feed_um_s": 80.0, "integral_share": 0.5, "recovery_s": 0.2,
            "shortest_us": 12.5, "proportional_share": 0.6, "integral_per_s": 4.0, "flux_filter_s": 0.05,
            "reliefs_per_s": 0.25, "relief_us": 200.0, "restart_share": 0.7,
        },
        {
            "open_target_share": (0.03, 0.06), "short_weight": (0.15, 0.5),
            "proportional_um_s": (120.0, 400.0, 700.0), "integral_um_s2": (20.0, 120.0, 250.0),
            "filter_s": (0.01, 0.04), "patience_s": (0.02, 0.08), "retract_feed_um_s": (40.0, 160.0, 300.0),
            "integral_share": (0.25, 0.8, 1.0), "recovery_s": (0.0, 0.1, 0.5), "shortest_us": (11.0, 15.5),
            "proportional_share": (0.3, 1.0), "integral_per_s": (2.0, 8.0), "flux_filter_s": (0.02, 0.1),
            "reliefs_per_s": (0.0, 0.1, 0.6), "relief_us": (100.0, 400.0),
            "restart_share": (0.0, 0.5, 0.9),
        },
        (),
        {
            "open_target_share": (0.0, 0.0, 0.0, 0.05), "short_weight": (0.15, 0.3, 0.3, 0.5),
            "proportional_um_s": (150.0, 250.0, 250.0, 400.0, 700.0),
            "integral_um_s2": (30.0, 60.0, 60.0, 120.0, 250.0), "filter_s": (0.01, 0.02, 0.02, 0.04),
            "patience_s": (0.02, 0.04, 0.04, 0.08), "retract_feed_um_s": (40.0, 80.0, 80.0, 160.0, 300.0),
            "integral_share": (0.25, 0.5, 0.5, 0.8, 1.0), "recovery_s": (0.0, 0.1, 0.2, 0.2, 0.5),
            "shortest_us": (11.0, 12.5, 12.5, 14.0), "proportional_share": (0.3, 0.6, 0.6, 1.0),
            "integral_per_s": (2.0, 4.0, 4.0, 8.0), "flux_filter_s": (0.02, 0.05, 0.05, 0.1),
            "reliefs_per_s": (0.1, 0.25, 0.25, 0.6), "relief_us": (100.0, 200.0, 200.0, 400.0),
            "restart_share": (0.5, 0.7, 0.7, 0.9),
        },
    ),
    "ThinWireShift": Search(
        "adaptive-hold:open_target_share=0.05,proportional_um_s=10,integral_um_s2=30,period_us=100,shortest_us=12,"
        "longest_us=300,limit_share=0.27,limit_spread=0.6,retract_feed_um_s=20",
        {
            "open_target_share": 0.05, "short_weight": 1.0, "proportional_um_s": 10.0, "integral_um_s2": 30.0,
            "filter_s": 0.05, "patience_s": 0.15, "retract_feed_um_s": 20.0, "integral_share": 0.5, "recovery_s": 0.5,
            "refill_s": 5.0, "proportional_share": 0.6, "integral_per_s": 4.0,
        },
        {
            "open_target_share": (0.0, 0.15, 0.3), "short_weight": (0.15, 0.3, 0.5, 2.0),
            "proportional_um_s": (5.0, 20.0, 40.0, 80.0), "integral_um_s2": (10.0, 60.0, 120.0),
            "filter_s": (0.02, 0.1), "patience_s": (0.04, 0.08, 0.4), "retract_feed_um_s": (10.0, 40.0, 80.0),
            "integral_share": (0.25, 0.8, 1.0), "recovery_s": (0.0, 0.2, 1.0), "refill_s": (0.0, 2.0),
            "proportional_share": (0.3, 1.0), "integral_per_s": (2.0, 8.0),
        },
        ({"open_target_share": 0.0, "short_weight": 0.3},),
        {
            "open_target_share": (0.0, 0.0, 0.05, 0.1, 0.2), "short_weight": (0.1, 0.15, 0.3, 0.3, 0.5, 1.0),
            "proportional_um_s": (5.0, 10.0, 20.0, 40.0, 80.0), "integral_um_s2": (10.0, 30.0, 30.0, 60.0, 120.0),
            "filter_s": (0.02, 0.05, 0.05, 0.1), "patience_s": (0.04, 0.08, 0.15, 0.4),
            "retract_feed_um_s": (10.0, 20.0, 40.0, 80.0), "integral_share": (0.25, 0.5, 0.5, 0.8, 1.0),
        },
    ),
}  # fmt: skip


class Recorder(Snapshots):
    """Cuts with the law, whose setting changes every few seconds; a lost wire restarts the segment."""

    name: ClassVar[str] = "recorder"
    STATE: ClassVar[tuple[str, ...]] = ("law", "left", "setting", "clock_s", "lost")

    def __init__(self, search: Search, seed: int) -> None:
        law = from_text(search.law)
        assert isinstance(law, ServoLaw)
        self.law, self.settings = law, search.settings
        self.left = np.random.default_rng(seed).permutation(len(self.settings)).tolist()
        self.setting, self.clock_s, self.lost = int(self.left.pop()), -FIRST_S, [0] * len(self.settings)

    @property
    def measures(self) -> bool:
        """Whether the last window counts."""
        return self.clock_s > SETTLE_S

    def set_up(self, machine: Machine, points_um: Any, start_um: float) -> None:
        """Set the machine and the path."""
        set_up_controller(self.law, machine, points_um, start_um)

    def reset(self, max_feed_um_s: float) -> FeedCommand:
        """Begin the cut."""
        return self.law.reset(max_feed_um_s)

    def wire_lost(self) -> FeedCommand:
        """Begin the next wire, and later the same setting again."""
        self.lost[self.setting] += self.clock_s >= 0.0
        self.clock_s = -START_S
        return self.law.wire_lost()

    def update(self, window: WindowObservation) -> FeedCommand:
        """Return the law's command with the present setting."""
        self.clock_s += window.duration_s
        self.law.override(self.settings[self.setting if self.clock_s >= 0.0 else 0])
        return self.law.update(window)


def record(job: tuple[str, int, int]) -> dict[str, Any]:
    """Return the record of a machine: rows of setting, seconds and area, in order of time; and lost wires."""
    task, seed, number = job
    recorder = Recorder(SEARCHES[task], 1000 * seed + number)
    episode = Episode(Task(f"edmsim/{task.partition('-')[0]}-v0", test_s=0.0), recorder, seed, "recorder")
    rows: list[tuple[int, float, float]] = []
    seconds = area = 0.0
    for window in episode.windows():
        if not recorder.measures:
            seconds = area = 0.0
            continue
        seconds += window.observation.duration_s
        area += window.area_mm2
        if recorder.clock_s >= SEGMENT_S:
            rows.append((recorder.setting, seconds, area))
            recorder.setting, recorder.clock_s = int(recorder.left.pop()) if recorder.left else 0, 0.0
            if len(rows) == len(recorder.settings):
                break
    return {"seed": seed, "rows": rows, "lost": recorder.lost}


class Gains(NamedTuple):
    """Rates of settings on a machine."""

    means: np.ndarray  # logarithm of each setting's rate over the own setting's
    own_mm2_min: float  # rate of the own setting
    segments: list[tuple[int, float]]  # setting, and logarithm of the rate over that of the segments around it


def gains(passes: list[dict[str, Any]]) -> Gains:
    """Return the rates of settings on a machine, from its records."""
    found: list[list[float]] = [[] for _ in passes[0]["lost"]]
    own: list[float] = []
    for one in passes:
        rows = np.array([row for row in one["rows"] if row[2] > 0.0])
        log_rate = np.log(rows[:, 2] / rows[:, 1])
        for k, (setting, *_) in enumerate(rows):
            found[int(setting)].append(log_rate[k] - np.median(log_rate[max(k - AROUND, 0) : k + AROUND + 1]))
            own += [60.0 * np.exp(log_rate[k])] * int(setting < OWN_REPEATS)
    means = np.array([np.mean(each) if each else np.nan for each in found])
    segments = [(setting, lead) for setting, leads in enumerate(found) for lead in leads]
    return Gains(means - np.nanmean(means[:OWN_REPEATS]), float(np.mean(own)), segments)


def print_values(search: Search, each: list[Gains], lost: np.ndarray) -> None:
    """Print the contribution of each value to the logarithm of the rate; machines are weighted by their rates."""
    settings = search.settings
    values = [(name, value) for name, own in search.own.items()
              for value in sorted({setting[name] for setting in settings} - {own})]  # fmt: skip
    has = np.array([[setting[name] == value for name, value in values] for setting in settings], float)
    setting, lead = np.array([segment for one in each for segment in one.segments]).T
    setting = setting.astype(int)
    weight = np.sqrt(np.repeat([one.own_mm2_min for one in each], [len(one.segments) for one in each]))
    design = np.column_stack([np.ones(len(setting)), has[setting]]) * weight[:, None]
    weighted = np.clip(lead, -MOST_LEAD, MOST_LEAD) * weight
    fitted, *_ = np.linalg.lstsq(design, weighted)
    error = (weighted - design @ fitted).std() * np.sqrt(np.diag(np.linalg.pinv(design.T @ design)))
    segments = np.bincount(setting, minlength=len(settings))
    for k, (name, value) in enumerate(values):
        broke = 100 * (has[:, k] @ lost) / max(has[:, k] @ segments, 1)
        print(f"{name}={value:g}: {100 * fitted[k + 1]:+.1f} ± {100 * error[k + 1]:.1f} %, "
              f"{broke:.1f} wires lost in 100 segments")  # fmt: skip


def main() -> None:
    """Make the missing records, and print the settings in order of their rates, summed over the machines."""
    parser = argparse.ArgumentParser(description="Search settings of the servo.")
    parser.add_argument("task", choices=list(SEARCHES))
    parser.add_argument("--machines", type=int, default=32)
    parser.add_argument("--out", type=Path, default=Path("out/servo"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    search = SEARCHES[options.task]
    settings = search.settings
    jobs = [(options.task, FIRST_SEED + k, number) for k in range(options.machines) for number in range(PASSES)]
    table = RunTable(options.out / f"{options.task}.jsonl", {"settings": settings})
    made = perform(record, jobs, lambda done, all_: print(done, "of", all_, flush=True), table=table,
                   engine=Processes(), ids=[f"{seed}-{number}" for _, seed, number in jobs])  # fmt: skip
    each = [gains(made[k : k + PASSES]) for k in range(0, len(made), PASSES)]
    logs, rates = np.array([one.means for one in each]), np.array([one.own_mm2_min for one in each])
    total = np.nansum(rates[:, None] * np.exp(logs), axis=0) / (rates[:, None] * np.isfinite(logs)).sum(axis=0)
    lost = np.sum([one["lost"] for one in made], axis=0)
    for k in np.argsort(-total):
        changes = {name: value for name, value in settings[k].items() if value != search.own[name]}
        changed = ",".join(f"{name}={value:g}" for name, value in changes.items())
        print(f"{100 * total[k]:.1f} % of the own rate, {lost[k]} wires lost: {changed or 'own'}")
    print_values(search, each, lost)


if __name__ == "__main__":
    from servo_search import main as run  # because other processes import functions by module

    run()
