"""The application example of the EANPOS manual (1.9), as printed and repaired.

``manual/`` has the texts as wiki.qem.it prints them, to the character; the program's two halves, which a page break
parts there, are one file.
"""

from __future__ import annotations

from pathlib import Path

FOLDER = Path(__file__).parent / "manual"
CONFIGURATION = (FOLDER / "ex_eanpos.cnf").read_text(encoding="utf-8")
PROGRAM = (FOLDER / "task_00.mod").read_text(encoding="utf-8")
SECOND_HALF = 45
"""Line of the program at which its second half begins."""


def in_second_half(line: int) -> int:
    """Line of the whole program of a line of its second half."""
    return SECOND_HALF - 1 + line


def _comment_stars(text: str) -> str:
    return "\n".join(f";{line}" if line.startswith("*") else line for line in text.splitlines())


def readable() -> tuple[str, str]:
    """Configuration and program with nothing repaired but what cannot be read: comments, and two names."""
    named = CONFIGURATION.replace("slVelAsse", "slVelAxis").replace("ofAxeFermo", "ofAxeStopped")
    return _comment_stars(named), _comment_stars(PROGRAM)


def repaired() -> tuple[str, str]:
    """Besides that the enabling input has an address of its own, and the missing RESUME stands before its WAIT."""
    configuration, program = readable()
    configuration = configuration.replace("1       2.INP01    2.AN01", "1       2.INP05    2.AN01")
    lines = program.splitlines()
    lines.insert(in_second_half(3) - 1, "RESUME Axis")
    return configuration, "\n".join(lines)
