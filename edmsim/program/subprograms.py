"""Subprograms: M98 P1000 L2 runs twice what stands between O1000 and M99 behind the end of the program."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from edmsim.errors import InputError
from edmsim.program.blocks import Block
from edmsim.program.limits import check_count

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
