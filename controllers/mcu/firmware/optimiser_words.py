"""The optimising routine's constants and variables as words in RAM, where the monitor changes them."""

from __future__ import annotations

from edmsim.controllers.mcu.chips.bus import Bus
from edmsim.controllers.mcu.firmware import memory_map as at
from edmsim.controllers.mcu.firmware.optimise import Settings, State


def constants(memory: Bus) -> Settings:
    """Return the constants; the return to a short is no faster than the cut."""
    found = Settings(*(memory.word(at.CONSTANTS + 2 * k) for k in range(len(at.CONSTANT_WORDS))))
    return found._replace(slow=min(found.slow, found.limit))


def set_constants(memory: Bus, settings: Settings) -> None:
    """Store the routine's constants in RAM; one of the words is MAXVEL."""
    for k, word in enumerate(settings):
        memory.store(at.CONSTANTS + 2 * k, word)


def variables(memory: Bus) -> State:
    """Return the variables."""
    return State(*(memory.word(at.VARIABLES + 2 * k) for k in range(len(at.VARIABLE_WORDS))))


def set_variables(memory: Bus, state: State) -> None:
    """Put what the routine keeps into RAM."""
    for k, name in enumerate(at.VARIABLE_WORDS):
        memory.store(at.VARIABLES + 2 * k, getattr(state, name))
