"""Records of an axis, its motor and its drive, which the plant and a drive's sample function share.

A machine has four axes: x and y move the lower guide, u and v the upper guide relative to the lower one. The plant
calls the sample function of a servo drive at its sampling instants, ``epoch_ns + index * num // den``, with the
addresses of two records: that of the drive (`DRIVE`) and that of the axis (`AXIS`). The function reads setpoint,
encoder and switches, and writes the command::

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
"""Channels of the events of `Plant.advance`, after those of the axes' steps: input lines of the drives. The value is
1 if the line is active; the fault line is active low. Line `c` is bit ``c - N_AXES`` of ``AXIS.lines``."""
N_CHANNELS = N_AXES + 3
STOP_IN, FAULT_IN, ENABLE_IN = (1 << (line - N_AXES) for line in (STOP_LINE, FAULT_LINE, ENABLE_LINE))
"""Bits of ``AXIS.lines``."""
SHARED_IN = 8  # bit of ``AXIS.lines``: another drive is using the shared output
LOW_END, HIGH_END = 1, 2  # bits of ``AXIS.ends``: open end switches
FAULT, FREEWHEEL, FAULT_OUT, LED, ERROR_LED, HOLDS_OUTPUT = 1, 2, 4, 8, 16, 32
"""Bits of ``DRIVE.lines``: the drive reports a fault to the machine; its enable output is low, so the bridge is off
and the motor freewheels; its fault output is pulled low; its status LED is on; its error LED is on; it does not
write to an output that it shares with others (``AXIS.shares``)."""
NET_IN, NET_OUT = 1, 2
"""Bits of ``AXIS.wiring``: the drive's fault input is connected to the machine's fault net; its fault output pulls
this net low through a diode. An unconnected input is pulled high."""
SAMPLE, WATCHDOG = 0, 1  # ``DRIVE.event``: why it is called; WATCHDOG: no sample for ``watchdog_ns``
FOLLOWING_ERROR, NO_COMMAND = 1, 2
"""Bits of ``AXIS.trip``: the table is too far from the planner's position, or its position is not finite; the drive's
command or period was invalid, and its board holds it in reset."""
BRIDGE_DAMAGED, MAGNETS_DAMAGED, WINDING_DAMAGED = 1, 2, 4
"""Bits of ``AXIS.damage``: current above ``bridge_A``, current above ``peak_A``, winding hotter than ``rated_K``."""
PHASE_A, PHASE_B = 1, 2  # bits of ``AXIS.unplugged`` and of the encoder's state
INDEX_WIRE = 4  # bit of ``AXIS.unplugged``: the wire of the index mark
REFERENCE_V = 10.0
"""Greatest magnitude of a velocity amplifier's reference voltage: that of a ``command`` of 1."""
SENT = 256  # length of the ring buffer ``DRIVE.sent``

DRIVE = np.dtype(
    [
        # the plant writes
        ("sample", "i8"),  # address of the compiled function, 0 for a drive without a loop
        ("epoch_ns", "i8"),  # time of sample 0
        ("index", "i8"),  # number of the next sample
        ("num", "i8"),  # the period is num / den ns
        ("den", "i8"),
        ("due_ns", "i8"),  # time of the next sample
        ("now_ns", "i8"),  # time of this call
        ("event", "i8"),  # why the sample is called: `SAMPLE` or `WATCHDOG`
        ("setpoint", "i8"),  # steps up minus steps down
        ("alarm_ns", "i8"),  # time at which the watchdog expires
        ("output_ns", "i8"),  # time at which the last sample's lines take effect
        ("duty_ns", "i8"),  # time at which its command takes effect
        # the drive writes
        ("command", "f8"),  # -1 to 1 of the motor's supply voltage or, before a velocity amplifier, `REFERENCE_V`
        ("lines", "i8"),  # output lines: `FAULT`, `FREEWHEEL` and so on
        ("busy_ns", "i8"),  # computing time; if longer than the period, the next sample follows at once
        ("delay_ns", "i8"),  # delay after which lines and command take effect
        ("pwm_ns", "i8"),  # PWM period at whose start the command takes effect; 0 for at once
        ("watchdog_ns", "i8"),  # longest time without a sample; 0 for no watchdog
        ("stalled_until_ns", "i8"),  # no sample before this time
        ("count_rate_Hz", "f8"),  # highest edge rate of its encoder input; 0 for the encoder's own limit
        ("index_ns", "i8"),  # shorter index pulses are not detected
        ("n_sent", "i8"),  # number of bytes sent
        ("sent", "i8", SENT),  # last bytes sent to the serial line, with their times: see `put_byte`
        # the drive's own state: parameters, ramps, recordings, non-volatile memory
        ("reg", "i8", 256),
        ("real", "f8", 32),
        ("memory", "i8", 512),
        ("eeprom", "u1", 128),
    ]
)
"""A drive. The whole record is part of the plant's snapshot."""

AXIS = np.dtype(
    [
        # inputs of the drive, updated before each sample
        ("time_ns", "i8"),  # time of the sample
        ("count", "i8"),  # encoder count, four per line, relative to the position at switch-on
        ("illegal", "i8"),  # number of times both phases changed at once, which is not counted
        ("edges", "i8"),  # number of counted edges
        ("index_at", "i8"),  # count at the last index mark
        ("indexes", "i8"),  # number of index marks passed
        ("ends", "i8"),  # open end switches: `LOW_END`, `HIGH_END`
        ("home", "i8"),  # home switch after its input filter
        ("index_on", "i8"),  # whether the encoder is on an index mark
        ("lines", "i8"),  # input lines: `STOP_IN`, `FAULT_IN`, `ENABLE_IN`, `SHARED_IN`
        # wiring; from here on nothing is visible to the drive
        ("hand_lines", "i8"),  # input lines activated from outside
        ("wiring", "i8"),  # connections to the fault net: `NET_IN`, `NET_OUT`
        ("in_reset", "i8"),  # whether the drive's processor is held in reset
        # index marks and home cam
        ("mark", "i8"),  # number of the next index mark below
        ("cam", "i8"),  # home switch before the filter
        ("cam_ns", "i8"),  # time of its last change
        ("shares", "i8"),  # axes with the same number, other than 0, share an output
        ("apart", "i8"),  # whether the contactor is open, so the motor freewheels
        # encoder
        ("missed", "i8"),  # counts lost: `true_count` minus `count`
        ("moved_ns", "i8"),  # time up to which the motor has been simulated
        ("true_count", "i8"),  # count that follows from the position
        ("state", "i8"),  # present state of the phases
        ("latched_state", "i8"),  # state of the phases at the last counted edge
        ("ready_ns", "f8"),  # time from which the input accepts the next edge
        ("unplugged", "i8"),  # broken wires `PHASE_A`, `PHASE_B`, `INDEX_WIRE`; their signals read 1
        ("swapped", "i8"),  # whether the phases are swapped
        ("disturbed", "i8"),  # phases inverted by a noise spike
        ("spike_ns", "f8"),  # end of the spike; without a spike, beginning of the next one
        ("noise_key", "u8"),  # key of the random draws of spikes
        ("noise_draws", "i8"),
        # motor
        ("locked", "i8"),  # whether the rotor is blocked
        ("damage", "i8"),  # `BRIDGE_DAMAGED`, `MAGNETS_DAMAGED`, `WINDING_DAMAGED`
        ("pins", "i8"),  # output lines in effect
        ("duty", "f8"),  # command in effect
        ("zero_um", "f8"),  # position at switch-on
        ("low_um", "f8"),  # the low end switch opens below this position
        ("high_um", "f8"),  # the high end switch opens above this position
        ("place_um", "f8"),  # position of the table
        ("speed_um_s", "f8"),  # speed of the table
        ("rotor_um", "f8"),  # rotor angle as travel of the table
        ("speed_rad_s", "f8"),  # speed of the rotor
        ("current_A", "f8"),
        ("integral_A", "f8"),  # integral part of a velocity amplifier's current
        ("link_V", "f8"),  # supply voltage at the bridge
        ("peak_A", "f8"),  # greatest current so far
        ("winding_K", "f8"),  # winding temperature above ambient
        ("hand_Nm", "f8"),  # external torque on the shaft
        ("hand_N", "f8"),  # external force on the table
        # the machine's supervision
        ("least_um", "f8"),  # lower end of the planned range
        ("most_um", "f8"),  # upper end of the planned range
        ("stray_um", "f8"),  # allowed distance outside this range
        ("trip", "i8"),  # why the machine stops the axis: `FOLLOWING_ERROR`, `NO_COMMAND`
        ("trip_ns", "i8"),  # time of the trip
    ]
)
"""An axis under a servo drive."""

MOTOR = np.dtype(
    [
        # supply and bridge
        ("supply_V", "f8"),
        ("supply_ohm", "f8"),
        ("supply_A", "f8"),  # current limit of the supply
        ("link_F", "f8"),  # capacitor at the bridge
        ("bridge_A", "f8"),  # current that destroys the bridge
        ("diode_V", "f8"),  # forward voltage of a diode
        # winding
        ("resistance_ohm", "f8"),
        ("inductance_H", "f8"),
        ("torque_Nm_A", "f8"),  # torque constant; also that of the back-EMF in V s per rad
        ("peak_A", "f8"),  # current that demagnetises the motor
        ("rated_K", "f8"),  # rated winding temperature above ambient
        ("winding_J_K", "f8"),  # heat capacity
        ("winding_K_W", "f8"),  # thermal resistance
        # rotor
        ("inertia_kg_m2", "f8"),  # rotor with all that turns with it
        ("damping_Nm_s", "f8"),
        ("friction_Nm", "f8"),  # friction of the turning rotor
        ("stiction_Nm", "f8"),  # breakaway torque
        # screw and table; on x and y those of the machine
        ("um_per_rad", "f8"),  # travel
        ("screw_N_m", "f8"),  # stiffness between nut and table
        ("screw_N_s_m", "f8"),  # damping between nut and table
        ("backlash_um", "f8"),
        ("table_kg", "f8"),
        ("way_N_s_m", "f8"),  # viscous friction of the ways
        ("way_friction_N", "f8"),
        ("way_stiction_N", "f8"),
        ("load_N", "f8"),  # constant force, such as gravity on a vertical axis
        # encoder
        ("counts_per_rad", "f8"),  # per rad of the rotor: 4 times the encoder's lines over 2 pi
        ("on_table", "f8"),  # 1 for an encoder (scale) on the table
        ("phase_error", "f8"),  # displacement of every other edge, in counts
        ("index_um", "f8"),  # distance between index marks
        ("edge_rate_Hz", "f8"),  # highest edge rate of the encoder
        ("spike_rate_Hz", "f8"),  # mean rate of random noise spikes on the wires
        ("spike_s", "f8"),  # mean duration of a spike
        ("index_phase_um", "f8"),  # distance of an index mark from a multiple of `index_um`
        ("index_width_um", "f8"),
        # velocity amplifier; 0 in the first field means no amplifier
        ("amplifier_rad_s_V", "f8"),  # rotor speed per volt of the reference
        ("amplifier_A_s", "f8"),  # proportional gain: A per rad/s of speed error
        ("amplifier_A", "f8"),  # integral gain: A per rad
        ("limit_A", "f8"),  # current limit
        ("gain_error", "f8"),  # relative error of the gain
        ("asymmetry", "f8"),  # relative: half of it faster forward, half of it slower backward
        ("offset_V", "f8"),  # input offset
        ("drift_V", "f8"),  # change of the offset after switch-on
        ("warm_s", "f8"),  # time constant of the drift; 0 for no drift
        # home cam; low equal to high means no cam
        ("cam_low_um", "f8"),  # the switch closes between this position of the table
        ("cam_high_um", "f8"),  # and this one
        ("cam_hysteresis_um", "f8"),  # and opens at this distance outside
        ("cam_bounce_ns", "f8"),  # duration of contact bounce
        ("cam_filter_ns", "f8"),  # the input accepts a level after this time
    ]
)
"""Constants of a DC motor with its supply, load and encoder."""


class SampleFunction:
    """A drive's sample function. It is compiled when its address is read, so listing drives needs no compiler."""

    def __init__(self, function: Callable[[Any, Any], None]) -> None:
        self._function = function

    @cached_property
    def address(self) -> int:
        """Address of the machine code."""
        signature = types.void(types.CPointer(from_dtype(DRIVE)), types.CPointer(from_dtype(AXIS)))
        # a reference is held, because numba frees the machine code with this object
        self._made = in_cache(cfunc(signature, cache=True, error_model="numpy"), self._function)
        return int(self._made.address)


def is_row(record: object, kind: np.dtype[np.void]) -> bool:
    """Return whether an object is one record of `DRIVE`, `MOTOR` or `AXIS`."""
    return isinstance(record, np.ndarray) and record.dtype == kind and record.shape == (1,)


def sample(function: Callable[[Any, Any], None]) -> SampleFunction:
    """Make a drive's sample function.

    It is compiled when a plant first uses it, without compiling the pulse loop again. The machine code is cached.

    Parameters
    ----------
    function : callable
        Takes pointers to the records of drive and axis; ``carray(pointer, 1)[0]`` is the record. It may call
        functions made by `edmsim.compiled.jit.compiled`, and must not allocate memory.
    """
    return SampleFunction(function)


@compiled
def put_byte(drive: Any, byte: int) -> None:
    """Send a byte from a sample function: ``sent`` stores it with its time, as ``time_ns * 256 + byte``."""
    drive.sent[drive.n_sent % SENT] = drive.now_ns * 256 + byte
    drive.n_sent += 1
