"""The homing search of a QEM EANPOS ("preset search", manual 1.3.9): to the cam, back off it, to the zero pulse.

In mode 0, an axis 500 units before the cam reaches it at 333 units/s, reverses, and leaves it at 167 units/s. There
the count becomes prspos; the axis stops and returns to prspos. In mode 1, the first zero pulse after the cam loads
the count. In mode 2 nothing moves: each closing of the cam loads it.
"""

from __future__ import annotations

import math

from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.axis.eanpos import registers as at
from edmsim.controllers.axis.eanpos.moves import catch_up, fail, shift, slopes, speed_unit, travel
from edmsim.controllers.axis.eanpos.profile import begin, brake, plan
from edmsim.controllers.axis.eanpos.registers import Reals, Words

NONE, FAST, TURNING, SLOW, TO_MARK, OVERRUN, RETURNING, REVERSING = range(8)
"""`HOME_PHASE`: no search; to the cam; stopping on it; off it; to the zero pulse; stopping behind the place that was
loaded; placing the axis there; stopping to go the other way."""


@exactly_compiled
def _search(reg: Words, real: Reals, direction: int, speed: int, phase: int) -> None:
    """Move at a speed until something is found."""
    reg[at.MOVE], reg[at.ST_STILL], reg[at.HOME_PHASE] = at.SEARCHING, 0, phase
    begin(reg, real, direction, slopes(reg))
    plan(reg, real, math.inf, speed * speed_unit(reg))
    real[at.SEARCHED_FROM] = real[at.THEORY]


@exactly_compiled
def give_up(reg: Words) -> None:
    """End a search without success."""
    reg[at.HOME_PHASE], reg[at.ST_PRSON] = NONE, 0


@exactly_compiled
def preset(reg: Words, real: Reals) -> None:
    """Start a search, or turn a running one about (row Q-A28)."""
    needed = at.HAS_HOME | at.HAS_INDEX if reg[at.PRSMODE] == 1 else at.HAS_HOME
    if reg[at.RESOURCES] & needed != needed:
        fail(reg, real, at.RESOURCE_MISSING, reg[at.PRSMODE])
        return
    reg[at.ST_PRSOK] = 0
    if reg[at.PRSMODE] == 2:
        return
    again = reg[at.HOME_PHASE] != NONE
    reg[at.ST_PRSON] = 1
    if not again:
        reg[at.HOME_DIR] = -1 if reg[at.PRMDIR] != 0 else 1
        if reg[at.ST_LOOPON] == 0:
            catch_up(reg, real)
    elif reg[at.HOME_PHASE] == FAST:
        reg[at.HOME_DIR] = -reg[at.HOME_DIR]
    if reg[at.MOVE] != at.RESTING:
        brake(reg, real)
        reg[at.MOVE], reg[at.HOME_PHASE] = at.ENDING, REVERSING
    else:
        _set_out(reg, real, again)


@exactly_compiled
def _set_out(reg: Words, real: Reals, again: bool) -> None:
    """Go to the cam; an axis on the cam at the first PRESET leaves it at once (row Q-53)."""
    if reg[at.CAM] != 0 and not again:
        _search(reg, real, -reg[at.HOME_DIR], reg[at.SPRSVEL], SLOW)
    else:
        _search(reg, real, reg[at.HOME_DIR], reg[at.PRSVEL], FAST)


@exactly_compiled
def _load(reg: Words, real: Reals, edges_since: int) -> None:
    """Make the count prspos where the axis was some edges ago; a locked count is not loaded, and the search ends."""
    brake(reg, real)
    if reg[at.ST_CNTLOCK] != 0:
        give_up(reg)
        return
    shift(reg, real, reg[at.PRSPOS] * reg[at.PULSE] + edges_since * reg[at.MEASURE], True)
    reg[at.HOME_PHASE] = OVERRUN


@exactly_compiled
def _edges_since_mark(reg: Words, index_at: int) -> int:
    edges: int = reg[at.LAST_COUNT] - index_at
    return -edges if reg[at.ST_CNTREV] != 0 else edges


@exactly_compiled
def search(reg: Words, real: Reals, cam_before: int, marks: int, index_at: int) -> None:
    """Carry a search on by a sample; `cam_before` is the enabling input at the last one, `index_at` the last mark."""
    phase, rests = reg[at.HOME_PHASE], reg[at.MOVE] == at.RESTING
    if phase == FAST and reg[at.CAM] > cam_before:
        brake(reg, real)
        reg[at.HOME_PHASE] = TURNING
    elif phase == TURNING and rests:
        _search(reg, real, -reg[at.HOME_DIR], reg[at.SPRSVEL], SLOW)
    elif phase == SLOW and reg[at.CAM] < cam_before:
        reg[at.MARKS] = marks
        if reg[at.PRSMODE] == 0:
            _load(reg, real, 0)
        else:
            reg[at.HOME_PHASE] = TO_MARK
            real[at.SEARCHED_FROM] = real[at.THEORY]
    elif phase == TO_MARK and marks != reg[at.MARKS]:
        _load(reg, real, _edges_since_mark(reg, index_at))
    elif phase == OVERRUN and rests:
        reg[at.SETPOS], reg[at.SETVEL] = reg[at.PRSPOS], reg[at.SPRSVEL]
        reg[at.TARGET], reg[at.HAS_TARGET] = reg[at.PRSPOS], 1
        reg[at.HOME_PHASE] = RETURNING
        travel(reg, real, float(reg[at.PRSPOS]))
    elif phase == RETURNING and rests:
        give_up(reg)
        reg[at.ST_PRSOK] = 1
    elif phase == REVERSING and rests:
        _search(reg, real, reg[at.HOME_DIR], reg[at.PRSVEL], FAST)
    _bound(reg, real)


@exactly_compiled
def _bound(reg: Words, real: Reals) -> None:
    """Beyond the manual: let no phase of a search go further than a limit."""
    searched = abs(real[at.THEORY] - real[at.SEARCHED_FROM])
    if reg[at.MOVE] == at.SEARCHING and reg[at.HOME_LIMIT] > 0 and searched > reg[at.HOME_LIMIT]:
        fail(reg, real, at.MARK_NOT_FOUND if reg[at.HOME_PHASE] == TO_MARK else at.CAM_NOT_FOUND, reg[at.PRSMODE])


@exactly_compiled
def hold_loaded(reg: Words, real: Reals) -> None:
    """Mode 2: load prspos while the input is closed, from its first closing after an opening on (row Q-52)."""
    if reg[at.CAM] == 0:
        reg[at.MODE2_ARMED] = 1
    elif reg[at.PRSMODE] == 2 and reg[at.MODE2_ARMED] != 0 and reg[at.ST_CNTLOCK] == 0:
        if reg[at.MODE2_ARMED] == 1:
            reg[at.ST_PRSOK], reg[at.MODE2_ARMED] = 1, 2
        if reg[at.NUMERATOR] != reg[at.PRSPOS] * reg[at.PULSE]:
            shift(reg, real, reg[at.PRSPOS] * reg[at.PULSE], True)
