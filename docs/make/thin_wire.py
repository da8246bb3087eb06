"""What constant settings are worth in ThinWire: `python docs/make/thin_wire.py` prints the page's table.

Machines are drawn with training seeds, and cut for 30 s of machine time with one wire each, at an open share of 0.05
and pulse periods in proportion to the set-up's.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edmsim.envs.batch import Batch
from edmsim.envs.path_follower import RUNNING, WIRE_BREAK
from edmsim.envs.thin_wire import ThinWire

FACTORS = (4.0, 3.0, 2.0, 1.4, 1.0, 0.7)
SEEDS = range(100, 124)
SECONDS = 30.0
TARGET_SHARE = 0.05


def rates(family: ThinWire, factor: float) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the rates in mm2/min on all machines, 0 where the cut ended before its time, and which lost a wire."""
    batch, running = Batch(family, len(SEEDS)), np.arange(len(SEEDS))
    for lane, seed in enumerate(SEEDS):
        batch.begin(lane, np.random.default_rng(seed), None, anew=True)
    low, high = family.servo_target_share
    action = [2 * (TARGET_SHARE - low) / (high - low) - 1, np.log2(factor) / family.setting_octaves]
    actions, area_mm2 = np.tile(np.array(action, np.float32), (len(SEEDS), 1)), np.zeros(len(SEEDS))
    rows = batch.lanes.rows
    while len(running):
        batch.step(running, actions)
        area_mm2 += batch.earned.area_mm2
        running = running[(rows["cause"][running] == RUNNING) & (rows["elapsed_ns"][running] < SECONDS * 1e9)]
    whole = rows["cause"] == RUNNING
    return np.where(whole, 60 * area_mm2 / (rows["elapsed_ns"] * 1e-9), 0.0), rows["cause"] == WIRE_BREAK


def main() -> None:
    """Print a row for every setting, and the mean of each machine's best."""
    family = ThinWire.of(wires=1, episode_s=None)
    found = {factor: rates(family, factor) for factor in FACTORS}
    print("| period over the set-up's | mean rate, mm2/min | machines that lost a wire |\n|---|---|---|")
    for factor, (rate, broke) in found.items():
        print(f"| {factor:g} | {rate.mean():.1f} | {broke.sum()} of {len(SEEDS)} |")
    best = np.array([rate for rate, _ in found.values()]).max(axis=0)
    print(f"| each machine's best | {best.mean():.1f} | |")


if __name__ == "__main__":
    main()
