"""All figures of ``edmsim bench``: speed of the pulse loop, of environments, controllers, serial ports, trainings."""

import os
import select
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

import edmsim
from edmsim import axis_bench, errors, screen, signals
from edmsim.bench import profile, revisions, workloads
from edmsim.closed_loop.simulation import Simulation
from edmsim.compiled import jit, vectors
from edmsim.controllers.axis.elcam import module, table
from edmsim.controllers.mcu.firmware.poscal import poscal
from edmsim.hil.boards import BOARDS, Rig
from edmsim.plant.constants import gap_law
from edmsim.plant.gap import breakdown, generator, rays
from edmsim.plant.mechanics.engine import mujoco
from edmsim.program.path import CutPath, WireContour

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
    return min(workloads.spent_s(run, times) for _ in range(REPEATS))


def pulses_per_s(resolution: str) -> tuple[float, edmsim.Plant]:
    """Return pulses per second of one core in a straight cut, and the plant after it."""
    plant = workloads.new_plant(resolution=resolution)
    window = workloads.straight_cut(plant, workloads.SETTLE_WINDOWS)
    return TIMED_WINDOWS * workloads.PULSES / best_s(window, TIMED_WINDOWS), plant


def mujoco_realtime_factor() -> float:
    """Return machine time over processor time if MuJoCo moves wire and table, at `default` and 10 kHz."""
    plant = workloads.new_plant(mechanics="mujoco")
    return MUJOCO_WINDOWS * plant.window_ns * 1e-9 / best_s(workloads.straight_cut(plant, 1), MUJOCO_WINDOWS)


@jit.compiled
def _sum_rays(rays: rays.Rays, law: breakdown.GapLaw, sums: np.ndarray, pulses: int) -> float:
    """Compute the sums over rays, the part of a pulse that every plant of this kind needs; return a total."""
    total = 0.0
    for pulse in range(pulses):
        for s in range(0, rays.distance.shape[0], vectors.PACK):  # sums of `PACK` slices
            shift = 1e-3 * (pulse % 7)
            breakdown.slice_sums(rays, s, shift, shift, law, sums)
            total += sums[s, 0] + sums[s, 2] + sums[s, 3]
    return total


def ray_sums_per_s(plant: edmsim.Plant) -> float:
    """Return pulses per second if a pulse consisted only of the sums over its rays: the bound of this design."""
    around, law, sums = *_rays_and_law(plant), np.zeros((plant.resolution.slices, 4))
    pulses = TIMED_WINDOWS * workloads.PULSES // 2
    _sum_rays(around, law, sums, 1)
    return pulses / best_s(lambda: _sum_rays(around, law, sums, pulses))


def _rays_and_law(plant: edmsim.Plant) -> tuple[rays.Rays, breakdown.GapLaw]:
    return plant.rays(), gap_law(plant.machine, plant.resolution, generator.timing(plant.machine).open_V)


def _together(works: Sequence[Callable[[], object]]) -> float:
    """Return the calls per second of all works together, each repeated in its own thread."""
    end_s = time.monotonic() + THREAD_S

    def run(work: Callable[[], object]) -> int:
        rounds = 0
        while time.monotonic() < end_s:
            work()
            rounds += 1
        return rounds

    with ThreadPoolExecutor(len(works)) as threads:
        return sum(threads.map(run, works)) / THREAD_S


def thread_scaling() -> tuple[float, float]:
    """Return the gain of two threads over one: of two plants, and of two loops that only compute.

    The second is the gain of the processors alone (1.2 if two share a core), for comparison with the first.
    """
    plants = [edmsim.Plant(edmsim.Machine.load(), seed=seed) for seed in range(2)]
    advance = [workloads.straight_cut(plant, workloads.SETTLE_WINDOWS) for plant in plants]
    around, law, sums = *_rays_and_law(plants[0]), np.zeros((2, plants[0].resolution.slices, 4))
    compute = [lambda k=k: _sum_rays(around, law, sums[k], workloads.PULSES) for k in range(2)]
    gains = []
    for works in (advance, compute):
        alone = max(_together(works[:1]) for _ in range(2))
        gains.append(max(_together(works) for _ in range(2)) / alone)
    return gains[0], gains[1]


def memory_growth_MB() -> float:
    """Return the growth of the process's memory over `MEMORY_S`, without the tiles of the kerf field."""
    plant = workloads.new_plant(resolution="fast")
    window = workloads.straight_cut(plant, workloads.SETTLE_WINDOWS)
    before, end = _resident_MB() - plant.field.tiles.nbytes * 1e-6, plant.time_ns + MEMORY_S * 1e9
    while plant.time_ns < end:
        window()
    return _resident_MB() - plant.field.tiles.nbytes * 1e-6 - before


def _resident_MB() -> float:
    """Return the memory used by this process, or 0 if the system does not report it."""
    with suppress(OSError):
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") * 1e-6
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
        "realtime_factor": default * edmsim.Machine.load().t_period_us * 1e-6,  # at `default`
        "pulses_per_s_fast": pulses_per_s("fast")[0],
        "pulses_per_s_fine": pulses_per_s("fine")[0],
        "ray_sums_per_s": bound,  # if a pulse consisted only of them
        "ray_sum_share": default / bound,
        "mujoco_realtime_factor": mujoco_realtime_factor(),
        "servo_realtime_factor": min(drive_realtime_factor(name) for name in edmsim.controllers.axis.CHIPS),
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


NUM_ENVS = 64
SETTLE_STEPS = 400
"""Steps before timing, until the wire cuts a full kerf."""
KNOB_STEPS, RESETS, EPISODES = 100, 50, 4
SLICE_S, SLICES = 0.05, 20
"""Length and number of timed spells per figure. The fastest counts; spells are short, because the computer is more
often undisturbed for a short time."""


def env_steps_per_s() -> float:
    """Return steps per second of processor time of one environment of `gymnasium.make`, in a straight cut."""
    env = gym.make("edmsim/GapFeed-v2", **workloads.STANDARD)
    env.reset(seed=0)
    action = np.array([workloads.FEED_UM_S / workloads.MAX_FEED_UM_S], np.float32)
    rate = _best_rate(lambda: env.step(action), time.process_time)
    env.close()
    return rate


def vector_env_steps_per_s() -> float:
    """Return steps per second of a native vector environment, all sub-environments together, on all processors."""
    return NUM_ENVS * _best_rate(workloads.fleet(NUM_ENVS, 0, None, "default"), time.perf_counter)


def turned_knobs_cost() -> float:
    """Return the processor time of steps that turn two knobs of the generator at random, over that of other steps.

    On 32 drawn machines at resolution ``fast``; the wire cuts in both.
    """
    env = gym.make_vec(
        "edmsim/Corner-v3", num_envs=32, vectorization_mode="vector_entry_point", resolution="fast", action="change",
        knobs=("on_time", "period_ratio"),
    )
    env.reset(seed=0)
    turns = np.random.default_rng(0).normal(0.0, 0.35, (KNOB_STEPS, *(env.action_space.shape or ())))
    turns = np.clip(turns, -1.0, 1.0).astype(np.float32)
    turns[..., 0] = 0.0  # the feed

    def timed(share: float) -> float:
        return workloads.spent_s(lambda: [env.step(actions) for actions in turns * np.float32(share)])

    rest, turned = (min(values) for values in zip(*((timed(0.0), timed(1.0)) for _ in range(3)), strict=True))
    env.close()
    return float(turned / rest)


def drawn_machines() -> dict[str, float]:
    """Return the processor time of a reset that draws another machine, and the ratio of episodes with and without."""
    drawn, reused = (gym.make("edmsim/GapFeed-v2", resolution="fast", machine_episodes=n) for n in (1, 2 * RESETS))
    for env in (drawn, reused):
        env.reset(seed=0)
    drawn_s, reused_s = (workloads.spent_s(env.reset, RESETS) / RESETS for env in (drawn, reused))
    action = np.zeros(reused.action_space.shape or (), np.float32)

    def episode() -> None:
        reused.reset()
        over = False
        while not over:
            *_, terminated, truncated, _ = reused.step(action)
            over = terminated or truncated

    episode_s = workloads.spent_s(episode, EPISODES) / EPISODES
    return {"drawn_reset_ms": drawn_s * 1e3, "drawn_machines_cost": (episode_s - reused_s + drawn_s) / episode_s}


def _best_rate(step: Callable[[], object], clock: Callable[[], float]) -> float:
    steps = settled(step)
    return steps / min(workloads.spent_s(step, steps, clock) for _ in range(SLICES))


def settled(step: Callable[[], object]) -> int:
    """Run environments to a steady state, and return the number of steps per spell."""
    return max(1, round(SLICE_S / workloads.spent_s(step, SETTLE_STEPS, time.perf_counter) * SETTLE_STEPS))


def half_cheetah_comparison() -> dict[str, float]:
    """Return steps per second of `NUM_ENVS` environments at ``fast`` and of as many HalfCheetah-v5, by turns.

    Raises `InputError` if ``gymnasium[mujoco]`` is not installed, which is in the extra ``test``.
    """
    cheetahs = _half_cheetahs(NUM_ENVS)
    steps = {
        "vector_env_steps_per_s_fast": workloads.fleet(NUM_ENVS, 0, None), "half_cheetah_vector_steps_per_s": cheetahs
    }
    spells, best_s = {name: settled(step) for name, step in steps.items()}, dict.fromkeys(steps, np.inf)
    for _ in range(SLICES):
        for name, step in steps.items():
            step_s = workloads.spent_s(step, spells[name], time.perf_counter) / spells[name]
            best_s[name] = min(best_s[name], step_s)
    return {name: NUM_ENVS / step_s for name, step_s in best_s.items()}


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
        with signals.noted() as pending:
            yield
            pending.raise_noted()
    except (ImportError, gym.error.DependencyNotInstalled) as error:
        raise errors.InputError(
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
    cut = Simulation(edmsim.Machine.load(), path, edmsim.controllers.make(controller), seed=0, planner=planner)
    workloads.spent_s(cut.step, CUT_SETTLE_WINDOWS)
    return cut


def controller_overhead() -> float:
    """Return the increase of a cut's processor time by the registers: `mcu` over `counts`, less 1, at `default`.

    Both make the same cut, alternately.
    """
    cuts = _cut("counts"), _cut("mcu")
    times = [[workloads.spent_s(cut.step, CUT_WINDOWS) for cut in cuts] for _ in range(REPEATS)]
    law_s, whole_s = np.min(times, axis=0).tolist()
    return float(whole_s / law_s - 1)


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
    bench = axis_bench.AxisBench({"x": edmsim.controllers.axis.tuned(name)})
    bench.run(0.1)
    least_s = float("inf")
    for _ in range(SERVO_REPEATS):
        bench.steps("x", 100, 300.0, 3_000.0)
        bench.steps("x", -100, 300.0, 3_000.0)
        least_s = min(least_s, workloads.spent_s(lambda: bench.run(SPAN_S)))
    return SPAN_S / least_s


POINTS = 1_000_000
"""Points of the cam table."""
LOOKUPS = 2000
"""Lookups of the cam table."""


def elcam_figures() -> dict[str, float]:
    """Return the processor time to load a cam table of a million points, in s, and of a cycle with it, in us."""
    points = np.column_stack([np.arange(POINTS, dtype=float), np.arange(POINTS) % 7.0])
    data, master = points.tobytes(), module.CamPlace()
    elcam = module.Elcam([module.CamPlace(), master], buffer_bytes=len(data))
    at, words = elcam.at(0), table.Function
    for function, value in ((words.BUFFER_SIZE, POINTS), (words.AXIS, 0), (words.MASTER, 1)):
        at.write_int(function, value)
    started = time.process_time()
    code = at.load(data)
    status = at.write_int(words.MODE, table.Mode.RUN)
    load_s = time.process_time() - started
    if code or status:
        raise errors.EdmsimError(f"a cam table of {POINTS} points was refused: {code!r}, {status!r}")
    started = time.process_time()
    for k in range(LOOKUPS):
        master.setpoint = 7919.7 * k % POINTS
        elcam.follow()
    return {"elcam_load_s": load_s, "elcam_lookup_us": (time.process_time() - started) / LOOKUPS * 1e6}


ROUND_TRIPS, PAUSE_S = 1000, 0.003
"""Queries, and the pause between two (ours: not a multiple of a frame, so that they come at any time in it)."""
MACHINE_S, SETTLE_S = 20.0, 1.0
BOARD_VEL = "VEL 4 0"
_WAIT_S = 10.0


def serial_figures(watch: Callable[[str], None]) -> dict[str, float]:
    """Return every board's machine time over processor time, and round trips at a serial port and the axes' port."""
    found: dict[str, float] = {}
    for name in BOARDS:
        watch(f"{name}: {MACHINE_S:g} s of machine time")
        found[f"{name}_realtime_factor"] = _board_realtime_factor(name)
    for name, port, line in (
        ("spark", "the board's serial port", b"r 1\n"), ("powercore", "the axes' port", b"?\n")
    ):  # fmt: skip
        watch(f"{name}: {ROUND_TRIPS} questions")
        times_ms = 1e3 * _round_trips(name, port, line)
        for title, share in (("median", 0.5), ("p99", 0.99), ("greatest", 1.0)):
            found[f"{name}_round_trip_{title}_ms"] = float(np.quantile(times_ms, share))
    return found


def _board_realtime_factor(name: str) -> float:
    rig = Rig(name, seed=1)
    rig.send("w 1 1")  # because a pulser is off at first
    rig.move(BOARD_VEL)
    rig.run(SETTLE_S)
    began_s, from_s = rig.time_s, time.process_time()
    while rig.time_s < began_s + MACHINE_S:
        rig.move(BOARD_VEL)
        rig.run(0.1)
        rig.board.unsolicited()
    return (rig.time_s - began_s) / (time.process_time() - from_s)


def _round_trips(name: str, port: str, line: bytes) -> np.ndarray:
    command = [sys.executable, "-m", "edmsim", "gap", "--serial", name]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as bench:
        try:
            assert bench.stderr is not None
            said = [bench.stderr.readline() for _ in range(2)]
            places = [rest.split()[0].rstrip(";") for one in said if (rest := one.partition(f"{port} is ")[2])]
            if not places:
                raise errors.EdmsimError(f"the bench did not begin: {said[0].strip()}")
            return _query(places[0], line)
        finally:
            bench.terminate()


def _query(place: str, line: bytes) -> np.ndarray:
    import tty  # not on every system

    end = os.open(place, os.O_RDWR | os.O_NOCTTY)
    try:
        tty.setraw(end)
        time.sleep(0.5)
        times = np.empty(ROUND_TRIPS)
        for k in range(ROUND_TRIPS):
            began, heard = time.perf_counter(), b""
            os.write(end, line)
            while not heard.endswith(b"\n"):
                if not select.select([end], [], [], _WAIT_S)[0]:
                    raise errors.EdmsimError(f"no answer within {_WAIT_S:g} s")
                heard += os.read(end, 4096)
            times[k] = time.perf_counter() - began
            time.sleep(PAUSE_S)
        return times
    finally:
        os.close(end)


TRAINED_COUNTS = (64, 256)
"""Numbers of environments."""
ROLLOUT = 64
"""Steps of each environment between two updates."""
LEARNERS: dict[str, dict[str, int]] = {"": {"batch_size": 2048, "n_epochs": 5}, "default_": {}}
"""Updates of PPO by the beginning of the figures' names: those of docs/training.md, which take little time, and the
defaults of stable-baselines3, batches of 64 and 10 epochs."""
SPELLS = 3
"""Timed rollouts with their updates; the fastest counts, because other programs use the machine, too."""


def training_figures(watch: Callable[[str], None], counts: Sequence[int] = TRAINED_COUNTS) -> dict[str, float]:
    """Return steps per second of trainings (wall-clock time), and the environments' share of that time.

    The learner is PPO of stable-baselines3, with each of `LEARNERS`. It steps all environments of edmsim in one
    compiled call, and those of HalfCheetah-v5 in turn in one process.
    """
    try:
        from stable_baselines3.common.vec_env import DummyVecEnv
    except ImportError as error:
        raise errors.InputError(f"the speed of trainings needs {error.name}: pip install 'edmsim[rl]'") from error

    found: dict[str, float] = {}
    for count in counts:
        watch(f"first rollouts of {count} environments")
        with half_cheetahs():
            cheetahs = DummyVecEnv([lambda: gym.make("HalfCheetah-v5")] * count)
        ours = edmsim.envs.make_sb3_vec_env("edmsim/GapFeed-v2", num_envs=count, seed=0, machine_episodes=4)
        trainings = {
            f"{learner}{name}": _Training(vec_env, **update) for learner, update in LEARNERS.items()
            for name, vec_env in (("training", ours), ("half_cheetah_training", cheetahs))
        }  # fmt: skip
        for spell in range(SPELLS):
            watch(f"{count} environments, {spell + 1} of {SPELLS}")
            for training in trainings.values():  # by turns, so that none always runs on the warmer machine
                training.spell()
        for name, training in trainings.items():
            found[f"{name}_steps_per_s_{count}"] = training.steps_per_s
            found[f"{name}_env_share_{count}"] = training.env_share
        ours.close()
        cheetahs.close()
    return found


class _Training:
    """A learner after its first rollout: rate of its fastest spell, and the environments' share of its time."""

    def __init__(self, vec_env: Any, **update: Any) -> None:
        import stable_baselines3 as sb3
        import torch

        torch.set_num_threads(1)  # as in a training
        self._env_s, self._step_wait = 0.0, vec_env.step_wait
        vec_env.step_wait = self._timed_step
        around = sb3.common.vec_env.VecNormalize(vec_env)
        self._model = sb3.PPO("MlpPolicy", around, n_steps=ROLLOUT, device="cpu", **update)
        self._model.set_logger(sb3.common.logger.Logger(None, []))  # the default logger leaves a folder
        self._steps = ROLLOUT * vec_env.num_envs
        self._model.learn(self._steps)
        self.steps_per_s = self.env_share = 0.0

    def _timed_step(self) -> Any:
        start_s = time.perf_counter()
        found = self._step_wait()
        self._env_s += time.perf_counter() - start_s
        return found

    def spell(self) -> None:
        """Time a rollout with its update."""
        self._env_s, start_s = 0.0, time.perf_counter()
        self._model.learn(self._steps, reset_num_timesteps=False)
        took = time.perf_counter() - start_s
        if self._steps / took > self.steps_per_s:
            self.steps_per_s, self.env_share = self._steps / took, self._env_s / took


# The command.

Measured = tuple[Mapping[str, Any], screen.ScreenTable]
"""A measurement as numbers and texts only, and as a table for the terminal."""


def measured(
    watch: Callable[[str], None], against: str | None, count: int | None, shares: bool, serial: bool, training: bool,
    picture: Path | None,
) -> dict[str, Measured]:
    """Make the measurements of these options of ``edmsim bench``, or of the speed if there are none."""
    if against is None and count is not None:
        raise errors.InputError("--pairs is for a comparison: give the revision with --against")
    found: dict[str, Measured] = {}
    if shares or picture is not None:
        found["profile"] = profile.measured(picture, watch)
    if against is not None:
        found["against"] = revisions.measured(against, count, watch)
    if serial:
        found["serial"] = _listed(serial_figures(watch), "edmsim gap --serial", lambda value: f"{value:.3g}")
    if training:
        found["training"] = _listed(
            training_figures(watch), "edmsim bench --training",
            lambda value: f"{value:,.0f}" if value > 1 else f"{value:.2f}",
        )  # fmt: skip
    if not found:
        found["speed"] = _listed(
            measure(), "edmsim bench", lambda value: f"{value:,.0f}" if value > 1000 else f"{value:,.2f}"
        )
    return found


def _listed(figures: Mapping[str, float], title: str, text: Callable[[float], str]) -> Measured:
    """Return the figures, and a table with a row for each."""
    shown = screen.ScreenTable("figure", numbers=("value",), title=title)
    for name, value in figures.items():
        shown.add_row(name, text(value))
    return figures, shown
