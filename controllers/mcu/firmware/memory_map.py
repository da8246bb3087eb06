"""The addresses in the 8 K of EPROM and the 8 K of RAM, by the document's names if it has them.

The addresses are ours, except the jump table (row T-48). CIADR and COADR are before it at the end of RAM, in the
segment STACK. In the test phase of 1982 the EPROM held the monitor, and the control program was in RAM (4.1). So
the start values of INIT are in RAM, where the monitor can change them.
"""

from typing import NamedTuple

from edmsim.controllers.mcu.chips.bus import Bus
from edmsim.controllers.mcu.chips.pic import ENTRY_BYTES, JUMP_TABLE
from edmsim.controllers.mcu.firmware.optimise import Settings, State

# one area of variables for each stepper (row T-71), with the same offsets
X_AREA, Y_AREA = 0x2000, 0x2010
AREAS = (X_AREA, Y_AREA)
POSITION, VELOCITY, TARGET, ROUNDS = 0, 2, 4, 6
"""Counter in um, signed speed in units, target, and rounds of the timer to wait."""
XPOS, XVELOC, NEWX = (X_AREA + offset for offset in (POSITION, VELOCITY, TARGET))
YPOS, YVELOC, NEWY = (Y_AREA + offset for offset in (POSITION, VELOCITY, TARGET))
CUTVEL = 0x2020  # present cutting speed, signed, in units
SHORTS, OPENS, COUNTED = 0x2022, 0x2024, 0x2026
"""Last counts, and their number of pulses: 255, or 0 before the first."""
ENTRY = 0x2028  # number that is being typed at the keys
SAVED = 0x2030  # copy of both areas and the speed, the first action in an emergency (row T-49)
SAVED_WORDS = (XPOS, XVELOC, YPOS, YVELOC, CUTVEL)
CONSTANTS, VARIABLES = 0x2040, 0x2070
"""Constants and variables of the optimising routine: the words of `Settings` and `State` in order."""
CONSTANT_WORDS = Settings._fields
VARIABLE_WORDS = tuple(State.__dataclass_fields__)
MAXVEL = CONSTANTS + 2 * CONSTANT_WORDS.index("limit")
"""Greatest cutting speed the operator allows, in units: the optimising routine's limit."""
LINE_LENGTH = 64  # characters of a line (row T-53)
BPTR, BPTR_DATA = 0x20A0, 0x20A2
"""Pointer into the operator's line, and the line with its final 00H (row T-55)."""
NEW = 0x20F0  # target of START, as an entry of a program
START_VALUES = 0x2100
START_AREAS = (
    (XVELOC, 2), (X_AREA + ROUNDS, 2), (YVELOC, 2), (Y_AREA + ROUNDS, 2), (CUTVEL, 2), (SHORTS, 6), (ENTRY, 2),
    (VARIABLES, 2 * len(VARIABLE_WORDS)), (JUMP_TABLE, 8 * ENTRY_BYTES),
)  # fmt: skip
"""The table of start values, and the data areas to which INIT copies it in order (row T-80).

Position counters, targets and the operator's settings are not among them: INIT does not change them (row T-A14).
"""
PROGRAM, PROGRAM_ENTRIES, ENTRY_MOST_BYTES = 0x2180, 500, 9
"""The program from the host: greatest number of entries (ours), greatest bytes of each, and a final 00H."""
FREE = 0x3320  # free from here to the stack: room for tapes
STACK = 0x3FD0  # the stack of a program begins below
CIADR, COADR = 0x3FD0, 0x3FD2  # addresses of the routines that read and send characters (row T-58)

# addresses of routines in EPROM, for the jump table and the two words above
MONITOR, TERMINAL_IN, HOST_IN, BUFFER_IN, TERMINAL_OUT, HOST_OUT = 0x0000, 0x0100, 0x0108, 0x0120, 0x0110, 0x0118
EMERGENCY_ROUTINE, X_ENTRY, Y_ENTRY, KBD_ROUTINE, NO_ROUTINE = 0x0200, 0x0210, 0x0218, 0x0220, 0x0228
INIT, MAIN = 0x0300, 0x0400


class Area(NamedTuple):
    """An area of memory and its content."""

    first: int
    bytes: int
    holds: str


MAP = (
    Area(XPOS, 8, "X: XPOS, XVELOC, NEWX, ROUNDS OF THE TIMER"),
    Area(YPOS, 8, "Y: YPOS, YVELOC, NEWY, ROUNDS OF THE TIMER"),
    Area(CUTVEL, 2, "CUTVEL, CUTTING SPEED NOW"),
    Area(SHORTS, 6, "SHORTS, OPENS, PULSES COUNTED"),
    Area(ENTRY, 2, "NUMBER BEING ENTERED AT THE KEYS"),
    Area(SAVED, 2 * len(SAVED_WORDS), "COPY OF THE LAST EMERGENCY"),
    Area(CONSTANTS, 2 * len(CONSTANT_WORDS), "OPTIMISER: WHAT IT IS SET TO"),
    Area(MAXVEL, 2, "MAXVEL, GREATEST SPEED"),
    Area(VARIABLES, 2 * len(VARIABLE_WORDS), "OPTIMISER: ITS VARIABLES"),
    Area(BPTR, 2 + LINE_LENGTH + 1, "BPTR AND THE OPERATOR'S LINE"),
    Area(NEW, ENTRY_MOST_BYTES + 1, "NEW POSITION"),
    Area(START_VALUES, sum(size for _, size in START_AREAS), "INIT'S TABLE OF START VALUES"),
    Area(PROGRAM, PROGRAM_ENTRIES * ENTRY_MOST_BYTES + 1, "PROGRAM FROM THE HOST"),
    Area(FREE, STACK - FREE, "FREE, FOR TAPES; THE STACK FROM ITS END DOWN"),
    Area(CIADR, 4, "CIADR, COADR"),
    Area(JUMP_TABLE, 8 * ENTRY_BYTES, "I0AD TO I7AD, THE JUMP TABLE"),
)
"""RAM, area by area."""


# The optimising routine's constants and variables as words in RAM, where the monitor changes them.


def constants(memory: Bus) -> Settings:
    """Return the constants; the return to the place of a short is at most as fast as the cut."""
    found = Settings(*(memory.word(CONSTANTS + 2 * k) for k in range(len(CONSTANT_WORDS))))
    return found._replace(slow=min(found.slow, found.limit))


def set_constants(memory: Bus, settings: Settings) -> None:
    """Store the routine's constants in RAM; one of the words is MAXVEL."""
    for k, word in enumerate(settings):
        memory.store(CONSTANTS + 2 * k, word)


def variables(memory: Bus) -> State:
    """Return the variables."""
    return State(*(memory.word(VARIABLES + 2 * k) for k in range(len(VARIABLE_WORDS))))


def set_variables(memory: Bus, state: State) -> None:
    """Store the variables in RAM."""
    for k, name in enumerate(VARIABLE_WORDS):
        memory.store(VARIABLES + 2 * k, getattr(state, name))
