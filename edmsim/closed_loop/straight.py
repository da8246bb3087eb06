"""Straight cuts in steady state, for measurements of the pulse loop in validation and calibration.

A cut begins at the end of a slot, so the wire has walls around it from the first pulse on, and is measured after it
has settled.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from edmsim.closed_loop.cycle import Cycle, EvenSteps
from edmsim.controllers import FeedController, WindowObservation, make, user_controllers
from edmsim.errors import InputError, refuses_wrong_types
from edmsim.machine.machine import Machine
from edmsim.machine.pulse_window import PulseWindow
from edmsim.metrology.edges import metal_at
from edmsim.numeric import finite, real
from edmsim.plant.plant import Plant
from edmsim.plant.resolution import Resolution
from edmsim.plant.workpiece.blanks import SLOT_GAP_UM, started_slot

FASTEST_UM_S = 400.0  # greatest feed of controllers here (ours: above the cutting rate of all measured set-ups)
_STEP_UM = 2.0  # spacing of the places at which the kerf is measured
_MARGIN_UM = 200.0  # distance from the wire's surface in which the kerf is searched


@dataclass(frozen=True)
class Cut:
    """A straight cut along +x, measured after it had settled; if the wire broke, the last window has `broken`."""

    plant: Plant  # after the cut
    windows: list[PulseWindow]  # measured windows; if the wire broke, the last one has `broken`
    from_um: float  # from_um, travel_um: commanded position at the first measured window, and travel from there
    travel_um: float

    @property
    def seconds(self) -> float:
        """Machine time measured."""
        return sum(w.duration_ns for w in self.windows) * 1e-9

    @property
    def feed_um_s(self) -> float:
        """Mean feed."""
        return self.travel_um / self.seconds

    @property
    def ignitions(self) -> int:
        """Sparks and arcs."""
        return sum(w.spark + w.arc for w in self.windows)

    @property
    def mean_delay_us(self) -> float:
        """Mean delay of the pulses that ignited; NaN if none did."""
        return self._per_ignition(lambda w: w.mean_delay_us)

    @property
    def gap_um(self) -> float:
        """Mean gap at the places of ignition; NaN without ignitions."""
        return self._per_ignition(lambda w: w.gap_um)

    @property
    def lag_um(self) -> float:
        """Mean deflection of the wire against the feed, averaged over the height."""
        return -float(np.mean([w.deflection_um[0] for w in self.windows]))

    @property
    def vibration_um(self) -> float:
        """Rms motion of the wire about its mean in each window, both axes."""
        return math.sqrt(float(np.mean([w.vibration2_um2 for w in self.windows])))

    @property
    def debris(self) -> float:
        """Mean debris share of the gap's water."""
        return float(np.mean([w.debris for w in self.windows]))

    @property
    def removed_mm3(self) -> float:
        """Metal removed."""
        return sum(w.crater_um3 for w in self.windows) * 1e-9

    @property
    def energy(self) -> float:
        """Energy of sparks and arcs in J."""
        return sum(w.energy_J for w in self.windows)

    @property
    def charge(self) -> float:
        """Charge of sparks and arcs in C, without short-circuit pulses."""
        return self.energy / self.plant.machine.material.burning_voltage_V.value

    @property
    def working_current_A(self) -> float:
        """Mean current without short-circuit pulses, the index of Sato et al."""
        return self.charge / self.seconds

    @property
    def broken(self) -> bool:
        """Whether the wire broke."""
        return self.windows[-1].broken

    @cached_property
    def kerf_um(self) -> np.typing.NDArray[np.float64]:
        """Width of the kerf in each slice from the bottom: cut area over length, as far as the wire has passed."""
        radius = self.plant.machine.wire_diameter_um / 2
        x = np.arange(self.from_um, self.from_um + self.travel_um - radius - SLOT_GAP_UM, 2 * _STEP_UM)
        if not len(x):
            raise InputError(f"a travel of {self.travel_um:g} um leaves no kerf behind the wire to measure")
        centre_um = self.plant.machine.base.table.centre_um
        y = centre_um[1] + np.arange(-radius - _MARGIN_UM, radius + _MARGIN_UM, _STEP_UM)
        places = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        cut = 1.0 - metal_at(self.plant.field, places).reshape(-1, len(x), len(y))
        return np.asarray(cut.sum(axis=2).mean(axis=1) * _STEP_UM)

    def share(self, kind: str) -> float:
        """Share of a class of pulses: "short", "open", "spark" or "arc"."""
        return float(sum(getattr(w, kind) for w in self.windows) / sum(w.pulses for w in self.windows))

    def _per_ignition(self, of: Callable[[PulseWindow], float]) -> float:
        ignited = [w for w in self.windows if w.spark + w.arc]
        total = sum(of(w) * (w.spark + w.arc) for w in ignited)
        return total / self.ignitions if ignited else math.nan


class Traverse(EvenSteps):
    """A cut along an axis at a fixed feed or with a controller, window by window; an alarm is only recorded."""

    def __init__(self, plant: Plant, feed: float | FeedController) -> None:
        um_s = real(feed)
        law = user_controllers.check_is_controller(feed) if um_s is None else make("fixed", feed_um_s=um_s)
        self._controller = law
        super().__init__(plant.machine.base.table.step_um.value, self._controller.reset(FASTEST_UM_S).feed_um_s)
        self.alarm: str | None = None
        self._plant = plant
        self._cycle = Cycle(plant, self, self._decide)

    def run(self, seconds: float) -> list[PulseWindow]:
        """Run for some machine time, or until the wire breaks."""
        windows: list[PulseWindow] = []
        until_ns = self._plant.time_ns + round(seconds * 1e9)
        while self._plant.time_ns < until_ns and not (windows and windows[-1].broken):
            windows.append(self.window())
        return windows

    def window(self) -> PulseWindow:
        """Run one window."""
        return self._cycle.run_window().window

    def _decide(self, observation: WindowObservation) -> None:
        self.feed_um_s, self.alarm = self._controller.update(observation)[:2]


def begin(
    machine: Machine, seed: int, *, resolution: str | Resolution = "fast", gap_um: float = SLOT_GAP_UM
) -> Plant:
    """Return a plant with its wire at the end of a slot, with a gap of `gap_um` in front and on both sides."""
    centre_um = machine.base.table.centre_um
    stock = started_slot(machine, centre_um, gap_um=gap_um)
    return Plant(machine, seed, stock=stock, position_um=centre_um, resolution=resolution)


def cut_straight(
    machine: Machine, feed: float | FeedController, seed: int, *, settle_s: float, seconds: float,
    resolution: str | Resolution = "fast",
) -> Cut:
    """Cut along +x from the end of a slot; if the wire breaks before the cut settles, the result covers this time."""
    for name, time_s in (("settle_s", settle_s), ("seconds", seconds)):
        if not finite(name, time_s) > 0:
            raise InputError(f"{name} is {time_s!r}: give a time above 0 s")
    plant = begin(machine, seed, resolution=resolution)
    traverse = Traverse(plant, feed)
    start_um = plant.commanded_um[0]
    windows = traverse.run(settle_s)
    if not windows[-1].broken:
        start_um = plant.commanded_um[0]
        windows = traverse.run(seconds)
    return Cut(plant, windows, start_um, plant.commanded_um[0] - start_um)


# Single pulses of a straight cut, for figures that need a finer resolution than windows of 255 pulses.

KINDS = ("short", "open", "spark", "arc")  # classes of pulses; `PulseSample.kind` counts them from 0
SETTLE_S = 3.0  # machine time before the first sampled pulse (ours: several times the settling time of a gap)
PULSES = 4096
"""Sampled pulses (ours: the spectrum has a resolution of some 20 Hz at 100 us, and shares an error of 1 %)."""


@dataclass(frozen=True, eq=False)
class PulseSample:
    """Single pulses of a straight cut at a fixed feed in steady state."""

    machine: Machine  # the set-up
    feed_um_s: float
    period_us: float  # pulse period
    kind: np.typing.NDArray[np.int64]  # (n,): class of every pulse, see `KINDS`
    delay_us: np.typing.NDArray[np.float64]  # (n,): ignition delay; NaN if the pulse did not ignite
    # (n, slices, 2): wire minus guides after the pulse, per slice from the bottom, X and Y
    deflection_um: np.typing.NDArray[np.float64]

    def share(self, kind: str) -> float:
        """Share of a class of pulses, 0..1."""
        return float(np.mean(self.kind == KINDS.index(kind)))


@refuses_wrong_types
def sample_pulses(
    machine: Machine, feed_um_s: float, *, seed: int = 0, pulses: int = PULSES, resolution: str = "fast"
) -> PulseSample:
    """Cut straight along +X from the start of a slot, and sample single pulses in steady state.

    Parameters
    ----------
    machine : Machine
    feed_um_s : float
        Above 0.
    seed : int
    pulses : int
        Number of pulses, at least 1.
    resolution : {"fast", "default", "fine"}

    Raises
    ------
    InputError
        If the generator's period is not fixed, feed or number of pulses is not above 0, or the wire breaks before
        the steady state.
    PlantError
        If the feed drives the wire into the metal.
    """
    if not 0 < feed_um_s < math.inf or pulses < 1:
        raise InputError(f"sampling pulses needs a cut: {pulses} pulses at {feed_um_s:g} um/s are not a cut")
    plant = begin(machine, seed, resolution=resolution)
    if not plant.window_ns:
        raise InputError("sampling pulses needs generators of a fixed period")
    traverse = Traverse(plant, feed_um_s)
    if traverse.run(SETTLE_S)[-1].broken:
        raise InputError(f"the wire broke within {SETTLE_S:g} s at {feed_um_s:g} um/s: no pulses to see")
    return _look(plant, traverse, pulses)


def _look(plant: Plant, steps: EvenSteps, pulses: int) -> PulseSample:
    period_ns = round(plant.machine.t_period_us * 1e3)
    kind, delay = np.empty(pulses, np.int64), np.empty(pulses)
    deflection = np.empty((pulses, plant.resolution.slices, 2))
    for n in range(pulses):
        start_ns = plant.time_ns
        pulse = plant.advance_pulse(steps.plan(start_ns, start_ns + period_ns))
        steps.keep(start_ns, plant.time_ns)
        kind[n] = (pulse.short, pulse.open, pulse.spark, pulse.arc).index(1)
        delay[n] = pulse.mean_delay_us
        deflection[n] = plant.deflections_um()
    return PulseSample(plant.machine, steps.feed_um_s, period_ns * 1e-3, kind, delay, deflection)
