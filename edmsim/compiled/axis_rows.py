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
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numba import carray, cfunc, from_dtype, types  # type: ignore[attr-defined]

from edmsim.compiled.jit import compiled
from edmsim.compiled.numba_internals import in_cache

__all__ = ["AXIS", "DRIVE", "MOTOR", "N_AXES", "SampleFunction", "carray", "put_byte", "sample"]

N_AXES = 4
"""Axes of the machine: x, y, u, v."""
STOP_LINE, FAULT_LINE, ENABLE_LINE = range(N_AXES, N_AXES + 3)
"""Channels of `Plant.advance`'s events behind those of the axes' steps: input lines of the drives, whose value is 1
while they are active, which for the fault line means pulled low. Line `c` is bit ``c - N_AXES`` of ``AXIS.lines``."""
N_CHANNELS = N_AXES + 3
STOP_IN, FAULT_IN, ENABLE_IN = (1 << (line - N_AXES) for line in (STOP_LINE, FAULT_LINE, ENABLE_LINE))
"""Bits of ``AXIS.lines``."""
SHARED_IN = 8
"""Bit of ``AXIS.lines``: another drive is writing to the output that this one shares with it."""
LOW_END, HIGH_END = 1, 2
"""Bits of ``AXIS.ends``: the end switches that are open."""
FAULT, FREEWHEEL, FAULT_OUT, LED, ERROR_LED, HOLDS_OUTPUT = 1, 2, 4, 8, 16, 32
"""Bits of ``DRIVE.lines``: the drive reports a fault to the machine; its enable output is low, so that the bridge is
off and the motor freewheels; its fault output is pulled low; its status LED, and its error LED, is lit; it leaves an
output that it shares with others (``AXIS.shares``) as it is."""
NET_IN, NET_OUT = 1, 2
"""Bits of ``AXIS.wiring``: the drive's fault input hangs on the machine's fault net; its fault output pulls that net
low through a diode. An input without the net is held high."""
SAMPLE, WATCHDOG = 0, 1
"""``DRIVE.event``: why the sample is called. For `WATCHDOG` no sample has run for ``watchdog_ns``."""
FOLLOWING_ERROR, NO_COMMAND = 1, 2
"""Bits of ``AXIS.trip``: the table is too far from where the planner has it, or nowhere; the drive's command was no
share of its supply, for which its board holds it in reset."""
BRIDGE_DAMAGED, MAGNETS_DAMAGED, WINDING_DAMAGED = 1, 2, 4
"""Bits of ``AXIS.damage``: a current over ``bridge_A``, one over ``peak_A``, a winding warmer than ``rated_K``."""
PHASE_A, PHASE_B = 1, 2
"""Bits of ``AXIS.unplugged`` and of the encoder's state."""
INDEX_WIRE = 4
"""Bit of ``AXIS.unplugged``: the wire of the index mark."""
REFERENCE_V = 10.0
"""Largest reference voltage of a velocity amplifier, of either sign: what a ``command`` of 1 is for it."""
SENT = 256
"""Bytes of ``DRIVE.sent`` before the first is written over."""

DRIVE = np.dtype(
    [
        ("sample", "i8"),
        ("epoch_ns", "i8"),
        ("index", "i8"),
        ("num", "i8"),
        ("den", "i8"),
        ("due_ns", "i8"),
        ("now_ns", "i8"),
        ("event", "i8"),
        ("setpoint", "i8"),
        ("alarm_ns", "i8"),
        ("output_ns", "i8"),
        ("duty_ns", "i8"),
        ("command", "f8"),
        ("lines", "i8"),
        ("busy_ns", "i8"),
        ("delay_ns", "i8"),
        ("pwm_ns", "i8"),
        ("watchdog_ns", "i8"),
        ("stalled_until_ns", "i8"),
        ("count_rate_Hz", "f8"),
        ("index_ns", "i8"),
        ("n_sent", "i8"),
        ("sent", "i8", SENT),
        ("reg", "i8", 256),
        ("real", "f8", 32),
        ("memory", "i8", 512),
        ("eeprom", "u1", 128),
    ]
)
"""A drive. The plant writes ``sample`` (address of the compiled function, 0 for a drive without a loop), the due
time of the next sample (its number is ``index``, the period ``num / den`` ns), ``now_ns`` and ``event`` at every
call, ``setpoint``, the step edges up less those down, ``alarm_ns``, when the watchdog is due, ``output_ns`` and
``duty_ns``, when the last sample's lines and command take effect.

The drive writes ``command``, the share of the motor's supply voltage, or of `REFERENCE_V` where a velocity amplifier
stands between (-1 to 1, held until the next sample), and its output ``lines``; both take effect ``delay_ns`` later
(its time to compute), the command at the next period of ``pwm_ns`` if that is not 0. A sample that is ``busy_ns``
long leaves the grid where that is longer than the period: the next one follows at once. ``watchdog_ns`` (0 for none)
is the longest time without a sample. No sample is taken before ``stalled_until_ns``. ``count_rate_Hz`` is the fastest
encoder edges its input takes, 0 for the encoder's own limit; an index mark shorter than ``index_ns`` is not seen.
``sent`` has the last bytes for the serial line and their times (see `put_byte`), ``n_sent`` counts them. ``reg``,
``real``, ``memory`` and ``eeprom`` are its own: parameters, ramps, what it records, what outlasts the power. All of
it is part of the plant's snapshot."""

AXIS = np.dtype(
    [
        ("time_ns", "i8"),
        ("count", "i8"),
        ("illegal", "i8"),
        ("edges", "i8"),
        ("index_at", "i8"),
        ("indexes", "i8"),
        ("ends", "i8"),
        ("home", "i8"),
        ("index_on", "i8"),
        ("lines", "i8"),
        ("hand_lines", "i8"),
        ("wiring", "i8"),
        ("in_reset", "i8"),
        ("mark", "i8"),
        ("cam", "i8"),
        ("cam_ns", "i8"),
        ("shares", "i8"),
        ("apart", "i8"),
        ("missed", "i8"),
        ("moved_ns", "i8"),
        ("true_count", "i8"),
        ("state", "i8"),
        ("latched_state", "i8"),
        ("ready_ns", "f8"),
        ("unplugged", "i8"),
        ("swapped", "i8"),
        ("disturbed", "i8"),
        ("spike_ns", "f8"),
        ("noise_key", "u8"),
        ("noise_draws", "i8"),
        ("locked", "i8"),
        ("damage", "i8"),
        ("pins", "i8"),
        ("duty", "f8"),
        ("zero_um", "f8"),
        ("low_um", "f8"),
        ("high_um", "f8"),
        ("place_um", "f8"),
        ("speed_um_s", "f8"),
        ("rotor_um", "f8"),
        ("speed_rad_s", "f8"),
        ("current_A", "f8"),
        ("integral_A", "f8"),
        ("link_V", "f8"),
        ("peak_A", "f8"),
        ("winding_K", "f8"),
        ("hand_Nm", "f8"),
        ("hand_N", "f8"),
        ("least_um", "f8"),
        ("most_um", "f8"),
        ("stray_um", "f8"),
        ("trip", "i8"),
        ("trip_ns", "i8"),
    ]
)
"""An axis under a drive with a loop. Read for the drive at its sample, at ``time_ns``: the encoder's ``count``, four
to a line, since the place ``zero_um`` where the drive was switched on; ``illegal``, how often both phases changed at
once, which moves no count; ``edges``, all that were counted; ``index_at``, the count at the last index mark passed,
and how many marks were passed (``indexes``); whether one is there now (``index_on``); ``ends``, the open end
switches; ``home``, the home cam's switch behind its input filter; ``lines``, its input lines.

The rest no drive sees. Wires: ``hand_lines`` are input lines held active from outside, ``wiring`` how the drive
hangs on the fault net, ``in_reset`` whether its logic is held in reset. Encoder: ``true_count`` by the place,
``missed`` what ``count`` is behind that, ``state`` the phases as they are, ``latched_state`` those last counted,
``ready_ns`` when the input takes the next edge, ``unplugged`` phases (which read 1) and whether they are
``swapped``; ``disturbed`` phases, which a spike turns over until ``spike_ns`` (without one, the next begins then),
``noise_key`` and ``noise_draws`` number its draws; ``mark`` is the last index mark below. ``cam`` is the home switch
itself and ``cam_ns`` when it last changed. Axes of equal ``shares`` other than 0 hang on one output, which the drives
write in turn; ``apart`` is an axis whose contactor is open, so that its motor freewheels. The switches open below
``low_um`` and above ``high_um``. Motor, moved to ``moved_ns``: ``pins`` and ``duty`` are the outputs in effect,
``place_um`` and ``speed_um_s`` of the table, ``rotor_um`` the travel that the rotor's angle stands for, its speed and
current, ``integral_A`` the integral part of the current that a velocity amplifier asks for, ``link_V`` the supply's
voltage at the bridge, ``peak_A`` the largest current so far, ``winding_K`` the winding's temperature over the
surroundings, ``damage`` what was too much. ``locked`` holds the rotor; ``hand_Nm`` and ``hand_N`` are a torque on its
shaft and a force on the table from outside. What the machine itself looks after: the table is to be between
``least_um`` and ``most_um``, and not further than ``stray_um`` outside; ``trip`` says for what the machine stops the
axis (`FOLLOWING_ERROR`, `NO_COMMAND`), and ``trip_ns`` since when."""

MOTOR = np.dtype(
    [
        ("supply_V", "f8"),
        ("supply_ohm", "f8"),
        ("supply_A", "f8"),
        ("link_F", "f8"),
        ("bridge_A", "f8"),
        ("diode_V", "f8"),
        ("resistance_ohm", "f8"),
        ("inductance_H", "f8"),
        ("torque_Nm_A", "f8"),
        ("peak_A", "f8"),
        ("rated_K", "f8"),
        ("winding_J_K", "f8"),
        ("winding_K_W", "f8"),
        ("inertia_kg_m2", "f8"),
        ("damping_Nm_s", "f8"),
        ("friction_Nm", "f8"),
        ("stiction_Nm", "f8"),
        ("um_per_rad", "f8"),
        ("screw_N_m", "f8"),
        ("screw_N_s_m", "f8"),
        ("backlash_um", "f8"),
        ("table_kg", "f8"),
        ("way_N_s_m", "f8"),
        ("way_friction_N", "f8"),
        ("way_stiction_N", "f8"),
        ("load_N", "f8"),
        ("counts_per_rad", "f8"),
        ("on_table", "f8"),
        ("phase_error", "f8"),
        ("index_um", "f8"),
        ("edge_rate_Hz", "f8"),
        ("spike_rate_Hz", "f8"),
        ("spike_s", "f8"),
        ("index_phase_um", "f8"),
        ("index_width_um", "f8"),
        ("amplifier_rad_s_V", "f8"),
        ("amplifier_A_s", "f8"),
        ("amplifier_A", "f8"),
        ("limit_A", "f8"),
        ("gain_error", "f8"),
        ("asymmetry", "f8"),
        ("offset_V", "f8"),
        ("drift_V", "f8"),
        ("warm_s", "f8"),
        ("cam_low_um", "f8"),
        ("cam_high_um", "f8"),
        ("cam_hysteresis_um", "f8"),
        ("cam_bounce_ns", "f8"),
        ("cam_filter_ns", "f8"),
    ]
)
"""Constants of a direct-current motor with its supply, what it moves, and its encoder.

Supply and bridge: ``supply_V`` behind ``supply_ohm``, at most ``supply_A``, into a capacitor ``link_F`` at the
bridge; ``bridge_A`` is what its transistors survive, ``diode_V`` the drop of a diode. Winding: ``torque_Nm_A`` is
the back-EMF in V s per rad, too; ``peak_A`` demagnetises the motor; the winding of heat capacity ``winding_J_K`` and
thermal resistance ``winding_K_W`` may be ``rated_K`` over its surroundings. Rotor: ``inertia_kg_m2`` with what turns
with it, ``friction_Nm`` while it turns, ``stiction_Nm`` before it does. Screw: ``um_per_rad`` of travel, its spring
and damper between nut and table, its backlash. Table: mass, oil film, friction and stiction of the ways, and
``load_N``, which pulls steadily (gravity of a vertical axis). On x and y of a machine, screw and table are the
machine's own. Encoder: ``counts_per_rad`` of the rotor (4 times its lines over 2 pi), of the table's travel where
``on_table`` is 1; ``phase_error``, by how much of a count every other edge is off; ``index_um`` from one index mark
to the next; ``edge_rate_Hz`` the fastest edges it makes; ``spike_rate_Hz`` how often on average a spike disturbs its
wires, at random, and ``spike_s`` how long one lasts on average. An index mark begins ``index_phase_um`` after a
multiple of the way between two and is ``index_width_um`` long.

Velocity amplifier, none where ``amplifier_rad_s_V`` is 0: the rotor's speed per volt of its reference; it turns an
error of speed into a current with ``amplifier_A_s`` (A per rad/s) and ``amplifier_A`` (A per rad), ``limit_A`` at
most. It is off by ``gain_error``, a share, faster forward and slower backward by half of ``asymmetry``, a share,
each, and by ``offset_V`` at its input, which drifts by ``drift_V`` with a time constant ``warm_s`` (0 for none) after
switching on.

Home cam: the switch closes between ``cam_low_um`` and ``cam_high_um`` of the table's place and opens
``cam_hysteresis_um`` outside; no cam where both are equal. Its contact bounces for ``cam_bounce_ns``, and the input
takes a level that has stood for ``cam_filter_ns``."""


class SampleFunction(Protocol):
    """A drive's sample in machine code."""

    @property
    def address(self) -> int:
        """Where the machine code is."""
        ...


class _Sample:
    """A sample that is compiled when its address is asked for: who names drives need not wait for machine code."""

    def __init__(self, function: Callable[[Any, Any], None]) -> None:
        self._function = function

    @cached_property
    def address(self) -> int:
        pointer: Any = types.CPointer
        signature = types.void(pointer(from_dtype(DRIVE)), pointer(from_dtype(AXIS)))
        # kept beside the address: numba frees the machine code with it
        self._made = in_cache(cfunc(signature, cache=True, error_model="numpy"), self._function)
        return int(self._made.address)


def sample(function: Callable[[Any, Any], None]) -> SampleFunction:
    """Make a drive's sample; it is compiled when a plant first uses it, and the pulse loop is not compiled for it.

    Machine code is kept between runs.

    Parameters
    ----------
    function : callable
        Takes pointers to the drive's and the axis' row, ``carray(pointer, 1)[0]`` is the row. It may call what
        `edmsim.compiled.jit.compiled` made, and allocates nothing.
    """
    return _Sample(function)


@compiled
def put_byte(drive: Any, byte: int) -> None:
    """Let a sample send a byte: it stands with its time in ``sent``, as ``time_ns * 256 + byte``."""
    drive.sent[drive.n_sent % SENT] = drive.now_ns * 256 + byte
    drive.n_sent += 1
