"""All figures of ``edmsim bench``: speed of the pulse loop, of environments and of controllers."""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from edmsim.axis_bench import AxisBench
from edmsim.bench.subject import FEED_UM_S, MAX_FEED_UM_S, new_plant, spent_s, straight_cut
from edmsim.compiled.jit import compiled
from edmsim.compiled.vectors import PACK
from edmsim.controllers import make
from edmsim.controllers.axis import CHIPS, tuned
from edmsim.controllers.axis.elcam.module import CamPlace, Elcam
from edmsim.controllers.axis.elcam.table import Function, Mode
from edmsim.controllers.mcu.firmware.poscal import poscal
from edmsim.cosim.simulation import Simulation
from edmsim.errors import EdmsimError, InputError
from edmsim.machine.machine import Machine
from edmsim.machine.setting import WINDOW_PULSES
from edmsim.plant.constants import gap_law
from edmsim.plant.gap.breakdown import GapLaw, slice_sums
from edmsim.plant.gap.generator import timing
from edmsim.plant.gap.rays import Rays
from edmsim.plant.mechanics.engine import mujoco
from edmsim.plant.plant import Plant
from edmsim.program.path import CutPath, WireContour
from edmsim.signals import noted

SETTLE_WINDOWS = 1000
"""Windows before timing, until the wire cuts a full kerf. At `default` the 800th takes a fifth longer than the first
ones, and as long as later ones."""
TIMED_WINDOWS = 200
REPEATS = 12
"""Runs per figure; the fastest counts, because other programs use the computer, too."""
MUJOCO_WINDOWS = 20
THREAD_S = 1.0
MEMORY_S = 60.0
"""Machine time over which the growth of memory is measured."""
_COLD = "import edmsim\nplant = edmsim.Plant(edmsim.Machine.load(), seed=0)\nplant.advance()\n"


def best_s(run: Callable[[], object], times: int = 1) -> float:
    """Return the processor time of `times` calls together, the shortest of `REPEATS`."""
    return min(spent_s(run, times) for _ in range(REPEATS))


def pulses_per_s(resolution: str) -> tuple[float, Plant]:
    """Return pulses per second of one core in a straight cut, and the plant after it."""
    plant = new_plant(resolution=resolution)
    return TIMED_WINDOWS * WINDOW_PULSES / best_s(straight_cut(plant, SETTLE_WINDOWS), TIMED_WINDOWS), plant


def mujoco_realtime_factor() -> float:
    """Return machine time over processor time if MuJoCo moves wire and table, at `default` and 10 kHz."""
    plant = new_plant(mechanics="mujoco")
    return MUJOCO_WINDOWS * plant.window_ns * 1e-9 / best_s(straight_cut(plant, 1), MUJOCO_WINDOWS)


@compiled
def _sum_rays(rays: Rays, law: GapLaw, sums: NDArray[np.float64], pulses: int) -> float:
    """Compute the sums over rays, the part of a pulse that every plant of this kind needs; return a total."""
    total = 0.0
    for pulse in range(pulses):
        for s in range(0, rays.distance.shape[0], PACK):  # sums of `PACK` slices
            shift = 1e-3 * (pulse % 7)
            slice_sums(rays, s, shift, shift, law, sums)
            total += sums[s, 0] + sums[s, 2] + sums[s, 3]
    return total


def ray_sums_per_s(plant: Plant) -> float:
    """Return pulses per second if a pulse consisted only of the sums over its rays: the bound of this design."""
    law = gap_law(plant.machine, plant.resolution, timing(plant.machine).open_V)
    rays = plant.rays()
    sums = np.zeros((plant.resolution.slices, 4))
    pulses = TIMED_WINDOWS * WINDOW_PULSES // 2
    _sum_rays(rays, law, sums, 1)
    return pulses / best_s(lambda: _sum_rays(rays, law, sums, pulses))


def _together(works: Sequence[Callable[[], object]]) -> float:
    """Return the calls per second of all works together, each repeated in its own thread."""
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
    """Return the gain of two threads over one: of two plants, and of two loops that only compute.

    The second is the gain of the processors alone (1.2 if two share a core), for comparison with the first.
    """
    plants = [Plant(Machine.load(), seed=seed) for seed in range(2)]
    advance = [straight_cut(plant, SETTLE_WINDOWS) for plant in plants]
    law = gap_law(plants[0].machine, plants[0].resolution, timing(plants[0].machine).open_V)
    rays = plants[0].rays()
    compute = [partial(_sum_rays, rays, law, np.zeros((len(rays.first), 4)), WINDOW_PULSES) for _ in range(2)]
    gains = []
    for works in (advance, compute):
        alone = max(_together(works[:1]) for _ in range(2))
        gains.append(max(_together(works) for _ in range(2)) / alone)
    return gains[0], gains[1]


def memory_growth_MB() -> float:
    """Return the growth of the process's memory over `MEMORY_S`, without the tiles of the kerf field."""
    plant = new_plant(resolution="fast")
    window = straight_cut(plant, SETTLE_WINDOWS)
    before, end = _resident_MB() - plant.field.tiles.nbytes * 1e-6, plant.time_ns + MEMORY_S * 1e9
    while plant.time_ns < end:
        window()
    return _resident_MB() - plant.field.tiles.nbytes * 1e-6 - before


def _resident_MB() -> float:
    """Return the memory used by this process, or 0 if the system does not report it."""
    with suppress(OSError):
        import resource

        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return pages * resource.getpagesize() * 1e-6
    return 0.0


def cold_start_s() -> float:
    """Return the processor time from the start of Python to the end of the first window, with the loop compiled."""
    command = [sys.executable, "-c", _COLD]
    subprocess.run(command, check=True)
    before = os.times()
    subprocess.run(command, check=True)
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def measure() -> dict[str, float]:
    """Return all figures by name, by processor time, which excludes other programs, but of threads by the clock."""
    comparison = half_cheetah_comparison()
    default, plant = pulses_per_s("default")
    bound = ray_sums_per_s(plant)
    plants, loops = thread_scaling()
    return {
        "pulses_per_s": default,
        "realtime_factor": default * Machine.load().t_period_us * 1e-6,  # at `default`
        "pulses_per_s_fast": pulses_per_s("fast")[0],
        "pulses_per_s_fine": pulses_per_s("fine")[0],
        "ray_sums_per_s": bound,  # if a pulse consisted only of them
        "ray_sum_share": default / bound,
        "mujoco_realtime_factor": mujoco_realtime_factor(),
        "servo_realtime_factor": min(drive_realtime_factor(name) for name in CHIPS),
        "positioner_realtime_factor": drive_realtime_factor("eanpos"),  # with samples of 1 ms
        **elcam_figures(),
        "env_steps_per_s": env_steps_per_s(),
        "vector_env_steps_per_s": vector_env_steps_per_s(),
        **comparison,  # of 64 environments each
        "turned_knobs_cost": turned_knobs_cost(),
        **drawn_machines(),
        "controller_overhead": controller_overhead(),
        "literal_realtime_factor": literal_realtime_factor(),
        "poscal_calls_per_s": poscal_calls_per_s(),
        "threads_plants": plants,
        "threads_compute": loops,
        "thread_efficiency": plants / loops,
        "memory_growth_MB": memory_growth_MB(),
        "cold_start_s": cold_start_s(),
    }


STANDARD: dict[str, Any] = {
    "action": "speed", "randomise": None, "height_mm": None, "tension": None, "episode_s": None, "length_mm": 30.0,
}
"""The standard set-up, without a limit of the episode's time."""
NUM_ENVS = 64
SETTLE_STEPS = 400
"""Steps before timing, until the wire cuts a full kerf."""
KNOB_STEPS, RESETS, EPISODES = 100, 50, 4
SLICE_S, SLICES = 0.05, 20
"""Length and number of timed spells per figure. The fastest counts; spells are short, because the computer is more
often undisturbed for a short time."""


def env_steps_per_s() -> float:
    """Return steps per second of processor time of one environment of `gymnasium.make`, in a straight cut."""
    env = gym.make("edmsim/GapFeed-v2", **STANDARD)
    env.reset(seed=0)
    action = np.array([FEED_UM_S / MAX_FEED_UM_S], np.float32)
    rate = _best_rate(lambda: env.step(action), time.process_time)
    env.close()
    return rate


def vector_env_steps_per_s() -> float:
    """Return steps per second of a native vector environment, all sub-environments together, on all processors."""
    with straight_cuts(NUM_ENVS, "default") as step:
        return NUM_ENVS * _best_rate(step, time.perf_counter)


@contextmanager
def straight_cuts(num_envs: int, resolution: str, threads: int | None = None) -> Iterator[Callable[[], object]]:
    """Yield the step of a vector environment at the feed of the benchmark."""
    env = gym.make_vec(
        "edmsim/GapFeed-v2", num_envs=num_envs, vectorization_mode="vector_entry_point", resolution=resolution,
        threads=threads, **STANDARD,
    )
    with closing(env):
        env.reset(seed=0)
        actions = np.full((num_envs, 1), FEED_UM_S / MAX_FEED_UM_S, np.float32)
        yield lambda: env.step(actions)


def turned_knobs_cost() -> float:
    """Return the processor time of steps that turn two knobs of the generator at random, over that of other steps.

    On 32 drawn machines at resolution ``fast``; the wire cuts in both.
    """
    env = gym.make_vec(
        "edmsim/Corner-v3", num_envs=32, vectorization_mode="vector_entry_point", resolution="fast", action="change",
        knobs=("on_time", "duty_factor"),
    )
    env.reset(seed=0)
    turns = np.random.default_rng(0).normal(0.0, 0.35, (KNOB_STEPS, *(env.action_space.shape or ())))
    turns = np.clip(turns, -1.0, 1.0).astype(np.float32)
    turns[..., 0] = 0.0  # the feed

    def timed(share: float) -> float:
        return spent_s(lambda: [env.step(actions) for actions in turns * np.float32(share)])

    rest, turned = (min(values) for values in zip(*((timed(0.0), timed(1.0)) for _ in range(3)), strict=True))
    env.close()
    return float(turned / rest)


def drawn_machines() -> dict[str, float]:
    """Return the processor time of a reset that draws another machine, and the ratio of episodes with and without."""
    drawn, reused = (gym.make("edmsim/GapFeed-v2", resolution="fast", machine_episodes=n) for n in (1, 2 * RESETS))
    for env in (drawn, reused):
        env.reset(seed=0)
    drawn_s, reused_s = (spent_s(env.reset, RESETS) / RESETS for env in (drawn, reused))
    action = np.zeros(reused.action_space.shape or (), np.float32)

    def episode() -> None:
        reused.reset()
        over = False
        while not over:
            *_, terminated, truncated, _ = reused.step(action)
            over = terminated or truncated

    episode_s = spent_s(episode, EPISODES) / EPISODES
    return {"drawn_reset_ms": drawn_s * 1e3, "drawn_machines_cost": (episode_s - reused_s + drawn_s) / episode_s}


def _best_rate(step: Callable[[], object], clock: Callable[[], float]) -> float:
    steps = settled(step)
    return steps / min(spent_s(step, steps, clock) for _ in range(SLICES))


def settled(step: Callable[[], object]) -> int:
    """Run environments to a steady state, and return the number of steps per spell."""
    return max(1, round(SLICE_S / spent_s(step, SETTLE_STEPS, time.perf_counter) * SETTLE_STEPS))


def half_cheetah_comparison() -> dict[str, float]:
    """Return steps per second of `NUM_ENVS` environments at ``fast`` and of as many HalfCheetah-v5, by turns.

    Raises `InputError` if ``gymnasium[mujoco]`` is not installed, which is in the extra ``test``.
    """
    cheetahs = _half_cheetahs(NUM_ENVS)
    best = [np.inf, np.inf]
    with straight_cuts(NUM_ENVS, "fast") as ours:
        steps = [ours, cheetahs]
        spells = [settled(step) for step in steps]
        for _ in range(SLICES):
            for k, (step, spell) in enumerate(zip(steps, spells, strict=True)):
                best[k] = min(best[k], spent_s(step, spell, time.perf_counter) / spell)
    names = "vector_env_steps_per_s_fast", "half_cheetah_vector_steps_per_s"
    return {name: NUM_ENVS / step_s for name, step_s in zip(names, best, strict=True)}


def _half_cheetahs(count: int) -> Callable[[], object]:
    """Return the step of Gymnasium's default vector environment of HalfCheetah-v5: in turn, in one process."""
    with half_cheetahs():
        env: Any = gym.make_vec("HalfCheetah-v5", num_envs=count, max_episode_steps=-1)
    env.reset(seed=0)
    actions = np.full(env.action_space.shape, 0.1, np.float32)
    return lambda: env.step(actions)


@contextmanager
def half_cheetahs() -> Iterator[None]:
    """Suppress MuJoCo's warnings about HalfCheetah-v5's model; raise `InputError` if it is not installed.

    Ctrl-C is delayed to the end of the block, because it would abort the process in a warning's callback.
    """
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        with noted() as signals:
            yield
            signals.raise_noted()
    except (ImportError, gym.error.DependencyNotInstalled) as error:
        raise InputError(
            'HalfCheetah-v5, which edmsim is compared with, is missing: pip install "gymnasium[mujoco]"'
        ) from error
    finally:
        mujoco.set_mju_user_warning(None)


CUT_WINDOWS = 100
CUT_SETTLE_WINDOWS = 300
"""Windows before timing, until the wire cuts."""
CALLS = 5000
_FROM_UM, _TO_UM = (30_000, 30_000), (36_000, 33_000)


def _cut(controller: str, planner: str = "poscal") -> Simulation:
    """Return a cut in progress along an oblique line, so that both motors step."""
    points_um = np.array([_FROM_UM, _TO_UM], np.int64)
    contour = WireContour(points_um, 0, points_um.astype(np.float64) * 1e-3, False, "left", (), (1,))
    path = CutPath((contour,), (25.0, 25.0, 40.0, 40.0), 0.13, (30.0, 30.0), (), "bench")
    cut = Simulation(Machine.load(), path, make(controller), seed=0, planner=planner)
    spent_s(cut.step, CUT_SETTLE_WINDOWS)
    return cut


def controller_overhead() -> float:
    """Return the increase of a cut's processor time by the registers: `mcu` over `counts`, less 1, at `default`.

    Both make the same cut, alternately.
    """
    law, whole = _cut("counts"), _cut("mcu")
    times = [(spent_s(law.step, CUT_WINDOWS), spent_s(whole.step, CUT_WINDOWS)) for _ in range(REPEATS)]
    return min(t for _, t in times) / min(t for t, _ in times) - 1


def literal_realtime_factor() -> float:
    """Return machine time over processor time in a cut whose steps the timers of 1982 make, at `default`."""
    cut = _cut("mcu", "poscal-literal")
    return CUT_WINDOWS * cut.plant.window_ns * 1e-9 / best_s(cut.step, CUT_WINDOWS)


def poscal_calls_per_s() -> float:
    """Return calls of POSCAL per second of processor time, with displacements of all lengths."""
    rng = np.random.default_rng(0)
    places = rng.integers(0, 65_536, (CALLS, 2, 2)) >> rng.integers(0, 12, (CALLS, 1, 1))
    pairs = [((ax, ay), (bx, by)) for (ax, ay), (bx, by) in places.tolist()]
    return CALLS / best_s(lambda: [poscal(position, target, 127) for position, target in pairs])


SPAN_S = 1.0  # simulated time of a drive's run
SERVO_REPEATS = 6  # runs per figure of a servo


def drive_realtime_factor(name: str) -> float:
    """Return simulated time over processor time of a drive that moves an axis forwards and backwards."""
    bench = AxisBench({"x": tuned(name)})
    bench.run(0.1)
    least_s = float("inf")
    for _ in range(SERVO_REPEATS):
        bench.steps("x", 100, 300.0, 3_000.0)
        bench.steps("x", -100, 300.0, 3_000.0)
        least_s = min(least_s, spent_s(lambda: bench.run(SPAN_S)))
    return SPAN_S / least_s


POINTS = 1_000_000
"""Points of the cam table."""
LOOKUPS = 2000
"""Lookups of the cam table."""


def elcam_figures() -> dict[str, float]:
    """Return the processor time to load a cam table of a million points, in s, and of a cycle with it, in us."""
    points = np.column_stack([np.arange(POINTS, dtype=float), np.arange(POINTS) % 7.0])
    data, master = points.tobytes(), CamPlace()
    elcam = Elcam([CamPlace(), master], buffer_bytes=len(data))
    at = elcam.at(0)
    for function, value in ((Function.BUFFER_SIZE, POINTS), (Function.AXIS, 0), (Function.MASTER, 1)):
        at.write_int(function, value)
    started = time.process_time()
    code = at.load(data)
    status = at.write_int(Function.MODE, Mode.RUN)
    load_s = time.process_time() - started
    if code or status:
        raise EdmsimError(f"a cam table of {POINTS} points was refused: {code!r}, {status!r}")
    started = time.process_time()
    for k in range(LOOKUPS):
        master.setpoint = 7919.7 * k % POINTS
        elcam.follow()
    return {"elcam_load_s": load_s, "elcam_lookup_us": (time.process_time() - started) / LOOKUPS * 1e6}
