"""A wire in a gap with commanded axes and generator: the plant, advanced by frames of some pulses; its delays.

A window of 255 pulses would be longer than the interval in which a board updates its outputs.
"""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from edmsim.closed_loop.straight import begin
from edmsim.errors import InputError, methods_refuse_wrong_types, refuses_wrong_types
from edmsim.files import replacing
from edmsim.machine import components, pulse_window
from edmsim.machine.machine import Machine
from edmsim.machine.setting import WINDOW_PULSES
from edmsim.numeric import finite
from edmsim.plant.kernel.state import Timing
from edmsim.plant.resolution import Resolution
from edmsim.plant.window import PlantError, without_wire
from edmsim.plant.workpiece.blanks import SLOT_GAP_UM, started_slot
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
            distance_um = self._within(self._now_um[axis] + speed * seconds) - self._counted[axis]
            direction = 1 if speed > 0 else -1
            for k in range(1, int(direction * distance_um / self._step_um + _NEAR) + 1):
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
            distance = target - self._now_um[axis]
            speed_um_s = math.copysign(self._max_um_s, distance) if distance else 0.0
            return speed_um_s, min(abs(distance) / self._max_um_s, frame_s)
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

    window: pulse_window.PulseWindow  # their sums
    pulses: np.typing.NDArray[np.void]  # (n,): rows of `edmsim.plant.kernel.state.PULSE`, one for every pulse
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

    def snapshot(self) -> dict[str, np.typing.NDArray[Any]]:
        """Return everything that changes, as arrays; `restore` continues bit for bit."""
        return {**self.plant.snapshot(), **{f"gap.{name}": array for name, array in self._own_state().items()}}

    def restore(self, state: dict[str, np.typing.NDArray[Any]]) -> None:
        """Load a `snapshot` of a gap with the same set-up; raises `InputError` for a damaged one."""
        own = with_prefix(state, "gap.")
        if own.keys() != self._own_state().keys():
            raise InputError("this is not a snapshot of a gap: its setpoints are missing")
        self._choose(*(None if np.isnan(value) else float(value) for value in own["choices"]))
        self.plant.restore({name: value for name, value in state.items() if not name.startswith("gap.")})
        self.setpoints.restore(own)
        self.lost = own["lost"].tobytes().decode()

    def _own_state(self) -> dict[str, np.typing.NDArray[Any]]:
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


# A table of ignition delays over gap and voltage, for circuit simulators.

GAPS_UM = (4.0, 6.0, 8.0, 10.0, 12.0, 15.0, 20.0, 30.0)
VOLTAGES_V = (60.0, 80.0, 100.0, 120.0)
QUANTILES = (0.05, 0.1, 0.25, 0.5, 0.75, 0.9, 0.95)
DRAWS = 200  # pulses per gap and voltage (ours: the median's error is a tenth of the delays' spread)
WAIT_US = 10_000.0  # a pulse that has not ignited by then counts as not ignited


class Delays(NamedTuple):
    """Delays of a gap at a voltage."""

    gap_um: float
    open_V: float
    # shares of pulses that were shorts, and that ignited within `WAIT_US`
    short: float
    ignited: float
    # `QUANTILES` of the delays of all pulses except shorts, in us; NaN if a quantile has not ignited
    us: tuple[float, ...]


@refuses_wrong_types
def delay_table(
    machine: Machine, *, gaps_um: Sequence[float] = GAPS_UM, voltages_V: Sequence[float] = VOLTAGES_V,
    draws: int = DRAWS, seed: int = 0, watch: Callable[[int, int], None] | None = None,
) -> list[Delays]:
    """Draw delays of a set-up at gaps and voltages.

    Every pulse is the first one of a wire at rest in clean water, in a slot with the same gap all round and the
    machine's height. In a cut, debris, gas and the wire's vibration change the delays.

    Parameters
    ----------
    machine : Machine
    gaps_um, voltages_V : sequence of float
    draws : int
        Pulses of each.
    seed : int
    watch : callable, optional
        Called with the numbers of finished and of all rows.

    Raises
    ------
    InputError
        If a gap or a voltage cannot be used, or there is nothing to draw.
    """
    if draws < 1 or not len(gaps_um) or not len(voltages_V):
        raise InputError("a table of delays needs gaps, voltages, and 1 or more pulses of each")
    for gap_um in gaps_um:
        check_gap(machine, gap_um)
    rows: list[Delays] = []
    for open_V in voltages_V:
        patient = _patient(machine, open_V)
        for gap_um in gaps_um:
            rows.append(_row(patient, gap_um, open_V, draws, seed + 1000 * len(rows)))
            if watch is not None:
                watch(len(rows), len(voltages_V) * len(gaps_um))
    return rows


def write_delays(rows: Sequence[Delays], file: Path) -> None:
    """Write a table as CSV; the field of a quantile that has not ignited is empty."""
    names = [f"p{100 * quantile:02.0f}_us" for quantile in QUANTILES]
    lines = [",".join(["gap_um", "open_V", "short_share", "ignited_share", *names])]
    for row in rows:
        delays = ["" if np.isnan(us) else f"{us:.3f}" for us in row.us]
        lines.append(
            ",".join([f"{row.gap_um:g}", f"{row.open_V:g}", f"{row.short:.3f}", f"{row.ignited:.3f}", *delays])
        )
    with replacing(file) as partial:
        partial.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _patient(machine: Machine, open_V: float) -> Machine:
    """Return a machine with this voltage whose generator waits long for an ignition."""
    if not machine.material.burning_voltage_V.value < open_V <= 1000.0:
        raise InputError(f"{open_V:g} V ignite nothing: give more than the burning voltage, and at most 1000 V")
    changes = {
        "mode": "iso-energetic", "supply_voltage_V": None,
        "open_voltage_V": components.Constant(value=open_V, source="table of delays"),
        "ignition_wait_us": components.Constant(value=WAIT_US, source="table of delays"), "equalising": None,
        "mean_current_limit_A": components.Constant(value=10_000.0, source="table of delays"),
    }  # fmt: skip
    own = machine.generator.model_copy(update=changes)
    free = dict.fromkeys(("open_voltage_V", "peak_current_A", "resistance_ohm", "ignition_wait_us"))
    patient = machine.model_copy(update={"generator": own, **free})
    patient.check()
    return patient


def _row(machine: Machine, gap_um: float, open_V: float, draws: int, seed: int) -> Delays:
    centre_um = machine.base.table.centre_um
    stock = started_slot(machine, centre_um, gap_um=gap_um)
    plant = begin(machine, seed, gap_um=gap_um)
    plant.watch_pulses()
    shorts, delays = 0, []
    for draw in range(draws):
        if draw:
            plant.reset(seed + draw, stock=stock, position_um=centre_um)
        window = plant.advance(pulses=1)
        shorts += window.short
        if not window.short:
            delays.append(window.mean_delay_us if window.spark + window.arc else np.inf)
    found = np.quantile(delays, QUANTILES, method="inverted_cdf") if delays else np.full(len(QUANTILES), np.nan)
    ignited = sum(np.isfinite(delays)) / draws
    return Delays(
        gap_um, open_V, shorts / draws, float(ignited), tuple(float(v) if v < np.inf else np.nan for v in found)
    )
