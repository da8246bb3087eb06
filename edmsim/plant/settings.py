"""Settings of a plant's generator as the pulse loop wants them, each worked out once."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from edmsim.plant import constants
from edmsim.plant.gap.breakdown import GapLaw
from edmsim.plant.gap.coverage import GasLaw
from edmsim.plant.gap.generator import switched_off, timing
from edmsim.plant.kernel.state import Timing
from edmsim.plant.resolution import Resolution

if TYPE_CHECKING:
    from edmsim.machine.machine import Machine

_MOST = 128  # settings that are kept, some 10 kB each; a knob with detents comes back to them


class GeneratorSetting(NamedTuple):
    """Times and currents of a setting, what follows for breakdown and gas; the machine with it; whether it is on."""

    timing: Timing
    gap: GapLaw
    gas: GasLaw
    machine: Machine
    on: bool


class GeneratorSettings:
    """The settings of one machine."""

    def __init__(self, machine: Machine, resolution: Resolution) -> None:
        self._machine, self._resolution = machine, resolution
        self._known: dict[tuple[float, float, bool], GeneratorSetting] = {}

    def get(self, t_on_us: float, t_period_us: float, on: bool) -> GeneratorSetting:
        """Return a setting, with the generator on or off; raises `InputError` if the generator refuses it."""
        key = t_on_us, t_period_us, on
        if key not in self._known:
            if len(self._known) == _MOST:
                self._known.clear()
            self._known[key] = self._make(*key)
        return self._known[key]

    def _make(self, t_on_us: float, t_period_us: float, on: bool) -> GeneratorSetting:
        machine = self._machine
        if (t_on_us, t_period_us) != (machine.t_on_us, machine.t_period_us):
            machine = machine.with_pulses(t_on_us, t_period_us)
        times = timing(machine) if on else switched_off(timing(machine))
        law = constants.gap_law(machine, self._resolution, times.open_V)
        return GeneratorSetting(times, law, constants.gas_law(machine, times), machine, on)
