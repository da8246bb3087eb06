"""The observation: a fixed list of entries that a machine can measure or its operator knows.

Entries are declared here. The compiled function `push_step` computes the entries of a step, `Entry.value` the others,
and `sub_envs.ObservationBuilder` combines them.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import exactly_compiled
from edmsim.compiled.random import normal
from edmsim.controllers.protocols import WindowObservation
from edmsim.geometry import Floats
from edmsim.machine.setting import WINDOW_PULSES, wire_speed_m_s
from edmsim.numeric import to_plain_numbers, whole_within, within
from edmsim.plant.constants import faces_Pa
from edmsim.plant.kernel.state import ARC, OPEN, SHORT, SPARK, WINDOW


@dataclass(frozen=True, kw_only=True)
class Sensors:
    """Errors of the analogue measurements of a window; the counts of pulses are digital and exact."""

    # standard deviation of mean voltage, current and ignition delay, as a share of each one's divisor in the
    # observation (ours: a moving-coil meter or an early converter has about 1 %)
    noise_share: float = 0.01
    # resolution of the converters, 1 to 16; full scale is the same divisor. 8 is the word of the 1982 machine, 0 is
    # without steps.
    bits: int = 8
    # age of observations in steps (0 by default: the 1982 analyser passes on its counts at the window's end)
    delay_steps: int = 0

    def __post_init__(self) -> None:
        """Raise `InputError` for a value that cannot be used."""
        to_plain_numbers(self)
        within("noise_share", self.noise_share, 0.0, 1.0)
        whole_within("bits", self.bits, 0, 16)
        whole_within("delay_steps", self.delay_steps, 0, 1000)

    @property
    def step(self) -> float:
        """Step of the converters, as a share of full scale; 0 for none."""
        return 1.0 / (2**self.bits - 1) if self.bits else 0.0


EXACT = Sensors(noise_share=0.0, bits=0)  # sensors without errors


class Entry(NamedTuple):
    """One entry of the observation."""

    name: str
    # range to which it is clipped
    low: float
    high: float
    # the measured quantity, and its divisor
    quantity: str
    divisor: str
    # returns the value: of an entry of the set-up from a `Machine`, of an entry after these (n,) from `Known`; None
    # for an entry of a step, which `push_step` computes
    value: Callable[..., Any] | None = None

    @property
    def meaning(self) -> str:
        """Quantity and divisor, as in the files of policies."""
        return f"{self.quantity} / {self.divisor}".replace("`", "")


MEASURED = (
    Entry("short", 0.0, 1.0, "short pulses", "pulses of the step"),
    Entry("open", 0.0, 1.0, "open pulses", "pulses of the step"),
    Entry("spark", 0.0, 1.0, "pulses that ignited; sparks and arcs look alike", "pulses of the step"),
    Entry("mean_voltage", 0.0, 1.0, "mean gap voltage, V", "open voltage, V"),
    Entry("mean_current", 0.0, 4.0, "mean gap current, A", "generator's limit of it, A"),
    Entry("mean_delay", 0.0, 1.0, "mean ignition delay, us; 1 if nothing ignited", "longest wait for it, us"),
    Entry("commanded_feed", -1.0, 1.0, "commanded feed, um/s", "``max_feed_um_s``"),
    Entry("actual_feed", -1.0, 1.0, "feed by the position counters, um/s", "``max_feed_um_s``"),
    Entry("t_on", 0.0, 1.0, "log10 of the on-time in us", "3"),
    Entry("t_period", 0.0, 1.0, "log10 of the pulse period in us", "4"),
)
"""Entries of every step; an observation has those of `history` steps, the latest first. They are 0 for steps before
the first window."""
FIFTHS = tuple(
    Entry(f"fifth_{k}", 0.0, 1.0, f"ignitions in fifth {k} of the height, from below", "ignitions of the step")
    for k in range(1, 6)
)
"""Further entries of a step if discharges are located (`Family.locates_discharges`)."""
SETUP_ENTRIES = (
    Entry("tension", 0.0, 10.0, "tension of the wire, N", "10 N", lambda m: m.tension / 10.0),
    Entry("wire_diameter", 0.0, 4.0, "diameter of the wire, um", "100 um", lambda m: m.wire_diameter_um / 100.0),
    Entry("height", 0.0, 8.0, "height of the workpiece, the greatest, mm", "50 mm", lambda m: m.height_mm / 50.0),
    # pressures after the loss of a stand-off, which a gauge at the nozzle shows, too
    Entry("flushing_lower", 0.0, 30.0, "pressure of the lower nozzle, Pa", "1 bar", lambda m: faces_Pa(m)[0] * 1e-5),
    Entry("flushing_upper", 0.0, 30.0, "pressure of the upper nozzle, Pa", "1 bar", lambda m: faces_Pa(m)[1] * 1e-5),
    Entry("wire_speed", 0.0, 15.0, "speed of the running wire, m/s", "1 m/s", wire_speed_m_s),
)
"""Entries after those of all steps: the settings of the machine that the operator knows."""


@dataclass
class Known:
    """Data of n episodes from which the entries after those of the set-up are computed."""

    rows: NDArray[np.void]
    # (n, most): length of path up to each corner, padded with infinity, and the corner's turn
    corner_um: Floats
    corner_deg: Floats
    age_s: Floats  # (n,): time of cutting with the present wire
    broke_at: Floats  # (n,): longest period per on-time at which a wire broke; 0 if none did
    offset_um: float | None  # argument of the environment
    scales: NDArray[np.void]

    @cached_property
    def ahead(self) -> tuple[Floats, Floats]:
        """Path to the next corner, 1 for `LOOK_UM` or more, and the corner's turn, 0 beyond `LOOK_UM`."""
        distance_um = self.corner_um - self.rows["path_um"][:, None]
        return self._nearest(np.where(distance_um > 0, distance_um, np.inf))

    @cached_property
    def behind(self) -> tuple[Floats, Floats]:
        """The same for the last corner."""
        distance_um = self.corner_um - self.rows["path_um"][:, None]
        return self._nearest(np.where(distance_um <= 0, -distance_um, np.inf))

    def _nearest(self, distances_um: Floats) -> tuple[Floats, Floats]:
        index, k = np.arange(len(distances_um)), distances_um.argmin(axis=1)
        nearest_um = distances_um[index, k]
        turns = np.where(nearest_um <= LOOK_UM, self.corner_deg[index, k] / 180.0, 0.0)
        return np.minimum(nearest_um / LOOK_UM, 1.0), turns


CORNERS = (
    Entry("corner_ahead", 0.0, 1.0, "path to the next corner, mm; 1 if none is nearer", "1 mm", lambda k: k.ahead[0]),
    Entry("corner_turn", -1.0, 1.0, "its turn, left positive; 0 if none is within 1 mm", "180 degrees",
          lambda k: k.ahead[1]),
    Entry("corner_behind", 0.0, 1.0, "path from the last corner, mm; 1 if none is nearer", "1 mm",
          lambda k: k.behind[0]),
    Entry("corner_turned", -1.0, 1.0, "its turn, left positive; 0 if none is within 1 mm", "180 degrees",
          lambda k: k.behind[1]),
)  # fmt: skip
"""Entries after those of the set-up if the program is known."""
OFFSET = Entry(
    "offset", -1.0, 1.0, "offset from the path, left positive, um", "``offset_um``",
    lambda k: k.rows["offset_um"] / k.offset_um,
)  # fmt: skip
"""Entry after those of set-up and corners if an action offsets the guides from the path."""
WIRES = (
    Entry("wires_lost", 0.0, 1.0, "wires that broke in the episode", "``wires``",
          lambda k: k.rows["wires_lost"] / k.scales["wires"]),
    Entry("wire_age", 0.0, 1.0, "time of cutting with the present wire, s", "60 s", lambda k: k.age_s / WIRE_AGE_S),
    Entry("spent", 0.0, 1.0, "time of cutting, s", "``episode_s``",
          lambda k: k.rows["elapsed_ns"] * 1e-9 / k.scales["episode_s"]),
    Entry("broke_at", 0.0, 1.0, "log2 of the longest period/on-time that broke", "10",
          lambda k: np.log2(np.maximum(k.broke_at, 1.0)) / 10.0),
)  # fmt: skip
"""Last entries, if an operator remembers the wires of the episode."""
WIRE_AGE_S = 60.0  # age of a wire at which its entry is 1 (ours: the time to thread one)
LOOK_UM = 1000.0
"""Length of path within which corners are observed (ours: well beyond the wire's lag and a slowdown's length)."""


_LOW = np.array([entry.low for entry in MEASURED])
_HIGH = np.array([entry.high for entry in MEASURED])
_VOLTAGE, _CURRENT, _DELAY = 3, 4, 5

STEP_SUMS = np.dtype(
    [
        ("short", "i8"),
        ("open", "i8"),
        ("ignited", "i8"),
        ("arc", "i8"),  # ignited pulses that were arcs; a machine cannot tell them from sparks
        ("ignitions", "i8"),
        ("duration_ns", "i8"),
        ("voltage_V_us", "f8"),  # gap voltage, summed over the time
        ("charge_A_us", "f8"),  # gap current, summed over the time
        ("delay_us", "f8"),  # sum of the ignitions' delays
        ("travel_um", "f8"),  # travel along the path, by the counters
        ("feed_um_s", "f8"),  # feed commanded for the last window
        ("t_on_us", "f8"),  # on-time and period of the last window
        ("t_period_us", "f8"),
        ("fifths", "i8", 5),  # ignitions by their measured place (`edmsim.plant.kernel.discharge.locate`)
    ]
)
"""Sums over the windows of a step."""
SCALE = np.dtype(
    [
        ("open_V", "f8"),  # divisors of voltage, current and delay
        ("limit_A", "f8"),
        ("wait_us", "f8"),
        ("noise_share", "f8"),  # noise and the converters' step, as shares of these divisors (`Sensors`)
        ("step", "f8"),
        ("key", "u8"),  # key of the noise's random draws
        ("draws", "u8"),  # number of draws so far
        ("max_feed_um_s", "f8"),  # arguments of the episode that are divisors of other entries
        ("wires", "f8"),
        ("episode_s", "f8"),  # infinite without a limit
    ]
)
"""Divisors and errors of the measurements."""


@exactly_compiled
def accumulate_window(
    indices: NDArray[np.int64], rows: NDArray[np.void], windows: NDArray[np.void], step_sums: NDArray[np.void]
) -> None:
    """Add the last window of some sub-environments (m,) to the sums of their step."""
    for j in range(indices.shape[0]):
        i = indices[j]
        row, window, sums = rows[i], windows[i], step_sums[i]
        counts, fifths, setting_us = window.counts, window.fifths, row.setting_us
        sums.short += counts[SHORT]
        sums.open += counts[OPEN]
        sums.ignited += counts[SPARK] + counts[ARC]
        sums.arc += counts[ARC]
        sums.ignitions += window.ignitions
        sums.duration_ns += window.duration_ns
        sums.voltage_V_us += window.voltage_us
        sums.charge_A_us += window.charge_A_us
        sums.delay_us += window.delay_us
        sums.travel_um += row.travel_um
        sums.feed_um_s = row.feed_um_s
        sums.t_on_us, sums.t_period_us = setting_us[0], setting_us[1]
        for k in range(5):
            sums.fifths[k] += fifths[k]


@exactly_compiled
def push_step(
    indices: NDArray[np.int64], step_sums: NDArray[np.void], scales: NDArray[np.void],
    history: NDArray[np.float32], values: Floats,
) -> None:
    """Insert the last step of some sub-environments (m,) at the front of their history, and drop the oldest step.

    `values` is a buffer for the entries `MEASURED` of one of them.
    """
    for j in range(indices.shape[0]):
        i = indices[j]
        s, scale, entries = step_sums[i], scales[i], history[i]
        pulses, duration_us, ignitions = s.short + s.open + s.ignited, s.duration_ns * 1e-3, s.ignitions
        for age in range(entries.shape[0] - 1, 0, -1):
            for k in range(entries.shape[1]):
                entries[age, k] = entries[age - 1, k]
        values[0] = s.short / pulses
        values[1] = s.open / pulses
        values[2] = s.ignited / pulses
        values[_VOLTAGE] = s.voltage_V_us / duration_us / scale.open_V
        values[_CURRENT] = s.charge_A_us / duration_us / scale.limit_A
        values[_DELAY] = s.delay_us / ignitions / scale.wait_us if ignitions > 0 else 1.0
        values[6] = s.feed_um_s / scale.max_feed_um_s
        values[7] = s.travel_um / (duration_us * 1e-6) / scale.max_feed_um_s
        values[8] = math.log10(s.t_on_us) / 3.0
        values[9] = math.log10(s.t_period_us) / 4.0
        noise_share, step = scale.noise_share, scale.step
        for k in range(_VOLTAGE, _DELAY + 1):
            if noise_share > 0.0:
                values[k] += noise_share * normal(scale.key, scale.draws)
                scale.draws += np.uint64(1)
            if step > 0.0:
                values[k] = np.rint(values[k] / step) * step
        for k in range(values.shape[0]):
            value, low, high = values[k], _LOW[k], _HIGH[k]
            entries[0, k] = low if value < low else (high if value > high else value)
        fifths = s.fifths
        for k in range(values.shape[0], entries.shape[1]):
            entries[0, k] = fifths[k - values.shape[0]] / (ignitions if ignitions > 1 else 1)


def values_of(entries: Sequence[Entry], of: Any, count: int) -> NDArray[np.float32]:
    """Return the values of entries (count, entries) from a machine or from `Known`."""
    values = np.empty((count, len(entries)))
    for k, entry in enumerate(entries):
        assert entry.value is not None
        values[:, k] = np.minimum(np.maximum(entry.value(of), entry.low), entry.high)
    return values.astype(np.float32)


def window_of(window: WindowObservation) -> NDArray[np.void]:
    """Return an observed window as a record (1,) of `kernel.state.WINDOW`, in which arcs count as sparks."""
    found: NDArray[np.void] = np.zeros(1, WINDOW)
    row, us = found[0], window.duration_s * 1e6
    ignited = WINDOW_PULSES - window.short - window.open
    row["counts"][[SHORT, OPEN, SPARK]] = window.short, window.open, ignited
    row["duration_ns"] = round(window.duration_s * 1e9)  # the plant counts whole nanoseconds
    row["voltage_us"], row["charge_A_us"] = window.mean_voltage_V * us, window.mean_current_A * us
    row["delay_us"] = window.mean_delay_us * ignited if ignited else 0.0
    row["ignitions"], row["fifths"] = ignited, window.fifths
    return found
