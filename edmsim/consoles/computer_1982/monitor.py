"""The monitor: the operator's program in EPROM of May 1982 (4.1, row T-78); and its tapes.

It reads and changes memory and the chips' registers, loads programs from tape and from the host, punches memory to
tape, and starts programs. It handles each character at once (row T-83): lines cannot be corrected, and an error ends
the command. The thesis names its functions but not its commands: the letters are ours, in the style of monitors of
the time.

Tapes are in Intel HEX, the format of punched and sent programs. Each line is a record: a colon, the number of bytes,
their address, the kind of the record (00 data, 01 the end), the bytes and a checksum, all in hexadecimal. Count,
address, kind, bytes and checksum add up to 0 in eight bits.
"""

from collections.abc import Callable, Generator
from pathlib import Path
from textwrap import fill
from typing import NamedTuple

from edmsim.consoles.computer_1982.line_input import CANCEL, LINE_FEED, RETURN, SPACE, normal
from edmsim.controllers.mcu.chips import bus
from edmsim.controllers.mcu.computer import Computer
from edmsim.controllers.mcu.firmware import memory_map as at
from edmsim.controllers.mcu.firmware.poscal import BYTE, WORD
from edmsim.errors import InputError

RECORD_BYTES = 16  # data bytes of a punched record, as in Intel's own programs
DATA, END = 0x00, 0x01
_FRAME = 5  # other bytes of a record: count, address, kind, checksum


class Tape(NamedTuple):
    """A tape's content: bytes by address, and the start address of its program (0 if it has none)."""

    bytes: dict[int, int]
    start: int


def read_tape(text: bytes) -> Tape:
    """Read a tape; raises `InputError` for an invalid record, a wrong checksum or a missing end, with its line."""
    found: dict[int, int] = {}
    for number, line in enumerate(text.replace(b"\0", b"").splitlines(), 1):
        if not line.strip():
            continue
        try:
            address, kind, data = _record(line.strip())
        except InputError as error:
            raise InputError(f"line {number} of the tape: {error.reason}") from None
        if kind == END:
            return Tape(found, address)
        found.update({address + offset & WORD: byte for offset, byte in enumerate(data)})
    raise InputError("the tape ends without its last record, :00000001FF")


def punch(data: bytes, first: int) -> str:
    """Return a tape with bytes for memory from an address on."""
    records = [
        _punched(first + offset, DATA, data[offset : offset + RECORD_BYTES])
        for offset in range(0, len(data), RECORD_BYTES)
    ]
    return "".join([*records, _punched(0, END, b"")])


def _punched(address: int, kind: int, data: bytes) -> str:
    record = bytes([len(data), address >> 8, address & BYTE, kind]) + data
    return f":{(record + bytes([-sum(record) & BYTE])).hex().upper()}\n"


def _record(line: bytes) -> tuple[int, int, bytes]:
    """Address, kind and data of a record."""
    try:
        record = bytes.fromhex(line[1:].decode("ascii"))
    except ValueError:
        record = b""
    if not line.startswith(b":") or len(record) < _FRAME:
        raise InputError("a record is a colon and at least 10 hexadecimal figures")
    if len(record) != _FRAME + record[0]:
        raise InputError(f"the record says {record[0]} bytes and has {len(record) - _FRAME}")
    right = -sum(record[:-1]) & BYTE
    if record[-1] != right:
        raise InputError(f"its checksum is {record[-1]:02X}H where {right:02X}H were right")
    if record[3] not in (DATA, END):
        raise InputError(f"a record of kind {record[3]:02X} is not for sixteen bits of address; 00 and 01 are")
    return record[1] << 8 | record[2], record[3], record[4:-1]


ESCAPE = 0x1B  # ends a command, as Ctrl-X does
BYTES_A_LINE, COLUMNS = 16, 80
_HEX = b"0123456789ABCDEF"
_ENDS = (RETURN, LINE_FEED)
_SEPARATORS = (SPACE, ord(","))
_NAME_MOST = 32

HELP = """\
D 2000,201F      display memory, or registers of the chips, 4000H and up
S 2044 1E 00     substitute: shows a byte and takes a new one; a space goes on
                 to the next, with nothing typed unchanged; RETURN ends
R NAME           read a tape into RAM          H    the same from the host
P 2000,20FF,NAME punch memory to a tape
G 0400           go: starts at an address; 0400 is MAIN, with INIT before it
G                goes back to MAIN where it was left
M                map of RAM, and the addresses that can be started
ESC or Ctrl-X ends a command; Ctrl-C is the emergency stop."""

STARTS = {
    at.MONITOR: "MONITOR, AFTER A RESET", at.EMERGENCY_ROUTINE: "EMERGENCY ROUTINE",
    at.X_ENTRY: "STEPPER ROUTINE, X", at.Y_ENTRY: "STEPPER ROUTINE, Y", at.KBD_ROUTINE: "KBD", at.INIT: "INIT",
    at.MAIN: "MAIN",
}  # fmt: skip
"""Routines in EPROM that G starts."""

_Typing = Generator[None, int, None]


class _Number(NamedTuple):
    """A typed number, None if it has no digits, and the character that ended it."""

    value: int | None
    end: int


class Monitor:
    """The monitor's commands, read character by character; `go` starts at an address or, for None, resumes MAIN."""

    prompt = ". "

    def __init__(
        self, computer: Computer, tapes: Path, from_host: Callable[[], bytes], go: Callable[[int | None], None],
        out: Callable[[bytes], None], say: Callable[[str], None],
    ) -> None:  # fmt: skip
        self._computer = computer
        self._tapes = tapes
        self._from_host = from_host
        self._start = go
        self._out = out
        self._say = say
        self._commands: dict[str, Callable[[], _Typing]] = {
            "D": self._display, "S": self._substitute, "R": self._read, "H": self._host, "P": self._punch,
            "G": self._go, "M": self._map, "?": self._help,
        }  # fmt: skip
        self._typed = bytearray()
        self._typing: _Typing | None = None

    @property
    def typed(self) -> bytes:
        """Text on the screen after the prompt."""
        return bytes(self._typed)

    def clear(self) -> None:
        """Discard an incomplete command."""
        self._typed.clear()
        self._typing = None

    def take(self, character: int) -> bool:
        """Handle a character; True if it ended a command, as every error does."""
        try:
            if self._typing is None:
                return self._begin(character)
            if character in (CANCEL, ESCAPE):
                raise InputError("ended by the operator")
            self._typing.send(character)
        except StopIteration:
            self.clear()
            return True
        except InputError:
            if self._typed:
                self._new_line()
            self.clear()
            raise
        return False

    def _begin(self, character: int) -> bool:
        if character in _ENDS:
            self._new_line()
            return True
        if character == SPACE:
            return False
        letter = normal(bytes([character])).decode("ascii", "replace")
        self._echo(ord(letter) & BYTE)
        if letter not in self._commands:
            shown = letter if letter.isprintable() else f"{character:02X}H"
            raise InputError(f"{shown} is not a command; ? shows them")
        self._typing = self._commands[letter]()
        next(self._typing)
        return False

    def _echo(self, character: int) -> None:
        if SPACE <= character < 0x7F:
            self._show(bytes([character]))

    def _new_line(self) -> None:
        self._typed.clear()
        self._out(b"\r\n")

    def _show(self, data: bytes) -> None:
        self._typed += data
        self._out(data)

    def _number(self, figures: int, may_lack: bool = False) -> Generator[None, int, _Number]:
        """Read a hexadecimal number up to a separator or the end of the line (GETHX)."""
        value, count = 0, 0
        while True:
            character = normal(bytes([(yield)]))[0]
            self._echo(character)
            if character in _ENDS or (character in _SEPARATORS and (count or may_lack)):
                return _Number(value if count else None, character)
            if character == SPACE:
                continue
            if character not in _HEX or count == figures:
                found = chr(character) if SPACE < character < 0x7F else f"{character:02X}H"
                raise InputError(f"a hexadecimal number of up to {figures} figures is expected, not {found}")
            value, count = value << 4 | _HEX.index(character), count + 1

    def _end(self) -> _Typing:
        """Read the end of the line; raises `InputError` for anything else."""
        while (character := (yield)) not in _ENDS:
            self._echo(character)
            if character != SPACE:
                raise InputError("RETURN is expected here")

    def _name(self) -> Generator[None, int, str]:
        name = bytearray()
        while (character := (yield)) not in _ENDS:
            self._echo(character)
            if not (chr(character).isascii() and (chr(character).isalnum() or character in b"-_. ")):
                raise InputError("a tape's name has letters, figures, points and dashes")
            name += bytes([character])
        found = name.decode("ascii").strip()
        if not found or found.startswith(".") or " " in found or len(found) > _NAME_MOST:
            raise InputError(f"a tape's name of up to {_NAME_MOST} letters, figures, points and dashes is expected")
        return found

    def _range(self, with_name: bool) -> Generator[None, int, tuple[int, int]]:
        """Read two addresses; the second may be omitted unless a name follows."""
        first = yield from self._number(4)
        if first.value is None:
            raise InputError("an address is expected")
        if first.end in _ENDS and not with_name:
            return first.value, first.value | BYTES_A_LINE - 1
        last = first if first.end in _ENDS else (yield from self._number(4))
        if last.value is None or last is first or (last.end in _ENDS) == with_name:
            raise InputError("a first and a last address are expected" + (", and a name" if with_name else ""))
        if last.value < first.value:
            raise InputError(f"the last address, {last.value:04X}H, lies before the first, {first.value:04X}H")
        return first.value, last.value

    def _display(self) -> _Typing:
        first, last = yield from self._range(with_name=False)
        self._new_line()
        for begin in range(first & -BYTES_A_LINE, last + 1, BYTES_A_LINE):
            addresses = range(max(begin, first), min(begin + BYTES_A_LINE, last + 1))
            self._say(f"{addresses[0]:04X}  " + " ".join(f"{self._computer.bus.read(a):02X}" for a in addresses))

    def _substitute(self) -> _Typing:
        address = yield from self._number(4)
        if address.value is None:
            raise InputError("an address is expected")
        place = address.value
        if address.end in _ENDS:
            self._new_line()
            self._show(b"%04X " % place)
        while True:
            self._show(b"%02X-" % self._computer.bus.read(place))
            new = yield from self._number(2, may_lack=True)
            if new.value is not None:
                self._write(place, new.value)
            if new.end in _ENDS:
                break
            place = place + 1 & WORD
        self._new_line()

    def _read(self) -> _Typing:
        name = yield from self._name()
        self._new_line()
        try:
            text = (self._tapes / name).read_bytes()
        except OSError as error:
            raise InputError(f"the tape {name} cannot be read: {error.strerror}") from None
        self._load(text)

    def _host(self) -> _Typing:
        yield from self._end()
        self._new_line()
        self._load(self._from_host())

    def _load(self, text: bytes) -> None:
        tape = read_tape(text)
        outside = [address for address in tape.bytes if address not in bus.RAM]
        if outside:
            raise InputError(f"the tape is for {outside[0]:04X}H, which is not RAM; nothing was loaded")
        for address, byte in tape.bytes.items():
            self._write(address, byte)
        where = f", {min(tape.bytes):04X}H TO {max(tape.bytes):04X}H" if tape.bytes else ""
        self._say(f"{len(tape.bytes)} BYTES{where}" + (f", TO BE STARTED AT {tape.start:04X}H" if tape.start else ""))

    def _punch(self) -> _Typing:
        first, last = yield from self._range(with_name=True)
        name = yield from self._name()
        self._new_line()
        if last not in bus.RAM and last not in bus.EPROM:
            raise InputError(f"{last:04X}H is not memory; {bus.EPROM[0]:04X}H to {bus.RAM[-1]:04X}H are punched")
        tape = punch(bytes(map(self._computer.bus.read, range(first, last + 1))), first)
        try:
            with (self._tapes / name).open("x", encoding="ascii") as file:
                file.write(tape)
        except FileExistsError:
            raise InputError(f"there is a tape {name} already, and no hole can be closed: name another") from None
        except OSError as error:
            raise InputError(f"the tape {name} cannot be punched: {error.strerror}") from None
        self._say(f"{last - first + 1} BYTES ON TAPE {name}")

    def _write(self, address: int, byte: int) -> None:
        self._computer.bus.check_writable(address)
        self._computer.bus.write(address, byte)

    def _go(self) -> _Typing:
        address = yield from self._number(4)
        if address.end not in _ENDS:
            yield from self._end()
        self._new_line()
        self._start(address.value)

    def _map(self) -> _Typing:
        yield from self._end()
        self._new_line()
        areas = [f"{area.first:04X}-{area.first + area.bytes - 1:04X}  {area.holds}" for area in at.MAP]
        self._say("\n".join(areas))
        self._say(fill("G STARTS " + ", ".join(f"{a:04X} {name}" for a, name in STARTS.items()), COLUMNS))

    def _help(self) -> _Typing:
        yield from self._end()
        self._new_line()
        self._say(HELP)
