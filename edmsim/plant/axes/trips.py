"""The reasons for which axes stopped, in words: from the drives, and from table and wire."""

import math

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.axis_rows import FAULT, FAULT_IN, FAULT_OUT, NET_IN, NET_OUT, NO_COMMAND
from edmsim.plant.axes.drives import AXIS_NAMES, Drives


def reason(drives: Drives) -> str:
    """Return why axes have stopped, the first one first: what stopped each, and what that did to others."""
    rows, lines = drives.axes.rows, drives.axes.drives["lines"]
    stopped = [k for k, name in enumerate(AXIS_NAMES) if name in drives.by_axis and drives.faults() >> k & 1]
    by_line = [k for k in stopped if lines[k] & FAULT and not _own_words(drives, k) and _line_low(drives, k)]
    stopped.sort(key=lambda k: (k in by_line, int(rows["trip_ns"][k])))
    return "; ".join(_of_axis(drives, k) for k in stopped)


def _of_axis(drives: Drives, k: int) -> str:
    row, name = drives.axes.rows[k], AXIS_NAMES[k]
    why = _own_words(drives, k)
    off_um = float(max(row["place_um"] - row["most_um"], row["least_um"] - row["place_um"], 0.0))
    if row["trip"] & NO_COMMAND:
        text = f"the drive of {name} is out of service: it commanded what is not a share of its supply"
    elif drives.axes.drives["lines"][k] & FAULT and not why and (pulled_by := _line_low(drives, k)):
        return f"the drive of {name} was stopped by its fault line, pulled low {pulled_by}"
    elif drives.axes.drives["lines"][k] & FAULT:
        text = f"the drive of {name} has shut off its motor, {off_um:.1f} um from its path{': ' + why if why else ''}"
    else:
        why = why or ("its drive is held in reset" if row["in_reset"] else "")
        text = (
            f"{name} is {off_um:.1f} um from its path, more than the {row['stray_um']:g} um of the wire's radius"
            f"{': ' + why if why else ''}"
        )
    return text + _of_supply(drives, k)


def _own_words(drives: Drives, k: int) -> str:
    explain = getattr(drives.by_axis[AXIS_NAMES[k]], "why_stopped", None)
    return str(explain()) if explain is not None else ""


def _line_low(drives: Drives, k: int) -> str:
    """Return who pulls the fault line of an axis low; nothing if nobody does."""
    rows, lines = drives.axes.rows, drives.axes.drives["lines"]
    others = [
        name for j, name in enumerate(AXIS_NAMES)
        if j != k and drives.has_loop(j) and rows["wiring"][j] & NET_OUT and lines[j] & FAULT_OUT
    ]
    if others and rows["wiring"][k] & NET_IN:
        return f"by {' and '.join(others)}"
    return "from outside" if rows["hand_lines"][k] & FAULT_IN else ""


def _of_supply(drives: Drives, k: int) -> str:
    """Return what is wrong with the supply of an axis' motor, if something is."""
    name = AXIS_NAMES[k]
    row, motor, own = drives.axes.rows[k], drives.axes.motors[k], drives.by_axis[name].motor
    assert own is not None
    if motor["supply_V"] < own["supply_V"][0]:
        return f"; its supply gives {motor['supply_V']:g} V in place of {own['supply_V'][0]:g} V"
    # behind its inner resistance a supply is lower than this only where its current is at its limit
    if row["link_V"] < motor["supply_V"] - motor["supply_A"] * motor["supply_ohm"]:
        return f"; its supply is at its limit of {motor['supply_A']:g} A and gives {row['link_V']:.1f} V"
    return ""


def reason_of_delay(drives: Drives, away_um: NDArray[np.float64], near_um: float, late_s: float) -> str:
    """Return which axes are not near their places, of which there is one, and how long (s) they would take."""
    far = [k for k, name in enumerate(AXIS_NAMES) if away_um[k] > near_um]
    texts = []
    for k in far:
        why = _own_words(drives, k)
        texts.append(f"{AXIS_NAMES[k]} is {away_um[k]:.1f} um from its place{f' ({why})' if why else ''}")
    rest = "not coming nearer" if math.isinf(late_s) else f"{late_s:.0f} s more until within {near_um:g} um"
    return f"{' and '.join(texts)}, {rest}" + "".join(_of_supply(drives, k) for k in far)
