"""A log of ratios and positions like that of an open machine's controller, for ``edmsim calibrate``."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Self

from edmsim.errors import InputError
from edmsim.hil.gap import Frame
from edmsim.hil.rig import Rig

LEAST_HZ, MOST_HZ = 2.0, 100.0
COLUMNS = ("t_s", "x_um", "y_um", "short_ratio", "open_ratio", "t_on_us", "t_period_us")


class RatioLog:
    """Writes shares of short and open pulses and the axes' positions, 2 to 100 rows per second, without time off."""

    def __init__(self, file: Path, rig: Rig, rate_Hz: float) -> None:
        if not LEAST_HZ <= rate_Hz <= MOST_HZ:
            raise InputError(f"a log of ratios has {LEAST_HZ:g} to {MOST_HZ:g} rows per second, not {rate_Hz:g}")
        if file.suffix != ".csv":
            raise InputError("a log of ratios is written as .csv", file)
        self._rig, self._every_s = rig, 1.0 / rate_Hz
        self._file, self._partial = file, file.with_name(file.name + ".part")
        try:
            self._out = self._partial.open("w", encoding="utf-8")
        except OSError as error:
            raise InputError(f"cannot be written: {error.strerror or error}", file) from None
        self._out.write(",".join(COLUMNS) + "\n")
        self._last_s = rig.time_s
        self._counts = [0, 0, 0]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the file; it takes its name whatever ended it."""
        self._out.close()
        self._partial.replace(self._file)

    def frame(self, frame: Frame) -> None:
        """Take in a frame."""
        window = frame.window
        if frame.on:
            for k, count in enumerate((window.short, window.open, window.pulses)):
                self._counts[k] += count
        now_s = self._rig.time_s
        if now_s - self._last_s < self._every_s or not self._counts[2]:
            return
        short, open_, pulses = self._counts
        machine, (x, y) = self._rig.gap.plant.machine, self._rig.gap.place_um
        self._out.write(
            f"{now_s:.6f},{x:g},{y:g},{short / pulses:.4f},{open_ / pulses:.4f},"
            f"{machine.t_on_us:g},{machine.t_period_us:g}\n"
        )
        self._counts, self._last_s = [0, 0, 0], now_s
