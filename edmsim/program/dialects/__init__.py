"""The dialects of G-code: a file for each, and how the dialect of a program is recognised."""

from __future__ import annotations

import re

from edmsim.errors import InputError, one_of
from edmsim.program.dialects.charmilles import CHARMILLES
from edmsim.program.dialects.dialect import ISO, Dialect
from edmsim.program.dialects.fanuc import FANUC
from edmsim.program.dialects.freecad import FREECAD
from edmsim.program.dialects.linuxcnc import LINUXCNC
from edmsim.program.dialects.mitsubishi import MITSUBISHI
from edmsim.program.dialects.skd2 import SKD2
from edmsim.program.dialects.sodick import SODICK

DIALECTS = {
    dialect.name: dialect for dialect in (SODICK, MITSUBISHI, SKD2, CHARMILLES, FANUC, LINUXCNC, FREECAD, ISO)
}  # fmt: skip
"""By name, in the order in which they are looked for in a program."""
AUTO = "auto"

_COMMENT = re.compile(r"\(([^()]*)\)|;(.*)")


def check_dialect(name: str) -> str:
    """Return the name of a dialect; raises `InputError` for an unknown one."""
    if name not in (AUTO, *DIALECTS):
        raise InputError(f"unknown dialect '{name}'; there are: {one_of(name, (AUTO, *DIALECTS))}")
    return name


def comments_of(text: str) -> list[str]:
    """Return the comments of a program."""
    return ["".join(found) for found in _COMMENT.findall(text)]


def dialect_of(text: str, requested: str) -> tuple[Dialect, list[str]]:
    """Return the dialect of a program, and notices about it; ``auto`` recognises it by words that no other has."""
    if check_dialect(requested) != AUTO:
        return DIALECTS[requested], [f"dialect {requested} ({DIALECTS[requested].machines}), as requested"]
    words = "\n".join("".join(_COMMENT.sub("", line).split()) for line in text.upper().splitlines())
    comments = "\n".join(comments_of(text))
    for dialect in DIALECTS.values():
        found = dialect.found_in(words, comments)
        if found is not None and (dialect is not LINUXCNC or re.search(r"[UV][-+\d.]", words)):
            short = found if len(found) < 60 else f"{found[:57]}..."
            return dialect, [f"dialect {dialect.name} ({dialect.machines}), recognised by {' '.join(short.split())}; "
                             "--dialect selects another"]  # fmt: skip
    return ISO, []
