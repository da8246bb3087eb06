"""Faults of an axis under a drive with a loop, while the machine runs.

>>> parse_fault("x:stuck@2.5")
AxisFault(axis='x', fault='stuck', at_s=2.5)
"""

import math
from typing import NamedTuple

from edmsim.compiled.axis_rows import FAULT_IN, PHASE_A, PHASE_B
from edmsim.errors import InputError
from edmsim.plant.axes.board import NEVER, hold_in_reset
from edmsim.plant.kernel.state import Axes


class AxisFault(NamedTuple):
    """A fault of an axis from a time on."""

    axis: str  # ``x`` or ``y``
    fault: str  # one of `FAULTS`
    at_s: float  # machine time from which on it is there; from the cut's begin, for 0


FAULTS = ("stuck", "swapped", "unplugged", "supply-off", "logic-off", "fault-line", "stalled")
"""The rotor is held; the encoder's wires are exchanged, so that the loop turns the wrong way; they are unplugged; the
motor has no supply, and the capacitor at its bridge is discharged; the drive's logic has none; its fault input is
pulled low; it computes no more."""


def break_axis(axes: Axes, k: int, fault: str) -> None:
    """Give an axis one of `FAULTS`; done twice it is as done once."""
    row = axes.rows[k : k + 1]
    match fault:
        case "stuck":
            row["locked"] = 1
        case "swapped":
            row["swapped"] = 1
        case "unplugged":
            row["unplugged"] |= PHASE_A | PHASE_B
        case "supply-off":
            axes.motors["supply_V"][k] = row["link_V"] = 0.0
        case "logic-off":
            hold_in_reset(axes, k)
        case "fault-line":
            row["hand_lines"] |= FAULT_IN
        case "stalled":
            axes.drives["stalled_until_ns"][k] = NEVER


_FORM = "an axis' fault is AXIS:FAULT@SECONDS, x:stuck@2.5 say"


def parse_fault(text: str) -> AxisFault:
    """Parse a fault; raises `InputError` if it is invalid."""
    where, _, at = text.partition("@")
    axis, _, fault = where.partition(":")
    if axis not in ("x", "y"):
        raise InputError(f"{text!r} names no axis x or y; {_FORM}")
    if fault not in FAULTS:
        raise InputError(f"{text!r} names no fault; choose one of {', '.join(FAULTS)}; {_FORM}")
    try:
        at_s = float(at)
    except ValueError:
        at_s = math.nan
    if not 0 <= at_s < math.inf:
        raise InputError(f"{text!r} has no time of 0 s or more behind @; {_FORM}")
    return AxisFault(axis, fault, at_s)
