"""Geometric errors of screws and ways: periodic, cumulative, squareness and straightness.

An error is the indicated minus the true position of an axis, as in a compensation table. It is 0 in the middle of the
table. The error of x has a cumulative and a periodic part of its screw, and the bend of the way of y. That of y has
the parts of its screw, the bend of the way of x, and the squareness error. Bends and squareness may change with the
third axis, u, whose slide is on the same column.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmsim.compiled.jit import compiled, compiled_apart
from edmsim.machine.machine import Machine

AXIS_ERRORS = np.dtype(
    [
        ("middle_um", "f8"),  # middle of the travel
        ("pitch", "f8"),  # cumulative error per um of travel
        ("wave_um", "f8"),  # periodic error: this amplitude times the sine of
        ("wave_per_um", "f8"),  # this factor times the travel from the middle
        ("skew", "f8"),  # per um of the other axis
        ("skew_per_um", "f8"),  # its change per um of u
        ("bend_per_um", "f8"),  # per square of the other axis
        ("bend_per_um2", "f8"),  # its change per um of u
        ("backlash_um", "f8"),  # backlash of a stepper at a reversal
    ]
)
"""Errors of x or of y."""


def no_errors() -> NDArray[np.void]:
    """Return the rows (2,) of perfect screws and ways."""
    return np.zeros(2, AXIS_ERRORS)


def geometric_errors_of(machine: Machine, nuts: bool = True) -> NDArray[np.void]:
    """Return the rows (2,) of a machine's x and y; the backlash of `nuts` is in MuJoCo's own model already."""
    rows = no_errors()
    found, table = machine.base.geometry, machine.base.table
    if not found.has_errors:
        return rows
    half_um = 0.5e3 * table.travel_mm.value
    change_um = 1e-3 * found.value("change_per_mm")
    rows["middle_um"], rows["backlash_um"] = half_um, table.backlash_um.value if nuts else 0.0
    for k, (own, other) in enumerate((("x", "y"), ("y", "x"))):
        rows["pitch"][k] = found.value(f"{own}_pitch_um_m") * 1e-6
        rows["wave_um"][k] = found.value(f"{own}_periodic_um")
        rows["bend_per_um"][k] = found.value(f"{other}_straightness_um") / half_um**2
    rows["wave_per_um"] = 2e-3 * math.pi / found.value("lead_mm") if rows["wave_um"].any() else 0.0
    rows["skew"][1] = found.value("squareness_um_m") * 1e-6
    rows["skew_per_um"], rows["bend_per_um2"] = rows["skew"] * change_um, rows["bend_per_um"] * change_um
    return rows


@compiled
def _error_um(axis: Any, own_um: float, other_um: float, third_um: float) -> float:
    """Return the error of an axis from its position and the other's, relative to their middles, and that of u."""
    skew = axis.skew + axis.skew_per_um * third_um
    bend = axis.bend_per_um + axis.bend_per_um2 * third_um
    screw = axis.pitch * own_um + axis.wave_um * math.sin(axis.wave_per_um * own_um)
    return float(screw + skew * other_um + bend * other_um * other_um)


@compiled_apart
def errors_um(errors: NDArray[np.void], x_um: float, y_um: float, u_um: float) -> tuple[float, float]:
    """Return the errors of x and y at indicated positions."""
    x_um, y_um = x_um - errors[0].middle_um, y_um - errors[1].middle_um
    return _error_um(errors[0], x_um, y_um, u_um), _error_um(errors[1], y_um, x_um, u_um)


@compiled
def taken_up(slack_um: float, travel_um: float, backlash_um: float) -> float:
    """Return the slack in a nut after a travel of its screw: at most half the backlash on either side."""
    return min(max(slack_um + travel_um, -0.5 * backlash_um), 0.5 * backlash_um)


class StillTable:
    """A table that is moved by steppers and rests in between, without wire and gap; with the pulse loop's errors.

    >>> from edmsim.machine.machine import Machine
    >>> StillTable(Machine.load()).move((10_000.0, 20_000.0))
    (10000.0, 20000.0)
    """

    def __init__(self, machine: Machine, nuts: bool = True) -> None:
        self._errors = geometric_errors_of(machine, nuts)
        self.commanded_um = np.array(machine.base.table.centre_um)
        self._slack_um = [0.0, 0.0]

    def move(self, to_um: tuple[float, float], third_um: float = 0.0) -> tuple[float, float]:
        """Move the motors to a place with u at `third_um`; return the true position of the table at rest, in um."""
        for k in (0, 1):
            travel_um = float(to_um[k] - self.commanded_um[k])
            self._slack_um[k] = taken_up(self._slack_um[k], travel_um, float(self._errors["backlash_um"][k]))
            self.commanded_um[k] = to_um[k]
        x_um, y_um = (float(self.commanded_um[k]) - self._slack_um[k] for k in (0, 1))
        off_x, off_y = errors_um(self._errors, x_um, y_um, third_um)
        return x_um - off_x, y_um - off_y
