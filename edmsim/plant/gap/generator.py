"""The pulse generator: voltages, currents and times.

Modes (thesis 1982, section 2.3, rows T-3..T-5):

* ``iso-pulse``: the switch closes for t(i) in every period t(p); the discharge lasts t(e) = t(i) - t(d).
* ``iso-energetic``: t(i) is stretched until the discharge has lasted t(e) = ``t_on_us``; the pause
  t(p) - t(e) follows, so the period varies.
* ``ignition-pulse``: a high voltage precedes every pulse so that it nearly always ignites; t(e) = ``t_on_us``.

Equalising pulses of the other polarity hold the mean gap voltage at 0 V (thesis 1982, section 2.6). The generator
integrates the gap voltage of the working pulses. In the pauses it connects a second supply of the other polarity to
the gap, through a large resistor, until the integral is 0 or the pause is over.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.machine import setting
from edmsim.machine.components import Equalising
from edmsim.machine.machine import Machine
from edmsim.machine.pulse_window import PulseWindow
from edmsim.plant.kernel.state import GRID, IGNITION_PULSE, ISO_ENERGETIC, ISO_PULSE, Timing

_MODES = {"iso-pulse": ISO_PULSE, "iso-energetic": ISO_ENERGETIC, "ignition-pulse": IGNITION_PULSE}
_IDLE_V = 1e-3  # voltage of a generator that is off: negligible, but not 0, because it is a divisor


def _removal_mm3_J(machine: Machine) -> float:
    """Return the metal removed per joule by discharges of this on-time; short ones eject less of the molten metal."""
    spark = machine.base.discharge
    length = min(machine.t_on_us / spark.removal_reference_us.value, 1.0)
    return float(machine.material.removal_mm3_J.value * length**spark.removal_exponent.value)


def crater_um3(machine: Machine) -> float:
    """Return the mean crater volume of this setting's discharges in water, if all last the on-time."""
    power_W = machine.material.burning_voltage_V.value * setting.discharge_current_A(machine)
    return _removal_mm3_J(machine) * 1e9 * power_W * machine.t_on_us * 1e-6


def timing(machine: Machine) -> Timing:
    """Return the setting as data of the pulse loop."""
    mode = _MODES[machine.generator.mode]
    on, period, wait = machine.t_on_us, machine.t_period_us, setting.ignition_wait_us(machine)
    pause = period - on
    varies = mode == ISO_ENERGETIC
    grid = math.ceil((wait + on + pause) * 1e3 / GRID) * 1e-3 if varies else period / GRID
    return Timing(
        mode=mode,
        open_V=setting.open_V(machine),
        burning_V=machine.material.burning_voltage_V.value,
        removal_um3_J=_removal_mm3_J(machine) * 1e9,
        current_A=setting.discharge_current_A(machine),
        short_A=setting.short_current_A(machine),
        current_form=setting.pulse_form(machine).square,
        on_us=on,
        wait_us=wait,
        arc_share=setting.arc_share(machine),
        pause_us=pause,
        period_ns=0 if varies else round(period * 1e3),
        grid_us=grid,
    )


def switched_off(working: Timing) -> Timing:
    """Return the setting without voltage and current: time passes in its periods, and nothing else happens."""
    return working._replace(open_V=_IDLE_V, burning_V=_IDLE_V, current_A=0.0, short_A=0.0)


class OppositePulses(NamedTuple):
    """The equalising pulses of a window."""

    # at the gap and through its water during a pulse; both are negative
    voltage_V: float
    current_A: float
    on_us: float  # total duration
    net_voltage_V: float  # mean gap voltage of the window over equalising and working pulses, with their signs
    power_W: float  # mean power of their supply over the window


def opposite_pulses(window: PulseWindow, timing: Timing, circuit: Equalising, leakage_S: float) -> OppositePulses:
    """Compute the equalising pulses for a window's working pulses."""
    # Later pauses of the window equalise what does not fit into a pause. No pulse follows a short circuit, because
    # the generator has detected that the gap cannot hold a voltage.
    duration_us = window.duration_ns * 1e-3
    supply_V, resistance_ohm = circuit.voltage_V.value, circuit.resistance_ohm.value
    voltage_V = supply_V / (1.0 + resistance_ohm * leakage_S)
    current_A = voltage_V * leakage_S
    owed_us = window.mean_voltage_V * duration_us / voltage_V
    on_us = max(0.0, min(owed_us, _room_us(window, timing)))
    net_V = max(0.0, window.mean_voltage_V - voltage_V * on_us / duration_us)  # rounding must not make it negative
    return OppositePulses(-voltage_V, -current_A, on_us, net_V, supply_V * current_A * on_us / duration_us)


def pulse_lengths_us(
    integral_V_us: NDArray[np.float64], room_us: NDArray[np.float64], voltage_V: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the duration of the equalising pulse after each working pulse (n, pulses), at most that of its pause."""
    lengths, owed = np.zeros_like(integral_V_us), np.zeros(len(integral_V_us))
    per_volt = np.divide(1.0, voltage_V, out=np.zeros_like(voltage_V), where=voltage_V > 0.0)
    for n in range(integral_V_us.shape[1]):
        owed += integral_V_us[:, n]
        lengths[:, n] = np.minimum(owed * per_volt, room_us[:, n])
        owed -= lengths[:, n] * voltage_V
    return lengths


def _room_us(window: PulseWindow, timing: Timing) -> float:
    """Return the total duration of a window's pauses, without those after shorts."""
    ignited = window.spark + window.arc
    short_us = timing.period_ns * 1e-3 if timing.period_ns else timing.on_us + timing.pause_us
    if timing.mode == ISO_PULSE:
        busy_us = timing.on_us * (ignited + window.open)
    else:
        waited_us = window.mean_delay_us * ignited if ignited else 0.0
        busy_us = waited_us + timing.on_us * ignited + timing.wait_us * window.open
    return window.duration_ns * 1e-3 - window.short * short_us - busy_us
