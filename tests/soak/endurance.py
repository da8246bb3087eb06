"""Long runs: an hour of a machine, a million steps of environments; memory beside what the cut itself needs."""

import time
from typing import Any

import gymnasium as gym
import numpy as np

from edmsim import Machine, Plant
from edmsim.closed_loop.straight import Traverse, begin
from edmsim.controllers import make

from .memory import growth, resident_bytes

SAMPLES = 200
"""How often memory is looked at (ours)."""
CHECKED = 10
"""How often a run is compared with one restored from its snapshot (ours)."""
TOGETHER = 20
"""Windows that both then run."""
NUM_ENVS = 16


def simulate(seconds: float, seed: int = 1) -> dict[str, Any]:
    """Cut straight on under `counts` for some machine time; compare with restored plants on the way.

    The kerf field grows with the cut, so its cells are subtracted from what the process holds.
    """
    began = time.monotonic()
    plant = begin(Machine.load(height_mm=5.0), seed)
    traverse = Traverse(plant, make("counts"))
    at, held, equal, windows = [], [], 0, 0
    for sample in range(SAMPLES + 1):
        at.append(plant.time_ns * 1e-9)
        held.append(float(resident_bytes() - plant.field.count * plant.field.tiles[0].nbytes))
        if sample == SAMPLES:
            break
        run = traverse.run(seconds / SAMPLES)
        windows += len(run)
        if run[-1].broken:
            raise RuntimeError(f"the wire broke after {at[-1]:.0f} s")
        if sample % (SAMPLES // CHECKED) == 0:
            equal += restored_goes_on_alike(plant, seed)
    rate = growth(at, held)
    return {
        "machine_s": at[-1] - at[0], "windows": windows, "travel_mm": plant.commanded_um[0] * 1e-3,
        "field_MB": plant.field.count * plant.field.tiles[0].nbytes * 1e-6, "restored": CHECKED, "equal": equal,
        "held_MB": held[-1] * 1e-6, "growth_kB_per_h": [v * 3.6 for v in rate], "wall_s": time.monotonic() - began,
    }


def restored_goes_on_alike(plant: Plant, seed: int) -> bool:
    """Whether a plant restored from another's snapshot runs as that one does; the other is left as it was."""
    state = plant.snapshot()
    twin = begin(plant.machine, seed + 1)
    twin.restore(state)
    for both in (plant, twin):
        for _ in range(TOGETHER):
            both.advance([(both.time_ns, 0, 1)])
    ends = [both.snapshot() for both in (plant, twin)]
    plant.restore(state)
    return all(np.array_equal(ends[0][name], ends[1][name]) for name in state)


def step(steps: int, seed: int = 1) -> dict[str, Any]:
    """Make environment steps with random actions, in environments side by side; episodes end and begin as they do."""
    began = time.monotonic()
    env = gym.make_vec(
        "edmsim/GapFeed-v2", num_envs=NUM_ENVS, vectorization_mode="vector_entry_point", resolution="fast", threads=1,
    )  # fmt: skip
    env.reset(seed=seed)
    env.action_space.seed(seed)
    at, held, ended, machine_s = [], [], 0, 0.0
    turns = steps // NUM_ENVS
    for turn in range(turns + 1):
        if turn % max(turns // SAMPLES, 1) == 0:
            at.append(float(turn * NUM_ENVS))
            held.append(float(resident_bytes()))
        if turn == turns:
            break
        observations, rewards, terminated, truncated, infos = env.step(env.action_space.sample())
        if not (np.isfinite(observations).all() and np.isfinite(rewards).all()):
            raise RuntimeError(f"step {turn}: an observation or reward is not a number")
        ended += int((terminated | truncated).sum())
        machine_s += float(np.sum(infos["dt_s"])) if "dt_s" in infos else 0.0
    env.close()
    rate = growth(at, held)
    return {
        "steps": turns * NUM_ENVS, "episodes": ended, "machine_s": machine_s, "held_MB": held[-1] * 1e-6,
        "growth_kB_per_million": [v * 1e3 for v in rate], "wall_s": time.monotonic() - began,
    }


