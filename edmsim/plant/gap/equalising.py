"""Equalising pulses: pulses of the other polarity that hold the mean gap voltage at 0 V (thesis 1982, section 2.6).

The generator integrates the gap voltage of the working pulses. In the pauses it switches a second supply to the gap,
of the other polarity and through a large resistor, until the integral is back at 0 or the pause is over.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmsim.machine.parts import Equalising
from edmsim.plant.kernel.state import ISO_PULSE, Timing

if TYPE_CHECKING:
    from edmsim.plant.window import PulseWindow


class OppositePulses(NamedTuple):
    """The equalising pulses of a window."""

    # at the gap and through its water while they last, both below 0
    voltage_V: float
    current_A: float
    on_us: float  # how long all of them together last
    net_voltage_V: float  # mean gap voltage of the window, they and the working pulses added with their signs
    power_W: float  # what their supply gives, averaged over the window


def opposite_pulses(
    window: PulseWindow, timing: Timing, circuit: Equalising, leakage_S: float
) -> OppositePulses:
    """Work out the equalising pulses that a window's working pulses call for.

    What a pause has no room for, later ones of the window make up for. No pulse follows a short circuit: the
    generator has seen that there is no gap to hold a voltage.
    """
    duration_us = window.duration_ns * 1e-3
    supply_V, resistance_ohm = circuit.voltage_V.value, circuit.resistance_ohm.value
    voltage_V = supply_V / (1.0 + resistance_ohm * leakage_S)
    current_A = voltage_V * leakage_S
    owed_us = window.mean_voltage_V * duration_us / voltage_V
    on_us = max(0.0, min(owed_us, _room_us(window, timing)))
    net_V = max(0.0, window.mean_voltage_V - voltage_V * on_us / duration_us)  # not below by rounding
    return OppositePulses(-voltage_V, -current_A, on_us, net_V, supply_V * current_A * on_us / duration_us)


def pulse_lengths_us(
    integral_V_us: NDArray[np.float64], room_us: NDArray[np.float64], voltage_V: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return how long the opposite pulse behind each working pulse lasts (n, pulses), within its pause's room."""
    lengths, owed = np.zeros_like(integral_V_us), np.zeros(len(integral_V_us))
    per_volt = np.divide(1.0, voltage_V, out=np.zeros_like(voltage_V), where=voltage_V > 0.0)
    for n in range(integral_V_us.shape[1]):
        owed += integral_V_us[:, n]
        lengths[:, n] = np.minimum(owed * per_volt, room_us[:, n])
        owed -= lengths[:, n] * voltage_V
    return lengths


def _room_us(window: PulseWindow, timing: Timing) -> float:
    """Pauses of a window's pulses all together, without those after shorts."""
    ignited = window.spark + window.arc
    short_us = timing.period_ns * 1e-3 if timing.period_ns else timing.on_us + timing.pause_us
    if timing.mode == ISO_PULSE:
        busy_us = timing.on_us * (ignited + window.open)
    else:
        waited_us = window.mean_delay_us * ignited if ignited else 0.0
        busy_us = waited_us + timing.on_us * ignited + timing.wait_us * window.open
    return window.duration_ns * 1e-3 - window.short * short_us - busy_us
