"""Marks in a program in LLVM's language: while it runs, a number in memory says which of its parts it is in.

They are for measurements of where time goes and nothing else: a program made without them has no trace of them.
"""

from __future__ import annotations

from collections.abc import Sequence

PART = "edmsim_part"
"""Name of the number (int64): 0 outside, else that of the part, counted from 1."""


def with_marks(program: str, parts: Sequence[Sequence[str]]) -> str:
    """Let functions of each part of a program (a module of numba's LLVM) say, before they are inlined, that they run.

    A function that is called by one of another part counts for its own; when it ends, the other goes on.
    """
    numbers = {symbol(name): number for number, names in enumerate(parts, 1) for name in names}
    lines: list[str] = []
    found, number = set(), 0
    for line in program.splitlines():
        if line.startswith("define "):
            begins = next((s for s in numbers if f"@{s}" in line.partition("(")[0]), "")
            number = numbers.get(begins, 0)
            found.add(begins)
        if number and line.startswith("  ret "):
            lines.append(f"  store volatile i64 %part.around, ptr @{PART}")
        lines.append(line)
        if number and line == "entry:":
            lines.append(f"  %part.around = load volatile i64, ptr @{PART}")
            lines.append(f"  store volatile i64 {number}, ptr @{PART}")
    if missing := numbers.keys() - found:
        raise LookupError(f"the compiled program has none of the functions {', '.join(sorted(missing))}")
    return "\n".join([*lines, f"@{PART} = global i64 0", ""])


def symbol(name: str) -> str:
    """Return what the symbols of all versions of a function begin with."""
    return "_ZN" + "".join(f"{len(word)}{word}" for word in name.split(".")) + "B"
