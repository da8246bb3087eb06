"""RS-274 text split into blocks of words; nothing here knows what the words do."""

from __future__ import annotations

import codecs
import re
from dataclasses import dataclass
from pathlib import Path

from edmsim.errors import InputError
from edmsim.program.limits import GREATEST_NUMBER, check_size
from edmsim.program.registers import register
from edmsim.program.words import IDLE, VALUES, Ignored, UnknownWordsError, code_of

_BYTE_ORDER_MARKS = {  # that of UTF-32 begins with that of UTF-16
    codecs.BOM_UTF8: "utf-8", codecs.BOM_UTF32_LE: "utf-32", codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16",
}  # fmt: skip
_NOT_READ = {
    ")": "a ')' without a '(' before it: take it out",
    "#": "variables (#) are not read: write their values",
    "[": "expressions in brackets are not read: write their values",
    ",R": "',R' rounds a corner, which is not read: write the arc as G2 or G3",
    ",C": "',C' chamfers a corner, which is not read: write the chamfer as G1",
    ",": "a comma is in the line: write numbers with a decimal point, X1.5, and no commas between words",
}
"""What cannot be a word, by its first characters, and what would be right."""
_WORD = re.compile(r"([A-Z])([+-]?(?:\d+\.?\d*|\.\d+))")
_COMMENT = re.compile(r"\([^()]*\)|;.*")
_OFFSET = re.compile(r"([DH])(\d{1,4})=([+-]?(?:\d+\.?\d*|\.\d+))")
_LONGEST_TOLD = 12
_NESTED = re.compile(r"\([^)]*\(")
_CALL = ("M", 98)
_END_CODES = frozenset({("M", 2), ("M", 30)})


@dataclass(frozen=True)
class Block:
    """One line of a program.

    Attributes
    ----------
    line : int
        Line in the file, counted from 1.
    codes : tuple of (str, float)
        G and M codes in the order they are written.
    values : dict of str to float
        All other words but N, as written.
    pointed : bool
        Whether any coordinate (X Y I J R) or offset has a decimal point.
    decimals : int or None
        Most decimal places of a coordinate; None if there is no coordinate.
    deletable : bool
        Whether the line begins with the block delete sign ``/``.
    idle : tuple of str
        Words that cannot change a contour, as they stand.
    ignored : tuple of str
        Words the user leaves out.
    offsets : tuple of (str, float)
        Registers that the block gives a value, ``D1=0.155``, as written.
    """

    line: int
    codes: tuple[tuple[str, float], ...]
    values: dict[str, float]
    pointed: bool
    decimals: int | None
    deletable: bool
    idle: tuple[str, ...] = ()
    ignored: tuple[str, ...] = ()
    offsets: tuple[tuple[str, float], ...] = ()

    @property
    def ends_program(self) -> bool:
        """Whether the block has M2 or M30."""
        return not _END_CODES.isdisjoint(self.codes)


def read_text(file: Path) -> str:
    """Return a program's text: UTF-8, or what its byte order mark says.

    Raises
    ------
    InputError
        No such file, a directory, not readable, or not text.
    """
    check_size(file)
    try:
        data = file.read_bytes()
    except FileNotFoundError:
        raise InputError("no such file: give the path of a part program", file) from None
    except IsADirectoryError:
        raise InputError("this is a directory: give the path of a part program", file) from None
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file) from None
    mark = next((mark for mark in _BYTE_ORDER_MARKS if data.startswith(mark)), None)
    if mark is None and b"\0" in data:
        raise InputError(f"byte {data.index(0)} is 0: this is a binary file, or a text to be saved as UTF-8", file)
    encoding = "utf-8" if mark is None else _BYTE_ORDER_MARKS[mark]
    try:
        return data.decode(encoding).removeprefix("\ufeff")
    except UnicodeDecodeError as error:
        byte = f"byte {error.start} is 0x{data[error.start]:02X}"
        raise InputError(f"{byte}: the text is not {encoding.upper()}, save it as UTF-8", file) from None


def read_blocks(text: str, file: str, ignored: Ignored) -> tuple[list[Block], list[Block], list[str]]:
    """Split a program into blocks.

    Comments, N words, lower case, blanks and empty lines leave no trace. The program ends at M2 or M30, at a
    second ``%``, or with the text. What stands behind M2 or M30 is read where the program calls subprograms.

    Parameters
    ----------
    text : str
        The program.
    file : str
        Name for error messages.
    ignored : Ignored
        Words to leave out.

    Returns
    -------
    blocks : list of Block
        Every line that holds a word.
    behind : list of Block
        Those of subprograms.
    notices : list of str
        What was left out.

    Raises
    ------
    UnknownWordsError
        Words that are not known, all of them.
    InputError
        A number beyond reason, a word twice in a block, or no block at all.
    """
    blocks: list[Block] = []
    unknown: list[tuple[str, int]] = []
    lines = re.split(r"\r\n|\r|\n", text)
    last = len(lines)
    for number, raw in enumerate(lines, 1):
        if raw.lstrip().startswith("%"):
            if blocks:
                last = number
                break
            continue
        block = _read_block(raw, number, file, ignored, unknown)
        if block is not None:
            blocks.append(block)
            if block.ends_program:
                last = number
                break
    behind: list[Block] = []
    if any(_CALL in block.codes for block in blocks):
        while last < len(lines) and not lines[last].lstrip().startswith("%"):
            block = _read_block(lines[last], last + 1, file, ignored, unknown)
            behind += [] if block is None else [block]
            last += 1
    if unknown:
        raise UnknownWordsError(unknown, file)
    if not blocks:
        raise InputError("the program is empty: no word of G-code in it", file)
    return blocks, behind, _left_out(lines, last)


def _left_out(lines: list[str], last: int) -> list[str]:
    for number, raw in enumerate(lines[last:], last + 1):
        if raw.strip(" \t%\x1a"):
            return [f"line {number}: text after the end of the program (line {last}) is left out"]
    return []


def _read_block(
    raw: str, line: int, file: str, ignored: Ignored, unknown: list[tuple[str, int]]
) -> Block | None:
    """Return what a line holds, None if nothing; unknown words are added to those of the file."""
    bare = "".join(_COMMENT.sub("", raw).split()).upper()
    deletable = bare.startswith("/")
    codes: list[tuple[str, float]] = []
    values: dict[str, float] = {}
    idle: list[str] = []
    dropped: list[str] = []
    offsets: list[tuple[str, float]] = []
    pointed, decimals = False, -1
    at = int(deletable)
    while at < len(bare) and not (codes and codes[-1] in _END_CODES):
        given = _OFFSET.match(bare, at)
        if given is not None:
            at = given.end()
            offsets.append((register(given[1], given[2]), _value(given[1], given[3], file, line)))
            pointed |= "." in given[3]
            continue
        word = _WORD.match(bare, at)
        if word is None:
            _refuse_no_word(bare[at:], raw, file, line)
            unknown.append((bare[at : at + _LONGEST_TOLD], line))
            break
        at, letter, number = word.end(), word[1], word[2]
        if ignored.has(letter, number):
            dropped.append(word[0])
        elif letter in IDLE and (letter != "O" or not values):  # X1O5 has a letter in place of a zero
            idle.append(word[0])
        elif letter in "GM" and (code := code_of(letter, number)) is not None:
            codes.append((letter, code))
        elif letter not in VALUES:
            unknown.append((word[0][:_LONGEST_TOLD], line))
        elif letter != "N":
            if letter in values:
                raise InputError(f"the word {letter} occurs twice in one block: write it once", file, line)
            values[letter] = _value(letter, number, file, line)
            if letter in "XYIJR":
                pointed |= "." in number
                decimals = max(decimals, len(number.partition(".")[2]))
    block = Block(
        line, tuple(codes), values, pointed, None if decimals < 0 else decimals, deletable, tuple(idle),
        tuple(dropped), tuple(offsets),
    )  # fmt: skip
    return block if codes or values or idle or dropped or offsets else None


def _refuse_no_word(rest: str, raw: str, file: str, line: int) -> None:
    """Refuse what cannot be a word where the cause is known; the rest of the line begins with it."""
    reason = next((reason for begin, reason in _NOT_READ.items() if rest.startswith(begin)), None)
    if rest.startswith("("):
        reason = ("a comment has a '(' in it: it ends at the first ')', so take the inner parentheses out"
                  if _NESTED.search(raw) else "a comment begins with '(' and is not closed: put a ')' on its line")
    if reason is not None:
        raise InputError(reason, file, line)


def _value(letter: str, number: str, file: str, line: int) -> float:
    value = float(number)
    if abs(value) > GREATEST_NUMBER:
        told = f"{letter}{number[:12]}{'...' if len(number) > 12 else ''}"
        raise InputError(f"the number of {told} is beyond all reason: at most {GREATEST_NUMBER:g}", file, line)
    return value
