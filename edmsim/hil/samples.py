"""Samples of gap voltage and current, like a converter's: by an iterator, from C, and in a file; logs of ratios.

The model's edges are vertical, and voltage and current are 0 between pulses. Without a low-pass a sample is the value
at its instant; with one, voltage and current first pass a first-order filter.
"""

import ctypes
import math
import wave
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, Self

import numpy as np
from scipy.signal import lfilter

from edmsim.errors import InputError, methods_refuse_wrong_types
from edmsim.files import check_suffix, naming, unfinished
from edmsim.hil.boards import NO_TIME_S, Rig, next_due_s
from edmsim.hil.gap import Frame
from edmsim.numeric import finite, whole_from
from edmsim.plant.kernel.state import OPEN, SHORT

Array = np.typing.NDArray[np.float64]
LEAST_HZ, MOST_HZ = 1e4, 1e5
_FINE_US = 1.0  # greatest step of the filter (ours: below a tenth of any pulse of these boards)
COUNT_V, COUNT_A = 0.01, 0.01  # one count of a WAV file
_COUNTS = 32767
_MOST_SAMPLES = (2**32 - 64) // 4  # limit of a WAV file, whose header has 32 bits for its length
READ = ctypes.CFUNCTYPE(
    ctypes.c_int64, ctypes.POINTER(ctypes.c_float), ctypes.POINTER(ctypes.c_float), ctypes.c_int64
)
"""``int64_t read(float *voltage_V, float *current_A, int64_t n)``."""


class Sensing(NamedTuple):
    """Properties of the voltage and current measurement."""

    rate_Hz: float = 5e4  # samples per second, 10 000 to 100 000
    low_pass_Hz: float = 0.0  # corner of the filter before the converter; 0 for none
    # noise_V, noise_A: standard deviations of the converter's noise
    noise_V: float = 0.0
    noise_A: float = 0.0
    seed: int = 0  # seed of the noise

    def check(self) -> None:
        """Raise `InputError` for values that cannot be used."""
        if not LEAST_HZ <= finite("rate_Hz", self.rate_Hz) <= MOST_HZ:
            raise InputError(f"samples are taken at {LEAST_HZ:g} to {MOST_HZ:g} Hz, not {self.rate_Hz:g}")
        for name in ("low_pass_Hz", "noise_V", "noise_A"):
            finite(name, getattr(self, name), 0.0)
        whole_from("seed", self.seed, 0)


class Sampler:
    """Samples consecutive frames from a machine time on."""

    def __init__(self, sensing: Sensing, start_us: float = 0.0) -> None:
        sensing.check()
        self._sensing = sensing
        period_us = 1e6 / sensing.rate_Hz
        self._fine = math.ceil(period_us / _FINE_US) if sensing.low_pass_Hz else 1
        self._step_us = period_us / self._fine
        self._origin_us, self._next = start_us, 0
        self._gain = 1.0 - math.exp(-2e-6 * math.pi * sensing.low_pass_Hz * self._step_us)
        self._state = np.zeros((2, 1))
        self._carried = np.zeros(2)
        self._rng = np.random.default_rng(sensing.seed)

    def samples(self, frame: Frame) -> tuple[Array, Array, Array]:
        """Return times in s, voltages and currents of the samples of a frame, each (n,)."""
        begin_us = frame.window.start_ns * 1e-3 - self._origin_us
        end_us = begin_us + frame.window.duration_ns * 1e-3
        behind = math.ceil(end_us / self._step_us - 1e-9)
        places = np.arange(self._next, behind)
        self._next = max(self._next, behind)
        times, values = _edges(frame)
        at = np.asarray(places * self._step_us - begin_us, np.float64)
        if self._sensing.low_pass_Hz:
            values = self._filtered(times, values, at, end_us - begin_us)
            chosen = places % self._fine == 0
            places, values = places[chosen], values[:, chosen]
        else:
            values = values[:, np.searchsorted(times, at, side="right")]
        noise = self._sensing.noise_V, self._sensing.noise_A
        voltage, current = (
            row + self._rng.normal(0.0, rms, len(row)) if rms else row for row, rms in zip(values, noise, strict=True)
        )
        return np.asarray((places * self._step_us + self._origin_us) * 1e-6, np.float64), voltage, current

    def _filtered(self, times: Array, values: Array, at: Array, length_us: float) -> Array:
        """Return the filter's outputs at some times; its inputs are the means between them."""
        corners = np.concatenate([[0.0], times, [length_us]])
        areas = np.concatenate([np.zeros((2, 1)), np.cumsum(values * np.diff(corners), axis=1)], axis=1)
        found = []
        for k in (0, 1):
            upto = np.interp(at, corners, areas[k])
            means = np.diff(upto, prepend=-self._carried[k]) / self._step_us
            self._carried[k] = areas[k, -1] - upto[-1] if len(at) else self._carried[k] + areas[k, -1]
            out, self._state[k] = lfilter([self._gain], [1.0, self._gain - 1.0], means, zi=self._state[k])
            found.append(out)
        return np.array(found)


def _edges(frame: Frame) -> tuple[Array, Array]:
    """Return the edges' times in us since the frame's begin; voltage and current before the first and after each."""
    pulses, timing = frame.pulses, frame.timing
    kinds = pulses["kind"]
    start, delay, conducting = (pulses[name].astype(np.float64) for name in ("start_us", "delay_us", "conducting_us"))
    is_open, is_short = kinds == OPEN, kinds == SHORT
    up = np.where(is_short, 0.0, pulses["open_V"])
    burning = np.where(is_open | is_short, 0.0, timing.burning_V)
    flowing = np.where(is_open, 0.0, np.where(is_short, timing.short_A, timing.current_A))
    times = np.stack([start, start + delay, start + delay + conducting], axis=1).ravel()
    zero = np.zeros_like(start)
    voltage = np.stack([up, burning, zero], axis=1).ravel()
    current = np.stack([zero, flowing, zero], axis=1).ravel()
    values = np.zeros((2, len(times) + 1))
    if frame.on:
        values[:, 1:] = voltage, current
    return times, values


@methods_refuse_wrong_types
class SampleReader:
    """Iterator over samples of a rig from its present time on; reading runs the rig if it has not run far enough.

    Parameters
    ----------
    rig : Rig
    sensing : Sensing

    Attributes
    ----------
    c_read : ctypes function
        ``int64_t read(float *voltage_V, float *current_A, int64_t n)`` for a firmware in C: fills both buffers and
        returns `n`. It is valid while the reader exists.

    Examples
    --------
    >>> reader = SampleReader(Rig("powercore", seed=1), Sensing(rate_Hz=20_000))
    >>> voltage, current = reader.read(256)
    >>> len(voltage)
    256
    >>> first = next(iter(reader))
    """

    def __init__(self, rig: Rig, sensing: Sensing = Sensing()) -> None:  # noqa: B008, a tuple does not change
        self._rig = rig
        self._sampler = Sampler(sensing, rig.time_s * 1e6)
        self._unread = [(np.zeros(0, np.float32), np.zeros(0, np.float32))]
        self._count = 0  # number of unread samples
        rig.watch(self._take)
        self.c_read = READ(self._fill)

    def read(self, count: int) -> tuple[np.typing.NDArray[np.float32], np.typing.NDArray[np.float32]]:
        """Return the next voltages in V and currents in A, each float32 (count,)."""
        if count < 0:
            raise InputError(f"{count} samples cannot be read")
        while self._count < count:
            self._rig.frame()
        voltages, currents = self._unread[0]
        if len(voltages) < count:  # else nothing is copied, as a rig may have run for minutes before
            voltages, currents = (np.concatenate(rows) for rows in zip(*self._unread, strict=True))
            self._unread = []
        self._unread[:1] = [(voltages[count:], currents[count:])]
        self._count -= count
        return voltages[:count], currents[:count]

    def _take(self, frame: Frame) -> None:
        _, voltage, current = self._sampler.samples(frame)
        self._unread.append((voltage.astype(np.float32), current.astype(np.float32)))
        self._count += len(voltage)

    def __iter__(self) -> Iterator[tuple[float, float]]:
        """Yield voltage and current of one sample after the other, without end."""
        while True:
            voltage, current = self.read(1)
            yield float(voltage[0]), float(current[0])

    def _fill(self, voltage_V: Any, current_A: Any, count: int) -> int:
        voltage, current = self.read(max(count, 0))
        ctypes.memmove(voltage_V, voltage.ctypes.data, voltage.nbytes)
        ctypes.memmove(current_A, current.ctypes.data, current.nbytes)
        return len(voltage)


class FrameFile(ABC):
    """A file written frame by frame; on leaving, even by an error, it gets its name if there was a frame."""

    def __init__(self, file: Path) -> None:
        self._file, self._partial = file, unfinished(file)
        self._has_frames = False
        try:
            self._open()
        except OSError as error:
            raise InputError(f"cannot be written: {error.strerror or error}", file) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        """Close the file; if it has no frame or the disk is full, it is removed, and an existing file is kept."""
        try:
            with naming(self._file):
                self._close()
                if self._has_frames:
                    self._partial.replace(self._file)
        finally:
            self._partial.unlink(missing_ok=True)

    def frame(self, frame: Frame) -> None:
        """Write a frame."""
        self._has_frames = True
        try:
            with naming(self._file):
                self._take(frame)
        except OSError:  # a full disk: what has been written cannot be read
            self._has_frames = False
            raise

    @abstractmethod
    def _open(self) -> None: ...

    @abstractmethod
    def _take(self, frame: Frame) -> None: ...

    @abstractmethod
    def _close(self) -> None: ...


class SampleFile(FrameFile):
    """A file of samples, written frame by frame: ``.parquet`` with time, voltage, current, or ``.wav``."""

    # a WAV file has voltage on the left channel and current on the right, 10 mV and 10 mA per count
    def __init__(self, file: Path, sensing: Sensing, start_s: float = 0.0) -> None:
        self._kind = check_suffix(file, "a file of samples", ".parquet", ".wav")
        self._sensing, self._sampler = sensing, Sampler(sensing, start_s * 1e6)
        if self._kind == ".wav" and sensing.rate_Hz % 1:
            raise InputError("a WAV file has a whole number of samples per second", file)
        self._rows: list[tuple[Array, Array, Array]] = []
        self._clipped = self._left_out = 0
        self.count = 0
        self._sound: BinaryIO | None = None
        super().__init__(file)

    def _open(self) -> None:
        if self._kind == ".wav":
            self._sound = self._partial.open("wb")
            self._writer: Any = wave.open(self._sound, "wb")  # noqa: SIM115, closed by __exit__
            self._writer.setnchannels(2)
            self._writer.setsampwidth(2)
            self._writer.setframerate(int(self._sensing.rate_Hz))
            return
        import pyarrow.parquet

        kinds = {"t_s": pyarrow.float64(), "voltage_V": pyarrow.float32(), "current_A": pyarrow.float32()}
        self._writer = pyarrow.parquet.ParquetWriter(self._partial, pyarrow.schema(kinds), compression="zstd")

    def _close(self) -> None:
        with ExitStack() as last:  # closes all of them, also on a full disk
            if self._sound is not None:
                last.callback(self._sound.close)
            last.callback(self._writer.close)
            self._write()

    def _take(self, frame: Frame) -> None:
        self._rows.append(self._sampler.samples(frame))
        if len(self._rows) >= 256:
            self._write()

    @property
    def notice(self) -> str:
        """Notice about the file for the user; may be empty."""
        said = []
        if self._clipped:
            most = f"{_COUNTS * COUNT_V:g} V or {_COUNTS * COUNT_A:g} A"
            said.append(f"{self._clipped} samples are beyond {most}, which is the most a WAV file holds")
        if self._left_out:
            said.append(f"it is full, as a WAV file ends at 4 GB: {self._left_out} samples after these are not in it")
        return "; ".join(said)

    def _write(self) -> None:
        if not self._rows:
            return
        time, voltage, current = (np.concatenate(rows) for rows in zip(*self._rows, strict=True))
        self._rows = []
        if self._kind == ".wav":
            room = _MOST_SAMPLES - self.count
            counts = np.stack([voltage[:room] / COUNT_V, current[:room] / COUNT_A], axis=1).round()
            self.count += len(counts)
            self._left_out += len(time) - len(counts)
            self._clipped += int((np.abs(counts) > _COUNTS).any(axis=1).sum())
            self._writer.writeframes(np.clip(counts, -_COUNTS, _COUNTS).astype("<i2").tobytes())
            return
        self.count += len(time)
        import pyarrow

        columns = {"t_s": time, "voltage_V": voltage.astype(np.float32), "current_A": current.astype(np.float32)}
        self._writer.write_table(pyarrow.table(columns))


# A log of ratios and positions like that of an open machine's controller, for ``edmsim calibrate``.

LEAST_ROWS_HZ, MOST_ROWS_HZ = 2.0, 100.0
COLUMNS = ("t_s", "x_um", "y_um", "short_ratio", "open_ratio", "t_on_us", "t_period_us")


class RatioLog(FrameFile):
    """Writes shares of short and open pulses and the axes' positions, 2 to 100 rows per second with pulses."""

    def __init__(self, file: Path, rig: Rig, rate_Hz: float) -> None:
        if not LEAST_ROWS_HZ <= rate_Hz <= MOST_ROWS_HZ:
            allowed = f"{LEAST_ROWS_HZ:g} to {MOST_ROWS_HZ:g}"
            raise InputError(f"a log of ratios has {allowed} rows per second, not {rate_Hz:g}")
        check_suffix(file, "a log of ratios", ".csv")
        self._rig, self._every_s = rig, 1.0 / rate_Hz
        self._due_s = rig.time_s + self._every_s
        self._counts = [0, 0, 0]
        self.count = 0  # rows written
        super().__init__(file)

    def _open(self) -> None:
        self._out = self._partial.open("w", encoding="utf-8")
        self._out.write(",".join(COLUMNS) + "\n")

    def _close(self) -> None:
        self._out.close()

    def _take(self, frame: Frame) -> None:
        window = frame.window
        if frame.on:
            for k, count in enumerate((window.short, window.open, window.pulses)):
                self._counts[k] += count
        now_s = self._rig.time_s
        if now_s < self._due_s - NO_TIME_S or not self._counts[2]:
            return
        self._due_s = next_due_s(self._due_s, self._every_s, now_s)
        short, open_, pulses = self._counts
        machine, (x, y) = self._rig.gap.plant.machine, self._rig.gap.place_um
        self._out.write(
            f"{now_s:.6f},{x:g},{y:g},{short / pulses:.4f},{open_ / pulses:.4f},"
            f"{machine.t_on_us:g},{machine.t_period_us:g}\n"
        )
        self._counts, self.count = [0, 0, 0], self.count + 1
