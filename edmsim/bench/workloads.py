"""Program that ``edmsim bench --against`` runs with two revisions, in separate processes; it prints rates as JSON.

It must also run with old revisions, so it uses only public names that all have: `edmsim.Plant`, `edmsim.Machine`, and
Gymnasium's environment ids. It imports no other module of its folder.

    python workloads.py ROOT SPELL_S SPELLS SETTLE_WINDOWS NUM_ENVS RESETS
"""

import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

import edmsim

FEED_UM_S, MAX_FEED_UM_S, STEP_UM = 28.0, 100.0, 2.0
"""Feed of straight cuts, with mostly sparks; scale of the environments' actions; step of the default table."""
PULSES = 255
"""Pulses of a window."""
SETTLE_WINDOWS = 1000
"""Windows before timing, until the wire cuts a full kerf. At `default` the 800th takes a fifth longer than the first
ones, and as long as later ones."""
STANDARD: dict[str, Any] = {
    "action": "speed", "randomise": None, "height_mm": None, "tension": None, "episode_s": None, "length_mm": 30.0,
}
"""The standard environment, without a limit of the episode's time."""
MUJOCO_SHARE, FLEET_SHARE = 50, 4
"""Divisors of the settling windows for MuJoCo, whose windows take a hundred times as long, and for the vector
environment, whose windows at `fast` soon take as long as later ones."""


def spent_s(run: Callable[[], object], times: int = 1, clock: Callable[[], float] = time.process_time) -> float:
    """Return the processor time, or the time by another clock, of `times` calls together."""
    started = clock()
    for _ in range(times):
        run()
    return clock() - started


def rate(
    step: Callable[[], object], spell_s: float, spells: int, now_s: Callable[[], float] = time.process_time
) -> float:
    """Return steps per second of processor time, or by another clock, in the fastest of `spells` spells."""
    steps = 1
    while (first_s := spent_s(step, steps, now_s)) < 0.2 * spell_s:
        steps *= 2
    steps = max(1, round(steps * spell_s / first_s))
    return steps / min(spent_s(step, steps, now_s) for _ in range(spells))


def new_plant(**options: str) -> edmsim.Plant:
    """Return a plant of the default machine."""
    return edmsim.Plant(edmsim.Machine.load(), seed=0, **options)  # type: ignore[arg-type]


def straight_cut(plant: edmsim.Plant, settle: int) -> Callable[[], None]:
    """Return a function that makes the next window of a straight cut, after `settle` windows."""
    interval_ns = round(STEP_UM * 1e9 / FEED_UM_S)
    due_ns = plant.time_ns + interval_ns

    def window() -> None:
        nonlocal due_ns
        end_ns = plant.time_ns + plant.window_ns
        steps = [(time_ns, 0, 1) for time_ns in range(due_ns, end_ns, interval_ns)]
        due_ns += len(steps) * interval_ns
        plant.advance(steps)

    for _ in range(settle):
        window()
    return window


def gap_feed() -> str:
    """Return the environment's id with the highest version in this revision."""
    names = [name for name in gymnasium.registry if name.startswith("edmsim/GapFeed-v")]
    return max(names, key=lambda name: int(name.rpartition("v")[2]))


def fleet(
    num_envs: int, settle: int, threads: int | None = 1, resolution: str = "fast"
) -> Callable[[], object]:
    """Return the step of a vector environment in straight cuts, after `settle` steps."""
    envs = gymnasium.make_vec(
        gap_feed(), num_envs=num_envs, vectorization_mode="vector_entry_point", resolution=resolution,
        threads=threads, **STANDARD,
    )
    envs.reset(seed=0)
    actions = np.full((num_envs, 1), FEED_UM_S / MAX_FEED_UM_S, np.float32)
    for _ in range(settle):
        envs.step(actions)
    return lambda: envs.step(actions)


def main() -> None:
    """Measure and print the rates."""
    root = Path(sys.argv[1])
    spell_s, (spells, settle, num_envs, resets) = float(sys.argv[2]), map(int, sys.argv[3:])
    if root not in Path(edmsim.__file__).parents:
        sys.exit(f"edmsim came from {edmsim.__file__}, not from {root}")
    found = {
        f"pulses_per_s_{name}": PULSES * rate(straight_cut(new_plant(resolution=name), settle), spell_s, spells)
        for name in ("fast", "default", "fine")
    }
    full = straight_cut(new_plant(mechanics="mujoco"), settle // MUJOCO_SHARE)
    found["mujoco_pulses_per_s"] = PULSES * rate(full, spell_s, spells)
    settle_fleet = settle // FLEET_SHARE
    found["vector_env_steps_per_s_fast"] = num_envs * rate(fleet(num_envs, settle_fleet), spell_s, spells)
    threads = fleet(num_envs, settle_fleet, os.cpu_count() or 1)
    found["vector_env_steps_per_s_fast_threads"] = num_envs * rate(threads, spell_s, spells, time.perf_counter)
    drawn = gymnasium.make(gap_feed(), resolution="fast", machine_episodes=1)
    drawn.reset(seed=0)
    start_s = time.process_time()
    for _ in range(resets):
        drawn.reset()
    found["drawn_resets_per_s"] = resets / (time.process_time() - start_s)
    print(json.dumps(found))


if __name__ == "__main__":
    main()
