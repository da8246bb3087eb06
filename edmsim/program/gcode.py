"""G-code (RS-274 and the Robofil dialect) read into outlines.

The words understood are G0 to G4, G10, G20, G21, G40 to G42, G90 to G92, M0, M1, M2, M30, F, D, H, N, X, Y, I, J, R
and P. Those that cannot change a contour in two axes (`edmsim.program.words`) are read with a notice. Dwells
(G4 with P or X) are in seconds. A ``/``
at the head of a line does not delete it. A G92 before any move says where the wire stands; later ones shift
the coordinates.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.program.arcs import centre_from_radius
from edmsim.program.blocks import Block, read_blocks, read_text
from edmsim.program.centres import Arc, CuttingMotion, prefer_absolute
from edmsim.program.limits import LONGEST_DWELL_S, check_contours, check_count, check_points
from edmsim.program.outline import CutMove, Outline, Program, Run, Side, outline_of
from edmsim.program.registers import OffsetRegisters, register
from edmsim.program.subprograms import expanded
from edmsim.program.words import IDLE_CODES, UNITS, Ignored

TABLE_MM = 65.0
"""Coordinates without a decimal point that span more than this many mm are whole um (row T-61)."""

LEAST_WHOLE_UM = 500
"""They must then span at least this many um (ours: nothing smaller is cut with a wire)."""

_INCHES = frozenset({("G", 20), ("G", 70)})
_UNIT_NAMES = {70: "inch", 71: "mm"}
_STOPS = frozenset({("M", 0), ("M", 1)})
_GROUPS = (
    ({0, 1, 2, 3}, "G0 G1 G2 G3"), ({20, 21, *UNITS}, "G20 G21 G70 G71"), ({40, 41, 42}, "G40 G41 G42"),
    ({90, 91}, "G90 G91"), ({4, 10, 92}, "G4 G10 G92"),
)
_WORK_OFFSETS = frozenset(range(54, 60))
_SAID_OTHERWISE = frozenset({("G", 17), ("M", 50), ("M", 60), *(("G", code) for code in _WORK_OFFSETS)})
_SIDES: dict[int, Side | None] = {40: None, 41: "left", 42: "right"}
_BESIDE = frozenset("FDH")
_G10_REGISTERS = {None: "DH", 10.0: "H", 12.0: "D"}
_INCH_MM = 25.4
_FEED_UNITS = {1.0: "mm/min", 0.001: "um/min", _INCH_MM: "in/min"}


class _Notices:
    """Notices gathered by kind, each with the first line it is about."""

    def __init__(self) -> None:
        self._lines: dict[str, list[int]] = {}

    def add(self, what: str, line: int) -> None:
        self._lines.setdefault(what, []).append(line)

    def texts(self) -> list[str]:
        return [f"line {lines[0]}: {what}" + (f" ({len(lines)} times)" if len(lines) > 1 else "")
                for what, lines in self._lines.items()]


class _Interpreter:
    """The modal state of a control, and the runs it leaves behind."""

    def __init__(self, metric_mm: float, file: str, offsets: Mapping[str, float]) -> None:
        self.file = file
        self.registers = OffsetRegisters(offsets, file)
        self.metric_mm = metric_mm
        self.unit_mm = metric_mm
        self.absolute = True
        self.side: Side | None = None
        self.motion: int | None = None
        self.position = 0j
        self.shift = 0j
        self.moved = False
        self.start_known = False
        self.work_offset: int | None = None
        self.cut_off: int | None = None
        self.feed_per_minute = True
        self.notices = _Notices()
        self.runs: list[tuple[Side | None, list[CuttingMotion], list[tuple[int, float]]]] = []
        self._open_run()

    def error(self, reason: str, block: Block) -> InputError:
        return InputError(reason, self.file, block.line)

    def _open_run(self) -> None:
        self.runs.append((self.side, [], []))

    def run_block(self, block: Block) -> None:
        if block.deletable:
            self.notices.add("'/' (block delete) is switched off: the block is carried out", block.line)
        g_codes = self._checked_codes(block)
        for code in g_codes:
            if code in UNITS:
                self.notices.add(f"G{code} is read as G{UNITS[code]} ({_UNIT_NAMES[code]})", block.line)
            self._set_mode(UNITS.get(code, code))
        self._note_words(block)
        if 4 in g_codes:
            self._dwell(block)
        elif 10 in g_codes:
            self._set_register(block)
        elif 92 in g_codes:
            self._set_position(block)
        else:
            self._move(block)

    def _checked_codes(self, block: Block) -> set[int]:
        for letter, number in block.codes:
            if (letter, number) in IDLE_CODES - _SAID_OTHERWISE:
                self.notices.add(f"{letter}{number} has no effect on the contour", block.line)
            elif (letter, number) in _STOPS:
                self.notices.add(f"M{number} (stop) is not waited for", block.line)
        self._thread(block)
        codes = {number for letter, number in block.codes if letter == "G"}
        for group, names in _GROUPS:
            if len(codes & group) > 1:
                raise self.error(f"two of {names} stand in one block: they exclude each other", block)
        for code in codes & _WORK_OFFSETS:
            self._take_work_offset(code, block)
        return codes

    def _thread(self, block: Block) -> None:
        """Note M50 and M60: a wire that is cut off cuts nothing until it is threaded."""
        for code in (number for letter, number in block.codes if letter == "M" and number in (50, 60)):
            done = "cuts the wire off" if code == 50 else "threads the wire"
            self.notices.add(f"M{code} ({done}) is not waited for: G0 does both", block.line)
            self.cut_off = block.line if code == 50 else None

    def _take_work_offset(self, code: int, block: Block) -> None:
        if self.work_offset not in (None, code):
            told = f"G{self.work_offset} and G{code}"
            raise self.error(f"work offsets {told}: how far they are apart is not in the program, use one", block)
        self.work_offset = code
        self.notices.add(f"the zero of G{code} is taken as the program's zero", block.line)

    def _set_mode(self, code: int) -> None:
        if code in (0, 1, 2, 3):
            self.motion = code
        elif code in (20, 21):
            self.unit_mm = _INCH_MM if code == 20 else self.metric_mm
        elif code in _SIDES:
            self.side = _SIDES[code]
        elif code in (90, 91):
            self.absolute = code == 90
        elif code in (93, 94, 95):
            self.feed_per_minute = code == 94

    def _note_words(self, block: Block) -> None:
        for word in block.ignored:
            self.notices.add(f"{word} is left out, as asked", block.line)
        for word in block.idle:
            self.notices.add(f"the word {word[0]} has no effect on the contour", block.line)
        if "F" in block.values:
            unit = f" {_FEED_UNITS[self.unit_mm]}" if self.feed_per_minute else ""
            feed = f"feed F{block.values['F']:g}{unit}"
            self.notices.add(f"{feed} is not used: the gap controller sets the speed", block.line)
        for name, value in block.offsets:
            self.registers.define(name, value * self.unit_mm, block.line)
        called = [register(letter, block.values[letter]) for letter in "DH" if letter in block.values]
        for told in self.registers.call(called, block.line):
            self.notices.add(told, block.line)

    def _dwell(self, block: Block) -> None:
        times = [block.values[letter] for letter in "PX" if letter in block.values]
        if len(times) != 1 or times[0] < 0 or not block.values.keys() <= {"P", "X", *_BESIDE}:
            raise self.error("G4 wants its time in seconds, 0 or more, as P or X and nothing else", block)
        if times[0] > LONGEST_DWELL_S:
            raise self.error(f"a dwell of {times[0]:g} s is beyond all reason: at most {LONGEST_DWELL_S:g} s", block)
        _, motions, dwells = self.runs[-1]
        dwells.append((len(motions), times[0]))

    def _set_register(self, block: Block) -> None:
        """Take over what G10 L12 P1 R0.155 says of D1, with L10 of H1, without L of both."""
        values = block.values
        letters = _G10_REGISTERS.get(values.get("L"))
        if letters is None:
            asked = f"G10 L{values['L']:g}"
            raise self.error(f"{asked} is not read: set offsets with L10 (H), L12 (D) or without L", block)
        if not {"P", "R"} <= values.keys() <= {"L", "P", "R", *_BESIDE} or not values["P"].is_integer():
            raise self.error("G10 wants the register's number as P and its offset as R: G10 L12 P1 R0.155", block)
        for letter in letters:
            self.registers.define(register(letter, values["P"]), values["R"] * self.unit_mm, block.line)

    def _set_position(self, block: Block) -> None:
        if not block.values.keys() <= {"X", "Y", *_BESIDE}:
            raise self.error("G92 takes X and Y only", block)
        bare = not block.values.keys() & {"X", "Y"}
        programmed = 0j if bare else self._target(block.values, self.position - self.shift, absolute=True)
        if self.moved:
            self.shift = self.position - programmed
            if bare:
                self.notices.add("G92 without words: the present position becomes X0 Y0", block.line)
        else:
            self.position = programmed
            self.start_known = True

    def _target(self, values: dict[str, float], here: complex, absolute: bool) -> complex:
        x, y = (values[axis] * self.unit_mm if axis in values else None for axis in "XY")
        base = here if not absolute else 0j
        return complex(here.real if x is None else base.real + x, here.imag if y is None else base.imag + y)

    def _move(self, block: Block) -> None:
        axes = block.values.keys() & set("XYIJR")
        self._refuse_stray_words(block)
        if not axes:
            return
        if self.motion is None:
            raise self.error("coordinates come before any of G0 G1 G2 G3: say how to move", block)
        end = self._target(block.values, self.position - self.shift, self.absolute) + self.shift
        if self.motion == 0:
            self._rapid(end)
        elif end != self.position or self.motion != 1:
            self._cut(block, end)
        self.position = end
        self.moved = True

    def _refuse_stray_words(self, block: Block) -> None:
        words = block.values.keys()
        if "P" in words:
            raise self.error("P is given without G4: only a dwell takes it", block)
        if "L" in words:
            raise self.error("L is given without M98: only the call of a subprogram takes it", block)
        if self.motion not in (2, 3) and words & {"I", "J", "R"}:
            raise self.error("I, J or R is given without G2 or G3: only an arc takes them", block)

    def _rapid(self, end: complex) -> None:
        self.start_known = True
        self.cut_off = None
        if not self.runs[-1][1]:
            self.runs.pop()
            self._open_run()
        elif end != self.position:
            self._open_run()

    def _cut(self, block: Block, end: complex) -> None:
        if self.cut_off is not None:
            reason = f"the wire is cut off since M50 on line {self.cut_off}: go on with G0, or thread it with M60"
            raise self.error(reason, block)
        if not self.start_known:
            self.notices.add("neither G92 nor G0 before the first cut: the wire starts at X0 Y0", block.line)
            self.start_known = True
        arc = self._arc(block, end) if self.motion in (2, 3) else None
        offset = None if self.side is None else self.registers.in_force
        self.runs[-1][1].append(CuttingMotion(self.position, end, self.side, block.line, arc, offset))

    def _arc(self, block: Block, end: complex) -> Arc:
        turn = -1 if self.motion == 2 else 1
        values, start = block.values, self.position
        if ("R" in values) == bool(values.keys() & {"I", "J"}):
            raise self.error("an arc wants its centre as I and J, or its radius as R: give one", block)
        if "R" in values:
            centre = centre_from_radius(start, end, values["R"] * self.unit_mm, turn)
            if centre is None:
                distance = abs(end - start)
                told = f"no arc of radius R{values['R']:g} joins ends {distance:.4f} mm apart"
                raise self.error(f"{told}: give I and J, or an R that does", block)
            return Arc(turn, centre, None)
        centre = complex(values.get("I", 0.0), values.get("J", 0.0)) * self.unit_mm
        return Arc(turn, start + centre, centre + self.shift if {"I", "J"} <= values.keys() else None)


def read_gcode(
    file: str | Path, ignore: Sequence[str] = (), offsets: Mapping[str, float] | None = None
) -> Program:
    """Read a G-code program.

    Parameters
    ----------
    file : path
        The program, UTF-8 text.
    ignore : sequence of str
        Words to leave out, as ``M77``, or letters, as ``U``.
    offsets : mapping of str to float, optional
        Offsets in mm by register, ``{"D1": 0.155}``; what the program says of one comes before it.

    Returns
    -------
    Program
        An outline per run between rapids, in mm. Its notices say whatever had to be decided: coordinates in
        whole um, absolute arc centres, words without effect, a lead-out left out.

    Raises
    ------
    UnknownWordsError
        All words of the file that are not known.
    InputError
        With file and line: an arc that fits neither way, a contour that makes no sense.
    """
    path = Path(file)
    blocks, behind, notices = read_blocks(read_text(path), str(path), Ignored.of(ignore))
    blocks, told = expanded(blocks, behind, str(path))
    notices += told
    metric_mm, unit_notices = _metric_unit(blocks, str(path))
    control = _Interpreter(metric_mm, str(path), offsets or {})
    for block in blocks:
        control.run_block(block)
    try:
        outlines = _outlines(control, notices)
    except InputError as error:
        raise InputError(error.reason, path, error.line) from None
    notices = sorted([*unit_notices, *control.notices.texts(), *notices], key=_line_of)
    return Program(tuple(outlines), tuple(notices), str(path))


def _line_of(notice: str) -> int:
    """Return the line that a notice is about; 0 if it is about the whole program."""
    found = re.match(r"line (\d+):", notice)
    return int(found[1]) if found else 0


def _metric_unit(blocks: list[Block], file: str) -> tuple[float, list[str]]:
    """Decide between mm and whole um: um if no coordinate has a point and the table is too small for mm."""
    pointed = any(block.pointed for block in blocks) or any(
        not _INCHES.isdisjoint(block.codes) for block in blocks
    )
    extent = 0.0 if pointed else _extent(blocks)
    if extent == 0:
        return 1.0, []
    span = f"no coordinate has a decimal point and they span {extent:g}"
    if extent <= TABLE_MM:
        return 1.0, [f"{span}: they are read as mm"]
    if extent < LEAST_WHOLE_UM:
        raise InputError(f"{span}: too much in mm, too little in um; write decimal points", file)
    return 0.001, [f"{span}: they are read as whole um"]


def _extent(blocks: list[Block]) -> float:
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


def _outlines(control: _Interpreter, notices: list[str]) -> list[Outline]:
    absolute, arc_notices = prefer_absolute([motion for _, motions, _ in control.runs for motion in motions])
    for text, line in arc_notices:
        control.notices.add(text, line)
    check_contours(sum(bool(motions) for _, motions, _ in control.runs))
    outlines, count = [], 0
    for side_at_start, motions, dwells in control.runs:
        if motions:
            moves = tuple(_cut_move(motion, absolute) for motion in motions)
            count += sum(len(move.points) for move in moves)
            check_count(count)
            outline, new = outline_of(Run(motions[0].start, side_at_start is not None, moves, tuple(dwells)))
            outlines.append(outline)
            notices.extend(new)
    if not outlines:
        raise InputError("the program cuts nothing: no G1, G2 or G3 with coordinates in it")
    return outlines


def _cut_move(motion: CuttingMotion, absolute: bool) -> CutMove:
    """Return a motion's points, an arc as chords, unless it leads beyond every table."""
    try:
        check_points(_array((motion.start, motion.end)), "the move")
        points = motion.points(absolute)
        if len(points) > 1:
            check_points(_array((motion.start, *points)), "the arc")
    except InputError as error:
        raise InputError(error.reason, line=motion.line) from None
    return CutMove(points, motion.side, motion.line, motion.offset)


def _array(points: tuple[complex, ...]) -> NDArray[np.float64]:
    return np.array(points, np.complex128).view(np.float64).reshape(-1, 2)
