"""What a window of pulses was, as Python sees it, and how one leaves the model's range."""

from __future__ import annotations

import math
import struct
from collections import namedtuple
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.axis_rows import N_AXES, N_CHANNELS
from edmsim.errors import EdmsimError
from edmsim.plant.kernel.state import ARC, INSIDE, NOT_FINITE, OPEN, OUTSIDE, SHORT, SPARK, WINDOW

_COLUMNS = [
    (f"{name}{k}" if WINDOW[name].shape else name, "q" if WINDOW[name].base.kind == "i" else "d")
    for name in WINDOW.names or ()
    for k in range(math.prod(WINDOW[name].shape))
]
_FORMAT = struct.Struct("=" + "".join(code for _, code in _COLUMNS))
_Row = cast(Any, namedtuple)("_Row", [name for name, _ in _COLUMNS])
"""A `state.WINDOW` as plain numbers by name; a vector's are numbered."""


class PulseWindow(NamedTuple):
    """What happened in one window of pulses. Gap, deflection, temperature and debris no real machine sees.

    Attributes
    ----------
    start_ns, duration_ns : int
        Machine time at the window's begin, and its length.
    short, open, spark, arc : int
        Pulses of each class; they add up to 255 unless the wire broke.
    mean_voltage_V, mean_current_A : float
        Means over the window.
    mean_delay_us : float
        Mean ignition delay of the pulses that ignited; NaN if none did.
    gap_um : float
        Mean gap at the places of ignition; NaN if none.
    deflection_um : (float, float)
        Mean deflection of the wire over height and time.
    vibration2_um2 : float
        Variance of that deflection within the window, both axes added.
    wire_temperature_K : float
        Highest temperature of a slice's wire.
    debris : float
        Mean debris share of the gap's water.
    energy_J, crater_um3 : float
        Sums over the window's discharges.
    broken : bool
        The wire broke in this window.
    """

    start_ns: int
    duration_ns: int
    short: int
    open: int
    spark: int
    arc: int
    mean_voltage_V: float
    mean_current_A: float
    mean_delay_us: float
    gap_um: float
    deflection_um: tuple[float, float]
    vibration2_um2: float
    wire_temperature_K: float
    debris: float
    energy_J: float
    crater_um3: float
    broken: bool

    @property
    def pulses(self) -> int:
        """Pulses fired in the window: 255 unless the wire broke."""
        return self.short + self.open + self.spark + self.arc


class PlantError(EdmsimError):
    """The simulated machine left the range its model holds for.

    Attributes
    ----------
    time_s : float
        Machine time at the end of the window in which that was seen.
    place_um : (float, float)
        Where the motor steps had commanded the wire.
    window : PulseWindow
        What the window had counted and measured.
    """

    def __init__(self, reason: str, time_s: float, place_um: tuple[float, float], window: PulseWindow) -> None:
        super().__init__(reason)
        self.time_s = time_s
        self.place_um = place_um
        self.window = window


class WireLostError(PlantError):
    """The wire was bent further than a wire between guides can be."""


class WireInMetalError(PlantError):
    """The wire was driven into the metal faster than it can be pushed back."""


class NotFiniteError(PlantError):
    """A value of the simulation is infinite or no number."""


_LEFT: dict[int, tuple[type[PlantError], str]] = {
    NOT_FINITE: (NotFiniteError, "a value of the simulation is not finite"),
    OUTSIDE: (WireLostError, "the wire left its guides"),
    INSIDE: (WireInMetalError, "the wire was driven deeper into the metal than its rays see"),
}


def read_window(row: memoryview) -> PulseWindow:
    """Return a window from the bytes of its `state.WINDOW`."""
    w = _Row._make(_FORMAT.unpack_from(row))
    counts = w.counts0, w.counts1, w.counts2, w.counts3
    open_, spark, arc, short = counts[OPEN], counts[SPARK], counts[ARC], counts[SHORT]
    pulses = open_ + spark + arc + short
    mean_x, mean_y = w.deflection_um0 / pulses, w.deflection_um1 / pulses
    return PulseWindow(
        start_ns=w.start_ns, duration_ns=w.duration_ns, short=short, open=open_, spark=spark, arc=arc,
        mean_voltage_V=w.voltage_us / (w.duration_ns * 1e-3),
        mean_current_A=w.charge_A_us / (w.duration_ns * 1e-3),
        mean_delay_us=w.delay_us / w.ignitions if w.ignitions else math.nan,
        gap_um=w.gap_um / w.ignitions if w.ignitions else math.nan,
        deflection_um=(mean_x, mean_y),
        vibration2_um2=max(0.0, (w.deflection2_um20 + w.deflection2_um21) / pulses - mean_x**2 - mean_y**2),
        wire_temperature_K=w.temperature_max_K, debris=w.debris, energy_J=w.energy_J, crater_um3=w.crater_um3,
        broken=bool(w.broken),
    )


def left_validity(
    status: int, window: PulseWindow, time_s: float, commanded_um: tuple[float, float]
) -> PlantError:
    """Return the error that tells how a window left the model's range, when and where."""
    kind, what = _LEFT[status]
    (x, y), (bent_x, bent_y) = commanded_um, window.deflection_um
    return kind(
        f"{what} at {time_s:.4f} s of machine time, x {x / 1e3:.3f} y {y / 1e3:.3f} mm: "
        f"mean deflection ({bent_x:.3g}, {bent_y:.3g}) um; of {window.pulses} pulses {window.short} short, "
        f"{window.open} open, {window.spark} sparks",
        time_s, (x, y), window,
    )


def wrong_step(rows: NDArray[np.int64], now_ns: int, lines: bool) -> str:
    """Say which step the loop refused; with `lines`, drives have input lines, too."""
    before = now_ns
    for time_ns, axis, direction in rows.tolist():
        is_step = axis in range(N_AXES) and direction in (-1, 1)
        is_line = lines and axis in range(N_AXES, N_CHANNELS) and direction in (0, 1)
        if not (is_step or is_line):
            return f"a step needs axis 0 to {N_AXES - 1} and direction +1 or -1, not {axis} and {direction}"
        if time_ns < before:
            return f"the step at {time_ns} ns lies before {before} ns: steps come in order of time"
        before = time_ns
    raise AssertionError("the loop refused steps in which nothing is wrong")
