"""Tapes: Intel HEX, the form in which programs were punched and sent.

Each line is a record: a colon, the number of bytes, their address, the kind of the record (00 data, 01 the end), the
bytes and a checksum, all in hexadecimal; count, address, kind, bytes and checksum add up to 0 in eight bits.
"""

from __future__ import annotations

from typing import NamedTuple

from edmsim.controllers.mcu.firmware.arithmetic import BYTE, WORD
from edmsim.errors import InputError

RECORD_BYTES = 16
"""Bytes in a record that is punched, as Intel's own programs punch them."""
DATA, END = 0x00, 0x01
_FRAME = 5
"""Bytes of a record besides its data: count, address, kind, checksum."""


class Tape(NamedTuple):
    """What stands on a tape.

    Attributes
    ----------
    bytes : dict of int to int
        Bytes by their addresses.
    start : int
        Address at which the program on it is to be started; 0 where the tape names none.
    """

    bytes: dict[int, int]
    start: int


def read_tape(text: bytes) -> Tape:
    """Read a tape.

    Raises
    ------
    InputError
        If a record is none, its checksum is wrong, or the end is missing; the line is named.
    """
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
    """Return the tape of some bytes that stand from an address on."""
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
