"""The homing search of a QEM EANPOS ("preset search", manual 1.3.9): to the cam, back off it, to the zero pulse.

In mode 0 an axis 500 units before the cam reaches it at 333 units/s, turns, and leaves it at 167 units/s; there the
count becomes prspos, the axis stops, and is placed at prspos. In mode 1 the first zero pulse after the cam loads the
count. In mode 2 nothing moves: each closing of the cam loads it.
"""

from __future__ import annotations

import math

from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.axis.eanpos_moves import can_move, catch_up, fail, shift, slopes, speed_unit, travel
from edmsim.controllers.axis.eanpos_profile import begin, brake, plan
from edmsim.controllers.axis.eanpos_registers import (
    CAM,
    CAM_NOT_FOUND,
    ENDING,
    HAS_HOME,
    HAS_INDEX,
    HAS_TARGET,
    HOME_DIR,
    HOME_LIMIT,
    HOME_PHASE,
    LAST_COUNT,
    MARK_NOT_FOUND,
    MARKS,
    MEASURE,
    MODE2_ARMED,
    MOVE,
    NUMERATOR,
    PRMDIR,
    PRSMODE,
    PRSPOS,
    PRSVEL,
    PULSE,
    RESOURCE_MISSING,
    RESOURCES,
    RESTING,
    SEARCHED_FROM,
    SEARCHING,
    SETPOS,
    SETVEL,
    SPRSVEL,
    ST_CNTLOCK,
    ST_CNTREV,
    ST_LOOPON,
    ST_PRSOK,
    ST_PRSON,
    ST_STILL,
    TARGET,
    THEORY,
    Reals,
    Words,
)

NONE, FAST, TURNING, SLOW, TO_MARK, OVERRUN, RETURNING, REVERSING = range(8)
"""`HOME_PHASE`: no search; to the cam; stopping on it; off it; to the zero pulse; stopping behind the place that was
loaded; placing the axis there; stopping to go the other way."""


@exactly_compiled
def _search(reg: Words, real: Reals, direction: int, speed: int, phase: int) -> None:
    """Move at a speed until something is found."""
    reg[MOVE], reg[ST_STILL], reg[HOME_PHASE] = SEARCHING, 0, phase
    begin(reg, real, direction, slopes(reg))
    plan(reg, real, math.inf, speed * speed_unit(reg))
    real[SEARCHED_FROM] = real[THEORY]


@exactly_compiled
def can_home(reg: Words) -> bool:
    """Say whether the speeds of a search with motion have a meaning."""
    return bool(reg[PRSMODE] == 2 or (can_move(reg, reg[PRSVEL]) and can_move(reg, reg[SPRSVEL])))


@exactly_compiled
def give_up(reg: Words) -> None:
    """End a search without success."""
    reg[HOME_PHASE], reg[ST_PRSON] = NONE, 0


@exactly_compiled
def preset(reg: Words, real: Reals) -> None:
    """Start a search, or turn a running one about (row Q-A28)."""
    needed = HAS_HOME | HAS_INDEX if reg[PRSMODE] == 1 else HAS_HOME
    if reg[RESOURCES] & needed != needed:
        fail(reg, real, RESOURCE_MISSING, reg[PRSMODE])
        return
    reg[ST_PRSOK] = 0
    if reg[PRSMODE] == 2:
        return
    again = reg[HOME_PHASE] != NONE
    reg[ST_PRSON] = 1
    if not again:
        reg[HOME_DIR] = -1 if reg[PRMDIR] != 0 else 1
        if reg[ST_LOOPON] == 0:
            catch_up(reg, real)
    elif reg[HOME_PHASE] == FAST:
        reg[HOME_DIR] = -reg[HOME_DIR]
    if reg[MOVE] != RESTING:
        brake(reg, real)
        reg[MOVE], reg[HOME_PHASE] = ENDING, REVERSING
    else:
        _set_out(reg, real, again)


@exactly_compiled
def _set_out(reg: Words, real: Reals, again: bool) -> None:
    """Go to the cam; an axis that stands on it at the first PRESET leaves it at once (row Q-53)."""
    if reg[CAM] != 0 and not again:
        _search(reg, real, -reg[HOME_DIR], reg[SPRSVEL], SLOW)
    else:
        _search(reg, real, reg[HOME_DIR], reg[PRSVEL], FAST)


@exactly_compiled
def _load(reg: Words, real: Reals, edges_since: int) -> None:
    """Make the count prspos where the axis was some edges ago; a locked count is not loaded, and the search ends."""
    brake(reg, real)
    if reg[ST_CNTLOCK] != 0:
        give_up(reg)
        return
    shift(reg, real, reg[PRSPOS] * reg[PULSE] + edges_since * reg[MEASURE], True)
    reg[HOME_PHASE] = OVERRUN


@exactly_compiled
def _edges_since_mark(reg: Words, index_at: int) -> int:
    edges: int = reg[LAST_COUNT] - index_at
    return -edges if reg[ST_CNTREV] != 0 else edges


@exactly_compiled
def search(reg: Words, real: Reals, cam_before: int, marks: int, index_at: int) -> None:
    """Carry a running search on by a sample.

    Parameters
    ----------
    cam_before : int
        The enabling input at the last sample; `CAM` has it now.
    marks, index_at : int
        How many zero pulses have come, and the counter at the last one.
    """
    phase, rests = reg[HOME_PHASE], reg[MOVE] == RESTING
    if phase == FAST and reg[CAM] > cam_before:
        brake(reg, real)
        reg[HOME_PHASE] = TURNING
    elif phase == TURNING and rests:
        _search(reg, real, -reg[HOME_DIR], reg[SPRSVEL], SLOW)
    elif phase == SLOW and reg[CAM] < cam_before:
        reg[MARKS] = marks
        if reg[PRSMODE] == 0:
            _load(reg, real, 0)
        else:
            reg[HOME_PHASE] = TO_MARK
            real[SEARCHED_FROM] = real[THEORY]
    elif phase == TO_MARK and marks != reg[MARKS]:
        _load(reg, real, _edges_since_mark(reg, index_at))
    elif phase == OVERRUN and rests:
        reg[SETPOS], reg[SETVEL] = reg[PRSPOS], reg[SPRSVEL]
        reg[TARGET], reg[HAS_TARGET] = reg[PRSPOS], 1
        reg[HOME_PHASE] = RETURNING
        travel(reg, real, float(reg[PRSPOS]))
    elif phase == RETURNING and rests:
        give_up(reg)
        reg[ST_PRSOK] = 1
    elif phase == REVERSING and rests:
        _search(reg, real, reg[HOME_DIR], reg[PRSVEL], FAST)
    _bound(reg, real)


@exactly_compiled
def _bound(reg: Words, real: Reals) -> None:
    """Beyond the manual: let no phase of a search go further than a limit."""
    searched = abs(real[THEORY] - real[SEARCHED_FROM])
    if reg[MOVE] == SEARCHING and reg[HOME_LIMIT] > 0 and searched > reg[HOME_LIMIT]:
        fail(reg, real, MARK_NOT_FOUND if reg[HOME_PHASE] == TO_MARK else CAM_NOT_FOUND, reg[PRSMODE])


@exactly_compiled
def hold_loaded(reg: Words, real: Reals) -> None:
    """Mode 2: load prspos while the input is closed, from its first closing after an opening on (row Q-52)."""
    if reg[CAM] == 0:
        reg[MODE2_ARMED] = 1
    elif reg[PRSMODE] == 2 and reg[MODE2_ARMED] != 0 and reg[ST_CNTLOCK] == 0:
        if reg[MODE2_ARMED] == 1:
            reg[ST_PRSOK], reg[MODE2_ARMED] = 1, 2
        if reg[NUMERATOR] != reg[PRSPOS] * reg[PULSE]:
            shift(reg, real, reg[PRSPOS] * reg[PULSE], True)
