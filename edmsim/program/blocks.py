"""Parser of RS-274 text: blocks of words, units, and expansion of subprograms.

The effect of words is not known here. Some words cannot change a contour, some are ignored at the user's request; a
dialect adds its own. M98 P1000 L2 runs twice the blocks between O1000 and M99 after the end of the program.
"""

import codecs
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from string import ascii_uppercase
from typing import NamedTuple, Self

from edmsim.errors import InputError, located
from edmsim.program.dialects import FREECAD, ISO, Dialect, without_line_ends
from edmsim.program.limits import GREATEST_NUMBER, check_count, read_bytes
from edmsim.program.tables import ConditionTable, register

VALUES = frozenset("NFDHXYIJRPLQ")  # letters whose numbers are used, by a motion or by the code they belong to
BELONGS: dict[float, str] = {64: "PQ", 39: "IJ", 43: "H", 44: "H", 96: "D"}
"""G codes without effect, and the letters in their block that belong to them: the tolerance of a path, the direction
of a corner, a tool's length, the greatest speed of a spindle."""
IDLE = frozenset("OTSCZ")
"""Letters that cannot change a contour in two axes: program and technology numbers, the height of the upper guide. E
is not included, because ``X1E2`` may be meant as a number."""
IDLE_CODES = frozenset(
    [("G", number) for number in (9, 15, 17, 38, 39, 43, 44, 49, 50, 59.1, 59.2, 59.3, 61.1, 64, 69, 80)]
    + [("G", number) for number in (*range(54, 62), *range(93, 100))]
    + [("M", number) for number in (*range(3, 12), 28, 40, 50, 60, *range(78, 90))]
)
"""Codes without effect on a contour in two axes: exact stop, plane XY, cancelled offsets, tapers, turns and cycles,
the work offset, the mode of the feed; spindle, water, tank, wire and generator; threading, which G0 does here."""
UNITS: dict[float, float] = {70: 20, 71: 21}  # codes of some controls for inch and mm, and the usual codes
_USED_G = frozenset({0, 1, 2, 3, 4, 10, 20, 21, 40, 41, 42, 90, 91, 90.1, 91.1, 92, *UNITS})
KNOWN = {
    "G": _USED_G | {n for letter, n in IDLE_CODES if letter == "G"},
    "M": frozenset({0, 1, 2, 30, 98, 99}) | {n for letter, n in IDLE_CODES if letter == "M"},
}  # codes that are read, by letter
_CODE = re.compile(r"0*\d{1,4}(\.\d)?")
_MOST_NAMED = 12
_NEEDED = frozenset({*"GNXYIJRPL", *(f"G{code:g}" for code in _USED_G - {4}), "M98", "M99"})
_IGNORED_WORD = re.compile(r"(Q[A-Z]{2,}|[A-Z])(\d+\.?\d*)?")


@dataclass(frozen=True)
class Ignored:
    """Words that are ignored at the user's request."""

    letters: frozenset[str] = frozenset()  # ignored with any number; names such as QAIC with any arguments
    words: frozenset[tuple[str, float]] = frozenset()

    @classmethod
    def of(cls, listed: Sequence[str]) -> Self:
        """Parse words like ``G51`` or letters like ``U``; raises `InputError` for others and words of contours."""
        letters, words = set(), set()
        for text in listed:
            word = _IGNORED_WORD.fullmatch(text.strip().upper())
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
        """Return whether a word is ignored."""
        return letter in self.letters or (letter, float(number)) in self.words


def offered_to_ignore(words: Iterable[str]) -> list[str]:
    """Return the unknown words that a message may offer to ignore: M codes, because others may change the contour."""
    return [word for word in words if re.fullmatch(r"M\d+", word)]


class UnknownWordsError(InputError):
    """A program has unknown words: `words` has each with its lines, `hint` names the dialects that know them."""

    def __init__(self, found: Sequence[tuple[str, int]], hint: str = "") -> None:
        self.words: dict[str, list[int]] = {}
        self.hint = hint
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
        super().__init__(reason + hint, line=found[0][1])


def code_of(letter: str, number: str, dialect: Dialect = ISO) -> float | None:
    """Return the number of a code, such as 41 of G41 or 90.1; None if no such code is known."""
    if not _CODE.fullmatch(number):
        return None
    code = float(number) if number.rstrip("0").partition(".")[2] else int(float(number))
    known = code in KNOWN.get(letter, ()) or (letter, code) in dialect.codes
    return code if known else None


_BYTE_ORDER_MARKS = {  # UTF-32 before UTF-16, with which its mark begins
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
"""Messages about text that cannot be a word, by its first characters."""
_WORD = re.compile(r"([A-Z])([+-]?(?:\d+\.?\d*|\.\d+))")
_DELETE = re.compile(r"(N\d+)?/\d*")
"""Block delete, optionally with the number of its switch; first in a line in RS-274, after N on some controls."""
_COMMENT = re.compile(r"\([^()]*\)|;.*")
_TERM = r"(?:(?:\d+\.?\d*|\.\d+)|[DH]\d{1,4})"
_OFFSET = re.compile(rf"([DH])(\d{{1,4}})=([+-]?{_TERM}(?:[+-]{_TERM})*)")
_ADDED = re.compile(rf"([+-]?)({_TERM})")
_PLANE = re.compile(r"(T[PN])=?([+-]?(?:\d+\.?\d*|\.\d+))")
_BEGINS_BLOCK = re.compile(r"[/:]|(?:T[PN]|[A-Z])=?[-+]?\.?\d")
_MOVES = re.compile(r"(?:[GXYIJR][-+]?[\d.]+)+")
_CALL_BY_NAME = re.compile(r"\b(Q[A-Z]{2,})\s*\([^()]*\)", re.IGNORECASE)
_NAME = re.compile(r"(Q[A-Z]{2,})\$")
"""A call of a control's own routine, ``QAIC(2,1,0015)``, and how it is written without its arguments."""
_PROGRAM_NUMBER = re.compile(r"^\s*:(\d+)\s*$")
_CONDITION = {"C": r"\d{1,4}", "E": r"\d{3,4}", "S": r"\d{1,4}"}
"""Numbers of conditions by letter. E has three digits or four, because ``X1E2`` may be meant as a number."""
_ABOVE = frozenset("XYIJ")
_LONGEST_QUOTE = 12
_NESTED = re.compile(r"\([^)]*\(")
CALL, RETURN = ("M", 98), ("M", 99)
_END_CODES = frozenset({("M", 2), ("M", 30)})


class OffsetValue(NamedTuple):
    """Definition of an offset register: a number as written, and registers added to it or subtracted."""

    register: str
    number: float
    added: tuple[tuple[int, str], ...] = ()


@dataclass(frozen=True)
class UpperWords:
    """The move of the second plane, after a colon; its code is None if it is that of the first plane."""

    code: float | None
    values: dict[str, float]


@dataclass
class Block:
    """One block of a program, usually a line; words are added one by one."""

    line: int  # line in the file, counted from 1
    deletable: bool  # whether the line begins with ``/``, block delete
    codes: list[tuple[str, float]] = field(default_factory=list)  # G and M codes in the order they are written
    values: dict[str, float] = field(default_factory=dict)  # all other words but N, as written
    pointed: bool = False  # whether any coordinate (X Y I J R) or offset has a decimal point
    decimals: int | None = None  # most decimal places of a coordinate; None if there is no coordinate
    idle: list[str] = field(default_factory=list)  # words that cannot change a contour, as written
    ignored: list[str] = field(default_factory=list)  # words ignored at the user's request
    offsets: list[OffsetValue] = field(default_factory=list)  # registers that it defines, ``D1=0.155``
    condition: str | None = None  # the machining condition that it calls, as written
    upper: UpperWords | None = None  # the move of the second plane
    label: int | None = None  # its N number, if a subprogram may begin there

    @property
    def ends_program(self) -> bool:
        """Whether the block has M2 or M30."""
        return not _END_CODES.isdisjoint(self.codes)

    def add(self, letter: str, number: str) -> None:
        """Add a word, and record how finely a coordinate is written."""
        if letter in self.values:
            raise InputError(f"the word {letter} occurs twice in one block: write it once")
        self.values[letter] = _value(letter, number)
        self.measure(letter, number)

    def measure(self, letter: str, number: str) -> None:
        """Record whether a coordinate has a decimal point, and its decimal places."""
        if letter in "XYIJRUV":
            self.pointed |= "." in number
            self.decimals = max(self.decimals or 0, len(number.partition(".")[2]))


def read_text(file: Path) -> str:
    """Return a program's text, in UTF-8 or the encoding of its byte order mark."""
    data = read_bytes(file, "a part program")
    mark = next((mark for mark in _BYTE_ORDER_MARKS if data.startswith(mark)), None)
    if mark is None and b"\0" in data:
        raise InputError(f"byte {data.index(0)} is 0: this is a binary file, or a text to be saved as UTF-8", file)
    encoding = "utf-8" if mark is None else _BYTE_ORDER_MARKS[mark]
    try:
        return data.decode(encoding).removeprefix("\ufeff")
    except UnicodeDecodeError as error:
        byte = f"byte {error.start} is 0x{data[error.start]:02X}"
        raise InputError(f"{byte}: the text is not {encoding.upper()}, save it as UTF-8", file) from None


class ProgramBlocks(NamedTuple):
    """A program split into blocks."""

    # main, behind: every block that has a word; those of subprograms, after the end of the program
    main: list[Block]
    behind: list[Block]
    notices: list[str]  # about omitted text
    conditions: dict[str, dict[str, float]]  # its tables of machining conditions, by condition and column


@dataclass
class _Reader:
    """Settings for reading blocks, and all unknown words found."""

    ignored: Ignored
    dialect: Dialect
    table: ConditionTable
    unknown: list[tuple[str, int]] = field(default_factory=list)
    notices: list[str] = field(default_factory=list)

    def blocks_of(self, raw: str, line: int, labelled: bool = False) -> list[Block]:
        """Return the blocks of a line: one, none, or more if ``;`` ends blocks."""
        if self.table.read_line(raw):
            return []
        raw = _CALL_BY_NAME.sub(r"\1$", raw)
        parts = [_PROGRAM_NUMBER.sub(r"O\1", raw)]  # as on punched tape
        first, *others = re.sub(r"\([^()]*\)", "", raw).upper().split(";")
        if self.dialect.ends_blocks:
            # text that begins as a block is one, because a typing error must not make it a comment
            parts = [first, *(part for part in others if _BEGINS_BLOCK.match("".join(part.split())))]
        elif first.strip():
            self.notices += [
                f"line {line}: {part.strip()} after ';' is a comment; --dialect sodick reads it as a block"
                for part in others if _MOVES.fullmatch("".join(part.split()))
            ]  # fmt: skip
        found = [_read_block(part, line, self, labelled) for part in parts]
        return [block for block in found if block is not None]

    def take_routine(self, name: str, block: Block) -> None:
        """Record a call of a control's own routine as ignored, idle or unknown."""
        if name in self.ignored.letters:
            block.ignored.append(name)
        elif name in self.dialect.routines:
            block.idle.append(name)
        else:
            self.unknown.append((name, block.line))


def read_blocks(text: str, ignored: Ignored, dialect: Dialect = ISO) -> ProgramBlocks:
    """Split a program into blocks, without comments, N words, blanks and empty lines."""
    # the program ends at M2 or M30, at a second %, or with the text; blocks after M2 or M30 are read if the
    # program calls subprograms
    blocks: list[Block] = []
    behind: list[Block] = []
    reader = _Reader(ignored, dialect, ConditionTable(dialect))
    lines = without_line_ends(re.split(r"\r\n|\r|\n", text))
    last = len(lines)
    for number, raw in enumerate(lines, 1):
        if raw.lstrip().startswith("%"):
            if blocks:
                last = number
                break
            continue
        with located(line=number):
            found = reader.blocks_of(raw, number)
        end = next((count for count, block in enumerate(found, 1) if block.ends_program), None)
        blocks += found[:end]
        if end is not None:
            last, behind = number, found[end:]
            break
    else:
        if text.lstrip().startswith("%"):
            reader.notices.append(f"line {last}: neither M2, M30 nor a second % ends the program: is it complete?")
    calls = any(CALL in block.codes for block in blocks)
    left_out = [] if calls else [block.line for block in behind]
    while calls and last < len(lines) and not lines[last].lstrip().startswith("%"):
        last += 1
        with located(line=last):
            behind += reader.blocks_of(lines[last - 1], last, labelled=dialect.numbered)
    if reader.unknown:
        raise UnknownWordsError(reader.unknown)
    if not blocks:
        raise InputError("the program is empty: no word of G-code in it")
    left_out += [number + 1 for number in range(last, len(lines)) if lines[number].strip(" \t%\x1a")]
    if left_out:
        reader.notices.append(f"line {left_out[0]}: text after the end of the program (line {last}) is left out")
    return ProgramBlocks(blocks, behind if calls else [], reader.notices, reader.table.values)


def _read_block(raw: str, line: int, reader: _Reader, labelled: bool) -> Block | None:
    """Return the block of a line, or None if it is empty; unknown words are added to the reader's."""
    dialect = reader.dialect
    bare = "".join(_COMMENT.sub("", raw).split()).upper()
    above: str | None = None
    if dialect.upper == "colon" and ":" in bare:
        bare, _, above = bare.partition(":")
    delete = _DELETE.match(bare)
    if delete is not None:
        bare = (delete[1] or "") + bare[delete.end() :]
    block = Block(line, delete is not None)
    at, ended = 0, False
    while at < len(bare) and not ended:
        found = _OFFSET.match(bare, at)
        plane = _PLANE.match(bare, at) if dialect.planes else None
        if found is not None:
            at = found.end()
            block.offsets.append(_offset_value(found))
            block.pointed |= "." in found[3]
            continue
        if plane is not None:
            at = plane.end()
            block.add(plane[1], plane[2])
            continue
        name = _NAME.match(bare, at)
        if name is not None:
            at = name.end()
            reader.take_routine(name[1], block)
            continue
        word = _WORD.match(bare, at)
        if word is None:
            _refuse_no_word(bare[at:], raw)
            reader.unknown.append((bare[at : at + _LONGEST_QUOTE], line))
            break
        at, letter, number = word.end(), word[1], word[2]
        if reader.ignored.has(letter, number):
            block.ignored.append(word[0])
        elif letter == dialect.condition and re.fullmatch(_CONDITION[letter], number):
            if block.condition is not None:
                raise InputError(f"{block.condition} and {word[0]} are both conditions: call one in a block")
            block.condition = word[0]
        elif letter in "GMT" and (code := code_of(letter, number, dialect)) is not None:
            # other codes that end a program are read as M2
            block.codes.append(("M", 2) if dialect.codes.get((letter, code)) == "end" else (letter, code))
            ended = block.codes[-1] in _END_CODES
        elif letter in IDLE and letter not in dialect.letters and (letter != "O" or not block.values):
            block.idle.append(word[0])  # X1O5 has a letter in place of a zero, so its O is unknown
        elif letter not in VALUES and letter not in dialect.letters:
            reader.unknown.append((word[0][:_LONGEST_QUOTE], line))
        elif letter == "N":
            block.label = int(number) if labelled and number.isdigit() else None
        else:
            block.add(letter, number)
    if above is not None:
        block.upper = _upper_words(above, reader, block)
    return None if block == Block(line, block.deletable) else block


def _offset_value(found: re.Match[str]) -> OffsetValue:
    """Return the definition of H1 in ``H1=.0085+H175``."""
    number, added = 0.0, []
    for sign, term in _ADDED.findall(found[3]):
        factor = -1 if sign == "-" else 1
        if term[0] in "DH":
            added.append((factor, register(term[0], term[1:])))
        else:
            number += factor * _value(found[1], term)
    return OffsetValue(register(found[1], found[2]), number, tuple(added))


def _upper_words(above: str, reader: _Reader, block: Block) -> UpperWords:
    """Parse the move after a colon: X Y I J and G1, G2 or G3."""
    code: float | None = None
    values: dict[str, float] = {}
    at = 0
    while at < len(above):
        word = _WORD.match(above, at)
        if word is None:
            reader.unknown.append((above[at : at + _LONGEST_QUOTE], block.line))
            break
        at, letter, number = word.end(), word[1], word[2]
        if letter in values:
            raise InputError(f"the word {letter} occurs twice after the colon: write it once")
        if letter in _ABOVE:
            values[letter] = _value(letter, number)
            block.measure(letter, number)
        elif (code_here := code_of(letter, number)) in (1, 2, 3):
            code = code_here
        else:
            reader.unknown.append((word[0], block.line))
    return UpperWords(code, values)


def _refuse_no_word(rest: str, raw: str) -> None:
    """Refuse text that cannot be a word if the cause is known; `rest` begins with it, or with its letter."""
    number = rest[1:] if rest[0] in ascii_uppercase + "=" else rest
    reason = next((reason for begin, reason in _NOT_READ.items() if number.startswith(begin)), None)
    if rest.startswith("("):
        reason = ("a comment has a '(' in it: it ends at the first ')', so take the inner parentheses out"
                  if _NESTED.search(raw) else "a comment begins with '(' and is not closed: put a ')' on its line")
    if reason is not None:
        raise InputError(reason)


def _value(letter: str, number: str) -> float:
    value = float(number)
    if abs(value) > GREATEST_NUMBER:
        quoted = f"{letter}{number[:12]}{'...' if len(number) > 12 else ''}"
        raise InputError(f"the number of {quoted} is too large: at most {GREATEST_NUMBER:g}")
    return value


INCH_MM = 25.4
TABLE_MM = 65.0  # coordinates without a decimal point that span more than this many mm are whole um (row T-61)
LEAST_WHOLE_UM = 500  # they must then span at least this many um (ours: nothing smaller is cut with a wire)
_INCH: float = 20


@dataclass(frozen=True)
class Units:
    """Units of a program."""

    metric_mm: float  # what G21 means, in mm: 1, or 0.001 in a program in whole um
    stated: frozenset[float]  # which of G20 and G21 the program has
    inch_mm: float = INCH_MM  # what G20 means, in mm: 25.4, or 0.0254 in a program in thousandths
    scaled: bool = False  # whether coordinates are in thousandths of the unit of feeds

    @property
    def only_inches(self) -> bool:
        """Whether inches are the only unit that the program states."""
        return self.stated == {_INCH}

    @property
    def at_start_mm(self) -> float:
        """Unit in mm before any is stated: the program's only one, otherwise the metric one."""
        return self.inch_mm if self.only_inches else self.metric_mm

    def of_code_mm(self, code: float) -> float | None:
        """Return the unit in mm that a G code sets, None if it sets none."""
        by_code: dict[float, float] = {_INCH: self.inch_mm, 21: self.metric_mm}
        return by_code.get(UNITS.get(code, code))


def units_of(blocks: Sequence[Block], dialect: Dialect = ISO, inches: bool = False) -> tuple[Units, list[str]]:
    """Return the units of a program and notices of what was decided; `inches`: use inches if it states none."""
    codes = {UNITS.get(number, number) for block in blocks for letter, number in block.codes if letter == "G"}
    stated = codes & {_INCH, 21} or ({_INCH} if inches else set())
    if dialect is FREECAD:
        scale, notices = _scale(blocks, INCH_MM if _INCH in stated else 1.0)
        return Units(scale, frozenset(stated), INCH_MM * scale, scaled=scale != 1), notices
    metric_mm, notices = _metric_unit(blocks, _INCH in stated)
    return Units(metric_mm, frozenset(stated)), notices


def _scale(blocks: Sequence[Block], unit_mm: float) -> tuple[float, list[str]]:
    """Decide whether coordinates are in the unit or in thousandths of it, by the size of the table."""
    extent = _extent(blocks)
    span, unit = f"the coordinates span {extent:g}", "mm" if unit_mm == 1 else "inch"
    if extent * unit_mm <= TABLE_MM:
        return 1.0, []
    if extent * unit_mm < LEAST_WHOLE_UM:
        raise InputError(f"{span}: too much in {unit}, too little in thousandths of it; write another scale")
    return 0.001, [f"{span}: they are read in thousandths of {'a mm' if unit == 'mm' else 'an inch'}"]


def _metric_unit(blocks: Sequence[Block], has_inches: bool) -> tuple[float, list[str]]:
    """Decide between mm and whole um: um if no coordinate has a point and the table is too small for mm."""
    extent = 0.0 if has_inches else _extent(blocks)
    pointed = [block for block in blocks if block.pointed and ("G", 4) not in block.codes]  # a dwell's X is a time
    if extent == 0 or pointed:
        return 1.0, _mixed_notices(blocks, pointed, extent)
    span = f"no coordinate has a decimal point and they span {extent:g}"
    if extent <= TABLE_MM:
        return 1.0, [f"{span}: they are read as mm"]
    if extent < LEAST_WHOLE_UM:
        raise InputError(f"{span}: too much in mm, too little in um; write decimal points")
    return 0.001, [f"{span}: they are read as whole um"]


def _mixed_notices(blocks: Sequence[Block], pointed: Sequence[Block], extent: float) -> list[str]:
    """Return notices that all numbers are mm, if some have no decimal point and may be meant in um."""
    whole = [block for block in blocks if block.decimals == 0 and not block.pointed and ("G", 4) not in block.codes
             and any(block.values.get(axis) for axis in "XYIJR")]  # fmt: skip
    if not whole or extent <= TABLE_MM:
        return []
    line = pointed[0].line
    mixed = f"this block has a decimal point, line {whole[0].line} none, and the coordinates span {extent:g}"
    if extent >= LEAST_WHOLE_UM:
        raise InputError(f"{mixed}: too much in mm; write all with decimal points, or all in whole um", line=line)
    return [f"line {line}: {mixed}: all are read as mm"]


def _extent(blocks: Sequence[Block]) -> float:
    """Return the larger of the spans of X and Y as written, with G91 moves added up and arcs by their ends."""
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


_DEEPEST = 10  # calls within calls (ours: controls allow 4 to 10)


def expanded(main: Sequence[Block], behind: Sequence[Block]) -> tuple[list[Block], list[str]]:
    """Replace calls by their subprograms, which follow the program's end; notices name unused subprograms."""
    subprograms = _sections(behind)
    blocks: list[Block] = []
    called: set[int] = set()
    _run(main, subprograms, blocks, called, 0)
    idle = [number for number in subprograms if number not in called]
    return blocks, [f"line {subprograms[number][0].line}: subprogram O{number} is never called" for number in idle]


def _sections(behind: Sequence[Block]) -> dict[int, list[Block]]:
    """Split the blocks after the program at their O numbers (or N numbers); a section ends with M99."""
    found: dict[int, list[Block]] = {}
    number: int | None = None
    for block in behind:
        names = [word for word in block.idle if word.startswith("O")]
        if number is None:
            if block.ends_program:
                continue
            if not names and block.label is not None:
                names = [f"N{block.label}"]
            if not names:
                raise InputError("only subprograms may follow the end of the program: begin them with their O number",
                                 line=block.line)
            number = int(float(names[0][1:]))
            if number in found:
                raise InputError(f"subprogram {names[0][0]}{number} occurs twice", line=block.line)
            found[number] = []
        elif names:
            raise InputError(f"subprogram O{number} has no M99 before {names[0]} begins", line=block.line)
        idle = [word for word in block.idle if word not in names]
        found[number].append(replace(block, idle=idle, codes=[code for code in block.codes if code != RETURN]))
        if RETURN in block.codes:
            number = None
    if number is not None:
        raise InputError(f"subprogram O{number} has no M99 at its end", line=found[number][0].line)
    return found


def _run(
    blocks: Sequence[Block], subprograms: dict[int, list[Block]], out: list[Block], called: set[int], depth: int
) -> None:
    for block in blocks:
        if RETURN in block.codes:
            raise InputError("M99 ends a subprogram, which begins with its O number after M2 or M30",
                             line=block.line)
        if CALL not in block.codes:
            out.append(block)
            check_count(len(out))
            continue
        number, times = _call(block)
        if number not in subprograms:
            there = ", ".join(f"O{known}" for known in subprograms) or "none"
            reason = f"there is no subprogram O{number} after the end of the program; there are: {there}"
            raise InputError(reason, line=block.line)
        if depth == _DEEPEST:
            raise InputError(f"subprogram O{number} calls itself, or calls lie over {_DEEPEST} deep", line=block.line)
        called.add(number)
        values = {letter: value for letter, value in block.values.items() if letter in "DH"}
        out.append(replace(block, codes=[code for code in block.codes if code != CALL], values=values))
        for _ in range(times):
            _run(subprograms[number], subprograms, out, called, depth + 1)


def _call(block: Block) -> tuple[int, int]:
    """Return the number of the called subprogram, and its repetitions."""
    number, times = block.values.get("P"), block.values.get("L", 1.0)
    if number is None or not block.values.keys() <= {"P", "L", "D", "H"} or number != int(number) or number < 0:
        raise InputError("M98 needs the number of a subprogram as P, its repetitions as L, and nothing else",
                         line=block.line)
    if times != int(times) or times < 1:
        raise InputError(f"M98 with L{times:g}: give the repetitions, a whole number from 1", line=block.line)
    return int(number), int(times)
