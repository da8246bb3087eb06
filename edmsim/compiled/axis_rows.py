"""What an axis, its motor and its drive are made of: the rows that the plant and a drive's sample both work on.

A machine has four axes: x and y move the lower guide, u and v the upper guide relative to the lower one. A drive with
a loop is called at its own sampling instants, ``epoch_ns + index * num // den``, with the addresses of two rows: its
own (`DRIVE`) and its axis' (`AXIS`). It reads setpoint, encoder and switches and writes its command::

    @sample
    def hold(drive_at, axis_at):
        drive, axis = carray(drive_at, 1)[0], carray(axis_at, 1)[0]
        drive.command = min(max((drive.setpoint - axis.count) / 1024.0, -1.0), 1.0)
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numba import carray, cfunc, from_dtype, types  # type: ignore[attr-defined]

from edmsim.compiled.jit import in_cache

__all__ = ["AXIS", "DRIVE", "MOTOR", "N_AXES", "SampleFunction", "carray", "sample"]

N_AXES = 4
"""Axes of the machine: x, y, u, v."""
STOP_LINE, FAULT_LINE, ENABLE_LINE = range(N_AXES, N_AXES + 3)
"""Channels of `Plant.advance`'s events behind those of the axes' steps: input lines of the drives, whose value is
their level, 0 or 1. Line `c` is bit ``c - N_AXES`` of ``AXIS.lines``."""
N_CHANNELS = N_AXES + 3
LOW_END, HIGH_END = 1, 2
"""Bits of ``AXIS.ends``: the end switches that are open."""
FAULT = 1
"""Bit of ``DRIVE.lines``: the drive reports a fault."""

DRIVE = np.dtype(
    [
        ("sample", "i8"),
        ("epoch_ns", "i8"),
        ("index", "i8"),
        ("num", "i8"),
        ("den", "i8"),
        ("due_ns", "i8"),
        ("setpoint", "i8"),
        ("command", "f8"),
        ("lines", "i8"),
        ("reg", "i8", 48),
        ("real", "f8", 16),
    ]
)
"""A drive. The plant writes ``sample`` (address of the compiled function, 0 for a drive without a loop), the due time
of the next sample (its number is ``index``, the period ``num / den`` ns), and ``setpoint``, the step edges up less
those down. The drive writes ``command``, the share of the motor's supply voltage (-1 to 1, held until the next
sample), and its output ``lines``. ``reg`` and ``real`` are its own: parameters, ramps, what it remembers. All of
it is part of the plant's snapshot."""

AXIS = np.dtype(
    [
        ("time_ns", "i8"),
        ("count", "i8"),
        ("index_at", "i8"),
        ("indexes", "i8"),
        ("mark", "i8"),
        ("ends", "i8"),
        ("lines", "i8"),
        ("missed", "i8"),
        ("zero_um", "f8"),
        ("low_um", "f8"),
        ("high_um", "f8"),
        ("place_um", "f8"),
        ("speed_rad_s", "f8"),
        ("current_A", "f8"),
        ("voltage_V", "f8"),
    ]
)
"""An axis under a drive with a loop. Read for the drive at its sample, at ``time_ns``: the encoder's ``count``, since
the place ``zero_um`` where the drive was switched on; ``index_at``, the count at the last index mark passed, and how
many marks were passed (``indexes``); ``ends``, the open end switches; ``lines``, its input lines. The rest no
drive sees: ``missed`` counts the edges that came faster than the encoder's input takes them, which are lost; ``mark``
is the last index mark below the axis; the switches open below ``low_um`` and above ``high_um``; place, speed of the
rotor, and the motor's current and voltage now."""

MOTOR = np.dtype(
    [
        ("supply_V", "f8"),
        ("resistance_ohm", "f8"),
        ("inductance_H", "f8"),
        ("torque_Nm_A", "f8"),
        ("inertia_kg_m2", "f8"),
        ("damping_Nm_s", "f8"),
        ("um_per_rad", "f8"),
        ("counts_per_um", "f8"),
        ("index_um", "f8"),
        ("edge_rate_Hz", "f8"),
    ]
)
"""Constants of a direct-current motor with what it moves, and of its encoder. ``torque_Nm_A`` is the back-EMF in V s
per rad, too; ``inertia_kg_m2`` is that of rotor, screw and table together (MuJoCo takes the inertia of rotor and
carriage from the machine's MJCF instead); ``um_per_rad`` the travel per turn of the rotor in rad; ``index_um`` the
travel from one index mark to the next; ``edge_rate_Hz`` the fastest edges the encoder's input counts."""


class SampleFunction(Protocol):
    """A compiled sample: numba's ``cfunc``."""

    @property
    def address(self) -> int:
        """Where the machine code is."""
        ...


def sample(function: Callable[[Any, Any], None]) -> SampleFunction:
    """Compile a drive's sample; machine code is kept between runs, and the pulse loop is not compiled for it.

    Parameters
    ----------
    function : callable
        Takes pointers to the drive's and the axis' row, ``carray(pointer, 1)[0]`` is the row. It may call what
        `edmsim.compiled.jit.compiled` made, and allocates nothing.
    """
    pointer: Any = types.CPointer
    signature = types.void(pointer(from_dtype(DRIVE)), pointer(from_dtype(AXIS)))
    made: SampleFunction = in_cache(cfunc(signature, cache=True, error_model="numpy"), function)
    return made
