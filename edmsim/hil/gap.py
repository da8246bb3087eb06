"""A wire in a gap with commanded axes and generator: the plant, advanced by frames of some pulses.

A window of 255 pulses would be longer than the interval in which a board updates its outputs.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.cosim.straight import begin
from edmsim.errors import InputError, methods_refuse_wrong_types
from edmsim.machine.machine import Machine
from edmsim.machine.pulse_window import PulseWindow
from edmsim.machine.setting import WINDOW_PULSES
from edmsim.numeric import finite
from edmsim.plant.kernel.state import Timing
from edmsim.plant.resolution import Resolution
from edmsim.plant.window import PlantError, without_wire
from edmsim.plant.workpiece.blanks import SLOT_GAP_UM
from edmsim.snapshots import ArraySnapshots, with_prefix

# Setpoints of the axes from the other side: positions, velocities or steps, converted to motor steps in each frame.

AXES = ("X", "Y")
VELOCITY_COUNTS_S = 0.5
"""Time in s for which a velocity is valid (ours): a sender repeats velocities, so the machine stops if its controller
stops, as it does without step pulses."""
_NEAR = 1e-6  # tolerance of positions, which are sums of floats, as a share of a step


class Setpoints(ArraySnapshots):
    """Setpoints of x and y, from 0 to the travel, which move in motor steps up to a speed."""

    STATE = ("_counted", "_now_um", "_target_um", "_velocity_um_s", "_until_ns")

    def __init__(self, place_um: tuple[float, float], step_um: float, max_um_s: float, travel_um: float) -> None:
        self._step_um, self._max_um_s, self._travel_um = step_um, max_um_s, travel_um
        self._counted = list(place_um)
        self._now_um = list(place_um)
        self._target_um = list(place_um)  # NaN for none
        self._velocity_um_s = [0.0, 0.0]
        self._until_ns = 0

    def go_to(self, place_um: tuple[float, float]) -> None:
        """Move to a position, each axis at its greatest speed."""
        self._target_um = [self._within(place) for place in place_um]

    def step(self, axis: int, steps: int) -> None:
        """Move an axis by some steps, in addition to pending ones."""
        target = self._target_um[axis]
        at = self._counted[axis] if math.isnan(target) else target
        self._target_um[axis] = self._within(at + steps * self._step_um)

    def move_at(self, velocity_um_s: tuple[float, float], now_ns: int) -> None:
        """Move at a velocity, for at most `VELOCITY_COUNTS_S`; it is clamped to the axes' greatest speed."""
        if any(map(math.isnan, velocity_um_s)):
            raise InputError("a feed in um/s must be a number, not nan")
        most = self._max_um_s
        self._velocity_um_s = [max(-most, min(most, v)) for v in velocity_um_s]
        self._target_um = [math.nan, math.nan]
        self._until_ns = now_ns + round(VELOCITY_COUNTS_S * 1e9)

    def plan(self, start_ns: int, end_ns: int) -> list[tuple[int, int, int]]:
        """Return the motor steps of a frame that ends at `end_ns` or before, in order of time."""
        found = []
        for axis in (0, 1):
            speed, seconds = self._speed(axis, start_ns, end_ns)
            if speed == 0.0:
                continue
            way_um = self._within(self._now_um[axis] + speed * seconds) - self._counted[axis]
            direction = 1 if speed > 0 else -1
            for k in range(1, int(direction * way_um / self._step_um + _NEAR) + 1):
                at_um = self._counted[axis] + direction * k * self._step_um
                after_s = max((at_um - self._now_um[axis]) / speed, 0.0)
                found.append((min(start_ns + int(after_s * 1e9), end_ns - 1), axis, direction))
        return sorted(found)

    def keep(self, start_ns: int, end_ns: int, counted_um: tuple[float, float]) -> None:
        """Advance the setpoints to the frame's end, with the axes' position after its steps."""
        for axis in (0, 1):
            speed, seconds = self._speed(axis, start_ns, end_ns)
            target = self._target_um[axis]
            reached = self._within(self._now_um[axis] + speed * seconds)
            self._now_um[axis] = target if abs(target - reached) < _NEAR * self._step_um else reached
        self._counted = list(counted_um)

    def _within(self, place_um: float) -> float:
        return max(0.0, min(self._travel_um, place_um))

    def _speed(self, axis: int, start_ns: int, end_ns: int) -> tuple[float, float]:
        """Return the speed of a setpoint in a frame, and the time for which it moves."""
        frame_s = (end_ns - start_ns) * 1e-9
        target = self._target_um[axis]
        if not math.isnan(target):
            way = target - self._now_um[axis]
            return math.copysign(self._max_um_s, way) if way else 0.0, min(abs(way) / self._max_um_s, frame_s)
        left_s = max(self._until_ns - start_ns, 0) * 1e-9
        return self._velocity_um_s[axis], min(frame_s, left_s)


class Output(NamedTuple):
    """Generator command for a frame."""

    pulses: int  # 1 to 255
    on: bool
    t_on_us: float
    t_period_us: float
    # voltage until ignition and peak current; None for those of the machine's set-up
    open_V: float | None = None
    peak_A: float | None = None


class Frame(NamedTuple):
    """The pulses of a frame."""

    window: PulseWindow  # their sums
    pulses: NDArray[np.void]  # (n,): rows of `edmsim.plant.kernel.state.PULSE`, one for every pulse
    timing: Timing  # the generator's setting for them
    on: bool  # whether the generator was on; if not, the rows are times without a pulse


def check_gap(machine: Machine, gap_um: float) -> None:
    """Raise `InputError` if a gap at the start is below 1 um or wider than the wire."""
    if not 1.0 <= finite("gap_um", gap_um) <= machine.wire_diameter_um:
        raise InputError(f"the gap is 1 to {machine.wire_diameter_um:g} um, a wire's diameter, not {gap_um:g}")


@methods_refuse_wrong_types
class Gap:
    """A wire at the end of a short slot along +x, with commanded axes.

    Parameters
    ----------
    machine : Machine
    seed : int
        The same seed and the same commands at the same times give the same result, bit for bit.
    resolution : str or Resolution
    gap_um : float
        Gap round the wire at the start; behind it the slot is open.

    Attributes
    ----------
    plant : Plant
    setpoints : Setpoints
        Targets of the axes.
    lost : str
        Reason why the wire is lost; empty while there is a wire.
    """

    def __init__(
        self, machine: Machine, seed: int = 0, *, resolution: str | Resolution = "fast", gap_um: float = SLOT_GAP_UM
    ) -> None:
        check_gap(machine, gap_um)
        self.plant = begin(machine, seed, resolution=resolution, gap_um=gap_um)
        self.plant.watch_pulses()
        self.origin_um = self.plant.commanded_um
        self._own = self._choices = machine.open_voltage_V, machine.peak_current_A
        table = machine.base.table
        travel_um = table.travel_mm.value * 1e3
        self.setpoints = Setpoints(self.origin_um, table.step_um.value, table.rapid_um_s.value, travel_um)
        self.lost = ""

    @property
    def time_s(self) -> float:
        """Machine time."""
        return self.plant.time_ns * 1e-9

    @property
    def place_um(self) -> tuple[float, float]:
        """Position by the counters, relative to the wire's first position."""
        x, y = self.plant.commanded_um
        return x - self.origin_um[0], y - self.origin_um[1]

    def run(self, output: Output) -> Frame:
        """Run a frame at a setting of the generator.

        If the wire breaks or leaves the model's valid range, `lost` has the reason, and all pulses are open until
        `thread`.

        Raises
        ------
        InputError
            If the generator refuses the setting; the gap is then unchanged.
        """
        self._set(output)
        plant, start_ns = self.plant, self.plant.time_ns
        steps = self.setpoints.plan(start_ns, start_ns + output.pulses * plant.longest_window_ns // WINDOW_PULSES)
        try:
            window = plant.advance(steps, output.pulses)
        except PlantError as error:
            self.lost, window = str(error), error.window
            plant.continue_without_wire()
        if window.broken and not self.lost:
            kelvin = f"{window.wire_temperature_K:.0f} K"
            self.lost = f"the wire broke {plant.broken_height_mm:.1f} mm above the lower face, at {kelvin}"
            plant.continue_without_wire()
        self.setpoints.keep(start_ns, plant.time_ns, plant.commanded_um)
        pulses = without_wire(window, plant.timing) if self.lost else plant.last_pulses()
        return Frame(window, pulses, plant.timing, output.on)

    def thread(self) -> None:
        """Thread a new wire at the axes' position; on this bench it takes no time."""
        self.plant.rethread(self.plant.commanded_um, 0)
        self.lost = ""

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return everything that changes, as arrays; `restore` continues bit for bit."""
        return {**self.plant.snapshot(), **{f"gap.{name}": array for name, array in self._own_state().items()}}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Load a `snapshot` of a gap with the same set-up; raises `InputError` for a damaged one."""
        own = with_prefix(state, "gap.")
        if own.keys() != self._own_state().keys():
            raise InputError("this is not a snapshot of a gap: its setpoints are missing")
        self._choose(*(None if np.isnan(value) else float(value) for value in own["choices"]))
        self.plant.restore({name: value for name, value in state.items() if not name.startswith("gap.")})
        self.setpoints.restore(own)
        self.lost = own["lost"].tobytes().decode()

    def _own_state(self) -> dict[str, NDArray[Any]]:
        """Return the state that is not in the plant's snapshot."""
        choices = [np.nan if value is None else value for value in self._choices]
        lost = np.frombuffer(self.lost.encode(), np.uint8).copy()
        return {**self.setpoints.snapshot(), "choices": np.array(choices), "lost": lost}

    def _set(self, output: Output) -> None:
        plant = self.plant
        open_V, peak_A = (own if new is None else new for own, new in zip(self._own, output[-2:], strict=True))
        if (open_V, peak_A) != self._choices:  # check them with the pulse times before anything is set
            plant.machine.with_(
                open_voltage_V=open_V, peak_current_A=peak_A, t_on_us=output.t_on_us, t_period_us=output.t_period_us
            )
        self._choose(open_V, peak_A)
        if (output.t_on_us, output.t_period_us) != (plant.machine.t_on_us, plant.machine.t_period_us):
            self.plant.set_generator(output.t_on_us, output.t_period_us)
        if output.on != plant.generator_on:
            self.plant.switch_generator(output.on)

    def _choose(self, open_V: float | None, peak_A: float | None) -> None:
        """Set voltage and current; they are constant in a plant, so another one continues from its state."""
        if (open_V, peak_A) == self._choices:
            return
        machine = self.plant.machine.with_(open_voltage_V=open_V, peak_current_A=peak_A)
        self.plant = self.plant.with_machine(machine)
        self.plant.watch_pulses()
        self._choices = open_V, peak_A
