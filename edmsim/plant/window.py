"""The results of a window of pulses in Python, and the errors of a plant that leaves the model's range."""

import math
import struct

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.axis_rows import N_AXES, N_CHANNELS
from edmsim.errors import EdmsimError, InputError
from edmsim.machine.pulse_window import PulseWindow
from edmsim.plant.axes.drives import Drives
from edmsim.plant.kernel.state import BROKEN, FREE, GRID, INSIDE, NOT_FINITE, OPEN, OUTSIDE, PULSE, WINDOW, Timing

_NAMES = tuple(name for name in WINDOW.names or () if name != FREE)
_KINDS = [WINDOW[name] for name in _NAMES]
_NAN = math.nan
_FORMAT = struct.Struct("=" + "".join(f"{math.prod(of.shape)}{'q' if of.base.kind == 'i' else 'd'}" for of in _KINDS))
"""`state.WINDOW` as Python numbers."""
_READ = (
    "start_ns", "duration_ns", "counts", "voltage_us", "charge_A_us", "energy_J", "delay_us", "ignitions", "gap_um",
    "crater_um3", "deflection_um", "deflection2_um2", "temperature_max_K", "debris", "coverage",
    "broken", "fifths",
)  # fmt: skip
"""Fields in the order of `read_window`: with keyword arguments a window would take 1 % longer."""
if _NAMES != _READ:
    raise TypeError(f"read_window reads {_READ}, and WINDOW has {_NAMES}")


class PlantError(EdmsimError):
    """The simulated machine left the range of validity of the model.

    Attributes
    ----------
    time_s : float
        Machine time at the end of that window.
    place_um : (float, float)
        Commanded position of the wire.
    window : PulseWindow
        Counts and measurements of that window.
    """

    def __init__(self, reason: str, time_s: float, place_um: tuple[float, float], window: PulseWindow) -> None:
        super().__init__(reason)
        self.time_s = time_s
        self.place_um = place_um
        self.window = window


class WireBrokenError(PlantError):
    """The wire broke in an earlier window."""


class WireLostError(PlantError):
    """The wire is bent further than a wire between guides can be."""


class WireInMetalError(PlantError):
    """The wire was driven into the metal faster than it can be pushed back."""


class NotFiniteError(PlantError):
    """A value of the simulation is infinite or not a number."""


_LEFT: dict[int, tuple[type[PlantError], str]] = {
    NOT_FINITE: (NotFiniteError, "a value of the simulation is not finite"),
    OUTSIDE: (WireLostError, "the wire left its guides"),
    INSIDE: (WireInMetalError, "the wire was driven deeper into the metal than its rays see"),
}


def read_window(row: memoryview) -> PulseWindow:
    """Return a window from the bytes of its `state.WINDOW`; raises `InputError` if they are invalid."""
    (
        start, duration, open_, spark, arc, short, voltage, charge, energy, delay, ignitions, gap, crater,
        x, y, xx, yy, hottest, debris, coverage, broken, bottom, second, third, fourth, top,
    ) = _FORMAT.unpack_from(row)
    pulses = open_ + spark + arc + short
    if pulses == 0:
        raise InputError("the plant has had no window yet: advance it first")
    mean_x, mean_y, duration_us = x / pulses, y / pulses, duration * 1e-3
    variance = (xx + yy) / pulses - mean_x**2 - mean_y**2
    return PulseWindow(
        start, duration, short, open_, spark, arc, voltage / duration_us, charge / duration_us,
        delay / ignitions if ignitions else _NAN, gap / ignitions if ignitions else _NAN, (mean_x, mean_y),
        variance if variance > 0.0 else 0.0,
        hottest, debris, coverage, energy, crater, broken != 0, (bottom, second, third, fourth, top),
    )  # fmt: skip


def without_wire(window: PulseWindow, timing: Timing) -> NDArray[np.void]:
    """Return the pulses of a window without a wire (rows of `state.PULSE`): all open."""
    pulses = np.zeros(window.pulses, PULSE)
    pulses["start_us"] = np.arange(window.pulses) * window.duration_ns * 1e-3 / window.pulses
    pulses["delay_us"], pulses["open_V"], pulses["kind"] = timing.wait_us, timing.open_V, OPEN
    pulses["slice"] = pulses["ray"] = -1
    for name in ("gap_um", "x_um", "y_um"):
        pulses[name] = np.nan
    return pulses


def left_validity(status: int, window: PulseWindow, time_s: float, commanded_um: tuple[float, float]) -> PlantError:
    """Return the error of a window that did not begin, or left the model's range, with its cause, time and place."""
    if status == BROKEN:
        reason = "the wire is broken: thread a new one (Plant.rethread), or begin again (Plant.reset)"
        return WireBrokenError(reason, time_s, commanded_um, window)
    kind, what = _LEFT[status]
    (x, y), (bent_x, bent_y) = commanded_um, window.deflection_um
    return kind(
        f"{what} at {time_s:.4f} s of machine time, x {x / 1e3:.3f} y {y / 1e3:.3f} mm: "
        f"mean deflection ({bent_x:.3g}, {bent_y:.3g}) um; of {window.pulses} pulses {window.short} short, "
        f"{window.open} open, {window.spark} sparks",
        time_s, (x, y), window,
    )


def wrong_step(rows: NDArray[np.int64], now_ns: int, lines: bool) -> str:
    """Return a message for an invalid step, or an empty text; with `lines`, drives have input lines, too."""
    before = now_ns
    for time_ns, axis, direction in rows.tolist():
        is_step = axis in range(N_AXES) and direction in (-1, 1)
        is_line = lines and axis in range(N_AXES, N_CHANNELS) and direction in (0, 1)
        if not (is_step or is_line):
            return f"a step needs axis 0 to {N_AXES - 1} and direction +1 or -1, not {axis} and {direction}"
        if time_ns < before:
            return f"the step at {time_ns} ns lies before {before} ns: steps come in order of time"
        before = time_ns
    return ""


def pass_window(
    state: NDArray[np.void], window: NDArray[np.void], drives: Drives, timing: Timing, events: NDArray[np.int64],
    step_um: float, pulses: int,
) -> None:
    """Let pulses without a wire pass, open ones of the longest wait; the axes move as in a rapid."""
    if wrong := wrong_step(events, int(state["time_ns"][0]), drives.axes.loops > 0):
        raise InputError(wrong)
    period_ns = timing.period_ns
    if period_ns == 0:
        spans = min(int((timing.wait_us + timing.pause_us) / timing.grid_us + 0.5), GRID)
        period_ns = int(spans * timing.grid_us * 1e3 + 0.5)
    start_ns, duration_ns = int(state["time_ns"][0]), pulses * period_ns
    drives.follow(state, events, start_ns + duration_ns, step_um)
    state["time_ns"] += duration_ns
    state["pulses"] += pulses
    window[:] = 0
    window["start_ns"], window["duration_ns"] = start_ns, duration_ns
    window["counts"][0, OPEN] = pulses
    window["temperature_max_K"] = np.nan  # there is no wire
    window["voltage_us"] = pulses * timing.open_V * timing.wait_us
