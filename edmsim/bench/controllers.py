"""Speed of controllers: the computer of 1982, servo drives, a positioner, cam tables; figures of ``edmsim bench``."""

from __future__ import annotations

import time

import numpy as np

from edmsim.axis_bench import AxisBench
from edmsim.bench.plant import REPEATS, best_s
from edmsim.controllers import make
from edmsim.controllers.axis import CHIPS, tuned
from edmsim.controllers.axis.elcam.module import CamPlace, Elcam
from edmsim.controllers.axis.elcam.registers import Function, Mode
from edmsim.controllers.mcu.firmware.poscal import poscal
from edmsim.cosim.simulation import Simulation
from edmsim.errors import EdmsimError
from edmsim.machine.machine import Machine
from edmsim.program.path import CutPath, WireContour

WINDOWS = 100
SETTLE_WINDOWS = 300
"""Windows before timing, until the wire cuts."""
CALLS = 5000
_FROM_UM, _TO_UM = (30_000, 30_000), (36_000, 33_000)


def _cut(controller: str, planner: str = "poscal") -> Simulation:
    """Return a cut in progress, along an oblique line: both motors step."""
    points_um = np.array([_FROM_UM, _TO_UM], np.int64)
    contour = WireContour(points_um, 0, points_um.astype(np.float64) * 1e-3, False, "left", (), (1,))
    path = CutPath((contour,), (25.0, 25.0, 40.0, 40.0), 0.13, (30.0, 30.0), (), "bench")
    cut = Simulation(Machine.load(), path, make(controller), seed=0, planner=planner)
    _advance(cut, SETTLE_WINDOWS)
    return cut


def _advance(cut: Simulation, windows: int) -> None:
    for _ in range(windows):
        cut.step()


def _run_s(cut: Simulation, windows: int) -> float:
    started = time.process_time()
    _advance(cut, windows)
    return time.process_time() - started


def controller_overhead() -> float:
    """Share of a cut's processor time that the registers add: `mcu` over `counts`, less 1, at the default resolution.

    Both cut the same, by turns.
    """
    law, whole = _cut("counts"), _cut("mcu")
    times = [(_run_s(law, WINDOWS), _run_s(whole, WINDOWS)) for _ in range(REPEATS)]
    return min(t for _, t in times) / min(t for t, _ in times) - 1


def literal_realtime_factor() -> float:
    """Simulated seconds per second of the processor in a cut whose steps the timers of 1982 make, at `default`."""
    cut = _cut("mcu", "poscal-literal")
    return WINDOWS * cut.plant.window_ns * 1e-9 / best_s(lambda: _advance(cut, WINDOWS))


def poscal_calls_per_s() -> float:
    """Calls of POSCAL in a second of the processor, over displacements of all lengths."""
    rng = np.random.default_rng(0)
    places = rng.integers(0, 65_536, (CALLS, 2, 2)) >> rng.integers(0, 12, (CALLS, 1, 1))
    pairs = [((ax, ay), (bx, by)) for (ax, ay), (bx, by) in places.tolist()]

    def call_all() -> None:
        for position, target in pairs:
            poscal(position, target, 127)

    return CALLS / best_s(call_all)


SPAN_S = 1.0  # simulated time of such a run
SERVO_REPEATS = 6  # runs per figure of a servo


def servo_realtime_factor() -> float:
    """Simulated seconds per second of the processor: the slower of two drives that move an axis to and fro."""
    return min(_factor(name) for name in CHIPS)


def positioner_realtime_factor() -> float:
    """Simulated seconds per second of the processor: an EANPOS at a sample of 1 ms that moves an axis to and fro."""
    return _factor("eanpos")


def _factor(name: str) -> float:
    bench = AxisBench({"x": tuned(name)})
    bench.run(0.1)
    least_s = float("inf")
    for _ in range(SERVO_REPEATS):
        bench.steps("x", 100, 300.0, 3_000.0)
        bench.steps("x", -100, 300.0, 3_000.0)
        started = time.process_time()
        bench.run(SPAN_S)
        least_s = min(least_s, time.process_time() - started)
    return SPAN_S / least_s


POINTS = 1_000_000
"""Points of the table."""
LOOKUPS = 2000
"""Places looked up."""


def elcam_figures() -> dict[str, float]:
    """Processor time: seconds to load a table of a million points, microseconds of a cycle that follows it."""
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
