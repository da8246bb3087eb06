"""End switches and wire-break switch: one common interrupt, and the effect of each (rows T-46, T-47)."""

from __future__ import annotations

from collections.abc import Callable, Set

from edmsim.errors import InputError
from edmsim.snapshots import Snapshots

X_END, Y_END, WIRE_BREAK, STOP_BUTTON = "x end", "y end", "wire break", "emergency stop"
NAMES = (X_END, Y_END, WIRE_BREAK, STOP_BUTTON)
"""The document names the first three; the operator's button is the emergency switch of its 4.1."""


class SafetySwitches(Snapshots):
    """Switches ORed into one interrupt; they cut supply and generator themselves; `stuck` ones never open."""

    STATE = ("_open",)

    def __init__(self, on_rise: Callable[[], None], stuck: Set[str] = frozenset()) -> None:
        self._on_rise = on_rise
        self.stuck = stuck
        self._open: set[str] = set()

    @property
    def open(self) -> tuple[str, ...]:
        """Names of the switches that have opened and not been released."""
        return tuple(name for name in NAMES if name in self._open)

    @property
    def steppers_supplied(self) -> bool:
        """Whether the steppers have their supply."""
        return not self._open & {X_END, Y_END, STOP_BUTTON}

    @property
    def generator_allowed(self) -> bool:
        """Whether the generator may run."""
        return not self._open & {WIRE_BREAK, STOP_BUTTON}

    def trip(self, name: str) -> None:
        """Open a switch, unless it is stuck; raises `InputError` if there is no such switch."""
        if name not in NAMES:
            raise InputError(f"there is no switch {name!r}; there are {', '.join(NAMES)}")
        if name in self.stuck:
            return
        before = bool(self._open)
        self._open.add(name)
        if not before:
            self._on_rise()

    def release(self) -> None:
        """Someone has put everything right: table off its ends, a wire threaded, the button pulled."""
        self._open.clear()
