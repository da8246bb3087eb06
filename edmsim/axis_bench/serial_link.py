"""A serial line between a terminal and a drive: a byte takes ten bits' time, and both ends need the same baud."""

import math
from collections import deque
from typing import NamedTuple

from edmsim.compiled.axis_rows import SENT
from edmsim.controllers.axis.drive import Drive, SerialDrive

BITS = 10  # bits of a byte on the line: start, eight data bits from the lowest, stop


_NO_BAUD = 9600.0  # of a drive without a serial line


class Byte(NamedTuple):
    """A byte read by an input: its value, the time of its stop bit, and whether that bit was 1."""

    value: int
    time_ns: int
    framed: bool


def levels_of(data: bytes) -> list[int]:
    """Return the line's levels of consecutive bytes, bit by bit."""
    levels = []
    for byte in data:
        levels += [0, *(byte >> k & 1 for k in range(8)), 1]
    return levels


def read_levels(levels: list[int], baud: float, start_ns: int, input_baud: float) -> list[Byte]:
    """Return the bytes that an input reads if the sender's baud differs: it samples in the middle of its own bits.

    Examples
    --------
    >>> [chr(b.value) for b in read_levels(levels_of(b"P6"), 38400.0, 0, 38461.5)]
    ['P', '6']
    >>> [b.framed for b in read_levels(levels_of(b"P"), 38400.0, 0, 57600.0)]
    [False]
    """
    bit_s, own_s, total_s = 1 / baud, 1 / input_baud, len(levels) / baud

    def level(time_s: float) -> int:
        return levels[int(time_s / bit_s)] if time_s < total_s else 1

    found: list[Byte] = []
    at_s = 0.0
    while at_s < total_s:
        k = math.floor(at_s / bit_s + 1e-9)
        falls = next((j for j in range(k, len(levels)) if levels[j] == 0 and (j == k or levels[j - 1] == 1)), None)
        if falls is None:
            break
        edge_s = max(at_s, falls * bit_s)
        value = sum(level(edge_s + (1.5 + j) * own_s) << j for j in range(8))
        stop_s = edge_s + 9.5 * own_s
        found.append(Byte(value, start_ns + round(stop_s * 1e9), level(stop_s) == 1))
        at_s = stop_s
    return found


class Sender:
    """One direction of a line: bytes are queued, transmitted one by one, and read by the input at the other end."""

    def __init__(self, baud: float) -> None:
        self.baud = baud
        self.input_baud = baud
        self.open = True
        self._free_ns = 0
        self._coming: deque[Byte] = deque()

    def put(self, data: bytes, now_ns: int) -> None:
        """Send some bytes as soon as the line is free."""
        if not data:
            return
        start_ns = max(now_ns, self._free_ns)
        self._free_ns = start_ns + round(len(data) * BITS / self.baud * 1e9)
        if not self.open:
            return
        if abs(self.input_baud / self.baud - 1) < 1e-6:
            bit_ns = 1e9 / self.baud
            for k, value in enumerate(data, 1):
                self._coming.append(Byte(value, start_ns + round(k * BITS * bit_ns), True))
        else:
            self._coming.extend(read_levels(levels_of(data), self.baud, start_ns, self.input_baud))

    @property
    def next_ns(self) -> int | None:
        """Time at which the next byte arrives; None if none is in transmission."""
        return self._coming[0].time_ns if self._coming else None

    def take(self, now_ns: int) -> list[Byte]:
        """Return the bytes that have arrived."""
        taken = []
        while self._coming and self._coming[0].time_ns <= now_ns:
            taken.append(self._coming.popleft())
        return taken


class SerialLink:
    """Both directions of the line between a terminal and a drive; a drive without a serial line does not answer."""

    def __init__(self, drive: Drive) -> None:
        self._drive = drive
        self._serial = drive if isinstance(drive, SerialDrive) else None
        baud = self._serial.baud if self._serial else _NO_BAUD
        self.to_drive, self.to_host = Sender(baud), Sender(baud)
        self._drained = 0
        self.heard: list[tuple[int, float]] = []  # bytes at the terminal, not yet taken by `received_at`

    @property
    def busy(self) -> bool:
        """Whether bytes are in transmission in either direction."""
        return self.to_drive.next_ns is not None or self.to_host.next_ns is not None

    def set_host_baud(self, baud: float) -> None:
        """Set the terminal's baud; by default it is the drive's."""
        self.to_drive.baud = self.to_host.input_baud = baud
        self.to_drive.input_baud = self.to_host.baud

    def exchange(self, now_ns: int, running: bool, unsolicited: bool) -> None:
        """Pass received bytes to the drive (lost in reset), and collect its answers and unsolicited bytes."""
        record = self._drive.record
        sent, n_sent = record["sent"][0], int(record["n_sent"][0])
        for k in range(max(self._drained, n_sent - SENT), n_sent):
            value = int(sent[k % SENT])
            self.to_host.put(bytes([value & 0xFF]), value >> 8)
        self._drained = n_sent
        for byte in self.to_drive.take(now_ns):
            if running:
                record["now_ns"] = now_ns
                if self._serial and not byte.framed:
                    self._serial.receive_error()
                self.to_host.put(self._drive.line(bytes([byte.value])), now_ns)
        if running and unsolicited:
            self.to_host.put(self._drive.line(b""), now_ns)
        self.heard += [(byte.value, byte.time_ns * 1e-9) for byte in self.to_host.take(now_ns)]

    def received_at(self) -> list[tuple[int, float]]:
        """Return the terminal's received bytes since the last call, each with its time in s."""
        heard, self.heard = self.heard, []
        return heard

    def forget(self) -> None:
        """Regard all bytes in the drive's buffer as sent, as after a snapshot was restored."""
        self._drained = int(self._drive.record["n_sent"][0])
