"""PULSER, the discharge board of the Spark project, by its registers (manual of PULSER, its first boards).

An I2C bus has no lines of text: here a read is ``r REGISTER [COUNT]`` and a write ``w REGISTER VALUE ...``, as a USB
bridge would take them; `Pulser.read` and `Pulser.write` are the same without text.
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from edmsim.hil.gap import Frame, Output
from edmsim.hil.powercore import Pins
from edmsim.plant.kernel.state import OPEN, SHORT

POLARITY, PULSE_CURRENT, TEMPERATURE, PULSE_DUR, MAX_DUTY = range(1, 6)
CKP_N_PULSE, T_IGNITION, T_IGNITION_SD, R_PULSE, R_SHORT, R_OPEN = range(0x10, 0x16)
TEST = 0x80
_RANGES = {PULSE_CURRENT: (1, 80), PULSE_DUR: (5, 100), MAX_DUTY: (1, 95)}
_INVALID = 255
_CURRENT_CHANGE_S, _POLARITY_CHANGE_S = 0.001, 0.02
"""How long the driver is suppressed after a change while it is active."""
_IGNITION_UNIT_US, _MOST_IGNITION_US = 5.0, 1000.0
_LEAST_PAUSE_US = 5.0  # shortest pause (manual: "a few us")
_FRAME_US = 5000.0  # pulses of a frame take about that long (ours: hosts poll at 10 Hz to 1 kHz)
_WATER_C = 25  # temperature of the heatsink that the register shows (ours: the board's cooling is not modelled)


class Pulser:
    """The board's registers, each of a byte; `enabled` is the level of GATE, without which no current flows."""

    name: ClassVar[str] = "spark"
    generator: ClassVar[str] = "spark-pulser"
    listens: ClassVar[bool] = True

    def __init__(self) -> None:
        self.enabled = True
        self._set = {POLARITY: 0, PULSE_CURRENT: 10, PULSE_DUR: 50, MAX_DUTY: 25, TEST: 0}
        self._shown = dict.fromkeys((CKP_N_PULSE, R_PULSE, R_SHORT, R_OPEN), 0)
        self._shown |= dict.fromkeys((T_IGNITION, T_IGNITION_SD), _INVALID)
        self._time_s = self._quiet_until_s = 0.0
        self._begin()

    def _begin(self) -> None:
        self._pulses = 0
        self._delays: list[float] = []
        self._us = np.zeros(4)
        """Pulse, short, open, all of the operating time."""

    def output(self) -> Output:
        """Ask for about 5 ms of pulses."""
        on_us = 10.0 * self._set[PULSE_DUR]
        pause_us = max(on_us * (100.0 / self._set[MAX_DUTY] - 1.0), _LEAST_PAUSE_US)
        on = self.enabled and self._set[POLARITY] != 0 and self._time_s >= self._quiet_until_s
        pulses = min(max(int(_FRAME_US / (on_us + pause_us)), 1), 50)
        return Output(pulses, on, on_us, on_us + pause_us, None, 0.1 * self._set[PULSE_CURRENT])

    def see(self, frame: Frame) -> None:
        """Add up where the time went."""
        self._time_s += frame.window.duration_ns * 1e-9
        if not frame.on:
            return
        pulses, kinds = frame.pulses, frame.pulses["kind"]
        shorted, ignited = kinds == SHORT, (kinds != OPEN) & (kinds != SHORT)
        delays, burns = pulses["delay_us"].astype(float), pulses["conducting_us"].astype(float)
        lengths = np.diff(pulses["start_us"].astype(float), append=frame.window.duration_ns * 1e-3)
        # what the board waits after a short counts as short
        self._us += burns[ignited].sum(), lengths[shorted].sum(), delays[~shorted].sum(), lengths.sum()
        self._pulses += int(ignited.sum())
        self._delays += np.minimum(delays[ignited], _MOST_IGNITION_US).tolist()

    def read(self, register: int, count: int = 1) -> bytes:
        """Read registers one after the other; `CKP_N_PULSE` shows a new interval and begins the next."""
        found = []
        for at in range(register, register + count):
            if at == CKP_N_PULSE:
                self._flip()
            found.append(self._value(at & 0xFF))
        return bytes(found)

    def write(self, register: int, value: int) -> None:
        """Write a register: an invalid value becomes the nearest valid one, an invalid polarity OFF."""
        if register == POLARITY:
            value = value if value <= 4 else 0
        elif register in _RANGES:
            low, high = _RANGES[register]
            value = min(max(value, low), high)
        elif register != TEST:
            return
        changed, was_on = self._set[register] != value, self._set[POLARITY] != 0
        self._set[register] = value
        if changed and was_on and register in (POLARITY, PULSE_CURRENT):
            quiet_s = _POLARITY_CHANGE_S if register == POLARITY else _CURRENT_CHANGE_S
            self._quiet_until_s = self._time_s + quiet_s

    def line(self, text: str) -> str:
        """Answer ``r REGISTER [COUNT]`` or ``w REGISTER VALUE ...``; numbers are decimal or as 0x10."""
        words = text.split()
        try:
            numbers = [int(word, 0) for word in words[1:]]
        except ValueError:
            numbers = []
        fine = bool(numbers) and all(0 <= number <= 0xFF for number in numbers)
        if fine and words[0] == "r" and len(numbers) <= 2 and (len(numbers) == 1 or numbers[1] > 0):
            read = self.read(numbers[0], numbers[1] if len(numbers) == 2 else 1)
            return f"0x{numbers[0]:02x}: {' '.join(map(str, read))}\r\n"
        if fine and words[0] == "w" and len(numbers) >= 2:
            for k, value in enumerate(numbers[1:]):
                self.write((numbers[0] + k) & 0xFF, value)
            return "ok\r\n"
        return "ERROR: give r REGISTER [COUNT] or w REGISTER VALUE ..., bytes as 18 or 0x12\r\n"

    def unasked(self) -> str:
        """Send nothing: a bus speaks when it is asked."""
        return ""

    def pins(self) -> Pins:
        """Return nothing: the board has no outputs but its bus."""
        return {}

    def _value(self, register: int) -> int:
        if register == TEMPERATURE:
            return _WATER_C
        return self._set.get(register, self._shown.get(register, 0))

    def _flip(self) -> None:
        """Show the interval that is over, and begin the next one."""
        pulse, short, open_, total = self._us.tolist()
        shares = (pulse / total, short / total, open_ / total) if total else (0.0, 0.0, 0.0)
        for register, share in zip((R_PULSE, R_SHORT, R_OPEN), shares, strict=True):
            self._shown[register] = min(int(255 * share + 0.5), 255)
        self._shown[CKP_N_PULSE] = min(self._pulses, 255)
        delays = np.array(self._delays)
        for register, value in ((T_IGNITION, delays.mean()), (T_IGNITION_SD, delays.std())) if len(delays) else ():
            self._shown[register] = min(math.floor(value / _IGNITION_UNIT_US + 0.5), _INVALID - 1)
        if not len(delays):
            self._shown[T_IGNITION] = self._shown[T_IGNITION_SD] = _INVALID
        self._begin()
