"""Observations of episodes as they run, for environments and for policies in cuts."""

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.protocols import WindowObservation
from edmsim.envs import observation
from edmsim.envs.task import Family
from edmsim.geometry import Floats
from edmsim.machine.machine import Machine
from edmsim.machine.setting import WINDOW_PULSES
from edmsim.plant.kernel.state import OPEN, SHORT, SPARK, WINDOW
from edmsim.snapshots import Snapshots


class ObservationBuilder(Snapshots):
    """Builds the observations of n episodes, window by window."""

    STATE = ("sums", "_history", "_scales", "_threaded_ns", "_broke_at")

    def __init__(self, family: Family, count: int, sensors: observation.Sensors) -> None:
        self.family, self.sensors = family, sensors
        width = len(observation.of_a_step(family.locates_discharges))
        self._history = np.zeros((count, family.history + sensors.delay_steps, width), np.float32)
        self._dials = np.zeros((count, len(observation.DIALS)), np.float32)
        # (n,) `SHOWN`: what the windows of the present step showed
        self.sums: NDArray[np.void] = np.zeros(count, observation.SHOWN)
        self._scales: NDArray[np.void] = np.zeros(count, observation.SCALE)
        self._take_arguments(slice(None))
        self._threaded_ns = np.zeros(count, np.int64)
        self._broke_at = np.zeros(count)
        self._values = np.zeros(len(observation.MEASURED))

    def begin(self, i: int, row: np.void, machine: Machine, noise_key: np.uint64 | int = 0) -> None:
        """Begin an episode on a machine; `row` is its `path_follower.SUB_ENV`."""
        self._history[i] = 0.0
        self.sums[i] = np.zeros((), observation.SHOWN)
        self._dials[i] = observation.values_of(observation.DIALS, machine, 1)[0]
        self._scales[i]["key"], self._scales[i]["draws"] = noise_key, 0
        self._broke_at[i] = 0.0
        self._take_arguments(i)
        self.take_scale(i, row)
        self.thread(i, row)

    def _take_arguments(self, which: int | slice) -> None:
        """Divide by what the arguments are at the episode's begin."""
        for name, value in (
            ("max_feed_um_s", self.family.max_feed_um_s), ("wires", self.family.wires),
            ("episode_s", self.family.episode_s or np.inf),
        ):  # fmt: skip
            self._scales[name][which] = value

    def take_scale(self, i: int, row: np.void) -> None:
        """Divide by what belongs to the generator's setting from now on."""
        scale = self._scales[i]
        for name in ("open_V", "limit_A", "wait_us"):
            scale[name] = row[name]
        scale["noise_share"], scale["step"] = self.sensors.noise_share, self.sensors.step

    def thread(self, i: int, row: np.void) -> None:
        """Begin with a fresh wire."""
        self._threaded_ns[i] = row["elapsed_ns"]

    def lose_wire(self, i: int, row: np.void, setting_us: tuple[float, float]) -> None:
        """Note the setting at which a wire broke, and begin with the next one."""
        on_us, period_us = setting_us
        self._broke_at[i] = max(self._broke_at[i], period_us / on_us)
        self.thread(i, row)

    def begin_step(self) -> None:
        """Begin a step, of which nothing has been seen yet."""
        self.sums.view(np.int64)[:] = 0  # as records it would take ten times as long

    def add(self, active: NDArray[np.int64], rows: NDArray[np.void], windows: NDArray[np.void]) -> None:
        """Add a window of some episodes; `rows` are all `path_follower.SUB_ENV`, `windows` `kernel.state.WINDOW`."""
        observation.gather(active, rows, windows, self.sums)

    def end_step(self, active: NDArray[np.int64]) -> None:
        """Put the steps of some episodes before those that came earlier."""
        observation.show(active, self.sums, self._scales, self._history, self._values)

    def observations(self, rows: NDArray[np.void], corner_um: Floats, corner_deg: Floats) -> NDArray[np.float32]:
        """Return all observations, (n, entries), in a fresh array; corners as `Known` has them."""
        parts = [self._history[:, self.sensors.delay_steps :].reshape(len(rows), -1), self._dials]
        family = self.family
        known = observation.known_entries(family.knows_corners, family.offset_um is not None, family.knows_wires)
        if known:
            age_s = np.asarray((rows["elapsed_ns"] - self._threaded_ns) * 1e-9, np.float64)
            what = observation.Known(
                rows, corner_um, corner_deg, age_s, self._broke_at, family.offset_um, self._scales
            )
            parts.append(observation.values_of(known, what, len(rows)))
        return np.concatenate(parts, axis=1)


def window_of(window: WindowObservation) -> NDArray[np.void]:
    """Return what a machine shows of a window as a record of it, (1,) `kernel.state.WINDOW`; arcs look as sparks."""
    found: NDArray[np.void] = np.zeros(1, WINDOW)
    row, us = found[0], window.duration_s * 1e6
    ignited = WINDOW_PULSES - window.short - window.open
    row["counts"][[SHORT, OPEN, SPARK]] = window.short, window.open, ignited
    row["duration_ns"] = round(window.duration_s * 1e9)  # the plant counts whole nanoseconds
    row["voltage_us"], row["charge_A_us"] = window.mean_voltage_V * us, window.mean_current_A * us
    row["delay_us"] = window.mean_delay_us * ignited if ignited else 0.0
    row["ignitions"], row["fifths"] = ignited, window.fifths
    return found
