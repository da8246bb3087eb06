"""The servo processor module's data recorder: 128 numbers from a trigger on, then sent a line each (guide 4.20).

``Z157`` is 5 + 24 + 128: every 32nd cycle, without trigger, the duty. The first number is from the trigger's cycle.
The guide says that a spreadsheet can read the data; here each number is a signed decimal with CR LF (row M-A18), sent
at the serial line's speed.
"""

from __future__ import annotations

from typing import Any

from edmsim.compiled.axis_rows import put_byte
from edmsim.compiled.jit import exactly_compiled
from edmsim.controllers.axis.servo_module import registers as at
from edmsim.controllers.axis.servo_module.law import Words

RATE, TRIGGER, FIRST_SOURCE = 0b111, 0b11 << 3, 5
"""Parts of a code: cycles of an entry as a power of 2, when to start, and from which bit on what to note."""
ON_VELOCITY, ON_TURN, UNUSED, AT_ONCE = 0, 8, 16, 24  # triggers
N_SOURCES = 6
_RETURN, _LINE_FEED, _MINUS, _ZERO = 13, 10, 45, 48  # characters


@exactly_compiled
def _source(reg: Words) -> int:
    source = reg[at.CODE] >> FIRST_SOURCE
    if source == 0:
        return int(reg[at.ERROR])
    if source == 1:
        return int(reg[at.VELOCITY])
    if source == 2:
        return int(reg[at.COMMANDED])
    if source == 3:
        return int(reg[at.OUTPUT])
    return int(reg[at.DUTY] if source == 4 else reg[at.LIMIT])


@exactly_compiled
def _triggered(reg: Words, turned: bool) -> bool:
    trigger = reg[at.CODE] & TRIGGER
    if trigger == ON_TURN:
        return turned
    return bool(trigger == AT_ONCE or reg[at.COMMANDED] != 0)


@exactly_compiled
def note(reg: Words, memory: Words, turned: bool) -> None:
    """Wait for the trigger, then record one cycle in `every` until the memory is full; called after the loop."""
    if reg[at.STATUS] & at.RECORDER_BIT == 0:
        return
    if reg[at.STATUS] & at.TRIGGERED_BIT == 0:
        if not _triggered(reg, turned):
            return
        reg[at.STATUS] |= at.TRIGGERED_BIT
        reg[at.RECORDED] = 0
    rate = reg[at.CODE] & RATE
    if reg[at.RECORDED] & ((1 << rate) - 1) == 0:
        memory[reg[at.RECORDED] >> rate] = _source(reg)
    reg[at.RECORDED] += 1
    if reg[at.RECORDED] >> rate == at.N_MEMORY:
        reg[at.STATUS] &= ~(at.RECORDER_BIT | at.TRIGGERED_BIT)
        reg[at.DUMPING], reg[at.DUMPED], reg[at.LINE_FREE_NS] = 1, 0, reg[at.NOW_NS]


@exactly_compiled
def character_of(value: int, place: int) -> int:
    """Return a character of a number's line: sign, digits, CR, LF."""
    size, digits = abs(value), 1
    while size >= 10**digits:
        digits += 1
    first = 1 if value < 0 else 0
    if place < first:
        return _MINUS
    if place < first + digits:
        return int(_ZERO + size // 10 ** (first + digits - 1 - place) % 10)
    return _RETURN if place == first + digits else _LINE_FEED


@exactly_compiled
def dump(drive: Any) -> None:
    """Send what the serial line takes until now of a full memory."""
    reg = drive.reg
    while reg[at.DUMPING] != 0 and reg[at.LINE_FREE_NS] <= reg[at.NOW_NS]:
        character = character_of(drive.memory[reg[at.DUMPING] - 1], reg[at.DUMPED])
        put_byte(drive, character)
        reg[at.DUMPED] += 1
        reg[at.LINE_FREE_NS] += reg[at.BYTE_NS]
        if character == _LINE_FEED:
            reg[at.DUMPED] = 0
            reg[at.DUMPING] = reg[at.DUMPING] + 1 if reg[at.DUMPING] < at.N_MEMORY else 0
