"""Indices of a QEM EANPOS's parameters, states and other values in ``reg`` and ``real`` of its record.

Parameters and states have the order of the manual's tables (1.7.3, 1.7.4), commands that of their priority.
"""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from edmsim.controllers.axis.drive import data_of

Words: TypeAlias = NDArray[np.int64]
Reals: TypeAlias = NDArray[np.float64]

DATA: dict[str, Any] = data_of("eanpos")
DEVICE: dict[str, Any] = DATA["device"]

PARAMETERS: tuple[str, ...] = tuple(entry["name"] for entry in DATA["parameter"])
"""The 45 parameters by the manual's names; number k is in register k."""
(
    MEASURE, PULSE, MAXPOS, MINPOS, PRSPOS, MAXVEL, PRSVEL, SPRSVEL, TOLL, MAXFOLLERR, RAMPMODE, RAMPTYPE, TACCDEC,
    TACC, TDEC, RTYPE, STOPT, TINVT, TOLDLY, PGAIN, FEEDFW, INTEGT, DERIVT, PRSMODE, PRMDIR, UNITVEL, DECPT, OFFSET,
    SETPOS, SETVEL, VOUT, VEL, FRQ, POSIT, ENCODER, FOLLERR, FFWDREG, PROPREG, INTEG, DERREG, DELTA, ERRCODE,
    ERRVALUE, WRNCODE, WRNVALUE,
) = range(45)  # fmt: skip
STATES = (
    "st_init", "st_emrg", "st_toll", "st_prsok", "st_still", "st_prson", "st_movdir", "st_loopon", "st_foller",
    "st_regoff", "st_cal", "st_cntlock", "st_cntrev", "st_acc", "st_dec", "st_vconst", "st_error", "st_warning",
    "st_int",
)  # fmt: skip
"""The 19 states; number k is in register `FIRST_STATE` + k."""
FIRST_STATE = 45
(
    ST_INIT, ST_EMRG, ST_TOLL, ST_PRSOK, ST_STILL, ST_PRSON, ST_MOVDIR, ST_LOOPON, ST_FOLLER, ST_REGOFF, ST_CAL,
    ST_CNTLOCK, ST_CNTREV, ST_ACC, ST_DEC, ST_VCONST, ST_ERROR, ST_WARNING, ST_INT,
) = range(45, 64)  # fmt: skip
COMMANDS = (
    "INIT", "EMRG", "RESUME", "START", "STOP", "LOOPON", "LOOPOFF", "CNTLOCK", "CNTUNLOCK", "CNTREV", "CNTDIR",
    "PRESET", "CALON", "CALOFF", "MANFW", "MANBW", "REGOFF", "REGON", "DELCNT", "RSERR", "RSWRN", "RSPRSOK",
)  # fmt: skip
"""The 22 commands, highest priority first; number k is bit k of the mailbox."""
(
    INIT, EMRG, RESUME, START, STOP, LOOPON, LOOPOFF, CNTLOCK, CNTUNLOCK, CNTREV, CNTDIR, PRESET, CALON, CALOFF,
    MANFW, MANBW, REGOFF, REGON, DELCNT, RSERR, RSWRN, RSPRSOK,
) = range(22)  # fmt: skip

MAILBOX, WRITTEN = 77, 78  # commands and writes for the next sample, one bit each
NEW_SETPOS, NEW_SETVEL, NEW_POSIT, NEW_RAMPS, NEW_RESOLUTION = 1, 2, 4, 8, 16  # bits of `WRITTEN`
SETTINGS: tuple[str, ...] = tuple(DATA["settings"])
FIRST_SETTING = 66
(
    GRADIENT, IDEAL_PID, DELAYS_FOLLOWING, ALREADY_SO, JERK_LIMIT, HOME_LIMIT, SINGLE_HOMING, FOLLOW_STEP,
    STARTS_IN_LOOP,
) = range(66, 75)  # fmt: skip
TCAMP_NS, RESOURCES = 75, 76
"""Sample time, and the declared resources of the device: bits `HAS_COUNTER` to `HAS_OUTPUT`."""
HAS_COUNTER, HAS_INDEX, HAS_HOME, HAS_OUTPUT = 1, 2, 4, 8
(
    FRESH, LAST_COUNT, NUMERATOR, NOW_NS, MOVE, DIRECTION, START_NS, STOPPED_NS, TARGET, HAS_TARGET, SINCE_NS,
    CODE, HOME_PHASE, HOME_DIR, CAM, MARKS, EXCESS_NS, EXCEEDED, GATE_NS, GATE_EDGES, UP_LAW, DOWN_LAW, EDGES,
    LAST_ERROR, OLD_SETPOS, OLD_SETVEL, MODE2_ARMED, FOLLOWED,
) = range(80, 108)  # fmt: skip
"""Whether the first sample is to come; counter at the last sample; position in 1 / pulse of a unit of measure; time;
motion (`RESTING` to `ENDING`), its direction and begin, and the end of the last one; target of START, if any, and
since when the axis is in tolerance; code in the DAC; homing (see `sample`); when the following error was last over
its limit, or since when; speed gate; laws of the present ramps; step edges followed; values in execution, to which a
refused write returns; whether mode 2 may load (1), or has loaded (2); position by the step edges."""
RESTING, PLACING, JOGGING, SEARCHING, ENDING = range(5)
"""`MOVE`: none; to a target; a jog to a limit; a homing search without a target; stopping."""
(
    THEORY, SPEED, FROM, FIRST_SPEED, TOP_SPEED, FIRST_S, EVEN_S, LAST_S, GOAL, UP_SLOPE, DOWN_SLOPE, INTEGRAL,
    SEARCHED_FROM, LIMIT,
) = range(14)  # fmt: skip
"""In ``real``: theoretical position and speed (units of measure, per s); the profile: its start, speed at its begin
and between its ramps, times of ramp, constant speed and ramp to rest, and its end; s per unit of speed of both ramps;
integral of the loop; start of a homing search's phase; end of a jog."""

CAM_NOT_FOUND, MARK_NOT_FOUND, OUTPUT_TAKEN, BAD_RESOLUTION, RESOURCE_MISSING = range(1, 6)
"""Error codes (ours, the manual's table is missing)."""
NOT_EXECUTED, NOT_WRITTEN, OUT_OF_LIMITS = 1, 2, 3  # warning codes; the manual has only the first
