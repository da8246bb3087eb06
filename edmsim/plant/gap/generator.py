"""The pulse generator: voltages, currents and times.

Modes (thesis 1982, section 2.3, rows T-3..T-5):

* ``iso-pulse``: the switch closes for t(i) in every period t(p); the discharge lasts t(e) = t(i) - t(d).
* ``iso-energetic``: t(i) is stretched until the discharge has lasted t(e) = ``t_on_us``; the pause
  t(p) - t(e) follows, so the period varies.
* ``ignition-pulse``: a high voltage precedes every pulse so that it nearly always ignites; t(e) = ``t_on_us``.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from edmsim.machine.setting import (
    arc_share,
    discharge_current_A,
    ignition_wait_us,
    open_V,
    pulse_form,
    short_current_A,
)
from edmsim.plant.kernel.state import GRID, IGNITION_PULSE, ISO_ENERGETIC, ISO_PULSE, Timing

if TYPE_CHECKING:
    from edmsim.machine.machine import Machine

_MODES = {"iso-pulse": ISO_PULSE, "iso-energetic": ISO_ENERGETIC, "ignition-pulse": IGNITION_PULSE}
_IDLE_V = 1e-3
"""Voltage of a generator switched off: nothing next to any gap voltage, but no 0 to divide by."""


def _removal_mm3_J(machine: Machine) -> float:
    """Metal removed per joule by discharges of this setting's length: short ones eject less of what they melt."""
    spark = machine.base.discharge
    length = min(machine.t_on_us / spark.removal_reference_us.value, 1.0)
    return float(machine.material.removal_mm3_J.value * length**spark.removal_exponent.value)


def crater_um3(machine: Machine) -> float:
    """Mean volume of a crater of this setting's discharges in water, all of them lasting the on-time."""
    power_W = machine.material.burning_voltage_V.value * discharge_current_A(machine)
    return _removal_mm3_J(machine) * 1e9 * power_W * machine.t_on_us * 1e-6


def timing(machine: Machine) -> Timing:
    """Return the setting as the pulse loop wants it."""
    mode = _MODES[machine.generator.mode]
    on, period, wait = machine.t_on_us, machine.t_period_us, ignition_wait_us(machine)
    pause = period - on
    varies = mode == ISO_ENERGETIC
    grid = math.ceil((wait + on + pause) * 1e3 / GRID) * 1e-3 if varies else period / GRID
    return Timing(
        mode=mode,
        open_V=open_V(machine),
        burning_V=machine.material.burning_voltage_V.value,
        removal_um3_J=_removal_mm3_J(machine) * 1e9,
        current_A=discharge_current_A(machine),
        short_A=short_current_A(machine),
        current_form=pulse_form(machine).square,
        on_us=on,
        wait_us=wait,
        arc_share=arc_share(machine),
        pause_us=pause,
        period_ns=0 if varies else round(period * 1e3),
        grid_us=grid,
    )


def switched_off(setting: Timing) -> Timing:
    """Return the setting with neither voltage nor current: time passes in its periods, nothing else happens."""
    return setting._replace(open_V=_IDLE_V, burning_V=_IDLE_V, current_A=0.0, short_A=0.0)
