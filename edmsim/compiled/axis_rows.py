"""What an axis, its motor and its drive are made of: the rows that the plant and a drive's sample both work on.

A machine has four axes: x and y move the lower guide, u and v the upper guide relative to the lower one. A drive with
a loop is called at its own sampling instants, ``epoch_ns + index * num // den``, with the addresses of two rows: its
own (`DRIVE`) and its axis' (`AXIS`). It reads setpoint, encoder and switches and writes its command::

    @sample
    def hold(drive_at, axis_at):
        drive, axis = carray(drive_at, 1)[0], carray(axis_at, 1)[0]
        drive.command = min(max((drive.setpoint - axis.count) / 1024.0, -1.0), 1.0)
"""

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
from numba import carray, cfunc, from_dtype, types

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
SHARED_IN = 8  # bit of ``AXIS.lines``: another drive is writing to the output that this one shares with it
LOW_END, HIGH_END = 1, 2  # bits of ``AXIS.ends``: the end switches that are open
FAULT, FREEWHEEL, FAULT_OUT, LED, ERROR_LED, HOLDS_OUTPUT = 1, 2, 4, 8, 16, 32
"""Bits of ``DRIVE.lines``: the drive reports a fault to the machine; its enable output is low, so that the bridge is
off and the motor freewheels; its fault output is pulled low; its status LED, and its error LED, is lit; it leaves an
output that it shares with others (``AXIS.shares``) as it is."""
NET_IN, NET_OUT = 1, 2
"""Bits of ``AXIS.wiring``: the drive's fault input hangs on the machine's fault net; its fault output pulls that net
low through a diode. An input without the net is held high."""
SAMPLE, WATCHDOG = 0, 1  # ``DRIVE.event``: why the sample is called; the latter if none has run for ``watchdog_ns``
FOLLOWING_ERROR, NO_COMMAND = 1, 2
"""Bits of ``AXIS.trip``: the table is too far from where the planner has it, or nowhere; the drive's command was no
share of its supply, for which its board holds it in reset."""
BRIDGE_DAMAGED, MAGNETS_DAMAGED, WINDING_DAMAGED = 1, 2, 4
"""Bits of ``AXIS.damage``: a current over ``bridge_A``, one over ``peak_A``, a winding warmer than ``rated_K``."""
PHASE_A, PHASE_B = 1, 2  # bits of ``AXIS.unplugged`` and of the encoder's state
INDEX_WIRE = 4  # bit of ``AXIS.unplugged``: the wire of the index mark
REFERENCE_V = 10.0
"""Largest reference voltage of a velocity amplifier, of either sign: what a ``command`` of 1 is for it."""
SENT = 256  # bytes of ``DRIVE.sent`` before the first is written over

DRIVE = np.dtype(
    [
        # the plant writes
        ("sample", "i8"),  # address of the compiled function, 0 for a drive without a loop
        ("epoch_ns", "i8"),  # start of the grid of samples
        ("index", "i8"),  # number of the next sample
        ("num", "i8"),  # the period is num / den ns
        ("den", "i8"),
        ("due_ns", "i8"),  # when the next sample is due
        ("now_ns", "i8"),  # time of this call
        ("event", "i8"),  # why the sample is called: `SAMPLE` or `WATCHDOG`
        ("setpoint", "i8"),  # step edges up less those down
        ("alarm_ns", "i8"),  # when the watchdog is due
        ("output_ns", "i8"),  # when the last sample's lines take effect
        ("duty_ns", "i8"),  # when its command does
        # the drive writes
        ("command", "f8"),  # -1 to 1 of the motor's supply voltage or, before a velocity amplifier, `REFERENCE_V`
        ("lines", "i8"),  # output lines: `FAULT`, `FREEWHEEL` and so on
        ("busy_ns", "i8"),  # a sample longer than the period leaves the grid: the next one follows at once
        ("delay_ns", "i8"),  # time to compute: lines and command take effect so much later
        ("pwm_ns", "i8"),  # the command takes effect at the next period of this, if not 0
        ("watchdog_ns", "i8"),  # longest time without a sample, 0 for none
        ("stalled_until_ns", "i8"),  # no sample is taken before
        ("count_rate_Hz", "f8"),  # fastest encoder edges its input takes, 0 for the encoder's own limit
        ("index_ns", "i8"),  # an index mark shorter than this is not seen
        ("n_sent", "i8"),  # bytes sent so far
        ("sent", "i8", SENT),  # last bytes for the serial line with their times, see `put_byte`
        # its own: parameters, ramps, what it records, what outlasts the power
        ("reg", "i8", 256),
        ("real", "f8", 32),
        ("memory", "i8", 512),
        ("eeprom", "u1", 128),
    ]
)
"""A drive. All of it is part of the plant's snapshot."""

AXIS = np.dtype(
    [
        # read for the drive at its sample
        ("time_ns", "i8"),  # of the sample
        ("count", "i8"),  # of the encoder, four to a line, since the place where the drive was switched on
        ("illegal", "i8"),  # how often both phases changed at once, which moves no count
        ("edges", "i8"),  # all that were counted
        ("index_at", "i8"),  # count at the last index mark passed
        ("indexes", "i8"),  # index marks passed
        ("ends", "i8"),  # end switches that are open: `LOW_END`, `HIGH_END`
        ("home", "i8"),  # the home cam's switch behind its input filter
        ("index_on", "i8"),  # whether an index mark is there now
        ("lines", "i8"),  # input lines: `STOP_IN`, `FAULT_IN`, `ENABLE_IN`, `SHARED_IN`
        # wires, which no drive sees, as all that follows
        ("hand_lines", "i8"),  # input lines held active from outside
        ("wiring", "i8"),  # how the drive hangs on the fault net: `NET_IN`, `NET_OUT`
        ("in_reset", "i8"),  # whether the drive's logic is held in reset
        # marks and cam
        ("mark", "i8"),  # the last index mark below
        ("cam", "i8"),  # the home switch itself
        ("cam_ns", "i8"),  # when it last changed
        ("shares", "i8"),  # axes of equal numbers other than 0 hang on one output, which their drives write in turn
        ("apart", "i8"),  # contactor open: the motor freewheels
        # encoder
        ("missed", "i8"),  # what `count` is behind `true_count`
        ("moved_ns", "i8"),  # the motor is moved up to this time
        ("true_count", "i8"),  # by the place
        ("state", "i8"),  # phases as they are
        ("latched_state", "i8"),  # phases last counted
        ("ready_ns", "f8"),  # when the input takes the next edge
        ("unplugged", "i8"),  # wires `PHASE_A`, `PHASE_B`, `INDEX_WIRE`, whose phases read 1
        ("swapped", "i8"),  # whether the phases are swapped
        ("disturbed", "i8"),  # phases that a spike turns over
        ("spike_ns", "f8"),  # until when; without a spike, when the next begins
        ("noise_key", "u8"),  # of the spikes' draws
        ("noise_draws", "i8"),
        # motor
        ("locked", "i8"),  # whether the rotor is held
        ("damage", "i8"),  # `BRIDGE_DAMAGED`, `MAGNETS_DAMAGED`, `WINDING_DAMAGED`
        ("pins", "i8"),  # outputs in effect
        ("duty", "f8"),  # command in effect
        ("zero_um", "f8"),  # place where the drive was switched on
        ("low_um", "f8"),  # the end switches open below this
        ("high_um", "f8"),  # and above this
        ("place_um", "f8"),  # of the table
        ("speed_um_s", "f8"),  # of the table
        ("rotor_um", "f8"),  # travel that the rotor's angle stands for
        ("speed_rad_s", "f8"),  # of the rotor
        ("current_A", "f8"),
        ("integral_A", "f8"),  # integral part of the current that a velocity amplifier asks for
        ("link_V", "f8"),  # the supply's voltage at the bridge
        ("peak_A", "f8"),  # largest current so far
        ("winding_K", "f8"),  # the winding's temperature over the surroundings
        ("hand_Nm", "f8"),  # torque on the shaft from outside
        ("hand_N", "f8"),  # force on the table from outside
        # what the machine watches
        ("least_um", "f8"),  # the table is to be between this
        ("most_um", "f8"),  # and this
        ("stray_um", "f8"),  # and not further than so much outside
        ("trip", "i8"),  # for what the machine stops the axis: `FOLLOWING_ERROR`, `NO_COMMAND`
        ("trip_ns", "i8"),  # since when
    ]
)
"""An axis under a drive with a loop."""

MOTOR = np.dtype(
    [
        # supply and bridge
        ("supply_V", "f8"),
        ("supply_ohm", "f8"),
        ("supply_A", "f8"),  # greatest current of the supply
        ("link_F", "f8"),  # capacitor at the bridge
        ("bridge_A", "f8"),  # what the bridge's transistors survive
        ("diode_V", "f8"),  # drop of a diode
        # winding
        ("resistance_ohm", "f8"),
        ("inductance_H", "f8"),
        ("torque_Nm_A", "f8"),  # also the back-EMF in V s per rad
        ("peak_A", "f8"),  # demagnetises the motor
        ("rated_K", "f8"),  # temperature that the winding may have over its surroundings
        ("winding_J_K", "f8"),  # heat capacity
        ("winding_K_W", "f8"),  # thermal resistance
        # rotor
        ("inertia_kg_m2", "f8"),  # with what turns with it
        ("damping_Nm_s", "f8"),
        ("friction_Nm", "f8"),  # while it turns
        ("stiction_Nm", "f8"),  # before it does
        # screw and table; on x and y of a machine, the machine's own
        ("um_per_rad", "f8"),  # travel
        ("screw_N_m", "f8"),  # spring between nut and table
        ("screw_N_s_m", "f8"),  # damper
        ("backlash_um", "f8"),
        ("table_kg", "f8"),
        ("way_N_s_m", "f8"),  # oil film of the ways
        ("way_friction_N", "f8"),
        ("way_stiction_N", "f8"),
        ("load_N", "f8"),  # pulls steadily, as gravity does on a vertical axis
        # encoder
        ("counts_per_rad", "f8"),  # of the rotor: 4 times its lines over 2 pi
        ("on_table", "f8"),  # 1 where counts are of the table's travel
        ("phase_error", "f8"),  # by how much of a count every other edge is off
        ("index_um", "f8"),  # from one index mark to the next
        ("edge_rate_Hz", "f8"),  # fastest edges it makes
        ("spike_rate_Hz", "f8"),  # how often on average a spike disturbs its wires, at random
        ("spike_s", "f8"),  # how long one lasts on average
        ("index_phase_um", "f8"),  # an index mark begins so far after a multiple of the way between two
        ("index_width_um", "f8"),
        # velocity amplifier, for which the motor has none where the first is 0
        ("amplifier_rad_s_V", "f8"),  # the rotor's speed per volt of its reference
        ("amplifier_A_s", "f8"),  # current per error of speed, A per rad/s
        ("amplifier_A", "f8"),  # current per integral of that error, A per rad
        ("limit_A", "f8"),  # greatest current
        ("gain_error", "f8"),  # share
        ("asymmetry", "f8"),  # share: faster forward and slower backward by half of it each
        ("offset_V", "f8"),  # at its input
        ("drift_V", "f8"),  # of the offset after switching on
        ("warm_s", "f8"),  # time constant of the drift, 0 for none
        # home cam, none where low and high are equal
        ("cam_low_um", "f8"),  # the switch closes between this place of the table
        ("cam_high_um", "f8"),  # and this
        ("cam_hysteresis_um", "f8"),  # and opens so far outside
        ("cam_bounce_ns", "f8"),  # its contact bounces for so long
        ("cam_filter_ns", "f8"),  # the input takes a level that has stood for so long
    ]
)
"""Constants of a direct-current motor with its supply, what it moves, and its encoder."""


class SampleFunction:
    """A drive's sample, compiled when its address is asked for: who names drives need not wait for machine code."""

    def __init__(self, function: Callable[[Any, Any], None]) -> None:
        self._function = function

    @cached_property
    def address(self) -> int:
        """Where the machine code is."""
        signature = types.void(types.CPointer(from_dtype(DRIVE)), types.CPointer(from_dtype(AXIS)))
        # kept beside the address: numba frees the machine code with it
        self._made = in_cache(cfunc(signature, cache=True, error_model="numpy"), self._function)
        return int(self._made.address)


def is_row(record: object, kind: np.dtype[np.void]) -> bool:
    """Return whether this is one row of `DRIVE`, `MOTOR` or `AXIS`."""
    return isinstance(record, np.ndarray) and record.dtype == kind and record.shape == (1,)


def sample(function: Callable[[Any, Any], None]) -> SampleFunction:
    """Make a drive's sample; it is compiled when a plant first uses it, and the pulse loop is not compiled for it.

    Machine code is kept between runs.

    Parameters
    ----------
    function : callable
        Takes pointers to the drive's and the axis' row, ``carray(pointer, 1)[0]`` is the row. It may call what
        `edmsim.compiled.jit.compiled` made, and allocates nothing.
    """
    return SampleFunction(function)


@compiled
def put_byte(drive: Any, byte: int) -> None:
    """Let a sample send a byte: it stands with its time in ``sent``, as ``time_ns * 256 + byte``."""
    drive.sent[drive.n_sent % SENT] = drive.now_ns * 256 + byte
    drive.n_sent += 1
