"""The pulse analyser's read-out: 8-bit counters per 255 pulses and their handshake (4.2.3).

Every pulse is an erosion, a short circuit (SC) or open (OP) (row T-38). A third counter counts all pulses;
at 255 the strobes STBA and STBB go low, the 8255 takes both counts over, answers IBFA and IBFB, and these
reset all counters for the next cycle (rows T-39, T-40).
"""

from typing import ClassVar, NamedTuple

from edmsim.errors import InputError
from edmsim.machine.setting import WINDOW_PULSES
from edmsim.snapshots import Snapshots


def percent_of_window(pulses: float) -> float:
    """Return a count as a percentage of a cycle's pulses."""
    return 100.0 * pulses / WINDOW_PULSES


class PulseCounts(NamedTuple):
    """Short and open pulses of one cycle of 255; their sum is 0..255 (row T-41)."""

    short: int
    open: int


class PulseAnalyser(Snapshots):
    """The three counters of a cycle, and the 8255's two input latches (mode 1), whose result is polled (row T-43).

    `missed` counts results that were not read before the next one (row T-44).
    """

    STATE: ClassVar[tuple[str, ...]] = ("pulses", "short", "open", "missed", "buffer_full", "_latch")

    def __init__(self) -> None:
        self.pulses = self.short = self.open = self.missed = 0
        self.buffer_full = False
        self._latch = PulseCounts(0, 0)

    def result_waits(self) -> bool:
        """Whether IBFA or IBFB is set: a result has not been read yet."""
        return self.buffer_full

    def put_result(self, short: int, open: int) -> None:
        """Put a result into the latches."""
        self._latch = PulseCounts(short, open)
        self.buffer_full = True

    def read(self) -> PulseCounts:
        """Read the latched counts at both ports, which clears IBF; without a new result they are the old ones."""
        self.buffer_full = False
        return self._latch

    def clock(self, sc: bool, op: bool) -> None:
        """Count one pulse on the edge of SYNC from the analyser's lines; at most one is set (row T-38)."""
        if sc and op:
            raise InputError("a pulse cannot be short and open at once: set SC or OP, or neither for an erosion")
        self.pulses += 1
        self.short += bool(sc)
        self.open += bool(op)
        if self.pulses == WINDOW_PULSES:
            self._strobe()

    def count_window(self, short: int, open: int) -> None:
        """Count a whole cycle of 255 pulses at once; no other cycle may have begun."""
        if self.pulses:
            raise InputError(f"a whole cycle can only be counted from its start, not after {self.pulses} pulses")
        if short < 0 or open < 0 or short + open > WINDOW_PULSES:
            raise InputError(f"{short} short and {open} open pulses do not fit in a cycle of {WINDOW_PULSES}")
        self.short, self.open = short, open
        self._strobe()

    def clear(self) -> None:
        """Reset all counters: a new cycle begins."""
        self.pulses = self.short = self.open = 0

    def _strobe(self) -> None:
        """STBA and STBB: latches without an unread result take the counts; IBF resets the counters."""
        if self.result_waits():
            self.missed += 1
        else:
            self.put_result(self.short, self.open)
        self.pulses = self.short = self.open = 0
