"""The operator's line and its numbers: LINE, NORMAL, GNUMCI, GETNUM, GNUMHX and SKIP (5.1.2).

The monitor's commands act on each character at once; here the operator types and corrects a whole line first. LINE
puts it into the input buffer, from which the others read it. Characters are bytes, as on the serial channel.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from edmsim.controllers.mcu.chips.bus import Bus
from edmsim.controllers.mcu.computer import Streams
from edmsim.controllers.mcu.firmware import memory_map as at
from edmsim.controllers.mcu.firmware.memory_map import LINE_LENGTH
from edmsim.controllers.mcu.firmware.poscal import WORD
from edmsim.errors import InputError

BACKSPACE, DELETE, CANCEL, RETYPE = 0x08, 0x7F, 0x18, 0x12
"""The four correction characters BS, DEL, CAN (Ctrl-X) and Ctrl-R; the text gives only their number (row T-A10)."""

RETURN, LINE_FEED = 0x0D, 0x0A  # the two characters that end a line (row T-A10)
BELL, TAB, SPACE, END = 0x07, 0x09, 0x20, 0x00
"""A refused character rings the bell; a tab is stored as a space; 00H ends the buffer (row T-55)."""

SEPARATORS = b" ,;="  # characters that SKIP skips (ours: the text says spaces and separators)
_RUB_OUT = b"\b \b"
_NEW_LINE = b"\r\n"


class InputBuffer:
    """The input buffer (BPTR.DATA) in RAM: up to 64 characters and a 00H; the pointer BPTR points to one of them."""

    def __init__(self, text: bytes = b"", streams: Streams | None = None) -> None:
        self._streams = streams or Streams(Bus())
        self._memory = self._streams.memory
        self._streams.inputs[at.BUFFER_IN] = lambda: gnumci(self)
        self.fill(text)

    def fill(self, text: bytes) -> None:
        """Store a line and set the pointer to its first character."""
        for offset, character in enumerate(text + bytes([END])):
            self._memory.write(at.BPTR_DATA + offset, character)
        self._memory.store(at.BPTR, at.BPTR_DATA)

    @property
    def text(self) -> bytes:
        """The whole line."""
        return self._from(at.BPTR_DATA)

    @property
    def rest(self) -> bytes:
        """The line from the pointer on."""
        return self._from(self._memory.word(at.BPTR))

    @property
    def column(self) -> int:
        """Column of the pointer in the line, from 1."""
        return self._memory.word(at.BPTR) - at.BPTR_DATA + 1

    @property
    def waiting(self) -> int:
        """Character at the pointer, 00H at the end; the pointer is not moved."""
        return self._memory.read(self._memory.word(at.BPTR))

    def advance(self) -> None:
        """Set the pointer to the next character, unless it is at the end."""
        if self.waiting != END:
            self._memory.store(at.BPTR, self._memory.word(at.BPTR) + 1)

    def step_back(self) -> None:
        """Set the pointer to the previous character."""
        self._memory.store(at.BPTR, self._memory.word(at.BPTR) - 1)

    @contextmanager
    def as_input(self) -> Iterator[Callable[[], int | None]]:
        """Redirect the input stream to the buffer; yields the routine that reads the stream (row T-83)."""
        before = self._memory.word(at.CIADR)
        self._memory.store(at.CIADR, at.BUFFER_IN)
        try:
            yield self._streams.ci
        finally:
            self._memory.store(at.CIADR, before)

    def _from(self, address: int) -> bytes:
        found = bytearray()
        while len(found) < LINE_LENGTH and (character := self._memory.read(address + len(found) & WORD)) != END:
            found.append(character)
        return bytes(found)


class Line:
    """LINE: reads a line character by character, with corrections; a terminator passes it on.

    BS and DEL delete the last character, CAN the whole line, Ctrl-R types the line again. The 65th character and all
    control characters ring the bell and are not stored. A line that was too long, and was not corrected afterwards,
    is refused (ours: a part of a number must not move the machine).
    """

    def __init__(self, buffer: InputBuffer, out: Callable[[bytes], None]) -> None:
        self._buffer = buffer
        self._out = out
        self.clear()

    @property
    def typed(self) -> bytes:
        """Characters of the line."""
        return bytes(self._typed)

    def clear(self) -> None:
        """Delete the line."""
        self._typed = bytearray()
        self._too_long = False

    def take(self, character: int) -> bool:
        """Take one character; True if it ended the line, which is then in the buffer, in upper case."""
        if character in (RETURN, LINE_FEED):
            return self._end()
        if character in (BACKSPACE, DELETE, CANCEL):
            self._too_long = False
            for _ in range(len(self._typed) if character == CANCEL else min(1, len(self._typed))):
                self._typed.pop()
                self._out(_RUB_OUT)
        elif character == RETYPE:
            self._out(_NEW_LINE + self._typed)
        elif character != END:  # 00H is the leader of a paper tape
            self._keep(SPACE if character == TAB else character)
        return False

    def _keep(self, character: int) -> None:
        printable = SPACE <= character < DELETE
        if printable and len(self._typed) < LINE_LENGTH:
            self._typed.append(character)
            self._out(bytes([character]))
            return
        self._too_long |= printable
        self._out(bytes([BELL]))

    def _end(self) -> bool:
        text, too_long = normal(self.typed), self._too_long
        self.clear()
        self._out(_NEW_LINE)
        self._buffer.fill(b"" if too_long else text)
        if too_long:
            raise InputError(f"a line has at most {LINE_LENGTH} characters; nothing was done")
        return True


def normal(text: bytes) -> bytes:
    """Return the text with small letters as capitals (NORMAL, row T-54)."""
    return text.upper()


def gnumci(buffer: InputBuffer) -> int:
    """Return the character at the pointer, a space at the end, and advance the pointer (GNUMCI, row T-55)."""
    character = buffer.waiting
    buffer.advance()
    return character or SPACE


def skip(buffer: InputBuffer) -> bool:
    """Skip spaces and separators (SKIP, row T-57); returns the carry flag, True unless the line has ended."""
    while buffer.waiting in SEPARATORS:
        buffer.advance()
    return buffer.waiting != END


def getnum(buffer: InputBuffer) -> int:
    """Read a decimal number of 16 bits at the pointer and skip it, valid or not (GETNUM, rows T-56, T-60)."""
    return _number(buffer, 10, b"0123456789", "whole")


def gnumhx(buffer: InputBuffer) -> int:
    """Read a hexadecimal number of 16 bits at the pointer (GNUMHX, row T-56); otherwise as `getnum`."""
    return _number(buffer, 16, b"0123456789ABCDEF", "hexadecimal")


def _number(buffer: InputBuffer, base: int, digits: bytes, kind: str) -> int:
    """Read a number as GETDEC and GETHX of the monitor do, from the input stream."""
    column, written, value = buffer.column, bytearray(), 0
    with buffer.as_input() as ci:
        while (passed := buffer.waiting) and (character := ci()) is not None and character in digits:
            written.append(character)
            value = value * base + digits.index(character)
    if passed:
        buffer.step_back()
    if not written:
        found = buffer.rest[:1].decode("ascii") or "the end of the line"
        raise InputError(f"a {kind} number is expected at column {column}, not {found}")
    if value > WORD:
        top = f"{WORD:X}" if base == 16 else str(WORD)
        raise InputError(f"a number has 16 bits, 0..{top}, not {written.decode('ascii')}")
    return value
