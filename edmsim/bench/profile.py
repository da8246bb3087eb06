"""Shares of the model's parts in the time of a pulse: ``edmsim bench --profile``.

A copy of the loop is compiled with marks (`edmsim.compiled.specialised`), and a second thread samples which part
runs. It runs alternately with the loop without marks, whose time per pulse is divided by the shares
among the parts.
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

import edmsim
from edmsim import errors, files, screen
from edmsim.bench import workloads
from edmsim.compiled.specialised import marked
from edmsim.plant.kernel.memory import CALL, fire_windows
from edmsim.plant.plant import shapes
from edmsim.plant.resolution import RESOLUTIONS
from edmsim.recording.figures import palette, style

PROFILED = ("fast", "default")
"""Resolutions to profile."""
PARTS: dict[str, tuple[str, ...]] = {
    "ray sums": ("gap.pulse_outcome.sum_rays",),
    "decide": ("gap.pulse_outcome.decide",),
    "discharge": ("kernel.discharge.discharge", "kernel.discharge.short_circuit"),
    "films": tuple(f"mechanics.squeeze_film.{name}" for name in (
        "scale_film", "mean_film", "mean_resistance", "find_films", "squeeze",
    )),
    "swings": ("kernel.fire._move_wire", *(
        f"mechanics.modal.{name}" for name in ("place_wire", "project", "kick", "ring")
    )),
    "gas": tuple(f"gap.gas.{name}" for name in ("fade", "blow")),
    "heat": ("kernel.discharge.propagate_heat",),
    "retrace": ("gap.rays.retrace",),
    "carve": ("kernel.fire._carve",),
    "rest": ("kernel.memory.fire_windows",),
}  # fmt: skip
"""Parts of a pulse, and the functions of `edmsim.plant` that each consists of. Functions that these call belong to
the same part unless they are listed themselves. The rest of the loop is counters, axes, the log of pulses."""
BATCH = 50
"""Windows per compiled call: enough to exclude Python from the timing; the wire stays within its tiles."""
ROUNDS = 40
"""Alternations between the loops with and without marks in one cut."""
LOOKS = 20_000
"""Least number of samples: a share of a tenth is known to 0.4 percentage points (ours)."""
LOOK_S = 200e-6
"""Longest pause between two samples (ours); pauses are random, so that they are not in step with windows."""


class LoopProfile(NamedTuple):
    """The processor time of a straight cut's pulses, and its division among parts, at one resolution."""

    ns_per_pulse: float  # of the loop without marks
    marked_ns_per_pulse: float  # of the loop with marks
    shares: dict[str, float]  # of the time with marks, by `PARTS`; their sum is 1
    looks: int  # number of samples

    def ns(self, part: str) -> float:
        """Return a part's time per pulse."""
        return self.ns_per_pulse * self.shares[part]


class _Watch:
    """Sampler, during `looking`, of the part that runs in the thread that made it."""

    def __init__(self, part: Callable[[], int]) -> None:
        self.spent_s = np.zeros(len(PARTS) + 1)
        self.looks = 0
        self._part, self._clock = part, _clock_of(threading.get_ident())

    @contextmanager
    def looking(self) -> Iterator[None]:
        """Sample in a second thread until the block ends."""
        over = threading.Event()
        thread = threading.Thread(target=self._look, args=(over,), daemon=True)
        try:
            thread.start()
            yield
        finally:
            over.set()
            if thread.is_alive():  # it is not if an interrupt came first
                thread.join()

    def _look(self, over: threading.Event) -> None:
        """Add the processor time since the last sample to the part that runs; it is 0 if the thread waited."""
        before, rng = time.clock_gettime(self._clock), np.random.default_rng()
        while not over.is_set():
            time.sleep(rng.random() * LOOK_S)
            part, now = self._part(), time.clock_gettime(self._clock)
            self.spent_s[part] += now - before
            before = now
            self.looks += 1


def _clock_of(thread: int) -> int:
    """Return the clock of a thread's processor time."""
    try:
        return time.pthread_getcpuclockid(thread)
    except AttributeError:
        raise errors.EdmsimError("this system has no clock of a thread's processor time: profile on Linux") from None


def profile(watch: Callable[[str], None] = lambda _: None) -> dict[str, LoopProfile]:
    """Return the time of each part of a pulse in a straight cut, at each resolution of `PROFILED`."""
    named = dict(zip(RESOLUTIONS, shapes(), strict=False))  # shapes with modal mechanics come first
    names = tuple(tuple(f"edmsim.plant.{name}" for name in names) for names in PARTS.values())
    found = {}
    for resolution in PROFILED:
        watch(f"compile {resolution} with marks")
        fire, part = marked(fire_windows, *named[resolution][:3], parts=names)
        watch(f"profile {resolution}")
        found[resolution] = _profile(workloads.new_plant(resolution=resolution), fire, part)
    return found


def _profile(plant: edmsim.Plant, fire: Callable[[int, int], None], part: Callable[[], int]) -> LoopProfile:
    """Run the loops with and without marks alternately, in as many cuts as necessary."""
    look = _Watch(part)
    plain_s, marked_s = [], []
    seed = 0
    while look.looks < LOOKS:
        plant.reset(seed)
        seed += 1
        for _ in range(workloads.SETTLE_WINDOWS // BATCH):
            _fire(plant, plant.fire)
        for _ in range(ROUNDS):
            plain_s.append(_fire(plant, plant.fire))
            with look.looking():
                marked_s.append(_fire(plant, fire))
    spent_s = look.spent_s[1:]  # the first entry is the time outside the loop
    shares = dict(zip(PARTS, (spent_s / spent_s.sum()).tolist(), strict=True))
    plain_ns, marked_ns = (1e9 * float(np.median(s)) / (BATCH * workloads.PULSES) for s in (plain_s, marked_s))
    return LoopProfile(plain_ns, marked_ns, shares, look.looks)


def _fire(plant: edmsim.Plant, fire: Callable[[int, int], None]) -> float:
    """Continue the straight cut by a batch of windows; return the processor time."""
    plant.make_tiles()
    interval_ns = round(plant.machine.base.table.step_um.value * 1e9 / workloads.FEED_UM_S)
    edges_ns = plant.time_ns + plant.window_ns * np.arange(BATCH + 1)
    due_ns = np.arange(plant.time_ns + interval_ns, edges_ns[-1], interval_ns)
    steps = np.column_stack([due_ns, np.zeros_like(due_ns), np.ones_like(due_ns)])
    first = np.searchsorted(due_ns, edges_ns)
    calls = np.empty((BATCH, CALL), np.int64)
    calls[:, 0] = plant.address
    calls[:, 1] = steps.ctypes.data + first[:-1] * steps.strides[0]
    calls[:, 2] = np.diff(first)
    calls[:, 3] = workloads.PULSES
    start_s = time.thread_time()
    fire(calls.ctypes.data, BATCH)
    spent_s = time.thread_time() - start_s
    if calls[:, 4].any():
        raise errors.EdmsimError(f"the straight cut that is profiled ended early, by {calls[:, 4].max()}")
    return spent_s


def measured(
    figure: Path | None, watch: Callable[[str], None]
) -> tuple[dict[str, object], screen.ScreenTable]:
    """Return profiles as numbers and texts only, and as a table for the terminal; draw them if there is a file."""
    if figure is not None:
        style.check_figure(figure)
        files.make_writable(figure.parent)
    found = profile(watch)
    if figure is not None:
        style.write_figure(draw(found), figure)
    return {resolution: one._asdict() for resolution, one in found.items()}, render(found)


def render(found: dict[str, LoopProfile]) -> screen.ScreenTable:
    """Return the profiles as a table for the terminal."""
    numbers = [head for resolution in found for head in (f"{resolution} ns", f"{resolution} %")]
    table = screen.ScreenTable("part of a pulse", numbers=numbers, title="edmsim bench --profile, processor time")
    for part in PARTS:
        table.add_row(part, *(
            cell for one in found.values() for cell in (f"{one.ns(part):.0f}", f"{100 * one.shares[part]:.1f}")
        ))  # fmt: skip
    table.add_section()
    table.add_row("together", *(text for p in found.values() for text in (f"{p.ns_per_pulse:.0f}", "100.0")))
    table.add_row("with marks", *(text for p in found.values() for text in (f"{p.marked_ns_per_pulse:.0f}", "")))
    return table


@style.in_style
def draw(found: dict[str, LoopProfile]) -> Figure:
    """Return the profiles as a figure: a bar for each part and resolution."""
    figure = style.column_figure(3.2, left_in=0.72, top_in=0.3)
    axes = figure.add_subplot()
    high, middles = 0.8 / len(found), np.arange(len(PARTS))
    for k, (resolution, one) in enumerate(found.items()):
        places = middles + (k - (len(found) - 1) / 2) * high
        spent_ns = [one.ns(part) for part in PARTS]
        bars = axes.barh(places, spent_ns, high, color=(palette.BLUE, palette.ORANGE)[k], label=resolution)
        axes.bar_label(bars, fmt="%.0f", fontsize=style.LABEL_PT - 1.5, padding=2)
    axes.set_yticks(middles, list(PARTS))
    axes.invert_yaxis()
    axes.margins(x=0.12)
    style.dress(axes, "processor time per pulse, ns", "")
    style.legend(axes, above=True, columns=len(found))
    return figure
