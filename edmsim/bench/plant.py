"""Speed of the plant: figures for ``edmsim bench``."""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import compiled
from edmsim.compiled.vectors import PACK
from edmsim.machine.machine import Machine
from edmsim.machine.setting import WINDOW_PULSES
from edmsim.plant.constants import gap_law
from edmsim.plant.gap.breakdown import GapLaw, slice_sums
from edmsim.plant.gap.generator import timing
from edmsim.plant.gap.rays import Rays
from edmsim.plant.plant import Plant

FEED_UM_S = 28.0
"""Feed of the straight cut that is timed: well into the metal, most pulses spark."""
SETTLE_WINDOWS = 1000
"""Windows before timing, until the wire cuts a full kerf. At `default` the 800th takes a fifth longer than the
first ones, and as long as any later one."""
TIMED_WINDOWS = 200
REPEATS = 12
"""Runs per figure, whose best counts, as other programs use the computer too."""
MUJOCO_WINDOWS = 20
THREAD_S = 1.0
MEMORY_S = 60.0
"""Machine time over which memory must not grow."""
_COLD = (
    "import edmsim\n"
    "plant = edmsim.Plant(edmsim.Machine.load(), seed=0)\n"
    "plant.advance()\n"
)


def _straight_cut(plant: Plant) -> Iterator[None]:
    """Advance a plant window by window at the feed of the benchmark."""
    interval_ns = round(plant.machine.base.table.step_um.value * 1e9 / FEED_UM_S)
    window_ns, until = plant.window_ns, plant.time_ns
    due = until + interval_ns
    while True:
        until += window_ns
        steps = [(t, 0, 1) for t in range(due, until, interval_ns)] if due < until else ()
        due += len(steps) * interval_ns
        plant.advance(steps)
        yield


def _settled_cut(plant: Plant) -> Iterator[None]:
    """Return the windows of a straight cut behind those until the wire cuts a full kerf."""
    cut = _straight_cut(plant)
    for _ in range(SETTLE_WINDOWS):
        next(cut)
    return cut


def spent_s(run: Callable[[], object], times: int = 1, clock: Callable[[], float] = time.process_time) -> float:
    """Return the processor time, or that of another clock, of some calls together."""
    started = clock()
    for _ in range(times):
        run()
    return clock() - started


def best_s(run: Callable[[], object], times: int = 1) -> float:
    """Return the shortest processor time that some calls together took, of `REPEATS`."""
    return min(spent_s(run, times) for _ in range(REPEATS))


def pulses_per_s(resolution: str) -> tuple[float, Plant]:
    """Pulses per second of one core in a straight cut, and the plant as it was left."""
    plant = Plant(Machine.load(), seed=0, resolution=resolution)
    cut = _settled_cut(plant)
    return TIMED_WINDOWS * WINDOW_PULSES / best_s(cut.__next__, TIMED_WINDOWS), plant


def mujoco_realtime_factor() -> float:
    """Machine time over processor time where MuJoCo moves wire and table, at the default resolution and 10 kHz."""
    plant = Plant(Machine.load(), seed=0, mechanics="mujoco")
    cut = _straight_cut(plant)
    next(cut)
    return MUJOCO_WINDOWS * plant.window_ns * 1e-9 / best_s(cut.__next__, MUJOCO_WINDOWS)


@compiled
def _sum_rays(rays: Rays, law: GapLaw, sums: NDArray[np.float64], pulses: int) -> float:
    """The one part of a pulse no plant of this kind can do without."""
    total = 0.0
    for pulse in range(pulses):
        for s in range(0, rays.distance.shape[0], PACK):  # the others in its block come with it
            shift = 1e-3 * (pulse % 7)
            slice_sums(rays, s, shift, shift, law, sums)
            total += sums[s, 0] + sums[s, 2] + sums[s, 3]
    return total


def ray_sums_per_s(plant: Plant) -> float:
    """Pulses per second if a pulse were nothing but the sums over its rays: the bound of this design."""
    law = gap_law(plant.machine, plant.resolution, timing(plant.machine).open_V)
    rays = plant.rays()
    sums = np.zeros((plant.resolution.slices, 4))
    pulses = TIMED_WINDOWS * WINDOW_PULSES // 2
    _sum_rays(rays, law, sums, 1)
    return pulses / best_s(lambda: _sum_rays(rays, law, sums, pulses))


def _together(works: Sequence[Callable[[], object]]) -> float:
    """Rounds per second that some kinds of work do side by side, each in a thread of its own."""
    rounds = [0] * len(works)
    stop = threading.Event()

    def run(k: int) -> None:
        while not stop.is_set():
            works[k]()
            rounds[k] += 1

    threads = [threading.Thread(target=run, args=(k,)) for k in range(len(works))]
    for thread in threads:
        thread.start()
    time.sleep(THREAD_S)
    stop.set()
    for thread in threads:
        thread.join()
    return sum(rounds) / THREAD_S


def thread_scaling() -> tuple[float, float]:
    """Gain of two threads over one: of two plants, and of two loops that only compute.

    The second is the gain of the processors alone (1.2 if two share a core), for comparison with the first.
    """
    plants = [Plant(Machine.load(), seed=seed) for seed in range(2)]
    cuts = [_settled_cut(plant) for plant in plants]
    law = gap_law(plants[0].machine, plants[0].resolution, timing(plants[0].machine).open_V)
    rays = plants[0].rays()
    advance: list[Callable[[], object]] = [cut.__next__ for cut in cuts]
    compute = [_summing(rays, law) for _ in range(2)]
    gains = []
    for works in (advance, compute):
        alone = max(_together(works[:1]) for _ in range(2))
        gains.append(max(_together(works) for _ in range(2)) / alone)
    return gains[0], gains[1]


def _summing(rays: Rays, law: GapLaw) -> Callable[[], object]:
    """Work of a thread that sums rays, into an array of its own."""
    sums = np.zeros((len(rays.first), 4))
    return lambda: _sum_rays(rays, law, sums, WINDOW_PULSES)


def memory_growth_MB() -> float:
    """Growth of the process over a minute of machine time, less the tiles of the kerf field."""
    plant = Plant(Machine.load(), seed=0, resolution="fast")
    cut = _settled_cut(plant)
    before, end = _resident_MB() - plant.field.tiles.nbytes * 1e-6, plant.time_ns + MEMORY_S * 1e9
    while plant.time_ns < end:
        next(cut)
    return _resident_MB() - plant.field.tiles.nbytes * 1e-6 - before


def _resident_MB() -> float:
    """Memory that this process uses, or 0 if the system does not report it."""
    with suppress(OSError):
        import resource

        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return pages * resource.getpagesize() * 1e-6
    return 0.0


def cold_start_s() -> float:
    """Processor time from starting Python to the end of the first window, with the loop compiled before."""
    command = [sys.executable, "-c", _COLD]
    subprocess.run(command, check=True)
    before = os.times()
    subprocess.run(command, check=True)
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system
