"""An operator at a drive's serial line: types values, steps or moves the axis, and watches what the drive sends.

Both chips send the tracking error: the UHU by the stream for its analyser (rows U-33 to U-36), the servo module by
its recorder (guide 4.20). The operator uses nothing else. It reads overshoot, settling time and oscillation from the
response to a step of the setpoint.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.axis_bench import AxisBench
from edmsim.controllers.axis import CHIPS
from edmsim.controllers.axis.drive import data_of

_REBOUND, _LEAST_COUNTS, _RESTLESS_COUNTS = 0.08, 2.5, 2
"""What is no oscillation (ours): a swing back behind the overshoot up to a share of the step, or a few counts, which
are the encoder's and friction's; and the most counts that a settled end may move by."""
_SETTLED_COUNTS = 1  # the axis has settled when it stays this near: the encoder tells no more


class AxisTrace(NamedTuple):
    """Response to a step or a move."""

    time_s: NDArray[np.float64]  # (n,): times since then
    # (n,): setpoint less position in counts; after a step, positive is short of the setpoint, whichever way it went
    error: NDArray[np.int64]

    def overshoot(self, counts: int) -> float:
        """Return how far it went beyond a step of `counts`, as a share of it; 0 if it did not."""
        return max(float(-self.error.min()) / counts, 0.0)

    @property
    def settling_s(self) -> float:
        """Time after which the error stays within a count; the whole time if it never does."""
        outside = np.flatnonzero(np.abs(self.error) > _SETTLED_COUNTS)
        return float(self.time_s[outside[-1]]) if len(outside) else 0.0

    @property
    def rms(self) -> float:
        """Root mean square of the error in counts."""
        return float(np.sqrt(np.mean(self.error.astype(np.float64) ** 2)))

    def oscillates(self, counts: int, most_overshoot: float) -> bool:
        """Return whether the answer to a step of `counts` goes beyond it by a share, or does not come to rest."""
        end = self.error[len(self.error) * 3 // 4 :]
        if not len(end) or np.ptp(end) > _RESTLESS_COUNTS:
            return True
        there = np.flatnonzero(self.error <= 0)
        if not len(there):
            return False
        beyond = self.error[there[0] :]
        lowest = int(beyond.argmin())
        back = float(beyond[lowest:].max())
        too_far = float(-beyond[lowest]) > max(most_overshoot * counts, _LEAST_COUNTS)
        return too_far or back > max(_REBOUND * counts, _LEAST_COUNTS)


_START_S = 0.05  # time for the start-up text (ours)
_REST_S = 0.2  # time for an axis to come to rest (ours)
_BITS = 10  # of a byte on the line: start bit, eight, stop bit
_DATA = 0x80  # bytes from here on are the stream's (row U-35)
STEP_RATE, MOVE_RATE, _AT_ONCE, _OUTPUT = 1, 2, 24, 96
"""Parts of a recorder's code (guide 4.20): rates, no trigger, the output instead of the error."""
_WATCHED_S = {STEP_RATE: 0.3, MOVE_RATE: 0.5}
"""Time for which an answer is watched (ours): as a full recorder and its dump take."""
_SPEED_SHARE, _MOST_HZ, _RAMP_S = 0.2, 20_000.0, 0.05
"""A move's speed as a share of the motor's without load, in counts/s at most, and the time of its ramps (ours)."""


class Operator(ABC):
    """One who tunes a drive, as delivered, on an axis; `rate_Hz` are the steps per second of a move."""

    chip: ClassVar[str]
    file: ClassVar[str]  # of ``models/drives``
    gains: ClassVar[tuple[str, ...]]
    """Letters of what is found: P, then what is raised against oscillation in the manual's order, then I."""
    fixed: ClassVar[Mapping[str, int]]  # letters of what stays as it is while they are found
    relay: ClassVar[Mapping[str, int]]
    """Settings that make the loop a relay: the largest gain alone, with a limit as its height."""
    height: ClassVar[str]  # letter of the relay's height
    no_trip: ClassVar[int]  # an error limit that nothing reaches
    shown: ClassVar[int]  # the largest error that the drive shows, in counts
    saving: ClassVar[tuple[str, ...]]  # lines that save what was typed

    def __init__(self, motor: NDArray[np.void]) -> None:
        drive = CHIPS[self.chip](motor)
        self.baud = drive.baud
        self.bench = AxisBench({"x": drive})
        self.bench.run(_START_S)
        free_rad_s = float(motor["supply_V"][0] / motor["torque_Nm_A"][0])
        self.rate_Hz = min(_SPEED_SHARE * free_rad_s * float(motor["counts_per_rad"][0]), _MOST_HZ)
        self._data = data_of(self.file)
        self.delivered = {row["letter"]: int(row["value"]) for row in self._data["parameter"]}
        self._typed: dict[str, int] = {}

    @property
    def interval_s(self) -> float:
        """Time from one recalculation to the next."""
        record = self.bench.drive().record
        return float(record["num"][0] / record["den"][0]) * 1e-9

    def enter(self, values: Mapping[str, int]) -> None:
        """Type what of some values is new, restart the loop, and let the axis come to rest."""
        for letter, value in values.items():
            if self._typed.get(letter) != value:
                self.bench.talk(f"{letter}{value}\r".encode("ascii"))
        self._typed.update(values)
        self.restart()
        self.bench.run(_REST_S)

    def restart(self) -> None:
        """Make the setpoint what the position is."""
        self.bench.talk(b"R\r")

    def step(self, counts: int, code: int = STEP_RATE) -> AxisTrace:
        """Step the setpoint and watch; the error is positive where the axis is short of it."""
        self.restart()
        self._watch(code)
        answer = self._watched(self.send_step(counts), _WATCHED_S[code])
        return answer._replace(error=answer.error if counts > 0 else -answer.error)

    def move(self, direction: int) -> AxisTrace:
        """Send the step pulses of a move with ramps, as the computer of the machine would, and watch."""
        self.restart()
        self._watch(MOVE_RATE)
        return self._watched(self.send_steps(direction), _WATCHED_S[MOVE_RATE])

    def send_step(self, counts: int) -> float:
        """Send the line that steps the setpoint; return the time in s at which it has come."""
        line = self._step_line(counts)
        self.bench.send(line)
        return self.bench.time_s + _BITS * len(line) / self.baud

    def send_steps(self, direction: int) -> float:
        """Send the step pulses of the move, 0.25 s of them, there or back; return the time in s of the first."""
        accel_Hz_s = self.rate_Hz / _RAMP_S
        self.bench.steps("x", direction * round(4 * _RAMP_S * self.rate_Hz), self.rate_Hz, accel_Hz_s)
        return self.bench.time_s

    @abstractmethod
    def _step_line(self, counts: int) -> bytes:
        """Return the line that steps the setpoint."""

    @abstractmethod
    def _watch(self, code: int) -> None:
        """Have the drive show what comes, a recorder by its code."""

    @abstractmethod
    def _watched(self, since_s: float, seconds: float) -> AxisTrace:
        """Wait some seconds, and return what it has shown of what happened since then."""


class UhuOperator(Operator):
    """One who tunes a UHU by the fine tuning text of its manual (rows U-25 and U-58) before the analyser."""

    chip, file = "uhu", "uhu"
    gains = "P", "H", "D", "I"
    fixed: ClassVar = {"X": 5000, "T": 255, "N": 1000, "C": 63}
    relay: ClassVar = {"P": 65535, "I": 0, "D": 0, "H": 0, "X": 65535, "N": 65535}
    height, no_trip, shown = "T", 30_000, 62
    saving = "S0", "S2"

    def _step_line(self, counts: int) -> bytes:
        return b"G%d\r" % counts

    def _watch(self, code: int) -> None:
        self.bench.send(b"A\r")
        self.bench.run(0.02)
        self.bench.received()

    def _watched(self, since_s: float, seconds: float) -> AxisTrace:
        self.bench.run(seconds)
        since_s += _BITS / self.baud  # which a byte is on its way
        data = [(at_s - since_s, byte) for byte, at_s in self.bench.received_at() if byte >= _DATA]
        heard = [(at_s, byte) for at_s, byte in data if at_s >= 0]
        self.bench.send(b"Z\r")
        self.bench.run(0.02)
        zero = _DATA + int(self._data["law"]["stream_zero"])
        return AxisTrace(np.array([at_s for at_s, _ in heard]), np.array([byte - zero for _, byte in heard]))


class ModuleOperator(Operator):
    """One who tunes a servo module with its recorder, as the guide says in 4.20."""

    chip, file = "servo-module", "servo_module"
    gains = "P", "D", "I"
    fixed: ClassVar = {"C": 760, "L": 6}
    relay: ClassVar = {"P": 65535, "I": 0, "D": 0}
    height, no_trip, shown = "C", 40_000, 32_767
    saving = ("S",)

    def _step_line(self, counts: int) -> bytes:
        return b"%+d\r" % counts

    def _watch(self, code: int) -> None:
        self._every = 1 << (code & 7)
        self.bench.received()
        self.bench.send(b"Z%d\r" % code)

    def _watched(self, since_s: float, seconds: float) -> AxisTrace:
        self.bench.run(seconds)
        lines = self.bench.received().decode("ascii")
        shown = np.array([int(number) for number in re.findall(r"^(-?\d+)\r$", lines, re.MULTILINE)])
        return AxisTrace(self._every * self.interval_s * np.arange(len(shown), dtype=np.float64), shown)

    def output_at_speed(self, direction: int) -> tuple[float, float]:
        """Move steadily; return the output in duty counts that this takes, and the commanded counts per cycle."""
        self.send_steps(direction)
        self.bench.run(_RAMP_S)
        self._watch(MOVE_RATE + _AT_ONCE + _OUTPUT)
        shown = self._watched(self.bench.time_s, _WATCHED_S[MOVE_RATE]).error
        steady = self.rate_Hz * self.interval_s * direction
        n = round(2 * _RAMP_S / (self._every * self.interval_s))
        return float(shown[:n].mean()), steady
