"""The pulse generator: voltages, currents, times, and the settings its supply refuses.

Modes (thesis 1982, section 2.3, rows T-3..T-5):

* ``iso-pulse``: the switch closes for t(i) in every period t(p); the discharge lasts t(e) = t(i) - t(d).
* ``iso-energetic``: t(i) is stretched until the discharge has lasted t(e) = ``t_on_us``; the pause
  t(p) - t(e) follows, so the period varies.
* ``ignition-pulse``: a high voltage precedes every pulse so that it nearly always ignites; t(e) = ``t_on_us``.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from edmsim.errors import InputError
from edmsim.plant.kernel.state import GRID, IGNITION_PULSE, ISO_ENERGETIC, ISO_PULSE, Timing

if TYPE_CHECKING:
    from edmsim.machine.machine import Machine

_MODES = {"iso-pulse": ISO_PULSE, "iso-energetic": ISO_ENERGETIC, "ignition-pulse": IGNITION_PULSE}
T_ON_US = (1.0, 1000.0)
"""On-times of the field (row T-1)."""
T_PERIOD_US = (2.0, 10_000.0)
"""Periods: 500 kHz (row T-36) to 10 ms (row T-2)."""
_IDLE_V = 1e-3
"""Voltage of a generator switched off: nothing next to any gap voltage, but no 0 to divide by."""


def discharge_current_A(machine: Machine) -> float:
    """Current of a discharge: (u(i) - u(e)) / R (row T-4)."""
    return (_supply_V(machine) - machine.material.burning_voltage_V.value) / machine.generator.resistance_ohm.value


def mean_current_A(machine: Machine) -> float:
    """Modelled mean current of a setting, all pulses igniting at once: I t(i) / t(p) (row T-35)."""
    return discharge_current_A(machine) * machine.t_on_us / machine.t_period_us


def least_period_us(machine: Machine, t_on_us: float) -> float:
    """Shortest period at which the supply gives an on-time without exceeding its mean current (rows T-34, T-35)."""
    return discharge_current_A(machine) * t_on_us / machine.generator.mean_current_limit_A.value


def _supply_V(machine: Machine) -> float:
    supply = machine.generator.supply_voltage_V or machine.generator.open_voltage_V
    return supply.value


def check_setting(machine: Machine) -> None:
    """Raise `InputError` for a setting the generator refuses (rows T-1, T-2, T-34..T-36)."""
    for name, value, (low, high) in (
        ("t_on", machine.t_on_us, T_ON_US),
        ("t_period", machine.t_period_us, T_PERIOD_US),
    ):
        if not low <= value <= high:
            raise InputError(f"{name} {value:g} us is not within {low:g}..{high:g} us")
    wait = machine.generator.ignition_wait_us
    busy = machine.t_on_us + (wait.value if wait and machine.generator.mode == "ignition-pulse" else 0.0)
    if busy >= machine.t_period_us:
        raise InputError(f"t_period {machine.t_period_us:g} us leaves no pause after {busy:g} us of pulse")
    current = discharge_current_A(machine)
    if current <= 0:
        raise InputError(f"open voltage {_supply_V(machine):g} V is not above the burning voltage")
    limit = machine.generator.mean_current_limit_A.value
    if mean_current_A(machine) > limit + 1e-9:
        raise InputError(
            f"t_on {machine.t_on_us:g} us in t_period {machine.t_period_us:g} us draws "
            f"{mean_current_A(machine):.2f} A, above the generator's {limit:g} A; t_period must be at least "
            f"{least_period_us(machine, machine.t_on_us):.4g} us"
        )


def timing(machine: Machine) -> Timing:
    """Return the setting as the pulse loop wants it."""
    generator = machine.generator
    mode = _MODES[generator.mode]
    on, period = machine.t_on_us, machine.t_period_us
    wait = on if generator.ignition_wait_us is None else generator.ignition_wait_us.value
    pause = period - on
    varies = mode == ISO_ENERGETIC
    grid = math.ceil((wait + on + pause) * 1e3 / GRID) * 1e-3 if varies else period / GRID
    return Timing(
        mode=mode,
        open_V=generator.open_voltage_V.value,
        burning_V=machine.material.burning_voltage_V.value,
        current_A=discharge_current_A(machine),
        short_A=_supply_V(machine) / generator.resistance_ohm.value,
        on_us=on,
        wait_us=wait,
        pause_us=pause,
        period_ns=0 if varies else round(period * 1e3),
        grid_us=grid,
    )


def switched_off(setting: Timing) -> Timing:
    """Return the setting with neither voltage nor current: time passes in its periods, nothing else happens."""
    return setting._replace(open_V=_IDLE_V, burning_V=_IDLE_V, current_A=0.0, short_A=0.0)
