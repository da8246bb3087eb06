"""G-code (RS-274 and the Robofil dialect) read into outlines.

The words understood are G0 to G4, G10, G20, G21, G40 to G42, G90 to G92, G90.1, G91.1, M0, M1, M2, M30, M50, M60, F,
D, H, N, X, Y, I, J, R and P. Those that cannot change a contour in two axes (`edmsim.program.words`) are read with a
notice. Dwells (G4 with P or X) are in seconds. A ``/`` at the head of a line does not delete it. A G92 before any
move says where the wire is; later ones shift the coordinates.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edmsim.errors import InputError
from edmsim.program.blocks import read_blocks, read_text
from edmsim.program.centres import Reading, prefer_absolute, reading_of
from edmsim.program.contours import closes_on_itself, outline_of
from edmsim.program.interpreter import Interpreter, Motions, registers_set
from edmsim.program.limits import check_contours, check_count, check_points
from edmsim.program.outline import CutMove, Outline, Program, Run
from edmsim.program.registers import OffsetRegisters
from edmsim.program.rounding import rounding_of
from edmsim.program.subprograms import expanded
from edmsim.program.units import units_of
from edmsim.program.words import Ignored


def read_gcode(
    file: str | Path, ignore: Sequence[str] = (), offsets: Mapping[str, float] | None = None
) -> Program:
    """Read a G-code program.

    Parameters
    ----------
    file : path
        The program, text in UTF-8, or as its byte order mark says.
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
    units, unit_notices = units_of(blocks, str(path))
    registers = OffsetRegisters(offsets or {}, registers_set(blocks), str(path))
    control = Interpreter(units, rounding_of(blocks, units), registers, str(path))
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


def _outlines(control: Interpreter, notices: list[str]) -> list[Outline]:
    absolute = prefer_absolute([motion for run in control.runs for motion in run.motions], control.rounding)
    check_contours(sum(bool(run.motions) for run in control.runs))
    outlines, count = [], 0
    for motions in control.runs:
        run = _run_of(motions, absolute, control) if motions.motions else None
        if run is not None:
            count += sum(len(move.points) for move in run.moves)
            check_count(count)
            outline, new = outline_of(run)
            outlines.append(outline)
            notices.extend(new)
    if not outlines:
        raise InputError("the program cuts nothing: no G1, G2 or G3 with coordinates in it")
    return outlines


def _run_of(motions: Motions, absolute: bool | None, control: Interpreter) -> Run | None:
    """Turn motions into moves; None if they cut nothing."""
    join_mm = control.rounding.join_mm
    readings = [reading_of(motion, absolute, control.rounding) for motion in motions.motions]
    if any(reading.full is None for reading in readings):  # what closes without the circle is no approach to it
        closes = closes_on_itself([_cut_move(reading) for reading in readings], motions.motions[0].start, join_mm)
        readings = [reading.decided(not closes) if reading.full is None else reading for reading in readings]
    for reading in readings:
        for notice in reading.notices:
            control.notices.add(notice, reading.motion.line)
    done = np.cumsum([0, *(reading.moves for reading in readings)])
    dwells = tuple((int(done[count]), seconds) for count, seconds in motions.dwells)
    moves = tuple(_cut_move(reading) for reading in readings if reading.moves)
    return Run(motions.motions[0].start, motions.side_at_start is not None, moves, dwells, join_mm) if moves else None


def _cut_move(reading: Reading) -> CutMove:
    """Return a motion's points, an arc as chords, unless it leads beyond every table."""
    motion = reading.motion
    try:
        check_points(_array((motion.start, motion.end)), "the move")
        points = reading.points
        if len(points) > 1:
            check_points(_array((motion.start, *points)), "the arc")
    except InputError as error:
        raise InputError(error.reason, line=motion.line) from None
    return CutMove(points, motion.side, motion.line, motion.offset)


def _array(points: tuple[complex, ...]) -> NDArray[np.float64]:
    return np.array(points, np.complex128).view(np.float64).reshape(-1, 2)
