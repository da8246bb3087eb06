"""RS-274 text split into blocks of words: which words there may be, in which unit, and subprograms taken apart.

What the words do is not known here. Some cannot change a contour, some a user leaves out. M98 P1000 L2 runs twice
what stands between O1000 and M99 behind the end of the program.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from edmsim.errors import InputError
from edmsim.program.limits import GREATEST_NUMBER, check_count, check_size
from edmsim.program.registers import register

VALUES = frozenset("NFDHXYIJRPLQ")
"""Letters whose numbers are used, by a motion or by the code they belong to."""
BELONGS: dict[float, str] = {64: "PQ", 39: "IJ", 43: "H", 44: "H", 96: "D"}
"""G codes without effect, and the letters in their block that are theirs: the tolerance of a path, the direction of a
corner, a tool's length, the greatest speed of a spindle."""
IDLE = frozenset("OTSCZ")
"""Letters that cannot change a contour in two axes: program and technology numbers, the height of the upper guide. E
is none of them: ``X1E2`` may be meant as a number."""
IDLE_CODES = frozenset(
    [("G", number) for number in (9, 15, 17, 38, 39, 43, 44, 49, 50, 59.1, 59.2, 59.3, 61.1, 64, 69, 80)]
    + [("G", number) for number in (*range(54, 62), *range(93, 100))]
    + [("M", number) for number in (*range(3, 12), 28, 40, 50, 60, *range(78, 90))]
)
"""Codes without effect on a contour in two axes: exact stop, plane XY, cancelled offsets, tapers, turns and cycles,
the work offset, the mode of the feed; spindle, water, tank, wire and generator; threading, which G0 does here."""
UNITS: dict[float, float] = {70: 20, 71: 21}
"""Codes of some controls for inch and mm, and what they are elsewhere."""
_USED_G = frozenset({0, 1, 2, 3, 4, 10, 20, 21, 40, 41, 42, 90, 91, 90.1, 91.1, 92, *UNITS})
KNOWN_G = _USED_G | {n for g, n in IDLE_CODES if g == "G"}
KNOWN_M = frozenset({0, 1, 2, 30, 98, 99}) | {n for m, n in IDLE_CODES if m == "M"}

_CODE = re.compile(r"0*\d{1,4}(\.\d)?")
_MOST_NAMED = 12
_NEEDED = frozenset({*"GNXYIJRPL", *(f"G{code:g}" for code in _USED_G - {4}), "M98", "M99"})
_ASKED = re.compile(r"([A-Z])(\d+\.?\d*)?")


@dataclass(frozen=True)
class Ignored:
    """Words that a user leaves out of a program.

    Attributes
    ----------
    letters : frozenset of str
        Left out with any number.
    words : frozenset of (str, float)
    """

    letters: frozenset[str] = frozenset()
    words: frozenset[tuple[str, float]] = frozenset()

    @classmethod
    def of(cls, asked: Sequence[str]) -> Ignored:
        """Read words as ``G51``, or letters as ``U``; raises `InputError` at others, and at what makes a contour."""
        letters, words = set(), set()
        for text in asked:
            word = _ASKED.fullmatch(text.strip().upper())
            if word is None:
                raise InputError(f"ignore has {text!r}: give letters or words as a program has them: U,M77")
            plain = word[1] if word[2] is None else f"{word[1]}{float(word[2]):g}"
            if plain in _NEEDED:
                raise InputError(f"ignore has {plain}: the contour cannot be read without it")
            if word[2] is None:
                letters.add(word[1])
            else:
                words.add((word[1], float(word[2])))
        return cls(frozenset(letters), frozenset(words))

    def has(self, letter: str, number: str) -> bool:
        """Say whether a word is left out."""
        return letter in self.letters or (letter, float(number)) in self.words


def offered_to_ignore(words: Iterable[str]) -> list[str]:
    """Return the unknown words that a user may be offered to leave out: M codes. Others may decide the contour."""
    return [word for word in words if re.fullmatch(r"M\d+", word)]


class UnknownWordsError(InputError):
    """A program has words that are not known here.

    Parameters
    ----------
    found : sequence of (str, int)
        Every one, with its line.
    file : path

    Attributes
    ----------
    words : dict of str to list of int
        Each word with its lines.
    """

    def __init__(self, found: Sequence[tuple[str, int]], file: str | Path) -> None:
        self.words: dict[str, list[int]] = {}
        for word, line in found:
            self.words.setdefault(word, []).append(line)
        named = [
            f"{word!r} (line {lines[0]}" + (f", {len(lines)} times)" if len(lines) > 1 else ")")
            for word, lines in self.words.items()
        ]
        more = f" and {len(named) - _MOST_NAMED} more" if len(named) > _MOST_NAMED else ""
        reason = f"unknown word{'s' * (len(named) > 1)} {', '.join(named[:_MOST_NAMED])}{more}: correct "
        reason += "them" if len(named) > 1 else "it"
        idle = offered_to_ignore(self.words)
        if idle:
            reason += f", or leave out what you know to be without effect: --ignore {','.join(idle[:_MOST_NAMED])}"
        super().__init__(reason, file, found[0][1])


def code_of(letter: str, number: str) -> float | None:
    """Return the number of a G or M code, as 41 or 90.1; None if no such code is known."""
    if not _CODE.fullmatch(number):
        return None
    code = float(number) if number.rstrip("0").partition(".")[2] else int(float(number))
    return code if code in (KNOWN_G if letter == "G" else KNOWN_M) else None


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


INCH_MM = 25.4
TABLE_MM = 65.0
"""Coordinates without a decimal point that span more than this many mm are whole um (row T-61)."""

LEAST_WHOLE_UM = 500
"""They must then span at least this many um (ours: nothing smaller is cut with a wire)."""

_INCH: float = 20


@dataclass(frozen=True)
class Units:
    """Units of a program.

    Attributes
    ----------
    metric_mm : float
        What G21 means, in mm: 1, or 0.001 in a program in whole um.
    stated : frozenset of float
        Which of G20 and G21 the program has.
    """

    metric_mm: float
    stated: frozenset[float]

    @property
    def only_inches(self) -> bool:
        """Whether inches are the only unit that the program states."""
        return self.stated == {_INCH}

    @property
    def at_start_mm(self) -> float:
        """The unit before any is stated, in mm: the program's only one, else millimetres."""
        return INCH_MM if self.only_inches else self.metric_mm

    def of_code_mm(self, code: float) -> float | None:
        """Return the unit in mm that a G code sets, None if it sets none."""
        by_code: dict[float, float] = {_INCH: INCH_MM, 21: self.metric_mm}
        return by_code.get(UNITS.get(code, code))


def units_of(blocks: Sequence[Block], file: str) -> tuple[Units, list[str]]:
    """Return the units of a program and notices of what was decided; raises `InputError` where nothing fits."""
    stated = {UNITS.get(number, number) for block in blocks for letter, number in block.codes if letter == "G"}
    metric_mm, notices = _metric_unit(blocks, file, _INCH in stated)
    return Units(metric_mm, frozenset(stated & {_INCH, 21})), notices


def _metric_unit(blocks: Sequence[Block], file: str, has_inches: bool) -> tuple[float, list[str]]:
    """Decide between mm and whole um: um if no coordinate has a point and the table is too small for mm."""
    extent = 0.0 if has_inches or any(block.pointed for block in blocks) else _extent(blocks)
    if extent == 0:
        return 1.0, []
    span = f"no coordinate has a decimal point and they span {extent:g}"
    if extent <= TABLE_MM:
        return 1.0, [f"{span}: they are read as mm"]
    if extent < LEAST_WHOLE_UM:
        raise InputError(f"{span}: too much in mm, too little in um; write decimal points", file)
    return 0.001, [f"{span}: they are read as whole um"]


def _extent(blocks: Sequence[Block]) -> float:
    """Return the larger span of X and Y as written, G91 summed up, arcs by their ends."""
    absolute = True
    reached: dict[str, list[float]] = {"X": [], "Y": []}
    for block in blocks:
        absolute = absolute if not {("G", 90), ("G", 91)} & set(block.codes) else ("G", 90) in block.codes
        if ("G", 4) in block.codes:
            continue
        for axis in block.values.keys() & reached.keys():
            if absolute or ("G", 92) in block.codes:
                reached[axis].append(block.values[axis])
            else:
                here = reached[axis][-1] if reached[axis] else 0.0
                reached[axis] += [here, here + block.values[axis]]
    return max(max(values) - min(values) if values else 0.0 for values in reached.values())


CALL, RETURN = ("M", 98), ("M", 99)
_DEEPEST = 10
"""Calls within calls (ours: controls allow 4 to 10)."""


def expanded(main: Sequence[Block], behind: Sequence[Block], file: str) -> tuple[list[Block], list[str]]:
    """Put subprograms in place of their calls.

    Parameters
    ----------
    main, behind : sequence of Block
        The program, and what stands behind its end.
    file : str
        Name for error messages.

    Returns
    -------
    blocks : list of Block
    notices : list of str
        Subprograms that nobody calls.

    Raises
    ------
    InputError
        A subprogram that there is not or that has no end, a call that makes no sense, calls without an end.
    """
    subprograms = _sections(behind, file)
    blocks: list[Block] = []
    called: set[int] = set()
    _run(main, subprograms, file, blocks, called, 0)
    idle = [number for number in subprograms if number not in called]
    return blocks, [f"line {subprograms[number][0].line}: nobody calls subprogram O{number}" for number in idle]


def _sections(behind: Sequence[Block], file: str) -> dict[int, list[Block]]:
    """Split what stands behind the program at its O numbers; a section ends with M99."""
    found: dict[int, list[Block]] = {}
    number: int | None = None
    for block in behind:
        names = [word for word in block.idle if word.startswith("O")]
        if number is None:
            if not names:
                raise InputError("behind the end of the program only subprograms may stand: begin them with their "
                                 "O number", file, block.line)
            number = int(float(names[0][1:]))
            if number in found:
                raise InputError(f"subprogram O{number} stands twice", file, block.line)
            found[number] = []
        elif names:
            raise InputError(f"subprogram O{number} has no M99 before {names[0]} begins", file, block.line)
        idle = tuple(word for word in block.idle if word not in names)
        found[number].append(replace(block, idle=idle, codes=tuple(code for code in block.codes if code != RETURN)))
        if RETURN in block.codes:
            number = None
    if number is not None:
        raise InputError(f"subprogram O{number} has no M99 at its end", file, found[number][0].line)
    return found


def _run(
    blocks: Sequence[Block], subprograms: dict[int, list[Block]], file: str, out: list[Block], called: set[int],
    depth: int,
) -> None:
    for block in blocks:
        if RETURN in block.codes:
            raise InputError("M99 ends a subprogram, which begins with its O number behind M2 or M30: here is none",
                             file, block.line)
        if CALL not in block.codes:
            out.append(block)
            check_count(len(out))
            continue
        number, times = _call(block, file)
        if number not in subprograms:
            there = ", ".join(f"O{known}" for known in subprograms) or "none"
            reason = f"there is no subprogram O{number} behind the end of the program; there are: {there}"
            raise InputError(reason, file, block.line)
        if depth == _DEEPEST:
            reason = f"subprogram O{number} calls itself, or calls lie over {_DEEPEST} deep"
            raise InputError(reason, file, block.line)
        called.add(number)
        rest = replace(block, codes=tuple(code for code in block.codes if code != CALL), values={})
        out.append(rest)
        for _ in range(times):
            _run(subprograms[number], subprograms, file, out, called, depth + 1)


def _call(block: Block, file: str) -> tuple[int, int]:
    """Return which subprogram is called, and how often."""
    number, times = block.values.get("P"), block.values.get("L", 1.0)
    if number is None or not block.values.keys() <= {"P", "L"} or number != int(number) or number < 0:
        raise InputError("M98 wants the number of a subprogram as P, its repetitions as L, and nothing else",
                         file, block.line)
    if times != int(times) or times < 1:
        raise InputError(f"M98 with L{times:g}: give how often, a whole number from 1", file, block.line)
    return int(number), int(times)
